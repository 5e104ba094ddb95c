//! Dependence of the features of episodes: correlations of a Gaussian copula.

use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, Normal};

use crumple_spaces::{DistributionSpec, ParameterValue};

/// Minimum eigenvalue of a matrix whose entries were estimated pair by pair and may be inconsistent.
const MIN_EIGENVALUE: f64 = 1e-3;
/// Maximum correlation for features with point masses.
const MAX_CORRELATION: f64 = 0.99;

pub(super) struct CopulaColumn<'a> {
    pub(super) values: &'a [f64],
    pub(super) distribution: &'a DistributionSpec,
}

/// Estimates the correlations of normal scores: ranks over n + 1 as normal numbers, with mean ranks for equal values.
/// For many values this is as efficient as any estimate that knows the marginals (Klaassen and Wellner, Efficient
/// estimation in the bivariate normal copula model, Bernoulli 3, 1997). The normal number of a point mass is known only
/// as an interval, and ranks would underestimate the dependence. Pairs with such values use the maximum likelihood of
/// the correlation, with scores for the other values (polyserial correlation: Olsson, Drasgow and Dorans, Psychometrika
/// 47, 1982). A term ln (1 − ρ²) keeps few values from giving ρ = ±1.
pub(super) fn estimate_correlation(columns: &[CopulaColumn<'_>]) -> Vec<Vec<f64>> {
    let latent: Vec<LatentColumn> = columns.iter().map(LatentColumn::new).collect();
    let entry = |row: usize, column: usize| {
        if row == column {
            return 1.0;
        }
        latent[row.min(column)].correlation(&latent[row.max(column)])
    };
    let found = (0..latent.len())
        .map(|row| (0..latent.len()).map(|column| entry(row, column)).collect())
        .collect();
    if latent.iter().any(|one| one.has_points) {
        shrink_to_positive_definite(found)
    } else {
        found
    }
}

/// Shrinks a matrix towards independence until its eigenvalues are at least [`MIN_EIGENVALUE`].
pub(super) fn shrink_to_positive_definite(entries: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let least = DMatrix::from_fn(entries.len(), entries.len(), |row, column| {
        entries[row][column]
    });
    let least = least.symmetric_eigenvalues().min();
    if least >= MIN_EIGENVALUE {
        return entries;
    }
    // (1 − s) R + s I moves the eigenvalues of R towards 1.
    let kept = 1.0 - (MIN_EIGENVALUE - least) / (1.0 - least);
    let drawn = |(row, entries): (usize, Vec<f64>)| {
        entries
            .into_iter()
            .enumerate()
            .map(|(column, entry)| if row == column { 1.0 } else { kept * entry })
            .collect()
    };
    entries.into_iter().enumerate().map(drawn).collect()
}

/// Normal number of a value, or its bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LatentNormal {
    Exact(f64),
    Interval(f64, f64),
}

struct LatentColumn {
    scores: Vec<f64>,
    latent: Vec<LatentNormal>,
    has_points: bool,
}

