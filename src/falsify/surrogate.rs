//! A cheap guess of the robustness from what was evaluated before.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Characteristic lengths that are tried, relative to the root of the dimension.
const LENGTHS: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// Variance of the noise relative to that of the signal: near points with unlike values must not bend the fit.
const NOISE: f64 = 0.05;

/// Kriging (a Gaussian process) with the Matérn 5/2 kernel through the ranks of earlier values, its length chosen by
/// likelihood (Rasmussen and Williams, Gaussian processes for machine learning, 2006, equations 2.25, 2.30 and 4.17).
///
/// Ranks, since robustness jumps and has outliers, while only order matters for choosing among candidates.
#[derive(Debug)]
pub(super) struct Surrogate {
    points: Vec<Vec<f64>>,
    length: f64,
    weights: DVector<f64>,
}

impl Surrogate {
    /// A fit to points and their values; none if there are too few or the numbers do not allow it.
    pub(super) fn fit(data: &[(Vec<f64>, f64)]) -> Option<Self> {
        let dimension = data.first()?.0.len() as f64;
        let points: Vec<Vec<f64>> = data.iter().map(|(point, _)| point.clone()).collect();
        let scores = DVector::from_vec(scores(data));
        let n = points.len();
        let squares = DMatrix::from_fn(n, n, |i, j| match (points.get(i), points.get(j)) {
            (Some(a), Some(b)) => square_distance(a, b),
            _ => 0.0,
        });
        let mut best: Option<(f64, f64, DVector<f64>)> = None;
        for length in LENGTHS.map(|share| share * dimension.sqrt()) {
            let covariance = squares.map(|square| matern(square, length)) + DMatrix::identity(n, n) * NOISE;
            let Some(factor) = Cholesky::<f64, Dyn>::new(covariance) else { continue };
            let weights = factor.solve(&scores);
            let variance = scores.dot(&weights) / n as f64;
            let log_determinant: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
            let likelihood = -0.5 * n as f64 * variance.ln() - log_determinant;
            if best.as_ref().is_none_or(|(most, ..)| likelihood > *most) {
                best = Some((likelihood, length, weights));
            }
        }
        let (_, length, weights) = best?;
        Some(Self { points, length, weights })
    }

    /// The expected score of a point: lower is better.
    pub(super) fn score(&self, point: &[f64]) -> f64 {
        let near = self.points.iter().map(|known| matern(square_distance(known, point), self.length));
        near.zip(self.weights.iter()).map(|(kernel, weight)| kernel * weight).sum()
    }
}

/// Logits of the ranks of the values; equal values have equal scores.
fn scores(data: &[(Vec<f64>, f64)]) -> Vec<f64> {
    let mut sorted: Vec<f64> = data.iter().map(|(_, value)| *value).collect();
    sorted.sort_by(f64::total_cmp);
    let rank = |value: f64| {
        let below = sorted.partition_point(|x| *x < value);
        let equal = sorted.partition_point(|x| *x <= value) - below;
        (below as f64 + 0.5 * equal as f64) / sorted.len() as f64
    };
    data.iter().map(|(_, value)| rank(*value)).map(|share| (share / (1.0 - share)).ln()).collect()
}

fn square_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

fn matern(square_distance: f64, length: f64) -> f64 {
    let r = (5.0 * square_distance).sqrt() / length;
    (1.0 + r + r * r / 3.0) * (-r).exp()
}
