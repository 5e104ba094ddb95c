//! Oracles of lane changes: times in the lane are consistent, and vehicles outside the lane have no influence.

use super::engines::result_bits;
use super::{Finding, OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_measure::LeadMeasures;
use crumple_sim::engine::{RecordingLevel, Run, SimulationResult, Trace, Track};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, InvalidField, LaneChange, Scenario, ScenarioSpec};

/// Tolerance of equal times and gaps, in seconds and metres.
const TOLERANCE: f64 = 1e-6;

/// Checks times in the lane, impacts and smallest gaps. No vehicle collides outside the lane or leaves before it
/// enters; a vehicle without lane changes is always in the lane; measures of the trace agree with the engine.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn lane_times_are_consistent(question: &OracleContext<'_>) -> OracleResult {
    check_times_in_lane(question)?;
    check_impacts_in_lane(question)?;
    check_gaps_to_leaders(question)?;
    Ok(OracleOutcome::Holds)
}

/// Checks that times in the lane agree with the planned changes.
fn check_times_in_lane(question: &OracleContext<'_>) -> Result<(), Finding> {
    for (vehicle, (track, spec)) in question
        .trace()?
        .vehicles
        .iter()
        .zip(question.test_case.scenario.vehicles())
        .enumerate()
    {
        let [from_s, to_s] = track.in_lane_s;
        let at =
            |what: &str| format!("vehicle {vehicle} {what}: in the lane from {from_s} to {to_s} s");
        ensure(from_s <= to_s, Invariant::Lanes, || {
            at("leaves before it enters")
        })?;
        ensure(
            !spec.keeps_lane() || track.in_lane_s == Track::THROUGHOUT_S,
            Invariant::Lanes,
            || at("keeps the lane"),
        )?;
        ensure(
            spec.enters.is_some() == (from_s >= 0.0),
            Invariant::Lanes,
            || at("enters, or was there from the start"),
        )?;
    }
    Ok(())
}

/// Checks that no vehicle outside the lane is involved in an impact.
fn check_impacts_in_lane(question: &OracleContext<'_>) -> Result<(), Finding> {
    let trace = question.trace()?;
    for impact in &question.result.impacts {
        let time_s = impact.collision.time_s;
        for vehicle in impact.first_involved..=impact.last_involved {
            let is_in_lane = trace.vehicles.get(vehicle).is_some_and(|track| {
                let [from_s, to_s] = track.in_lane_s;
                from_s <= time_s + TOLERANCE && time_s - TOLERANCE <= to_s
            });
            let is_beside = impact.beside.contains(&vehicle);
            ensure(is_beside || is_in_lane, Invariant::Lanes, || {
                format!("vehicle {vehicle} is hit outside the lane at {time_s} s")
            })?;
        }
    }
    Ok(())
}

/// Checks that the measured smallest gaps are those of the engine.
fn check_gaps_to_leaders(question: &OracleContext<'_>) -> Result<(), Finding> {
    let trace = question.trace()?;
    let result = &question.result;
    // A trace does not show the effect of an impact on speeds between two samples.
    let continues =
        question.run.options().after_collision.continues() && !result.impacts.is_empty();
    for (index, summary) in result.vehicles.iter().enumerate().filter(|_| !continues) {
        let measured_m = LeadMeasures::from_trace(trace, &result.impacts, index)
            .and_then(|ahead| ahead.min_gap_m);
        let [reported_m, measured_m] =
            [summary.min_gap_m, measured_m].map(|gap_m| gap_m.unwrap_or(f64::INFINITY));
        ensure(
            reported_m == measured_m || (reported_m - measured_m).abs() < TOLERANCE,
            Invariant::Lanes,
            || {
                format!(
                    "vehicle {index}: the reported smallest gap is {reported_m} m, that of the trace {measured_m} m"
                )
            },
        )?;
    }
    Ok(())
}

/// Checks that entering at the start equals being there: the same run to the last bit, except for the times in the
/// lane.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn entering_at_start_changes_nothing(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    // A vehicle that leaves at 0 s cannot enter then.
    let entering = with_entries(scenario, Some(LaneChange::At(0.0))).ok();
    let inside = with_entries(scenario, None).ok();
    if entering == inside {
        return Ok(OracleOutcome::NotApplicable);
    }
    let [entering, inside] = [entering, inside]
        .map(|variant| simulate_variant(question, &variant?).map(without_lane_times));
    let Some((entering, inside)) = entering.zip(inside) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    ensure(
        result_bits(&entering) == result_bits(&inside),
        Invariant::Lanes,
        || {
            format!(
                "entering at 0 s ends with {:?}, being there with {:?}",
                entering.outcome, inside.outcome
            )
        },
    )?;
    Ok(OracleOutcome::Holds)
}

