//! Header of a policy file: everything that driving needs except the weights.

use serde::{Deserialize, Serialize};

use super::residual::ResidualControl;
use crate::observation::{EstimatorKind, Neighbour, Observation};

/// Version of the policy file format that this release reads and writes.
pub const POLICY_VERSION: u32 = 1;

/// Number of inputs of a policy per decision: the paper's eight.
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
    /// Scaling of the eight numbers to inputs of the network.
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
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub history: usize,
    /// Number of decisions between two of these; 5 with decisions 0.1 s apart means 0.5 s.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub history_every: usize,
}

fn one() -> usize {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
fn is_one(count: &usize) -> bool {
    *count == 1
}

impl Default for ObservationScaling {
    fn default() -> Self {
        Self {
            offset: [16.0, 16.0, 12.5, 12.5, 12.5, 0.0, 0.0, 0.0],
            scale: [16.0, 16.0, 12.5, 12.5, 12.5, 5.0, 5.0, 5.0],
            limit: 4.0,
            empty_gap_m: 80.0,
            history: one(),
            history_every: one(),
        }
    }
}

impl ObservationScaling {
    /// Returns the inputs of the current decision. NaN counts as 0, infinity as the limit.
    #[must_use]
    #[inline]
    pub fn state(&self, seen: &Observation) -> [f32; STATE_LEN] {
        let empty = Neighbour { gap_m: self.empty_gap_m, speed_mps: seen.speed_mps, acceleration_mps2: 0.0 };
        let (ahead, behind) = (seen.ahead.unwrap_or(empty), seen.behind.unwrap_or(empty));
        let numbers = [
            ahead.gap_m,
            behind.gap_m,
            ahead.speed_mps,
            seen.speed_mps,
            behind.speed_mps,
            ahead.acceleration_mps2,
            seen.acceleration_mps2,
            behind.acceleration_mps2,
        ];
        std::array::from_fn(|i| {
            let scaled = (numbers[i] - self.offset[i]) / self.scale[i];
            if scaled.is_nan() { 0.0 } else { scaled.clamp(-self.limit, self.limit) as f32 }
        })
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
    /// Base controller of a residual policy; `None` if the network determines the acceleration itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(rename = "departs_from")]
    pub residual_over: Option<ResidualControl>,
}

impl Default for ActionBounds {
    fn default() -> Self {
        Self { low_mps2: -7.5, high_mps2: 3.0, residual_over: None }
    }
}

impl ActionBounds {
    /// Returns the action, between -1 and 1, for an output before tanh. NaN means full braking.
    #[inline]
    pub(crate) fn squash(raw: f32) -> f32 {
        if raw.is_nan() { -1.0 } else { libm::tanhf(raw) }
    }
}
