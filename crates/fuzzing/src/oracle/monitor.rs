//! Oracle: STL formulas have the robustness of the definition, and "always a gap" agrees with the verdict.

use std::fmt::Display;

use super::{Finding, OracleContext, OracleOutcome, OracleResult, ROUNDING_M, ensure, is_grazing};
use crate::Invariant;
use crate::formula::formula_from_bytes;
use crumple_measure::stl::{
    ComparisonOp, Formula, FormulaError, LinearPredicate, MonitorError, SampledSignals,
    SignalsError, TimeWindow, naive_robustness,
};
use crumple_sim::engine::Trace;

/// Maximum number of samples for random formulas: evaluation by the definition takes quadratic time.
const MAX_SAMPLES: usize = 40;

/// Gap without a vehicle, in metres: larger than any gap, and finite so that sums remain finite.
const NO_VEHICLE_GAP_M: f64 = 1e6;

/// Checks that "always a gap" holds on the trace exactly if there is no collision, and that random formulas over gaps
/// and speeds have the robustness of the definition at every sample.
///
/// # Errors
/// [`Invariant::Monitor`].
pub fn monitor_agrees(question: &OracleContext<'_>) -> OracleResult {
    let trace = question.trace()?;
    check_no_collision_formula(question, trace)?;
    let every = trace.len().div_ceil(MAX_SAMPLES);
    let signals = trace_signals(trace, question.run.dt_s(), every).map_err(monitor_finding)?;
    let names: Vec<&str> = signals.names().collect();
    // Derived from the scenario, so that a test case is deterministic.
    let mut bytes = Vec::new();
    for vehicle in question.test_case.scenario.vehicles() {
        bytes.extend(vehicle.position_m.to_bits().to_le_bytes());
        bytes.extend(vehicle.speed_mps.to_bits().to_le_bytes());
    }
    bytes.extend(question.test_case.scenario.spec().seed.to_le_bytes());
    let formula = formula_from_bytes(&bytes, &names, signals.step_s()).map_err(monitor_finding)?;
    check_definition(question, &formula, &signals)?;
    Ok(OracleOutcome::Holds)
}

fn monitor_finding(error: impl Display) -> Finding {
    (Invariant::Monitor, error.to_string())
}

/// Checks that the robustness of "always a gap" agrees with collisions and the smallest gap of the run.
fn check_no_collision_formula(question: &OracleContext<'_>, trace: &Trace) -> Result<(), Finding> {
    let signals = trace_signals(trace, question.run.dt_s(), 1).map_err(monitor_finding)?;
    let apart = no_collision_formula(trace.vehicles.len()).map_err(monitor_finding)?;
    let robustness = first_robustness(question, &apart, &signals)?;
    let collided = !question.result.impacts.is_empty();
    let sign = if collided {
        robustness <= ROUNDING_M
    } else {
        robustness > 0.0 || is_grazing(&question.result)
    };
    ensure(sign, Invariant::Monitor, || {
        format!("{apart} has robustness {robustness}, collided: {collided}")
    })?;
    let gaps_m = question
        .result
        .vehicles
        .iter()
        .filter_map(|vehicle| vehicle.min_gap_m);
    let min_gap_m = gaps_m.fold(NO_VEHICLE_GAP_M, f64::min);
    ensure(
        robustness >= min_gap_m - ROUNDING_M,
        Invariant::Monitor,
        || {
            format!(
                "{apart} has robustness {robustness}, but the smallest gap of the run is {min_gap_m} m"
            )
        },
    )
}

fn check_definition(
    question: &OracleContext<'_>,
    formula: &Formula,
    signals: &SampledSignals<'_>,
) -> Result<(), Finding> {
    let finding = |error: MonitorError| (Invariant::Monitor, format!("{formula}: {error}"));
    let over_time = question
        .system
        .robustness_over_time(formula, signals)
        .map_err(finding)?;
    for (k, &value) in over_time.iter().enumerate() {
        let defined = naive_robustness(formula, signals, k).map_err(finding)?;
        ensure(value == defined, Invariant::Monitor, || {
            format!("{formula} at sample {k}: {value}, defined as {defined}")
        })?;
    }
    let satisfied = question
        .system
        .is_satisfied(formula, signals)
        .map_err(finding)?;
    let sign = over_time
        .first()
        .is_none_or(|&value| value == 0.0 || satisfied == (value > 0.0));
    ensure(sign, Invariant::Monitor, || {
        format!(
            "{formula} is satisfied: {satisfied}, but has robustness {:?}",
            over_time.first()
        )
    })
}

fn first_robustness(
    question: &OracleContext<'_>,
    formula: &Formula,
    signals: &SampledSignals<'_>,
) -> Result<f64, Finding> {
    let over_time = question.system.robustness_over_time(formula, signals);
    let over_time = over_time.map_err(monitor_finding)?;
    over_time.first().copied().ok_or_else(|| {
        (
            Invariant::Monitor,
            "no robustness at the first sample".to_owned(),
        )
    })
}

fn no_collision_formula(vehicles: usize) -> Result<Formula, FormulaError> {
    (2..vehicles).try_fold(always_a_gap(1)?, |all, rear| {
        Ok(Formula::And(Box::new(all), Box::new(always_a_gap(rear)?)))
    })
}

fn always_a_gap(rear: usize) -> Result<Formula, FormulaError> {
    let gap = format!("gap{rear}_m");
    let comparison = LinearPredicate::new([(1.0, gap)], ComparisonOp::Above, 0.0)?;
    Ok(Formula::Always(
        TimeWindow::ALL,
        Box::new(Formula::Compare(comparison)),
    ))
}

/// Returns gaps and speeds of a trace, at every `every`-th sample.
fn trace_signals(
    trace: &Trace,
    step_s: f64,
    every: usize,
) -> Result<SampledSignals<'static>, SignalsError> {
    let every = every.max(1);
    let mut signals = SampledSignals::new(step_s * every as f64, trace.len().div_ceil(every))?;
    for (index, track) in trace.vehicles.iter().enumerate() {
        let speeds: Vec<f64> = track.speed_mps.iter().copied().step_by(every).collect();
        signals.insert(format!("v{index}_mps"), speeds)?;
        if index > 0 {
            let gaps_m = trace
                .gaps_m(index)
                .into_iter()
                .map(|gap_m| gap_m.unwrap_or(NO_VEHICLE_GAP_M));
            signals.insert(
                format!("gap{index}_m"),
                gaps_m.step_by(every).collect::<Vec<_>>(),
            )?;
        }
    }
    Ok(signals)
}
