//! Description of an imported network, as text and as JSON.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::{
    NetworkFile, NetworkFormat, NetworkStep, Normalisation, SavedModel, VecNormalizeStats,
    VecNormalizeUse,
};
use crumple_core::quoting::TerminalText;

/// Statistics of `VecNormalize` that a search beside a model found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FoundStatistics {
    /// File that seems to contain the statistics.
    pub path: Option<PathBuf>,
    /// Normalisation of observations in that file.
    pub normalisation: Option<Normalisation>,
}

impl FoundStatistics {
    /// Searches for the statistics of a network, if it is a model of Stable-Baselines3.
    #[must_use]
    pub fn find(network: &NetworkFile, path: &Path) -> Self {
        if network.saved_model().is_none() {
            return Self::default();
        }
        let statistics = VecNormalizeStats::find_for_model(path);
        let normalisation = match statistics.as_deref().map(VecNormalizeStats::load) {
            Some(VecNormalizeStats::Observations(normalisation)) => Some(normalisation),
            _ => None,
        };
        Self {
            path: statistics,
            normalisation,
        }
    }
}

/// Description of an imported network, with a controller file for it.
#[derive(Debug, Serialize)]
pub struct NetworkDescription {
    /// Path of the network.
    pub file: String,
    /// Format of the file.
    pub format: NetworkFormat,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Widths of the layers.
    pub layers: String,
    /// Names of the elementwise operators.
    pub functions: Vec<String>,
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// Bounds that the network itself sets for each output; `None` without a bound.
    pub output_bounds: Vec<[Option<f64>; 2]>,
    /// Algorithm, version, bounds of observations and actions (`None` without a bound) and `VecNormalize` of
    /// Stable-Baselines3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<SavedModelDescription>,
    /// True if the network needs no controller file.
    pub drives_as_it_is: bool,
    /// Controller file to begin with.
    pub controller_file: String,
}

/// Description of a model of Stable-Baselines3.
#[derive(Debug, Serialize)]
pub struct SavedModelDescription {
    /// Algorithm of the training.
    pub algorithm: &'static str,
    /// Version of Stable-Baselines3.
    pub version: Option<String>,
    /// Bounds of the observations.
    pub observations: Vec<[Option<f32>; 2]>,
    /// Bounds of the actions.
    pub actions: Vec<[Option<f32>; 2]>,
    /// Use of `VecNormalize` in the training.
    pub vec_normalize: VecNormalizeUse,
    /// File that seems to contain the statistics.
    pub statistics: Option<String>,
    /// Normalisation of observations in that file.
    pub normalisation: Option<Normalisation>,
}

impl NetworkDescription {
    /// Describes a network that was read from `file`. `controller_file` is the text of a file for it.
    #[must_use]
    pub fn new(
        file: String,
        network: &NetworkFile,
        statistics: FoundStatistics,
        drives_as_it_is: bool,
        controller_file: String,
    ) -> Self {
        let layers = &network.network;
        let model = network.saved_model();
        Self {
            file,
            format: network.format(),
            sha256: network.sha256.clone(),
            layers: layers.shape(),
            functions: function_names(layers.steps()),
            inputs: layers.inputs(),
            outputs: layers.outputs(),
            output_bounds: layers
                .answer_bounds()
                .into_iter()
                .map(|bounds| bounds.map(|bound| Some(bound).filter(|bound| bound.is_finite())))
                .collect(),
            model: model.map(|model| SavedModelDescription::new(model, statistics)),
            drives_as_it_is,
            controller_file,
        }
    }

    /// Returns the controller file, after comments with the description.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut lines = vec![format!(
            "{}: layers {}, {}",
            self.file,
            self.layers,
            self.functions.join(", ")
        )];
        if let Some(model) = &self.model {
            lines.extend(model.lines());
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
        let comments: String = lines
            .iter()
            .map(|line| format!("# {}\n", TerminalText(line)))
            .collect();
        comments + &self.controller_file
    }
}

impl SavedModelDescription {
    fn new(model: &SavedModel, statistics: FoundStatistics) -> Self {
        let observations = &model.observation_space;
        let actions = &model.action_space;
        Self {
            algorithm: model.algorithm,
            version: model.version.clone(),
            observations: finite_bounds(&observations.low, &observations.high),
            actions: finite_bounds(&actions.low, &actions.high),
            vec_normalize: model.vec_normalize,
            statistics: statistics.path.map(|path| path.display().to_string()),
            normalisation: statistics.normalisation,
        }
    }

    fn lines(&self) -> [String; 4] {
        let version = self.version.as_ref();
        let version = version.map(|version| format!(" {version}"));
        let usage = match self.vec_normalize {
            VecNormalizeUse::None => "not used in training, or it changed no observation",
            VecNormalizeUse::Behind => "used in training",
            VecNormalizeUse::Unknown => "unknown; the file does not state it",
        };
        let statistics = self.statistics.as_ref();
        let statistics =
            statistics.map(|path| format!("; `{path}` seems to contain the statistics"));
        [
            format!(
                "{}, saved by Stable-Baselines3{}",
                self.algorithm,
                version.unwrap_or_default()
            ),
            format!("observation_space: {}", format_bounds(&self.observations)),
            format!("action_space: {}", format_bounds(&self.actions)),
            format!("VecNormalize: {usage}{}", statistics.unwrap_or_default()),
        ]
    }
}

fn finite_bounds(low: &[f32], high: &[f32]) -> Vec<[Option<f32>; 2]> {
    low.iter()
        .zip(high)
        .map(|(low, high)| [*low, *high].map(|bound| Some(bound).filter(|bound| bound.is_finite())))
        .collect()
}

/// Returns the names of the elementwise operators, each once.
fn function_names(steps: &[NetworkStep]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for step in steps {
        let NetworkStep::Elementwise(operator) = step else {
            continue;
        };
        let name: String = format!("{operator:?}")
            .chars()
            .take_while(|letter| letter.is_alphanumeric())
            .collect();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Formats bounds: `2 numbers from -1 to 1`, or each separately.
fn format_bounds(bounds: &[[Option<f32>; 2]]) -> String {
    let noun = if bounds.len() == 1 {
        "number"
    } else {
        "numbers"
    };
    let ranges = match bounds.split_first() {
        Some((first, rest)) if rest.iter().all(|range| range == first) => format_range(first),
        _ => bounds
            .iter()
            .map(format_range)
            .collect::<Vec<_>>()
            .join(", "),
    };
    format!("{} {noun}, {ranges}", bounds.len())
}

fn format_range([low, high]: &[Option<f32>; 2]) -> String {
    format!(
        "{} to {}",
        format_end(*low, "-inf"),
        format_end(*high, "inf")
    )
}

fn format_end(bound: Option<f32>, infinite: &str) -> String {
    bound.map_or_else(|| infinite.to_owned(), |bound| bound.to_string())
}
