//! Usability of a vehicle in traffic: progress, distance, and no unnecessary braking.
//!
//! Collisions alone are not enough to evaluate a controller, because a vehicle that stands still never hits its leader.
//! Collisions are counted in critical scenarios; these measures are evaluated in uncritical ones.

mod amplification;
mod drive;
mod unnecessary;

use serde::{Deserialize, Serialize};

pub use amplification::{MIN_DEVIATION_MPS, SETTLED_TOLERANCE_MPS, SpeedAmplification};
pub use drive::DriveStep;
use drive::drive_steps;
pub use unnecessary::{
    BrakeInstant, CAUSE_LASTS_S, EASY_BRAKE_MPS2, HARD_BRAKE_MPS2, MAX_FOLLOWING_TIME_GAP_S,
    MIN_BRAKING_S, MIN_BRAKING_SPEED_MPS, UNNECESSARY_MARGIN_MPS2, UnnecessaryBraking,
    justified_brake_mps2,
};

use super::comfort::JERK_WINDOW_S;
use super::demand::InducedBraking;
use super::proximity::time_gap_s;
use crumple_sim::engine::{Impact, Trace};

/// Speed above which a vehicle moves, in m/s. Below it a time gap has no meaning, and falling behind a leader does not
/// count.
pub const MIN_MOVING_SPEED_MPS: f64 = 1.0;

/// Distance that counts as falling far behind, in metres, plus [`FAR_BEHIND_S`] times the leader's speed.
pub const FAR_BEHIND_M: f64 = 20.0;
/// Time gap that counts as falling far behind, in seconds: twice the one up to which a vehicle follows.
pub const FAR_BEHIND_S: f64 = 2.0 * MAX_FOLLOWING_TIME_GAP_S;

/// Usability measures of a vehicle before its first impact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UsefulnessMeasures {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// Unnecessary braking.
    #[serde(alias = "needless")]
    pub unnecessary: UnnecessaryBraking,
    /// Braking harder than [`HARD_BRAKE_MPS2`] where less than [`EASY_BRAKE_MPS2`] was justified.
    pub hard: UnnecessaryBraking,
    /// Measures of following the leader; `None` for the first vehicle.
    pub following: Option<FollowingMeasures>,
    /// Root mean square of acceleration, in m/s²; `None` for less than two samples.
    pub rms_acceleration_mps2: Option<f64>,
    /// Root mean square of the change of acceleration within [`JERK_WINDOW_S`], divided by that time, in m/s³; `None`
    /// for a shorter drive.
    pub rms_jerk_mps3: Option<f64>,
    /// Braking induced in the follower, until their collision; `None` for the last vehicle.
    #[serde(alias = "imposed")]
    pub induced: Option<InducedBraking>,
}

/// Measures of following a leader.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FollowingMeasures {
    /// Distance driven, relative to that of the leader; `None` if the leader did not move.
    pub progress: Option<f64>,
    /// Mean time gap while moving, in seconds; `None` if the vehicle never moved.
    pub mean_time_gap_s: Option<f64>,
    /// Standard deviation of the time gap while moving, in seconds.
    pub time_gap_deviation_s: Option<f64>,
    /// True if the vehicle ended below half the speed of its moving leader, or farther behind it than it started and
    /// than [`FAR_BEHIND_M`] plus [`FAR_BEHIND_S`] times the leader's speed.
    #[serde(alias = "left_behind")]
    pub fell_behind: bool,
}

impl UsefulnessMeasures {
    /// Computes the measures of vehicle `index`; `None` if there is no such vehicle. `impacts` are those of the run.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        let steps: Vec<DriveStep> = drive_steps(trace, impacts, index)?.collect();
        Some(Self {
            induced: InducedBraking::from_trace(trace, impacts, index),
            ..Self::from_steps(index, &steps)
        })
    }

    /// Computes the measures of vehicle `vehicle` from the steps of its drive, without braking induced in the follower.
    #[must_use]
    pub fn from_steps(vehicle: usize, steps: &[DriveStep]) -> Self {
        let squares = steps
            .iter()
            .map(|step| (step.acceleration_mps2.powi(2), step.duration_s));
        Self {
            vehicle,
            unnecessary: UnnecessaryBraking::from_steps(steps.iter().copied()),
            hard: UnnecessaryBraking::hard_from_steps(steps.iter().copied()),
            following: FollowingMeasures::from_steps(steps),
            rms_acceleration_mps2: time_weighted_mean(squares).map(f64::sqrt),
            rms_jerk_mps3: rms_jerk_mps3(steps),
            induced: None,
        }
    }
}

