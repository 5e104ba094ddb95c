//! Header of a policy file: everything that driving needs except the weights.

use crumple_core::text_file::is_one;
use serde::{Deserialize, Serialize};

use crate::observation::{EMPTY_GAP_M, EstimatorKind, Neighbour, Observation, ObservedQuantity};

/// Version of the policy file format that this release reads and writes.
pub const POLICY_VERSION: u32 = 1;

/// Number of the paper's inputs per decision, which every policy has.
pub const STATE_LEN: usize = 8;

/// Header of a policy file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyHeader {
    /// Version of the file format: 1.
    pub version: u32,
    /// Release that wrote the file.
    pub crumple: String,
    /// Widths of the hidden layers, input side first.
    pub hidden: Vec<usize>,
    /// Inputs of the network.
    pub observation: ObservationScaling,
    /// Mapping of the network's answer to an acceleration.
    pub action: ActionBounds,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
    /// Estimator in training.
    pub estimator: EstimatorKind,
    /// Seed of the training.
    pub seed: u64,
    /// Training episode after which the policy was saved.
    pub episode: u64,
    /// Training configuration.
    pub training: serde_json::Value,
}

/// Scaling of observations to inputs of order one: (x - offset) / scale, clipped to ±limit.
///
/// Order: `d_fm`, `d_mr`, `v_f`, `v_m`, `v_r`, `a_f`, `a_m`, `a_r` (paper, section "Markov decision process", S).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationScaling {
    /// Offsets that are subtracted: metres, m/s or m/s².
    pub offset: [f64; STATE_LEN],
    /// Divisors: metres, m/s or m/s², positive.
    pub scale: [f64; STATE_LEN],
    /// Clipping limit of scaled numbers.
    pub limit: f64,
    /// Gap that stands for a missing neighbour, in metres; its speed is that of the ego vehicle.
    pub empty_gap_m: f64,
    /// Number of decisions whose inputs the network receives, including the current one.
    #[serde(default = "default_one", skip_serializing_if = "is_one")]
    pub history: usize,
    /// Number of decisions between two of these; 5 with decisions 0.1 s apart means 0.5 s.
    #[serde(default = "default_one", skip_serializing_if = "is_one")]
    pub history_every: usize,
    /// Inputs after the paper's eight.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extra: Vec<ExtraInput>,
}

/// Input of a policy that the paper does not have, as `(x - offset) / scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ExtraInput {
    /// The quantity.
    pub quantity: ObservedQuantity,
    /// Offset that is subtracted, in the unit of the quantity.
    pub offset: f64,
    /// Positive divisor, in the unit of the quantity.
    pub scale: f64,
}

fn default_one() -> usize {
    1
}

impl Default for ObservationScaling {
    fn default() -> Self {
        Self {
            offset: [16.0, 16.0, 12.5, 12.5, 12.5, 0.0, 0.0, 0.0],
            scale: [16.0, 16.0, 12.5, 12.5, 12.5, 5.0, 5.0, 5.0],
            limit: 4.0,
            empty_gap_m: EMPTY_GAP_M,
            history: default_one(),
            history_every: default_one(),
            extra: Vec::new(),
        }
    }
}

impl ObservationScaling {
    /// Returns the number of inputs per decision.
    #[must_use]
    pub fn width(&self) -> usize {
        STATE_LEN + self.extra.len()
    }

    /// Writes the inputs of the current decision, [`width`](Self::width) numbers. NaN counts as 0, infinity as the
    /// limit. `last_answer_mps2` is the controller's last answer.
    #[inline]
    pub fn write_state(&self, observation: &Observation, last_answer_mps2: f64, state: &mut [f32]) {
        let empty = Neighbour {
            gap_m: self.empty_gap_m,
            speed_mps: observation.speed_mps,
            acceleration_mps2: 0.0,
        };
        let ahead = observation.ahead.unwrap_or(empty);
        let behind = observation.behind.unwrap_or(empty);
        let numbers = [
            ahead.gap_m,
            behind.gap_m,
            ahead.speed_mps,
            observation.speed_mps,
            behind.speed_mps,
            ahead.acceleration_mps2,
            observation.acceleration_mps2,
            behind.acceleration_mps2,
        ];
        let paper = numbers.into_iter().zip(self.offset).zip(self.scale);
        let (first, rest) = state.split_at_mut(STATE_LEN.min(state.len()));
        for (input, ((number, offset), scale)) in first.iter_mut().zip(paper) {
            *input = self.scale_input(number, offset, scale);
        }
        for (input, extra) in rest.iter_mut().zip(&self.extra) {
            let number = extra.quantity.value(observation, last_answer_mps2, None);
            *input = self.scale_input(number, extra.offset, extra.scale);
        }
    }

    /// Returns a number as an input of the network: 0 for NaN, within the limit for infinity.
    #[inline]
    fn scale_input(&self, number: f64, offset: f64, scale: f64) -> f32 {
        let scaled = (number - offset) / scale;
        if scaled.is_nan() {
            0.0
        } else {
            scaled.clamp(-self.limit, self.limit) as f32
        }
    }
}

/// Accelerations that a policy chooses from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionBounds {
    /// Minimum acceleration, in m/s².
    pub low_mps2: f64,
    /// Maximum acceleration, in m/s².
    pub high_mps2: f64,
}

impl Default for ActionBounds {
    fn default() -> Self {
        Self {
            low_mps2: -7.5,
            high_mps2: 3.0,
        }
    }
}

impl ActionBounds {
    /// Returns the action, between -1 and 1, that stands for an acceleration.
    #[must_use]
    pub fn action(&self, acceleration_mps2: f64) -> f32 {
        let action = (2.0 * acceleration_mps2 - self.low_mps2 - self.high_mps2)
            / (self.high_mps2 - self.low_mps2);
        action.clamp(-1.0, 1.0) as f32
    }

    /// Returns the action, between -1 and 1, for an output before tanh. NaN means full braking.
    #[inline]
    pub(crate) fn squash(raw: f32) -> f32 {
        if raw.is_nan() { -1.0 } else { libm::tanhf(raw) }
    }
}
