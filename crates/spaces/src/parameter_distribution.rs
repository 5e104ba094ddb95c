//! Distributions of a parameter, in its unit, for fitting.

use super::invalid::InvalidSpace;
use super::marginal::CoordinateMarginal;
use super::spec::DistributionSpec;

/// A validated distribution of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterDistribution(CoordinateMarginal);

impl DistributionSpec {
    /// Validates the distribution.
    ///
    /// # Errors
    /// [`InvalidSpace`] names the invalid field.
    pub fn build(&self) -> Result<ParameterDistribution, InvalidSpace> {
        self.marginal()
            .map(ParameterDistribution)
            .map_err(|invalid| invalid.within("distribution"))
    }
}

impl ParameterDistribution {
    /// Returns the CDF at a value.
    #[must_use]
    pub fn cdf(&self, value: f64) -> f64 {
        self.0.cdf_of_value(value)
    }

    /// Returns the value at a CDF value.
    #[must_use]
    pub fn quantile(&self, share: f64) -> f64 {
        self.0.value(self.0.quantile(share))
    }

    /// Returns the probability mass within the range before truncation; 1 without truncation.
    #[must_use]
    pub fn truncation_mass(&self) -> f64 {
        match &self.0 {
            CoordinateMarginal::Truncated { mass, .. } => *mass,
            CoordinateMarginal::PointMass { others, .. } => {
                Self((**others).clone()).truncation_mass()
            }
            _ => 1.0,
        }
    }
}
