//! Mixtures of normal distributions, as proposals of importance sampling.

use libm::{exp, log};
use nalgebra::{Cholesky, DMatrix, DVector};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crumple_world::random::Stream;

/// Share of samples from the standard normal distribution. Its inverse bounds the weights, even where no failure was
/// seen.
const DEFENSIVE_SHARE: f64 = 0.1;
/// Share of samples from components around the origin, one as wide as each level is far. They cover other directions at
/// the same distance, and failures by noise on the way.
const ORIGIN_CENTERED_SHARE: f64 = 0.2;
/// Initial number of components, for separate failure regions.
const MAX_COMPONENTS: usize = 4;
const MIN_COMPONENT_SHARE: f64 = 0.02;
const EM_STEPS: usize = 12;
/// Factor on covariances: a proposal that is too narrow costs far more than one that is too wide.
const COVARIANCE_INFLATION: f64 = 1.15;

/// A mixture of components at failures, components around the origin, and the standard normal distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Mixture {
    #[serde(rename = "all_round")]
    origin_centered: Vec<GaussianComponent>,
    #[serde(rename = "parts")]
    components: Vec<GaussianComponent>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct GaussianComponent {
    /// Share among the components of its kind.
    share: f64,
    mean: Vec<f64>,
    /// Lower triangle of the Cholesky factor of the covariance, row by row.
    factor: Vec<f64>,
}

/// Second moments about the origin of points at a level.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OriginMoments {
    #[serde(rename = "places")]
    count: u64,
    /// Sums of products of two coordinates: lower triangle, row by row.
    products: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct WeightedPoint {
    pub(super) point: Vec<f64>,
    pub(super) weight: f64,
}

impl Mixture {
    /// Fits a mixture to failures, and to the levels on the way; `None` without failures or with different dimensions.
    /// Directions that the failures leave undetermined keep the standard variance.
    pub(super) fn fit(levels: &[OriginMoments], failures: &[WeightedPoint], random: &mut Stream) -> Option<Self> {
        let dimension = failures.first()?.point.len();
        if failures.iter().any(|seen| seen.point.len() != dimension) {
            return None;
        }
        let mut centres: Vec<&[f64]> = vec![&pick_weighted(failures, |seen| seen.weight, random)?.point];
        while centres.len() < MAX_COMPONENTS {
            // Points far from all centres are likelier to belong to another failure region.
            let far = |seen: &WeightedPoint| {
                let nearest =
                    centres.iter().map(|centre| squared_distance(centre, &seen.point)).fold(f64::INFINITY, f64::min);
                seen.weight * nearest
            };
            let Some(next) = pick_weighted(failures, far, random) else { break };
            centres.push(&next.point);
        }
        let share = 1.0 / centres.len() as f64;
        let standard = DMatrix::identity(dimension, dimension);
        let begin = |centre: &&[f64]| GaussianComponent::new(share, centre.to_vec(), standard.clone());
        let mut all_round: Vec<GaussianComponent> =
            levels.iter().filter_map(|level| level.component(dimension)).collect();
        let equal = 1.0 / all_round.len() as f64;
        all_round.iter_mut().for_each(|part| part.share = equal);
        let mut mixture = Self { origin_centered: all_round, components: centres.iter().filter_map(begin).collect() };
        for _ in 0..EM_STEPS {
            mixture = mixture.em_step(failures)?;
        }
        Some(mixture)
    }

    pub(super) fn has_dimension(&self, dimension: usize) -> bool {
        let factors = dimension * (dimension + 1) / 2;
        let mut parts = self.origin_centered.iter().chain(&self.components);
        parts.all(|part| part.mean.len() == dimension && part.factor.len() == factors)
    }

