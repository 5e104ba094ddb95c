//! Observation of the agent: a selection of the paper's eight quantities, and their scaling.

use crumple_core::text_file::is_one;
use serde::{Deserialize, Serialize};

use super::config_error::TrainingConfigError;
use super::serde_helpers::default_one;
use crumple_sim::policy::{
    ExtraInput, MAX_EXTRA_INPUTS, MAX_HISTORY, ObservationScaling, STATE_LEN,
};

/// Inputs of the networks, each as `(x - offset) / scale`, clipped to ±`limit`. Quantities that `inputs` omits are 0.
///
/// The default is the paper's eight quantities (section "Markov decision process", paragraph S). The paper does not
/// state their scaling; this one is crumple's. A policy file contains it ([`ObservationScaling`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "schema", schemars(extend("if" = strided_history_schema(), "then" = required_history_schema())))]
#[non_exhaustive]
pub struct ObservationConfig {
    /// Clipping limit of scaled inputs.
    pub limit: f64,
    /// Gap to a vehicle that is absent, in metres; it has the ego vehicle's speed.
    pub empty_gap_m: f64,
    /// Number of decisions in the observation, with the present one. At the start the first one is repeated.
    #[serde(default = "default_one::<u32>", skip_serializing_if = "is_one")]
    pub history: u32,
    /// Decisions between two of them. A longer interval keeps noise from hiding changes of speed.
    #[serde(default = "default_one::<u32>", skip_serializing_if = "is_one")]
    pub history_every: u32,
    /// Selected inputs.
    pub inputs: ObservationInputs,
    /// Inputs besides the paper's eight, such as the last answer or time gaps.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extra: Vec<ExtraInput>,
}

/// Returns the schema condition: `history_every` of 2 or more requires a `history`.
#[cfg(feature = "schema")]
fn strided_history_schema() -> serde_json::Value {
    serde_json::json!({ "required": ["history_every"], "properties": { "history_every": { "minimum": 2 } } })
}

#[cfg(feature = "schema")]
fn required_history_schema() -> serde_json::Value {
    serde_json::json!({ "required": ["history"], "properties": { "history": { "minimum": 2 } } })
}

/// Scaling of each input; none for an omitted input.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ObservationInputs {
    /// Gap to the leader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gap_ahead_m: Option<InputScaling>,
    /// Gap to the follower.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gap_behind_m: Option<InputScaling>,
    /// Speed of the leader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_ahead_mps: Option<InputScaling>,
    /// Speed of the ego vehicle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<InputScaling>,
    /// Speed of the follower.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_behind_mps: Option<InputScaling>,
    /// Acceleration of the leader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_ahead_mps2: Option<InputScaling>,
    /// Acceleration of the ego vehicle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_mps2: Option<InputScaling>,
    /// Acceleration of the follower.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_behind_mps2: Option<InputScaling>,
}

/// Linear scaling `(x - offset) / scale`, both in the unit of the input.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct InputScaling {
    /// Value that is subtracted.
    pub offset: f64,
    /// Positive divisor.
    pub scale: f64,
}

/// Scaling that maps every value to 0.
const MASKED_INPUT: InputScaling = InputScaling {
    offset: 0.0,
    scale: f64::MAX,
};

