//! Controllers in files: policies, networks, and controller files, which map observations to inputs and outputs to
//! accelerations, or set a built-in controller.

mod draft;

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use serde::de::{Deserializer, Error, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};

use crumple_core::format_version::check_version;
use crumple_core::text_file::{FileError, line_in_toml, parse_toml, read};
use crumple_networks::network::{NetworkError, NetworkFile, VecNormalizeStats, VecNormalizeUse};
use crumple_networks::{
    HistoryPadding, InputMapping, InvalidMapping, Mapping, NetworkController, OutputMapping,
};
use crumple_process::{
    FmuConfig, FmuProblem, NameOrigin, ProcessController, ProcessSetup, StartPermission,
};
use crumple_sim::control::{
    BuiltInController, ControllerSource, PolicySource, SourceFile, StartRefusal,
};
use crumple_sim::policy::{Policy, PolicyError};

pub use draft::ControllerFileDraft;

const CONTROLLER_FILE_VERSION: u32 = 1;

/// Content of a controller file (`docs/controllers.md`).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(
    feature = "schema",
    derive(schemars::JsonSchema),
    schemars(title = "crumple controller, version 1")
)]
#[serde(deny_unknown_fields)]
pub struct ControllerFile {
    /// Version of the format: 1.
    pub version: u32,
    /// Name of a built-in controller. Excludes `network`, `fmu` and `command`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub built_in: Option<String>,
    /// Settings of the built-in controller that differ from their defaults.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, f64>,
    /// Path of the network from the folder of this file: ONNX or a Stable-Baselines3 model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// Path of the FMU from the folder of this file: co-simulation, FMI 2.0 or 3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fmu: Option<String>,
    /// Initial values of FMU parameters; 0 or 1 for Booleans.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, f64>,
    /// Command of the controller: a program and its arguments. It runs in the folder of this file, without a shell.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        deserialize_with = "deserialize_command"
    )]
    pub command: Option<Vec<String>>,
    /// Files that determine the behaviour of the command, as paths from the folder of this file. Without them no result
    /// is cached or certified.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
    /// True if the command gives equal answers to equal queries.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Time limit of the command's first answer, in seconds. Default 30.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_within_s: Option<f64>,
    /// Time limit of every other answer, in seconds. Default 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answer_within_s: Option<f64>,
    /// Time between decisions, in seconds. A command may state it in its handshake.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decision_interval_s: Option<f64>,
    /// Number of decisions whose inputs the controller receives; 1 for only the current inputs.
    #[serde(default = "default_history")]
    pub history: usize,
    /// Padding before the first decision: the first inputs, or `zeros` as in Stable-Baselines3's `VecFrameStack`.
    #[serde(default, skip_serializing_if = "HistoryPadding::is_default")]
    pub history_padding: HistoryPadding,
    /// True if the current inputs come first instead of last.
    #[serde(default)]
    pub newest_first: bool,
    /// True if the inputs apply the `VecNormalize` of the training: means as `offset`, √(variance + epsilon)
    /// as `scale`, ±`clip_obs` as `low` and `high`. False if observations were not normalised. Required for a
    /// model that may have been trained with `VecNormalize`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normalised: Option<bool>,
    /// Inputs of the controller, in order; for a command by default all that exist.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Vec<InputMapping>>,
    /// Meaning of the output; for a command by default an acceleration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub output: Option<OutputMapping>,
    /// Real output of an FMU that is above 0.5 while the FMU warns its driver of a forward collision.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

fn default_history() -> usize {
    1
}

/// Reads a list of words. The error for one text, which a shell would take, shows the list.
fn deserialize_command<'de, D: Deserializer<'de>>(
    command: D,
) -> Result<Option<Vec<String>>, D::Error> {
    command.deserialize_any(CommandVisitor).map(Some)
}

struct CommandVisitor;

impl<'de> Visitor<'de> for CommandVisitor {
    type Value = Vec<String>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a list of the program and its arguments")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<String>, A::Error> {
        let mut words = Vec::new();
        while let Some(word) = list.next_element()? {
            words.push(word);
        }
        Ok(words)
    }

    fn visit_str<E: Error>(self, line: &str) -> Result<Vec<String>, E> {
        let words: Vec<&str> = line.split_whitespace().collect();
        Err(E::custom(format!(
            "must be a list of the program and its arguments, as in `command = {words:?}`"
        )))
    }
}

/// The JSON schema of controller files.
#[cfg(feature = "schema")]
#[must_use]
pub fn controller_file_schema() -> serde_json::Value {
    schemars::schema_for!(ControllerFile).to_value()
}

