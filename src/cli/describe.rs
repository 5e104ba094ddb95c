//! `crumple describe`: metadata of external controller files. Starts no program and loads no library.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::error::is_caused_by_environment;
use super::output_format::OutputFormat;
use super::{CliError, describe_fmu, file_kind, output};
use crumple_controllers::controller_file::ControllerFileDraft;
use crumple_controllers::{Controllers, UnknownController};
use crumple_networks::network::{
    NetworkError, NetworkFile, NetworkFormat, NetworkStep, Normalisation, VecNormalizeStats,
    VecNormalizeUse,
};

/// Inspect an ONNX/SB3 network and print a starter controller file, or inspect an FMU
#[derive(Args)]
#[command(after_long_help = "\
The command starts no program and loads no library, whatever the file is. For an FMU it lists the variables of \
modelDescription.xml.

For a model of Stable-Baselines3 it prints the algorithm, the spaces of observations and actions, and whether the \
model was trained with VecNormalize; for any network it prints the layers. The output is a controller file that \
runs, with this information as comments. No file states which quantity each input is, in which order and unit: \
correct these guesses before you rely on a result. The controller file contains the path of the network as given \
here, relative to the folder of the controller file.

Examples:
  crumple describe ppo.zip
  crumple describe ppo.zip > ppo.toml
  crumple describe acc.onnx --format json
  crumple describe acc.fmu")]
pub(super) struct Describe {
    /// Network, F.onnx or F.zip of Stable-Baselines3, or FMU, F.fmu
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Output format: text (for a network, a controller file with comments), or one JSON object
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Serialize)]
struct NetworkDescription {
    file: String,
    format: NetworkFormat,
    sha256: String,
    layers: String,
    functions: Vec<String>,
    inputs: usize,
    answers: usize,
    /// Bounds that the network itself sets for each output; `None` without a bound.
    answer_bounds: Vec<[Option<f64>; 2]>,
    /// Algorithm, version, bounds of observations and actions (`None` without a bound) and `VecNormalize` of
    /// Stable-Baselines3.
    #[serde(skip_serializing_if = "Option::is_none")]
    model: Option<SavedModelDescription>,
    /// True if the network needs no controller file.
    drives_as_it_is: bool,
    controller_file: String,
}

#[derive(Serialize)]
struct SavedModelDescription {
    algorithm: &'static str,
    version: Option<String>,
    observations: Vec<[Option<f32>; 2]>,
    actions: Vec<[Option<f32>; 2]>,
    vec_normalize: VecNormalizeUse,
    /// File that seems to contain the statistics, and their normalisation of observations.
    statistics: Option<String>,
    normalisation: Option<Normalisation>,
}

impl Describe {
    pub(super) fn run(self) -> Result<(), CliError> {
        let place = &self.file;
        if place
            .extension()
            .is_some_and(|extension| extension == "fmu")
        {
            return describe_fmu::describe(place, self.format);
        }
        let network = NetworkFile::load(place).map_err(|error| self.not_a_network_error(&error))?;
        let statistics = network
            .saved_model()
            .and_then(|_| VecNormalizeStats::find_for_model(place));
        let normalisation = match statistics.as_deref().map(VecNormalizeStats::load) {
            Some(VecNormalizeStats::Observations(normalisation)) => Some(normalisation),
            _ => None,
        };
        let file = place.display().to_string();
        let drives_as_it_is = is_controller(place);
        let draft = ControllerFileDraft {
            path: &file,
            network: &network,
            normalisation: normalisation.as_ref(),
            drives_as_it_is,
        };
        let controller_file = draft.to_toml();
        let model = network.saved_model().map(|saved| SavedModelDescription {
            algorithm: saved.algorithm,
            version: saved.version.clone(),
            observations: finite_bounds(
                &saved.observation_space.low,
                &saved.observation_space.high,
            ),
            actions: finite_bounds(&saved.action_space.low, &saved.action_space.high),
            vec_normalize: saved.vec_normalize,
            statistics: statistics.map(|path| path.display().to_string()),
            normalisation,
        });
        let description = NetworkDescription {
            file,
            format: network.format(),
            sha256: network.sha256.clone(),
            layers: network.network.shape(),
            functions: activation_names(network.network.steps()),
            inputs: network.network.inputs(),
            answers: network.network.outputs(),
            answer_bounds: without_infinities(network.network.answer_bounds()),
            model,
            drives_as_it_is,
            controller_file,
        };
        let words = || format!("{}{}", description.comments(), description.controller_file);
        output::print_result(self.format, &description, words)
    }

