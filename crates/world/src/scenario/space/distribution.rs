//! From a distribution's data to one that is found to be valid.

use statrs::distribution::{Gamma as GammaLaw, LogNormal as LogNormalLaw, Normal as Gauss, Weibull as WeibullLaw};

use super::marginal::{Law, Marginal};
use super::spec::{Choice, Distribution, Kind, PointMass, ShapeScale, Uniform};
use crate::scenario::short;

/// Least share of a distribution that must lie in its range.
const LEAST_MASS: f64 = 1e-6;
/// Shapes of gamma and Weibull distributions.
const SHAPES: [f64; 2] = [0.01, 1e6];

impl Distribution {
    pub(super) fn kind(&self) -> Kind {
        match self {
            Self::Choice(choice) => choice.values.first().map_or(Kind::Number, |value| value.kind()),
            _ => Kind::Number,
        }
    }

    /// The distribution ready for use, or which field of it is wrong and why.
    pub(super) fn marginal(&self) -> Result<Marginal, (&'static str, String)> {
        let range = |low: f64, high: f64, kind: &'static str| {
            finite(kind, "low", low)?;
            finite(kind, "high", high)?;
            let found = || format!("low must be below high, found {} and {}", short(low), short(high));
            if low < high { Ok(()) } else { Err((kind, found())) }
        };
        match self {
            Self::Uniform(Uniform { low, high }) => {
                range(*low, *high, ".uniform")?;
                Ok(Marginal::Uniform { low: *low, high: *high })
            }
            Self::LogUniform(Uniform { low, high }) => {
                range(*low, *high, ".log-uniform")?;
                if *low <= 0.0 {
                    return Err((".log-uniform.low", format!("must be above 0, found {low}")));
                }
                Ok(Marginal::LogUniform { low: *low, high: *high })
            }
            Self::Normal(normal) => {
                range(normal.low, normal.high, ".normal")?;
                finite(".normal", "mean", normal.mean)?;
                finite(".normal", "deviation", normal.deviation)?;
                let gauss = Gauss::new(normal.mean, normal.deviation).ok().filter(|_| normal.deviation > 0.0);
                let Some(gauss) = gauss else {
                    let found = short(normal.deviation);
                    return Err((".normal", format!("deviation must be above 0, found {found}")));
                };
                cut(".normal", Law::Normal(gauss), normal.low, normal.high)
            }
            Self::LogNormal(of) => {
                let kind = ".log-normal";
                range(of.low, of.high, kind)?;
                from_zero(kind, of.low)?;
                finite(kind, "ln_mean", of.ln_mean)?;
                finite(kind, "ln_deviation", of.ln_deviation)?;
                let law = LogNormalLaw::new(of.ln_mean, of.ln_deviation).ok().filter(|_| of.ln_deviation > 0.0);
                let Some(law) = law else {
                    return Err((kind, format!("ln_deviation must be above 0, found {}", short(of.ln_deviation))));
                };
                cut(kind, Law::LogNormal(law), of.low, of.high)
            }
            Self::Gamma(of) => {
                let kind = ".gamma";
                range(of.low, of.high, kind)?;
                let [shape, scale] = of.checked(kind)?;
                let law = GammaLaw::new(shape, 1.0 / scale).map_err(|problem| (kind, problem.to_string()))?;
                cut(kind, Law::Gamma(law), of.low, of.high)
            }
            Self::Weibull(of) => {
                let kind = ".weibull";
                range(of.low, of.high, kind)?;
                let [shape, scale] = of.checked(kind)?;
                let law = WeibullLaw::new(shape, scale).map_err(|problem| (kind, problem.to_string()))?;
                cut(kind, Law::Weibull(law), of.low, of.high)
            }
            Self::Choice(choice) => choice_of(choice),
            Self::PointMass(of) => of.marginal(),
        }
    }
}

impl ShapeScale {
    /// Shape and scale.
    fn checked(&self, kind: &'static str) -> Result<[f64; 2], (&'static str, String)> {
        from_zero(kind, self.low)?;
        let Self { shape, scale, .. } = *self;
        if !(SHAPES[0]..=SHAPES[1]).contains(&shape) {
            return Err((kind, format!("shape must be from {} to {}, found {}", SHAPES[0], SHAPES[1], short(shape))));
        }
        if !(1e-9..=1e9).contains(&scale) {
            return Err((kind, format!("scale must be from 1e-9 to 1e9, found {}", short(scale))));
        }
        Ok([shape, scale])
    }
}

