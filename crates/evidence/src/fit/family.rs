//! Maximum likelihood fits of truncated distribution families.

use serde::Serialize;
use statrs::function::gamma::ln_gamma;

use super::minimum::{hessian, minimize};
use crumple_spaces::{DistributionSpec, LogNormalSpec, NormalSpec, ShapeScaleSpec, UniformSpec};

/// Distribution family with two parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DistributionFamily {
    /// Uniform.
    Uniform,
    /// Normal.
    Normal,
    /// Log-normal.
    LogNormal,
    /// Gamma.
    Gamma,
    /// Weibull.
    Weibull,
}

/// Fit of a family to values.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamilyFit {
    /// Family that was fitted.
    pub family: DistributionFamily,
    /// Names of the parameters in a space file.
    pub parameter_names: [&'static str; 2],
    /// Parameter estimates.
    pub estimates: [f64; 2],
    /// Confidence intervals at 95 %: Wald's, exact for a uniform distribution. `None` if the likelihood has no maximum
    /// within the allowed range, or its curvature there is singular.
    pub intervals_95: Option<[[f64; 2]; 2]>,
    /// Log-likelihood.
    pub ln_likelihood: f64,
    /// Akaike information criterion: 2 k − 2 ln L, k = 2.
    pub aic: f64,
    /// Bayesian information criterion: k ln n − 2 ln L, k = 2.
    pub bic: f64,
    /// Distribution in the form of a space.
    #[serde(skip)]
    pub distribution: DistributionSpec,
}

/// Reason why a family cannot be fitted.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FamilyFitError {
    /// The family has positive values only.
    #[error("needs values above 0, found {0}")]
    NotPositive(f64),
    /// There is no value.
    #[error("there is no value")]
    NoValue,
    /// All values are equal.
    #[error("all values are {0}")]
    Constant(f64),
    /// The likelihood has no maximum.
    #[error("the likelihood has no maximum")]
    NoMaximum,
}

struct SampleStatistics<'a> {
    values: &'a [f64],
    logarithms: Vec<f64>,
    mean: f64,
    deviation: f64,
    ln_mean: f64,
    ln_deviation: f64,
    range: [f64; 2],
}

const Z_95: f64 = 1.959_963_984_540_054;

impl DistributionFamily {
    /// All families.
    pub const ALL: [Self; 5] = [
        Self::Uniform,
        Self::Normal,
        Self::LogNormal,
        Self::Gamma,
        Self::Weibull,
    ];

