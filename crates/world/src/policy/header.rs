//! What a policy file says about its network: everything that is needed to drive with it.

use serde::{Deserialize, Serialize};

use super::residual::ResidualControl;
use crate::observation::{EstimatorKind, Neighbour, Observation};

/// Version of the policy file format this release reads and writes.
pub const POLICY_VERSION: u32 = 1;

/// Numbers a policy sees at a decision: the paper's eight.
pub const STATE_LEN: usize = 8;

/// The header of a policy file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyHeader {
    /// Version of the file format: 1.
    pub version: u32,
    /// The release that wrote it.
    pub crumple: String,
    /// Widths of the hidden layers, from the state on.
    pub hidden: Vec<usize>,
    /// From the eight numbers to what the network sees.
    pub observation: ObservationScaling,
    /// From what the network answers to an acceleration.
    pub action: ActionBounds,
    /// Time between decisions, in seconds.
    pub decision_interval_s: f64,
    /// What it looked through in training.
    pub estimator: EstimatorKind,
    /// Seed it was trained under.
    pub seed: u64,
    /// Episode of training after which it was taken.
    pub episode: u64,
    /// The whole training configuration.
    pub training: serde_json::Value,
}

/// Makes numbers of order one out of an observation: (x - offset) / scale, cut to ±limit.
///
/// Order: `d_fm`, `d_mr`, `v_f`, `v_m`, `v_r`, `a_f`, `a_m`, `a_r` (paper, section "Markov decision process", paragraph S).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationScaling {
    /// Subtracted: metres, m/s or m/s².
    pub offset: [f64; STATE_LEN],
    /// Divided by: metres, m/s or m/s², positive.
    pub scale: [f64; STATE_LEN],
    /// Scaled numbers are cut to plus and minus this.
    pub limit: f64,
    /// Gap to the vehicle that stands in for one that is not there, in metres; it drives as fast as the ego.
    pub empty_gap_m: f64,
    /// Decisions whose numbers the network sees, the present one included; 1 for one that sees the present alone.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub history: usize,
    /// Decisions from one of them to the next: with 5, and decisions 0.1 s apart, what was seen is half a second apart.
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
    /// What the network sees of the present. A number that is not finite counts as the limit or as 0.
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

/// The accelerations a policy chooses from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionBounds {
    /// Lowest acceleration, in m/s².
    pub low_mps2: f64,
    /// Highest acceleration, in m/s².
    pub high_mps2: f64,
    /// The law that is followed unless the network says otherwise; without one it says the acceleration itself.
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
    /// The action, between -1 and 1, of the output of a network, before the final tanh. NaN, which a network whose weights multiply to
    /// infinity answers with, would mean full braking: a vehicle must not coast because its controller failed.
    #[must_use]
    #[inline]
    pub(crate) fn squash(raw: f32) -> f32 {
        if raw.is_nan() { -1.0 } else { libm::tanhf(raw) }
    }
}
