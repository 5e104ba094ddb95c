//! The likelihood region of a fitted space, in which searches stay.
//!
//! Normal scores of the observed parameters, without their correlations, have a spherical density. The region is the
//! ball that contains the stated share of the distribution, so that likelihood decreases outwards along each ray.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal as Gauss};

use super::{ObservedData, ScenarioSpace};

/// Shrinks the ball a little, so that a point on its surface stays inside after rounding.
const INSIDE: f64 = 1.0 - 1e-9;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct LikelihoodRegion {
    radius: f64,
    /// Coordinates of the observed parameters and of those that depend on them.
    coordinates: Vec<usize>,
}

impl LikelihoodRegion {
    /// Returns the distance of independent normal scores from the median.
    fn distance(&self, scores: &[f64]) -> f64 {
        let squares = self
            .coordinates
            .iter()
            .filter_map(|&index| scores.get(index))
            .map(|score| score * score);
        squares.sum::<f64>().sqrt()
    }

    pub(super) fn new(space: &ScenarioSpace, observed: &ObservedData) -> Option<Self> {
        let share = observed.search_share?;
        let observed_parameters = space.parameters.iter().filter(|parameter| {
            let mut observed = observed.parameters.iter();
            observed.any(|observed| observed.name == parameter.name)
        });
        let mut coordinates: Vec<usize> = observed_parameters
            .flat_map(|parameter| parameter.coordinates())
            .collect();
        coordinates.extend(space.copula.iter().flat_map(|copula| copula.coordinates()));
        coordinates.sort_unstable();
        coordinates.dedup();
        let radius = ChiSquared::new(coordinates.len() as f64)
            .ok()?
            .inverse_cdf(share)
            .sqrt();
        Some(Self {
            radius,
            coordinates,
        })
    }
}

impl ScenarioSpace {
    /// Converts a point of a search to the point that it evaluates. In a fitted space with a `search_share`, the cube
    /// becomes the bounding box of the likelihood region, and points outside the region move onto its surface, towards
    /// the median. In any other space the point stays.
    #[must_use]
    pub fn search_point(&self, point: &[f64]) -> Vec<f64> {
        let mut narrowed = point.to_vec();
        let Some(region) = &self.region else {
            return narrowed;
        };
        let [below, above] =
            [-region.radius, region.radius].map(|score| Gauss::standard().cdf(score));
        for &index in &region.coordinates {
            let Some(parameter) = self.coordinate_parameters().nth(index) else {
                continue;
            };
            let [low, high] = [below, above].map(|share| parameter.marginal.quantile(share));
            if let Some(coordinate) = narrowed.get_mut(index) {
                *coordinate = low + coordinate.clamp(0.0, 1.0) * (high - low);
            }
        }
        let mut scores = self.scores(&narrowed);
        let distance = region.distance(&scores);
        if distance <= region.radius {
            return narrowed;
        }
        let factor = INSIDE * region.radius / distance;
        scores
            .iter_mut()
            .for_each(|score| *score = Gauss::standard().cdf(factor * *score));
        let projected = self.quantile(&scores);
        for &index in &region.coordinates {
            if let (Some(coordinate), Some(inside)) =
                (narrowed.get_mut(index), projected.get(index))
            {
                *coordinate = *inside;
            }
        }
        narrowed
    }

    /// Returns true if a search may evaluate the point, up to rounding.
    #[must_use]
    pub fn is_in_search_region(&self, point: &[f64]) -> bool {
        self.region.as_ref().is_none_or(|region| {
            region.distance(&self.scores(point)) <= region.radius * (1.0 + 1e-6)
        })
    }

    /// Returns the independent normal scores of a point.
    fn scores(&self, point: &[f64]) -> Vec<f64> {
        let below: Vec<f64> = self
            .coordinate_parameters()
            .zip(point)
            .map(|(parameter, &coordinate)| parameter.marginal.cdf(coordinate))
            .collect();
        let mut scores: Vec<f64> = below
            .iter()
            .map(|share| {
                let share = share.clamp(f64::MIN_POSITIVE, 1.0 - f64::EPSILON);
                Gauss::standard().inverse_cdf(share)
            })
            .collect();
        if let Some(copula) = &self.copula {
            copula.decorrelate(&below, &mut scores);
        }
        scores
    }

    /// Returns the smallest and largest observed value of a parameter; `None` unless the space was fitted.
    #[must_use]
    pub fn observed_range(&self, parameter: &str) -> Option<[f64; 2]> {
        let observed = self
            .spec
            .observed
            .as_ref()?
            .parameters
            .iter()
            .find(|observed| observed.name == parameter)?;
        let low = observed
            .values
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min);
        let high = observed
            .values
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max);
        Some([low, high])
    }

    /// Returns the smallest and largest observed value of a parameter, if `value` is outside them.
    #[must_use]
    pub fn extrapolated_range(&self, parameter: &str, value: f64) -> Option<[f64; 2]> {
        self.observed_range(parameter)
            .filter(|[low, high]| !(*low..=*high).contains(&value))
    }
}
