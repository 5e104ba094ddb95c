//! Training spaces by name, file or blend.

use std::sync::Arc;

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::config_error::{TrainingConfigError, check_range};
use super::source::{PaperSource, ScenarioSource, unsuitability};
use crumple_world::random::{self, Purpose};
use crumple_world::scenario::space::{ScenarioSpace, find_space};
use crumple_world::scenario::{InvalidField, Scenario};

/// Most times that costs count.
const MAX_COST_MULTIPLIER: f64 = 1e4;

/// Least and most weight of a space.
const WEIGHT_RANGE: [f64; 2] = [1e-6, 1e6];

/// Weights of one space would add up where somebody may have meant the last to count, and `costs_times` could contradict itself.
const ONE_WEIGHT_HINT: &str = "give it one weight";

/// Most spaces of a blend.
const MAX_SPACES: usize = 32;

/// One space of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TrainingSpace {
    /// A built-in space, or a space file: from the folder that `crumple` runs in.
    pub space: String,
    /// How many of the episodes are drawn from it, relative to the weights of the others.
    pub weight: f64,
    /// How many times their weights the costs of a step count in its episodes: more where nothing is to be gained by paying them.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[serde(rename = "costs_times")]
    pub cost_multiplier: f64,
}

fn one() -> f64 {
    1.0
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_one(times: &f64) -> bool {
    *times == 1.0
}

/// Draws of several spaces by turns.
#[derive(Debug, Clone)]
pub struct SpaceMixture {
    components: Vec<SpaceComponent>,
}

#[derive(Debug, Clone)]
struct SpaceComponent {
    space: ScenarioSpace,
    share: f64,
    /// Sum of the shares up to this one.
    cumulative_share: f64,
    cost_multiplier: f64,
}

/// Sets the stream of the turns apart from those of other mixtures.
const COMPONENT_SEED_INDEX: u64 = u64::MAX - 3;

impl SpaceMixture {
    /// The spaces of a configuration, each in proportion to its weight.
    ///
    /// # Errors
    /// [`ConfigError`] if a space is unknown, cannot be read, holds what the agent cannot be trained on or is named twice, or a weight
    /// is no positive number.
    pub fn new(shares: &[TrainingSpace]) -> Result<Self, TrainingConfigError> {
        check_spaces(shares)?;
        let total: f64 = shares.iter().map(|share| share.weight).sum();
        let (mut parts, mut below) = (Vec::<SpaceComponent>::new(), 0.0);
        for (index, TrainingSpace { space: name, weight, cost_multiplier: costs_times }) in shares.iter().enumerate() {
            let problem =
                |problem: String| TrainingConfigError::Field { field: format!("spaces[{index}].space"), problem };
            let space = find_space(name).map_err(|error| problem(error.to_string()))?;
            let first = space.draw(0, 0).map_err(|error| problem(format!("`{name}` cannot be drawn from: {error}")))?;
            if let Some(reason) = unsuitability(&first) {
                return Err(problem(format!("`{name}` cannot be trained on: {reason}")));
            }
            // One space under the names of two files is one space.
            if let Some(same) = parts.iter().position(|part| part.space.spec() == space.spec()) {
                return Err(problem(format!("`{name}` is the space of spaces[{same}]: {ONE_WEIGHT_HINT}")));
            }
            let share = weight / total;
            below += share;
            parts.push(SpaceComponent { space, share, cumulative_share: below, cost_multiplier: *costs_times });
        }
        Ok(Self { components: parts })
    }

    /// Its spaces.
    pub fn spaces(&self) -> impl Iterator<Item = &ScenarioSpace> {
        self.components.iter().map(|part| &part.space)
    }
}

impl SpaceMixture {
    /// Whose turn it is; none only where there are no spaces.
    fn component_for(&self, seed: u64, index: u64) -> Option<&SpaceComponent> {
        let mut stream =
            random::stream(random::derived_seed(seed, COMPONENT_SEED_INDEX), Purpose::ScenarioSampling, index);
        let turn = stream.random::<f64>();
        // Shares add up to 1 but for rounding: the last one takes what is left.
        self.components.iter().find(|part| turn < part.cumulative_share).or(self.components.last())
    }
}

impl ScenarioSource for SpaceMixture {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        match self.component_for(seed, index) {
            Some(part) => part.space.draw(seed, index),
            None => PaperSource.draw(seed, index),
        }
    }

    fn cost_multiplier(&self, seed: u64, index: u64) -> f64 {
        self.component_for(seed, index).map_or(1.0, |part| part.cost_multiplier)
    }

    fn max_cost_multiplier(&self) -> f64 {
        self.components.iter().fold(1.0, |most, part| most.max(part.cost_multiplier))
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        let named = self.components.iter().map(|part| {
            let name = part.space.identity()?.unwrap_or_default();
            let costs = if is_one(&part.cost_multiplier) {
                String::new()
            } else {
                format!(", whose costs count {} times", part.cost_multiplier)
            };
            Ok(format!("a share of {} of {name}{costs}", part.share))
        });
        Ok(Some(named.collect::<Result<Vec<_>, serde_json::Error>>()?.join(", ")))
    }
}