impl PointMass {
    fn marginal(&self) -> Result<Marginal, (&'static str, String)> {
        let Self { at, probability, others } = self;
        if matches!(**others, Distribution::Choice(_) | Distribution::PointMass(_)) {
            return Err((".point-mass.others", "must have a density: no choice, and no other point mass".to_owned()));
        }
        let in_others = |(field, problem): (&'static str, String)| {
            (".point-mass.others", format!("{}: {problem}", field.trim_start_matches('.')))
        };
        let others = others.marginal().map_err(in_others)?;
        if !(0.0..1.0).contains(probability) {
            return Err((".point-mass.probability", format!("must be from 0, below 1, found {}", short(*probability))));
        }
        let (low, high) = (others.low(), others.high());
        if !at.is_finite() || (*at > low && *at < high) {
            let (low, high, at) = (short(low), short(high), short(*at));
            let problem = format!("must be at most {low} or at least {high}, where the others end, found {at}");
            return Err((".point-mass.at", problem));
        }
        Ok(Marginal::PointMass { at: *at, share: *probability, is_first: *at <= low, others: Box::new(others) })
    }
}

/// A law within a range, if the range holds enough of it.
fn cut(kind: &'static str, law: Law, low: f64, high: f64) -> Result<Marginal, (&'static str, String)> {
    let below = law.cdf(low);
    let mass = law.cdf(high) - below;
    if mass.is_nan() || mass < LEAST_MASS {
        let (low, high, mass) = (short(low), short(high), short(mass));
        let problem = format!(
            "the range from {low} to {high} holds a share of only {mass} of the distribution, and must hold {LEAST_MASS}"
        );
        return Err((kind, problem));
    }
    Ok(Marginal::Cut { low, high, law, below, mass })
}

/// A law of positive values has no range below 0.
fn from_zero(kind: &'static str, low: f64) -> Result<(), (&'static str, String)> {
    if low >= 0.0 { Ok(()) } else { Err((kind, format!("low must be from 0, found {}", short(low)))) }
}

/// Refuses what is no number, by the name of its field.
fn finite(kind: &'static str, field: &str, found: f64) -> Result<(), (&'static str, String)> {
    if found.is_finite() { Ok(()) } else { Err((kind, format!("{field} must be a finite number, found {found}"))) }
}

fn choice_of(choice: &Choice) -> Result<Marginal, (&'static str, String)> {
    let unusable = |problem: String| Err((".choice.values", problem));
    let values: Vec<f64> = choice.values.iter().map(|value| value.number()).collect();
    if values.is_empty() {
        return unusable("must have at least one value".to_owned());
    }
    if choice.values.windows(2).any(|pair| pair[0].kind() != pair[1].kind()) {
        return unusable("must be all numbers, all classes or all drivers".to_owned());
    }
    if let Some(value) = values.iter().find(|value| !value.is_finite()) {
        return unusable(format!("must be finite numbers, found {value}"));
    }
    let mut known = choice.values.iter().enumerate();
    if let Some((_, value)) = known.find(|(index, value)| choice.values.iter().take(*index).any(|v| v == *value)) {
        return unusable(format!("must differ, found {value} twice"));
    }
    let weights = choice.weights.clone().unwrap_or_else(|| vec![1.0; values.len()]);
    let unusable = |problem: String| Err((".choice.weights", problem));
    if weights.len() != values.len() {
        return unusable(format!("must be as many as values ({}), found {}", values.len(), weights.len()));
    }
    if let Some(weight) = weights.iter().find(|weight| !(**weight >= 0.0 && weight.is_finite())) {
        return unusable(format!("must be finite numbers from 0, found {weight}"));
    }
    let total: f64 = weights.iter().sum();
    if !(total > 0.0 && total.is_finite()) {
        return unusable(format!("must add up to a finite number above 0, found a sum of {}", short(total)));
    }
    Ok(Marginal::Choice { values, shares: weights.iter().map(|weight| weight / total).collect() })
}
