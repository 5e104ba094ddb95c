//! How finely motion is integrated decides nothing.

use super::{Checked, Finding, Question, grazes, must};
use crate::scenario::{Scenario, ScenarioSpec};
use crate::sim::{Keep, Run, Simulated, Trace};
use crate::trial::Law;

/// How much finer the second integration is.
const FINER: usize = 10;
/// How far two equal motions may be apart, in metres: rounding, over some hundred steps.
const APART_M: f64 = 1e-7;
/// Disturbances that no verdict should hang on: far above rounding, far below anything a sensor sees.
const DISTURBED_M: [f64; 2] = [1e-8, -1e-8];

/// Ten times finer integration, with controllers, sensors and noise at the same instants, is the same motion, and
/// accelerations are held from one such instant to the next.
///
/// A threshold that is met within rounding may be crossed at one step and not at another. A run that a disturbance of
/// 10 nm throws off its way just as far is not compared.
///
/// # Errors
/// [`Law::StepSize`].
pub fn step_size_decides_nothing(question: &Question<'_>) -> Finding {
    let (run, coarse) = (&question.run, &question.result);
    let options = run.options().clone().with_dt_s(run.dt_s() / FINER as f64);
    let fine_run = Run::new(run.scenario(), options).map_err(|error| (Law::StepSize, error.to_string()))?;
    let fine = question.system.simulate(&fine_run, Keep::Trace);
    let Some(fine_trace) = &fine.trace else { return Err((Law::StepSize, "no trace was kept".to_owned())) };
    held(fine_trace, &fine, fine_run.substeps()).map_err(|finding| (Law::StepSize, finding))?;
    if grazes(coarse) || grazes(&fine) {
        return Ok(Checked::Undecided);
    }
    let Err(finding) = same_run(coarse, &fine, FINER, APART_M) else { return Ok(Checked::Holds) };
    must(is_on_edge(question), Law::StepSize, || finding)?;
    Ok(Checked::Undecided)
}

/// Whether accelerations change only where a step of the scenario begins, or vehicles touch.
fn held(trace: &Trace, result: &Simulated, substeps: usize) -> Result<(), String> {
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

/// Whether two runs have the same impacts, and all samples of the first at the same places in the second.
fn same_run(coarse: &Simulated, fine: &Simulated, finer: usize, apart_m: f64) -> Result<(), String> {
    same_impacts(coarse, fine, 0, 0.0)?;
    let (Some(coarse), Some(fine)) = (&coarse.trace, &fine.trace) else { return Err("no trace".to_owned()) };
    for (vehicle, (coarse_track, fine_track)) in coarse.vehicles.iter().zip(&fine.vehicles).enumerate() {
        // The last sample of either may be the instant of contact.
        let samples = coarse_track.position_m.iter().zip(fine_track.position_m.iter().step_by(finer));
        for (k, (x, y)) in samples.take(coarse.len().saturating_sub(1)).enumerate() {
            if (x - y).abs() >= apart_m {
                return Err(format!("vehicle {vehicle} at {x} and {y} m at sample {k}"));
            }
        }
    }
    Ok(())
}

/// Whether the run goes elsewhere when all gaps, or all speeds, are changed by next to nothing.
fn is_on_edge(question: &Question<'_>) -> bool {
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
    let scenario = &question.trial.scenario;
    let twins = DISTURBED_M.into_iter().flat_map(|by| [scenario.edited(gaps(by)), scenario.edited(speeds(by))]);
    twins.flatten().any(|twin| diverges(question, &twin))
}

fn diverges(question: &Question<'_>, twin: &Scenario) -> bool {
    let Ok(run) = Run::new(twin, question.run.options().clone()) else { return false };
    // A disturbance grows with time by itself, but not a hundredfold.
    same_run(&question.result, &question.system.simulate(&run, Keep::Trace), 1, 5e-6).is_err()
}

/// Whether two runs have the same impacts, apart from the numbers of the vehicles and the time, which may differ by a shift.
///
/// Rounding moves positions by 1e-11 m or so: times may differ by what that is at the impact speed.
///
/// # Errors
/// The first difference.
pub fn same_impacts(before: &Simulated, after: &Simulated, shift: usize, shift_s: f64) -> Result<(), String> {
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