impl ObservationInputs {
    /// Returns field and scaling of each input in the order of the network inputs, which is that of the paper.
    fn fields_mut(&mut self) -> [(&'static str, &mut Option<InputScaling>); STATE_LEN] {
        [
            ("gap_ahead_m", &mut self.gap_ahead_m),
            ("gap_behind_m", &mut self.gap_behind_m),
            ("speed_ahead_mps", &mut self.speed_ahead_mps),
            ("speed_mps", &mut self.speed_mps),
            ("speed_behind_mps", &mut self.speed_behind_mps),
            ("acceleration_ahead_mps2", &mut self.acceleration_ahead_mps2),
            ("acceleration_mps2", &mut self.acceleration_mps2),
            (
                "acceleration_behind_mps2",
                &mut self.acceleration_behind_mps2,
            ),
        ]
    }

    fn to_array(&self) -> [(&'static str, Option<InputScaling>); STATE_LEN] {
        self.clone()
            .fields_mut()
            .map(|(name, input)| (name, *input))
    }
}

impl Default for ObservationConfig {
    fn default() -> Self {
        let ObservationScaling {
            offset,
            scale,
            limit,
            empty_gap_m,
            ..
        } = ObservationScaling::default();
        let mut inputs = ObservationInputs::default();
        for ((_, input), (offset, scale)) in inputs
            .fields_mut()
            .into_iter()
            .zip(offset.into_iter().zip(scale))
        {
            *input = Some(InputScaling { offset, scale });
        }
        Self {
            limit,
            empty_gap_m,
            history: 1,
            history_every: 1,
            inputs,
            extra: Vec::new(),
        }
    }
}

impl ObservationConfig {
    pub(super) fn width(&self) -> usize {
        (STATE_LEN + self.extra.len()) * self.history as usize
    }

    /// Returns the scaling for a policy file.
    #[must_use]
    pub fn scaling(&self) -> ObservationScaling {
        let all = self
            .inputs
            .to_array()
            .map(|(_, input)| input.unwrap_or(MASKED_INPUT));
        ObservationScaling {
            offset: all.map(|input| input.offset),
            scale: all.map(|input| input.scale),
            limit: self.limit,
            empty_gap_m: self.empty_gap_m,
            history: self.history as usize,
            history_every: self.history_every as usize,
            extra: self.extra.clone(),
        }
    }

    /// Yields the path, value and range of every number.
    pub(super) fn ranges(&self) -> impl Iterator<Item = (String, f64, [f64; 2])> {
        let inputs = self
            .inputs
            .to_array()
            .into_iter()
            .filter_map(|(name, input)| Some((name, input?)));
        let inputs =
            inputs.map(|(name, input)| (format!("inputs.{name}"), input.offset, input.scale));
        let extra = self.extra.iter().enumerate();
        let extra =
            extra.map(|(index, input)| (format!("extra[{index}]"), input.offset, input.scale));
        let scaled = inputs.chain(extra).flat_map(|(input, offset, scale)| {
            [
                (format!("{input}.offset"), offset, [-1e4, 1e4]),
                (format!("{input}.scale"), scale, [1e-3, 1e4]),
            ]
        });
        let whole = [
            ("limit".to_owned(), self.limit, [0.1, 1000.0]),
            ("empty_gap_m".to_owned(), self.empty_gap_m, [1.0, 1e4]),
            (
                "history".to_owned(),
                f64::from(self.history),
                [1.0, MAX_HISTORY as f64],
            ),
            (
                "history_every".to_owned(),
                f64::from(self.history_every),
                [1.0, MAX_HISTORY as f64],
            ),
        ];
        let all = whole.into_iter().chain(scaled);
        all.map(|(name, value, range)| (format!("environment.observation.{name}"), value, range))
    }

    /// Refuses an observation without inputs, and an interval without a history.
    pub(super) fn check(&self) -> Result<(), TrainingConfigError> {
        if self.history_every > 1 && self.history == 1 {
            let problem = "is the interval between past decisions in the observation: remove it, \
                or set `history` to 2 or more";
            return Err(TrainingConfigError::field(
                "environment.observation.history_every",
                problem,
            ));
        }
        if self.extra.len() > MAX_EXTRA_INPUTS {
            let problem = format!(
                "must have at most {MAX_EXTRA_INPUTS} inputs, found {}",
                self.extra.len()
            );
            return Err(TrainingConfigError::field(
                "environment.observation.extra",
                problem,
            ));
        }
        if self.inputs == ObservationInputs::default() {
            let problem = "the observation is empty; name at least one input";
            return Err(TrainingConfigError::field(
                "environment.observation.inputs",
                problem,
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::observation::{Neighbour, Observation};

    #[test]
    fn the_default_observation_is_unchanged_and_omitted_values_are_0() {
        assert_eq!(
            ObservationConfig::default().scaling(),
            ObservationScaling::default()
        );
        let mut config = ObservationConfig::default();
        config.inputs.gap_behind_m = None;
        config.inputs.acceleration_ahead_mps2 = None;
        let neighbour = Neighbour {
            gap_m: 24.0,
            speed_mps: 25.0,
            acceleration_mps2: -5.0,
        };
        let seen = Observation {
            speed_mps: 0.0,
            acceleration_mps2: 5.0,
            ahead: Some(neighbour),
            behind: Some(neighbour),
        };
        let mut state = [0.0; STATE_LEN];
        config.scaling().write_state(&seen, 0.0, &mut state);
        assert_eq!(state, [0.5, 0.0, 1.0, -1.0, 1.0, 0.0, 1.0, -1.0]);
        config.inputs = ObservationInputs::default();
        assert!(config.check().is_err());
    }
}
