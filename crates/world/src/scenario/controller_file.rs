//! Controllers in files: policies, networks, and controller files, which say what a network or a process sees and what its answer
//! means.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::file::{FileError, line_in_toml, parse_toml, read};
use crate::control::{
    ControllerKind, FmuConfig, FmuProblem, HistoryPadding, InputMapping, InvalidMapping, Mapping, NameOrigin,
    NetworkController, OutputMapping, ProcessController, ProcessSetup, StartPermission, StartRefusal,
};
use crate::network::{NetworkError, NetworkFile, VecNormalizeStats, VecNormalizeUse};
use crate::policy::{Policy, PolicyError};

/// Version of the format of controller files that this release reads.
pub(crate) const CONTROLLER_FILE_VERSION: u32 = 1;

/// A controller file as it is written: `docs/controllers.md`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "crumple controller, version 1"))]
#[serde(deny_unknown_fields)]
pub struct ControllerFile {
    /// Version of the format: 1.
    pub version: u32,
    /// The network, as a path from the folder of this file: ONNX, or a model of Stable-Baselines3. Either this, an FMU or a command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// The FMU, as a path from the folder of this file: co-simulation, FMI 2.0 or 3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fmu: Option<String>,
    /// What parameters of the FMU begin with; 0 or 1 for Booleans.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, f64>,
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
    /// Decisions of which the controller sees the inputs: 1 for the present ones alone.
    #[serde(default = "default_history")]
    pub history: usize,
    /// What stands for the decisions before the first: what was seen first, unless it says `zeros`, as Stable-Baselines3's
    /// `VecFrameStack` begins.
    #[serde(default, skip_serializing_if = "HistoryPadding::is_default")]
    pub history_padding: HistoryPadding,
    /// Whether the present inputs come first; otherwise they come last.
    #[serde(default)]
    pub newest_first: bool,
    /// Whether the inputs hold what `VecNormalize` did to observations in training (means as `offset`, square roots of the variances
    /// plus epsilon as `scale`, `clip_obs` as `low` and `high`); false says that it did nothing to them. A model that may have been trained
    /// behind it needs the answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normalised: Option<bool>,
    /// What the controller sees, in order; everything there is, for a command without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Vec<InputMapping>>,
    /// What its answer means; an acceleration, for a command without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<OutputMapping>,
}

fn default_history() -> usize {
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
    /// A program that the user did not name.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// An FMU that cannot drive.
    #[error("{path}: {problem}")]
    Fmu {
        /// Its file.
        path: String,
        /// What is wrong.
        problem: FmuProblem,
    },
    /// A network or an FMU without a controller file that needs one.
    #[error("{path}: {invalid}")]
    NeedsMapping {
        /// Its file.
        path: String,
        /// What the mapping without one does not fit.
        invalid: InvalidMapping,
    },
    /// A model whose observations were normalised in training, and nothing says how.
    #[error(
        "{path}: {reason}: write a controller file whose inputs have the means as offsets and the deviations as scales, and that says \
         `normalised = true`, or `false` if observations were left alone (docs/controllers.md)"
    )]
    Normalised {
        /// The model's file.
        path: String,
        /// What tells it.
        reason: String,
    },
}

/// Reads a controller, and starts nothing. `named_by` says who named the file: runs of a process or an FMU start it. A name that
/// ends in `.onnx` is a network, in `.zip` a model of Stable-Baselines3, in `.fmu` an FMU, in `.toml` a controller file. Any other
/// file is a policy, or a model of Stable-Baselines3 if it begins as a zip archive.
///
/// # Errors
/// [`ControllerFileError`] if there is no such file, it holds no usable controller, or its program may not be started.
pub fn load(path: &Path, named_by: NameOrigin) -> Result<ControllerKind, ControllerFileError> {
    if path.extension().is_some_and(|extension| extension == "toml") {
        load_controller_file(path, named_by)
    } else if path.extension().is_some_and(|extension| extension == "fmu") {
        load_fmu(path, named_by)
    } else if NetworkFile::is_network(path) {
        load_network(path)
    } else {
        Ok(Arc::new(Policy::load(path)?).into())
    }
}

