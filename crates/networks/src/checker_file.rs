//! The file of an imported network for the checker of certificates; `crumple-verify` documents its content.
//!
//! The bytes depend only on the network and its mapping, so that reading the source again gives the same file.

use std::borrow::Cow;

use safetensors::tensor::{Dtype, TensorView};
use serde::Serialize;

use super::mapping::{InputMapping, Mapping, OutputMapping, Squash};
use super::{InvalidMapping, NetworkController};
use crate::network::{Elementwise, Linear, NetworkFormat, NetworkStep};
use crumple_sim::control::ObservedQuantity;
use crumple_sim::observation::EMPTY_GAP_M;

const METADATA_KEY: &str = "crumple_network";
const VERSION: u32 = 1;

#[derive(Serialize)]
struct CheckerFileHeader<'a> {
    version: u32,
    source: CheckerFileSource<'a>,
    inputs: &'a [InputMapping],
    steps: Vec<CheckerFileStep>,
    output: CheckerFileOutput,
    empty_gap_m: f64,
    decision_interval_s: f64,
}

#[derive(Serialize)]
struct CheckerFileSource<'a> {
    format: NetworkFormat,
    sha256: &'a str,
}

#[derive(Serialize)]
#[serde(rename_all = "kebab-case")]
enum CheckerFileStep {
    Linear(usize),
    Relu,
    LeakyRelu(f64),
    Elu(f64),
    Tanh,
    Sigmoid,
    Add,
    Multiply,
    Divide,
    Clip,
}

#[derive(Serialize)]
struct CheckerFileOutput {
    answer: usize,
    scale_mps2: f64,
    offset_mps2: f64,
    low_mps2: f64,
    high_mps2: f64,
}

/// Name, shape and bytes.
type NamedTensor = (String, Vec<usize>, Vec<u8>);

impl NetworkController {
    /// Returns the network as a file for the checker.
    ///
    /// # Errors
    /// [`InvalidMapping`] if an input is not an affine function of the current observation.
    pub fn checker_file(&self) -> Result<Vec<u8>, InvalidMapping> {
        let mapping = self.mapping();
        check_inputs(mapping)?;
        let interval_s = mapping.decision_interval_s;
        let decision_interval_s = interval_s.ok_or_else(|| {
            InvalidMapping::new("decision_interval_s", "is missing, and a network needs it")
        })?;
        let mut steps = Vec::new();
        let mut tensors = Vec::new();
        let mut width = self.network().inputs();
        for (index, step) in self.network().steps().iter().enumerate() {
            steps.push(serialize_step(step, index, width, &mut tensors));
            if let NetworkStep::Linear(Linear { biases, .. }) = step {
                width = biases.len();
            }
        }
        // Equals the squashing of the mapping: the same function in single precision.
        steps.extend(
            mapping
                .output
                .squash
                .map(|Squash::Tanh| CheckerFileStep::Tanh),
        );
        let header = CheckerFileHeader {
            version: VERSION,
            source: CheckerFileSource {
                format: self.network_file().format(),
                sha256: &self.network_file().sha256,
            },
            inputs: &mapping.inputs,
            steps,
            output: CheckerFileOutput::from(&mapping.output),
            empty_gap_m: EMPTY_GAP_M,
            decision_interval_s,
        };
        let text = serde_json::to_string(&header)
            .map_err(|error| InvalidMapping::new("network", error.to_string()))?;
        serialize_tensors(&tensors, text)
            .map_err(|error| InvalidMapping::new("network", error.to_string()))
    }
}

/// Rejects a mapping with inputs that are not affine functions of the current observation.
fn check_inputs(mapping: &Mapping) -> Result<(), InvalidMapping> {
    if mapping.history != 1 {
        let problem = format!(
            "is {}, and only a network that sees nothing but the present can be followed",
            mapping.history
        );
        return Err(InvalidMapping::new("history", problem));
    }
    for (index, input) in mapping.inputs.iter().enumerate() {
        if let Some(why) = input.quantity.and_then(why_not_affine) {
            let problem = format!("`{}` {why}", input.name());
            return Err(InvalidMapping::new(
                format!("inputs[{index}].quantity"),
                problem,
            ));
        }
    }
    Ok(())
}

