//! Reachability of a closed loop with a learned policy, from every initial state of a box.
//!
//! An ego vehicle drives behind a leader that brakes. A network decides the ego's acceleration. Behind the ego there
//! may be a follower with a latched emergency brake or a control law. A *reach* statement bisects a box of initial
//! states repeatedly. It claims that no member of some cells ever collides, and that other cells contain a member that
//! collides. The check derives these claims again from the network file and the cuts alone. [`form`] has affine forms,
//! and [`relax`] functions of them. [`controller`] bounds the network, with [`activation`] for its activation
//! functions. [`braking`], [`leader`] and [`propagate`] bound the vehicles. Uncertainty is always enlarged, never
//! dropped. Enclosures and their losses of tightness, with noise symbols as in [`form`]:
//!
//! - initial state: one symbol for each range, for the whole run; no loss;
//! - ReLU that may be active or not on [l, h]: a line plus an excess, for which there is a symbol until the output of
//!   the network is known; at most (h · -l)/(h - l);
//! - other activation functions: likewise, with a [line](activation) for each; second order in the width if smooth;
//! - tanh of the output: chord and its largest distance on either side; second order in the width;
//! - clipping of inputs and of the acceleration: two ReLUs; no loss while no member is clipped;
//! - rounding in single and double precision: bounds of each sum, from the weights; about 10⁻⁵ m/s²;
//! - leader with bounded braking: two symbols per decision interval; its observed acceleration is any allowed one at
//!   each decision;
//! - products (braking rate and time): product of the radii; second order;
//! - moving or standing: one set each, joined at each decision; some centimetres;
//! - follower with a law: the [law](follower), per step; second order in the width, more if its emergency brake may
//!   fire;
//! - firing instant of the follower: a propagation for each decision interval in which it may fire, with a symbol for
//!   the instant; a small loss;
//! - old noise symbols: merged in pairs ([order reduction](ego_set) of the zonotope); almost nothing;
//! - inside a decision interval of D steps h: the smaller gap at its ends less m (D h)²/8, for a relative acceleration
//!   of at most m; about 2 cm.
//!
//! # What is not covered
//! - The estimator: observations are within stated errors of the true state, at each decision anew and in any
//!   combination.
//! - Noise on accelerations, delays and lags: the vehicles have none.
//! - Agreement of the simulator with this semantics: tests compare the two.
//! - Agreement of an imported network with its source: an assumption; `crumple check --policy` reads the source again.
//! - Feasibility of commanded accelerations: the certificate holds no limits of the vehicle; crumple compares them when
//!   it creates the claim.
//! - Rounding of a simulator: motion is that of real numbers. Observation errors of 10⁻⁹ cover double precision within
//!   a kilometre of the origin, except if rounding decides which vehicle stands or brakes at an instant.

pub mod activation;
pub mod bounds;
pub mod braking;
mod claim;
pub mod controller;
pub mod ego_set;
#[cfg(test)]
mod fixtures;
pub mod follower;
pub mod form;
pub mod leader;
pub mod network_file;
pub mod policy_file;
pub mod propagate;
mod ranges;
pub mod relax;
pub mod safetensors;
mod volume;
pub mod window;

use crate::canonical::{is_sha256, sha256};
use crate::number::round_down;
use crate::rejection::Rejection;
pub use activation::Activation;
pub use claim::{PartitionCell, ReachClaim};
pub use controller::{
    ControllerInput, LinearLayer, NativePolicy, NetworkFileFormat, NetworkFileSource, NetworkLayer,
    NeuralController, OBSERVATION_SIZE,
};
pub use follower::{AccAebLaw, FollowerLaw, FollowerModel, IdmLaw};
pub use propagate::{ReachProblem, ReachTube, reach, reach_with_tube};
pub use ranges::{BoxDimension, InitialRanges};

/// Reason for which a collision is not excluded.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Undecided {
    /// A gap may close.
    #[error(
        "the gap {} the ego vehicle may be as small as {} m by step {step}",
        if *pair == 0 { "ahead of" } else { "behind" },
        round_down(*gap_m)
    )]
    MayCollide {
        /// 0 for the gap ahead, 1 for the one behind.
        pair: usize,
        /// Step by which it may close.
        step: u32,
        /// Proved lower bound of the gap, in metres.
        gap_m: f64,
    },
    /// The bounds have become too wide.
    #[error("bounds are too wide at step {step}")]
    TooWide {
        /// Step at which they became too wide.
        step: u32,
    },
    /// The follower may fire in too many intervals.
    #[error("there are too many cases at step {step}")]
    TooManySets {
        /// Step of the interval.
        step: u32,
    },
}

/// The result of the analysis of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachResult {
    /// Lower bounds of the gaps ahead and behind until the analysis ended, in metres.
    pub gaps_m: [f64; 2],
    /// Reason for which a collision is not excluded; `None` if it is.
    pub undecided: Option<Undecided>,
    /// True if every member surely collides.
    pub surely_collides: bool,
    /// Contribution of each dimension to the undecided gap, in metres.
    pub sensitivity: [f64; 8],
}

impl ReachResult {
    const INITIAL: Self = Self {
        gaps_m: [f64::INFINITY; 2],
        undecided: None,
        surely_collides: false,
        sensitivity: [0.0; 8],
    };
}

/// Loads the controller of a file and checks its digest and source.
pub(crate) fn load_controller(
    file: Option<&[u8]>,
    digest: &str,
    source: Option<&NetworkFileSource>,
) -> Result<NeuralController, Rejection> {
    let wrong = |problem: &str| Rejection::Policy {
        problem: problem.to_owned(),
    };
    let file = file.ok_or_else(|| wrong("is not there"))?;
    let actual = sha256(file);
    if actual != digest {
        return Err(Rejection::Policy {
            problem: format!("has SHA-256 {actual}, and `policy_sha256` is {digest}"),
        });
    }
    let controller =
        NeuralController::from_bytes(file).map_err(|problem| Rejection::Policy { problem })?;
    if controller.source.as_ref() == source {
        Ok(controller)
    } else {
        Err(wrong("was read from another file than `source`"))
    }
}

/// Returns the name of a controller file in the certificate's folder.
#[must_use]
pub fn controller_file_name(digest: &str, is_imported: bool) -> String {
    let kind = if is_imported { "network" } else { "policy" };
    format!(
        "{kind}-{}.safetensors",
        digest.get(..12).unwrap_or_default()
    )
}

/// Checks that the name of a network file follows from its digest.
pub(crate) fn check_policy_file_name(
    file: &str,
    digest: &str,
    is_from_outside: bool,
) -> Result<(), Rejection> {
    if is_sha256(digest) && file == controller_file_name(digest, is_from_outside) {
        Ok(())
    } else {
        Err(Rejection::invalid(
            "policy_file",
            "is not named after `policy_sha256`",
        ))
    }
}

/// Describes a network for the scope of a claim.
pub(crate) fn describe_network(digest: &str, source: Option<&NetworkFileSource>) -> String {
    let digest = digest.escape_debug();
    match source {
        None => format!("policy with SHA-256 {digest}"),
        Some(NetworkFileSource { format, sha256 }) => format!(
            "network with SHA-256 {digest}, read from a file in the format {} with SHA-256 {}",
            format.name(),
            sha256.escape_debug()
        ),
    }
}