    /// Returns the name in a space file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Normal => "normal",
            Self::LogNormal => "log-normal",
            Self::Gamma => "gamma",
            Self::Weibull => "weibull",
        }
    }

    /// Fits the family, truncated to a range, to values.
    ///
    /// # Errors
    /// [`FamilyFitError`] if the family cannot describe the values.
    pub fn fit(self, values: &[f64], range: [f64; 2]) -> Result<FamilyFit, FamilyFitError> {
        if values.is_empty() {
            return Err(FamilyFitError::NoValue);
        }
        let (smallest, largest) = min_max(values);
        if smallest >= largest {
            return Err(FamilyFitError::Constant(smallest));
        }
        if self == Self::Uniform {
            return Ok(fit_uniform(values.len(), smallest, largest));
        }
        if self != Self::Normal && smallest <= 0.0 {
            return Err(FamilyFitError::NotPositive(smallest));
        }
        let sums = SampleStatistics::new(values, range);
        let objective = |point: [f64; 2]| -self.ln_likelihood(&sums, point);
        let maximum = minimize(&objective, self.initial_point(&sums));
        let ln_likelihood = -objective(maximum);
        if !ln_likelihood.is_finite() {
            return Err(FamilyFitError::NoMaximum);
        }
        Ok(FamilyFit {
            family: self,
            parameter_names: self.parameter_names(),
            estimates: self.estimates(&sums, maximum),
            intervals_95: self.intervals(&sums, &objective, maximum),
            ln_likelihood,
            aic: 4.0 - 2.0 * ln_likelihood,
            bic: 2.0 * (values.len() as f64).ln() - 2.0 * ln_likelihood,
            distribution: self.distribution(self.estimates(&sums, maximum), range),
        })
    }

    fn parameter_names(self) -> [&'static str; 2] {
        match self {
            Self::Uniform => ["low", "high"],
            Self::Normal => ["mean", "deviation"],
            Self::LogNormal => ["ln_mean", "ln_deviation"],
            Self::Gamma | Self::Weibull => ["shape", "scale"],
        }
    }

    /// Returns the initial point of the search from the moments without truncation.
    fn initial_point(self, sums: &SampleStatistics<'_>) -> [f64; 2] {
        match self {
            Self::Uniform | Self::Normal | Self::LogNormal => [0.0, 0.0],
            Self::Gamma => [
                (2.0 * (sums.mean / sums.deviation).ln()).clamp(-4.0, 13.0),
                0.0,
            ],
            // The logarithm of a Weibull variable has the standard deviation π / (√6 k).
            Self::Weibull => [
                (std::f64::consts::PI / 6.0_f64.sqrt() / sums.ln_deviation)
                    .ln()
                    .clamp(-4.0, 13.0),
                0.0,
            ],
        }
    }

    fn estimates(self, sums: &SampleStatistics<'_>, [a, b]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Uniform | Self::Normal => {
                [sums.mean + sums.deviation * a, sums.deviation * b.exp()]
            }
            Self::LogNormal => [
                sums.ln_mean + sums.ln_deviation * a,
                sums.ln_deviation * b.exp(),
            ],
            Self::Gamma => [a.exp(), sums.mean * (b - a).exp()],
            Self::Weibull => [a.exp(), sums.mean * b.exp()],
        }
    }

    fn distribution(self, [first, second]: [f64; 2], [low, high]: [f64; 2]) -> DistributionSpec {
        match self {
            Self::Uniform => DistributionSpec::Uniform(UniformSpec {
                low: first,
                high: second,
            }),
            Self::Normal => DistributionSpec::Normal(NormalSpec {
                mean: first,
                deviation: second,
                low,
                high,
            }),
            Self::LogNormal => DistributionSpec::LogNormal(LogNormalSpec {
                ln_mean: first,
                ln_deviation: second,
                low,
                high,
            }),
            Self::Gamma => DistributionSpec::Gamma(ShapeScaleSpec {
                shape: first,
                scale: second,
                low,
                high,
            }),
            Self::Weibull => DistributionSpec::Weibull(ShapeScaleSpec {
                shape: first,
                scale: second,
                low,
                high,
            }),
        }
    }

    /// Returns the log-likelihood of the truncated distribution; −∞ for parameters that no space may have.
    fn ln_likelihood(self, sums: &SampleStatistics<'_>, at: [f64; 2]) -> f64 {
        let n = sums.values.len() as f64;
        let parameters = self.estimates(sums, at);
        let Ok(ready) = self.distribution(parameters, sums.range).build() else {
            return f64::NEG_INFINITY;
        };
        let whole = match self {
            Self::Uniform => return f64::NEG_INFINITY,
            Self::Normal => normal_ln_likelihood(n, parameters, [sums.mean, sums.deviation]),
            Self::LogNormal => {
                let logarithms = [sums.ln_mean, sums.ln_deviation];
                normal_ln_likelihood(n, parameters, logarithms) - n * sums.ln_mean
            }
            Self::Gamma => {
                let [shape, scale] = parameters;
                n * ((shape - 1.0) * sums.ln_mean
                    - sums.mean / scale
                    - shape * scale.ln()
                    - ln_gamma(shape))
            }
            Self::Weibull => {
                let [shape, scale] = parameters;
                let powers: f64 = sums
                    .logarithms
                    .iter()
                    .map(|ln| (shape * (ln - scale.ln())).exp())
                    .sum();
                n * (shape.ln() - shape * scale.ln() + (shape - 1.0) * sums.ln_mean) - powers
            }
        };
        whole - n * ready.truncation_mass().ln()
    }

    /// Returns the intervals from the inverse of the Hessian (Wald, 1943).
    fn intervals(
        self,
        sums: &SampleStatistics<'_>,
        objective: &dyn Fn([f64; 2]) -> f64,
        at: [f64; 2],
    ) -> Option<[[f64; 2]; 2]> {
        let [[aa, ab], [_, bb]] = hessian(objective, at)?;
        let determinant = aa * bb - ab * ab;
        if !(aa > 0.0 && determinant > 0.0) {
            return None;
        }
        let [var_a, var_b, covariance] = [bb, aa, -ab].map(|entry| entry / determinant);
        let [a, b] = at;
        let deviation_a = var_a.sqrt();
        let deviation_b = match self {
            // The logarithm of the second parameter is the difference of both coordinates.
            Self::Gamma => (var_a + var_b - 2.0 * covariance).max(0.0).sqrt(),
            _ => var_b.sqrt(),
        };
        let [[low_a, low_b], [high_a, high_b]] = [-1.0, 1.0].map(|sign| {
            [
                self.estimates(sums, [a + sign * Z_95 * deviation_a, b])[0],
                self.estimates(sums, [a, b + sign * Z_95 * deviation_b])[1],
            ]
        });
        Some([[low_a, high_a], [low_b, high_b]])
    }
}

