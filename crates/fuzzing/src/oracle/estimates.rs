//! Oracle: observations are near the true state.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::engine::Motion;
use crumple_sim::estimate::EgoTuning;
use crumple_sim::observation::{BANDWIDTH_RAD_PER_S, EstimatorKind, Neighbour, Observation};
use crumple_sim::scenario::{Driver, VehicleSpec};

const TIME_TOLERANCE_S: f64 = 1e-9;

/// Maximum error of an estimate, in standard deviations of the noise.
const MAX_DEVIATIONS: f64 = 12.0;

/// Checks that observations are finite and speeds are not negative, that the true state is observed exactly, and that
/// without lost measurements the errors of gaps and speeds stay within noise and lag. The lag is that of a third-order
/// Butterworth filter of bandwidth ω. A jump Δa of acceleration causes errors of about Δa/ω² in distance and Δa/ω in
/// speed; a jump Δv of speed causes Δv/ω and Δv. The bounds are three times as large.
///
/// # Errors
/// [`Invariant::Estimates`].
pub fn estimates_within_bounds(question: &OracleContext<'_>) -> OracleResult {
    let bounds = EstimateBounds::new(question);
    let mut finding = None;
    let tracks = question
        .result
        .trace
        .iter()
        .flat_map(|trace| &trace.vehicles);
    let in_lane_s: Vec<[f64; 2]> = tracks.map(|track| track.in_lane_s).collect();
    let vehicles = question.test_case.scenario.vehicles();
    let has_filters = question.run.options().estimator == EstimatorKind::Kalman;
    question
        .system
        .for_each_observation(&question.run, &mut |sight| {
            let now_s = sight.time_s + TIME_TOLERANCE_S;
            let truth = true_observation(sight.motion, vehicles, sight.vehicle, |vehicle| {
                in_lane_s
                    .get(vehicle)
                    .is_none_or(|&[from_s, to_s]| from_s <= now_s && now_s < to_s)
            });
            let problem = match vehicles.get(sight.vehicle) {
                Some(vehicle) if has_filters && vehicle.driver == Driver::UnderTest => {
                    bounds.find_problem(&sight.observation, &truth)
                }
                _ => (sight.observation != truth).then(|| {
                    format!(
                        "the estimate is {:?}, the truth is {truth:?}",
                        sight.observation
                    )
                }),
            };
            finding = problem.map(|problem| format!("vehicle {}: {problem}", sight.vehicle));
            finding.is_none()
        });
    ensure(finding.is_none(), Invariant::Estimates, || {
        finding.unwrap_or_default()
    })?;
    Ok(OracleOutcome::Holds)
}

fn true_observation(
    motion: &[Motion],
    vehicles: &[VehicleSpec],
    index: usize,
    is_in_lane: impl Fn(usize) -> bool,
) -> Observation {
    let own = motion.get(index);
    let ahead = (0..index)
        .rev()
        .find(|&front| is_in_lane(front) && is_in_lane(index));
    let behind = (index + 1..motion.len()).find(|&rear| is_in_lane(rear) && is_in_lane(index));
    Observation {
        speed_mps: own.map_or(f64::NAN, |own| own.speed_mps),
        acceleration_mps2: own.map_or(f64::NAN, |own| own.acceleration_mps2),
        ahead: ahead.and_then(|front| {
            let gap_m = gap_m(motion, vehicles, front, index)?;
            Some(neighbour(motion.get(front)?, gap_m))
        }),
        behind: behind.and_then(|rear| {
            let gap_m = gap_m(motion, vehicles, index, rear)?;
            Some(neighbour(motion.get(rear)?, gap_m))
        }),
    }
}

fn gap_m(motion: &[Motion], vehicles: &[VehicleSpec], front: usize, rear: usize) -> Option<f64> {
    let front_m = motion.get(front)?.position_m;
    Some(front_m - vehicles.get(front)?.length_m() - motion.get(rear)?.position_m)
}