/// Replaces the entries of all vehicles that enter.
fn with_entries(scenario: &Scenario, entry: Option<LaneChange>) -> Result<Scenario, InvalidField> {
    scenario.edited(|spec: &mut ScenarioSpec| {
        spec.vehicles
            .iter_mut()
            .filter(|vehicle| vehicle.enters.is_some())
            .for_each(|vehicle| vehicle.enters = entry);
    })
}

/// Checks that the last vehicle has no influence on the others up to the first impact, to the last bit, if they ignore
/// their followers and change lanes by time. With the Kalman filter only without sensor faults and changes of other
/// vehicles.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn leaving_last_vehicle_changes_nothing_ahead(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let keeping_lane = scenario.edited(|spec| {
        if let Some(last) = spec.vehicles.last_mut() {
            last.enters = None;
            last.leaves = None;
        }
    });
    let Ok(keeping_lane) = keeping_lane else {
        return Ok(OracleOutcome::NotApplicable);
    };
    if keeping_lane == *scenario || may_depend_on_last_vehicle(question) {
        return Ok(OracleOutcome::NotApplicable);
    }
    let Some(without_change) = simulate_variant(question, &keeping_lane) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    let first_impacts = [&question.result, &without_change]
        .into_iter()
        .filter_map(|result| result.impacts.first());
    let until_s = first_impacts
        .map(|impact| impact.collision.time_s)
        .fold(f64::INFINITY, f64::min);
    let traces = question.result.trace.as_ref();
    let Some((with, without)) = traces.zip(without_change.trace.as_ref()) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    check_same_motion_ahead(with, without, until_s)?;
    Ok(OracleOutcome::Holds)
}

/// True if a change of the last vehicle may influence the others: their drivers, lane changes or filters.
fn may_depend_on_last_vehicle(question: &OracleContext<'_>) -> bool {
    let scenario = &question.test_case.scenario;
    let changes = scenario
        .vehicles()
        .iter()
        .rev()
        .skip(1)
        .flat_map(|vehicle| [vehicle.enters, vehicle.leaves]);
    let changes_of_others: Vec<LaneChange> = changes.flatten().collect();
    // A trigger by gap or TTC may refer to the last vehicle.
    let change_by_time_only = changes_of_others
        .iter()
        .all(|change| matches!(change, LaneChange::At(_)));
    // The filters of both sides draw the initial errors of a new target from one stream.
    let draws_anew = question.run.options().estimator == EstimatorKind::Kalman
        && (scenario.spec().sensors.faults.is_any() || !changes_of_others.is_empty());
    let look_ahead_only = scenario
        .vehicles()
        .iter()
        .all(|vehicle| match &vehicle.driver {
            Driver::Controller(spec) => !spec.observes_follower(),
            Driver::UnderTest => question.test_case.setup.looks_ahead_only(),
            Driver::Profile(_) | Driver::File(_) => true,
        });
    draws_anew || !change_by_time_only || !look_ahead_only
}

/// Checks that all vehicles but the last move equally in two runs until a time.
fn check_same_motion_ahead(with: &Trace, without: &Trace, until_s: f64) -> Result<(), Finding> {
    let samples = with
        .time_s
        .iter()
        .take_while(|&&time_s| time_s < until_s)
        .count()
        .saturating_sub(1);
    let others = with.vehicles.len().saturating_sub(1);
    for (vehicle, (with, without)) in with
        .vehicles
        .iter()
        .zip(&without.vehicles)
        .take(others)
        .enumerate()
    {
        let differs = with
            .position_m
            .iter()
            .zip(&without.position_m)
            .take(samples)
            .position(|(a, b)| a != b);
        ensure(differs.is_none(), Invariant::Lanes, || {
            format!(
                "vehicle {vehicle} moves differently from sample {differs:?} on, because a vehicle behind it has left"
            )
        })?;
    }
    Ok(())
}

fn simulate_variant(question: &OracleContext<'_>, scenario: &Scenario) -> Option<SimulationResult> {
    let run = Run::new(scenario, question.run.options().clone()).ok()?;
    Some(question.system.simulate(&run, RecordingLevel::Trace))
}

fn without_lane_times(mut result: SimulationResult) -> SimulationResult {
    for track in result
        .trace
        .iter_mut()
        .flat_map(|trace| &mut trace.vehicles)
    {
        track.in_lane_s = Track::THROUGHOUT_S;
    }
    result
}