/// A controller file and its network, by the names under which they make the same controller; the controller file first.
///
/// # Errors
/// None in practice; the serializer's error is passed on rather than hidden.
pub fn to_files(controller: &NetworkController) -> Result<[(String, Vec<u8>); 2], toml::ser::Error> {
    let Mapping { decision_interval_s, history, history_padding, newest_first, inputs, output } =
        controller.mapping().clone();
    let (network, bytes) = controller.file().name_and_bytes();
    let file = ControllerFile {
        version: CONTROLLER_FILE_VERSION,
        network: Some(network.clone()),
        decision_interval_s,
        history,
        history_padding,
        newest_first,
        normalised: controller.normalised(),
        inputs: Some(inputs),
        output: Some(output),
        ..ControllerFile::default()
    };
    Ok([(file_name(controller), toml::to_string(&file)?.into_bytes()), (network, bytes.to_vec())])
}

/// The name that [`to_files`] gives the controller file.
#[must_use]
pub fn file_name(controller: &NetworkController) -> String {
    let identity = controller.identity();
    format!("{}.toml", identity.get(..16).unwrap_or(identity))
}

/// Whether there is an ordinary file: a scenario may name anything, and reading some things does not end.
pub(crate) fn is_regular_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| found.is_file())
}

/// A network in a file of its own, which sees and answers what crumple's own policies do.
fn load_network(path: &Path) -> Result<ControllerKind, ControllerFileError> {
    let file = NetworkFile::load(path)?;
    let shown = || path.display().to_string();
    if let Some(reason) = normalisation_evidence(&file, path) {
        return Err(ControllerFileError::Normalised { path: shown(), reason });
    }
    let controller = NetworkController::with_native_mapping(file)
        .map_err(|invalid| ControllerFileError::NeedsMapping { path: shown(), invalid })?;
    // Where the statistics beside it say that they left observations alone, a copy elsewhere still has to say so.
    let is_behind = controller.file().saved_model().is_some_and(|saved| saved.vec_normalize == VecNormalizeUse::Behind);
    Ok(Arc::new(controller.with_normalised(is_behind.then_some(false)).with_file_path(path)).into())
}

/// Whether the inputs hold what the statistics beside a model say.
fn matches_saved_statistics(mapping: &Mapping, path: &Path) -> bool {
    /// Numbers are often written with seven digits.
    const TOLERANCE: f64 = 1e-5;
    let Some(VecNormalizeStats::Observations(theirs)) =
        VecNormalizeStats::find_for_model(path).map(|beside| VecNormalizeStats::load(&beside))
    else {
        return false;
    };
    let is_close = |own: f64, their: f64| (own - their).abs() <= TOLERANCE * their.abs().max(TOLERANCE);
    theirs.means.len() == mapping.inputs.len()
        && mapping.inputs.iter().zip(theirs.means.iter().zip(&theirs.deviations)).all(|(input, (mean, deviation))| {
            is_close(input.offset, *mean)
                && is_close(input.scale, *deviation)
                && is_close(input.low, -theirs.limit)
                && is_close(input.high, theirs.limit)
        })
}