/// An error of a controller file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControllerFileError {
    /// The file cannot be read or parsed, or has an invalid field.
    #[error(transparent)]
    File(#[from] FileError),
    /// An unusable policy.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// An unusable network.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// An unusable command.
    #[error("{0}")]
    Command(InvalidMapping),
    /// A program that the user did not name.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// An unusable FMU.
    #[error("{path}: {problem}")]
    Fmu {
        /// File of the FMU.
        path: String,
        /// Reason.
        #[source]
        problem: FmuProblem,
    },
    /// A network or an FMU that needs a controller file.
    #[error("{path}: {invalid}")]
    NeedsMapping {
        /// Path of the network or FMU.
        path: String,
        /// Mismatch with the default mapping.
        invalid: InvalidMapping,
    },
    /// A model with normalised observations whose normalisation is not stated.
    #[error(
        "{path}: {reason}: write a controller file whose inputs have the means as offsets and the deviations as \
         scales, and that says `normalised = true`, or `false` if observations were left alone (docs/controllers.md)"
    )]
    Normalised {
        /// File of the model.
        path: String,
        /// Evidence of the normalisation.
        reason: String,
    },
}

/// Reads a controller without starting a program; runs start it. `named_by` states the origin of the path.
///
/// The extension decides: `.onnx` is a network, `.zip` a Stable-Baselines3 model, `.fmu` an FMU, `.toml` a controller
/// file. Any other file is a Stable-Baselines3 model if it begins as a zip archive, and a policy otherwise.
///
/// # Errors
/// [`ControllerFileError`] if there is no such file, it holds no usable controller, or its program may not be started.
pub fn load(
    path: &Path,
    named_by: NameOrigin,
) -> Result<Arc<dyn ControllerSource>, ControllerFileError> {
    if path
        .extension()
        .is_some_and(|extension| extension == "toml")
    {
        load_controller_file(path, named_by)
    } else if path.extension().is_some_and(|extension| extension == "fmu") {
        load_fmu(path, named_by)
    } else if NetworkFile::is_network(path) {
        load_network(path)
    } else {
        Ok(Arc::new(PolicySource::new(Arc::new(Policy::load(path)?))))
    }
}

/// Returns the controller file and its network, with names under which they load as the same controller.
///
/// # Errors
/// None in practice; passes on the error of the serializer.
pub fn to_files(
    controller: &NetworkController,
) -> Result<[(String, Vec<u8>); 2], toml::ser::Error> {
    let Mapping {
        decision_interval_s,
        history,
        history_padding,
        newest_first,
        inputs,
        output,
    } = controller.mapping().clone();
    let (network, bytes) = controller.network_file().name_and_bytes();
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
    Ok([
        (file_name(controller), toml::to_string(&file)?.into_bytes()),
        (network, bytes.to_vec()),
    ])
}

/// Returns the name that [`to_files`] gives the controller file.
#[must_use]
pub fn file_name(controller: &NetworkController) -> String {
    let identity = controller.sha256();
    format!("{}.toml", identity.get(..16).unwrap_or(identity))
}

/// Returns true for a regular file: reading a device or a pipe may never end.
pub(crate) fn is_regular_file(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|metadata| metadata.is_file())
}

/// Loads a network without controller file, with the mapping of crumple's own policies.
fn load_network(path: &Path) -> Result<Arc<dyn ControllerSource>, ControllerFileError> {
    let file = NetworkFile::load(path)?;
    if let Some(reason) = normalisation_evidence(&file, path) {
        return Err(ControllerFileError::Normalised {
            path: path.display().to_string(),
            reason,
        });
    }
    let controller = NetworkController::with_native_mapping(file).map_err(|invalid| {
        ControllerFileError::NeedsMapping {
            path: path.display().to_string(),
            invalid,
        }
    })?;
    // Keeps `normalised = false` from the statistics file, which a copy elsewhere would lack.
    let is_behind = controller
        .network_file()
        .saved_model()
        .is_some_and(|saved| saved.vec_normalize == VecNormalizeUse::Behind);
    Ok(Arc::new(
        controller
            .with_normalised(is_behind.then_some(false))
            .with_source_file(SourceFile::binary(path)),
    ))
}

