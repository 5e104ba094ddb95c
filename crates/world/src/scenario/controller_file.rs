//! Controllers in files: policies, networks, and controller files, which say what a network sees and what its answer means.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::file::{FileError, line_in_toml, parse_toml, read};
use crate::control::{Input, InvalidMapping, Mapping, NetworkController, Output};
use crate::network::{NetworkError, NetworkFile};
use crate::policy::{Policy, PolicyError};

/// Version of the format of controller files that this release reads.
pub const CONTROLLER_FILE_VERSION: u32 = 1;

/// A controller file as it is written: `docs/controllers.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "crumple controller, version 1"))]
#[serde(deny_unknown_fields)]
pub struct ControllerFile {
    /// Version of the format: 1.
    pub version: u32,
    /// The network, as a path from the folder of this file: ONNX, or a model of Stable-Baselines3.
    pub network: String,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
    /// Decisions of which the network sees the inputs: 1 for the present ones alone. Before there are as many, the first
    /// stands in.
    #[serde(default = "one")]
    pub history: usize,
    /// Whether the present inputs come first; otherwise they come last.
    #[serde(default)]
    pub newest_first: bool,
    /// What the network sees, in order.
    pub inputs: Vec<Input>,
    /// What its answer means.
    pub output: Output,
}

fn one() -> usize {
    1
}

/// The JSON schema of controller files.
#[cfg(feature = "schema")]
#[must_use]
pub fn controller_file_schema() -> serde_json::Value {
    schemars::schema_for!(ControllerFile).to_value()
}

/// Why a controller in a file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControllerFileError {
    /// The file cannot be read or parsed, or says something wrong.
    #[error(transparent)]
    File(#[from] FileError),
    /// The policy cannot be used.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The network cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A network without a controller file that needs one.
    #[error("{path}: {invalid}")]
    NeedsMapping {
        /// The network's file.
        path: String,
        /// What crumple's own mapping does not fit.
        invalid: InvalidMapping,
    },
    /// A model beside the statistics by which its observations were normalised.
    #[error(
        "{path}: beside it lies `{statistics}`, so what it saw in training was normalised: write a controller file whose inputs \
         have the means as offsets and the deviations as scales (docs/controllers.md)"
    )]
    Normalised {
        /// The model's file.
        path: String,
        /// The name of the other.
        statistics: &'static str,
    },
}

/// Names under which statistics of normalised observations are usually saved.
const STATISTICS: [&str; 2] = ["vecnormalize.pkl", "vec_normalize.pkl"];

/// A controller that was read from a file.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum FileController {
    /// A policy of crumple's own.
    Policy(Arc<Policy>),
    /// A network from outside.
    Network(Arc<NetworkController>),
}

impl FileController {
    /// Reads a controller. A name that ends in `.onnx` is a network, in `.zip` a model of Stable-Baselines3, in `.toml` a
    /// controller file, and any other file a policy.
    ///
    /// # Errors
    /// [`ControllerFileError`] if there is no such file, or it holds no usable controller.
    pub fn load(path: &Path) -> Result<Self, ControllerFileError> {
        if path.extension().is_some_and(|extension| extension == "toml") {
            load(path).map(Self::Network)
        } else if NetworkFile::is_one(path) {
            load_network(path).map(Self::Network)
        } else {
            Ok(Self::Policy(Arc::new(Policy::load(path)?)))
        }
    }

    /// SHA-256, in hexadecimal, of everything that decides how it drives.
    #[must_use]
    pub fn identity(&self) -> String {
        match self {
            Self::Policy(policy) => policy.digest(),
            Self::Network(network) => network.identity().to_owned(),
        }
    }
}

/// A controller file and its network, by the names under which they make the same controller; the controller file first.
///
/// # Errors
/// None in practice; the serializer's error is passed on rather than hidden.
pub fn files_of(controller: &NetworkController) -> Result<[(String, Vec<u8>); 2], toml::ser::Error> {
    let Mapping { decision_interval_s, history, newest_first, inputs, output } = controller.mapping().clone();
    let (network, bytes) = controller.file().named();
    let file = ControllerFile {
        version: CONTROLLER_FILE_VERSION,
        network: network.clone(),
        decision_interval_s,
        history,
        newest_first,
        inputs,
        output,
    };
    Ok([(file_name(controller), toml::to_string(&file)?.into_bytes()), (network, bytes.to_vec())])
}

/// The name that [`files_of`] gives the controller file.
#[must_use]
pub fn file_name(controller: &NetworkController) -> String {
    let identity = controller.identity();
    format!("{}.toml", identity.get(..16).unwrap_or(identity))
}

/// Whether there is an ordinary file: a scenario may name anything, and reading some things does not end.
pub(super) fn is_ordinary(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| found.is_file())
}

/// A network in a file of its own, which sees and answers what crumple's own policies do.
fn load_network(path: &Path) -> Result<Arc<NetworkController>, ControllerFileError> {
    let file = NetworkFile::load(path)?;
    let shown = || path.display().to_string();
    let is_beside = |name: &&&str| path.with_file_name(**name).exists();
    if path.extension().is_some_and(|extension| extension == "zip")
        && let Some(statistics) = STATISTICS.iter().find(is_beside)
    {
        return Err(ControllerFileError::Normalised { path: shown(), statistics });
    }
    let controller = NetworkController::with_own_mapping(file)
        .map_err(|invalid| ControllerFileError::NeedsMapping { path: shown(), invalid })?;
    Ok(Arc::new(controller))
}

/// The controller of a controller file.
fn load(path: &Path) -> Result<Arc<NetworkController>, ControllerFileError> {
    let text = read(path)?;
    let file: ControllerFile = parse_toml(&text, path)?;
    let wrong = |InvalidMapping { field, problem }| FileError::Syntax {
        path: path.to_owned(),
        line: line_in_toml(&text, &field),
        message: format!("{field}: {problem}"),
    };
    if file.version != CONTROLLER_FILE_VERSION {
        let problem =
            format!("version {} is not supported: this release reads {CONTROLLER_FILE_VERSION}", file.version);
        return Err(wrong(InvalidMapping { field: "version".to_owned(), problem }).into());
    }
    let ControllerFile { network, decision_interval_s, history, newest_first, inputs, output, .. } = file;
    let mapping = Mapping { decision_interval_s, history, newest_first, inputs, output };
    mapping.check().map_err(wrong)?;
    let network = NetworkFile::load(&path.with_file_name("").join(network))?;
    Ok(Arc::new(NetworkController::new(network, mapping).map_err(wrong)?))
}
