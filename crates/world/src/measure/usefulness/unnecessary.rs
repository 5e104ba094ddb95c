//! Unnecessary braking.

use serde::{Deserialize, Serialize};

use super::drive::{DriveStep, drive_steps};
use crate::control::{Idm, IdmSettings};
use crate::measure::approach::PairState;
use crate::measure::comfort::SlidingExtreme;
use crate::measure::demand::required_brake_mps2;
use crate::measure::proximity::time_gap_s;
use crate::sim::{Impact, Trace};

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
    #[serde(rename = "caused_mps2")]
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
    pub fn from_trace_above_limit(limit_mps2: f64, trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        let exceeds_limit = |brake: &BrakeInstant| brake.brake_mps2 > limit_mps2 && brake.justified_mps2 <= limit_mps2;
        drive_steps(trace, impacts, index).map(|steps| Self::from_steps_where(steps, exceeds_limit))
    }

    /// Measures the braking of a drive.
    #[must_use]
    pub fn from_steps(steps: impl Iterator<Item = DriveStep>) -> Self {
        Self::from_steps_where(steps, |brake| brake.brake_mps2 > brake.justified_mps2 + UNNECESSARY_MARGIN_MPS2)
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
    pub(in crate::measure) fn margin_mps2(trace: &Trace, impacts: &[Impact], index: usize) -> Option<f64> {
        let margin = |brake: BrakeInstant| brake.justified_mps2 + UNNECESSARY_MARGIN_MPS2 - brake.brake_mps2;
        if let Some(hardest) = Self::from_trace(trace, impacts, index)?.hardest {
            return Some(margin(hardest));
        }
        // Excess that is too short to count is clipped to 0.
        let all = brake_instants(drive_steps(trace, impacts, index)?);
        all.map(|(_, brake)| margin(brake).max(0.0)).reduce(f64::min)
    }

    /// Measures all braking of sufficient duration for which the predicate holds.
    fn from_steps_where(
        steps: impl Iterator<Item = DriveStep>,
        is_unnecessary: impl Fn(&BrakeInstant) -> bool,
    ) -> Self {
        let (mut sum, mut open) = (Self::default(), None::<OpenBraking>);
        for (step, brake) in brake_instants(steps).filter(|(_, brake)| is_unnecessary(brake)) {
            let until_s = step.time_s + step.duration_s;
            match &mut open {
                Some(braking) if step.time_s < braking.until_s + MIN_BRAKING_S => {
                    braking.extend(step.duration_s, brake)
                }
                _ => sum.add(open.replace(OpenBraking { until_s, lasted_s: step.duration_s, hardest: brake })),
            }
        }
        sum.add(open);
        sum
    }

    fn add(&mut self, braking: Option<OpenBraking>) {
        // The tolerance is for rounding, because times are sums of steps.
        let Some(braking) = braking.filter(|braking| braking.lasted_s >= MIN_BRAKING_S * (1.0 - 1e-6)) else {
            return;
        };
        self.time_s += braking.lasted_s;
        self.count += 1;
        self.hardest = Some(self.hardest.map_or(braking.hardest, |hardest| hardest.max_excess(braking.hardest)));
    }
}

/// Returns actual and justified braking at each step of sufficient speed.
fn brake_instants(steps: impl Iterator<Item = DriveStep>) -> impl Iterator<Item = (DriveStep, BrakeInstant)> {
    let reference = Idm::from(&IdmSettings::default());
    let mut largest = SlidingExtreme::new(|new, old| new >= old);
    let all = steps.map(move |step| {
        let now_mps2 = step.ahead.as_ref().map_or(0.0, |state| justified_mps2(&reference, state));
        let caused_mps2 = largest.push(now_mps2, step.time_s + step.duration_s, step.time_s - CAUSE_LASTS_S);
        (step, BrakeInstant { time_s: step.time_s, brake_mps2: step.brake_mps2(), justified_mps2: caused_mps2 })
    });
    all.filter(|(step, _)| step.speed_mps >= MIN_BRAKING_SPEED_MPS)
}