impl FollowingMeasures {
    fn from_steps(steps: &[DriveStep]) -> Option<Self> {
        let ahead = || steps.iter().filter_map(|step| Some((step, step.ahead?)));
        let first_gap_m = ahead().next()?.1.gap_m;
        let last = ahead().next_back()?.1;
        let far_m = first_gap_m.max(FAR_BEHIND_M + FAR_BEHIND_S * last.front_speed_mps);
        let mut own_m = 0.0;
        let mut ahead_m = 0.0;
        for (step, ahead) in ahead() {
            let duration_s = step.duration_s;
            own_m += distance_m(step.speed_mps, step.acceleration_mps2, duration_s);
            ahead_m += distance_m(
                ahead.front_speed_mps,
                ahead.front_acceleration_mps2,
                duration_s,
            );
        }
        let moving = ahead().filter(|(step, _)| step.speed_mps > MIN_MOVING_SPEED_MPS);
        let gaps = moving.filter_map(|(step, ahead)| {
            Some((time_gap_s(ahead.gap_m, step.speed_mps)?, step.duration_s))
        });
        let mean_time_gap_s = time_weighted_mean(gaps.clone());
        let variance_s2 = mean_time_gap_s.and_then(|mean_s| {
            time_weighted_mean(gaps.map(|(gap_s, held_s)| ((gap_s - mean_s).powi(2), held_s)))
        });
        Some(Self {
            progress: Some(own_m / ahead_m).filter(|_| ahead_m > 0.0),
            mean_time_gap_s,
            time_gap_deviation_s: variance_s2.map(f64::sqrt),
            fell_behind: last.front_speed_mps > MIN_MOVING_SPEED_MPS
                && (last.rear_speed_mps < 0.5 * last.front_speed_mps || last.gap_m > far_m),
        })
    }
}

fn distance_m(speed_mps: f64, acceleration_mps2: f64, duration_s: f64) -> f64 {
    (speed_mps + 0.5 * acceleration_mps2 * duration_s).max(0.0) * duration_s
}

/// Returns the mean of values weighted by their durations; `None` for a duration of 0.
fn time_weighted_mean(values: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut sum = 0.0;
    let mut total_s = 0.0;
    for (value, duration_s) in values {
        sum += value * duration_s;
        total_s += duration_s;
    }
    (total_s > 0.0).then_some(sum / total_s)
}

