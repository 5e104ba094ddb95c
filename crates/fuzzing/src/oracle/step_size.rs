//! Oracle: the integration step has no influence.

use super::{OracleContext, OracleOutcome, OracleResult, ensure, is_grazing};
use crate::Invariant;
use crumple_sim::engine::{RecordingLevel, Run, SimulationResult, Trace};
use crumple_sim::scenario::ScenarioSpec;

const REFINEMENT: usize = 10;
/// Tolerance for equal positions, in metres. It covers rounding over some hundred steps.
const TOLERANCE_M: f64 = 1e-7;
/// Disturbances, in metres and m/s: far above rounding, far below the resolution of sensors.
const DISTURBANCES: [f64; 2] = [1e-8, -1e-8];
/// A disturbance explains a difference if its effect is at least this fraction of it.
const EXPLAINED_SHARE: f64 = 0.01;

/// Checks that a ten times finer integration gives the same motion, and that accelerations are held between decisions.
/// Controllers, sensors and noise act at the same times in both runs.
///
/// Rounding may cross a threshold at one step size and not at the other, and a policy rounds to single precision. The
/// check therefore compares the difference with the effect of a disturbance of 10 nm. If the disturbance explains the
/// difference, the outcome is undecided.
///
/// # Errors
/// [`Invariant::StepSize`].
pub fn step_size_changes_nothing(question: &OracleContext<'_>) -> OracleResult {
    let run = &question.run;
    let coarse = &question.result;
    let options = run
        .options()
        .clone()
        .with_dt_s(run.dt_s() / REFINEMENT as f64);
    let fine_run = Run::new(run.scenario(), options)
        .map_err(|error| (Invariant::StepSize, error.to_string()))?;
    let fine = question.system.simulate(&fine_run, RecordingLevel::Trace);
    let Some(fine_trace) = &fine.trace else {
        return Err((Invariant::StepSize, "no trace was recorded".to_owned()));
    };
    check_held_accelerations(fine_trace, &fine, fine_run.substeps())
        .map_err(|finding| (Invariant::StepSize, finding))?;
    if is_grazing(coarse) || is_grazing(&fine) {
        return Ok(OracleOutcome::Undecided);
    }
    let apart_m = max_distance_m(coarse, &fine, REFINEMENT);
    if apart_m < TOLERANCE_M {
        return Ok(OracleOutcome::Holds);
    }
    let explained = is_started_by_noise(question, fine_trace)
        || disturbance_effect_m(question) >= EXPLAINED_SHARE * apart_m;
    ensure(explained, Invariant::StepSize, || {
        format!(
            "{apart_m} m apart; {:?} became {:?}",
            coarse.outcome, fine.outcome
        )
    })?;
    Ok(OracleOutcome::Undecided)
}

/// Checks that accelerations change only at the start of a scenario step or at an impact.
fn check_held_accelerations(
    trace: &Trace,
    result: &SimulationResult,
    substeps: usize,
) -> Result<(), String> {
    let impacts_s: Vec<f64> = result
        .impacts
        .iter()
        .map(|impact| impact.collision.time_s)
        .collect();
    for (vehicle, track) in trace.vehicles.iter().enumerate() {
        for (step, (accelerations, times)) in track
            .acceleration_mps2
            .chunks_exact(substeps)
            .zip(trace.time_s.chunks_exact(substeps))
            .enumerate()
        {
            let Some((&from_s, &to_s)) = times.first().zip(times.last()) else {
                continue;
            };
            let collided = impacts_s
                .iter()
                .any(|t| (from_s - 1e-9..=to_s + (to_s - from_s) + 1e-9).contains(t));
            let first = accelerations.first();
            if !collided && accelerations.iter().any(|a| Some(a) != first) {
                return Err(format!(
                    "vehicle {vehicle} changes its acceleration within step {step}, {from_s} s"
                ));
            }
        }
    }
    Ok(())
}

/// Returns the largest distance of two runs at the samples of the first or at impacts, in metres; infinite if different
/// vehicles collide.
fn max_distance_m(coarse: &SimulationResult, fine: &SimulationResult, refinement: usize) -> f64 {
    if colliding_vehicles(coarse) != colliding_vehicles(fine) {
        return f64::INFINITY;
    }
    let impacts = coarse
        .impacts
        .iter()
        .zip(&fine.impacts)
        .map(|(coarse, fine)| {
            let apart_s = (coarse.collision.time_s - fine.collision.time_s).abs();
            // The impact time is a root of the gap: at low speed, a small error in distance is a large error in time.
            if apart_s < 1e-9 {
                0.0
            } else {
                10.0 * apart_s * coarse.collision.impact_speed_mps.abs()
            }
        });
    let impacts_m = impacts.fold(0.0, f64::max);
    let Some((coarse, fine)) = coarse.trace.as_ref().zip(fine.trace.as_ref()) else {
        return f64::INFINITY;
    };
    let tracks = coarse.vehicles.iter().zip(&fine.vehicles);
    let samples = tracks.flat_map(|(coarse_track, fine_track)| {
        // The last sample of either run may be the time of a collision.
        let samples = coarse_track
            .position_m
            .iter()
            .zip(fine_track.position_m.iter().step_by(refinement));
        samples.take(coarse.len().saturating_sub(1))
    });
    samples
        .map(|(x, y)| (x - y).abs())
        .fold(impacts_m, f64::max)
}

