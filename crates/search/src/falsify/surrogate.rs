//! A surrogate model that predicts robustness from earlier evaluations.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::UnitCube;

/// Variance of the noise relative to that of the signal: prevents overfitting to near points with different values.
const NOISE_VARIANCE: f64 = 0.05;
/// Growth of the number of points after which the metric is selected again.
const RESELECTION_GROWTH: f64 = 1.25;

/// Kriging (a Gaussian process) with the Matérn 5/2 kernel on the ranks of earlier values. The metric maximises the
/// likelihood (Rasmussen and Williams, Gaussian processes for machine learning, 2006, equations 2.25, 2.30 and 4.17).
/// Ranks are used because robustness jumps and has outliers, and only order matters to choose candidates.
#[derive(Debug)]
pub(super) struct Surrogate {
    cube: UnitCube,
    metric: Metric,
    features: Vec<Vec<f64>>,
    weights: DVector<f64>,
}

#[derive(Debug, Default)]
pub(super) struct MetricSelection {
    metric: Metric,
    points: usize,
}

/// A distance of points. Signals often act through their integrals, and only until some instant. The fit therefore
/// selects from metrics that compare values, integrals or both, over the first part of each signal.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Metric {
    signal_feature: SignalFeature,
    /// Exponent of the share of each signal that counts, from its start: 2^(-horizon/2).
    horizon: i32,
    /// Exponent of the characteristic length, 1.6^exponent times [`MIN_LENGTH_SCALE`].
    length_exponent: i32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum SignalFeature {
    Values,
    Integral,
    Both,
}

const SIGNAL_FEATURES: [SignalFeature; 3] = [
    SignalFeature::Values,
    SignalFeature::Integral,
    SignalFeature::Both,
];
const HORIZON_COUNT: i32 = 7;
const LENGTH_COUNT: i32 = 9;
/// Smallest characteristic length, relative to the diagonal of a cube with a coordinate for each block.
const MIN_LENGTH_SCALE: f64 = 0.15;

impl Default for Metric {
    fn default() -> Self {
        Self {
            signal_feature: SignalFeature::Both,
            horizon: 0,
            length_exponent: 2,
        }
    }
}

impl Metric {
    /// Returns all metrics that differ in a cube: without signals, only the length matters.
    fn candidates(cube: &UnitCube) -> impl Iterator<Item = Self> {
        let signals = cube.blocks().iter().any(|block| block.len() > 1);
        let features = if signals { SIGNAL_FEATURES.len() } else { 1 };
        let horizons = if signals { HORIZON_COUNT } else { 1 };
        SIGNAL_FEATURES
            .into_iter()
            .take(features)
            .flat_map(move |signal_feature| {
                (0..horizons).flat_map(move |horizon| {
                    (0..LENGTH_COUNT).map(move |length_exponent| Self {
                        signal_feature,
                        horizon,
                        length_exponent,
                    })
                })
            })
    }

    fn length_scale(self, cube: &UnitCube) -> f64 {
        MIN_LENGTH_SCALE * 1.6_f64.powi(self.length_exponent) * (cube.blocks().len() as f64).sqrt()
    }

    /// Returns coordinates whose Euclidean distance is that of the metric; every block weighs as much as a number.
    fn features(self, cube: &UnitCube, point: &[f64]) -> Vec<f64> {
        let mut features = Vec::new();
        for block in cube.blocks() {
            let share = if block.len() == 1 {
                1.0
            } else {
                0.5_f64.powf(0.5 * f64::from(self.horizon))
            };
            let pieces = (block.len() as f64 * share).ceil();
            let values = point
                .get(block.clone())
                .unwrap_or_default()
                .iter()
                .take(pieces as usize);
            if self.signal_feature != SignalFeature::Integral || block.len() == 1 {
                features.extend(values.clone().map(|value| value / pieces.sqrt()));
            }
            if self.signal_feature != SignalFeature::Values && block.len() > 1 {
                let mut integral = 0.0;
                features.extend(values.map(|value| {
                    integral += value / pieces;
                    integral
                }));
            }
        }
        features
    }
}

impl Surrogate {
    /// Fits a model to `data`, the last ones of `total` points; `None` if there are too few or the factorisation fails.
    pub(super) fn fit(
        cube: &UnitCube,
        data: &[(Vec<f64>, f64)],
        total: usize,
        selection: &mut MetricSelection,
    ) -> Option<Self> {
        if data.is_empty() {
            return None;
        }
        let scores = DVector::from_vec(scores(data));
        if total as f64 >= RESELECTION_GROWTH * selection.points as f64 {
            let metrics: Vec<Metric> = Metric::candidates(cube).collect();
            // Fits are independent and compared in a fixed order, so threads do not change the result.
            let fits = metrics
                .into_par_iter()
                .map(|metric| Self::fit_with_metric(cube, data, &scores, metric));
            let fits: Vec<_> = fits.collect();
            let fits = fits
                .into_iter()
                .flatten()
                .filter(|(likelihood, _)| !likelihood.is_nan());
            let (_, likeliest) = fits.max_by(|a, b| a.0.total_cmp(&b.0))?;
            *selection = MetricSelection {
                metric: likeliest.metric,
                points: total,
            };
            return Some(likeliest);
        }
        Self::fit_with_metric(cube, data, &scores, selection.metric).map(|(_, fit)| fit)
    }

