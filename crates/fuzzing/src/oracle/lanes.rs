//! Oracles of lane changes: times in the lane are consistent, and vehicles outside the lane have no influence.

use super::engines::result_bits;
use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_measure::LeadMeasures;
use crumple_sim::engine::{AfterContact, RecordingLevel, Run, SimulationResult, Track};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LaneChange, Scenario, ScenarioSpec, VehicleSpec};

/// Tolerance of equal times and gaps, in seconds and metres.
const TOLERANCE: f64 = 1e-6;

/// Checks times in the lane, impacts and smallest gaps. No vehicle collides outside the lane or leaves before it
/// enters; a vehicle without lane changes is always in the lane; measures of the trace agree with the engine.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn lane_times_are_consistent(question: &OracleContext<'_>) -> OracleResult {
    let (trace, result) = (question.trace()?, &question.result);
    for (vehicle, (track, spec)) in trace
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
    for impact in &result.impacts {
        let time_s = impact.contact.time_s;
        let is_there = |vehicle: usize| {
            trace.vehicles.get(vehicle).is_some_and(|track| {
                let [from_s, to_s] = track.in_lane_s;
                from_s <= time_s + TOLERANCE && time_s - TOLERANCE <= to_s
            })
        };
        for vehicle in impact.first_involved..=impact.last_involved {
            let is_beside = impact.beside.contains(&vehicle);
            ensure(is_beside || is_there(vehicle), Invariant::Lanes, || {
                format!("vehicle {vehicle} is hit outside the lane at {time_s} s")
            })?;
        }
    }
    // A trace does not show the effect of an impact on speeds between two samples.
    let goes_on = question.run.options().after_contact == AfterContact::Continue
        && !result.impacts.is_empty();
    for (index, summary) in result.vehicles.iter().enumerate().filter(|_| !goes_on) {
        let measured_m = LeadMeasures::from_trace(trace, &result.impacts, index)
            .and_then(|ahead| ahead.min_gap_m);
        let [told_m, seen_m] =
            [summary.min_gap_m, measured_m].map(|gap_m| gap_m.unwrap_or(f64::INFINITY));
        ensure(
            told_m == seen_m || (told_m - seen_m).abs() < TOLERANCE,
            Invariant::Lanes,
            || {
                format!(
                    "vehicle {index}: the reported smallest gap is {told_m} m, that of the trace {seen_m} m"
                )
            },
        )?;
    }
    Ok(OracleOutcome::Holds)
}

/// Checks that entering at the start equals being there: the same run to the last bit, except for the times in the
/// lane.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn entering_at_start_changes_nothing(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let changed = |to: Option<LaneChange>| {
        scenario.edited(|spec: &mut ScenarioSpec| {
            spec.vehicles
                .iter_mut()
                .filter(|vehicle| vehicle.enters.is_some())
                .for_each(|vehicle| vehicle.enters = to);
        })
    };
    // A vehicle that leaves at 0 s cannot enter then.
    let (Ok(enters), Ok(there)) = (changed(Some(LaneChange::At(0.0))), changed(None)) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    if enters == there {
        return Ok(OracleOutcome::NotApplicable);
    }
    let [enters, there] =
        [enters, there].map(|twin| simulate_variant(question, &twin).map(without_lane_times));
    let (Some(enters), Some(there)) = (enters, there) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    ensure(
        result_bits(&enters) == result_bits(&there),
        Invariant::Lanes,
        || {
            format!(
                "entering at 0 s ends with {:?}, being there with {:?}",
                enters.outcome, there.outcome
            )
        },
    )?;
    Ok(OracleOutcome::Holds)
}

/// Checks that the last vehicle has no influence on the others up to the first impact, to the last bit, if they ignore
/// their followers and change lanes by time. With the Kalman filter only without sensor faults and changes of other
/// vehicles.
///
/// # Errors
/// [`Invariant::Lanes`].
pub fn leaving_last_vehicle_changes_nothing_ahead(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let looks_ahead = |vehicle: &VehicleSpec| match &vehicle.driver {
        Driver::Controller(spec) => !spec.observes_follower(),
        driver => {
            !matches!(driver, Driver::UnderTest) || question.test_case.setup.looks_ahead_only()
        }
    };
    let keeps = scenario.edited(|spec| {
        if let Some(last) = spec.vehicles.last_mut() {
            (last.enters, last.leaves) = (None, None);
        }
    });
    let Ok(keeps) = keeps else {
        return Ok(OracleOutcome::NotApplicable);
    };
    // A trigger by gap or TTC may refer to the last vehicle.
    let is_by_time = |change: &LaneChange| matches!(change, LaneChange::At(_));
    let others = scenario
        .vehicles()
        .iter()
        .rev()
        .skip(1)
        .flat_map(|vehicle| [vehicle.enters, vehicle.leaves]);
    let changes_of_others: Vec<LaneChange> = others.flatten().collect();
    let is_free = changes_of_others.iter().all(is_by_time);
    // The filters of both sides draw the initial errors of a new target from one stream.
    let draws_anew = question.run.options().estimator == EstimatorKind::Kalman
        && (scenario.spec().sensors.faults.is_any() || !changes_of_others.is_empty());
    if draws_anew || keeps == *scenario || !is_free || !scenario.vehicles().iter().all(looks_ahead)
    {
        return Ok(OracleOutcome::NotApplicable);
    }
    let Some(stays) = simulate_variant(question, &keeps) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    let until_s = [&question.result, &stays]
        .into_iter()
        .filter_map(|result| result.impacts.first());
    let until_s = until_s
        .map(|impact| impact.contact.time_s)
        .fold(f64::INFINITY, f64::min);
    let (Some(with), Some(without)) = (&question.result.trace, &stays.trace) else {
        return Ok(OracleOutcome::NotApplicable);
    };
    let samples = with
        .time_s
        .iter()
        .take_while(|&&time_s| time_s < until_s)
        .count()
        .saturating_sub(1);
    let others = with.vehicles.len().saturating_sub(1);
    for (vehicle, (left, stayed)) in with
        .vehicles
        .iter()
        .zip(&without.vehicles)
        .take(others)
        .enumerate()
    {
        let differs = left
            .position_m
            .iter()
            .zip(&stayed.position_m)
            .take(samples)
            .position(|(one, other)| one != other);
        ensure(differs.is_none(), Invariant::Lanes, || {
            format!(
                "vehicle {vehicle} moves differently from sample {differs:?} on, because a vehicle behind it has left"
            )
        })?;
    }
    Ok(OracleOutcome::Holds)
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
