//! Resolution of recorded positions and times: the grid on which they lie, whatever digits a file prints.

use std::f64::consts::TAU;

/// Smallest increment of a position that is a movement, in metres.
const MIN_MOVEMENT_M: f64 = 1e-8;
/// Distance from a multiple of the grid that counts as on the grid, as a share of its step.
const ON_GRID: f64 = 0.05;
/// This distance in metres, at most: positions on a grid are exact but for single precision.
const MAX_OFF_GRID_M: f64 = 5e-4;
/// Number of positions from which the offset of a grid is taken.
const OFFSET_POSITIONS: usize = 64;
/// Positions that may be on no grid: one in ten, but at most one, such as the first vertex, and one in a hundred. More
/// of them show that the others are round values.
const EXCEPTION_OF: usize = 10;
const FURTHER_EXCEPTION_OF: usize = 100;
/// Number of movements from which on they show a grid. By chance, one in ten is on a given grid.
const LEAST_MOVEMENTS: usize = 4;
/// Coarsest and finest step, in metres.
const MAX_STEP_M: f64 = 0.125;
const MIN_STEP_M: f64 = 1e-6;
/// Units of grids in metres: metres and feet with their decimal places, and binary fractions of a metre.
const DECIMAL_UNITS_M: [f64; 2] = [1.0, 0.3048];
const DECIMAL_STEPS: [f64; 3] = [1.0, 0.5, 0.2];
const FINEST_BINARY_DIGIT: i32 = 14;

/// Returns the step of the coarsest grid on which positions lie, but for a common offset; 0 without a grid, in metres.
pub(super) fn grid_step_m(positions_m: &[f64]) -> f64 {
    let mut steps_m = candidate_steps_m().into_iter();
    steps_m
        .find(|step_m| are_on_grid(positions_m, *step_m))
        .unwrap_or(0.0)
}

/// Longest time between the vertices of a recording, in seconds.
const MAX_RECORDING_STEP_S: f64 = 0.2;
/// Largest distance of a rounded time from a line, in steps.
const MAX_OFF_LINE: f64 = 0.6;
/// Largest share of vertices that are missing.
const MAX_MISSING: f64 = 0.05;

/// Returns the times of vertices at a constant rate, of which few may be missing, if the times are these but for
/// rounding to a step. The first and the last time stay.
pub(super) fn regular_times_s(times_s: &[f64]) -> Option<Vec<f64>> {
    let [first_s, .., last_s] = times_s else {
        return None;
    };
    let indices = regular_indices(times_s)?;
    let interval_s = (last_s - first_s) / indices.last()?;
    let step_s = grid_step_m(times_s);
    if interval_s > MAX_RECORDING_STEP_S || step_s == 0.0 {
        return None;
    }
    let regular_s = indices.iter().map(|index| first_s + index * interval_s);
    let regular_s: Vec<f64> = regular_s.collect();
    let off_s: Vec<f64> = regular_s
        .iter()
        .zip(times_s)
        .map(|(s, time_s)| time_s - s)
        .collect();
    are_on_line(&indices, &off_s, MAX_OFF_LINE * step_s).then_some(regular_s)
}

/// Returns the numbers of vertices at a constant rate; `None` if too many are missing.
fn regular_indices(times_s: &[f64]) -> Option<Vec<f64>> {
    let pairs = times_s.iter().zip(times_s.iter().skip(1));
    let intervals_s: Vec<f64> = pairs.map(|(from_s, to_s)| to_s - from_s).collect();
    let mut sorted_s = intervals_s.clone();
    sorted_s.sort_by(f64::total_cmp);
    let median_s = sorted_s.get(sorted_s.len() / 2)?;
    let mut indices = vec![0.0];
    let mut index = 0.0;
    for interval_s in intervals_s {
        index += (interval_s / median_s).round().max(1.0);
        indices.push(index);
    }
    let missing = index + 1.0 - times_s.len() as f64;
    (missing <= MAX_MISSING * times_s.len() as f64).then_some(indices)
}

/// Returns true if values are near the line through all of them (least squares). The first and the last one are
/// rounded, too.
fn are_on_line(indices: &[f64], values: &[f64], distance: f64) -> bool {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let [middle, mean_value] = [mean(indices), mean(values)];
    let centred = indices.iter().map(|index| index - middle);
    let products = centred
        .clone()
        .zip(values)
        .map(|(index, value)| index * value);
    let products: f64 = products.sum();
    let squares: f64 = centred.clone().map(|index| index * index).sum();
    let mut pairs = centred.zip(values);
    pairs.all(|(index, value)| (value - mean_value - index * products / squares).abs() <= distance)
}

