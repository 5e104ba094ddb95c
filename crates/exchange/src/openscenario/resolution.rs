//! Resolution of recorded positions: the grid on which they lie, whatever digits a file prints.

/// Smallest increment of a position that is a movement, in metres.
const MIN_MOVEMENT_M: f64 = 1e-8;
/// Distance from a multiple of the grid that counts as on the grid, as a share of its step.
const ON_GRID: f64 = 0.05;
/// This distance in metres, at most: positions on a grid are exact but for single precision. At nearly constant speed,
/// all increments are near a multiple of some coarse step.
const MAX_OFF_GRID_M: f64 = 5e-4;
/// Number of different multiples of the step from which on increments show a grid.
const LEAST_MULTIPLES: usize = 3;
/// Share of the increments that must be on a grid. The first vertex may be that of another source.
const LEAST_ON_GRID: f64 = 0.9;
/// Number of movements from which on they show a grid. By chance, one in ten is on a given grid.
const LEAST_MOVEMENTS: usize = 4;
/// Coarsest and finest step, in metres.
const MAX_STEP_M: f64 = 0.125;
const MIN_STEP_M: f64 = 1e-6;
/// Units of grids in metres: metres and feet with their decimal places, and binary fractions of a metre.
const DECIMAL_UNITS_M: [f64; 2] = [1.0, 0.3048];
const DECIMAL_STEPS: [f64; 3] = [1.0, 0.5, 0.2];
const FINEST_BINARY_DIGIT: i32 = 14;

/// Returns the step of the coarsest grid on which the increments of positions lie; 0 without a grid, in metres.
pub(super) fn grid_step_m(positions_m: &[f64]) -> f64 {
    let pairs = positions_m.iter().zip(positions_m.iter().skip(1));
    let increments = pairs.map(|(from_m, to_m)| to_m - from_m);
    let movements_m: Vec<f64> = increments
        .filter(|increment_m| increment_m.abs() >= MIN_MOVEMENT_M)
        .collect();
    if movements_m.len() < LEAST_MOVEMENTS {
        return 0.0;
    }
    let mut steps_m = candidate_steps_m().into_iter();
    steps_m
        .find(|step_m| are_on_grid(&movements_m, *step_m))
        .unwrap_or(0.0)
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

fn are_on_grid(movements_m: &[f64], step_m: f64) -> bool {
    let off_grid = ON_GRID.min(MAX_OFF_GRID_M / step_m);
    let allowed = ((1.0 - LEAST_ON_GRID) * movements_m.len() as f64) as usize;
    let mut others = movements_m.iter().filter(|movement_m| {
        let steps = *movement_m / step_m;
        // A movement of less than half a step shows another grid.
        steps.round() == 0.0 || (steps - steps.round()).abs() > off_grid
    });
    others.nth(allowed).is_none() && has_different_multiples(movements_m, step_m)
}

fn has_different_multiples(movements_m: &[f64], step_m: f64) -> bool {
    let mut multiples: Vec<f64> = movements_m
        .iter()
        .map(|movement_m| (movement_m / step_m).round())
        .collect();
    multiples.sort_by(f64::total_cmp);
    multiples.dedup();
    multiples.len() >= LEAST_MULTIPLES
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

    #[test]
    fn exact_positions_have_no_grid() {
        assert_eq!(grid_step_m(&driven_m()), 0.0);
        assert_eq!(grid_step_m(&[0.0, 20.0, 40.0]), 0.0);
        // At 22.43 m/s with noise, each increment is within 6 mm of 1.125 m; these positions have four decimals.
        let noisy_m = [0.0, 1.1213, 2.2421, 3.3621, 4.4819, 5.6024, 6.7232, 7.8457];
        assert_eq!(grid_step_m(&noisy_m), 1e-4);
        assert_eq!(grid_step_m(&[3.0; 50]), 0.0);
        assert_eq!(grid_step_m(&[]), 0.0);
    }
}