    fn fit_with_metric(
        cube: &UnitCube,
        data: &[(Vec<f64>, f64)],
        scores: &DVector<f64>,
        metric: Metric,
    ) -> Option<(f64, Self)> {
        let length = metric.length_scale(cube);
        let features: Vec<Vec<f64>> = data
            .iter()
            .map(|(point, _)| metric.features(cube, point))
            .collect();
        let n = features.len();
        // The factorisation reads the lower triangle only.
        let covariance = DMatrix::from_fn(n, n, |i, j| match (features.get(i), features.get(j)) {
            (Some(a), Some(b)) if j <= i => {
                matern(square_distance(a, b), length) + if i == j { NOISE_VARIANCE } else { 0.0 }
            }
            _ => 0.0,
        });
        let factor = Cholesky::<f64, Dyn>::new(covariance)?;
        let weights = factor.solve(scores);
        let variance = scores.dot(&weights) / n as f64;
        let log_determinant: f64 = factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum();
        let likelihood = -0.5 * n as f64 * variance.ln() - log_determinant;
        Some((
            likelihood,
            Self {
                cube: cube.clone(),
                metric,
                features,
                weights,
            },
        ))
    }

    /// Returns the predicted score of a point: lower is better.
    pub(super) fn score(&self, point: &[f64]) -> f64 {
        let own = self.metric.features(&self.cube, point);
        let length = self.metric.length_scale(&self.cube);
        let kernels = self
            .features
            .iter()
            .map(|features| matern(square_distance(features, &own), length));
        kernels
            .zip(self.weights.iter())
            .map(|(kernel, weight)| kernel * weight)
            .sum()
    }
}

/// Returns the logits of the ranks of the values; equal values have equal scores.
fn scores(data: &[(Vec<f64>, f64)]) -> Vec<f64> {
    let mut sorted: Vec<f64> = data.iter().map(|(_, value)| *value).collect();
    sorted.sort_by(f64::total_cmp);
    data.iter()
        .map(|(_, value)| {
            let below = sorted.partition_point(|x| x < value);
            let equal = sorted.partition_point(|x| x <= value) - below;
            let rank = (below as f64 + 0.5 * equal as f64) / sorted.len() as f64;
            (rank / (1.0 - rank)).ln()
        })
        .collect()
}

fn square_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

fn matern(square_distance: f64, length: f64) -> f64 {
    let r = (5.0 * square_distance).sqrt() / length;
    (1.0 + r + r * r / 3.0) * (-r).exp()
}

#[cfg(test)]
mod tests {
    use super::super::Method;
    use super::*;

    #[test]
    fn the_metric_compares_early_integrals_if_only_they_count() {
        let cube = UnitCube::new([10, 10]).unwrap();
        let mut search = Method::Uniform.start(&cube, 5);
        let points: Vec<Vec<f64>> = std::iter::repeat_with(|| search.ask())
            .flatten()
            .take(90)
            .collect();
        // Distance after three pieces of acceleration.
        let value = |point: &Vec<f64>| 3.0 * point[0] + 2.0 * point[1] + point[2];
        let data: Vec<_> = points
            .iter()
            .map(|point| (point.clone(), value(point)))
            .collect();
        let (training, test) = data.split_at(60);
        let mut chosen = MetricSelection::default();
        let free = Surrogate::fit(&cube, training, training.len(), &mut chosen).unwrap();
        assert!(
            chosen.metric.horizon > 0 && chosen.metric.signal_feature != SignalFeature::Values,
            "{chosen:?}"
        );

        let plain = Metric::candidates(&cube)
            .filter(|metric| metric.horizon == 0 && metric.signal_feature == SignalFeature::Values);
        let scores = DVector::from_vec(scores(training));
        let plain =
            plain.filter_map(|metric| Surrogate::fit_with_metric(&cube, training, &scores, metric));
        let (_, plain) = plain.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let pairs = || {
            test.iter()
                .flat_map(|a| test.iter().map(move |b| (a, b)))
                .filter(|(a, b)| a.1 < b.1)
        };
        let wrong = |fit: &Surrogate| {
            pairs()
                .filter(|(a, b)| fit.score(&a.0) >= fit.score(&b.0))
                .count()
        };
        assert!(
            2 * wrong(&free) < wrong(&plain),
            "{} and {}",
            wrong(&free),
            wrong(&plain)
        );
    }
}
