//! Validation of distributions.

use statrs::distribution::{
    Gamma as GammaLaw, LogNormal as LogNormalLaw, Normal as Gauss, Weibull as WeibullLaw,
};

use super::marginal::{ContinuousDistribution, CoordinateMarginal};
use super::spec::{
    ChoiceSpec, DistributionSpec, HistogramSpec, PointMassSpec, ShapeScaleSpec, UniformSpec,
    ValueKind,
};
use crumple_core::digits::format_compact;

/// Smallest probability mass of a distribution within its range.
const MIN_MASS: f64 = 1e-6;
/// Range of shapes of gamma and Weibull distributions.
const SHAPE_RANGE: [f64; 2] = [0.01, 1e6];

impl DistributionSpec {
    pub(super) fn kind(&self) -> ValueKind {
        match self {
            Self::Choice(choice) => choice
                .values
                .first()
                .map_or(ValueKind::Number, |value| value.kind()),
            _ => ValueKind::Number,
        }
    }

    /// Returns the validated distribution, or the invalid field and its problem.
    pub(super) fn marginal(&self) -> Result<CoordinateMarginal, (&'static str, String)> {
        let range = |low: f64, high: f64, kind: &'static str| {
            check_finite(kind, "low", low)?;
            check_finite(kind, "high", high)?;
            let found = || {
                format!(
                    "low must be below high, found {} and {}",
                    format_compact(low),
                    format_compact(high)
                )
            };
            if low < high {
                Ok(())
            } else {
                Err((kind, found()))
            }
        };
        match self {
            Self::Uniform(UniformSpec { low, high }) => {
                range(*low, *high, ".uniform")?;
                Ok(CoordinateMarginal::Uniform {
                    low: *low,
                    high: *high,
                })
            }
            Self::LogUniform(UniformSpec { low, high }) => {
                range(*low, *high, ".log-uniform")?;
                if *low <= 0.0 {
                    return Err((".log-uniform.low", format!("must be above 0, found {low}")));
                }
                Ok(CoordinateMarginal::LogUniform {
                    low: *low,
                    high: *high,
                })
            }
            Self::Normal(normal) => {
                range(normal.low, normal.high, ".normal")?;
                check_finite(".normal", "mean", normal.mean)?;
                check_finite(".normal", "deviation", normal.deviation)?;
                let gauss = Gauss::new(normal.mean, normal.deviation)
                    .ok()
                    .filter(|_| normal.deviation > 0.0);
                let gauss =
                    gauss.ok_or_else(|| not_positive(".normal", "deviation", normal.deviation))?;
                truncate(
                    ".normal",
                    ContinuousDistribution::Normal(gauss),
                    normal.low,
                    normal.high,
                )
            }
            Self::LogNormal(of) => {
                let kind = ".log-normal";
                range(of.low, of.high, kind)?;
                check_non_negative(kind, of.low)?;
                check_finite(kind, "ln_mean", of.ln_mean)?;
                check_finite(kind, "ln_deviation", of.ln_deviation)?;
                let law = LogNormalLaw::new(of.ln_mean, of.ln_deviation)
                    .ok()
                    .filter(|_| of.ln_deviation > 0.0);
                let law = law.ok_or_else(|| not_positive(kind, "ln_deviation", of.ln_deviation))?;
                truncate(
                    kind,
                    ContinuousDistribution::LogNormal(law),
                    of.low,
                    of.high,
                )
            }
            Self::Gamma(of) => {
                let kind = ".gamma";
                range(of.low, of.high, kind)?;
                let [shape, scale] = of.validate(kind)?;
                let law = GammaLaw::new(shape, 1.0 / scale)
                    .map_err(|problem| (kind, problem.to_string()))?;
                truncate(kind, ContinuousDistribution::Gamma(law), of.low, of.high)
            }
            Self::Weibull(of) => {
                let kind = ".weibull";
                range(of.low, of.high, kind)?;
                let [shape, scale] = of.validate(kind)?;
                let law =
                    WeibullLaw::new(shape, scale).map_err(|problem| (kind, problem.to_string()))?;
                truncate(kind, ContinuousDistribution::Weibull(law), of.low, of.high)
            }
            Self::Histogram(histogram) => histogram.marginal(),
            Self::Choice(choice) => choice_marginal(choice),
            Self::PointMass(of) => of.marginal(),
        }
    }
}

impl ShapeScaleSpec {
    fn validate(&self, kind: &'static str) -> Result<[f64; 2], (&'static str, String)> {
        check_non_negative(kind, self.low)?;
        let Self { shape, scale, .. } = *self;
        if !(SHAPE_RANGE[0]..=SHAPE_RANGE[1]).contains(&shape) {
            return Err((
                kind,
                format!(
                    "shape must be from {} to {}, found {}",
                    SHAPE_RANGE[0],
                    SHAPE_RANGE[1],
                    format_compact(shape)
                ),
            ));
        }
        if !(1e-9..=1e9).contains(&scale) {
            return Err((
                kind,
                format!(
                    "scale must be from 1e-9 to 1e9, found {}",
                    format_compact(scale)
                ),
            ));
        }
        Ok([shape, scale])
    }
}

