//! Lead profiles: scripted motion, independent of other vehicles.
//!
//! A profile returns the acceleration to hold over a step. If the script changes within a step, the acceleration is the
//! mean over the step, so that speeds at step boundaries match the script. Profiles with a final speed read the
//! vehicle's speed, which corrects for noise. Scripted vehicles have neither delay nor lag, and brake at most as
//! friction allows.

use serde::{Deserialize, Serialize};

/// Scripted motion of a vehicle, usually the leader.
#[derive(Debug, Clone, PartialEq)]
pub enum LeadProfile {
    /// Constant speed.
    ConstantSpeed,
    /// Constant braking to standstill.
    Brake(Brake),
    /// Braking that builds up within a time, is held, and eases off just before standstill.
    RampBrake(RampBrake),
    /// Constant braking to a lower speed, which is then held.
    BrakeToSpeed(BrakeToSpeed),
    /// Piecewise constant acceleration.
    Pieces(PiecewiseAcceleration),
    /// Recorded speeds.
    Recorded(RecordedSpeeds),
}

/// Constant braking from `onset_s` to standstill.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Brake {
    /// Start of braking, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub onset_s: f64,
    /// Deceleration in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub rate_mps2: f64,
}

/// Braking that builds up linearly within `ramp_s`, is held, and falls linearly to zero in the last `release_s` before
/// standstill.
///
/// "0.5 g within 1.5 s, held until 250 ms before standstill" is `rate 4.905, ramp 1.5, release 0.25`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RampBrake {
    /// Start of braking, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub onset_s: f64,
    /// Held deceleration, in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub rate_mps2: f64,
    /// Time from zero to the full rate, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub ramp_s: f64,
    /// Time before standstill at which easing off starts, in seconds.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub release_s: f64,
}

/// Constant braking from `onset_s` until `final_speed_mps`, which is then held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BrakeToSpeed {
    /// Start of braking, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub onset_s: f64,
    /// Deceleration in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub rate_mps2: f64,
    /// Final speed, in m/s.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub final_speed_mps: f64,
}

/// Piecewise constant acceleration: `accel_mps2[i]` from `from_s[i]` on; 0 before the first, the last one held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PiecewiseAcceleration {
    /// Start of each piece in seconds, increasing.
    pub from_s: Vec<f64>,
    /// Acceleration over each piece in m/s², negative for braking.
    pub accel_mps2: Vec<f64>,
}

/// Recorded speeds, linear between samples, followed within the vehicle's limits; the last speed is held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RecordedSpeeds {
    /// Time of each sample in seconds, increasing.
    pub time_s: Vec<f64>,
    /// Speed at each sample in m/s.
    pub speed_mps: Vec<f64>,
}

impl LeadProfile {
    /// Returns the name in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::ConstantSpeed => "constant-speed",
            Self::Brake(_) => "brake",
            Self::RampBrake(_) => "ramp-brake",
            Self::BrakeToSpeed(_) => "brake-to-speed",
            Self::Pieces(_) => "pieces",
            Self::Recorded(_) => "recorded",
        }
    }

    /// Returns the acceleration to hold from `from_s` to `to_s`, in m/s², for a vehicle at `speed_mps`.
    #[must_use]
    #[inline]
    pub fn acceleration_mps2(&self, from_s: f64, to_s: f64, speed_mps: f64) -> f64 {
        match self {
            Self::Brake(brake) => brake.acceleration_mps2(from_s, to_s),
            _ => self.other_acceleration_mps2(from_s, to_s, speed_mps),
        }
    }

    /// Returns the constant acceleration of all steps from `from_s` until a time, and this time, so that callers can
    /// skip those steps; `None` if the acceleration depends on the speed.
    pub(crate) fn constant_acceleration_span(&self, from_s: f64) -> Option<[f64; 2]> {
        match self {
            Self::ConstantSpeed => Some([0.0, f64::INFINITY]),
            Self::Brake(brake) => {
                let until_s = if brake.onset_s <= from_s {
                    f64::INFINITY
                } else {
                    brake.onset_s
                };
                Some([brake.acceleration_mps2(from_s, from_s), until_s])
            }
            Self::Pieces(pieces) => {
                let next = pieces.from_s.partition_point(|&start| start <= from_s);
                Some([
                    pieces.piece_before_mps2(next),
                    pieces.from_s.get(next).copied().unwrap_or(f64::INFINITY),
                ])
            }
            Self::RampBrake(_) | Self::BrakeToSpeed(_) | Self::Recorded(_) => None,
        }
    }

    /// Separate function, so that [`Self::acceleration_mps2`] is small enough to be inlined.
    fn other_acceleration_mps2(&self, from_s: f64, to_s: f64, speed_mps: f64) -> f64 {
        match self {
            Self::ConstantSpeed => 0.0,
            Self::Brake(brake) => brake.acceleration_mps2(from_s, to_s),
            Self::RampBrake(ramp) => ramp.acceleration_mps2(from_s, to_s, speed_mps),
            Self::BrakeToSpeed(brake) => {
                let braking = -brake.rate_mps2 * share_after(brake.onset_s, from_s, to_s);
                let to_final_speed = (brake.final_speed_mps - speed_mps) / (to_s - from_s);
                braking.max(to_final_speed.min(0.0))
            }
            Self::Pieces(pieces) => pieces.mean_mps2(from_s, to_s),
            Self::Recorded(recorded) => (recorded.speed_at_mps(to_s) - speed_mps) / (to_s - from_s),
        }
    }

    /// Returns the lowest and highest acceleration of the script, in m/s².
    ///
    /// Recorded speeds count as `[0, 0]`: they are followed only within the vehicle's limits.
    #[must_use]
    pub fn acceleration_range_mps2(&self) -> [f64; 2] {
        match self {
            Self::ConstantSpeed | Self::Recorded(_) => [0.0, 0.0],
            Self::Brake(brake) => [-brake.rate_mps2, 0.0],
            Self::RampBrake(ramp) => [-ramp.rate_mps2, 0.0],
            Self::BrakeToSpeed(brake) => [-brake.rate_mps2, 0.0],
            Self::Pieces(pieces) => pieces
                .accel_mps2
                .iter()
                .fold([0.0, 0.0], |[lowest, highest]: [f64; 2], &a| {
                    [lowest.min(a), highest.max(a)]
                }),
        }
    }
}

