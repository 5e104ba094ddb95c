//! Oracle: the scalar and the batch engine agree.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::Invariant;
use crumple_sim::engine::{RecordingLevel, Run, SimulationResult, Track};
use crumple_sim::scenario::Scenario;

/// Checks that the batch engine gives the results of the scalar engine to the last bit. The batch holds the test case
/// twice, and variants with other noise, speeds and roads.
///
/// # Errors
/// [`Invariant::Engines`].
pub fn engines_agree(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    let others = [
        scenario.edited(|spec| {
            (spec.seed, spec.duration_s) = (spec.seed ^ 1, spec.duration_s + spec.step_s)
        }),
        scenario.edited(|spec| {
            spec.environment.friction = 0.5;
            spec.vehicles
                .iter_mut()
                .for_each(|vehicle| vehicle.speed_mps *= 0.75);
        }),
    ];
    let others: Vec<Scenario> = others.into_iter().flatten().collect();
    let scenarios = [scenario].into_iter().chain(&others).chain([scenario]);
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
        let is_the_trial = std::ptr::eq(run.scenario().spec(), scenario.spec());
        let mut alone = if is_the_trial {
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

/// Returns all numbers of a result as bits; 0 and -0 differ.
#[must_use]
pub fn result_bits(result: &SimulationResult) -> Vec<u64> {
    result_numbers(result)
        .iter()
        .map(|(.., number)| number.to_bits())
        .collect()
}

fn first_difference(alone: &SimulationResult, batch: &SimulationResult) -> String {
    let (one, other) = (result_numbers(alone), result_numbers(batch));
    let differing = one
        .iter()
        .zip(&other)
        .find(|(one, other)| one.2.to_bits() != other.2.to_bits());
    let outcomes = format!(
        "alone {:?}, in the batch {:?}",
        alone.outcome, batch.outcome
    );
    match differing {
        Some((&(name, index, one), &(.., other))) => {
            format!("{name} {index} is {one:?} and {other:?}; {outcomes}")
        }
        None => format!("{} numbers and {}; {outcomes}", one.len(), other.len()),
    }
}

/// Returns all numbers of a result: a name, the index of the impact, vehicle or sample, and the number.
fn result_numbers(result: &SimulationResult) -> Vec<(&'static str, usize, f64)> {
    let mut numbers = Vec::new();
    for (index, impact) in result.impacts.iter().enumerate() {
        let contact = &impact.contact;
        let indices = [
            contact.front_vehicle,
            contact.rear_vehicle,
            impact.first_involved,
            impact.last_involved,
        ];
        numbers.extend(indices.map(|vehicle| ("vehicle of impact", index, vehicle as f64)));
        let speeds = [
            contact.front_speed_mps,
            contact.rear_speed_mps,
            contact.impact_speed_mps,
            impact.common_speed_mps,
        ];
        numbers.push(("time of impact", index, contact.time_s));
        numbers.extend(speeds.map(|speed_mps| ("speed of impact", index, speed_mps)));
    }
    for (index, vehicle) in result.vehicles.iter().enumerate() {
        let absent = f64::from_bits(u64::MAX);
        numbers.push((
            "smallest gap of vehicle",
            index,
            vehicle.min_gap_m.unwrap_or(absent),
        ));
        numbers.push((
            "smallest time to collision of vehicle",
            index,
            vehicle.min_ttc_s.unwrap_or(absent),
        ));
        numbers.push(("hardest braking of vehicle", index, vehicle.max_brake_mps2));
        numbers.push((
            "whether it stopped, vehicle",
            index,
            f64::from(vehicle.stopped),
        ));
    }
    for (index, done) in result.interventions.iter().enumerate() {
        let flags = [done.outside_kernel, done.rear_conflict].map(f64::from);
        let all = [
            done.vehicle as f64,
            done.from_s,
            done.to_s,
            flags[0],
            flags[1],
        ];
        numbers.extend(all.map(|number| ("intervention", index, number)));
    }
    if let Some(trace) = &result.trace {
        let samples = |name: &'static str, values: &[f64]| {
            values
                .iter()
                .copied()
                .enumerate()
                .map(|(index, value)| (name, index, value))
                .collect::<Vec<_>>()
        };
        numbers.extend(samples("time of sample", &trace.time_s));
        for (index, track) in trace.vehicles.iter().enumerate() {
            let Track {
                length_m,
                mass_kg,
                position_m,
                speed_mps,
                acceleration_mps2,
                in_lane_s,
            } = track;
            numbers.extend([
                ("length of vehicle", index, *length_m),
                ("mass of vehicle", index, *mass_kg),
            ]);
            numbers.extend(samples("change of lane", in_lane_s));
            numbers.extend(samples("position of sample", position_m));
            numbers.extend(samples("speed of sample", speed_mps));
            numbers.extend(samples("acceleration of sample", acceleration_mps2));
        }
    }
    numbers
}
