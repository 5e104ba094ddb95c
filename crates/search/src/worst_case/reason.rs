//! Why a question has no answer.

use serde::Serialize;

/// Why neither an escape nor a proof was reached.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum UndecidedReason {
    /// The leader reacts to other vehicles.
    #[error("vehicle 0 does not follow a script")]
    Leader,
    /// Who is ahead of whom changes.
    #[error("vehicles enter or leave the lane, which the programs do not model")]
    LaneChanges,
    /// No vehicle is under test behind the leader, or those that are do not follow each other.
    #[error("the vehicles under test are not those directly behind the leader")]
    NoEgo,
    /// The vehicle behind those under test is not driven by the latched emergency brake.
    #[error(
        "vehicle {vehicle} is driven by {driver}, and only a latched emergency brake without lag is modelled there"
    )]
    Follower {
        /// Its index.
        vehicle: usize,
        /// What drives it.
        driver: &'static str,
    },
    /// The scenario cannot be written down, and a certificate holds its hash.
    #[error("the scenario cannot be written as TOML: {why}")]
    Unwritable {
        /// Why.
        why: String,
    },
    /// The escape that was found makes a vehicle collide that is not modelled.
    #[error("vehicle {vehicle} and those behind it are not modelled")]
    BehindFollower {
        /// The first of them.
        vehicle: usize,
    },
    /// A vehicle under test that does not do at once what it wants: one that did might escape, and whether this one does is open.
    #[error("what decides is how late or sluggishly vehicle {vehicle} answers, which is not modelled")]
    EgoResponse {
        /// Its index.
        vehicle: usize,
    },
    /// More vehicles under test than the checker reads.
    #[error("{egos} vehicles under test are too many for a certificate, which holds {most} at most")]
    TooManyVehicles {
        /// How many there are.
        egos: usize,
        /// How many there may be.
        most: usize,
    },
    /// Noise on an acceleration that a proof would have to bound.
    #[error("the acceleration of vehicle {vehicle} is noisy, and no proof covers that")]
    Noise {
        /// Its index.
        vehicle: usize,
    },
    /// The two answers are closer together than the arithmetic.
    #[error("{}", describe_undecided_gap(*low_m, *high_m))]
    TooClose {
        /// What was reached, in metres.
        low_m: f64,
        /// What cannot be exceeded, in metres.
        high_m: f64,
    },
    /// An escape of the model that the simulation does not confirm.
    #[error("an escape was found, but vehicles touch when it is replayed")]
    Replay,
    /// A proof that the checker does not accept.
    #[error("a proof was found, but the checker rejects it: {why}")]
    Rejected {
        /// What the checker says.
        why: String,
    },
    /// The solver gave up on a program.
    #[error("the solver could not solve a program: {status}")]
    Solver {
        /// What it says.
        status: String,
    },
}

fn describe_undecided_gap(low_m: f64, high_m: f64) -> String {
    if low_m.is_finite() {
        format!("the best smallest gap lies between {low_m:.6} and {high_m:.6} m, which decides nothing")
    } else {
        format!("no escape was found, and all that is proved is that nobody keeps more than {high_m:.6} m")
    }
}

impl UndecidedReason {
    /// Whether it is that the programs do not model who drives: an escape may be found without them.
    pub(super) fn is_not_modelled(&self) -> bool {
        matches!(self, Self::Leader | Self::LaneChanges | Self::Follower { .. } | Self::BehindFollower { .. })
    }
}
