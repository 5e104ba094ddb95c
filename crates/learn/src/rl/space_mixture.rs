//! Training spaces by name or file, and their mixture.

use crumple_core::text_file::is_one;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::config_error::{TrainingConfigError, check_range};
use super::serde_helpers::default_one;
use super::source::{PaperSource, ScenarioSource, unsuitability};
use crumple_controllers::Controllers;
use crumple_core::text_file::is_default;
use crumple_sim::random::{self, Purpose};
use crumple_sim::scenario::{InvalidField, Scenario};
use crumple_spaces::{ScenarioSpace, find_space};

const MAX_COST_MULTIPLIER: f64 = 1e4;

const WEIGHT_RANGE: [f64; 2] = [1e-6, 1e6];

/// Hint for a space that is listed twice: its weights would add up, and its values of `cost_multiplier` could
/// contradict each other.
const ONE_WEIGHT_HINT: &str = "give it one weight";

const MAX_SPACES: usize = 32;

/// Space of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TrainingSpace {
    /// Built-in space, or space file relative to the working directory.
    pub space: String,
    /// Relative share of the episodes that are drawn from it.
    pub weight: f64,
    /// Factor on the weights of all costs in its episodes.
    #[serde(
        default = "default_one::<f64>",
        skip_serializing_if = "is_one",
        alias = "costs_times"
    )]
    pub cost_multiplier: f64,
    /// Share of its episodes, from 0 to 1, at points that are uniform over the ranges of its parameters, so that rare
    /// values are learned, too.
    #[serde(default, skip_serializing_if = "is_default")]
    pub uniform_share: f64,
}

/// Random mixture of several spaces.
#[derive(Debug, Clone)]
pub struct SpaceMixture {
    components: Vec<SpaceComponent>,
}

#[derive(Debug, Clone)]
struct SpaceComponent {
    space: ScenarioSpace,
    share: f64,
    cumulative_share: f64,
    cost_multiplier: f64,
    uniform_share: f64,
}

/// Separates the random stream of uniform points from those of samples.
const UNIFORM_SEED_INDEX: u64 = u64::MAX - 5;

/// Separates the random stream of this mixture from those of other mixtures.
const COMPONENT_SEED_INDEX: u64 = u64::MAX - 3;

impl SpaceMixture {
    /// Creates the mixture of a configuration's spaces in proportion to their weights.
    ///
    /// # Errors
    /// [`TrainingConfigError`] if a space is unknown, unreadable, unsuitable or duplicate, or a weight invalid.
    pub fn new(
        shares: &[TrainingSpace],
        controllers: Controllers,
    ) -> Result<Self, TrainingConfigError> {
        check_spaces(shares)?;
        let total: f64 = shares.iter().map(|share| share.weight).sum();
        let mut components = Vec::<SpaceComponent>::new();
        let mut cumulative_share = 0.0;
        for (index, training_space) in shares.iter().enumerate() {
            let name = &training_space.space;
            let space = load_space(name, &controllers)
                .and_then(|space| match same_space(&components, &space) {
                    Some(same) => Err(format!(
                        "`{name}` is the space of spaces[{same}]: {ONE_WEIGHT_HINT}"
                    )),
                    None => Ok(space),
                })
                .map_err(|problem| {
                    TrainingConfigError::field(format!("spaces[{index}].space"), problem)
                })?;
            let share = training_space.weight / total;
            cumulative_share += share;
            components.push(SpaceComponent {
                space,
                share,
                cumulative_share,
                cost_multiplier: training_space.cost_multiplier,
                uniform_share: training_space.uniform_share,
            });
        }
        Ok(Self { components })
    }

    /// Yields the spaces.
    pub fn spaces(&self) -> impl Iterator<Item = &ScenarioSpace> {
        self.components.iter().map(|part| &part.space)
    }

