//! Marginal distribution of one coordinate: maps the unit interval to values of a parameter.

use statrs::distribution::{Continuous, ContinuousCDF, Gamma, LogNormal, Normal as Gauss, Weibull};

/// The distribution of one coordinate over its range.
///
/// A *coordinate* in [0, 1] maps linearly to the range, or to its logarithm for a log-uniform distribution. A choice
/// has equal slices, one for each value. A point mass has a slice of a tenth, and the other values have the rest.
/// Classes are numbered. The position within a slice does not affect the scenario, but encodes the CDF, so that
/// coordinates map back to it exactly.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum CoordinateMarginal {
    Uniform {
        low: f64,
        high: f64,
    },
    LogUniform {
        low: f64,
        high: f64,
    },
    /// A distribution with mass `mass` within the range and `cdf_low` below it.
    Truncated {
        low: f64,
        high: f64,
        distribution: ContinuousDistribution,
        cdf_low: f64,
        mass: f64,
    },
    /// Constant density in each bin; one more edge than bins.
    Histogram {
        edges: Vec<f64>,
        probabilities: Vec<f64>,
    },
    Choice {
        values: Vec<f64>,
        probabilities: Vec<f64>,
    },
    /// A value with positive probability before or after all others, and the distribution of these.
    PointMass {
        at: f64,
        probability: f64,
        is_first: bool,
        others: Box<CoordinateMarginal>,
    },
}

/// Width of the slice of a point mass: one in ten points of a search has its value.
const POINT_MASS_WIDTH: f64 = 0.1;

/// A position in [0, 1], one end of which is a slice for a point mass.
#[derive(Clone, Copy)]
enum MixturePosition {
    /// Position within the slice, from 0 to 1.
    PointMass(f64),
    /// Position within the rest, from 0 to 1.
    Others(f64),
}

impl MixturePosition {
    fn from_unit(unit: f64, slice: f64, is_first: bool) -> Self {
        match is_first {
            true if unit < slice => Self::PointMass(unit / slice),
            true => Self::Others(((unit - slice) / (1.0 - slice)).min(1.0)),
            false if unit > 1.0 - slice => Self::PointMass((unit - (1.0 - slice)) / slice),
            false => Self::Others((unit / (1.0 - slice)).min(1.0)),
        }
    }

    /// Returns the position in [0, 1] for a slice of another width.
    fn to_unit(self, slice: f64, is_first: bool) -> f64 {
        match self {
            Self::PointMass(within) if is_first => within.min(1.0 - f64::EPSILON) * slice,
            Self::PointMass(within) => (1.0 - slice + within * slice)
                .max((1.0 - slice).next_up())
                .min(1.0),
            Self::Others(within) if is_first => (slice + within * (1.0 - slice)).min(1.0),
            Self::Others(within) => within * (1.0 - slice),
        }
    }
}

/// A distribution before truncation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ContinuousDistribution {
    Normal(Gauss),
    LogNormal(LogNormal),
    Gamma(Gamma),
    Weibull(Weibull),
}

/// Smallest argument of a gamma distribution, relative to its scale, at which the CDF is evaluated.
const MIN_SCALED: f64 = 1e-200;

impl ContinuousDistribution {
    pub(super) fn cdf(&self, value: f64) -> f64 {
        match self {
            Self::Normal(law) => law.cdf(value),
            Self::LogNormal(law) => law.cdf(value),
            // Statrs panics unless the product of value and rate is positive.
            Self::Gamma(law) => match value * law.rate() {
                scaled if scaled < MIN_SCALED => 0.0,
                scaled if scaled > 1.0 / MIN_SCALED => 1.0,
                _ => law.cdf(value),
            },
            Self::Weibull(law) => law.cdf(value),
        }
    }

    fn inverse_cdf(&self, share: f64) -> f64 {
        match self {
            Self::Normal(law) => law.inverse_cdf(share),
            Self::LogNormal(law) => law.inverse_cdf(share),
            Self::Gamma(law) => {
                let least = 2.0 * MIN_SCALED / law.rate();
                if self.cdf(least) >= share {
                    least
                } else {
                    law.inverse_cdf(share)
                }
            }
            Self::Weibull(law) => law.inverse_cdf(share),
        }
    }

    fn ln_pdf(&self, value: f64) -> f64 {
        match self {
            Self::Normal(law) => law.ln_pdf(value),
            Self::LogNormal(law) => law.ln_pdf(value),
            Self::Gamma(law) => law.ln_pdf(value),
            Self::Weibull(law) => law.ln_pdf(value),
        }
    }

    /// Returns the smallest value at which the density of a range from `low` is evaluated: positive distributions may
    /// be unbounded at 0.
    fn min_pdf_argument(&self, low: f64, high: f64) -> f64 {
        if matches!(self, Self::Normal(_)) {
            low
        } else {
            low.max(1e-9 * high)
        }
    }
}