/// Returns the steps of grids, coarse to fine.
fn candidate_steps_m() -> Vec<f64> {
    let mut steps_m = Vec::new();
    for unit_m in DECIMAL_UNITS_M {
        for decimals in 0..=6 {
            let last_digit_m = unit_m * libm::pow(10.0, -f64::from(decimals));
            steps_m.extend(DECIMAL_STEPS.map(|step| step * last_digit_m));
        }
    }
    steps_m.extend((0..=FINEST_BINARY_DIGIT).map(|digit| libm::pow(2.0, -f64::from(digit))));
    steps_m.retain(|step_m| (MIN_STEP_M..=MAX_STEP_M).contains(step_m));
    steps_m.sort_by(|a, b| b.total_cmp(a));
    steps_m
}

fn are_on_grid(positions_m: &[f64], step_m: f64) -> bool {
    let pairs = positions_m.iter().zip(positions_m.iter().skip(1));
    let increments_m: Vec<f64> = pairs.map(|(from_m, to_m)| to_m - from_m).collect();
    let movements = increments_m.iter().map(|increment_m| increment_m.abs());
    let movements = movements.filter(|movement_m| *movement_m >= MIN_MOVEMENT_M);
    let count = movements.clone().count();
    // A movement of less than half a step shows another grid.
    let small = movements.filter(|movement_m| *movement_m < 0.5 * step_m);
    count >= LEAST_MOVEMENTS
        && small.count() <= exceptions(count)
        && has_different_multiples(&increments_m, step_m)
        && have_common_offset(positions_m, step_m)
}

/// Returns true if positions are multiples of a step, but for an offset and few exceptions.
fn have_common_offset(positions_m: &[f64], step_m: f64) -> bool {
    let first_m = positions_m.first().copied().unwrap_or(0.0);
    let stride = positions_m.len().div_ceil(OFFSET_POSITIONS).max(1);
    let angles = positions_m
        .iter()
        .step_by(stride)
        .map(|position_m| ((position_m - first_m) / step_m).fract() * TAU);
    let [sine, cosine] = angles.fold([0.0, 0.0], |[sine, cosine], angle| {
        [sine + libm::sin(angle), cosine + libm::cos(angle)]
    });
    let offset = libm::atan2(sine, cosine) / TAU;
    let off_grid = ON_GRID.min(MAX_OFF_GRID_M / step_m);
    let mut others = positions_m.iter().filter(|position_m| {
        let steps = (*position_m - first_m) / step_m - offset;
        (steps - steps.round()).abs() > off_grid
    });
    others.nth(exceptions(positions_m.len())).is_none()
}

/// Returns how many of `count` positions or movements may be none of a grid.
fn exceptions(count: usize) -> usize {
    (count / EXCEPTION_OF).min(1 + count / FURTHER_EXCEPTION_OF)
}

