//! What a certificate speaks about: who drives where, how, and for how long.
//!
//! Lengths are in metres, times in seconds, speeds in m/s, accelerations in m/s². A position is a front bumper's. Where a
//! field is an [`Interval`] the claim holds for each of its members, in any combination.

use serde::{Deserialize, Serialize};

use crate::interval::Interval;

/// A value held over a number of steps. In a file `[steps, value]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Held<T>(pub u32, pub T);

/// A line of vehicles, front to rear: the leader, the egos and at most one follower.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// h, the time between two decisions; instant k is at k h exactly.
    pub step_s: f64,
    /// N, the number of steps. Contact counts from instant 0 to instant N, both included.
    pub steps: u32,
    /// Vehicle 0.
    pub leader: Leader,
    /// Vehicles 1 to n, n at least 1.
    pub egos: Vec<Ego>,
    /// Vehicle n + 1, if there is one.
    pub follower: Option<Follower>,
}

/// A vehicle that moves as it is told and reacts to nobody.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leader {
    /// Front bumper at the start.
    pub position_m: Interval,
    /// Bumper to bumper.
    pub length_m: f64,
    /// Speed at the start.
    pub speed_mps: Interval,
    /// Acceleration over each of the N steps.
    pub acceleration_mps2: Vec<Held<Interval>>,
}

/// A vehicle under test. What drives it is not said: only what it is able to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ego {
    /// Front bumper at the start.
    pub position_m: Interval,
    /// Bumper to bumper.
    pub length_m: f64,
    /// Speed at the start.
    pub speed_mps: Interval,
    /// Hardest braking on this road, not negative.
    pub max_brake_mps2: f64,
    /// Hardest acceleration, not negative.
    pub max_accel_mps2: f64,
}

/// A vehicle behind the egos with a latched emergency brake.
///
/// It holds its speed. At the first instant k < N with gap - θ (own speed - speed ahead) < 0 its brake *fires*: from instant
/// k + `reaction_steps` on it brakes, to standstill, whatever happens. For a positive gap the condition implies that it is
/// closing in, and says that time to collision is below θ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Follower {
    /// Front bumper at the start.
    pub position_m: Interval,
    /// Speed at the start.
    pub speed_mps: Interval,
    /// How hard it brakes, not negative.
    pub brake_mps2: Interval,
    /// θ, the time to collision below which it brakes.
    pub ttc_s: f64,
    /// Steps from firing to braking.
    pub reaction_steps: u32,
}