impl CoordinateMarginal {
    pub(super) fn low(&self) -> f64 {
        match self {
            Self::Uniform { low, .. }
            | Self::LogUniform { low, .. }
            | Self::Truncated { low, .. } => *low,
            Self::Histogram { edges, .. } => edges.first().copied().unwrap_or(f64::NAN),
            Self::Choice { values, .. } => values.iter().copied().fold(f64::INFINITY, f64::min),
            Self::PointMass { at, others, .. } => at.min(others.low()),
        }
    }

    pub(super) fn high(&self) -> f64 {
        match self {
            Self::Uniform { high, .. }
            | Self::LogUniform { high, .. }
            | Self::Truncated { high, .. } => *high,
            Self::Histogram { edges, .. } => edges.last().copied().unwrap_or(f64::NAN),
            Self::Choice { values, .. } => values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            Self::PointMass { at, others, .. } => at.max(others.high()),
        }
    }

    #[inline]
    pub(super) fn value(&self, coordinate: f64) -> f64 {
        let u = coordinate.clamp(0.0, 1.0);
        match self {
            Self::Uniform { low, high } | Self::Truncated { low, high, .. } => {
                (low + u * (high - low)).clamp(*low, *high)
            }
            Self::LogUniform { low, high } => (low * libm::pow(high / low, u)).clamp(*low, *high),
            Self::Histogram { .. } => {
                (self.low() + u * (self.high() - self.low())).clamp(self.low(), self.high())
            }
            Self::Choice { values, .. } => {
                let index = ((u * values.len() as f64) as usize).min(values.len() - 1);
                values.get(index).copied().unwrap_or(f64::NAN)
            }
            Self::PointMass {
                at,
                is_first,
                others,
                ..
            } => match MixturePosition::from_unit(u, POINT_MASS_WIDTH, *is_first) {
                MixturePosition::PointMass(_) => *at,
                MixturePosition::Others(within) => others.value(within),
            },
        }
    }

    /// Returns a coordinate with this value; the middle of its slice, if it has one.
    pub(super) fn coordinate(&self, value: f64) -> f64 {
        match self {
            Self::Uniform { low, high } | Self::Truncated { low, high, .. } => {
                ((value - low) / (high - low)).clamp(0.0, 1.0)
            }
            Self::LogUniform { low, high } => {
                (libm::log(value / low) / libm::log(high / low)).clamp(0.0, 1.0)
            }
            Self::Histogram { .. } => {
                ((value - self.low()) / (self.high() - self.low())).clamp(0.0, 1.0)
            }
            Self::Choice { values, .. } => {
                let distances = values.iter().map(|choice| (choice - value).abs());
                let nearest = distances
                    .enumerate()
                    .min_by(|(_, a), (_, b)| a.total_cmp(b))
                    .map_or(0, |(index, _)| index);
                (nearest as f64 + 0.5) / values.len() as f64
            }
            Self::PointMass { at, is_first, .. } if value == *at => {
                MixturePosition::PointMass(0.5).to_unit(POINT_MASS_WIDTH, *is_first)
            }
            Self::PointMass {
                is_first, others, ..
            } => MixturePosition::Others(others.coordinate(value))
                .to_unit(POINT_MASS_WIDTH, *is_first),
        }
    }

    /// Returns the coordinate at CDF value `u`.
    #[inline]
    pub(super) fn quantile(&self, u: f64) -> f64 {
        let u = u.clamp(0.0, 1.0);
        match self {
            Self::Uniform { .. } | Self::LogUniform { .. } => u,
            Self::Truncated {
                low,
                high,
                distribution: law,
                cdf_low: below,
                mass,
            } => {
                let value = law
                    .inverse_cdf((below + u * mass).clamp(f64::MIN_POSITIVE, 1.0 - f64::EPSILON));
                ((value - low) / (high - low)).clamp(0.0, 1.0)
            }
            Self::Histogram {
                edges,
                probabilities,
            } => histogram_quantile(edges, probabilities, u)
                .map_or(1.0, |value| self.coordinate(value)),
            Self::Choice { probabilities, .. } => choice_quantile(probabilities, u),
            Self::PointMass {
                probability: share,
                is_first,
                others,
                ..
            } => match MixturePosition::from_unit(u, *share, *is_first) {
                MixturePosition::Others(within) => MixturePosition::Others(others.quantile(within)),
                point => point,
            }
            .to_unit(POINT_MASS_WIDTH, *is_first),
        }
    }

