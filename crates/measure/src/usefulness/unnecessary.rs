//! Unnecessary braking.

use serde::{Deserialize, Serialize};

use super::drive::{DriveStep, drive_steps};
use crate::approach::PairState;
use crate::comfort::SlidingExtreme;
use crate::demand::required_brake_mps2;
use crate::proximity::time_gap_s;
use crumple_sim::control::{Idm, IdmSettings};
use crumple_sim::engine::{Impact, Trace};

/// Deceleration beyond the justified one that makes braking unnecessary, in m/s².
///
/// Project-specific: about as hard as drivers brake in everyday traffic. A vehicle may thus add everyday braking to
/// that of the reference driver.
pub const UNNECESSARY_MARGIN_MPS2: f64 = 2.0;

/// Smallest duration of braking that counts, in seconds. Shorter pauses do not end it, so that braking in bursts
/// counts.
///
/// Project-specific: a change of speed of a few tenths of a metre per second is noise to passengers and to the
/// follower.
pub const MIN_BRAKING_S: f64 = 0.2;

/// Time for which a past justification counts, in seconds.
///
/// Project-specific: braking that reacts with delay also ends with delay; half a second is the longest reaction time in
/// the built-in spaces.
pub const CAUSE_LASTS_S: f64 = 0.5;

/// Largest time gap of a vehicle that follows its leader, in seconds: the headway below which the Highway Capacity
/// Manual 2000 counts vehicles as following.
pub const MAX_FOLLOWING_TIME_GAP_S: f64 = 3.0;

/// Speed below which braking does not count, in m/s.
///
/// Project-specific: a vehicle that stops with cause brakes until it stands, but near the end the reference driver
/// would roll on to a smaller gap. At full braking the last 3 m/s take 0.4 s.
pub const MIN_BRAKING_SPEED_MPS: f64 = 3.0;

/// Deceleration above which braking is hard, in m/s²; drivers do not reach it in everyday traffic.
pub const HARD_BRAKE_MPS2: f64 = 4.0;

/// Largest justified deceleration at which hard braking is unnecessary, in m/s².
pub const EASY_BRAKE_MPS2: f64 = 3.0;

/// Unnecessary braking: harder than any vehicle ahead requires, at the expense of passengers and followers.
///
/// The justified deceleration at any instant is the largest of these within the last [`CAUSE_LASTS_S`]:
/// - the deceleration of the Intelligent Driver Model with default settings in the true state, without its free-road
///   term: a (s*/s)²;
/// - the deceleration required to avoid the leader if the leader holds its braking to standstill
///   ([`required_brake_mps2`]);
/// - the deceleration of the leader, within [`MAX_FOLLOWING_TIME_GAP_S`]: braking like the leader counts as following
///   it, even if softer braking to a smaller gap would suffice;
///
/// The justified deceleration is 0 without a leader. The first two grow without bound as the gap shrinks to 0. They
/// justify any braking in an emergency, and braking that widens a gap that is too small. UN Regulation 157 likewise
/// uses a reference driver to decide which collisions were preventable.
///
/// Braking counts only before the first impact and from [`MIN_BRAKING_SPEED_MPS`] on. Source of the model: Treiber,
/// Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000); thresholds are project-specific.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct UnnecessaryBraking {
    /// Total duration, in seconds.
    pub time_s: f64,
    /// Number of brakings.
    pub count: usize,
    /// Instant of the largest excess over the justified deceleration; `None` without unnecessary braking.
    pub hardest: Option<BrakeInstant>,
}

/// Unnecessary braking at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BrakeInstant {
    /// Time, in seconds.
    pub time_s: f64,
    /// Deceleration, in m/s², positive.
    pub brake_mps2: f64,
    /// Justified deceleration, in m/s², never negative.
    #[serde(alias = "caused_mps2")]
    pub justified_mps2: f64,
}

