//! Minimisation of a smooth function of two variables.

const MAX_STEPS: usize = 400;
const TOLERANCE: f64 = 1e-7;

/// Minimises with the simplex of Nelder and Mead (A simplex method for function minimization, 1965), restarted once at
/// its result. Values that are not finite are the worst.
pub(super) fn minimize(of: &dyn Fn([f64; 2]) -> f64, start: [f64; 2]) -> [f64; 2] {
    let once = nelder_mead(of, start, 0.5);
    nelder_mead(of, once, 0.1)
}

fn nelder_mead(of: &dyn Fn([f64; 2]) -> f64, start: [f64; 2], size: f64) -> [f64; 2] {
    let evaluated = |at: [f64; 2]| {
        let value = of(at);
        (
            at,
            if value.is_finite() {
                value
            } else {
                f64::INFINITY
            },
        )
    };
    let [x, y] = start;
    let mut corners = [
        evaluated(start),
        evaluated([x + size, y]),
        evaluated([x, y + size]),
    ];
    for _ in 0..MAX_STEPS {
        corners.sort_by(|a, b| a.1.total_cmp(&b.1));
        let [best, middle, worst] = corners;
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        if apart(best.0, middle.0).max(apart(best.0, worst.0)) < TOLERANCE {
            break;
        }
        let towards = |share: f64| {
            let along = |axis: usize| {
                let centre = 0.5 * (best.0[axis] + middle.0[axis]);
                centre + share * (centre - worst.0[axis])
            };
            evaluated([along(0), along(1)])
        };
        let reflected = towards(1.0);
        let replaced = if reflected.1 < best.1 {
            let expanded = towards(2.0);
            Some(if expanded.1 < reflected.1 {
                expanded
            } else {
                reflected
            })
        } else if reflected.1 < middle.1 {
            Some(reflected)
        } else {
            let contracted = if reflected.1 < worst.1 {
                towards(0.5)
            } else {
                towards(-0.5)
            };
            (contracted.1 < worst.1.min(reflected.1)).then_some(contracted)
        };
        match replaced {
            Some(better) => corners[2] = better,
            None => {
                let half = |corner: [f64; 2]| {
                    evaluated([0.5 * (corner[0] + best.0[0]), 0.5 * (corner[1] + best.0[1])])
                };
                corners = [best, half(middle.0), half(worst.0)];
            }
        }
    }
    corners.sort_by(|a, b| a.1.total_cmp(&b.1));
    corners[0].0
}

/// Returns the Hessian by central differences; `None` if a value is not finite.
pub(super) fn hessian(of: &dyn Fn([f64; 2]) -> f64, [x, y]: [f64; 2]) -> Option<[[f64; 2]; 2]> {
    const STEP: f64 = 1e-3;
    let at = |i: f64, j: f64| of([x + i * STEP, y + j * STEP]);
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
    fn a_banana_is_descended_and_its_curvature_known() {
        let banana = |[x, y]: [f64; 2]| (1.0 - x).powi(2) + 100.0 * (y - x * x).powi(2);
        let found = minimize(&banana, [-1.2, 1.0]);
        assert!(
            (found[0] - 1.0).abs() < 1e-5 && (found[1] - 1.0).abs() < 1e-5,
            "{found:?}"
        );
        let [[xx, xy], [_, yy]] = hessian(&banana, found).unwrap();
        assert!(
            (xx - 802.0).abs() < 0.1 && (xy + 400.0).abs() < 0.1 && (yy - 200.0).abs() < 0.1,
            "{xx} {xy} {yy}"
        );
    }
}