    pub(super) fn cdf(&self, coordinate: f64) -> f64 {
        let u = coordinate.clamp(0.0, 1.0);
        match self {
            Self::Uniform { .. } | Self::LogUniform { .. } => u,
            Self::Truncated {
                distribution: law,
                cdf_low: below,
                mass,
                ..
            } => ((law.cdf(self.value(u)) - below) / mass).clamp(0.0, 1.0),
            Self::Histogram {
                edges,
                probabilities,
            } => {
                let value = self.value(u);
                let shares = edges.windows(2).zip(probabilities).map(|(bin, share)| {
                    let within = ((value - bin[0]) / (bin[1] - bin[0])).clamp(0.0, 1.0);
                    within * share
                });
                shares.sum::<f64>().clamp(0.0, 1.0)
            }
            Self::Choice {
                probabilities: shares,
                ..
            } => {
                let position = u * shares.len() as f64;
                let index = (position as usize).min(shares.len() - 1);
                let before: f64 = shares.iter().take(index).sum();
                let share = shares.get(index).copied().unwrap_or(0.0);
                (before + share * (position - index as f64)).clamp(0.0, 1.0)
            }
            Self::PointMass {
                probability: share,
                is_first,
                others,
                ..
            } => match MixturePosition::from_unit(u, POINT_MASS_WIDTH, *is_first) {
                MixturePosition::Others(within) => MixturePosition::Others(others.cdf(within)),
                point => point,
            }
            .to_unit(*share, *is_first),
        }
    }

    /// Returns the probability of values up to `value`.
    pub(super) fn cdf_of_value(&self, value: f64) -> f64 {
        match self {
            Self::PointMass {
                at, is_first: true, ..
            } if value < *at => 0.0,
            Self::PointMass {
                at,
                probability: share,
                is_first: true,
                ..
            } if value == *at => *share,
            Self::PointMass {
                at,
                is_first: false,
                ..
            } if value >= *at => 1.0,
            _ => self.cdf(self.coordinate(value)),
        }
    }

    /// Returns the logarithm of the density with respect to coordinates; 0 where the distribution is uniform over the
    /// range.
    #[inline]
    pub(super) fn ln_density(&self, coordinate: f64) -> f64 {
        match self {
            Self::Uniform { .. } | Self::LogUniform { .. } => 0.0,
            Self::Truncated {
                low,
                high,
                distribution: law,
                mass,
                ..
            } => {
                let value = self
                    .value(coordinate)
                    .max(law.min_pdf_argument(*low, *high));
                law.ln_pdf(value) - mass.ln() + (high - low).ln()
            }
            Self::Histogram {
                edges,
                probabilities,
            } => {
                let value = self.value(coordinate);
                let bin = edges
                    .windows(2)
                    .zip(probabilities)
                    .find(|(bin, _)| value <= bin[1]);
                let density = bin.map_or(0.0, |(bin, share)| share / (bin[1] - bin[0]));
                (density * (self.high() - self.low())).ln()
            }
            Self::Choice {
                probabilities: shares,
                ..
            } => {
                let index = ((coordinate.clamp(0.0, 1.0) * shares.len() as f64) as usize)
                    .min(shares.len() - 1);
                (shares.get(index).copied().unwrap_or(0.0) * shares.len() as f64).ln()
            }
            Self::PointMass {
                probability: share,
                is_first,
                others,
                ..
            } => {
                match MixturePosition::from_unit(
                    coordinate.clamp(0.0, 1.0),
                    POINT_MASS_WIDTH,
                    *is_first,
                ) {
                    MixturePosition::PointMass(_) => (share / POINT_MASS_WIDTH).ln(),
                    MixturePosition::Others(within) => {
                        ((1.0 - share) / (1.0 - POINT_MASS_WIDTH)).ln() + others.ln_density(within)
                    }
                }
            }
        }
    }
}

/// Returns the value at CDF value `u`; `None` beyond the last bin.
fn histogram_quantile(edges: &[f64], shares: &[f64], u: f64) -> Option<f64> {
    let mut before = 0.0;
    for (bin, share) in edges.windows(2).zip(shares) {
        if u <= before + share && *share > 0.0 {
            return Some(bin[0] + (bin[1] - bin[0]) * (u - before) / share);
        }
        before += share;
    }
    None
}

/// Returns the coordinate at CDF value `u`: within the slice of a choice, as far as `u` is within its probability.
fn choice_quantile(shares: &[f64], u: f64) -> f64 {
    let mut before = 0.0;
    for (index, share) in shares.iter().enumerate() {
        if u < before + share || index + 1 == shares.len() {
            let within = if *share > 0.0 {
                ((u - before) / share).clamp(0.0, 1.0)
            } else {
                0.5
            };
            return (index as f64 + within.min(1.0 - f64::EPSILON)) / shares.len() as f64;
        }
        before += share;
    }
    1.0
}

#[cfg(test)]
mod tests;
