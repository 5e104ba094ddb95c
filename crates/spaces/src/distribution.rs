//! Validation of distributions.

use statrs::distribution::{Gamma, LogNormal, Normal as Gauss, Weibull};

use super::invalid::{InvalidSpace, reject};
use super::marginal::{ContinuousDistribution, CoordinateMarginal};
use super::spec::{
    ChoiceSpec, DistributionSpec, HistogramSpec, LogNormalSpec, NormalSpec, ParameterValue,
    PointMassSpec, ShapeScaleSpec, UniformSpec, ValueKind,
};
use crumple_core::digits::format_compact;

/// Smallest probability mass of a distribution within its range.
const MIN_MASS: f64 = 1e-6;
/// Range of shapes of gamma and Weibull distributions.
const SHAPE_RANGE: [f64; 2] = [0.01, 1e6];

impl DistributionSpec {
    pub(super) fn kind(&self) -> ValueKind {
        match self {
            Self::Choice(choice) => choice.kind(),
            _ => ValueKind::Number,
        }
    }

    /// Returns the validated distribution. Paths in errors begin with the kind of distribution: `.normal.mean`.
    pub(super) fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        match self {
            Self::Uniform(UniformSpec { low, high }) => {
                let range = DistributionRange::new(".uniform", *low, *high)?;
                Ok(range.uniform())
            }
            Self::LogUniform(UniformSpec { low, high }) => {
                let range = DistributionRange::new(".log-uniform", *low, *high)?;
                range.log_uniform()
            }
            Self::Normal(normal) => normal.marginal(),
            Self::LogNormal(log_normal) => log_normal.marginal(),
            Self::Gamma(gamma) => gamma.gamma_marginal(),
            Self::Weibull(weibull) => weibull.weibull_marginal(),
            Self::Histogram(histogram) => histogram.marginal(),
            Self::Choice(choice) => choice.marginal(),
            Self::PointMass(point_mass) => point_mass.marginal(),
        }
    }
}

/// A valid range of a distribution, with the path of the distribution in errors.
#[derive(Clone, Copy)]
struct DistributionRange {
    path: &'static str,
    low: f64,
    high: f64,
}

impl DistributionRange {
    fn new(path: &'static str, low: f64, high: f64) -> Result<Self, InvalidSpace> {
        check_finite(path, "low", low)?;
        check_finite(path, "high", high)?;
        if low < high {
            return Ok(Self { path, low, high });
        }
        let [low, high] = [low, high].map(format_compact);
        reject(
            path,
            format!("low must be below high, found {low} and {high}"),
        )
    }

    fn check_non_negative(&self) -> Result<(), InvalidSpace> {
        if self.low >= 0.0 {
            return Ok(());
        }
        let low = format_compact(self.low);
        reject(self.path, format!("low must be from 0, found {low}"))
    }

    fn uniform(self) -> CoordinateMarginal {
        CoordinateMarginal::Uniform {
            low: self.low,
            high: self.high,
        }
    }

    fn log_uniform(self) -> Result<CoordinateMarginal, InvalidSpace> {
        let Self { low, high, .. } = self;
        if low <= 0.0 {
            return reject(".log-uniform.low", format!("must be above 0, found {low}"));
        }
        Ok(CoordinateMarginal::LogUniform { low, high })
    }

    /// Returns a distribution within this range only.
    fn truncate(
        self,
        distribution: ContinuousDistribution,
    ) -> Result<CoordinateMarginal, InvalidSpace> {
        let Self { path, low, high } = self;
        let cdf_low = distribution.cdf(low);
        let mass = distribution.cdf(high) - cdf_low;
        if mass.is_nan() || mass < MIN_MASS {
            let [low, high, mass] = [low, high, mass].map(format_compact);
            let problem = format!(
                "the range from {low} to {high} holds a share of only {mass} of the distribution, and must hold \
                {MIN_MASS}"
            );
            return reject(path, problem);
        }
        Ok(CoordinateMarginal::Truncated {
            low,
            high,
            distribution,
            cdf_low,
            mass,
        })
    }
}