    pub(super) fn em_step(&self, failures: &[WeightedPoint]) -> Option<Self> {
        let all: f64 = failures.iter().map(|seen| seen.weight).sum();
        let charges: Vec<Vec<f64>> = failures.iter().map(|seen| self.responsibilities(&seen.point)).collect();
        let part = |index: usize| {
            let own: Vec<(f64, &WeightedPoint)> = failures
                .iter()
                .zip(&charges)
                .filter_map(|(seen, charges)| Some((seen.weight * charges.get(index)?, seen)))
                .collect();
            GaussianComponent::fit(&own, all)
        };
        let mut parts: Vec<GaussianComponent> = (0..self.components.len()).filter_map(part).collect();
        let kept: f64 = parts.iter().map(|part| part.share).sum();
        parts.iter_mut().for_each(|part| part.share /= kept);
        (!parts.is_empty() && kept > 0.0)
            .then_some(Self { origin_centered: self.origin_centered.clone(), components: parts })
    }

    fn responsibilities(&self, at: &[f64]) -> Vec<f64> {
        let ln: Vec<f64> = self.components.iter().map(|part| log(part.share) + part.ln_density(at)).collect();
        let most = ln.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let relative: Vec<f64> = ln.iter().map(|one| exp(one - most)).collect();
        let sum: f64 = relative.iter().sum();
        relative.into_iter().map(|one| one / sum).collect()
    }

    pub(super) fn draw(&self, dimension: usize, random: &mut Stream) -> Vec<f64> {
        let normal = |random: &mut Stream| (0..dimension).map(|_| StandardNormal.sample(random)).collect::<Vec<f64>>();
        let mut lot: f64 = random.random::<f64>() - DEFENSIVE_SHARE;
        if lot < 0.0 {
            return normal(random);
        }
        let drawn = normal(random);
        let from = self.weighted_components().find(|(share, _)| {
            lot -= share;
            lot < 0.0
        });
        let from = from.map(|(_, part)| part);
        from.or(self.components.last()).map_or(drawn.clone(), |part| part.transform(&drawn))
    }

    /// Returns the ratio of the standard density to that of the mixture: at most 1/[`DEFENSIVE_SHARE`].
    pub(super) fn importance_weight(&self, at: &[f64]) -> f64 {
        let standard = -0.5 * at.iter().map(|x| x * x).sum::<f64>();
        let ratios = self.weighted_components().map(|(share, part)| share * exp(part.ln_density(at) - standard));
        1.0 / (DEFENSIVE_SHARE + ratios.sum::<f64>())
    }

    /// Iterates over all components but the standard one, with their shares of all samples.
    fn weighted_components(&self) -> impl Iterator<Item = (f64, &GaussianComponent)> {
        let around = self.origin_centered.iter().map(|part| (ORIGIN_CENTERED_SHARE * part.share, part));
        around.chain(
            self.components.iter().map(|part| ((1.0 - DEFENSIVE_SHARE - ORIGIN_CENTERED_SHARE) * part.share, part)),
        )
    }
}

impl GaussianComponent {
    /// Returns `None` if the covariance is not positive definite.
    fn new(share: f64, mean: Vec<f64>, covariance: DMatrix<f64>) -> Option<Self> {
        let lower = Cholesky::new(covariance)?.unpack();
        let rows = (0..mean.len()).flat_map(|row| (0..=row).map(move |column| (row, column)));
        Some(Self { share, mean, factor: rows.filter_map(|place| lower.get(place).copied()).collect() })
    }

    /// Fits a component to points with responsibilities, of a total; `None` if its share is too small.
    fn fit(own: &[(f64, &WeightedPoint)], all: f64) -> Option<Self> {
        let sum: f64 = own.iter().map(|(w, _)| w).sum();
        let share = sum / all;
        if share.is_nan() || share < MIN_COMPONENT_SHARE {
            return None;
        }
        let mut mean = DVector::zeros(own.first()?.1.point.len());
        own.iter().for_each(|(w, seen)| mean.axpy(w / sum, &DVector::from_column_slice(&seen.point), 1.0));
        let (seen, covariance) = weighted_second_moment(own, &mean)?;
        Self::new(share, mean.as_slice().to_vec(), with_prior(covariance, seen, COVARIANCE_INFLATION))
    }

