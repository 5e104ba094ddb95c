//! How finely motion is integrated decides nothing.

use super::{OracleContext, OracleOutcome, OracleResult, ensure, is_grazing};
use crate::Invariant;
use crumple_world::scenario::ScenarioSpec;
use crumple_world::sim::{Impact, RecordingLevel, Run, SimulationResult, Trace};

/// How much finer the second integration is.
const REFINEMENT: usize = 10;
/// How far two equal motions may be apart, in metres: rounding, over some hundred steps.
const TOLERANCE_M: f64 = 1e-7;
/// Disturbances, in metres and m/s: far above rounding, far below anything a sensor sees.
const DISTURBANCES: [f64; 2] = [1e-8, -1e-8];
/// A run that a disturbance throws off by a hundredth of what was found explains what was found.
const EXPLAINED_SHARE: f64 = 0.01;

/// Ten times finer integration, with controllers, sensors and noise at the same instants, is the same motion, and
/// accelerations are held from one such instant to the next.
///
/// A threshold that is met within rounding may be crossed at one step and not at another, and a learned driver rounds to
/// single precision. What two integrations differ by is therefore compared with what a disturbance of 10 nm does: a run
/// that it throws off its way as well decides nothing.
///
/// # Errors
/// [`Law::StepSize`].
pub fn step_size_changes_nothing(question: &OracleContext<'_>) -> OracleResult {
    let (run, coarse) = (&question.run, &question.result);
    let options = run.options().clone().with_dt_s(run.dt_s() / REFINEMENT as f64);
    let fine_run = Run::new(run.scenario(), options).map_err(|error| (Invariant::StepSize, error.to_string()))?;
    let fine = question.system.simulate(&fine_run, RecordingLevel::Trace);
    let Some(fine_trace) = &fine.trace else { return Err((Invariant::StepSize, "no trace was kept".to_owned())) };
    check_held_accelerations(fine_trace, &fine, fine_run.substeps())
        .map_err(|finding| (Invariant::StepSize, finding))?;
    if is_grazing(coarse) || is_grazing(&fine) {
        return Ok(OracleOutcome::Undecided);
    }
    let apart_m = max_distance_m(coarse, &fine, REFINEMENT);
    if apart_m < TOLERANCE_M {
        return Ok(OracleOutcome::Holds);
    }
    let explained =
        is_started_by_noise(question, fine_trace) || disturbance_effect_m(question) >= EXPLAINED_SHARE * apart_m;
    ensure(explained, Invariant::StepSize, || {
        format!("{apart_m} m apart; {:?} became {:?}", coarse.outcome, fine.outcome)
    })?;
    Ok(OracleOutcome::Undecided)
}

/// Whether accelerations change only where a step of the scenario begins, or vehicles touch.
fn check_held_accelerations(trace: &Trace, result: &SimulationResult, substeps: usize) -> Result<(), String> {
    let impacts_s: Vec<f64> = result.impacts.iter().map(|impact| impact.contact.time_s).collect();
    for (vehicle, track) in trace.vehicles.iter().enumerate() {
        for (step, (held, times)) in
            track.acceleration_mps2.chunks_exact(substeps).zip(trace.time_s.chunks_exact(substeps)).enumerate()
        {
            let (Some(&from_s), Some(&to_s)) = (times.first(), times.last()) else { continue };
            let touched = impacts_s.iter().any(|t| (from_s - 1e-9..=to_s + (to_s - from_s) + 1e-9).contains(t));
            if !touched && held.iter().any(|a| Some(a) != held.first()) {
                return Err(format!("vehicle {vehicle} changes its acceleration within step {step}, {from_s} s"));
            }
        }
    }
    Ok(())
}