/// What tells that a model's observations were normalised in training: its own file, or statistics beside it.
fn normalisation_evidence(file: &NetworkFile, path: &Path) -> Option<String> {
    let trace = file.saved_model()?.vec_normalize;
    if trace == VecNormalizeUse::None {
        return None;
    }
    let beside = VecNormalizeStats::find_for_model(path);
    if beside.as_deref().is_some_and(|beside| VecNormalizeStats::load(beside) == VecNormalizeStats::RewardsOnly) {
        return None;
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let beside = beside.map(|beside| beside.strip_prefix(folder).unwrap_or(&beside).display().to_string());
    match (trace, beside) {
        (VecNormalizeUse::Behind, Some(beside)) => Some(format!(
            "it was trained behind VecNormalize, as its own data tells (`{beside}` seems to have the statistics)"
        )),
        (VecNormalizeUse::Behind, None) => Some("it was trained behind VecNormalize, as its own data tells".to_owned()),
        (_, Some(beside)) => Some(format!("beside it lies `{beside}`, so what it saw in training was normalised")),
        (_, None) => None,
    }
}

/// The controller of a controller file.
fn load_controller_file(path: &Path, named_by: NameOrigin) -> Result<ControllerKind, ControllerFileError> {
    let text = read(path)?;
    let file: ControllerFile = parse_toml(&text, path)?;
    let wrong = |InvalidMapping { field, problem }| FileError::from_field(path, &text, &field, problem);
    if file.version != CONTROLLER_FILE_VERSION {
        let problem =
            format!("version {} is not supported: this release reads {CONTROLLER_FILE_VERSION}", file.version);
        return Err(wrong(InvalidMapping::new("version", problem)).into());
    }
    let folder = path.with_file_name("");
    let permission =
        |field: &str| named_by.permission(|| format!("{}:{}: {field}", path.display(), line_in_toml(&text, field)));
    match file.controller_source().map_err(wrong)? {
        ControllerFileSource::Network(name) => {
            let normalised = file.normalised;
            let mapping = file.into_network_mapping().map_err(wrong)?;
            mapping.check().map_err(wrong)?;
            let place = folder.join(name);
            let network = NetworkFile::load(&place)?;
            if normalised.is_none()
                && !matches_saved_statistics(&mapping, &place)
                && let Some(reason) = normalisation_evidence(&network, &place)
            {
                let problem = format!(
                    "is missing: {}: {reason}; say `true` once the inputs have the means as offsets and the deviations as scales, or \
                     `false` if observations were left alone (docs/controllers.md)",
                    place.display()
                );
                return Err(wrong(InvalidMapping::new("normalised", problem)).into());
            }
            let controller = NetworkController::new(network, mapping).map_err(wrong)?;
            Ok(Arc::new(controller.with_normalised(normalised).with_file_path(path)).into())
        }
        ControllerFileSource::Fmu(name) => {
            let (deterministic, start_within_s) = (file.deterministic, file.start_within_s);
            let (answer_within_s, wiring) = (file.answer_within_s, file.into_wiring());
            let plain = ProcessSetup::from_fmu(&folder, &name, wiring).map_err(|problem| match problem {
                FmuProblem::Mapping(invalid) => wrong(invalid).into(),
                problem => ControllerFileError::Fmu { path: folder.join(&name).display().to_string(), problem },
            })?;
            let setup = ProcessSetup {
                deterministic: deterministic.unwrap_or(plain.deterministic),
                start_within_s: start_within_s.unwrap_or(plain.start_within_s),
                answer_within_s: answer_within_s.unwrap_or(plain.answer_within_s),
                ..plain
            };
            process_controller(setup, path, permission("fmu")?).map_err(|invalid| wrong(invalid).into())
        }
        ControllerFileSource::Command(command) => {
            let setup = file.into_process_setup(command, &folder);
            process_controller(setup, path, permission("command")?).map_err(|invalid| wrong(invalid).into())
        }
    }
}

/// Returns the process that the file at `path` sets up.
fn process_controller(
    setup: ProcessSetup,
    path: &Path,
    permission: StartPermission,
) -> Result<ControllerKind, InvalidMapping> {
    let setup = ProcessSetup { file: Some(path.to_owned()), ..setup };
    Ok(Arc::new(ProcessController::new(setup, permission)?).into())
}

/// An FMU in a file of its own: its inputs are called like what can be seen.
fn load_fmu(path: &Path, named_by: NameOrigin) -> Result<ControllerKind, ControllerFileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let setup = ProcessSetup::from_fmu(&path.with_file_name(""), &name, FmuConfig::default());
    let failed = |problem| match problem {
        FmuProblem::Mapping(invalid) => ControllerFileError::NeedsMapping { path: path.display().to_string(), invalid },
        problem => ControllerFileError::Fmu { path: path.display().to_string(), problem },
    };
    let setup = setup.map_err(failed)?;
    let permission = named_by.permission(|| path.display().to_string())?;
    process_controller(setup, path, permission).map_err(|invalid| failed(invalid.into()))
}

