//! From recorded episodes to a search space that draws such episodes.
//!
//! [`Sample`] holds the numbers of each episode; [`FittedSpace`] is the space, with what was chosen and how well it fits. Each number has a
//! family of [`Family::ALL`], the one of the greatest likelihood: all have two parameters, so that Akaike's criterion and
//! Schwarz's agree. A value that is seen again and again, such as standstill, has a probability of its own beside; the size of vehicles is light
//! or heavy. What depends on what is a Gaussian copula. `refitted` does the same with other values, such as a resample.
//!
//! | module | what it holds |
//! |---|---|
//! | `minimum` | the minimum of a function of two numbers, and its curvature |
//! | `family` | a family, fitted |
//! | `goodness` | how well it fits |
//! | `marginal` | how one number is distributed |
//! | `dependence` | the correlations of a copula |
//! | `space` | the space of all that; whether a space is what is fitted to what it keeps |
//! | `sizes`, `episodes` | from recordings to numbers |
//! | `base` | the scenario in which they vary |
//! | `fitted` | from numbers to a space |
//! | `resample` | other numbers that could have been seen |

mod base;
mod dependence;
mod episodes;
mod error;
mod family;
mod fitted_space;
mod goodness;
mod marginal;
mod minimum;
mod resample;
mod sizes;
mod space;
#[cfg(test)]
mod tests;

pub use episodes::{EpisodeFeature, EpisodeSample, ExclusionCounts, ExtractionConfig, MAX_VEHICLES};
pub use error::FitError;
pub use family::{DistributionFamily, FamilyFit, FamilyFitError};
pub use fitted_space::{FittedFeature, FittedSize, FittedSpace, fit};
pub use goodness::{GoodnessOfFit, Tails, format_p_value};
pub use marginal::PointFit;
pub(crate) use resample::resample;
pub use sizes::VehicleSizes;
pub(crate) use space::{find_edit, refit};
