//! The policy file: safetensors with one JSON object in its metadata.

use std::fmt::Display;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensorError, SafeTensors};

use super::header::{ActionBounds, ObservationScaling, POLICY_VERSION, PolicyHeader};
use super::{Network, Policy};
use crumple_core::format_version::check_version;
use crumple_core::regular_file;

const METADATA_KEY: &str = "crumple_policy";

const MAX_BYTES: u64 = 256 << 20;

const MAX_LAYERS: usize = 16;
const MAX_LAYER_WIDTH: usize = 4096;
/// Maximum number of decisions in the history of a network, and of decisions between two of its frames.
pub const MAX_HISTORY: usize = 64;
/// Maximum number of inputs per decision besides the paper's eight.
pub const MAX_EXTRA_INPUTS: usize = 32;

/// Reason why a policy cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A policy in a file cannot be used.
    #[error("{}: {reason}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: Box<Self>,
    },
    /// The file is too large.
    #[error("the policy file has more than {MAX_BYTES} bytes")]
    TooLarge,
    /// The file is not a safetensors file, or is truncated.
    #[error("not a whole safetensors file: {0}")]
    Container(#[from] SafeTensorError),
    /// The header is missing or wrong.
    #[error("header of the policy: {0}")]
    Header(String),
    /// The network can overflow.
    #[error(
        "layer {layer} can overflow on a state within the observation's limit: its numbers are too large to drive with"
    )]
    Overflow {
        /// Index of the layer, from 0.
        layer: usize,
    },
    /// A tensor is missing, superfluous, or does not fit the header.
    #[error("tensor `{tensor}`: {problem}")]
    Tensor {
        /// Name of the tensor.
        tensor: String,
        /// Description of the error.
        problem: String,
    },
}

impl Policy {
    /// Reads a policy file.
    ///
    /// # Errors
    /// [`PolicyError`] for a missing or damaged file, tensors that do not fit the header, or a possible overflow.
    pub fn load(path: &Path) -> Result<Self, PolicyError> {
        let mut bytes = Vec::new();
        regular_file::open(path)
            .and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes))
            .map_err(|source| PolicyError::Read {
                path: path.to_owned(),
                source,
            })?;
        Self::from_bytes(&bytes).map_err(|reason| PolicyError::InFile {
            path: path.to_owned(),
            reason: Box::new(reason),
        })
    }

    /// Reads the bytes of a policy file.
    ///
    /// # Errors
    /// [`PolicyError`], as for [`Policy::load`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PolicyError> {
        if bytes.len() as u64 > MAX_BYTES {
            return Err(PolicyError::TooLarge);
        }
        let (_, container) = SafeTensors::read_metadata(bytes)?;
        let metadata = container.metadata().as_ref();
        let text = metadata
            .and_then(|metadata| metadata.get(METADATA_KEY))
            .ok_or_else(|| PolicyError::Header("missing: this is not a policy file".to_owned()))?;
        let header = parse_header(text)?;
        let network = read_network(bytes, &layer_sizes(&header))?;
        Self::from_checked_parts(header, network)
    }

    /// Returns the bytes of the policy file, which are the same for equal policies.
    ///
    /// # Errors
    /// None in practice; [`PolicyError::Header`] and [`PolicyError::Container`] forward errors of the writers.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PolicyError> {
        let text =
            serde_json::to_string(&self.header).map_err(|e| PolicyError::Header(e.to_string()))?;
        let mut data = Vec::new();
        for (index, layer) in self.network.layers().enumerate() {
            let parameters = self.network.parameters();
            data.push((
                weight_name(index),
                vec![layer.inputs, layer.outputs],
                le_bytes(&parameters[layer.weights()]),
            ));
            data.push((
                bias_name(index),
                vec![layer.outputs],
                le_bytes(&parameters[layer.biases()]),
            ));
        }
        let views = data
            .iter()
            .map(|(name, shape, bytes)| {
                Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?))
            })
            .collect::<Result<Vec<_>, SafeTensorError>>()?;
        Ok(safetensors::serialize(
            views,
            Some([(METADATA_KEY.to_owned(), text)].into()),
        )?)
    }
}