/// What a controller file says drives.
enum ControllerFileSource {
    Network(String),
    Fmu(String),
    Command(Vec<String>),
}

impl ControllerFile {
    /// What drives, if everything else that is said is for that.
    fn controller_source(&self) -> Result<ControllerFileSource, InvalidMapping> {
        let network = self.network.clone().map(|name| ("network", "a network", ControllerFileSource::Network(name)));
        let fmu = self.fmu.clone().map(|name| ("fmu", "an FMU", ControllerFileSource::Fmu(name)));
        let command = self.command.clone().map(|words| ("command", "a command", ControllerFileSource::Command(words)));
        let mut said = [network, fmu, command].into_iter().flatten();
        let problem = "there is neither a `network`, nor an `fmu`, nor a `command`";
        let (field, what, drives) = said.next().ok_or_else(|| InvalidMapping::new("version", problem))?;
        if let Some((other, ..)) = said.next() {
            return Err(InvalidMapping::new(other, format!("there is `{field}` already, and one of them drives")));
        }
        let (is_network, is_fmu) = (field == "network", field == "fmu");
        let input = self.inputs.iter().flatten().position(|input| input.variable.is_some());
        let output = self.output.as_ref().is_some_and(|output| output.variable.is_some());
        let misplaced = [
            ("files".to_owned(), !self.files.is_empty() && (is_network || is_fmu)),
            ("deterministic".to_owned(), self.deterministic.is_some() && is_network),
            ("start_within_s".to_owned(), self.start_within_s.is_some() && is_network),
            ("answer_within_s".to_owned(), self.answer_within_s.is_some() && is_network),
            ("history".to_owned(), self.history != default_history() && is_fmu),
            ("history_padding".to_owned(), !self.history_padding.is_default() && is_fmu),
            ("newest_first".to_owned(), self.newest_first && is_fmu),
            ("normalised".to_owned(), self.normalised.is_some() && !is_network),
            ("parameters".to_owned(), !self.parameters.is_empty() && !is_fmu),
            (format!("inputs[{}].variable", input.unwrap_or_default()), input.is_some() && !is_fmu),
            ("output.variable".to_owned(), output && !is_fmu),
        ];
        match misplaced.into_iter().find(|(_, is_misplaced)| *is_misplaced) {
            Some((field, _)) => Err(InvalidMapping::new(field, format!("is not for {what}"))),
            None => Ok(drives),
        }
    }

    /// What a network sees and answers, all of which has to be said.
    fn into_network_mapping(self) -> Result<Mapping, InvalidMapping> {
        let missing = |field| InvalidMapping::new(field, "is missing, and a network needs it");
        Ok(Mapping {
            decision_interval_s: Some(self.decision_interval_s.ok_or_else(|| missing("decision_interval_s"))?),
            history: self.history,
            history_padding: self.history_padding,
            newest_first: self.newest_first,
            inputs: self.inputs.ok_or_else(|| missing("inputs"))?,
            output: self.output.ok_or_else(|| missing("output"))?,
        })
    }

    /// What an FMU is wired to.
    fn into_wiring(self) -> FmuConfig {
        let Self { inputs, output, parameters, decision_interval_s, .. } = self;
        FmuConfig { inputs, output, parameters, decision_interval_s }
    }

    /// What a command is started with, sees and answers.
    fn into_process_setup(self, command: Vec<String>, folder: &Path) -> ProcessSetup {
        let plain = ProcessSetup::new(command, folder);
        ProcessSetup {
            files: self.files,
            deterministic: self.deterministic.unwrap_or(plain.deterministic),
            start_within_s: self.start_within_s.unwrap_or(plain.start_within_s),
            answer_within_s: self.answer_within_s.unwrap_or(plain.answer_within_s),
            mapping: Mapping {
                decision_interval_s: self.decision_interval_s,
                history: self.history,
                history_padding: self.history_padding,
                newest_first: self.newest_first,
                inputs: self.inputs.unwrap_or(plain.mapping.inputs),
                output: self.output.unwrap_or(plain.mapping.output),
            },
            ..plain
        }
    }
}