    /// Returns the error for a file that is not a network, with a note if crumple can drive with it directly.
    fn not_a_network_error(&self, error: &NetworkError) -> CliError {
        let place = self.file.display();
        let names_no_network = !NetworkFile::is_network(&self.file);
        match file_kind::detect(&self.file) {
            Some(what) => {
                CliError::Input(format!("{place}: is not an imported network, but {what}"))
            }
            None if names_no_network && is_controller(&self.file) => CliError::Input(format!(
                "{place}: is not an imported network, but a controller: use it with --controller of other commands"
            )),
            None if names_no_network => CliError::Input(format!(
                "{place}: `describe` takes a network (.onnx, or .zip for a model of Stable-Baselines3) or an FMU (.fmu)"
            )),
            None if is_caused_by_environment(error) => CliError::Environment(error.to_string()),
            None => CliError::input(error),
        }
    }
}

/// Returns true if the file is a controller. A program counts, and is not started.
fn is_controller(file: &Path) -> bool {
    let found = Controllers::default().find(&file.to_string_lossy(), Path::new(""));
    matches!(found, Ok(_) | Err(UnknownController::StartRefused(_)))
}

fn finite_bounds(low: &[f32], high: &[f32]) -> Vec<[Option<f32>; 2]> {
    low.iter()
        .zip(high)
        .map(|(low, high)| [*low, *high].map(|bound| Some(bound).filter(|bound| bound.is_finite())))
        .collect()
}

fn without_infinities(bounds: Vec<[f64; 2]>) -> Vec<[Option<f64>; 2]> {
    bounds
        .into_iter()
        .map(|pair| pair.map(|bound| Some(bound).filter(|bound| bound.is_finite())))
        .collect()
}

fn activation_names(steps: &[NetworkStep]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for step in steps {
        if let NetworkStep::Elementwise(each) = step {
            let name: String = format!("{each:?}")
                .chars()
                .take_while(|letter| letter.is_alphanumeric())
                .collect();
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    names
}

/// Formats bounds: `2 numbers from -1 to 1`, or each separately.
fn format_bounds(bounds: &[[Option<f32>; 2]]) -> String {
    let one = |[low, high]: &[Option<f32>; 2]| {
        let end = |bound: &Option<f32>, open: &str| {
            bound.map_or_else(|| open.to_owned(), |bound| bound.to_string())
        };
        format!("{} to {}", end(low, "-inf"), end(high, "inf"))
    };
    let noun = if bounds.len() == 1 {
        "number"
    } else {
        "numbers"
    };
    let ranges = match bounds.split_first() {
        Some((first, rest)) if rest.iter().all(|other| other == first) => one(first),
        _ => bounds.iter().map(one).collect::<Vec<_>>().join(", "),
    };
    format!("{} {noun}, {ranges}", bounds.len())
}

impl NetworkDescription {
    fn comments(&self) -> String {
        let mut lines = vec![format!(
            "{}: layers {}, {}",
            self.file,
            self.layers,
            self.functions.join(", ")
        )];
        if let Some(model) = &self.model {
            let version = model
                .version
                .as_ref()
                .map(|version| format!(" {version}"))
                .unwrap_or_default();
            lines.push(format!(
                "{}, saved by Stable-Baselines3{version}",
                model.algorithm
            ));
            lines.push(format!(
                "observation_space: {}",
                format_bounds(&model.observations)
            ));
            lines.push(format!("action_space: {}", format_bounds(&model.actions)));
            let trace = match model.vec_normalize {
                VecNormalizeUse::None => "not used in training, or it changed no observation",
                VecNormalizeUse::Behind => "used in training",
                _ => "unknown; the file does not state it",
            };
            let statistics = model
                .statistics
                .as_ref()
                .map(|path| format!("; `{path}` seems to contain the statistics"));
            lines.push(format!(
                "VecNormalize: {trace}{}",
                statistics.unwrap_or_default()
            ));
        }
        if self.drives_as_it_is {
            lines.push(
                "The network needs no controller file if it has the inputs and outputs of crumple's own policies."
                    .to_owned(),
            );
        }
        lines.push(
            "The quantity, order and unit of the inputs are guesses: correct them (docs/controllers.md).".to_owned(),
        );
        lines
            .iter()
            .map(|line| format!("# {}\n", line.escape_debug()))
            .collect()
    }
}