fn matches_saved_statistics(mapping: &Mapping, path: &Path) -> bool {
    /// Files often hold seven digits.
    const TOLERANCE: f64 = 1e-5;
    let Some(VecNormalizeStats::Observations(statistics)) =
        VecNormalizeStats::find_for_model(path).map(|file| VecNormalizeStats::load(&file))
    else {
        return false;
    };
    let limit = statistics.limit;
    let columns = statistics.means.iter().zip(&statistics.deviations);
    let mut pairs = mapping
        .inputs
        .iter()
        .zip(columns)
        .flat_map(|(input, (&mean, &deviation))| {
            [
                [input.offset, mean],
                [input.scale, deviation],
                [input.low, -limit],
                [input.high, limit],
            ]
        });
    statistics.means.len() == mapping.inputs.len()
        && pairs
            .all(|[stated, saved]| (stated - saved).abs() <= TOLERANCE * saved.abs().max(TOLERANCE))
}

/// Returns the evidence that observations were normalised in training: the model itself, or a statistics file beside
/// it.
fn normalisation_evidence(file: &NetworkFile, path: &Path) -> Option<String> {
    let trace = file.saved_model()?.vec_normalize;
    if trace == VecNormalizeUse::None {
        return None;
    }
    let statistics = VecNormalizeStats::find_for_model(path);
    if statistics
        .as_deref()
        .is_some_and(|file| VecNormalizeStats::load(file) == VecNormalizeStats::RewardsOnly)
    {
        return None;
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let statistics = statistics.map(|file| {
        let name = file.strip_prefix(folder).unwrap_or(&file);
        name.display().to_string()
    });
    match (trace, statistics) {
        (VecNormalizeUse::Behind, Some(statistics)) => Some(format!(
            "its data shows that it was trained with VecNormalize (`{statistics}` seems to contain the statistics)"
        )),
        (VecNormalizeUse::Behind, None) => {
            Some("its data shows that it was trained with VecNormalize".to_owned())
        }
        (_, Some(statistics)) => Some(format!(
            "`{statistics}` is in the same folder, so its observations were normalised in training"
        )),
        (_, None) => None,
    }
}

fn load_controller_file(
    path: &Path,
    named_by: NameOrigin,
) -> Result<Arc<dyn ControllerSource>, ControllerFileError> {
    let text = read(path)?;
    let file: ControllerFile = parse_toml(&text, path)?;
    let wrong =
        |InvalidMapping { field, problem }| FileError::from_field(path, &text, &field, problem);
    check_version(file.version, CONTROLLER_FILE_VERSION)
        .map_err(|unsupported| wrong(InvalidMapping::new("version", unsupported.to_string())))?;
    let folder = path.with_file_name("");
    let source_file = SourceFile::controller_file(path, &text);
    let source = file.controller_source().map_err(wrong)?;
    let field = source.field();
    let setup = match source {
        ControllerFileSource::BuiltIn(name) => {
            return Ok(Arc::new(file.built_in_controller(&name).map_err(wrong)?));
        }
        ControllerFileSource::Network(name) => {
            let controller = file
                .into_network_controller(&folder.join(name))
                .map_err(wrong)?;
            return Ok(Arc::new(controller.with_source_file(source_file)));
        }
        ControllerFileSource::Fmu(name) => {
            let setup = ProcessSetup::from_fmu(&folder, &name, file.wiring());
            let fmu_path = folder.join(&name);
            let setup = setup.map_err(|problem| match problem {
                FmuProblem::Mapping(invalid) => wrong(invalid).into(),
                FmuProblem::ProcessFeatureDisabled => fmu_error(&fmu_path, problem),
                _ => wrong(InvalidMapping::new("fmu", problem.describe(&fmu_path))).into(),
            })?;
            file.with_limits(setup)
        }
        ControllerFileSource::Command(command) => file.into_process_setup(command, &folder),
    };
    let permission = named_by
        .permission(|| format!("{}:{}: {field}", path.display(), line_in_toml(&text, field)))?;
    process_controller(setup, source_file, permission).map_err(|invalid| wrong(invalid).into())
}

fn process_controller(
    setup: ProcessSetup,
    file: SourceFile,
    permission: StartPermission,
) -> Result<Arc<dyn ControllerSource>, InvalidMapping> {
    let setup = ProcessSetup {
        file: Some(file),
        ..setup
    };
    Ok(Arc::new(ProcessController::new(setup, permission)?))
}

/// Loads an FMU without controller file; its variables must have the names of the inputs.
fn load_fmu(
    path: &Path,
    named_by: NameOrigin,
) -> Result<Arc<dyn ControllerSource>, ControllerFileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let setup = ProcessSetup::from_fmu(&path.with_file_name(""), &name, FmuConfig::default())
        .map_err(|problem| fmu_error(path, problem))?;
    let permission = named_by.permission(|| path.display().to_string())?;
    process_controller(setup, SourceFile::binary(path), permission)
        .map_err(|invalid| fmu_error(path, invalid.into()))
}