impl NormalSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let path = ".normal";
        let range = DistributionRange::new(path, self.low, self.high)?;
        check_finite(path, "mean", self.mean)?;
        check_finite(path, "deviation", self.deviation)?;
        check_positive(path, "deviation", self.deviation)?;
        let gauss = Gauss::new(self.mean, self.deviation)
            .map_err(|problem| InvalidSpace::new(path, problem.to_string()))?;
        range.truncate(ContinuousDistribution::Normal(gauss))
    }
}

impl LogNormalSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let path = ".log-normal";
        let range = DistributionRange::new(path, self.low, self.high)?;
        range.check_non_negative()?;
        check_finite(path, "ln_mean", self.ln_mean)?;
        check_finite(path, "ln_deviation", self.ln_deviation)?;
        check_positive(path, "ln_deviation", self.ln_deviation)?;
        let log_normal = LogNormal::new(self.ln_mean, self.ln_deviation)
            .map_err(|problem| InvalidSpace::new(path, problem.to_string()))?;
        range.truncate(ContinuousDistribution::LogNormal(log_normal))
    }
}

impl ShapeScaleSpec {
    fn gamma_marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let range = self.check(".gamma")?;
        let gamma = Gamma::new(self.shape, 1.0 / self.scale)
            .map_err(|problem| InvalidSpace::new(range.path, problem.to_string()))?;
        range.truncate(ContinuousDistribution::Gamma(gamma))
    }

    fn weibull_marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let range = self.check(".weibull")?;
        let weibull = Weibull::new(self.shape, self.scale)
            .map_err(|problem| InvalidSpace::new(range.path, problem.to_string()))?;
        range.truncate(ContinuousDistribution::Weibull(weibull))
    }

    fn check(&self, path: &'static str) -> Result<DistributionRange, InvalidSpace> {
        let range = DistributionRange::new(path, self.low, self.high)?;
        range.check_non_negative()?;
        let [min, max] = SHAPE_RANGE;
        if !(min..=max).contains(&self.shape) {
            let shape = format_compact(self.shape);
            return reject(
                path,
                format!("shape must be from {min} to {max}, found {shape}"),
            );
        }
        if !(1e-9..=1e9).contains(&self.scale) {
            let scale = format_compact(self.scale);
            return reject(
                path,
                format!("scale must be from 1e-9 to 1e9, found {scale}"),
            );
        }
        Ok(range)
    }
}

impl HistogramSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let Self { edges, weights } = self;
        let increases = edges.windows(2).all(|pair| pair[0] < pair[1]);
        if edges.len() < 2 || !increases || !edges.iter().all(|edge| edge.is_finite()) {
            let problem = "must be at least two increasing finite numbers";
            return reject(".histogram.edges", problem);
        }
        if weights.len() + 1 != edges.len() {
            let problem = format!(
                "must be one fewer than edges ({}), found {}",
                edges.len(),
                weights.len()
            );
            return reject(".histogram.weights", problem);
        }
        Ok(CoordinateMarginal::Histogram {
            edges: edges.clone(),
            probabilities: normalize(weights, ".histogram.weights")?,
        })
    }
}

/// Returns the probabilities of relative weights.
fn normalize(weights: &[f64], path: &str) -> Result<Vec<f64>, InvalidSpace> {
    if let Some(weight) = weights
        .iter()
        .find(|&&weight| !(weight >= 0.0 && weight.is_finite()))
    {
        return reject(
            path,
            format!("must be finite numbers from 0, found {weight}"),
        );
    }
    let total: f64 = weights.iter().sum();
    if !(total > 0.0 && total.is_finite()) {
        let total = format_compact(total);
        let problem = format!("must add up to a finite number above 0, found a sum of {total}");
        return reject(path, problem);
    }
    Ok(weights.iter().map(|weight| weight / total).collect())
}