fn le_bytes(parameters: &[f32]) -> Vec<u8> {
    parameters
        .iter()
        .flat_map(|parameter| parameter.to_le_bytes())
        .collect()
}

/// Reads and checks the header of a policy file. Versions and removed features have errors of their own.
fn parse_header(text: &str) -> Result<PolicyHeader, PolicyError> {
    let raw = serde_json::from_str::<serde_json::Value>(text).unwrap_or_default();
    let version = raw.get("version").and_then(serde_json::Value::as_u64);
    if let Some(version) = version {
        check_version(version, POLICY_VERSION)
            .map_err(|unsupported| PolicyError::Header(unsupported.to_string()))?;
    }
    if raw.pointer("/action/departs_from").is_some() {
        let problem = "action.departs_from: residual policies were removed in crumple 0.3.0";
        return Err(PolicyError::Header(problem.to_owned()));
    }
    let header: PolicyHeader =
        serde_json::from_str(text).map_err(|e| PolicyError::Header(e.to_string()))?;
    check_header(&header)?;
    Ok(header)
}

/// Reads a network with layers of the given sizes from the bytes of a policy file.
fn read_network(bytes: &[u8], sizes: &[usize]) -> Result<Network, PolicyError> {
    let tensors = SafeTensors::deserialize(bytes)?;
    // Checked before any allocation: a small file cannot claim a large network.
    let described: usize = sizes
        .windows(2)
        .map(|pair| pair.iter().product::<usize>() + pair[1])
        .sum();
    if described.saturating_mul(4) > bytes.len() {
        let problem =
            format!("describes a network of {described} parameters, more than the file holds");
        return Err(PolicyError::Header(problem));
    }
    let mut network = Network::zeros(sizes);
    let layers = network.layers();
    if let Some(name) = tensors
        .names()
        .into_iter()
        .find(|name| !tensor_names(layers.len()).any(|n| n == **name))
    {
        return Err(tensor_error(
            name,
            "is not part of the network the header describes".to_owned(),
        ));
    }
    for (index, layer) in layers.enumerate() {
        let parameters = network.parameters_mut();
        read_tensor(
            &tensors,
            &weight_name(index),
            &[layer.inputs, layer.outputs],
            &mut parameters[layer.weights()],
        )?;
        read_tensor(
            &tensors,
            &bias_name(index),
            &[layer.outputs],
            &mut parameters[layer.biases()],
        )?;
    }
    Ok(network)
}

fn weight_name(layer: usize) -> String {
    format!("actor.{layer}.weight")
}

fn bias_name(layer: usize) -> String {
    format!("actor.{layer}.bias")
}

fn tensor_names(layers: usize) -> impl Iterator<Item = String> {
    (0..layers).flat_map(|layer| [weight_name(layer), bias_name(layer)])
}

pub(super) fn layer_sizes(header: &PolicyHeader) -> Vec<usize> {
    [
        &[header.observation.width() * header.observation.history],
        header.hidden.as_slice(),
        &[1],
    ]
    .concat()
}

fn tensor_error(tensor: &str, problem: String) -> PolicyError {
    PolicyError::Tensor {
        tensor: tensor.to_owned(),
        problem,
    }
}