/// Returns the rear, the first and the last vehicle of each impact.
fn colliding_vehicles(result: &SimulationResult) -> Vec<[usize; 3]> {
    result
        .impacts
        .iter()
        .map(|impact| {
            [
                impact.collision.rear_vehicle,
                impact.first_involved,
                impact.last_involved,
            ]
        })
        .collect()
}

/// True if the vehicle whose motion differs first was at rest and has noise. A vehicle at rest gets no noise unless it
/// commands motion. A command as small as a rounding error is enough, so rounding can decide whether noise moves it.
fn is_started_by_noise(question: &OracleContext<'_>, fine: &Trace) -> bool {
    let Some(coarse) = &question.result.trace else {
        return false;
    };
    let first_differences = coarse
        .vehicles
        .iter()
        .zip(&fine.vehicles)
        .enumerate()
        .filter_map(|(index, (track, fine))| {
            let fine_mps = fine.speed_mps.iter().step_by(REFINEMENT);
            let differs = track
                .speed_mps
                .iter()
                .zip(fine_mps)
                .position(|(v, w)| (v - w).abs() > TOLERANCE_M)?;
            Some((differs, index))
        });
    let Some((sample, index)) = first_differences.min() else {
        return false;
    };
    let before_mps = sample
        .checked_sub(1)
        .and_then(|before| coarse.vehicles.get(index)?.speed_mps.get(before));
    let noisy = question
        .test_case
        .scenario
        .vehicles()
        .get(index)
        .is_some_and(|v| v.acceleration_noise_mps2 > 0.0);
    noisy && before_mps == Some(&0.0)
}

/// Returns the largest change of the run if all gaps or all speeds are disturbed, in metres.
fn disturbance_effect_m(question: &OracleContext<'_>) -> f64 {
    let scenario = &question.test_case.scenario;
    let disturbed = DISTURBANCES.into_iter().flat_map(|by| {
        [
            scenario.edited(|spec| disturb_gaps(spec, by)),
            scenario.edited(|spec| disturb_speeds(spec, by)),
        ]
    });
    let effects_m = disturbed.flatten().filter_map(|disturbed| {
        let run = Run::new(&disturbed, question.run.options().clone()).ok()?;
        Some(max_distance_m(
            &question.result,
            &question.system.simulate(&run, RecordingLevel::Trace),
            1,
        ))
    });
    effects_m.fold(0.0, f64::max)
}

fn disturb_gaps(spec: &mut ScenarioSpec, by_m: f64) {
    for (vehicle, index) in spec.vehicles.iter_mut().zip(0_u32..) {
        vehicle.position_m -= by_m * f64::from(index);
    }
}

/// Changes the speeds of followers, each more than that of its leader, so that closing speeds change.
fn disturb_speeds(spec: &mut ScenarioSpec, by_mps: f64) {
    for (vehicle, index) in spec.vehicles.iter_mut().zip(0_u32..).skip(1) {
        vehicle.speed_mps = (vehicle.speed_mps + by_mps * f64::from(index)).max(0.0);
    }
}

/// Checks that two runs have the same impacts, except for a shift of vehicle indices and of time. Rounding moves
/// positions by about 1e-11 m, so the tolerance of impact times is larger at lower impact speeds.
///
/// # Errors
/// The first difference.
pub fn check_same_impacts(
    before: &SimulationResult,
    after: &SimulationResult,
    shift: usize,
    shift_s: f64,
) -> Result<(), String> {
    if before.impacts.len() != after.impacts.len() {
        return Err(format!("{:?} became {:?}", before.outcome, after.outcome));
    }
    for (before, after) in before.impacts.iter().zip(&after.impacts) {
        let vehicles = [
            before.collision.front_vehicle,
            before.first_involved,
            before.last_involved,
        ];
        let same = vehicles.map(|vehicle| vehicle + shift)
            == [
                after.collision.front_vehicle,
                after.first_involved,
                after.last_involved,
            ];
        let apart_s = (before.collision.time_s + shift_s - after.collision.time_s).abs();
        let limit_s = (1e-8 / before.collision.impact_speed_mps).clamp(1e-9, 1e-3);
        if !same || apart_s.is_nan() || apart_s > limit_s {
            return Err(format!("{before:?} became {after:?}, {apart_s} s apart"));
        }
    }
    Ok(())
}