/// Returns the log-likelihood of a normal distribution for `n` values with a mean and a standard deviation.
fn normal_ln_likelihood(
    n: f64,
    [mean, deviation]: [f64; 2],
    [sample_mean, sample_deviation]: [f64; 2],
) -> f64 {
    let ln_root = 0.5 * (2.0 * std::f64::consts::PI).ln();
    let offset = (sample_mean - mean) / deviation;
    let spread = sample_deviation / deviation;
    -n * (deviation.ln() + ln_root + 0.5 * (spread * spread + offset * offset))
}

/// Fits the uniform distribution: the observed ends are the most likely ones. The relative distance T to the true ends
/// has P(T > t) = (1 + t)^(1 − n).
fn fit_uniform(n: usize, low: f64, high: f64) -> FamilyFit {
    let width = high - low;
    let beyond = width * (0.05_f64.powf(-1.0 / (n as f64 - 1.0)) - 1.0);
    let ln_likelihood = -(n as f64) * width.ln();
    FamilyFit {
        family: DistributionFamily::Uniform,
        parameter_names: DistributionFamily::Uniform.parameter_names(),
        estimates: [low, high],
        intervals_95: Some([[low - beyond, low], [high, high + beyond]]),
        ln_likelihood,
        aic: 4.0 - 2.0 * ln_likelihood,
        bic: 2.0 * (n as f64).ln() - 2.0 * ln_likelihood,
        distribution: DistributionFamily::Uniform.distribution([low, high], [low, high]),
    }
}

impl<'a> SampleStatistics<'a> {
    fn new(values: &'a [f64], range: [f64; 2]) -> Self {
        let logarithms: Vec<f64> = values.iter().map(|value| value.ln()).collect();
        let [mean, deviation] = moments(values);
        let [ln_mean, ln_deviation] = moments(&logarithms);
        Self {
            values,
            logarithms,
            mean,
            deviation,
            ln_mean,
            ln_deviation,
            range,
        }
    }
}

/// Returns the mean and the standard deviation.
fn moments(values: &[f64]) -> [f64; 2] {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|value| (value - mean) * (value - mean));
    [mean, (squares.sum::<f64>() / n).sqrt()]
}

fn min_max(values: &[f64]) -> (f64, f64) {
    values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| {
            (low.min(value), high.max(value))
        })
}
