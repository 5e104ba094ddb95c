//! The scene of a certificate: vehicles, initial states, accelerations and duration.
//!
//! Lengths are in metres, times in seconds, speeds in m/s, accelerations in m/s². A position is that of a front bumper.
//! A claim holds for each member of each [`Interval`] field, in any combination.

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::interval::Interval;
use crate::number::format_range;
use crate::rejection::Rejection;
use crate::scope::Scope;

pub(crate) const MAX_STEPS: u32 = 100_000;
/// Maximum number of egos of a scene.
pub const MAX_EGOS: usize = 16;

/// A value held over a number of steps. In a file `[steps, value]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ConstantPiece<T>(pub u32, pub T);

/// A line of vehicles, front to rear: the leader, the egos and at most one follower.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// h, the time between two decisions; instant k is at k h exactly.
    pub step_s: f64,
    /// N, the number of steps. Collisions count from instant 0 to instant N, both included.
    pub steps: u32,
    /// Vehicle 0.
    pub leader: SceneLeader,
    /// Vehicles 1 to n, n at least 1.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub egos: Vec<SceneEgo>,
    /// Vehicle n + 1, if there is one.
    pub follower: Option<SceneFollower>,
}

/// A vehicle that moves as scripted and reacts to no vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneLeader {
    /// Initial position of the front bumper.
    pub position_m: Interval,
    /// Length from bumper to bumper.
    pub length_m: f64,
    /// Initial speed.
    pub speed_mps: Interval,
    /// Acceleration over each of the N steps.
    #[serde(deserialize_with = "bounded::deserialize_list::<{ MAX_STEPS as usize }, _, _>")]
    pub acceleration_mps2: Vec<ConstantPiece<Interval>>,
}

/// A vehicle under test, described by its capabilities and not by its controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEgo {
    /// Initial position of the front bumper.
    pub position_m: Interval,
    /// Length from bumper to bumper.
    pub length_m: f64,
    /// Initial speed.
    pub speed_mps: Interval,
    /// Hardest braking on this road, not negative.
    pub max_brake_mps2: f64,
    /// Hardest acceleration, not negative.
    pub max_accel_mps2: f64,
}

/// A vehicle behind the egos with a latched emergency brake.
///
/// The follower holds its speed. At the first instant k < N with gap - θ (own speed - speed ahead) < 0 its brake
/// *fires*: from instant k + `reaction_steps` on it brakes to standstill. For a positive gap this means that it closes
/// in with a time to collision below θ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFollower {
    /// Initial position of the front bumper.
    pub position_m: Interval,
    /// Initial speed.
    pub speed_mps: Interval,
    /// Deceleration of its brake, not negative.
    pub brake_mps2: Interval,
    /// θ, the time to collision below which it brakes.
    pub ttc_s: f64,
    /// Steps from firing to braking.
    pub reaction_steps: u32,
}

impl Scene {
    /// Checks that no speed, length, limit or time is negative or infinite, and that sizes are bounded.
    ///
    /// # Errors
    /// [`Rejection::Invalid`] names the first invalid field.
    pub fn check(&self) -> Result<(), Rejection> {
        if !(self.step_s > 0.0 && self.step_s.is_finite()) {
            return Err(Rejection::invalid("step_s", "must be positive"));
        }
        if !(1..=MAX_STEPS).contains(&self.steps) {
            return Err(Rejection::invalid("steps", "must be from 1 to 100 000"));
        }
        if !(1..=MAX_EGOS).contains(&self.egos.len()) {
            return Err(Rejection::invalid("egos", "must be from 1 to 16"));
        }
        let SceneLeader {
            length_m,
            speed_mps,
            acceleration_mps2,
            ..
        } = &self.leader;
        check_nonnegative(
            "leader",
            &[("length_m", *length_m), ("speed_mps", speed_mps.low())],
        )?;
        self.check_profile_length(acceleration_mps2, || "leader.acceleration_mps2".into())?;
        for (index, ego) in self.egos.iter().enumerate() {
            ego.check(&format!("egos[{index}]"))?;
        }
        self.follower.iter().try_for_each(SceneFollower::check)
    }

    /// Returns N h, rounded to the nanosecond; the claim covers no later time.
    #[must_use]
    pub(crate) fn horizon_s(&self) -> f64 {
        steps_to_seconds(self.step_s, self.steps)
    }

    pub(crate) fn instant_count(&self) -> u64 {
        u64::from(self.steps) + 1
    }

    pub(crate) fn vehicle_count(&self) -> u64 {
        1 + self.egos.len() as u64 + u64::from(self.follower.is_some())
    }

