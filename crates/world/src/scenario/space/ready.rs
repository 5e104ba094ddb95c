//! A distribution by itself, in the parameter's unit, for whoever fits one.

use super::check::InvalidSpace;
use super::marginal::Marginal;
use super::spec::Distribution;

/// A distribution of numbers that is found to be valid.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadyDistribution(Marginal);

impl Distribution {
    /// The distribution ready for use.
    ///
    /// # Errors
    /// [`InvalidSpace`] names the field that is wrong.
    pub fn ready(&self) -> Result<ReadyDistribution, InvalidSpace> {
        let wrong = |(field, problem)| InvalidSpace::new(format!("distribution{field}"), problem);
        self.marginal().map(ReadyDistribution).map_err(wrong)
    }
}

impl ReadyDistribution {
    /// The share of the distribution up to a value.
    #[must_use]
    pub fn share_below(&self, value: f64) -> f64 {
        self.0.share_up_to(value)
    }

    /// The value below which a share of it lies.
    #[must_use]
    pub fn quantile(&self, share: f64) -> f64 {
        self.0.value(self.0.quantile(share))
    }

    /// How much of the law, before it was cut, lies within its range; 1 where nothing is cut.
    #[must_use]
    pub fn mass(&self) -> f64 {
        match &self.0 {
            Marginal::Cut { mass, .. } => *mass,
            Marginal::PointMass { others, .. } => Self((**others).clone()).mass(),
            _ => 1.0,
        }
    }
}
