//! Minimisation of a smooth function of two variables.

const MAX_STEPS: usize = 400;
const TOLERANCE: f64 = 1e-7;

/// Minimises with the simplex of Nelder and Mead (A simplex method for function minimization, 1965), restarted once at
/// its result. Values that are not finite are the worst.
pub(super) fn minimize(function: &Function<'_>, start: [f64; 2]) -> [f64; 2] {
    let first_result = nelder_mead(function, start, 0.5);
    nelder_mead(function, first_result, 0.1)
}

type Function<'a> = dyn Fn([f64; 2]) -> f64 + 'a;

/// A corner of the simplex.
#[derive(Clone, Copy)]
struct Corner {
    point: [f64; 2],
    value: f64,
}

impl Corner {
    fn evaluate(function: &Function<'_>, point: [f64; 2]) -> Self {
        let value = function(point);
        let value = if value.is_finite() {
            value
        } else {
            f64::INFINITY
        };
        Self { point, value }
    }

    fn distance(&self, corner: &Self) -> f64 {
        let [x, y] = self.point;
        (x - corner.point[0]).abs().max((y - corner.point[1]).abs())
    }
}

fn nelder_mead(function: &Function<'_>, start: [f64; 2], size: f64) -> [f64; 2] {
    let [x, y] = start;
    let mut corners =
        [start, [x + size, y], [x, y + size]].map(|point| Corner::evaluate(function, point));
    for _ in 0..MAX_STEPS {
        corners.sort_by(|a, b| a.value.total_cmp(&b.value));
        let [best, middle, worst] = corners;
        if best.distance(&middle).max(best.distance(&worst)) < TOLERANCE {
            break;
        }
        corners = match find_better_corner(function, corners) {
            Some(better) => [best, middle, better],
            None => [
                best,
                halve_distance(function, middle, best),
                halve_distance(function, worst, best),
            ],
        };
    }
    corners.sort_by(|a, b| a.value.total_cmp(&b.value));
    corners[0].point
}

/// Reflects, expands or contracts the worst corner of a sorted simplex; `None` if no such corner is better.
fn find_better_corner(
    function: &Function<'_>,
    [best, middle, worst]: [Corner; 3],
) -> Option<Corner> {
    let beyond_centre = |share: f64| {
        let point = std::array::from_fn(|axis| {
            let centre = 0.5 * (best.point[axis] + middle.point[axis]);
            centre + share * (centre - worst.point[axis])
        });
        Corner::evaluate(function, point)
    };
    let reflected = beyond_centre(1.0);
    if reflected.value < best.value {
        let expanded = beyond_centre(2.0);
        return Some(if expanded.value < reflected.value {
            expanded
        } else {
            reflected
        });
    }
    if reflected.value < middle.value {
        return Some(reflected);
    }
    let contracted = beyond_centre(if reflected.value < worst.value {
        0.5
    } else {
        -0.5
    });
    (contracted.value < worst.value.min(reflected.value)).then_some(contracted)
}

/// Returns the corner half-way to the best one.
fn halve_distance(function: &Function<'_>, corner: Corner, best: Corner) -> Corner {
    let point = std::array::from_fn(|axis| 0.5 * (corner.point[axis] + best.point[axis]));
    Corner::evaluate(function, point)
}

/// Returns the Hessian by central differences; `None` if a value is not finite.
pub(super) fn hessian(function: &Function<'_>, [x, y]: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    const STEP: f64 = 1e-3;
    let at = |i: f64, j: f64| function([x + i * STEP, y + j * STEP]);
    let squared = STEP * STEP;
    let middle = at(0.0, 0.0);
    let xx = (at(1.0, 0.0) - 2.0 * middle + at(-1.0, 0.0)) / squared;
    let yy = (at(0.0, 1.0) - 2.0 * middle + at(0.0, -1.0)) / squared;
    let xy = (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / (4.0 * squared);
    [xx, yy, xy]
        .iter()
        .all(|entry| entry.is_finite())
        .then_some([[xx, xy], [xy, yy]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minimum_and_hessian_of_the_banana_function() {
        let banana = |[x, y]: [f64; 2]| (1.0 - x).powi(2) + 100.0 * (y - x * x).powi(2);
        let minimum = minimize(&banana, [-1.2, 1.0]);
        assert!(
            (minimum[0] - 1.0).abs() < 1e-5 && (minimum[1] - 1.0).abs() < 1e-5,
            "{minimum:?}"
        );
        let [[xx, xy], [_, yy]] = hessian(&banana, minimum).unwrap();
        assert!(
            (xx - 802.0).abs() < 0.1 && (xy + 400.0).abs() < 0.1 && (yy - 200.0).abs() < 0.1,
            "{xx} {xy} {yy}"
        );
    }
}
