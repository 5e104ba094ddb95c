//! Shrinking of scenarios: to few changes from the nominal one, then to round numbers.

use crumple_search::falsify::counterexample::{
    ChangedParameter, rounder_values, shrink as shrink_values,
};
use crumple_sim::scenario::{Scenario, ScenarioSpec};
use crumple_spaces::ScenarioSpace;
use serde_json::Value;

use super::Scenarios;
use super::generator::place_vehicles;
use super::scenarios::{Family, SeededValues, read_point};

/// Steps towards zero for each byte: half of the way, and half as much after each failed step.
const BYTE_STEPS: usize = 8;
/// Largest change by rounding, as a share of the number.
const MAX_ROUNDING_SHARE: f64 = 0.1;

/// A scenario after shrinking, with its changes from the nominal one.
#[derive(Debug, Clone)]
pub(super) struct ShrunkScenario {
    pub(super) scenario: Scenario,
    pub(super) changes: Vec<String>,
}

/// Returns the simplest scenario found for which `holds`, from the one of the bytes.
pub(super) fn shrink(
    scenarios: &Scenarios,
    bytes: &[u8],
    holds: &mut dyn FnMut(&Scenario) -> bool,
) -> ShrunkScenario {
    match scenarios.0.as_ref() {
        Family::Any => {
            let bytes = shrink_bytes(bytes, &mut |bytes| holds(&scenarios.read(bytes)));
            // The first byte is the number of vehicles.
            let nominal = numbers(&scenarios.read(bytes.get(..1).unwrap_or_default()));
            let scenario = round_numbers(scenarios.read(&bytes), &nominal, holds);
            ShrunkScenario {
                changes: changed_numbers(&nominal, &scenario),
                scenario,
            }
        }
        Family::Space(space) => shrink_sample(space, read_point(space, bytes), holds),
        Family::Files(_) => ShrunkScenario {
            scenario: scenarios.read(bytes),
            changes: Vec::new(),
        },
    }
}

/// Shrinks the noise seed to 0, and the values of a space.
fn shrink_sample(
    space: &ScenarioSpace,
    sample: SeededValues,
    holds: &mut dyn FnMut(&Scenario) -> bool,
) -> ShrunkScenario {
    let noiseless = SeededValues {
        seed: 0,
        ..sample.clone()
    };
    let seed = if holds(&noiseless.scenario(space)) {
        0
    } else {
        sample.seed
    };
    let values = shrink_values(space, &sample.values, &mut |values| {
        let changed = SeededValues {
            seed,
            values: values.to_vec(),
        };
        space.is_in_search_region(&space.point(values)) && holds(&changed.scenario(space))
    });
    let shrunk = SeededValues { seed, values };
    ShrunkScenario {
        changes: changed_parameters(space, &shrunk.values),
        scenario: shrunk.scenario(space),
    }
}

/// Describes the parameters that are not nominal.
fn changed_parameters(space: &ScenarioSpace, values: &[f64]) -> Vec<String> {
    let mut changed = Vec::new();
    for parameter in space.parameters() {
        let Some(own) = values.get(parameter.coordinates()) else {
            continue;
        };
        if own == parameter.nominal() {
            continue;
        }
        let formatted: Vec<_> = own
            .iter()
            .map(|&value| parameter.format_value(value))
            .collect();
        let parameter = ChangedParameter {
            parameter: parameter.name().to_owned(),
            value: formatted.join(", "),
            unit: parameter.unit().to_owned(),
            outside_observed: own
                .iter()
                .find_map(|&value| space.extrapolated_range(parameter.name(), value)),
        };
        changed.push(parameter.to_string());
    }
    changed
}