    /// Checks that a profile lasts for exactly N steps.
    pub(crate) fn check_profile_length<T>(
        &self,
        profile: &[ConstantPiece<T>],
        field: impl Fn() -> String,
    ) -> Result<(), Rejection> {
        // Saturating: 2^32 pieces of 2^32 steps would overflow, and their total is not N either.
        let steps = profile
            .iter()
            .fold(0_u64, |sum, piece| sum.saturating_add(piece.0.into()));
        if steps == u64::from(self.steps) {
            Ok(())
        } else {
            Err(Rejection::invalid(field(), "must last for all N steps"))
        }
    }

    /// Returns the assumptions of a claim about the scene with a statement about its egos.
    pub(crate) fn assumptions(&self, about_egos: Assumption) -> Vec<Assumption> {
        let follower = self.follower.as_ref().map(|_| Assumption::LatchedFollower);
        [
            Assumption::ExactMotion,
            Assumption::ScriptedLeader,
            about_egos,
        ]
        .into_iter()
        .chain(follower)
        .collect()
    }

    /// Returns the scope of a claim about the scene.
    pub(crate) fn scope(&self) -> Scope {
        let leader = &self.leader;

        let mut vehicles = vec![format!(
            "leader: {}, {} m long, {}",
            describe_start(leader.position_m, leader.speed_mps),
            leader.length_m,
            describe_script(&leader.acceleration_mps2)
        )];
        vehicles.extend(self.egos.iter().map(SceneEgo::describe));
        let behind = self.follower.as_ref().map_or_else(
            || "behind: no vehicle is part of the claim".to_owned(),
            SceneFollower::describe,
        );
        let limits = vec![format!("{} steps of {} s", self.steps, self.step_s)];
        Scope {
            behind: Some(behind),
            ..Scope::new(Some(self.horizon_s()), vehicles, limits)
        }
    }
}

impl SceneEgo {
    fn check(&self, field: &str) -> Result<(), Rejection> {
        let fields = [
            ("max_brake_mps2", self.max_brake_mps2),
            ("max_accel_mps2", self.max_accel_mps2),
            ("length_m", self.length_m),
            ("speed_mps", self.speed_mps.low()),
        ];
        check_nonnegative(field, &fields)
    }

    fn describe(&self) -> String {
        format!(
            "under test: {}, {} m long, brakes at up to {} and accelerates at up to {} m/s²",
            describe_start(self.position_m, self.speed_mps),
            self.length_m,
            self.max_brake_mps2,
            self.max_accel_mps2
        )
    }
}

impl SceneFollower {
    fn check(&self) -> Result<(), Rejection> {
        let fields = [
            ("speed_mps", self.speed_mps.low()),
            ("brake_mps2", self.brake_mps2.low()),
            ("ttc_s", self.ttc_s),
        ];
        check_nonnegative("follower", &fields)
    }

    fn describe(&self) -> String {
        format!(
            "behind: {}, brakes at {} m/s² from {} steps after its time to collision falls below {} s",
            describe_start(self.position_m, self.speed_mps),
            format_range(self.brake_mps2),
            self.reaction_steps,
            self.ttc_s
        )
    }
}

fn describe_start(position_m: Interval, speed_mps: Interval) -> String {
    format!(
        "front bumper at {} m, {} m/s",
        format_range(position_m),
        format_range(speed_mps)
    )
}

fn describe_script(pieces: &[ConstantPiece<Interval>]) -> String {
    let hull = pieces
        .iter()
        .map(|piece| [piece.1.low(), piece.1.high()])
        .reduce(|hull, ends| [hull[0].min(ends[0]), hull[1].max(ends[1])]);
    match hull.and_then(|[low, high]| Interval::new(low, high)) {
        Some(accelerations) => format!(
            "a script of {} pieces at {} m/s²",
            pieces.len(),
            format_range(accelerations)
        ),
        None => "no script".to_owned(),
    }
}

pub(crate) fn steps_to_seconds(step_s: f64, steps: u32) -> f64 {
    (step_s * f64::from(steps) * 1e9).round() / 1e9
}

fn check_nonnegative(part: &str, fields: &[(&str, f64)]) -> Result<(), Rejection> {
    match fields
        .iter()
        .find(|(_, value)| !(*value >= 0.0 && value.is_finite()))
    {
        Some((name, _)) => Err(Rejection::invalid(
            format!("{part}.{name}"),
            "is negative or infinite",
        )),
        None => Ok(()),
    }
}