    /// Returns the logarithm of the density, without the constant that depends on the dimension only.
    fn ln_density(&self, at: &[f64]) -> f64 {
        let (mut solved, mut ln, mut rest) = (Vec::with_capacity(at.len()), 0.0, self.factor.as_slice());
        for (row, (x, mean)) in at.iter().zip(&self.mean).enumerate() {
            let Some((own, below)) = rest.split_at_checked(row + 1) else { break };
            rest = below;
            let Some((diagonal, left)) = own.split_last() else { break };
            let known: f64 = left.iter().zip(&solved).map(|(factor, z): (&f64, &f64)| factor * z).sum();
            let z = (x - mean - known) / diagonal;
            ln -= 0.5 * z * z + log(*diagonal);
            solved.push(z);
        }
        ln
    }

    fn transform(&self, normal: &[f64]) -> Vec<f64> {
        let mut rest = self.factor.as_slice();
        let place = |(row, mean): (usize, &f64)| {
            let (own, below) = rest.split_at_checked(row + 1)?;
            rest = below;
            Some(mean + own.iter().zip(normal).map(|(factor, z)| factor * z).sum::<f64>())
        };
        self.mean.iter().enumerate().filter_map(place).collect()
    }
}

impl OriginMoments {
    pub(super) fn from_points<'a>(places: impl IntoIterator<Item = &'a [f64]>) -> Self {
        let mut around = Self::default();
        for place in places {
            let of_row = |(row, x): (usize, &f64)| -> Vec<f64> { place.iter().take(row + 1).map(|y| x * y).collect() };
            let products = place.iter().enumerate().flat_map(of_row).collect();
            around.merge(&Self { count: 1, products });
        }
        around
    }

    pub(super) fn merge(&mut self, other: &Self) {
        if self.products.len() < other.products.len() {
            self.products.resize(other.products.len(), 0.0);
        }
        self.count = self.count.saturating_add(other.count);
        self.products.iter_mut().zip(&other.products).for_each(|(sum, product)| *sum += product);
    }

    /// Returns a component with the second moments of the points; `None` without points.
    fn component(&self, dimension: usize) -> Option<GaussianComponent> {
        if self.count == 0 || self.products.len() != dimension * (dimension + 1) / 2 {
            return None;
        }
        let seen = self.count as f64;
        let at = |row: usize, column: usize| {
            let (row, column) = (row.max(column), row.min(column));
            self.products.get(row * (row + 1) / 2 + column).map_or(0.0, |sum| sum / seen)
        };
        let moment = DMatrix::from_fn(dimension, dimension, at);
        GaussianComponent::new(1.0, vec![0.0; dimension], with_prior(moment, seen, 1.0))
    }
}

/// Returns the second moment of weighted points about a centre, and their effective sample size; `None` without weight.
fn weighted_second_moment(own: &[(f64, &WeightedPoint)], centre: &DVector<f64>) -> Option<(f64, DMatrix<f64>)> {
    let (sum, squares) = own.iter().fold((0.0, 0.0), |(sum, squares), (w, _)| (sum + w, squares + w * w));
    if squares.is_nan() || squares <= 0.0 {
        return None;
    }
    let mut moment = DMatrix::zeros(centre.len(), centre.len());
    for (w, seen) in own {
        let off = DVector::from_column_slice(&seen.point) - centre;
        moment.ger(w / sum, &off, &off, 1.0);
    }
    Some((sum * sum / squares, moment))
}