    fn component_for(&self, seed: u64, index: u64) -> Option<&SpaceComponent> {
        let mut stream = random::stream(
            random::derived_seed(seed, COMPONENT_SEED_INDEX),
            Purpose::ScenarioSampling,
            index,
        );
        let turn = stream.random::<f64>();
        // Rounding can leave the sum of the shares below 1: the last space takes the rest.
        self.components
            .iter()
            .find(|part| turn < part.cumulative_share)
            .or(self.components.last())
    }
}

impl SpaceComponent {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        let seed_of_points = random::derived_seed(seed, UNIFORM_SEED_INDEX);
        let mut stream = random::stream(seed_of_points, Purpose::ScenarioSampling, index);
        if stream.random::<f64>() >= self.uniform_share {
            return self.space.draw(seed, index);
        }
        let point: Vec<f64> = (0..self.space.dimension())
            .map(|_| stream.random())
            .collect();
        self.space
            .scenario_at_with_seed(&point, random::derived_seed(seed_of_points, index))
    }
}

impl ScenarioSource for SpaceMixture {
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        match self.component_for(seed, index) {
            Some(part) => part.draw(seed, index),
            None => PaperSource.draw(seed, index),
        }
    }

    fn cost_multiplier(&self, seed: u64, index: u64) -> f64 {
        self.component_for(seed, index)
            .map_or(1.0, |part| part.cost_multiplier)
    }

    fn max_cost_multiplier(&self) -> f64 {
        self.components
            .iter()
            .fold(1.0, |most, part| most.max(part.cost_multiplier))
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        let named = self.components.iter().map(|part| {
            let name = part.space.identity()?.unwrap_or_default();
            let costs = if is_one(&part.cost_multiplier) {
                String::new()
            } else {
                format!(", whose costs count {} times", part.cost_multiplier)
            };
            let uniform = match part.uniform_share {
                0.0 => String::new(),
                share => format!(", {share} of them uniform over its ranges"),
            };
            Ok(format!(
                "a share of {} of {name}{costs}{uniform}",
                part.share
            ))
        });
        Ok(Some(
            named
                .collect::<Result<Vec<_>, serde_json::Error>>()?
                .join(", "),
        ))
    }
}

/// Loads a space and checks that a policy can be trained in it.
fn load_space(name: &str, controllers: &Controllers) -> Result<ScenarioSpace, String> {
    let space = find_space(name, controllers).map_err(|error| error.to_string())?;
    let first = space
        .draw(0, 0)
        .map_err(|error| format!("`{name}` has no random scenario: {error}"))?;
    match unsuitability(&first) {
        Some(reason) => Err(format!("`{name}` cannot be trained on: {reason}")),
        None => Ok(space),
    }
}

/// Returns the index of a component with the same space: two files can hold the same one.
fn same_space(components: &[SpaceComponent], space: &ScenarioSpace) -> Option<usize> {
    components
        .iter()
        .position(|component| component.space.spec() == space.spec())
}

