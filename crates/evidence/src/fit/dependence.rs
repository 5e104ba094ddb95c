//! Dependence of the features of episodes: correlations of a Gaussian copula.

use std::cmp::Ordering;

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
    let rows = latent.iter().enumerate().map(|(row, a)| {
        let entries = latent.iter().enumerate();
        entries
            .map(|(column, b)| match row.cmp(&column) {
                Ordering::Less => a.correlation(b),
                Ordering::Equal => 1.0,
                Ordering::Greater => b.correlation(a),
            })
            .collect()
    });
    let correlation = rows.collect();
    if latent.iter().any(|column| column.has_points) {
        shrink_to_positive_definite(correlation)
    } else {
        correlation
    }
}

/// Shrinks a matrix towards independence until its eigenvalues are at least [`MIN_EIGENVALUE`].
pub(super) fn shrink_to_positive_definite(mut entries: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let matrix = DMatrix::from_fn(entries.len(), entries.len(), |row, column| {
        entries[row][column]
    });
    let min_eigenvalue = matrix.symmetric_eigenvalues().min();
    if min_eigenvalue >= MIN_EIGENVALUE {
        return entries;
    }
    // (1 − s) R + s I moves the eigenvalues of R towards 1.
    let factor = 1.0 - (MIN_EIGENVALUE - min_eigenvalue) / (1.0 - min_eigenvalue);
    for (row, entries) in entries.iter_mut().enumerate() {
        for (column, entry) in entries.iter_mut().enumerate() {
            *entry = if row == column { 1.0 } else { factor * *entry };
        }
    }
    entries
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
        let values: Vec<f64> = column
            .values
            .iter()
            .map(|&value| column.sort_key(value))
            .collect();
        let ranks = NormalScores::new(values.len());
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
        let mut scores = vec![0.0; values.len()];
        let mut latent = vec![LatentNormal::Exact(0.0); values.len()];
        let mut has_points = false;
        let mut before = 0;
        for equal in order.chunk_by(|&a, &b| values[a] == values[b]) {
            let until = before + equal.len();
            let mean_score = ranks.score(0.5 * ((before + 1) as f64 + until as f64));
            let is_point = equal
                .first()
                .is_some_and(|&index| column.is_point(column.values[index]));
            let latent_normal = if is_point {
                LatentNormal::Interval(ranks.end(before), ranks.end(until))
            } else {
                LatentNormal::Exact(mean_score / ranks.spread)
            };
            has_points |= is_point;
            for &index in equal {
                scores[index] = mean_score;
                latent[index] = latent_normal;
            }
            before = until;
        }
        Self {
            scores,
            latent,
            has_points,
        }
    }

    fn correlation(&self, column: &Self) -> f64 {
        if !(self.has_points || column.has_points) {
            let a = &self.scores;
            let b = &column.scores;
            let lengths = (dot(a, a) * dot(b, b)).sqrt();
            return (dot(a, b) / lengths).clamp(-1.0, 1.0);
        }
        let pairs = LatentPairs::new(self, column);
        maximize_over_correlation(&|rho| pairs.ln_likelihood(rho))
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()
}

impl CopulaColumn<'_> {
    /// True if the value has a probability of its own.
    fn is_point(&self, value: f64) -> bool {
        match self.distribution {
            DistributionSpec::Choice(_) => true,
            DistributionSpec::PointMass(point) => value == point.at,
            _ => false,
        }
    }

    /// Returns the value, or its index among the choices of the distribution.
    fn sort_key(&self, value: f64) -> f64 {
        match self.distribution {
            DistributionSpec::Choice(choice) => choice
                .values
                .iter()
                .position(|choice| *choice == ParameterValue::Number(value))
                .map_or(f64::NAN, |index| index as f64),
            _ => value,
        }
    }
}

/// Normal scores of ranks.
struct NormalScores {
    count: usize,
    /// Standard deviation of the scores: below 1 for few values.
    spread: f64,
}

impl NormalScores {
    fn new(count: usize) -> Self {
        let unscaled = Self { count, spread: 1.0 };
        let squares = (1..=count).map(|rank| unscaled.score(rank as f64).powi(2));
        Self {
            count,
            spread: (squares.sum::<f64>() / count.max(1) as f64).sqrt(),
        }
    }

    fn score(&self, rank: f64) -> f64 {
        Normal::standard().inverse_cdf(rank / (self.count as f64 + 1.0))
    }