/// Returns the widened covariance, regularised by prior samples of the standard covariance.
fn with_prior(covariance: DMatrix<f64>, seen: f64, widened: f64) -> DMatrix<f64> {
    let dimension = covariance.nrows();
    let before = dimension as f64 + 1.0;
    let standard = DMatrix::identity(dimension, dimension);
    covariance * (widened * seen / (seen + before)) + standard * (before / (seen + before))
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Samples a point by weight; `None` if all weights are zero.
fn pick_weighted<'a>(
    all: &'a [WeightedPoint],
    chance: impl Fn(&WeightedPoint) -> f64,
    random: &mut Stream,
) -> Option<&'a WeightedPoint> {
    let sum: f64 = all.iter().map(&chance).sum();
    let mut lot = random.random::<f64>() * sum;
    let of = |seen: &&WeightedPoint| {
        lot -= chance(seen);
        lot < 0.0
    };
    (sum > 0.0 && sum.is_finite()).then(|| all.iter().find(of).or(all.last())).flatten()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn failures(dimension: usize, count: usize, random: &mut Stream) -> Vec<WeightedPoint> {
        let at = |random: &mut Stream| {
            let mut at: Vec<f64> = (0..dimension).map(|_| StandardNormal.sample(random)).collect();
            at[0] = 4.0 + 0.3 * at[1];
            at
        };
        (0..count).map(|_| WeightedPoint { point: at(random), weight: 1.0 }).collect()
    }

    fn fitted(failures: Vec<WeightedPoint>, random: &mut Stream) -> Option<Mixture> {
        Mixture::fit(
            &[OriginMoments::from_points(failures.iter().map(|seen| seen.point.as_slice()))],
            &failures,
            random,
        )
    }

    #[test]
    fn how_far_out_places_lie_can_be_put_together() {
        let mut random = Stream::seed_from_u64(4);
        let all = failures(3, 40, &mut random);
        let around = |some: &[WeightedPoint]| OriginMoments::from_points(some.iter().map(|seen| seen.point.as_slice()));
        let mut divided = around(&all[..13]);
        divided.merge(&around(&[]));
        divided.merge(&around(&all[13..]));
        assert_eq!(divided.count, 40);
        let off = divided.products.iter().zip(&around(&all).products).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-10 && divided.products.len() == 6 && divided.component(3).is_some(), "{off}");
        assert!(divided.component(2).is_none() && OriginMoments::default().component(3).is_none());
    }

    #[test]
    fn weights_have_a_mean_of_one_and_a_bound() {
        let mut random = Stream::seed_from_u64(1);
        let mixture = fitted(failures(5, 300, &mut random), &mut random).unwrap();
        let weights: Vec<f64> =
            (0..200_000).map(|_| mixture.importance_weight(&mixture.draw(5, &mut random))).collect();
        let mean = weights.iter().sum::<f64>() / weights.len() as f64;
        assert!((mean - 1.0).abs() < 0.02, "{mean}");
        assert!(weights.iter().all(|weight| (0.0..=1.0 / DEFENSIVE_SHARE + 1e-9).contains(weight)));
    }

    #[test]
    fn a_fit_lies_where_failures_are_and_turns_as_they_do() {
        let mut random = Stream::seed_from_u64(2);
        let mixture = fitted(failures(4, 2000, &mut random), &mut random).unwrap();
        let drawn: Vec<Vec<f64>> = (0..20_000).map(|_| mixture.draw(4, &mut random)).collect();
        let there = drawn.iter().filter(|at| (at[0] - 4.0 - 0.3 * at[1]).abs() < 0.5).count();
        assert!(there > 13_000, "{there}");
    }

    #[test]
    fn nothing_is_fitted_to_nothing() {
        let mut random = Stream::seed_from_u64(3);
        assert_eq!(Mixture::fit(&[], &[], &mut random), None);
        assert_eq!(fitted(vec![WeightedPoint { point: vec![1.0], weight: 0.0 }], &mut random), None);
        let [one, two] = [vec![1.0], vec![1.0, 2.0]].map(|at| WeightedPoint { point: at, weight: 1.0 });
        assert_eq!(fitted(vec![one, two.clone()], &mut random), None);
        let one = fitted(vec![two], &mut random).unwrap();
        assert!(one.has_dimension(2) && !one.has_dimension(1));
        assert!(one.importance_weight(&[1.0, 2.0]).is_finite());
    }
}
