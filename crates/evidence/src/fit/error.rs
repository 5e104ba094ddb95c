//! Reasons why a space cannot be fitted.

use super::MAX_VEHICLES;
use super::family::FamilyFitError;
use crumple_spaces::InvalidSpace;

/// Reason why a space cannot be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// The number of vehicles is out of range.
    #[error("vehicles: must be from 2 to {MAX_VEHICLES}, found {found}")]
    Vehicles {
        /// Requested number.
        found: usize,
    },
    /// The threshold leaves no braking.
    #[error(
        "the deceleration of braking must be above 0 and below {limit} m/s², because recordings with harder \
         decelerations are not trusted, found {found}"
    )]
    MinBrake {
        /// Requested threshold, in m/s².
        found: f64,
        /// Exclusive upper limit, in m/s².
        limit: f64,
    },
    /// Too few episodes.
    #[error(
        "found {found} episodes of {vehicles} vehicles, and {needed} are needed; {too_few_vehicles} have fewer \
         vehicles, {out_of_range} have values outside the ranges of a space{details}"
    )]
    TooFew {
        /// Number of episodes.
        found: usize,
        /// Required number of episodes.
        needed: usize,
        /// Number of vehicles per episode.
        vehicles: usize,
        /// Number of episodes with too few vehicles.
        too_few_vehicles: usize,
        /// Number of episodes with a feature outside its range.
        out_of_range: usize,
        /// Further details: the feature of most of these, and other exclusions.
        details: String,
    },
    /// More data than a space may hold.
    #[error("{found} {what}: at most {max} can be fitted")]
    TooMany {
        /// Number that was found.
        found: usize,
        /// Maximum number.
        max: usize,
        /// Kind of the data.
        what: &'static str,
    },
    /// No family describes a feature.
    #[error("{name}: {why}")]
    NoFamily {
        /// Name of the feature.
        name: String,
        /// Reason of the failure.
        why: FamilyFitError,
    },
    /// No family describes the values of a feature beside those of its point mass.
    #[error(
        "{name}: {count} of {all} values are {at}, and a distribution of the others needs two different ones: {why}"
    )]
    NoFamilyBesidePoint {
        /// Name of the feature.
        name: String,
        /// Value of the point mass.
        at: f64,
        /// Number of episodes with this value.
        count: u64,
        /// Number of episodes.
        all: usize,
        /// Reason of the failure, for the other values.
        why: FamilyFitError,
    },
    /// The fitted space is invalid.
    #[error("the fitted space is invalid: {0}")]
    Space(#[from] InvalidSpace),
}
