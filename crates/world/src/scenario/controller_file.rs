//! Controllers in files: policies, networks, and controller files, which say what a network or a process sees and what its answer
//! means.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::file::{FileError, line_in_toml, parse_toml, read};
use crate::control::{Input, InvalidMapping, Mapping, NetworkController, Output, ProcessController, ProcessSetup};
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
    /// The network, as a path from the folder of this file: ONNX, or a model of Stable-Baselines3. Either this or a command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// The command that drives: a program and its arguments. It runs in the folder of this file, without a shell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<Vec<String>>,
    /// The files that decide how the command drives, as paths from the folder of this file. Without them nothing of it is kept or
    /// certified.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
    /// Whether the command always answers the same to the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Time that the command has for its first answer, in seconds: 30 unless it is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_within_s: Option<f64>,
    /// Time that it has for each other answer, in seconds: 1 unless it is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer_within_s: Option<f64>,
    /// Time between decisions, in seconds; a command may say it itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision_interval_s: Option<f64>,
    /// Decisions of which the controller sees the inputs: 1 for the present ones alone. Before there are as many, the first
    /// stands in.
    #[serde(default = "one")]
    pub history: usize,
    /// Whether the present inputs come first; otherwise they come last.
    #[serde(default)]
    pub newest_first: bool,
    /// What the controller sees, in order; everything there is, for a command without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Vec<Input>>,
    /// What its answer means; an acceleration, for a command without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<Output>,
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
    /// A command that cannot drive.
    #[error("{0}")]
    Command(InvalidMapping),
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
    /// A process.
    Process(Arc<ProcessController>),
}

impl FileController {
    /// Reads a controller. A name that ends in `.onnx` is a network, in `.zip` a model of Stable-Baselines3, in `.toml` a
    /// controller file, and any other file a policy.
    ///
    /// # Errors
    /// [`ControllerFileError`] if there is no such file, or it holds no usable controller.
    pub fn load(path: &Path) -> Result<Self, ControllerFileError> {
        if path.extension().is_some_and(|extension| extension == "toml") {
            load(path)
        } else if NetworkFile::is_one(path) {
            load_network(path).map(Self::Network)
        } else {
            Ok(Self::Policy(Arc::new(Policy::load(path)?)))
        }
    }

    /// SHA-256, in hexadecimal, of everything that decides how it drives; none for a process of which that is not known.
    #[must_use]
    pub fn identity(&self) -> Option<String> {
        match self {
            Self::Policy(policy) => Some(policy.digest()),
            Self::Network(network) => Some(network.identity().to_owned()),
            Self::Process(process) => process.identity().map(str::to_owned),
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
        network: Some(network.clone()),
        command: None,
        files: Vec::new(),
        deterministic: None,
        start_within_s: None,
        answer_within_s: None,
        decision_interval_s,
        history,
        newest_first,
        inputs: Some(inputs),
        output: Some(output),
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
fn load(path: &Path) -> Result<FileController, ControllerFileError> {
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
        return Err(wrong(InvalidMapping::new("version", problem)).into());
    }
    let folder = path.with_file_name("");
    match file.network.clone() {
        None => {
            let process = file.process(folder).and_then(ProcessController::new).map_err(wrong)?;
            Ok(FileController::Process(Arc::new(process)))
        }
        Some(network) => {
            let mapping = file.mapping_of_network().map_err(wrong)?;
            mapping.check().map_err(wrong)?;
            let network = NetworkFile::load(&folder.join(network))?;
            Ok(FileController::Network(Arc::new(NetworkController::new(network, mapping).map_err(wrong)?)))
        }
    }
}

impl ControllerFile {
    /// What a network sees and answers, all of which has to be said.
    fn mapping_of_network(self) -> Result<Mapping, InvalidMapping> {
        let of_commands = [
            ("command", self.command.is_some()),
            ("files", !self.files.is_empty()),
            ("deterministic", self.deterministic.is_some()),
            ("start_within_s", self.start_within_s.is_some()),
            ("answer_within_s", self.answer_within_s.is_some()),
        ];
        if let Some((field, _)) = of_commands.into_iter().find(|(_, is_given)| *is_given) {
            return Err(InvalidMapping::new(field, "is not for a network"));
        }
        let missing = |field| InvalidMapping::new(field, "is missing, and a network needs it");
        Ok(Mapping {
            decision_interval_s: Some(self.decision_interval_s.ok_or_else(|| missing("decision_interval_s"))?),
            history: self.history,
            newest_first: self.newest_first,
            inputs: self.inputs.ok_or_else(|| missing("inputs"))?,
            output: self.output.ok_or_else(|| missing("output"))?,
        })
    }

    /// What a command is started with, sees and answers.
    fn process(self, folder: PathBuf) -> Result<ProcessSetup, InvalidMapping> {
        let missing = || InvalidMapping::new("version", "there is neither a `network` nor a `command`");
        let plain = ProcessSetup::new(self.command.ok_or_else(missing)?, &folder);
        Ok(ProcessSetup {
            files: self.files,
            deterministic: self.deterministic.unwrap_or(plain.deterministic),
            start_within_s: self.start_within_s.unwrap_or(plain.start_within_s),
            answer_within_s: self.answer_within_s.unwrap_or(plain.answer_within_s),
            mapping: Mapping {
                decision_interval_s: self.decision_interval_s,
                history: self.history,
                newest_first: self.newest_first,
                inputs: self.inputs.unwrap_or(plain.mapping.inputs),
                output: self.output.unwrap_or(plain.mapping.output),
            },
            ..plain
        })
    }
}
