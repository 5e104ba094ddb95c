//! Driving costs in the reward.

#[cfg(doc)]
use crumple_measure::justified_brake_mps2;
use serde::{Deserialize, Serialize};

const MAX_WEIGHT: f64 = 100.0;

/// Costs of a step, as a share of its reward. A step without a collision earns `step_reward * (1 - sum of weight *
/// term)`. Every weight is 0 by default.
///
/// | weight | term, from the true state after the step |
/// |---|---|
/// | `far` | (gap - wanted) / wanted, in `[0, 1]`: large gap |
/// | `near` | (wanted - gap) / wanted, in `[0, 1]`: small gap |
/// | `relative_speed` | speed difference to the leader / 10 m/s, at most 1 |
/// | `acceleration` | (acceleration / 7.5 m/s²)² |
/// | `jerk` | jerk / 75 m/s³ |
/// | `induced_braking` | (follower's deceleration - leader's deceleration, at least 0) / 7.5 m/s², at least 0 |
/// | `unnecessary_braking` | (deceleration - [`justified_brake_mps2`] of this step - 1 m/s²) / 7.5 m/s², at least 0 |
///
/// The wanted gap is `standstill_m + headway_s * speed`. Terms about an absent vehicle are 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct CostConfig {
    /// Wanted gap at a standstill, in metres.
    pub standstill_m: f64,
    /// Wanted time headway in addition, in seconds.
    pub headway_s: f64,
    /// Weight of a gap above the wanted one.
    pub far: f64,
    /// Weight of a gap below the wanted one.
    pub near: f64,
    /// Weight of the speed difference to the leader.
    pub relative_speed: f64,
    /// Weight of acceleration.
    pub acceleration: f64,
    /// Weight of jerk.
    pub jerk: f64,
    /// Weight of induced braking of the follower.
    #[serde(alias = "imposed")]
    pub induced_braking: f64,
    /// Weight of unnecessary braking.
    #[serde(alias = "needless")]
    pub unnecessary_braking: f64,
}

impl Default for CostConfig {
    fn default() -> Self {
        Self {
            standstill_m: 2.0,
            headway_s: 1.3,
            far: 0.0,
            near: 0.0,
            relative_speed: 0.0,
            acceleration: 0.0,
            jerk: 0.0,
            induced_braking: 0.0,
            unnecessary_braking: 0.0,
        }
    }
}

impl CostConfig {
    fn weights_mut(&mut self) -> [(&'static str, &mut f64); 7] {
        [
            ("far", &mut self.far),
            ("near", &mut self.near),
            ("relative_speed", &mut self.relative_speed),
            ("acceleration", &mut self.acceleration),
            ("jerk", &mut self.jerk),
            ("induced_braking", &mut self.induced_braking),
            ("unnecessary_braking", &mut self.unnecessary_braking),
        ]
    }

    fn weights(&self) -> [(&'static str, f64); 7] {
        self.clone()
            .weights_mut()
            .map(|(name, weight)| (name, *weight))
    }

    /// Yields the path, value and range of every number.
    pub(super) fn ranges(&self) -> impl Iterator<Item = (String, f64, [f64; 2])> {
        let wanted = [
            ("standstill_m", self.standstill_m, [0.1, 100.0]),
            ("headway_s", self.headway_s, [0.0, 10.0]),
        ];
        let weights = self
            .weights()
            .map(|(name, weight)| (name, weight, [0.0, MAX_WEIGHT]));
        let all = wanted.into_iter().chain(weights);
        all.map(|(name, value, range)| (format!("environment.costs.{name}"), value, range))
    }

    pub(crate) fn is_free(&self) -> bool {
        self.weights().iter().all(|(_, weight)| *weight == 0.0)
    }

    pub(super) fn scaled_by(&self, times: f64) -> Self {
        let mut scaled = self.clone();
        scaled
            .weights_mut()
            .into_iter()
            .for_each(|(_, weight)| *weight *= times);
        scaled
    }

    /// Returns approximately the largest cost of a step, as a share of its reward.
    pub(super) fn max_cost(&self) -> f64 {
        self.weights().iter().map(|(_, weight)| weight).sum()
    }
}