impl Brake {
    #[inline(always)]
    pub(crate) fn acceleration_mps2(&self, from_s: f64, to_s: f64) -> f64 {
        -self.rate_mps2 * share_after(self.onset_s, from_s, to_s)
    }
}

#[inline(always)]
fn share_after(onset_s: f64, from_s: f64, to_s: f64) -> f64 {
    // Most steps take the first two branches, which need no division.
    if onset_s <= from_s {
        1.0
    } else if onset_s >= to_s {
        0.0
    } else {
        (to_s - onset_s) / (to_s - from_s)
    }
}

impl RampBrake {
    fn acceleration_mps2(&self, from_s: f64, to_s: f64, speed_mps: f64) -> f64 {
        let mean_build_up =
            (self.speed_lost_mps(to_s) - self.speed_lost_mps(from_s)) / (to_s - from_s);
        -mean_build_up.min(self.easing_mps2(to_s - from_s, speed_mps))
    }

    /// Integrates build-up and held rate from the onset to `at_s`, in m/s.
    fn speed_lost_mps(&self, at_s: f64) -> f64 {
        let braking_s = (at_s - self.onset_s).max(0.0);
        if braking_s < self.ramp_s {
            0.5 * self.rate_mps2 * braking_s * braking_s / self.ramp_s
        } else {
            self.rate_mps2 * (braking_s - 0.5 * self.ramp_s)
        }
    }

    /// Returns the mean deceleration over a step while easing off. Deceleration that falls linearly from `rate` to zero
    /// over `release` is `sqrt(2 rate v / release)` at speed v, so the square root of the speed falls linearly.
    fn easing_mps2(&self, step_s: f64, speed_mps: f64) -> f64 {
        if self.release_s == 0.0 {
            return self.rate_mps2;
        }
        let root_lost = step_s * (0.5 * self.rate_mps2 / self.release_s).sqrt();
        let root_left = (speed_mps.sqrt() - root_lost).max(0.0);
        (speed_mps - root_left * root_left) / step_s
    }
}

impl PiecewiseAcceleration {
    fn mean_mps2(&self, from_s: f64, to_s: f64) -> f64 {
        let current = self.from_s.partition_point(|&start| start <= from_s);
        let mut piece = self.piece_before_mps2(current);
        let mut mean = piece;
        for (&start, &next) in self.from_s.iter().zip(&self.accel_mps2).skip(current) {
            if start >= to_s {
                break;
            }
            mean += (next - piece) * share_after(start, from_s, to_s);
            piece = next;
        }
        mean
    }

    /// Returns the acceleration of the piece before `next`, in m/s².
    fn piece_before_mps2(&self, next: usize) -> f64 {
        next.checked_sub(1)
            .and_then(|current| self.accel_mps2.get(current))
            .copied()
            .unwrap_or(0.0)
    }
}

impl RecordedSpeeds {
    /// Returns the speed at a time, in m/s: linear between samples, constant outside them.
    #[must_use]
    pub fn speed_at_mps(&self, at_s: f64) -> f64 {
        let next = self.time_s.partition_point(|&t| t <= at_s);
        let before = next.checked_sub(1).and_then(|before| self.sample(before));
        match (before, self.sample(next)) {
            (Some([t0, v0]), Some([t1, v1])) => v0 + (v1 - v0) * (at_s - t0) / (t1 - t0),
            (Some([_, v]), None) | (None, Some([_, v])) => v,
            (None, None) => 0.0,
        }
    }

    /// Returns time (s) and speed (m/s) of a sample.
    fn sample(&self, index: usize) -> Option<[f64; 2]> {
        Some([*self.time_s.get(index)?, *self.speed_mps.get(index)?])
    }
}

#[cfg(test)]
mod tests;
