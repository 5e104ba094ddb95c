//! Why no space can be fitted.

use super::MAX_VEHICLES;
use super::family::FamilyFitError;
use crumple_world::scenario::space::InvalidSpace;

/// Why no space can be fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// More or fewer vehicles than can be fitted.
    #[error("vehicles: must be from 2 to {MAX_VEHICLES}, found {found}")]
    Vehicles {
        /// What was asked for.
        found: usize,
    },
    /// A threshold beyond which no braking is left.
    #[error("min_brake: must be below {limit} m/s², beyond which nothing is taken for braking, found {found}")]
    MinBrake {
        /// What was asked for, in m/s².
        found: f64,
        /// What it must be below, in m/s².
        limit: f64,
    },
    /// Too few episodes.
    #[error(
        "{found} episodes of {vehicles} vehicles, and {needed} are needed; {too_few_vehicles} have fewer vehicles, {out_of_range} have numbers that no \
         scenario of such a space may have{details}"
    )]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
        /// Vehicles of an episode.
        vehicles: usize,
        /// How many have fewer vehicles.
        too_few_vehicles: usize,
        /// How many are not described by the space.
        out_of_range: usize,
        /// By which number most of these, and what else there was, in words.
        details: String,
    },
    /// More than a space may keep.
    #[error("{found} {what}: at most {max} can be fitted")]
    TooMany {
        /// How many there are.
        found: usize,
        /// How many there may be.
        max: usize,
        /// Of what.
        what: &'static str,
    },
    /// A number that no family describes.
    #[error("{name}: {why}")]
    NoFamily {
        /// Its name.
        name: String,
        /// Why.
        why: FamilyFitError,
    },
    /// What was fitted is no space.
    #[error("what was fitted is no space: {0}")]
    Space(#[from] InvalidSpace),
}