/// Returns true if increments are different multiples of a step, with 0: at constant speed, rounding makes two.
fn has_different_multiples(increments_m: &[f64], step_m: f64) -> bool {
    let mut multiples = increments_m
        .iter()
        .map(|increment_m| (increment_m / step_m).round());
    let first = multiples.next();
    multiples.any(|multiple| Some(multiple) != first)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of a vehicle that brakes, in steps of 0.1 s.
    fn driven_m() -> Vec<f64> {
        (0..80)
            .map(|sample| 0.1 * f64::from(sample))
            .map(|time_s| 6.3 * std::f64::consts::PI * time_s - f64::sqrt(1.3) * time_s * time_s)
            .collect()
    }

    fn rounded_m(step_m: f64) -> Vec<f64> {
        let steps = driven_m().into_iter();
        steps.map(|m| (m / step_m).round() * step_m).collect()
    }

    #[test]
    fn the_grid_of_rounded_positions_is_found() {
        for step_m in [
            0.1,
            0.05,
            0.01,
            0.001,
            1e-5,
            0.0625,
            1.0 / 128.0,
            0.03048,
            0.003048,
        ] {
            let found_m = grid_step_m(&rounded_m(step_m));
            assert!(
                (found_m - step_m).abs() < 1e-9 * step_m,
                "{step_m}: {found_m}"
            );
        }
    }

    /// An offset, a place far from the origin, single precision and a first position of another source change nothing.
    #[test]
    fn the_grid_does_not_depend_on_offsets() {
        let moved = |offset_m: f64| -> Vec<f64> {
            rounded_m(0.01).into_iter().map(|m| m + offset_m).collect()
        };
        let mut first = moved(0.0);
        first[0] += 0.003_217;
        let single = moved(1234.56).into_iter().map(|m| f64::from(m as f32));
        for positions_m in [
            moved(0.001_234_567),
            moved(5_000_000.0),
            first,
            single.collect(),
        ] {
            assert_eq!(grid_step_m(&positions_m), 0.01);
        }
    }

    /// At constant speed, the movements are two adjacent multiples of the step, of which one may be none.
    #[test]
    fn the_grid_at_constant_speed_is_found() {
        for (speed_mps, step_m) in [(20.37, 0.01), (20.37, 0.1), (0.7, 0.05), (25.03, 0.001)] {
            let positions_m = (0..100).map(|sample| 0.04 * f64::from(sample) * speed_mps);
            let positions_m = positions_m.map(|m| (m / step_m).round() * step_m);
            let found_m = grid_step_m(&positions_m.collect::<Vec<f64>>());
            assert!((found_m - step_m).abs() < 1e-9, "{speed_mps}: {found_m}");
        }
    }

    #[test]
    fn rounded_times_at_a_constant_rate_are_regular() {
        let rounded_s = |rate_hz: f64, step_s: f64| -> Vec<f64> {
            let exact = (0..200).map(|index| 3.0 + f64::from(index) / rate_hz);
            exact.map(|s| (s / step_s).round() * step_s).collect()
        };
        for (rate_hz, step_s) in [(30.0, 0.001), (29.97, 0.001), (30.0, 0.01), (12.0, 0.01)] {
            let regular_s = regular_times_s(&rounded_s(rate_hz, step_s)).unwrap();
            for (index, time_s) in regular_s.iter().enumerate() {
                let off_s = time_s - 3.0 - index as f64 / rate_hz;
                assert!(off_s.abs() <= 0.5 * step_s + 1e-9, "{rate_hz}: {off_s}");
            }
        }
        // Missing vertices.
        for (rate_hz, step_s) in [(30.0, 0.001), (29.97, 0.001), (30.0, 0.01), (60.0, 0.01)] {
            let [mut gaps_s, mut exact_s] = [rounded_s(rate_hz, step_s), rounded_s(rate_hz, 1e-9)];
            for index in [171, 70, 69] {
                gaps_s.remove(index);
                exact_s.remove(index);
            }
            let regular_s = regular_times_s(&gaps_s).unwrap();
            for (time_s, exact_s) in regular_s.iter().zip(exact_s) {
                let off_s = time_s - exact_s;
                assert!(off_s.abs() <= 0.5 * step_s + 1e-8, "{rate_hz}: {off_s}");
            }
        }
        // Regular without rounding, and times that are planned.
        assert_eq!(regular_times_s(&rounded_s(25.0, 0.001)), None);
        assert_eq!(regular_times_s(&[0.0, 1.0, 2.0, 3.1, 4.0, 5.0]), None);
        assert_eq!(regular_times_s(&[0.0, 0.1, 0.2, 0.35, 0.4, 0.5]), None);
        assert_eq!(regular_times_s(&[]), None);
    }

    #[test]
    fn exact_positions_have_no_grid() {
        assert_eq!(grid_step_m(&driven_m()), 0.0);
        assert_eq!(grid_step_m(&[0.0, 20.0, 40.0]), 0.0);
        // At 22.43 m/s with noise, each increment is within 6 mm of 1.125 m; these positions have four decimals.
        let noisy_m = [0.0, 1.1213, 2.2421, 3.3621, 4.4819, 5.6024, 6.7232, 7.8457];
        assert_eq!(grid_step_m(&noisy_m), 1e-4);
        // Increments at 5 Hz of a vehicle that brakes at 3 m/s² are near multiples of 2 cm, and positions are not.
        let positions_m = (0..50).map(|sample| 0.2 * f64::from(sample)).map(|time_s| {
            let braked_s = f64::max(time_s - 3.0, 0.0);
            20.001 * time_s - 1.5 * braked_s * braked_s
        });
        assert!(grid_step_m(&positions_m.collect::<Vec<f64>>()) < 1e-3);
        assert_eq!(grid_step_m(&[3.0; 50]), 0.0);
        assert_eq!(grid_step_m(&[]), 0.0);
    }
}