/// Returns the error of an FMU; a mapping is a problem of an FMU without controller file.
fn fmu_error(path: &Path, problem: FmuProblem) -> ControllerFileError {
    let path = path.display().to_string();
    match problem {
        FmuProblem::Mapping(invalid) => ControllerFileError::NeedsMapping { path, invalid },
        problem => ControllerFileError::Fmu { path, problem },
    }
}

#[derive(PartialEq)]
enum ControllerFileSource {
    BuiltIn(String),
    Network(String),
    Fmu(String),
    Command(Vec<String>),
}

impl ControllerFileSource {
    /// Returns the field of a controller file that states the source.
    fn field(&self) -> &'static str {
        match self {
            Self::BuiltIn(_) => "built_in",
            Self::Network(_) => "network",
            Self::Fmu(_) => "fmu",
            Self::Command(_) => "command",
        }
    }

    fn description(&self) -> &'static str {
        match self {
            Self::BuiltIn(_) => "a built-in controller",
            Self::Network(_) => "a network",
            Self::Fmu(_) => "an FMU",
            Self::Command(_) => "a command",
        }
    }
}

impl ControllerFile {
    /// Returns the source, unless a field belongs to another source.
    fn controller_source(&self) -> Result<ControllerFileSource, InvalidMapping> {
        let built_in = self.built_in.clone().map(ControllerFileSource::BuiltIn);
        let network = self.network.clone().map(ControllerFileSource::Network);
        let fmu = self.fmu.clone().map(ControllerFileSource::Fmu);
        let command = self.command.clone().map(ControllerFileSource::Command);
        let mut stated = [built_in, network, fmu, command].into_iter().flatten();
        let Some(source) = stated.next() else {
            let problem = "one of `built_in`, `network`, `fmu` and `command` is required";
            return Err(InvalidMapping::new("version", problem));
        };
        if let Some(second) = stated.next() {
            let field = source.field();
            return Err(InvalidMapping::new(
                second.field(),
                format!("`{field}` is given already: keep one of them"),
            ));
        }
        match self.misplaced_field(&source) {
            Some(field) => {
                let problem = format!("is not for {}", source.description());
                Err(InvalidMapping::new(field, problem))
            }
            None => Ok(source),
        }
    }

    /// Returns the first field that belongs to another source.
    fn misplaced_field(&self, source: &ControllerFileSource) -> Option<String> {
        use ControllerFileSource as Source;
        let is_built_in = matches!(source, Source::BuiltIn(_));
        let is_network = matches!(source, Source::Network(_));
        let is_fmu = matches!(source, Source::Fmu(_));
        let is_program = !is_built_in && !is_network;
        let has_history = !is_built_in && !is_fmu;
        let inputs = self.inputs.iter().flatten();
        let input = inputs
            .into_iter()
            .position(|input| input.variable.is_some());
        let output = self
            .output
            .as_ref()
            .is_some_and(|output| output.variable.is_some());
        let variable = format!("inputs[{}].variable", input.unwrap_or_default());
        let fields = [
            ("settings", !self.settings.is_empty() && !is_built_in),
            ("files", !self.files.is_empty() && (is_fmu || !is_program)),
            ("deterministic", self.deterministic.is_some() && !is_program),
            (
                "start_within_s",
                self.start_within_s.is_some() && !is_program,
            ),
            (
                "answer_within_s",
                self.answer_within_s.is_some() && !is_program,
            ),
            (
                "decision_interval_s",
                self.decision_interval_s.is_some() && is_built_in,
            ),
            ("inputs", self.inputs.is_some() && is_built_in),
            ("output", self.output.is_some() && is_built_in),
            ("history", self.history != default_history() && !has_history),
            (
                "history_padding",
                !self.history_padding.is_default() && !has_history,
            ),
            ("newest_first", self.newest_first && !has_history),
            ("normalised", self.normalised.is_some() && !is_network),
            ("parameters", !self.parameters.is_empty() && !is_fmu),
            (variable.as_str(), input.is_some() && !is_fmu),
            ("output.variable", output && !is_fmu),
            ("warning", self.warning.is_some() && !is_fmu),
        ];
        let misplaced = fields.into_iter().find(|(_, is_misplaced)| *is_misplaced);
        misplaced.map(|(field, _)| field.to_owned())
    }

