//! Fit of a scenario space to recorded braking episodes.
//!
//! [`EpisodeSample`] holds the features of each episode, [`FittedSpace`] the space with its goodness of fit. Each
//! feature has the most likely family of [`DistributionFamily::ALL`]; all have two parameters, so AIC and BIC would
//! choose the same family. A frequent value such as standstill has a point mass. The size of a vehicle is one of two
//! values, light or heavy. A Gaussian copula describes the dependence.

mod base;
mod dependence;
mod episodes;
mod error;
mod exclusions;
mod family;
mod fitted_space;
mod goodness;
mod marginal;
mod minimum;
mod report;
mod resample;
mod sizes;
mod space;
#[cfg(test)]
mod tests;

pub use episodes::{
    EpisodeCollector, EpisodeFeature, EpisodeSample, ExtractionConfig, MAX_VEHICLES,
};
pub use error::FitError;
pub use exclusions::ExclusionCounts;
pub use family::{DistributionFamily, FamilyFit, FamilyFitError};
pub use fitted_space::{FitOptions, FittedFeature, FittedSize, FittedSpace, fit};
pub use goodness::{GoodnessOfFit, MIN_P_VALUE, Tails, format_p_value};
pub use marginal::PointFit;
pub use report::FitReport;
pub(crate) use resample::resample;
pub use sizes::VehicleSizes;
pub(crate) use space::{find_edit, refit};
