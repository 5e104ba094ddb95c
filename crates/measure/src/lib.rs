//! Surrogate safety measures of a run, and signal temporal logic ([`stl`]).
//!
//! Collisions are rare. For a run without a collision, these measures state how close it came to one; for a run with a
//! collision, how severe it was. Each pointwise formula is a function with its source. [`Approach`] applies those of a
//! pair to a trace up to its collision; [`Measures`] holds the results of one vehicle. [`UsefulnessMeasures`] states
//! whether a vehicle makes progress, and at what cost to others. [`GainSurvey`] simulates a line of vehicles, and
//! measures the growth of oscillations in it.
//!
//! All measures use the true motion, not the observations of a controller.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | `approach` | states of two successive vehicles up to their collision |
//! | `comfort` | hardest deceleration and largest jerk |
//! | `collision_role` | roles of vehicles under test in a collision |
//! | `harm` | expected number of seriously injured drivers |
//! | `severity` | impact speed and change of speed |
//! | `demand` | deceleration that avoids a collision, and braking induced in a follower |
//! | `exposure` | duration and integral of a short time to collision |
//! | `proximity` | time to collision, time headway and time gap |
//! | `gain` | growth of oscillations along a line of vehicles |
//! | `level` | hardest braking of the leader for which both sides stay safe |
//! | [`stl`] | formulas of signal temporal logic, and their monitor |
//! | `usefulness` | progress, comfort, and unnecessary braking |
//! | `recorded_drive` | drives at equal intervals, of controllers and of recorded drivers |
//! | `driving_rule` | rules of conduct towards followers and passengers |
//! | `specification` | specifications of a controller, and the robustness of a run |
//! | `run_report` | report of a run, as text and as JSON |
//! | `replay_share` | share of replays with a result |
//! | `run_total` | total of several runs |
//! | `braking_alone` | unnecessary braking that only the vehicles behind cause |

mod approach;
mod braking_alone;
mod collision_role;
mod comfort;
mod demand;
mod driving_rule;
mod exposure;
mod gain;
mod harm;
#[cfg(test)]
mod lane_tests;
mod level;
mod proximity;
mod recorded_drive;
mod replay_share;
mod run_report;
mod run_total;
mod severity;
mod specification;
pub mod stl;
#[cfg(test)]
mod testing;
mod usefulness;

use serde::{Deserialize, Serialize};

pub use approach::{Approach, PairState};
pub use braking_alone::{BrakingAloneError, BrakingAloneProblem};
pub use collision_role::CollisionRole;
pub use comfort::{JERK_WINDOW_S, peak_brake_mps2, peak_jerk_mps3};
pub use demand::{InducedBraking, drac_mps2, required_brake_mps2};
pub use driving_rule::{DrivingRule, UnknownDrivingRule};
pub use exposure::{TTC_THRESHOLD_S, TtcExposure};
pub use gain::{
    GAIN_FREQUENCIES_RAD_PER_S, GAIN_SPEEDS_MPS, GainError, GainSurvey, MeasuredGain, NoGain,
    OSCILLATION_AMPLITUDE_MPS, OperatingPoint,
};
pub use harm::{harm, harm_of_pair, injury_probability};
pub use level::{DEFAULT_CLASS_WORDS, LevelMeasures, NoLevel, describe_outside_class};
pub use proximity::{time_gap_s, time_headway_s, ttc_s};
pub use recorded_drive::{
    ACCELERATION_WINDOW_S, DriveSeries, FAR_TIME_GAP_S, MIN_FOLLOWING_MPS, MeasuredSeries,
    is_far_behind,
};
pub use replay_share::ReplayShare;
pub use run_report::{
    LaneChanges, MissingLevel, PartReport, ReportedController, RunReport, SpecificationResult,
    UnnecessaryBrakingReport,
};
pub use run_total::{PlantCollisions, RunEnd, RunFindings, RunTotal, TotalReport};
pub use severity::{impact_speed_mps, impacts_of, max_delta_v_mps};
pub use specification::{
    BrakingLevel, FirstCollision, RunVerdict, Specification, SpecificationError,
};
pub use usefulness::{
    BrakeInstant, CAUSE_LASTS_S, DriveStep, EASY_BRAKE_MPS2, FAR_BEHIND_M, FAR_BEHIND_S,
    FollowingMeasures, HARD_BRAKE_MPS2, MAX_FOLLOWING_TIME_GAP_S, MIN_BRAKING_S,
    MIN_BRAKING_SPEED_MPS, MIN_DEVIATION_MPS, MIN_MOVING_SPEED_MPS, SETTLED_TOLERANCE_MPS,
    SpeedAmplification, UNNECESSARY_MARGIN_MPS2, UnnecessaryBraking, UsefulnessMeasures,
    justified_brake_mps2,
};