    /// Returns the scaled score half-way after a rank; unbounded before the first and after the last.
    fn end(&self, rank: usize) -> f64 {
        match rank {
            0 => f64::NEG_INFINITY,
            rank if rank == self.count => f64::INFINITY,
            rank => self.score(rank as f64 + 0.5) / self.spread,
        }
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
                    let x = [*low_x, *high_x];
                    let y = [*low_y, *high_y];
                    match pairs
                        .rectangles
                        .iter_mut()
                        .find(|rectangle| (rectangle.0, rectangle.1) == (x, y))
                    {
                        Some(rectangle) => rectangle.2 += 1.0,
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
        let half_exact = self.half_exact.iter().map(|(x, [low, high])| {
            let inside = conditional_cdf(*high, *x, rho) - conditional_cdf(*low, *x, rho);
            inside.max(1e-300).ln()
        });
        let rectangles = self
            .rectangles
            .iter()
            .map(|([left, right], [low, high], count)| {
                let inside = bivariate_normal_cdf(*right, *high, rho)
                    - bivariate_normal_cdf(*left, *high, rho)
                    - bivariate_normal_cdf(*right, *low, rho)
                    + bivariate_normal_cdf(*left, *low, rho);
                count * inside.max(1e-300).ln()
            });
        exact + half_exact.sum::<f64>() + rectangles.sum::<f64>() + rest.ln()
    }
}

/// Returns the probability that a normal number is below `end` if a correlated one is `x`.
fn conditional_cdf(end: f64, x: f64, rho: f64) -> f64 {
    let score = if end.is_finite() {
        (end - rho * x) / (1.0 - rho * rho).sqrt()
    } else {
        end
    };
    Normal::standard().cdf(score)
}

/// Returns the probability that two correlated normal numbers are below `x` and `y`: Φ(x) Φ(y) + ∫ φ₂(x, y; r) dr from
/// 0 to ρ, with r = sin θ (Drezner and Wesolowsky, On the computation of the bivariate normal integral, 1990).
fn bivariate_normal_cdf(x: f64, y: f64, rho: f64) -> f64 {
    const PARTS: usize = 32;
    let apart = Normal::standard().cdf(x) * Normal::standard().cdf(y);
    if !(x.is_finite() && y.is_finite()) {
        return apart;
    }
    let step = rho.asin() / PARTS as f64;
    let sum: f64 = (0..=PARTS)
        .map(|part| {
            let theta = part as f64 * step;
            let height =
                (-(x * x + y * y - 2.0 * x * y * theta.sin()) / (2.0 * theta.cos().powi(2))).exp();
            let weight = if part == 0 || part == PARTS {
                1.0
            } else {
                2.0 + 2.0 * (part % 2) as f64
            };
            weight * height
        })
        .sum();
    apart + sum * step / 3.0 / (2.0 * std::f64::consts::PI)
}

/// Maximises a function of a correlation: a coarse grid, then golden section search.
fn maximize_over_correlation(function: &dyn Fn(f64) -> f64) -> f64 {
    const GRID: i32 = 20;
    const STEPS: usize = 40;
    let grid_point = |index: i32| MAX_CORRELATION * f64::from(index) / f64::from(GRID);
    let best = (-GRID..=GRID)
        .max_by(|&a, &b| function(grid_point(a)).total_cmp(&function(grid_point(b))))
        .unwrap_or(0);
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let mut low = grid_point((best - 1).max(-GRID));
    let mut high = grid_point((best + 1).min(GRID));
    let mut a = high - golden * (high - low);
    let mut b = low + golden * (high - low);
    let mut value_at_a = function(a);
    let mut value_at_b = function(b);
    for _ in 0..STEPS {
        if value_at_a >= value_at_b {
            (high, b, value_at_b) = (b, a, value_at_a);
            a = high - golden * (high - low);
            value_at_a = function(a);
        } else {
            (low, a, value_at_a) = (a, b, value_at_b);
            b = low + golden * (high - low);
            value_at_b = function(b);
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bivariate_normal_probabilities_match_closed_forms() {
        for rho in [-0.95_f64, -0.4, 0.0, 0.3, 0.9] {
            let expected = 0.25 + rho.asin() / (2.0 * std::f64::consts::PI);
            assert!(
                (bivariate_normal_cdf(0.0, 0.0, rho) - expected).abs() < 1e-9,
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