/// Whether shares are in their ranges and each of another space, as far as can be told without reading a file.
pub(super) fn check_spaces(shares: &[TrainingSpace]) -> Result<(), TrainingConfigError> {
    if shares.len() > MAX_SPACES {
        let problem = format!("{MAX_SPACES} are the most, found {}", shares.len());
        return Err(TrainingConfigError::Field { field: "spaces".to_owned(), problem });
    }
    for (index, TrainingSpace { space, weight, cost_multiplier: costs_times }) in shares.iter().enumerate() {
        check_range(&format!("spaces[{index}].weight"), *weight, WEIGHT_RANGE)?;
        check_range(&format!("spaces[{index}].costs_times"), *costs_times, [0.0, MAX_COST_MULTIPLIER])?;
        if shares.iter().take(index).any(|earlier| earlier.space == *space) {
            let problem = format!("`{space}` is named twice: {ONE_WEIGHT_HINT}");
            return Err(TrainingConfigError::Field { field: format!("spaces[{index}].space"), problem });
        }
    }
    Ok(())
}

/// What a training of these spaces draws from; without any, the paper's distribution.
pub(super) fn scenario_source(shares: &[TrainingSpace]) -> Result<Arc<dyn ScenarioSource>, TrainingConfigError> {
    if shares.is_empty() { Ok(Arc::new(PaperSource)) } else { Ok(Arc::new(SpaceMixture::new(shares)?)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::{EpisodeConfig, TrainingConfig};

    fn training_space(space: &str, weight: f64) -> TrainingSpace {
        TrainingSpace { space: space.to_owned(), weight, cost_multiplier: 1.0 }
    }

    #[test]
    fn each_space_gets_its_share_and_is_drawn_from_as_it_is() {
        let blend = SpaceMixture::new(&[
            training_space("traffic", 3.0),
            training_space("paper", 1.0),
            training_space("high-risk", 4.0),
        ])
        .unwrap();
        let mut counts = [0_u32; 3];
        for index in 0..2000 {
            let drawn = blend.draw(7, index).unwrap();
            let place = blend.spaces().position(|space| space.draw(7, index).unwrap() == drawn).unwrap();
            counts[place] += 1;
        }
        // Four standard deviations.
        for (found, expected, four) in [(counts[0], 750, 87), (counts[1], 250, 60), (counts[2], 1000, 90)] {
            assert!(found.abs_diff(expected) < four, "{counts:?}");
        }
        let identity = blend.identity().unwrap().unwrap();
        assert!(identity.starts_with("a share of 0.375 of the space `traffic` (sha256 "), "{identity}");
    }

    #[test]
    fn mistakes_are_named() {
        let refused = |shares: &[TrainingSpace]| SpaceMixture::new(shares).unwrap_err().to_string();
        let found = refused(&[training_space("paper", 1.0), training_space("nowhere", 1.0)]);
        assert!(found.starts_with("spaces[1].space: `nowhere` is neither a built-in space"), "{found}");
        for weight in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let found = refused(&[training_space("steady", 1.0), training_space("paper", weight)]);
            assert!(found.starts_with("spaces[1].weight: must be between 0.000001 and 1000000, found "), "{found}");
        }
        assert!(refused(&vec![training_space("paper", 1.0); 33]).starts_with("spaces: 32 are the most, found 33"));
        for costs_times in [-1.0, f64::NAN, f64::INFINITY, 2.0 * MAX_COST_MULTIPLIER] {
            let found = refused(&[TrainingSpace { cost_multiplier: costs_times, ..training_space("paper", 1.0) }]);
            assert!(found.starts_with("spaces[0].costs_times: must be between 0 and 10000, found "), "{found}");
        }
        let found =
            refused(&[training_space("paper", 1.0), training_space("steady", 1.0), training_space("paper", 2.0)]);
        assert_eq!(found, "spaces[2].space: `paper` is named twice: give it one weight");
    }

    #[test]
    fn a_space_in_two_files_is_one_space() {
        let folder = tempfile::tempdir().unwrap();
        let steady = crumple_world::scenario::space::built_in_space("steady").unwrap();
        let text = crumple_world::scenario::space::file::to_toml(&steady).unwrap();
        let shares = ["one.toml", "other.toml"].map(|name| {
            let path = folder.path().join(name);
            std::fs::write(&path, &text).unwrap();
            training_space(path.to_str().unwrap(), 1.0)
        });
        let refused = SpaceMixture::new(&shares).unwrap_err().to_string();
        assert!(refused.starts_with("spaces[1].space: `"), "{refused}");
        assert!(refused.ends_with("other.toml` is the space of spaces[0]: give it one weight"), "{refused}");
    }

    /// In the episodes of its space, and in no others; and a training of other costs is another one.
    #[test]
    fn costs_count_as_often_as_the_space_says() {
        let ten = TrainingSpace { cost_multiplier: 10.0, ..training_space("traffic", 1.0) };
        let blend = SpaceMixture::new(&[ten, training_space("paper", 1.0)]).unwrap();
        let config = TrainingConfig::preset("road").unwrap().environment;
        let weight = config.costs.jerk;
        let terms = EpisodeConfig::new(config, 0.99);
        assert!(weight > 0.0);
        let mut counts = [0; 2];
        for index in 0..100 {
            let is_traffic = blend.spaces().position(|space| space.draw(3, index) == blend.draw(3, index)) == Some(0);
            counts[usize::from(is_traffic)] += 1;
            let times = if is_traffic { 10.0 } else { 1.0 };
            assert_eq!(terms.for_episode(&blend, 3, index).environment().costs.jerk, times * weight);
        }
        assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
        let identity = blend.identity().unwrap().unwrap();
        assert!(identity.contains("whose costs count 10 times, a share of 0.5"), "{identity}");
    }
}
