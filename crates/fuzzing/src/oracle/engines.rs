//! Oracle: the scalar and the batch engine agree.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::engine::{
    Impact, Intervention, RecordingLevel, Run, SimulationResult, Track, VehicleSummary,
};
use crumple_sim::scenario::Scenario;

/// Checks that the batch engine gives the results of the scalar engine to the last bit. The batch holds the test case
/// twice, and variants with other noise, speeds and roads.
///
/// # Errors
/// [`Invariant::Engines`].
pub fn engines_agree(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let variants = variants(scenario);
    let scenarios = [scenario].into_iter().chain(&variants).chain([scenario]);
    let runs = scenarios.map(|scenario| Run::new(scenario, question.run.options().clone()));
    let runs = runs
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| (Invariant::Engines, error.to_string()))?;
    let traced = question.system.simulate_batch(&runs, RecordingLevel::Trace);
    let summed = question
        .system
        .simulate_batch(&runs, RecordingLevel::Summary);
    let results = [traced.len(), summed.len()];
    ensure(results == [runs.len(); 2], Invariant::Engines, || {
        format!("{results:?} results of {} runs", runs.len())
    })?;
    for (index, ((run, traced), summed)) in runs.iter().zip(&traced).zip(&summed).enumerate() {
        let is_test_case = std::ptr::eq(run.scenario().spec(), scenario.spec());
        let mut alone = if is_test_case {
            question.result.clone()
        } else {
            question.system.simulate(run, RecordingLevel::Trace)
        };
        ensure(
            result_bits(&alone) == result_bits(traced),
            Invariant::Engines,
            || format!("run {index}: {}", first_difference(&alone, traced)),
        )?;
        alone.trace = None;
        ensure(
            result_bits(&alone) == result_bits(summed),
            Invariant::Engines,
            || {
                format!(
                    "run {index} without trace: {}",
                    first_difference(&alone, summed)
                )
            },
        )?;
    }
    Ok(OracleOutcome::Holds)
}

/// Returns valid variants of a scenario with other noise and duration, and with other speeds and road.
fn variants(scenario: &Scenario) -> Vec<Scenario> {
    let variants = [
        scenario.edited(|spec| {
            spec.seed ^= 1;
            spec.duration_s += spec.step_s;
        }),
        scenario.edited(|spec| {
            spec.environment.friction = 0.5;
            spec.vehicles
                .iter_mut()
                .for_each(|vehicle| vehicle.speed_mps *= 0.75);
        }),
    ];
    variants.into_iter().flatten().collect()
}

/// Returns all numbers of a result as bits; 0 and -0 differ.
#[must_use]
pub fn result_bits(result: &SimulationResult) -> Vec<u64> {
    result_numbers(result)
        .iter()
        .map(|number| number.value.to_bits())
        .collect()
}

fn first_difference(alone: &SimulationResult, batch: &SimulationResult) -> String {
    let numbers_alone = result_numbers(alone);
    let numbers_in_batch = result_numbers(batch);
    let mut pairs = numbers_alone.iter().zip(&numbers_in_batch);
    let differing = pairs.find(|(a, b)| a.value.to_bits() != b.value.to_bits());
    let outcomes = format!(
        "alone {:?}, in the batch {:?}",
        alone.outcome, batch.outcome
    );
    match differing {
        Some((alone, batch)) => {
            let ResultNumber { name, index, value } = alone;
            format!(
                "{name} {index} is {value:?} and {:?}; {outcomes}",
                batch.value
            )
        }
        None => format!(
            "{} numbers and {}; {outcomes}",
            numbers_alone.len(),
            numbers_in_batch.len()
        ),
    }
}

/// A number of a result.
struct ResultNumber {
    name: &'static str,
    /// Index of the impact, vehicle or sample.
    index: usize,
    value: f64,
}

/// Returns all numbers of a result.
fn result_numbers(result: &SimulationResult) -> Vec<ResultNumber> {
    let mut numbers = Vec::new();
    for (index, impact) in result.impacts.iter().enumerate() {
        numbers.extend(impact_numbers(index, impact));
    }
    for (index, summary) in result.vehicles.iter().enumerate() {
        numbers.extend(summary_numbers(index, summary));
    }
    for (index, intervention) in result.interventions.iter().enumerate() {
        numbers.extend(intervention_numbers(index, intervention));
    }
    if let Some(trace) = &result.trace {
        numbers.extend(series_numbers("time of sample", &trace.time_s));
        for (index, track) in trace.vehicles.iter().enumerate() {
            numbers.extend(track_numbers(index, track));
        }
    }
    numbers
}

fn impact_numbers(index: usize, impact: &Impact) -> [ResultNumber; 9] {
    let collision = &impact.collision;
    [
        ("vehicle of impact", collision.front_vehicle as f64),
        ("vehicle of impact", collision.rear_vehicle as f64),
        ("vehicle of impact", impact.first_involved as f64),
        ("vehicle of impact", impact.last_involved as f64),
        ("time of impact", collision.time_s),
        ("speed of impact", collision.front_speed_mps),
        ("speed of impact", collision.rear_speed_mps),
        ("speed of impact", collision.impact_speed_mps),
        ("speed of impact", impact.common_speed_mps),
    ]
    .map(|(name, value)| ResultNumber { name, index, value })
}

fn summary_numbers(index: usize, summary: &VehicleSummary) -> [ResultNumber; 4] {
    let absent = f64::from_bits(u64::MAX);
    [
        (
            "smallest gap of vehicle",
            summary.min_gap_m.unwrap_or(absent),
        ),
        (
            "smallest time to collision of vehicle",
            summary.min_ttc_s.unwrap_or(absent),
        ),
        ("hardest braking of vehicle", summary.max_brake_mps2),
        ("whether it stopped, vehicle", f64::from(summary.stopped)),
    ]
    .map(|(name, value)| ResultNumber { name, index, value })
}

fn intervention_numbers(index: usize, intervention: &Intervention) -> [ResultNumber; 5] {
    [
        intervention.vehicle as f64,
        intervention.from_s,
        intervention.to_s,
        f64::from(intervention.outside_kernel),
        f64::from(intervention.rear_conflict),
    ]
    .map(|value| ResultNumber {
        name: "intervention",
        index,
        value,
    })
}

fn track_numbers(index: usize, track: &Track) -> Vec<ResultNumber> {
    let Track {
        length_m,
        mass_kg,
        position_m,
        speed_mps,
        acceleration_mps2,
        in_lane_s,
    } = track;
    let of_vehicle = [
        ("length of vehicle", *length_m),
        ("mass of vehicle", *mass_kg),
    ]
    .map(|(name, value)| ResultNumber { name, index, value });
    of_vehicle
        .into_iter()
        .chain(series_numbers("change of lane", in_lane_s))
        .chain(series_numbers("position of sample", position_m))
        .chain(series_numbers("speed of sample", speed_mps))
        .chain(series_numbers("acceleration of sample", acceleration_mps2))
        .collect()
}

/// Returns the numbers of a series, with their own indices.
fn series_numbers(name: &'static str, values: &[f64]) -> impl Iterator<Item = ResultNumber> {
    values
        .iter()
        .enumerate()
        .map(move |(index, &value)| ResultNumber { name, index, value })
}