/// Checks the ranges of weights and factors, and that no space is listed twice, without reading a file.
pub(super) fn check_spaces(shares: &[TrainingSpace]) -> Result<(), TrainingConfigError> {
    if shares.len() > MAX_SPACES {
        let problem = format!(
            "must have at most {MAX_SPACES} spaces, found {}",
            shares.len()
        );
        return Err(TrainingConfigError::field("spaces", problem));
    }
    for (index, share) in shares.iter().enumerate() {
        let field = format!("spaces[{index}]");
        check_range(&format!("{field}.weight"), share.weight, WEIGHT_RANGE)?;
        check_range(
            &format!("{field}.cost_multiplier"),
            share.cost_multiplier,
            [0.0, MAX_COST_MULTIPLIER],
        )?;
        check_range(
            &format!("{field}.uniform_share"),
            share.uniform_share,
            [0.0, 1.0],
        )?;
        let space = &share.space;
        if shares
            .iter()
            .take(index)
            .any(|earlier| earlier.space == *space)
        {
            let problem = format!("`{space}` is named twice: {ONE_WEIGHT_HINT}");
            return Err(TrainingConfigError::field(
                format!("{field}.space"),
                problem,
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::{EpisodeConstants, TrainingConfig};

    fn training_space(space: &str, weight: f64) -> TrainingSpace {
        TrainingSpace {
            space: space.to_owned(),
            weight,
            cost_multiplier: 1.0,
            uniform_share: 0.0,
        }
    }

    #[test]
    fn each_space_gets_its_share_and_its_own_samples() {
        let spaces = [("traffic", 3.0), ("paper", 1.0), ("high-risk", 4.0)];
        let blend = SpaceMixture::new(
            &spaces.map(|(space, weight)| training_space(space, weight)),
            Controllers::default(),
        )
        .unwrap();
        let mut counts = [0_u32; 3];
        for index in 0..2000 {
            let drawn = blend.draw(7, index).unwrap();
            let position = blend
                .spaces()
                .position(|space| space.draw(7, index).unwrap() == drawn)
                .unwrap();
            counts[position] += 1;
        }
        // Four standard deviations.
        for (actual, expected, four) in [
            (counts[0], 750, 87),
            (counts[1], 250, 60),
            (counts[2], 1000, 90),
        ] {
            assert!(actual.abs_diff(expected) < four, "{counts:?}");
        }
        let identity = blend.identity().unwrap().unwrap();
        assert!(
            identity.starts_with("a share of 0.375 of the space `traffic` (sha256 "),
            "{identity}"
        );
    }

    #[test]
    fn too_many_spaces_and_infinite_numbers_are_named() {
        let refused = |shares: &[TrainingSpace], expected: &str| {
            let actual = SpaceMixture::new(shares, Controllers::default())
                .unwrap_err()
                .to_string();
            assert!(actual.starts_with(expected), "{actual}");
        };
        refused(
            &vec![training_space("paper", 1.0); 33],
            "spaces: must have at most 32 spaces, found 33",
        );
        let expected = "spaces[0].weight: must be between 0.000001 and 1000000, found inf";
        refused(&[training_space("paper", f64::INFINITY)], expected);
    }

    #[test]
    fn a_space_in_two_files_is_one_space() {
        let folder = tempfile::tempdir().unwrap();
        let steady = crumple_spaces::built_in_space("steady").unwrap();
        let text = crumple_spaces::file::to_toml(&steady).unwrap();
        let shares = ["one.toml", "other.toml"].map(|name| {
            let path = folder.path().join(name);
            std::fs::write(&path, &text).unwrap();
            training_space(path.to_str().unwrap(), 1.0)
        });
        let refused = SpaceMixture::new(&shares, Controllers::default())
            .unwrap_err()
            .to_string();
        assert!(refused.starts_with("spaces[1].space: `"), "{refused}");
        assert!(
            refused.ends_with("other.toml` is the space of spaces[0]: give it one weight"),
            "{refused}"
        );
    }

    /// A cost multiplier affects only the episodes of its space, and changes the identity of the source.
    #[test]
    fn costs_are_weighted_by_the_space_multiplier() {
        let ten = TrainingSpace {
            cost_multiplier: 10.0,
            ..training_space("traffic", 1.0)
        };
        let blend = SpaceMixture::new(&[ten, training_space("paper", 1.0)], Controllers::default())
            .unwrap();
        let weight = 1.0;
        let mut config = TrainingConfig::preset("road").unwrap().environment;
        config.costs.jerk = weight;
        let constants = EpisodeConstants::new(config, 0.99);
        let mut counts = [0; 2];
        for index in 0..100 {
            let is_traffic = blend
                .spaces()
                .position(|space| space.draw(3, index) == blend.draw(3, index))
                == Some(0);
            counts[usize::from(is_traffic)] += 1;
            let times = if is_traffic { 10.0 } else { 1.0 };
            assert_eq!(
                constants
                    .for_episode(&blend, 3, index)
                    .environment()
                    .costs
                    .jerk,
                times * weight
            );
        }
        assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
        let identity = blend.identity().unwrap().unwrap();
        assert!(
            identity.contains("whose costs count 10 times, a share of 0.5"),
            "{identity}"
        );
    }
}
