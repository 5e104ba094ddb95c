//! Oracle: no driver does what the convex programs prove impossible.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_search::worst_case::AvoidanceVerdict;
use crumple_sim::engine::Outcome;

/// Tolerance for rounding in the simulation, in metres: the proof holds in exact arithmetic.
const ROUNDING_M: f64 = 1e-6;
/// Maximum number of steps of a scenario that is checked: longer ones take seconds, and half a minute with the counters
/// of a fuzzer in the solver's loops.
const MAX_STEPS: usize = 500;

/// Checks that no run avoids a collision that is proved unavoidable, or keeps a larger gap than is proved possible.
///
/// # Errors
/// [`Invariant::Avoidability`].
pub fn avoidability_bound_holds(question: &OracleContext<'_>) -> OracleResult {
    let is_long = question.test_case.scenario.steps() > MAX_STEPS;
    if is_long || question.result.outcome != Outcome::NoCollision {
        return Ok(OracleOutcome::NotApplicable);
    }
    let Some(avoidance) = question.system.avoid(&question.test_case.scenario) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    let unavoidable = matches!(avoidance.verdict, AvoidanceVerdict::Unavoidable(_));
    ensure(!unavoidable, Invariant::Avoidability, || {
        "the run has no collision, but is `unavoidable`".to_owned()
    })?;
    let gaps_m = question
        .result
        .vehicles
        .iter()
        .filter_map(|vehicle| vehicle.min_gap_m);
    let smallest_m = gaps_m.fold(f64::INFINITY, f64::min);
    let bound_m = avoidance.min_gap_bound_m;
    let possible = bound_m.is_none_or(|bound_m| smallest_m <= bound_m + ROUNDING_M);
    ensure(possible, Invariant::Avoidability, || {
        format!(
            "the smallest gap is {smallest_m} m, but the bound for every controller is {bound_m:?} m"
        )
    })?;
    Ok(if bound_m.is_some() {
        OracleOutcome::Holds
    } else {
        OracleOutcome::NotApplicable
    })
}