impl HistogramSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, (&'static str, String)> {
        let Self { edges, weights } = self;
        let increases = edges.windows(2).all(|pair| pair[0] < pair[1]);
        if edges.len() < 2 || !increases || !edges.iter().all(|edge| edge.is_finite()) {
            return Err((
                ".histogram.edges",
                "must be at least two increasing finite numbers".to_owned(),
            ));
        }
        if weights.len() + 1 != edges.len() {
            let problem = format!(
                "must be one fewer than edges ({}), found {}",
                edges.len(),
                weights.len()
            );
            return Err((".histogram.weights", problem));
        }
        let probabilities = shares(weights).map_err(|problem| (".histogram.weights", problem))?;
        Ok(CoordinateMarginal::Histogram {
            edges: edges.clone(),
            probabilities,
        })
    }
}

/// Returns the probabilities of relative weights.
fn shares(weights: &[f64]) -> Result<Vec<f64>, String> {
    if let Some(weight) = weights
        .iter()
        .find(|weight| !(**weight >= 0.0 && weight.is_finite()))
    {
        return Err(format!("must be finite numbers from 0, found {weight}"));
    }
    let total: f64 = weights.iter().sum();
    if !(total > 0.0 && total.is_finite()) {
        return Err(format!(
            "must add up to a finite number above 0, found a sum of {}",
            format_compact(total)
        ));
    }
    Ok(weights.iter().map(|weight| weight / total).collect())
}

impl PointMassSpec {
    fn marginal(&self) -> Result<CoordinateMarginal, (&'static str, String)> {
        let Self {
            at,
            probability,
            others,
        } = self;
        if matches!(
            **others,
            DistributionSpec::Choice(_) | DistributionSpec::PointMass(_)
        ) {
            return Err((
                ".point-mass.others",
                "must have a density: no choice, and no other point mass".to_owned(),
            ));
        }
        let in_others = |(field, problem): (&'static str, String)| {
            (
                ".point-mass.others",
                format!("{}: {problem}", field.trim_start_matches('.')),
            )
        };
        let others = others.marginal().map_err(in_others)?;
        if !(0.0..1.0).contains(probability) {
            return Err((
                ".point-mass.probability",
                format!(
                    "must be from 0, below 1, found {}",
                    format_compact(*probability)
                ),
            ));
        }
        let (low, high) = (others.low(), others.high());
        if !at.is_finite() || (*at > low && *at < high) {
            let (low, high, at) = (
                format_compact(low),
                format_compact(high),
                format_compact(*at),
            );
            let problem = format!(
                "must be at most {low} or at least {high}, where the others end, found {at}"
            );
            return Err((".point-mass.at", problem));
        }
        Ok(CoordinateMarginal::PointMass {
            at: *at,
            probability: *probability,
            is_first: *at <= low,
            others: Box::new(others),
        })
    }
}

fn truncate(
    kind: &'static str,
    law: ContinuousDistribution,
    low: f64,
    high: f64,
) -> Result<CoordinateMarginal, (&'static str, String)> {
    let below = law.cdf(low);
    let mass = law.cdf(high) - below;
    if mass.is_nan() || mass < MIN_MASS {
        let (low, high, mass) = (
            format_compact(low),
            format_compact(high),
            format_compact(mass),
        );
        let problem = format!(
            "the range from {low} to {high} holds a share of only {mass} of the distribution, and must hold {MIN_MASS}"
        );
        return Err((kind, problem));
    }
    Ok(CoordinateMarginal::Truncated {
        low,
        high,
        distribution: law,
        cdf_low: below,
        mass,
    })
}

fn not_positive(kind: &'static str, field: &str, found: f64) -> (&'static str, String) {
    (
        kind,
        format!("{field} must be above 0, found {}", format_compact(found)),
    )
}

fn check_non_negative(kind: &'static str, low: f64) -> Result<(), (&'static str, String)> {
    if low >= 0.0 {
        Ok(())
    } else {
        Err((
            kind,
            format!("low must be from 0, found {}", format_compact(low)),
        ))
    }
}

fn check_finite(kind: &'static str, field: &str, found: f64) -> Result<(), (&'static str, String)> {
    if found.is_finite() {
        Ok(())
    } else {
        Err((
            kind,
            format!("{field} must be a finite number, found {found}"),
        ))
    }
}

fn choice_marginal(choice: &ChoiceSpec) -> Result<CoordinateMarginal, (&'static str, String)> {
    let unusable = |problem: String| Err((".choice.values", problem));
    let values: Vec<f64> = choice.values.iter().map(|value| value.number()).collect();
    if values.is_empty() {
        return unusable("must have at least one value".to_owned());
    }
    if choice
        .values
        .windows(2)
        .any(|pair| pair[0].kind() != pair[1].kind())
    {
        return unusable("must be all numbers, all classes or all drivers".to_owned());
    }
    if let Some(value) = values.iter().find(|value| !value.is_finite()) {
        return unusable(format!("must be finite numbers, found {value}"));
    }
    let mut known = choice.values.iter().enumerate();
    if let Some((_, value)) =
        known.find(|(index, value)| choice.values.iter().take(*index).any(|v| v == *value))
    {
        return unusable(format!("must differ, found {value} twice"));
    }
    let weights = choice
        .weights
        .clone()
        .unwrap_or_else(|| vec![1.0; values.len()]);
    let unusable = |problem: String| Err((".choice.weights", problem));
    if weights.len() != values.len() {
        return unusable(format!(
            "must be as many as values ({}), found {}",
            values.len(),
            weights.len()
        ));
    }
    let probabilities = shares(&weights).map_err(|problem| (".choice.weights", problem))?;
    Ok(CoordinateMarginal::Choice {
        values,
        probabilities,
    })
}