/// Returns the root mean square of jerk, in m/s³: the change of acceleration between steps that start a window apart,
/// divided by the window. [`peak_jerk_mps3`](super::peak_jerk_mps3) returns the largest change within a window.
fn rms_jerk_mps3(steps: &[DriveStep]) -> Option<f64> {
    // The tolerance is for rounding, because times are sums of steps.
    let window_s = JERK_WINDOW_S * (1.0 - 1e-6);
    let mut earlier = steps.iter().peekable();
    let first_s = steps.first()?.time_s;
    let changes = steps
        .iter()
        .filter(|step| step.time_s - first_s >= window_s)
        .filter_map(|step| {
            let since_s = step.time_s - window_s;
            while earlier
                .peek()
                .is_some_and(|before| before.time_s + before.duration_s <= since_s)
            {
                earlier.next();
            }
            let before = earlier.peek()?;
            Some((
                ((step.acceleration_mps2 - before.acceleration_mps2) / JERK_WINDOW_S).powi(2),
                step.duration_s,
            ))
        });
    time_weighted_mean(changes).map(f64::sqrt)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{driven_track, trace};
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::PaperDistribution;

    #[test]
    fn how_a_vehicle_follows_by_hand() {
        // Ahead 20 m/s throughout: 40 m in 2 s. Behind 20 m/s for 1 s, then -8 m/s² to 12 m/s: 20 + 16 m.
        // Gaps at 0, 0.5, 1, 1.5 s: 20, 20, 20, 21 m at 20, 20, 20, 16 m/s: 1, 1, 1, 1.3125 s.
        let front = driven_track(4.0, 24.0, 20.0, &[(2.0, 0.0)], 0.5);
        let rear = driven_track(4.0, 0.0, 20.0, &[(1.0, 0.0), (1.0, -8.0)], 0.5);
        let measures =
            UsefulnessMeasures::from_trace(&trace(vec![front, rear], 0.5), &[], 1).unwrap();
        let following = measures.following.unwrap();
        let near = |value: Option<f64>, by_hand: f64| (value.unwrap() - by_hand).abs() < 1e-12;
        assert!(near(following.progress, 0.9));
        assert!(near(following.mean_time_gap_s, 1.078_125));
        assert!(near(
            following.time_gap_deviation_s,
            (0.3125_f64.powi(2) * 3.0 / 16.0).sqrt()
        ));
        assert!(!following.fell_behind);
        assert!(near(measures.rms_acceleration_mps2, 32.0_f64.sqrt()));
        assert!(measures.unnecessary.count == 1 && measures.induced.is_none());
        // Steps of 0.5 s exceed the window, so that one of three contains the jump of 8 m/s².
        assert!(near(
            measures.rms_jerk_mps3,
            (8.0_f64.powi(2) / 3.0).sqrt() / JERK_WINDOW_S
        ));

        let following_of = |front, rear| {
            UsefulnessMeasures::from_trace(&trace(vec![front, rear], 0.5), &[], 1)
                .unwrap()
                .following
                .unwrap()
        };
        let steady =
            |position_m, speed_mps| driven_track(4.0, position_m, speed_mps, &[(1.0, 0.0)], 0.5);
        let following = following_of(steady(0.0, 0.0), steady(0.0, 0.0));
        assert_eq!(
            (
                following.progress,
                following.mean_time_gap_s,
                following.fell_behind
            ),
            (None, None, false)
        );
        assert!(following_of(steady(9.0, 20.0), steady(0.0, 9.0)).fell_behind);
        // Behind a leader at 20 m/s the limit is 140 m. The gap grows by 1.5 m until the last step starts.
        for (front_m, own_mps, fell_behind) in [
            (143.0, 17.0, true),
            (141.0, 17.0, false),
            (203.0, 20.0, false),
        ] {
            let following = following_of(steady(front_m, 20.0), steady(0.0, own_mps));
            assert_eq!(following.fell_behind, fell_behind, "{front_m} m");
        }
    }

    #[test]
    fn jerk_of_a_ramp_is_its_slope() {
        // 3 m/s³ in steps of 0.01 s: the change within a window is 0.3 m/s².
        let stairs: Vec<_> = (0..200).map(|k| (0.01, -0.03 * f64::from(k))).collect();
        let alone = trace(vec![driven_track(4.0, 0.0, 30.0, &stairs, 0.01)], 0.01);
        let measures = UsefulnessMeasures::from_trace(&alone, &[], 0).unwrap();
        assert!(
            (measures.rms_jerk_mps3.unwrap() - 3.0).abs() < 1e-9,
            "{measures:?}"
        );
    }

    /// The reference driver never brakes unnecessarily by its own measure, even with sensors and in an emergency.
    #[test]
    fn the_reference_driver_never_brakes_unnecessarily() {
        for index in 0..20 {
            let scenario = PaperDistribution { seed: 5 }.draw(index).unwrap();
            let run = Run::new(
                &scenario,
                RunOptions::new(BuiltInController::from_name("idm").unwrap()),
            )
            .unwrap();
            let result = simulate(&run, RecordingLevel::Trace);
            let measures =
                UsefulnessMeasures::from_trace(&result.trace.unwrap(), &result.impacts, 1).unwrap();
            assert!(
                measures.unnecessary.is_empty() && measures.hard.is_empty(),
                "{measures:?}"
            );
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Measures do not depend on the position, survive JSON, and exist for any motion.
        #[test]
        fn a_shift_along_the_road_changes_nothing(
            halves in prop::collection::vec(-9..4i32, 6),
            shift_m in -1000..1000i32,
        ) {
            let at = |shift_m: f64| {
                let vehicle = |i: usize| {
                    let pieces: Vec<_> = halves[2 * i..2 * i + 2].iter().map(|&a| (2.0, 0.5 * f64::from(a))).collect();
                    driven_track(4.0, shift_m - 20.0 * i as f64, 20.0, &pieces, 0.125)
                };
                let line = trace((0..3).map(vehicle).collect(), 0.125);
                (0..3).map(|index| UsefulnessMeasures::from_trace(&line, &[], index).unwrap()).collect::<Vec<_>>()
            };
            let measures = at(0.0);
            prop_assert_eq!(&measures, &at(f64::from(shift_m)));
            let json = serde_json::to_string(&measures).unwrap();
            prop_assert_eq!(&serde_json::from_str::<Vec<UsefulnessMeasures>>(&json).unwrap(), &measures);
        }
    }
}