fn read_tensor(
    tensors: &SafeTensors<'_>,
    name: &str,
    shape: &[usize],
    parameters: &mut [f32],
) -> Result<(), PolicyError> {
    let Ok(view) = tensors.tensor(name) else {
        return Err(tensor_error(name, "is missing".to_owned()));
    };
    if view.dtype() != Dtype::F32 {
        return Err(tensor_error(
            name,
            format!("must be F32, found {:?}", view.dtype()),
        ));
    }
    if view.shape() != shape {
        return Err(tensor_error(
            name,
            format!("must have shape {shape:?}, found {:?}", view.shape()),
        ));
    }
    let (values, _) = view.data().as_chunks::<4>();
    for (parameter, &bytes) in parameters.iter_mut().zip(values) {
        *parameter = f32::from_le_bytes(bytes);
    }
    if parameters.iter().all(|value| value.is_finite()) {
        Ok(())
    } else {
        Err(tensor_error(
            name,
            "holds a number that is not finite".to_owned(),
        ))
    }
}

fn header_error<T>(field: &str, problem: impl Display) -> Result<T, PolicyError> {
    Err(PolicyError::Header(format!("{field}: {problem}")))
}

pub(super) fn check_header(header: &PolicyHeader) -> Result<(), PolicyError> {
    if let Err(unsupported) = check_version(header.version, POLICY_VERSION) {
        return header_error("version", unsupported);
    }
    check_hidden_layers(&header.hidden)?;
    check_scaling(&header.observation)?;
    for (field, value) in [
        ("observation.limit", header.observation.limit),
        ("observation.empty_gap_m", header.observation.empty_gap_m),
        ("decision_interval_s", header.decision_interval_s),
    ] {
        if !(value.is_finite() && value > 0.0) {
            return header_error(field, format!("must be positive, found {value}"));
        }
    }
    check_action(&header.action)
}

fn check_hidden_layers(widths: &[usize]) -> Result<(), PolicyError> {
    if widths.len() > MAX_LAYERS {
        let layers = widths.len();
        let problem = format!("at most {MAX_LAYERS} layers are allowed, found {layers}");
        return header_error("hidden", problem);
    }
    let wrong = widths
        .iter()
        .find(|width| !(1..=MAX_LAYER_WIDTH).contains(*width));
    match wrong {
        Some(width) => header_error(
            "hidden",
            format!("a layer must be 1 to {MAX_LAYER_WIDTH} wide, found {width}"),
        ),
        None => Ok(()),
    }
}

/// Checks extra inputs, offsets, scales and history of an observation.
fn check_scaling(observation: &ObservationScaling) -> Result<(), PolicyError> {
    let extra = &observation.extra;
    if extra.len() > MAX_EXTRA_INPUTS {
        let problem = format!(
            "at most {MAX_EXTRA_INPUTS} are allowed, found {}",
            extra.len()
        );
        return header_error("observation.extra", problem);
    }
    let extra_offsets = extra.iter().map(|input| &input.offset);
    let mut offsets = observation.offset.iter().chain(extra_offsets);
    if !offsets.all(|offset| offset.is_finite()) {
        return header_error("observation", "every offset must be finite");
    }
    let extra_scales = extra.iter().map(|input| &input.scale);
    let mut scales = observation.scale.iter().chain(extra_scales);
    if !scales.all(|scale| scale.is_finite() && *scale > 0.0) {
        return header_error("observation", "every scale must be positive");
    }
    for (field, decisions) in [
        ("observation.history", observation.history),
        ("observation.history_every", observation.history_every),
    ] {
        if !(1..=MAX_HISTORY).contains(&decisions) {
            let problem = format!("must be 1 to {MAX_HISTORY} decisions, found {decisions}");
            return header_error(field, problem);
        }
    }
    Ok(())
}

fn check_action(action: &ActionBounds) -> Result<(), PolicyError> {
    let low_mps2 = action.low_mps2;
    let high_mps2 = action.high_mps2;
    if low_mps2.is_nan() || high_mps2.is_nan() || low_mps2 >= high_mps2 {
        return header_error("action", "low_mps2 must be below high_mps2");
    }
    if !(low_mps2 - high_mps2).is_finite() || !(low_mps2 + high_mps2).is_finite() {
        return header_error(
            "action",
            "the bounds must be finite, and so their sum and difference",
        );
    }
    Ok(())
}