impl LatentColumn {
    fn new(column: &CopulaColumn<'_>) -> Self {
        let CopulaColumn {
            values,
            distribution,
        } = *column;
        let is_point = |value: f64| match distribution {
            DistributionSpec::Choice(_) => true,
            DistributionSpec::PointMass(point) => value == point.at,
            _ => false,
        };
        let place = |value: f64| match distribution {
            DistributionSpec::Choice(choice) => choice
                .values
                .iter()
                .position(|known| *known == ParameterValue::Number(value))
                .map_or(f64::NAN, |at| at as f64),
            _ => value,
        };
        let values: Vec<f64> = values.iter().map(|&value| place(value)).collect();
        let n = values.len();
        let score = |rank: f64| Normal::standard().inverse_cdf(rank / (n as f64 + 1.0));
        // Scores of few values have a variance below 1.
        let spread =
            ((1..=n).map(|rank| score(rank as f64).powi(2)).sum::<f64>() / n.max(1) as f64).sqrt();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let (mut scores, mut known) = (vec![0.0; n], vec![LatentNormal::Exact(0.0); n]);
        let mut before = 0;
        for equal in order.chunk_by(|&a, &b| values[a] == values[b]) {
            let until = before + equal.len();
            let middle = score(0.5 * ((before + 1) as f64 + until as f64));
            // Half-way between ranks; unbounded before the first and after the last.
            let end = |rank: usize| match rank {
                0 => f64::NEG_INFINITY,
                rank if rank == n => f64::INFINITY,
                rank => score(rank as f64 + 0.5) / spread,
            };
            let is_point = equal
                .first()
                .is_some_and(|&index| is_point(column.values[index]));
            let latent = if is_point {
                LatentNormal::Interval(end(before), end(until))
            } else {
                LatentNormal::Exact(middle / spread)
            };
            equal
                .iter()
                .for_each(|&index| (scores[index], known[index]) = (middle, latent));
            before = until;
        }
        let has_points = known
            .iter()
            .any(|latent| matches!(latent, LatentNormal::Interval(..)));
        Self {
            scores,
            latent: known,
            has_points,
        }
    }

    fn correlation(&self, other: &Self) -> f64 {
        if !(self.has_points || other.has_points) {
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let (a, b) = (&self.scores, &other.scores);
            return (product(a, b) / (product(a, a) * product(b, b)).sqrt()).clamp(-1.0, 1.0);
        }
        let pairs = LatentPairs::new(self, other);
        maximize_over_correlation(&|rho| pairs.ln_likelihood(rho))
    }
}

#[derive(Default)]
struct LatentPairs {
    /// Pairs of exact numbers: count, Σ x² + y², and Σ x y.
    exact_sums: [f64; 3],
    /// Exact numbers with the bounds of the other.
    half_exact: Vec<(f64, [f64; 2])>,
    /// Bounds of both, with the number of such pairs.
    rectangles: Vec<([f64; 2], [f64; 2], f64)>,
}

impl LatentPairs {
    fn new(a: &LatentColumn, b: &LatentColumn) -> Self {
        let mut pairs = Self::default();
        for pair in a.latent.iter().zip(&b.latent) {
            match pair {
                (LatentNormal::Exact(x), LatentNormal::Exact(y)) => {
                    let [count, squares, products] = &mut pairs.exact_sums;
                    (*count, *squares, *products) =
                        (*count + 1.0, *squares + x * x + y * y, *products + x * y);
                }
                (LatentNormal::Exact(x), LatentNormal::Interval(low, high))
                | (LatentNormal::Interval(low, high), LatentNormal::Exact(x)) => {
                    pairs.half_exact.push((*x, [*low, *high]));
                }
                (LatentNormal::Interval(low_x, high_x), LatentNormal::Interval(low_y, high_y)) => {
                    let (x, y) = ([*low_x, *high_x], [*low_y, *high_y]);
                    match pairs
                        .rectangles
                        .iter_mut()
                        .find(|known| (known.0, known.1) == (x, y))
                    {
                        Some(known) => known.2 += 1.0,
                        None => pairs.rectangles.push((x, y, 1.0)),
                    }
                }
            }
        }
        pairs
    }