/// How far two runs are apart at most at a sample of the first, or at an impact, in metres; infinitely far if their impacts
/// are not between the same vehicles.
fn max_distance_m(coarse: &SimulationResult, fine: &SimulationResult, finer: usize) -> f64 {
    let who = |result: &SimulationResult| -> Vec<[usize; 3]> {
        let of = |impact: &Impact| [impact.contact.rear_vehicle, impact.first_involved, impact.last_involved];
        result.impacts.iter().map(of).collect()
    };
    if who(coarse) != who(fine) {
        return f64::INFINITY;
    }
    let impacts = coarse.impacts.iter().zip(&fine.impacts).map(|(coarse, fine)| {
        let apart_s = (coarse.contact.time_s - fine.contact.time_s).abs();
        // Times are what the root of a gap says, so a slow impact may be off by much time for little way.
        if apart_s < 1e-9 { 0.0 } else { 10.0 * apart_s * coarse.contact.impact_speed_mps.abs() }
    });
    let impacts_m = impacts.fold(0.0, f64::max);
    let (Some(coarse), Some(fine)) = (&coarse.trace, &fine.trace) else { return f64::INFINITY };
    let tracks = coarse.vehicles.iter().zip(&fine.vehicles);
    let samples = tracks.flat_map(|(coarse_track, fine_track)| {
        // The last sample of either may be the instant of contact.
        let samples = coarse_track.position_m.iter().zip(fine_track.position_m.iter().step_by(finer));
        samples.take(coarse.len().saturating_sub(1))
    });
    samples.map(|(x, y)| (x - y).abs()).fold(impacts_m, f64::max)
}

/// Whether the first vehicle to move differently is one with noise that stood.
///
/// A vehicle that stands and does not want to move is held, noise included; one that wants to move by as little as
/// rounding is at the mercy of its noise.
fn is_started_by_noise(question: &OracleContext<'_>, fine: &Trace) -> bool {
    let Some(coarse) = &question.result.trace else { return false };
    let first_differences =
        coarse.vehicles.iter().zip(&fine.vehicles).enumerate().filter_map(|(index, (track, fine))| {
            let fine_mps = fine.speed_mps.iter().step_by(REFINEMENT);
            let differs = track.speed_mps.iter().zip(fine_mps).position(|(v, w)| (v - w).abs() > TOLERANCE_M)?;
            Some((differs, index))
        });
    let Some((sample, index)) = first_differences.min() else { return false };
    let before_mps = sample.checked_sub(1).and_then(|before| coarse.vehicles.get(index)?.speed_mps.get(before));
    let noisy = question.test_case.scenario.vehicles().get(index).is_some_and(|v| v.acceleration_noise_mps2 > 0.0);
    noisy && before_mps == Some(&0.0)
}

/// How far the run goes elsewhere when all gaps, or all speeds, are changed by next to nothing, in metres.
fn disturbance_effect_m(question: &OracleContext<'_>) -> f64 {
    let gaps = |by_m: f64| {
        move |spec: &mut ScenarioSpec| {
            spec.vehicles.iter_mut().zip(0_u32..).for_each(|(v, index)| v.position_m -= by_m * f64::from(index));
        }
    };
    let speeds = |by_mps: f64| {
        move |spec: &mut ScenarioSpec| {
            // Followers only, and each more than the one ahead: closing speeds change.
            for (vehicle, index) in spec.vehicles.iter_mut().zip(0_u32..).skip(1) {
                vehicle.speed_mps = (vehicle.speed_mps + by_mps * f64::from(index)).max(0.0);
            }
        }
    };
    let scenario = &question.test_case.scenario;
    let twins = DISTURBANCES.into_iter().flat_map(|by| [scenario.edited(gaps(by)), scenario.edited(speeds(by))]);
    let apart = twins.flatten().filter_map(|twin| {
        let run = Run::new(&twin, question.run.options().clone()).ok()?;
        Some(max_distance_m(&question.result, &question.system.simulate(&run, RecordingLevel::Trace), 1))
    });
    apart.fold(0.0, f64::max)
}

/// Whether two runs have the same impacts, apart from the numbers of the vehicles and the time, which may differ by a shift.
///
/// Rounding moves positions by 1e-11 m or so: times may differ by what that is at the impact speed.
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
        let vehicles = [before.contact.front_vehicle, before.first_involved, before.last_involved];
        let same = vehicles.map(|vehicle| vehicle + shift)
            == [after.contact.front_vehicle, after.first_involved, after.last_involved];
        let apart_s = (before.contact.time_s + shift_s - after.contact.time_s).abs();
        let limit_s = (1e-8 / before.contact.impact_speed_mps).clamp(1e-9, 1e-3);
        if !same || apart_s.is_nan() || apart_s > limit_s {
            return Err(format!("{before:?} became {after:?}, {apart_s} s apart"));
        }
    }
    Ok(())
}