    /// Returns the built-in controller of that name with the settings of this file.
    fn built_in_controller(&self, name: &str) -> Result<BuiltInController, InvalidMapping> {
        if BuiltInController::from_name(name).is_none() {
            let problem = format!("there is no built-in controller `{name}`");
            return Err(InvalidMapping::new("built_in", problem));
        }
        let mut text = name.to_owned();
        for (setting, value) in &self.settings {
            let setting_text = format!(",{setting}={value}");
            if let Some(Err(invalid)) = BuiltInController::parse(&format!("{name}{setting_text}")) {
                let field = format!("settings.{setting}");
                return Err(InvalidMapping::new(field, invalid.to_string()));
            }
            text += &setting_text;
        }
        match BuiltInController::parse(&text) {
            Some(Ok(controller)) => Ok(controller),
            other => {
                let problem = other
                    .and_then(Result::err)
                    .map_or_else(String::new, |invalid| invalid.to_string());
                Err(InvalidMapping::new("settings", problem))
            }
        }
    }

    /// Loads the network in the file `path`, and gives it the mapping of this file.
    fn into_network_controller(self, path: &Path) -> Result<NetworkController, InvalidMapping> {
        let normalised = self.normalised;
        let mapping = self.into_network_mapping()?;
        mapping.check()?;
        let network = NetworkFile::load(path).map_err(|error| {
            let problem = match &error {
                NetworkError::Read { source, .. } if source.kind() == ErrorKind::NotFound => {
                    format!("there is no file {}", path.display())
                }
                error => error.to_string(),
            };
            InvalidMapping::new("network", problem)
        })?;
        if normalised.is_none()
            && !matches_saved_statistics(&mapping, path)
            && let Some(reason) = normalisation_evidence(&network, path)
        {
            let problem = format!(
                "is missing: {}: {reason}; say `true` once the inputs have the means as offsets and the \
                 deviations as scales, or `false` if observations were left alone (docs/controllers.md)",
                path.display()
            );
            return Err(InvalidMapping::new("normalised", problem));
        }
        Ok(NetworkController::new(network, mapping)?.with_normalised(normalised))
    }

    /// Returns the mapping of a network, whose fields are all required.
    fn into_network_mapping(self) -> Result<Mapping, InvalidMapping> {
        let decision_interval_s = require(self.decision_interval_s, "decision_interval_s")?;
        Ok(Mapping {
            decision_interval_s: Some(decision_interval_s),
            history: self.history,
            history_padding: self.history_padding,
            newest_first: self.newest_first,
            inputs: require(self.inputs, "inputs")?,
            output: require(self.output, "output")?,
        })
    }

    fn wiring(&self) -> FmuConfig {
        let Self {
            inputs,
            output,
            warning,
            parameters,
            decision_interval_s,
            ..
        } = self.clone();
        FmuConfig {
            inputs,
            output,
            warning,
            parameters,
            decision_interval_s,
        }
    }

    /// Returns a setup with the limits that the file states in place of the default ones.
    fn with_limits(&self, plain: ProcessSetup) -> ProcessSetup {
        ProcessSetup {
            deterministic: self.deterministic.unwrap_or(plain.deterministic),
            start_within_s: self.start_within_s.unwrap_or(plain.start_within_s),
            answer_within_s: self.answer_within_s.unwrap_or(plain.answer_within_s),
            ..plain
        }
    }

    fn into_process_setup(self, command: Vec<String>, folder: &Path) -> ProcessSetup {
        let plain = self.with_limits(ProcessSetup::new(command, folder));
        ProcessSetup {
            files: self.files,
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

/// Returns the value of a field that a network needs.
fn require<T>(value: Option<T>, field: &str) -> Result<T, InvalidMapping> {
    value.ok_or_else(|| InvalidMapping::new(field, "is missing, and a network needs it"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error for a text or a number where a list is required shows the list.
    #[test]
    fn errors_show_how_a_list_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("aeb.toml");
        for (line, expected) in [
            (
                "command = \"./aeb --fast\"",
                "command: must be a list of the program and its arguments, as in `command = [\"./aeb\", \"--fast\"]`",
            ),
            (
                "command = 5",
                "command: invalid type: integer `5`, expected a list of the program and its arguments",
            ),
            (
                "command = [\"./aeb\", 5]",
                "command[1]: invalid type: integer `5`, expected a string",
            ),
            (
                "command = [\"./aeb\"]\nfiles = \"aeb\"",
                "files: must be a list in square brackets, as in `[\"aeb\"]`",
            ),
            (
                "network = [\"a.onnx\"]",
                "network: must be one text in quotation marks, not a list",
            ),
        ] {
            fs::write(&path, format!("version = 1\n{line}\n")).unwrap();
            let error = load(&path, NameOrigin::User).unwrap_err();
            let number = 1 + line.lines().count();
            assert_eq!(
                error.to_string(),
                format!("{}:{number}: {expected}", path.display())
            );
        }
    }
}
