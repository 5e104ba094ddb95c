//! A normal distribution, fitted to values and to lower limits of further values.

/// Steps of expectation and maximisation; the change is below 1e-6 long before.
const STEPS: usize = 1000;
/// Smallest deviation, so that equal values give a distribution.
const MIN_DEVIATION: f64 = 0.01;

/// A normal distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CensoredNormal {
    mean: f64,
    deviation: f64,
}

/// Mean and variance of the part of a distribution above a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UpperPart {
    pub(super) mean: f64,
    pub(super) variance: f64,
}

impl CensoredNormal {
    /// Maximises the likelihood of values, and of further values of which only a lower limit is known, by expectation
    /// and maximisation (Dempster, Laird and Rubin 1977).
    pub(super) fn fit(values: &[f64], limits: &[f64]) -> Self {
        let count = (values.len() + limits.len()) as f64;
        let start = values.iter().chain(limits).sum::<f64>() / count;
        let mut normal = Self {
            mean: start,
            deviation: 0.2,
        };
        for _ in 0..STEPS {
            let parts: Vec<_> = limits.iter().map(|limit| normal.above(*limit)).collect();
            let sum = values.iter().sum::<f64>() + parts.iter().map(|part| part.mean).sum::<f64>();
            let mean = sum / count;
            let of_values: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
            let of_parts: f64 = parts
                .iter()
                .map(|part| part.variance + (part.mean - mean).powi(2))
                .sum();
            normal = Self {
                mean,
                deviation: ((of_values + of_parts) / count).sqrt().max(MIN_DEVIATION),
            };
        }
        normal
    }

    /// Returns the part above a limit: mean μ + σ λ and variance σ² (1 + z λ - λ²), with z = (limit - μ)/σ and λ the
    /// density at z divided by the probability above it.
    pub(super) fn above(&self, limit: f64) -> UpperPart {
        let z = (limit - self.mean) / self.deviation;
        let density = libm::exp(-0.5 * z * z) / (2.0 * std::f64::consts::PI).sqrt();
        let probability = 0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2);
        let hazard = density / probability;
        UpperPart {
            mean: self.mean + self.deviation * hazard,
            variance: self.deviation.powi(2) * (1.0 + z * hazard - hazard * hazard),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without limits, the fit has the mean and the deviation of the values.
    #[test]
    fn values_alone_give_their_moments() {
        let normal = CensoredNormal::fit(&[1.0, 2.0, 6.0], &[]);
        assert!((normal.mean - 3.0).abs() < 1e-9, "{normal:?}");
        let deviation = (14.0_f64 / 3.0).sqrt();
        assert!((normal.deviation - deviation).abs() < 1e-9, "{normal:?}");
    }

    /// No small change of the fit increases the likelihood, which is computed independently.
    #[test]
    fn the_fit_maximises_the_likelihood() {
        let (values, limits) = ([0.9, 1.0, 1.2, 0.7], [0.8, 1.7]);
        let log_likelihood = |mean: f64, deviation: f64| {
            let of_values: f64 = values
                .iter()
                .map(|value| -0.5 * ((value - mean) / deviation).powi(2) - deviation.ln())
                .sum();
            let of_limits: f64 = limits
                .iter()
                .map(|limit| libm::log(libm::erfc((limit - mean) / deviation / 2.0_f64.sqrt())))
                .sum();
            of_values + of_limits
        };
        let normal = CensoredNormal::fit(&values, &limits);
        let best = log_likelihood(normal.mean, normal.deviation);
        for [mean, deviation] in [[1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]] {
            assert!(log_likelihood(normal.mean + mean, normal.deviation + deviation) < best);
        }
    }
}