use crumple_sim::engine::{Impact, Trace};

/// Measures of a run for one vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Measures {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// Measures towards the leader; `None` for the first vehicle.
    pub ahead: Option<LeadMeasures>,
    /// Braking induced in the follower; `None` for the last vehicle.
    #[serde(alias = "imposed")]
    pub induced: Option<InducedBraking>,
    /// Hardest deceleration of the run, in m/s², positive; `None` for less than two samples.
    pub peak_brake_mps2: Option<f64>,
    /// Largest change of acceleration within [`JERK_WINDOW_S`], divided by it, in m/s³; `None` for less than two
    /// samples.
    pub peak_jerk_mps3: Option<f64>,
    /// Number of impacts that involve the vehicle: it hits, is hit, or is locked to a vehicle that hits or is hit.
    pub impacts: usize,
    /// Largest change of speed in one impact, in m/s; `None` without impacts.
    pub max_delta_v_mps: Option<f64>,
}

/// Measures of a vehicle towards its leader, until their collision or the end of the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LeadMeasures {
    /// Smallest bumper gap, in metres, 0 at collision; `None` for an empty trace.
    pub min_gap_m: Option<f64>,
    /// Bumper gap at standstill of both, in metres; `None` after a collision or if one still moved at the end.
    pub standstill_gap_m: Option<f64>,
    /// Smallest time to collision, in seconds, 0 at collision; `None` if the gap never closed.
    pub min_ttc_s: Option<f64>,
    /// Smallest time from front bumper to front bumper, in seconds; `None` if the vehicle never moved.
    pub min_time_headway_s: Option<f64>,
    /// Smallest time from the leader's rear bumper to the own front bumper, in seconds; `None` if the vehicle never
    /// moved.
    pub min_time_gap_s: Option<f64>,
    /// Largest deceleration rate to avoid a crash, in m/s²; `None` if the gap never closed, and after a collision.
    pub max_drac_mps2: Option<f64>,
    /// Largest required deceleration if the leader held its braking to standstill, in m/s²; `None` after a collision.
    pub max_required_brake_mps2: Option<f64>,
    /// Duration of a time to collision below [`TTC_THRESHOLD_S`], in seconds.
    pub tet_s: f64,
    /// Integral of the shortfall of time to collision over that time, in s².
    pub tit_s2: f64,
    /// Impact speed with the leader, in m/s; `None` without a collision.
    pub impact_speed_mps: Option<f64>,
}

impl Measures {
    /// Computes the measures of vehicle `index` in a run; `None` if the trace has no such vehicle.
    ///
    /// `impacts` are those of the run. If tracks have unequal lengths, the end of the shortest is the end for all.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        let track = trace.vehicles.get(index)?;
        let samples = trace.len().min(track.acceleration_mps2.len());
        Some(Self {
            vehicle: index,
            ahead: LeadMeasures::from_trace(trace, impacts, index),
            induced: InducedBraking::from_trace(trace, impacts, index),
            peak_brake_mps2: peak_brake_mps2(track.acceleration_mps2.iter().copied().take(samples)),
            peak_jerk_mps3: peak_jerk_mps3(&trace.time_s, track, JERK_WINDOW_S),
            impacts: impacts_of(impacts, index).count(),
            max_delta_v_mps: max_delta_v_mps(impacts, index),
        })
    }
}

