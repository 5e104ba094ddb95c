//! Reasons for an undecided result.

use std::borrow::Cow;

use crumple_core::digits::{format_fixed_down, format_fixed_up};
use serde::{Deserialize, Serialize};

/// Reason why neither an escape nor a proof was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum UndecidedReason {
    /// The leader is not scripted.
    #[error("vehicle 0 does not follow a script")]
    Leader,
    /// The order of vehicles changes.
    #[error("vehicles enter or leave the lane, which the programs do not model")]
    LaneChanges,
    /// A vehicle is not a point mass.
    #[error("a vehicle has the plant `multi-body`, and the programs model only `point-mass`")]
    Plant,
    /// No vehicle under test is behind the leader, or they are not neighbours.
    #[error("the vehicles under test are not those directly behind the leader")]
    NoEgo,
    /// The vehicle behind those under test has another driver than the latched emergency brake.
    #[error(
        "the controller of vehicle {vehicle} is {driver}, and the programs model only a latched emergency brake \
         without lag there"
    )]
    Follower {
        /// Index of the vehicle.
        vehicle: usize,
        /// Name of its driver.
        driver: Cow<'static, str>,
    },
    /// The scenario has no TOML form, whose hash a certificate contains.
    #[error("the scenario cannot be written as TOML: {why}")]
    Unwritable {
        /// Cause of the error.
        why: String,
    },
    /// An unmodelled vehicle collides in the escape that was found.
    #[error("vehicle {vehicle} and those behind it are not modelled")]
    BehindFollower {
        /// Index of the first unmodelled vehicle.
        vehicle: usize,
    },
    /// A vehicle under test does not execute commands at once; if it did, it might escape.
    #[error("the result depends on the delay or lag of vehicle {vehicle}, which is not modelled")]
    EgoResponse {
        /// Index of the vehicle.
        vehicle: usize,
    },
    /// More vehicles under test than the checker accepts.
    #[error("{egos} vehicles under test are too many for a certificate: it holds {most} at most")]
    TooManyVehicles {
        /// Number of vehicles under test.
        egos: usize,
        /// Maximum number.
        most: usize,
    },
    /// Noise on an acceleration, which a proof would have to bound.
    #[error("the acceleration of vehicle {vehicle} is noisy, which no proof covers")]
    Noise {
        /// Index of the vehicle.
        vehicle: usize,
    },
    /// The lower and upper bounds are closer than the accuracy of the arithmetic.
    #[error("{}", describe_undecided_gap(*low_m, *high_m))]
    TooClose {
        /// Smallest gap that was reached, in metres; `None` without an escape.
        low_m: Option<f64>,
        /// Upper bound of the smallest gap, in metres.
        high_m: f64,
    },
    /// The simulation does not confirm an escape of the model.
    #[error("an escape was found, but its replay has a collision")]
    Replay,
    /// The checker rejects a proof.
    #[error("a proof was found, but the checker rejects it: {why}")]
    Rejected {
        /// Message of the checker.
        why: String,
    },
    /// The scenario was not analysed.
    #[error("{why}")]
    NotAnalysed {
        /// Message of the error.
        why: String,
    },
    /// The solver failed.
    #[error("the solver could not solve a program: {status}")]
    Solver {
        /// Status of the solver.
        status: String,
    },
}

fn describe_undecided_gap(low_m: Option<f64>, high_m: f64) -> String {
    let high = format_fixed_up(high_m, 6);
    if let Some(low_m) = low_m {
        let low = format_fixed_down(low_m, 6);
        format!(
            "the best motion of the ego vehicle keeps a smallest gap between {low} and {high} m, so an escape is \
             neither shown nor excluded"
        )
    } else {
        format!(
            "no escape was found, and the proof shows only that no controller keeps more than {high} m"
        )
    }
}

impl UndecidedReason {
    /// Returns true if the programs do not model a driver: an escape may be found without them.
    pub(super) fn is_not_modelled(&self) -> bool {
        matches!(
            self,
            Self::Leader | Self::LaneChanges | Self::Follower { .. } | Self::BehindFollower { .. }
        )
    }
}