fn neighbour(motion: &Motion, gap_m: f64) -> Neighbour {
    Neighbour {
        gap_m,
        speed_mps: motion.speed_mps,
        acceleration_mps2: motion.acceleration_mps2,
    }
}

/// Maximum errors of estimates; infinite with dropout and faults.
struct EstimateBounds {
    gap_m: f64,
    own_speed_mps: f64,
    neighbour_speed_mps: f64,
    /// True if sensors may miss vehicles and report ghosts.
    has_faults: bool,
}

impl EstimateBounds {
    fn new(question: &OracleContext<'_>) -> Self {
        let spec = question.test_case.scenario.spec();
        let has_faults = spec.sensors.faults.is_any();
        if spec.sensors.dropout > 0.0 || has_faults {
            let [gap_m, own_speed_mps, neighbour_speed_mps] = [f64::INFINITY; 3];
            return Self {
                gap_m,
                own_speed_mps,
                neighbour_speed_mps,
                has_faults,
            };
        }
        let tuning = EgoTuning::new(spec.step_s, &spec.sensors);
        let [gap_deviation_m, rate_deviation_mps, _] = tuning.gap().steady_deviations();
        let [_, own_deviation_mps, _] = tuning.position().steady_deviations();
        let tracks = question
            .result
            .trace
            .iter()
            .flat_map(|trace| &trace.vehicles);
        let accelerations = tracks.flat_map(|track| &track.acceleration_mps2);
        let hardest_mps2 = accelerations.fold(0.0_f64, |hardest, a| hardest.max(a.abs()));
        let jumps_mps: f64 = question
            .result
            .impacts
            .iter()
            .map(|impact| impact.collision.impact_speed_mps)
            .sum();
        // Worst case: the two vehicles deviate in opposite directions.
        let lag_mps = 3.0 * (2.0 * hardest_mps2 / BANDWIDTH_RAD_PER_S + jumps_mps);
        Self {
            gap_m: lag_mps / BANDWIDTH_RAD_PER_S + MAX_DEVIATIONS * gap_deviation_m,
            own_speed_mps: lag_mps + MAX_DEVIATIONS * own_deviation_mps,
            neighbour_speed_mps: 2.0 * lag_mps
                + MAX_DEVIATIONS * own_deviation_mps.hypot(rate_deviation_mps),
            has_faults,
        }
    }

    fn find_problem(&self, estimate: &Observation, truth: &Observation) -> Option<String> {
        let own_off_mps = (estimate.speed_mps - truth.speed_mps).abs();
        if !(estimate.speed_mps >= 0.0
            && estimate.acceleration_mps2.is_finite()
            && own_off_mps <= self.own_speed_mps)
        {
            return Some(format!(
                "its estimated speed is {} m/s, the truth is {} m/s",
                estimate.speed_mps, truth.speed_mps
            ));
        }
        for (estimate, truth) in [
            (estimate.ahead, truth.ahead),
            (estimate.behind, truth.behind),
        ] {
            match (estimate, truth) {
                (None, None) => {}
                (None, Some(_)) if self.has_faults => {}
                (Some(estimate), None)
                    if self.has_faults && self.contains(&estimate, &estimate) => {}
                (Some(estimate), Some(truth)) if self.contains(&estimate, &truth) => {}
                (estimate, truth) => {
                    return Some(format!(
                        "the estimate is {estimate:?}, the truth is {truth:?}"
                    ));
                }
            }
        }
        None
    }

    fn contains(&self, estimate: &Neighbour, truth: &Neighbour) -> bool {
        let finite = estimate.gap_m.is_finite()
            && estimate.speed_mps.is_finite()
            && estimate.acceleration_mps2.is_finite();
        finite
            && estimate.speed_mps >= 0.0
            && (estimate.gap_m - truth.gap_m).abs() <= self.gap_m
            && (estimate.speed_mps - truth.speed_mps).abs() <= self.neighbour_speed_mps
    }
}
