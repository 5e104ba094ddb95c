//! Shrinking of failures: nearer to nominal, with fewer pieces and rounder values.

use crumple_spaces::{ScenarioSpace, SpaceParameter};

const MAX_ROUNDS: usize = 2;
/// Steps towards nominal for each coordinate and round: half of the way, and half as much after each failed step.
const NOMINAL_STEPS: usize = 4;
/// Maximum change by rounding, as a share of the range, so that a rounder value is not much more extreme.
const MAX_ROUNDING_SHARE: f64 = 0.1;
const MAX_DECIMALS: i32 = 3;

/// Returns the simplest values found for which `holds`, from `values` of the space. Moves have a fixed order, the
/// largest first: whole parameter to nominal; neighbouring pieces merged; part of the way to nominal; fewer decimals.
pub fn shrink(
    space: &ScenarioSpace,
    values: &[f64],
    holds: &mut dyn FnMut(&[f64]) -> bool,
) -> Vec<f64> {
    let mut current = values.to_vec();
    for _ in 0..MAX_ROUNDS {
        let before = current.clone();
        for parameter in space.parameters() {
            try_nominal(parameter, &mut current, holds);
        }
        for parameter in space.parameters() {
            join_pieces(parameter, &mut current, holds);
        }
        for parameter in space
            .parameters()
            .iter()
            .filter(|parameter| !parameter.is_choice())
        {
            move_towards_nominal(parameter, &mut current, holds);
        }
        for parameter in space
            .parameters()
            .iter()
            .filter(|parameter| !parameter.is_choice())
        {
            round_values(parameter, &mut current, holds);
        }
        if current == before {
            break;
        }
    }
    current
}

/// Accepts a change if the values differ and the failure survives.
fn attempt(
    current: &mut Vec<f64>,
    changed: Vec<f64>,
    holds: &mut dyn FnMut(&[f64]) -> bool,
) -> bool {
    let is_accepted = changed != *current && holds(&changed);
    if is_accepted {
        *current = changed;
    }
    is_accepted
}

fn try_nominal(
    parameter: &SpaceParameter,
    current: &mut Vec<f64>,
    holds: &mut dyn FnMut(&[f64]) -> bool,
) {
    let mut changed = current.clone();
    if let Some(own) = changed.get_mut(parameter.coordinates()) {
        own.copy_from_slice(parameter.nominal());
    }
    attempt(current, changed, holds);
}

/// Merges neighbouring pieces: runs of equal pieces take the value before or after them.
fn join_pieces(
    parameter: &SpaceParameter,
    current: &mut Vec<f64>,
    holds: &mut dyn FnMut(&[f64]) -> bool,
) {
    let range = parameter.coordinates();
    let mut border = range.start + 1;
    while border < range.end {
        let left = value_at(current, border - 1);
        let right = value_at(current, border);
        if left != right {
            let start = (range.start..border)
                .rev()
                .take_while(|&i| value_at(current, i) == left)
                .last()
                .unwrap_or(border);
            let end = (border..range.end)
                .take_while(|&i| value_at(current, i) == right)
                .last()
                .map_or(border, |i| i + 1);
            let mut all_left = current.clone();
            all_left.get_mut(border..end).unwrap_or_default().fill(left);
            let mut all_right = current.clone();
            all_right
                .get_mut(start..border)
                .unwrap_or_default()
                .fill(right);
            let _ = attempt(current, all_left, holds) || attempt(current, all_right, holds);
        }
        border += 1;
    }
}

fn value_at(values: &[f64], index: usize) -> f64 {
    values.get(index).copied().unwrap_or(f64::NAN)
}

fn move_towards_nominal(
    parameter: &SpaceParameter,
    current: &mut Vec<f64>,
    holds: &mut dyn FnMut(&[f64]) -> bool,
) {
    for run in equal_runs(parameter, current) {
        let nominal = parameter
            .nominal()
            .get(run.start - parameter.coordinates().start)
            .copied()
            .unwrap_or(0.0);
        let mut share = 0.5;
        for _ in 0..NOMINAL_STEPS {
            let Some(&value) = current.get(run.start) else {
                break;
            };
            let mut changed = current.clone();
            changed
                .get_mut(run.clone())
                .unwrap_or_default()
                .fill(value + share * (nominal - value));
            if !attempt(current, changed, holds) {
                share *= 0.5;
            }
        }
    }
}