/// Sets as many bytes as possible to zero, halves of a block at a time, and reduces the others.
fn shrink_bytes(bytes: &[u8], holds: &mut dyn FnMut(&[u8]) -> bool) -> Vec<u8> {
    let mut current = bytes.to_vec();
    let count = current.len();
    // A byte may be unnecessary once later ones are zero.
    for _ in 0..2 {
        clear_block(&mut current, 0..count, holds);
    }
    for index in 0..count {
        let mut share = 0.5;
        for _ in 0..BYTE_STEPS {
            let mut changed = current.clone();
            changed[index] -= (f64::from(changed[index]) * share).ceil() as u8;
            if changed != current && holds(&changed) {
                current = changed;
            } else {
                share *= 0.5;
            }
        }
    }
    current
}

fn clear_block(
    current: &mut Vec<u8>,
    block: std::ops::Range<usize>,
    holds: &mut dyn FnMut(&[u8]) -> bool,
) {
    if current[block.clone()].iter().all(|&byte| byte == 0) {
        return;
    }
    let mut changed = current.clone();
    changed[block.clone()].fill(0);
    if holds(&changed) {
        *current = changed;
    } else if block.len() > 1 {
        let middle = block.start + block.len() / 2;
        clear_block(current, block.start..middle, holds);
        clear_block(current, middle..block.end, holds);
    }
}

/// Rounds each number that is not nominal to the fewest decimals for which `holds`.
fn round_numbers(
    mut scenario: Scenario,
    nominal: &[(String, f64)],
    holds: &mut dyn FnMut(&Scenario) -> bool,
) -> Scenario {
    for (path, value) in numbers(&scenario)
        .into_iter()
        .filter(|number| !nominal.contains(number))
    {
        for rounded in rounder_values(value) {
            if (rounded - value).abs() > MAX_ROUNDING_SHARE * value.abs() {
                continue;
            }
            if let Some(changed) =
                with_number(&scenario, &path, rounded).filter(|changed| holds(changed))
            {
                scenario = changed;
                break;
            }
        }
    }
    scenario
}

fn changed_numbers(nominal: &[(String, f64)], scenario: &Scenario) -> Vec<String> {
    let changed = numbers(scenario)
        .into_iter()
        .filter(|number| !nominal.contains(number));
    changed
        .map(|(path, value)| format!("{} {value}", path.trim_start_matches('/')))
        .collect()
}

/// Returns the path and value of each number with decimals. The position of a vehicle counts as the gap ahead of it.
fn numbers(scenario: &Scenario) -> Vec<(String, f64)> {
    fn collect(value: &Value, path: &str, into: &mut Vec<(String, f64)>) {
        match value {
            Value::Number(number) if number.is_f64() => {
                into.extend(number.as_f64().map(|number| (path.to_owned(), number)))
            }
            Value::Array(all) => all
                .iter()
                .enumerate()
                .for_each(|(i, item)| collect(item, &format!("{path}/{i}"), into)),
            Value::Object(all) => all
                .iter()
                .for_each(|(name, field)| collect(field, &format!("{path}/{name}"), into)),
            _ => {}
        }
    }
    let mut numbers = Vec::new();
    collect(&to_json(scenario), "", &mut numbers);
    numbers
}

fn with_number(scenario: &Scenario, path: &str, number: f64) -> Option<Scenario> {
    let mut value = to_json(scenario);
    *value.pointer_mut(path)? = number.into();
    let mut spec: ScenarioSpec = serde_json::from_value(value).ok()?;
    let leader_m = spec.vehicles.first()?.position_m;
    place_vehicles(&mut spec.vehicles, leader_m);
    Scenario::new(spec).ok()
}

/// Returns the scenario with gaps in place of the positions of all vehicles but the first.
fn to_json(scenario: &Scenario) -> Value {
    let mut spec = scenario.spec().clone();
    for (index, vehicle) in spec.vehicles.iter_mut().enumerate() {
        vehicle.position_m = scenario.initial_gap_m(index).unwrap_or(vehicle.position_m);
    }
    serde_json::to_value(spec).unwrap_or_default()
}