impl PointMassSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let others = self.others_marginal()?;
        let Self {
            at, probability, ..
        } = *self;
        if !(0.0..1.0).contains(&probability) {
            let probability = format_compact(probability);
            let problem = format!("must be from 0, below 1, found {probability}");
            return reject(".point-mass.probability", problem);
        }
        let low = others.low();
        let high = others.high();
        if !at.is_finite() || (at > low && at < high) {
            let [low, high, found] = [low, high, at].map(format_compact);
            let problem = format!(
                "must be at most {low} or at least {high}, where the others end, found {found}"
            );
            return reject(".point-mass.at", problem);
        }
        Ok(CoordinateMarginal::PointMass {
            at,
            probability,
            is_first: at <= low,
            others: Box::new(others),
        })
    }

    fn others_marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let path = ".point-mass.others";
        if matches!(
            *self.others,
            DistributionSpec::Choice(_) | DistributionSpec::PointMass(_)
        ) {
            let problem = "must have a density: no choice, and no other point mass";
            return reject(path, problem);
        }
        self.others
            .marginal()
            .map_err(|InvalidSpace { field, problem }| {
                let field = field.trim_start_matches('.');
                InvalidSpace::new(path, format!("{field}: {problem}"))
            })
    }
}

fn check_positive(path: &str, name: &str, value: f64) -> Result<(), InvalidSpace> {
    if value > 0.0 {
        return Ok(());
    }
    let value = format_compact(value);
    reject(path, format!("{name} must be above 0, found {value}"))
}

fn check_finite(path: &str, name: &str, value: f64) -> Result<(), InvalidSpace> {
    if value.is_finite() {
        return Ok(());
    }
    reject(
        path,
        format!("{name} must be a finite number, found {value}"),
    )
}

impl ChoiceSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, InvalidSpace> {
        let values = self.check_values()?;
        let path = ".choice.weights";
        let weights = match &self.weights {
            Some(weights) => weights.clone(),
            None => vec![1.0; values.len()],
        };
        if weights.len() != values.len() {
            let problem = format!(
                "must be as many as values ({}), found {}",
                values.len(),
                weights.len()
            );
            return reject(path, problem);
        }
        Ok(CoordinateMarginal::Choice {
            probabilities: normalize(&weights, path)?,
            values,
        })
    }

    /// Returns the kind of the values: followers if one of them is only a follower.
    fn kind(&self) -> ValueKind {
        let mut kinds = self.values.iter().map(|value| value.kind());
        let first = kinds.clone().next().unwrap_or(ValueKind::Number);
        if kinds.any(|kind| kind == ValueKind::Follower) {
            ValueKind::Follower
        } else {
            first
        }
    }

    /// Returns the values as numbers.
    fn check_values(&self) -> Result<Vec<f64>, InvalidSpace> {
        let path = ".choice.values";
        let numbers: Vec<f64> = self.values.iter().map(|value| value.number()).collect();
        let Some(first) = self.values.first() else {
            return reject(path, "must have at least one value");
        };
        let kind = self.kind();
        let is_of_kind = |value: &ParameterValue| match kind {
            ValueKind::Follower => matches!(value.kind(), ValueKind::Driver | ValueKind::Follower),
            _ => value.kind() == first.kind(),
        };
        if !self.values.iter().all(is_of_kind) {
            let problem = "must be all numbers, all classes or all drivers";
            return reject(path, problem);
        }
        if let Some(value) = numbers.iter().find(|value| !value.is_finite()) {
            return reject(path, format!("must be finite numbers, found {value}"));
        }
        let mut numbered = self.values.iter().enumerate();
        match numbered.find(|(index, value)| self.values[..*index].contains(value)) {
            Some((_, value)) => reject(path, format!("must differ, found {value} twice")),
            None => Ok(numbers),
        }
    }
}