impl UnnecessaryBraking {
    /// Measures braking of vehicle `index` by more than [`UNNECESSARY_MARGIN_MPS2`] beyond the justified deceleration;
    /// `None` if there is no such vehicle.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        drive_steps(trace, impacts, index).map(Self::from_steps)
    }

    /// Measures braking of vehicle `index` that is harder than a limit, in m/s², although the justified deceleration
    /// does not exceed the limit; `None` if there is no such vehicle. Unlike [`UnnecessaryBraking::from_trace`], it has
    /// no margin: 2.1 m/s² where 1.9 m/s² was justified exceeds a limit of 2 m/s².
    #[must_use]
    pub fn from_trace_above_limit(
        limit_mps2: f64,
        trace: &Trace,
        impacts: &[Impact],
        index: usize,
    ) -> Option<Self> {
        let steps = drive_steps(trace, impacts, index)?;
        Some(Self::from_steps_where(steps, |brake| {
            brake.brake_mps2 > limit_mps2 && brake.justified_mps2 <= limit_mps2
        }))
    }

    /// Measures the braking of a drive.
    #[must_use]
    pub fn from_steps(steps: impl Iterator<Item = DriveStep>) -> Self {
        Self::from_steps_where(steps, |brake| {
            brake.brake_mps2 > brake.justified_mps2 + UNNECESSARY_MARGIN_MPS2
        })
    }

    /// Measures braking harder than [`HARD_BRAKE_MPS2`] where less than [`EASY_BRAKE_MPS2`] was justified.
    pub(super) fn hard_from_steps(steps: impl Iterator<Item = DriveStep>) -> Self {
        Self::from_steps_where(steps, |brake| {
            brake.brake_mps2 > HARD_BRAKE_MPS2 && brake.justified_mps2 < EASY_BRAKE_MPS2
        })
    }

    /// Returns true without unnecessary braking.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the margin of vehicle `index` to unnecessary braking, in m/s². Without unnecessary braking it is the
    /// smallest margin of the drive. With unnecessary braking it is negative: minus the largest excess. `None` if there
    /// is no such vehicle, or it never reaches [`MIN_BRAKING_SPEED_MPS`].
    pub(crate) fn margin_mps2(trace: &Trace, impacts: &[Impact], index: usize) -> Option<f64> {
        let margin =
            |brake: BrakeInstant| brake.justified_mps2 + UNNECESSARY_MARGIN_MPS2 - brake.brake_mps2;
        if let Some(hardest) = Self::from_trace(trace, impacts, index)?.hardest {
            return Some(margin(hardest));
        }
        // Excess that is too short to count is clipped to 0.
        let all = brake_instants(drive_steps(trace, impacts, index)?);
        all.map(|(_, brake)| margin(brake).max(0.0))
            .reduce(f64::min)
    }

    /// Measures all braking of sufficient duration for which the predicate holds.
    fn from_steps_where(
        steps: impl Iterator<Item = DriveStep>,
        is_unnecessary: impl Fn(&BrakeInstant) -> bool,
    ) -> Self {
        let mut sum = Self::default();
        let mut open = None::<OpenBraking>;
        for (step, brake) in brake_instants(steps).filter(|(_, brake)| is_unnecessary(brake)) {
            let until_s = step.time_s + step.duration_s;
            match &mut open {
                Some(braking) if step.time_s < braking.until_s + MIN_BRAKING_S => {
                    braking.extend(step.duration_s, brake)
                }
                _ => sum.add(open.replace(OpenBraking {
                    until_s,
                    lasted_s: step.duration_s,
                    hardest: brake,
                })),
            }
        }
        sum.add(open);
        sum
    }

    fn add(&mut self, braking: Option<OpenBraking>) {
        // The tolerance is for rounding, because times are sums of steps.
        let Some(braking) =
            braking.filter(|braking| braking.lasted_s >= MIN_BRAKING_S * (1.0 - 1e-6))
        else {
            return;
        };
        self.time_s += braking.lasted_s;
        self.count += 1;
        self.hardest = Some(self.hardest.map_or(braking.hardest, |hardest| {
            hardest.max_excess(braking.hardest)
        }));
    }
}

/// Returns actual and justified braking at each step of sufficient speed.
fn brake_instants(
    steps: impl Iterator<Item = DriveStep>,
) -> impl Iterator<Item = (DriveStep, BrakeInstant)> {
    let reference = Idm::from(&IdmSettings::default());
    let mut largest = SlidingExtreme::new(|new, old| new >= old);
    let all = steps.map(move |step| {
        let now_mps2 = step
            .ahead
            .as_ref()
            .map_or(0.0, |state| justified_mps2(&reference, state));
        let caused_mps2 = largest.push(
            now_mps2,
            step.time_s + step.duration_s,
            step.time_s - CAUSE_LASTS_S,
        );
        (
            step,
            BrakeInstant {
                time_s: step.time_s,
                brake_mps2: step.brake_mps2(),
                justified_mps2: caused_mps2,
            },
        )
    });
    all.filter(|(step, _)| step.speed_mps >= MIN_BRAKING_SPEED_MPS)
}

impl BrakeInstant {
    /// Returns the instant with the larger excess; the earlier of equals.
    fn max_excess(self, later: Self) -> Self {
        if later.brake_mps2 - later.justified_mps2 > self.brake_mps2 - self.justified_mps2 {
            later
        } else {
            self
        }
    }
}

/// Braking that may continue.
struct OpenBraking {
    until_s: f64,
    lasted_s: f64,
    hardest: BrakeInstant,
}

impl OpenBraking {
    fn extend(&mut self, held_s: f64, brake: BrakeInstant) {
        self.until_s = brake.time_s + held_s;
        self.lasted_s += held_s;
        self.hardest = self.hardest.max_excess(brake);
    }
}

/// Returns the justified deceleration of a state, in m/s², never negative: the instantaneous part of the definition of
/// [`UnnecessaryBraking`].
#[must_use]
pub fn justified_brake_mps2(state: &PairState) -> f64 {
    justified_mps2(&Idm::from(&IdmSettings::default()), state)
}

fn justified_mps2(reference: &Idm, state: &PairState) -> f64 {
    let PairState {
        gap_m,
        front_speed_mps,
        rear_speed_mps,
        front_acceleration_mps2,
        ..
    } = *state;
    let followed_mps2 = reference.interaction_brake_mps2(rear_speed_mps, [gap_m, front_speed_mps]);
    let required_mps2 = required_brake_mps2(
        gap_m,
        front_speed_mps,
        -front_acceleration_mps2,
        rear_speed_mps,
    );
    let follows =
        time_gap_s(gap_m, rear_speed_mps).is_some_and(|gap_s| gap_s <= MAX_FOLLOWING_TIME_GAP_S);
    let matched_mps2 = if follows {
        -front_acceleration_mps2
    } else {
        0.0
    };
    followed_mps2
        .max(required_mps2.unwrap_or(0.0))
        .max(matched_mps2)
}

#[cfg(test)]
mod tests;
