//! `crumple describe`: metadata of external controller files. Starts no program and loads no library.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::error::is_caused_by_environment;
use super::simulate::OutputFormat;
use super::{CliError, describe_fmu, file_kind, output};
use crumple_world::control::{Mapping, ObservedQuantity, OutputMapping};
use crumple_world::network::{
    NetworkError, NetworkFile, NetworkFormat, NetworkStep, Normalisation, SavedModel,
    VecNormalizeStats, VecNormalizeUse,
};
use crumple_world::sim::{NamedController, UnknownController};

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

/// Default quantities of the inputs, in this order.
const DEFAULT_QUANTITIES: [ObservedQuantity; 6] = [
    ObservedQuantity::GapAheadM,
    ObservedQuantity::SpeedMps,
    ObservedQuantity::RelativeSpeedAheadMps,
    ObservedQuantity::AccelerationMps2,
    ObservedQuantity::SpeedAheadMps,
    ObservedQuantity::AccelerationAheadMps2,
];

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
        let is_named = is_controller(place);
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
        let mut description = NetworkDescription {
            file: place.display().to_string(),
            format: network.format(),
            sha256: network.sha256.clone(),
            layers: network.network.shape(),
            functions: activation_names(network.network.steps()),
            inputs: network.network.inputs(),
            answers: network.network.outputs(),
            answer_bounds: without_infinities(network.network.answer_bounds()),
            model,
            drives_as_it_is: is_named,
            controller_file: String::new(),
        };
        description.controller_file = description.draft_controller_file(network.saved_model());
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
    let found = NamedController::find(&file.to_string_lossy(), Path::new(""));
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

    /// Returns a controller file that can be loaded.
    fn draft_controller_file(&self, saved: Option<&SavedModel>) -> String {
        let own = Mapping::native();
        let model = self.model.as_ref();
        let normalisation = model.and_then(|model| model.normalisation.as_ref());
        // A JSON string is also a valid TOML string.
        let path = serde_json::Value::from(self.file.as_str());
        let mut text =
            format!("version = 1\nnetwork = {path}\ndecision_interval_s = 0.1 # as in training\n");
        let is_normalised = normalisation.is_some_and(|found| found.means.len() == self.inputs);
        if is_normalised {
            text += "normalised = true # the inputs contain the statistics\n";
        } else if saved.is_some_and(|saved| saved.vec_normalize == VecNormalizeUse::Behind) {
            // No default: crumple refuses the file until the user decides.
            text += "# Write normalised = true when the inputs contain means and deviations, or false if VecNormalize \
                     changed no observation.\n";
        }
        for index in 0..self.inputs {
            let own = own.inputs.get(index).filter(|_| self.drives_as_it_is);
            let quantity = own
                .and_then(|own| own.quantity)
                .unwrap_or(DEFAULT_QUANTITIES[index % DEFAULT_QUANTITIES.len()]);
            text += &format!(
                "\n[[inputs]]\nquantity = \"{}\" # a guess\n",
                quantity.name()
            );
            let (mut offset, mut scale) = own.map_or((0.0, 1.0), |own| (own.offset, own.scale));
            let bounds = model
                .and_then(|model| model.observations.get(index))
                .copied()
                .unwrap_or_default();
            let [mut low, mut high] = bounds.map(|bound| bound.map(f64::from));
            if let Some(found) = normalisation.filter(|_| is_normalised) {
                (offset, scale) = (found.means[index], found.deviations[index]);
                (low, high) = (Some(-found.limit), Some(found.limit));
            }
            text += &format!("offset = {offset:?}\nscale = {scale:?}\n");
            text += &low
                .map(|low| format!("low = {low:?}\n"))
                .unwrap_or_default();
            text += &high
                .map(|high| format!("high = {high:?}\n"))
                .unwrap_or_default();
        }
        text += "\n[output]\n";
        if self.answers > 1 {
            text += "answer = 0 # index of the output that is the acceleration, a guess\n";
        }
        text + &self.output_section(&own.output)
    }

    /// Returns the rest of `[output]`. A network that limits its outputs itself, as by a final tanh, needs a scale to
    /// m/s².
    fn output_section(&self, own: &OutputMapping) -> String {
        let [least_mps2, most_mps2] = [own.low_mps2, own.high_mps2];
        let limits = format!("low_mps2 = {least_mps2:?}\nhigh_mps2 = {most_mps2:?}\n");
        // The action space is wider than the network's range if the network clips the mean before tanh.
        let actions = self.model.as_ref().and_then(|model| model.actions.first());
        let actions = actions.map(|bounds| bounds.map(|bound| bound.map(f64::from)));
        match actions.as_ref().or(self.answer_bounds.first()) {
            // These bounds look like accelerations.
            Some([Some(low), Some(high)]) if *low < -1.5 && *high <= 10.0 && low < high => {
                format!(
                    "# The limits of the network's outputs are assumed to be in m/s², a guess. Otherwise add \
                     scale_mps2 and offset_mps2.\nlow_mps2 = {low:?}\nhigh_mps2 = {high:?}\n"
                )
            }
            Some([Some(low), Some(high)]) if low < high => {
                let scale_mps2 = (most_mps2 - least_mps2) / (high - low);
                let offset_mps2 = least_mps2 - scale_mps2 * low;
                format!(
                    "# The network itself limits its outputs to {low:?} to {high:?}: scale_mps2 and offset_mps2 \
                     turn\n# them into m/s². Do not add `squash`: it is for a tanh outside the network.\nscale_mps2 = \
                     {scale_mps2:?} # a guess: the limits of a light vehicle\noffset_mps2 = {offset_mps2:?}\n{limits}"
                )
            }
            _ if self.drives_as_it_is => {
                let OutputMapping {
                    scale_mps2,
                    offset_mps2,
                    ..
                } = own;
                format!("scale_mps2 = {scale_mps2:?}\noffset_mps2 = {offset_mps2:?}\n{limits}")
            }
            _ => format!(
                "# The network does not limit its outputs, so they are assumed to be in m/s². If training applied tanh \
                 to them, write\n# squash = \"tanh\" and the scale_mps2 and offset_mps2 that turn -1 to 1 into \
                 m/s².\n{limits}"
            ),
        }
    }
}