impl BrakeInstant {
    /// Returns the instant with the larger excess; the earlier of equals.
    fn max_excess(self, later: Self) -> Self {
        if later.brake_mps2 - later.justified_mps2 > self.brake_mps2 - self.justified_mps2 { later } else { self }
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
    let PairState { gap_m, front_speed_mps, rear_speed_mps, front_acceleration_mps2, .. } = *state;
    let followed_mps2 = reference.interaction_brake_mps2(rear_speed_mps, [gap_m, front_speed_mps]);
    let required_mps2 = required_brake_mps2(gap_m, front_speed_mps, -front_acceleration_mps2, rear_speed_mps);
    let follows = time_gap_s(gap_m, rear_speed_mps).is_some_and(|gap_s| gap_s <= MAX_FOLLOWING_TIME_GAP_S);
    let matched_mps2 = if follows { -front_acceleration_mps2 } else { 0.0 };
    followed_mps2.max(required_mps2.unwrap_or(0.0)).max(matched_mps2)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::measure::testing::{driven_track, impact, trace};

    /// Creates a trace of a vehicle at 20 m/s, 200 m behind a leader of that speed.
    fn steady_leader_trace(pieces: &[(f64, f64)]) -> Trace {
        let total_s = pieces.iter().map(|(held_s, _)| held_s).sum();
        let front = driven_track(4.0, 204.0, 20.0, &[(total_s, 0.0)], 0.05);
        trace(vec![front, driven_track(4.0, 0.0, 20.0, pieces, 0.05)], 0.05)
    }

    /// Demand of the reference driver at the start: (2 + 1.6 * 20)² / 200² of 0.73 m/s².
    const JUSTIFIED_MPS2: f64 = 0.73 * 34.0 * 34.0 / (200.0 * 200.0);

    #[test]
    fn braking_without_cause_by_hand() {
        let unnecessary =
            |pieces: &[(f64, f64)]| UnnecessaryBraking::from_trace(&steady_leader_trace(pieces), &[], 1).unwrap();
        let found = unnecessary(&[(1.0, 0.0), (0.5, -5.0), (1.0, 0.0), (0.3, -2.5), (0.5, 0.0)]);
        let hardest = found.hardest.unwrap();
        assert!((found.time_s - 0.8).abs() < 1e-9 && found.count == 2, "{found:?}");
        assert_eq!((hardest.brake_mps2, hardest.time_s), (5.0, 1.0));
        assert!((hardest.justified_mps2 - JUSTIFIED_MPS2).abs() < 1e-12);
        assert!(unnecessary(&[(1.0, -2.0)]).is_empty(), "within the margin");
        assert!(unnecessary(&[(0.5, 0.0), (0.15, -7.0), (0.5, 0.0)]).is_empty(), "too short");
        let bursts = unnecessary(&[(0.5, 0.0), (0.1, -7.0), (0.1, 0.0), (0.1, -7.0), (0.5, 0.0)]);
        assert!((bursts.time_s - 0.2).abs() < 1e-9 && bursts.count == 1, "{bursts:?}");
        assert_eq!(UnnecessaryBraking::from_trace(&steady_leader_trace(&[(1.0, 0.0)]), &[], 2), None);
    }

    #[test]
    fn braking_harder_than_a_limit_without_cause_by_hand() {
        let harder = |limit_mps2: f64, pieces: &[(f64, f64)]| {
            UnnecessaryBraking::from_trace_above_limit(limit_mps2, &steady_leader_trace(pieces), &[], 1).unwrap().count
        };
        assert_eq!(harder(2.0, &[(0.5, 0.0), (0.5, -2.1), (1.0, 0.0), (0.5, -5.0)]), 2, "no margin");
        assert_eq!(harder(2.0, &[(0.5, 0.0), (0.5, -2.0)]), 0, "no harder");
        assert_eq!(harder(2.0, &[(0.5, 0.0), (0.15, -7.0), (0.5, 0.0)]), 0, "too short");
        assert_eq!(harder(0.9 * JUSTIFIED_MPS2, &[(0.5, -0.1)]), 0, "that much had a cause");
        assert_eq!(UnnecessaryBraking::from_trace_above_limit(2.0, &steady_leader_trace(&[(1.0, 0.0)]), &[], 2), None);
    }

    #[test]
    fn an_emergency_justifies_braking_and_motion_after_an_impact_is_ignored() {
        // Half a second behind a leader that brakes at 8 m/s², less suffices: 20² / (2 * (10 + 25)) = 5.7 m/s².
        let front = driven_track(4.0, 14.0, 20.0, &[(3.0, -8.0)], 0.05);
        let rear = driven_track(4.0, 0.0, 20.0, &[(3.0, -7.6)], 0.05);
        assert!(UnnecessaryBraking::from_trace(&trace(vec![front, rear], 0.05), &[], 1).unwrap().is_empty());
        let mut hit = impact(1.0, 1, 20.0, 25.0);
        (hit.first_involved, hit.last_involved) = (1, 2);
        let braking = steady_leader_trace(&[(1.0, 0.0), (2.0, -7.0)]);
        let is_empty = |impacts: &[Impact]| UnnecessaryBraking::from_trace(&braking, impacts, 1).unwrap().is_empty();
        assert!(is_empty(&[hit]) && !is_empty(&[]), "hit from behind before it braked");
    }

    #[test]
    fn without_a_leader_no_braking_is_justified() {
        let alone = trace(vec![driven_track(4.0, 0.0, 20.0, &[(1.0, -3.0)], 0.05)], 0.05);
        let UnnecessaryBraking { time_s, count, hardest } = UnnecessaryBraking::from_trace(&alone, &[], 0).unwrap();
        assert!((time_s - 1.0).abs() < 1e-9 && count == 1);
        assert_eq!(hardest, Some(BrakeInstant { time_s: 0.0, brake_mps2: 3.0, justified_mps2: 0.0 }));
    }

    proptest! {
        /// A vehicle that does not brake does not brake unnecessarily. The measured time is at most the time for which
        /// braking exceeds the margin. Finer steps give the same time, up to one coarse step at each change of
        /// acceleration and a few brakings near the minimum duration.
        #[test]
        fn braking_without_cause_is_braking(
            gap_m in 20.0..90.0f64,
            own in prop::collection::vec(-7.0..2.0f64, 6),
            front in prop::collection::vec(-4.0..2.0f64, 6),
        ) {
            let pieces = |a: &[f64]| a.iter().map(|&a| (0.5, a)).collect::<Vec<_>>();
            let line = |own: &[f64], step_s: f64| {
                let front = driven_track(4.0, gap_m + 4.0, 25.0, &pieces(&front), step_s);
                trace(vec![front, driven_track(4.0, 0.0, 25.0, &pieces(own), step_s)], step_s)
            };
            let unnecessary = |own: &[f64], step_s| UnnecessaryBraking::from_trace(&line(own, step_s), &[], 1).unwrap();
            let coasting: Vec<f64> = own.iter().map(|a| a.max(0.0)).collect();
            prop_assert!(unnecessary(&coasting, 0.05).is_empty());
            let (rough, fine) = (unnecessary(&own, 0.05), unnecessary(&own, 0.01));
            let beyond_s = 0.5 * own.iter().filter(|a| **a < -UNNECESSARY_MARGIN_MPS2).count() as f64;
            prop_assert!(rough.time_s <= beyond_s + 1e-9);
            prop_assert!((rough.time_s - fine.time_s).abs() <= 6.0 * 0.05 + 3.0 * MIN_BRAKING_S, "{rough:?} {fine:?}");
            if let Some(hardest) = rough.hardest {
                prop_assert!(hardest.brake_mps2 - hardest.justified_mps2 > UNNECESSARY_MARGIN_MPS2);
                prop_assert!(hardest.justified_mps2 >= 0.0);
            }
        }
    }
}