impl From<&OutputMapping> for CheckerFileOutput {
    fn from(output: &OutputMapping) -> Self {
        Self {
            answer: output.answer.unwrap_or_default(),
            scale_mps2: output.scale_mps2,
            offset_mps2: output.offset_mps2,
            low_mps2: output.low_mps2,
            high_mps2: output.high_mps2,
        }
    }
}

fn serialize_tensors(
    tensors: &[NamedTensor],
    header: String,
) -> Result<Vec<u8>, safetensors::SafeTensorError> {
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    safetensors::serialize(views, Some([(METADATA_KEY.to_owned(), header)].into()))
}

fn why_not_affine(quantity: ObservedQuantity) -> Option<&'static str> {
    match quantity {
        ObservedQuantity::TimeGapAheadS
        | ObservedQuantity::TimeGapBehindS
        | ObservedQuantity::TimeToCollisionAheadS
        | ObservedQuantity::TimeToCollisionBehindS => {
            Some("is a quotient of what is observed, and only sums and differences can be followed")
        }
        ObservedQuantity::LastAnswerMps2 => {
            Some("is memory, and only a network without memory can be followed")
        }
        _ => None,
    }
}

/// Converts a step to its file form and appends its numbers to `tensors`.
fn serialize_step(
    step: &NetworkStep,
    index: usize,
    width: usize,
    tensors: &mut Vec<NamedTensor>,
) -> CheckerFileStep {
    match step {
        NetworkStep::Linear(Linear { weights, biases }) => {
            let outputs = biases.len();
            tensors.push(named_tensor(index, "weight", &[width, outputs], weights));
            tensors.push(named_tensor(index, "bias", &[outputs], biases));
            CheckerFileStep::Linear(outputs)
        }
        NetworkStep::Elementwise(function) => {
            for (name, operands) in elementwise_operands(function) {
                tensors.push(named_tensor(index, name, &[width], &operands));
            }
            match function {
                Elementwise::Relu => CheckerFileStep::Relu,
                Elementwise::LeakyRelu { slope } => CheckerFileStep::LeakyRelu(f64::from(*slope)),
                Elementwise::Elu { alpha } => CheckerFileStep::Elu(f64::from(*alpha)),
                Elementwise::Tanh => CheckerFileStep::Tanh,
                Elementwise::Sigmoid => CheckerFileStep::Sigmoid,
                Elementwise::Add(_) => CheckerFileStep::Add,
                Elementwise::Multiply(_) => CheckerFileStep::Multiply,
                Elementwise::Divide(_) => CheckerFileStep::Divide,
                Elementwise::Clip { .. } => CheckerFileStep::Clip,
            }
        }
    }
}

/// Returns the operands of a function, with the names of their tensors.
fn elementwise_operands(function: &Elementwise) -> Vec<(&'static str, Cow<'_, [f32]>)> {
    match function {
        Elementwise::Add(operands)
        | Elementwise::Multiply(operands)
        | Elementwise::Divide(operands) => vec![("operand", operands.into())],
        Elementwise::Clip { low, high } => {
            vec![
                ("low", finite_limits(low).into()),
                ("high", finite_limits(high).into()),
            ]
        }
        Elementwise::Relu
        | Elementwise::LeakyRelu { .. }
        | Elementwise::Elu { .. }
        | Elementwise::Tanh
        | Elementwise::Sigmoid => Vec::new(),
    }
}

/// Replaces infinite limits, which stand for missing ones, by the largest finite number.
fn finite_limits(limits: &[f32]) -> Vec<f32> {
    limits
        .iter()
        .map(|limit| limit.clamp(f32::MIN, f32::MAX))
        .collect()
}

fn named_tensor(step: usize, name: &str, shape: &[usize], numbers: &[f32]) -> NamedTensor {
    let bytes = numbers
        .iter()
        .flat_map(|number| number.to_le_bytes())
        .collect();
    (format!("steps.{step}.{name}"), shape.to_vec(), bytes)
}