    /// Returns the log-likelihood of a correlation up to a constant, with ln (1 − ρ²).
    fn ln_likelihood(&self, rho: f64) -> f64 {
        let rest = 1.0 - rho * rho;
        let [count, squares, products] = self.exact_sums;
        let exact = -0.5 * count * rest.ln() - (squares - 2.0 * rho * products) / (2.0 * rest)
            + 0.5 * squares;
        let cdf = |x: f64| Normal::standard().cdf(x);
        let given = |x: f64, end: f64| {
            if end.is_finite() {
                cdf((end - rho * x) / rest.sqrt())
            } else {
                cdf(end)
            }
        };
        let half = |(x, [low, high]): &(f64, [f64; 2])| {
            (given(*x, *high) - given(*x, *low)).max(1e-300).ln()
        };
        let rectangle = |([left, right], [low, high], count): &([f64; 2], [f64; 2], f64)| {
            let below = |x: f64, y: f64| bivariate_normal_cdf(x, y, rho);
            let inside = below(*right, *high) - below(*left, *high) - below(*right, *low)
                + below(*left, *low);
            count * inside.max(1e-300).ln()
        };
        exact
            + self.half_exact.iter().map(half).sum::<f64>()
            + self.rectangles.iter().map(rectangle).sum::<f64>()
            + rest.ln()
    }
}

/// Returns the probability that two correlated normal numbers are below `x` and `y`: Φ(x) Φ(y) + ∫ φ₂(x, y; r) dr from
/// 0 to ρ, with r = sin θ (Drezner and Wesolowsky, On the computation of the bivariate normal integral, 1990).
fn bivariate_normal_cdf(x: f64, y: f64, rho: f64) -> f64 {
    const PARTS: usize = 32;
    let apart = Normal::standard().cdf(x) * Normal::standard().cdf(y);
    if !(x.is_finite() && y.is_finite()) {
        return apart;
    }
    let height = |theta: f64| {
        (-(x * x + y * y - 2.0 * x * y * theta.sin()) / (2.0 * theta.cos().powi(2))).exp()
    };
    let step = rho.asin() / PARTS as f64;
    let weight = |part: usize| {
        if part == 0 || part == PARTS {
            1.0
        } else {
            2.0 + 2.0 * (part % 2) as f64
        }
    };
    let sum: f64 = (0..=PARTS)
        .map(|part| weight(part) * height(part as f64 * step))
        .sum();
    apart + sum * step / 3.0 / (2.0 * std::f64::consts::PI)
}

/// Maximises a function of a correlation: a coarse grid, then golden section search.
fn maximize_over_correlation(of: &dyn Fn(f64) -> f64) -> f64 {
    const GRID: i32 = 20;
    const STEPS: usize = 40;
    let at = |index: i32| MAX_CORRELATION * f64::from(index) / f64::from(GRID);
    let best = (-GRID..=GRID)
        .max_by(|&a, &b| of(at(a)).total_cmp(&of(at(b))))
        .unwrap_or(0);
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut low, mut high) = (at((best - 1).max(-GRID)), at((best + 1).min(GRID)));
    let inner = |low: f64, high: f64| (high - golden * (high - low), low + golden * (high - low));
    let (mut a, mut b) = inner(low, high);
    let (mut of_a, mut of_b) = (of(a), of(b));
    for _ in 0..STEPS {
        if of_a >= of_b {
            (high, b, of_b) = (b, a, of_a);
            a = inner(low, high).0;
            of_a = of(a);
        } else {
            (low, a, of_a) = (a, b, of_b);
            b = inner(low, high).1;
            of_b = of(b);
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_of_rectangles_are_known() {
        for rho in [-0.95_f64, -0.4, 0.0, 0.3, 0.9] {
            let known = 0.25 + rho.asin() / (2.0 * std::f64::consts::PI);
            assert!(
                (bivariate_normal_cdf(0.0, 0.0, rho) - known).abs() < 1e-9,
                "{rho}"
            );
            assert!(
                (bivariate_normal_cdf(0.7, f64::INFINITY, rho) - Normal::standard().cdf(0.7)).abs()
                    < 1e-12
            );
            assert!(
                (bivariate_normal_cdf(0.7, 9.0, rho) - Normal::standard().cdf(0.7)).abs() < 1e-6,
                "{rho}"
            );
            assert_eq!(bivariate_normal_cdf(f64::NEG_INFINITY, 0.7, rho), 0.0);
        }
    }
}