impl LeadMeasures {
    /// Computes the measures of vehicle `index` towards its leader; `None` for the first vehicle and for one that does
    /// not exist.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        let approach = Approach::from_trace(trace, impacts, index)?;
        let TtcExposure { tet_s, tit_s2 } = approach.ttc_exposure(TTC_THRESHOLD_S);
        Some(Self {
            min_gap_m: approach.min_gap_m(),
            standstill_gap_m: approach.standstill_gap_m(),
            min_ttc_s: approach.min_ttc_s(),
            min_time_headway_s: approach.min_time_headway_s(),
            min_time_gap_s: approach.min_time_gap_s(),
            max_drac_mps2: approach.max_drac_mps2(),
            max_required_brake_mps2: approach.max_required_brake_mps2(),
            tet_s,
            tit_s2,
            impact_speed_mps: impact_speed_mps(impacts, index),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::testing::{driven_track, impact, pair_trace, trace};
    use super::*;
    use crumple_sim::engine::Track;

    fn measure_all(trace: &Trace, impacts: &[Impact]) -> Vec<Measures> {
        (0..trace.vehicles.len())
            .filter_map(|index| Measures::from_trace(trace, impacts, index))
            .collect()
    }

    #[test]
    fn undefined_measures_are_absent() {
        let nothing = |samples: usize| Track {
            length_m: 2.0,
            mass_kg: 1500.0,
            position_m: vec![0.0; samples],
            speed_mps: vec![0.0; samples],
            acceleration_mps2: vec![0.0; samples],
            in_lane_s: Track::THROUGHOUT_S,
        };
        assert_eq!(
            measure_all(
                &Trace {
                    time_s: vec![],
                    vehicles: vec![]
                },
                &[]
            ),
            []
        );

        let empty = Trace {
            time_s: vec![],
            vehicles: vec![nothing(0), nothing(0)],
        };
        let [leader, follower] = measure_all(&empty, &[])[..] else {
            panic!("one entry a vehicle")
        };
        assert_eq!((leader.ahead, follower.induced), (None, None));
        assert_eq!(follower.ahead.unwrap().min_gap_m, None);
        assert_eq!(
            (
                follower.peak_brake_mps2,
                follower.peak_jerk_mps3,
                follower.max_delta_v_mps
            ),
            (None, None, None)
        );
        assert_eq!(Measures::from_trace(&empty, &[], 2), None);
        assert_eq!(Measures::from_trace(&empty, &[], usize::MAX), None);
    }

    #[test]
    fn measures_survive_json() {
        let pair = pair_trace(10.0, [(10.0, &[(5.0, -1.0)]), (14.0, &[(5.0, 0.0)])], 1.0);
        for measures in measure_all(&pair, &[impact(1.7, 0, 8.3, 14.0)]) {
            let json = serde_json::to_string(&measures).unwrap();
            assert_eq!(
                serde_json::from_str::<Measures>(&json).unwrap(),
                measures,
                "{json}"
            );
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Tracks that violate every invariant of a trace are measured without a panic.
        #[test]
        fn measures_of_invalid_traces_do_not_panic(
            time_s in prop::collection::vec(any::<f64>(), 0..6),
            values in prop::collection::vec(prop::collection::vec(any::<f64>(), 0..6), 9),
            (front_vehicle, rear_vehicle, collision_s) in (0..5usize, 0..5usize, any::<f64>()),
        ) {
            let vehicles = values.chunks(3).map(|values| Track {
                length_m: 4.0,
                mass_kg: 0.0,
                position_m: values[0].clone(),
                speed_mps: values[1].clone(),
                acceleration_mps2: values[2].clone(),
                in_lane_s: Track::THROUGHOUT_S,
            });
            let trace = Trace { time_s, vehicles: vehicles.collect() };
            let mut impact = impact(collision_s, front_vehicle, 1.0, 2.0);
            impact.collision.rear_vehicle = rear_vehicle;
            prop_assert_eq!(measure_all(&trace, &[impact]).len(), 3);
        }

        /// Measures do not depend on the position: with steps of a power of two, no bit changes.
        #[test]
        fn a_shift_along_the_road_changes_nothing(
            halves in prop::array::uniform3(-16..4i32),
            shift_m in -1000..1000i32,
        ) {
            let at = |shift_m: f64| {
                let vehicle = |i: usize| {
                    let at_m = shift_m - 20.0 * i as f64;
                    driven_track(4.0, at_m, 20.0, &[(0.5, 0.0), (2.0, 0.5 * f64::from(halves[i])), (4.0, -4.0)], 0.125)
                };
                measure_all(&trace((0..3).map(vehicle).collect(), 0.125), &[])
            };
            prop_assert_eq!(at(0.0), at(f64::from(shift_m)));
        }
    }
}
