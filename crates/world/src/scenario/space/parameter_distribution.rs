//! A distribution by itself, in the parameter's unit, for whoever fits one.

use super::check::InvalidSpace;
use super::marginal::CoordinateMarginal;
use super::spec::DistributionSpec;

/// A distribution of numbers that is found to be valid.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterDistribution(CoordinateMarginal);

impl DistributionSpec {
    /// The distribution ready for use.
    ///
    /// # Errors
    /// [`InvalidSpace`] names the field that is wrong.
    pub fn build(&self) -> Result<ParameterDistribution, InvalidSpace> {
        let wrong = |(field, problem)| InvalidSpace::new(format!("distribution{field}"), problem);
        self.marginal().map(ParameterDistribution).map_err(wrong)
    }
}

impl ParameterDistribution {
    /// The share of the distribution up to a value.
    #[must_use]
    pub fn cdf(&self, value: f64) -> f64 {
        self.0.cdf_of_value(value)
    }

    /// The value below which a share of it lies.
    #[must_use]
    pub fn quantile(&self, share: f64) -> f64 {
        self.0.value(self.0.quantile(share))
    }

    /// How much of the law, before it was cut, lies within its range; 1 where nothing is cut.
    #[must_use]
    pub fn truncation_mass(&self) -> f64 {
        match &self.0 {
            CoordinateMarginal::Truncated { mass, .. } => *mass,
            CoordinateMarginal::PointMass { others, .. } => Self((**others).clone()).truncation_mass(),
            _ => 1.0,
        }
    }
}