/// Rounds values to the fewest decimals, from tens to thousandths, with which the failure survives. Tries the nearest
/// rounded value first, then the one on the other side.
fn round_values(
    parameter: &SpaceParameter,
    current: &mut Vec<f64>,
    holds: &mut dyn FnMut(&[f64]) -> bool,
) {
    let [low, high] = parameter.range();
    for run in equal_runs(parameter, current) {
        let Some(&value) = current.get(run.start) else {
            continue;
        };
        // A nominal value needs no rounding.
        if parameter
            .nominal()
            .get(run.start - parameter.coordinates().start)
            == Some(&value)
        {
            continue;
        }
        for rounded in rounder_values(value) {
            let mut changed = current.clone();
            changed
                .get_mut(run.clone())
                .unwrap_or_default()
                .fill(rounded);
            let near = (rounded - value).abs() <= MAX_ROUNDING_SHARE * (high - low);
            if near && (low..=high).contains(&rounded) && attempt(current, changed, holds) {
                break;
            }
        }
    }
}

/// Returns the numbers around a value that have fewer decimals, from tens to thousandths; the nearer side first.
pub fn rounder_values(value: f64) -> impl Iterator<Item = f64> {
    (-1..=MAX_DECIMALS)
        .flat_map(move |decimals| neighbours_with_decimals(value, decimals))
        .take_while(move |&rounded| rounded != value)
}

fn neighbours_with_decimals(value: f64, decimals: i32) -> [f64; 2] {
    let scale = 10f64.powi(decimals);
    let scaled = value * scale;
    let farther = if scaled.round() > scaled {
        scaled.floor()
    } else {
        scaled.ceil()
    };
    [scaled.round() / scale, farther / scale]
}

/// Returns the coordinates of a parameter, grouped by neighbouring pieces of equal value.
fn equal_runs(parameter: &SpaceParameter, current: &[f64]) -> Vec<std::ops::Range<usize>> {
    let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
    for index in parameter.coordinates() {
        match runs.last_mut() {
            Some(run) if current.get(run.start) == current.get(index) => run.end = index + 1,
            _ => runs.push(index..index + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_spaces::built_in_space;
    use proptest::prelude::*;

    #[test]
    fn irrelevant_parameters_become_nominal_and_others_round() {
        let space = built_in_space("high-risk").unwrap();
        let values = space.values(&space.draw_point(1, 5));
        let names = space.coordinate_names();
        let gap = names.iter().position(|name| name == "gap_ahead_m").unwrap();
        let brake = names
            .iter()
            .position(|name| name == "lead_brake_share_0")
            .unwrap();
        let mut start = values.clone();
        start[gap] = 3.4567;
        start[brake..brake + 5].copy_from_slice(&[0.912, 0.934, 0.95, 0.1, 0.2]);
        // Fails if the gap is small and the leader brakes hard over the first two pieces.
        let mut holds = |v: &[f64]| v[gap] < 8.3 && v[brake] > 0.7123 && v[brake + 1] > 0.7123;
        let shrunk = shrink(&space, &start, &mut holds);
        for (index, (value, nominal)) in shrunk.iter().zip(space.nominal()).enumerate() {
            let plays_a_part = index == gap || (brake..brake + 5).contains(&index);
            assert!(
                plays_a_part || *value == nominal,
                "{}: {value}",
                names[index]
            );
        }
        assert!([6.0, 7.0, 8.0].contains(&shrunk[gap]), "{}", shrunk[gap]);
        assert!(
            shrunk[brake..brake + 5]
                .iter()
                .all(|share| *share == shrunk[brake]),
            "one piece: {shrunk:?}"
        );
        let percent = 100.0 * shrunk[brake];
        assert!(
            (72.0..=91.0).contains(&percent) && (percent - percent.round()).abs() < 1e-9,
            "{percent}"
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Shrinking terminates, preserves the failure, and stays in the ranges.
        #[test]
        fn shrinking_preserves_the_failure(seed in any::<u64>(), weights in prop::collection::vec(-1.0..1.0f64, 15)) {
            let space = built_in_space("high-risk").unwrap();
            let start = space.draw_point(seed, 0);
            let score = |point: &[f64]| point.iter().zip(&weights).map(|(x, w)| x * w).sum::<f64>();
            let limit = score(&start) - 0.3;
            let mut attempts = 0;
            let mut holds = |values: &[f64]| {
                attempts += 1;
                score(&space.point(values)) >= limit
            };
            let shrunk = shrink(&space, &space.values(&start), &mut holds);
            prop_assert!(holds(&shrunk));
            prop_assert!(attempts < 700, "{attempts}");
            for (value, parameter) in shrunk.iter().zip(space.coordinate_parameters()) {
                let [low, high] = parameter.range();
                prop_assert!((low..=high).contains(value));
            }
        }
    }
}
