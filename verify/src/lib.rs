//! Checks crumple's proofs about traffic scenes, and uses no code of its simulator, search or solver.
//!
//! crumple simulates, searches and solves convex programs. It writes each conclusion to a file together with a proof.
//! This crate accepts or rejects the file, without random numbers. Modules in reading order: [`interval`], [`claim`],
//! [`motion`], [`avoidable`], [`unavoidable`], [`polynomial`], [`kernel`], [`rate`], [`reach`], [`invariant`],
//! [`certificate`], [`scope`], [`work`].
//!
//! # What is claimed
//! A leader moves as scripted. Behind it drive one or more *egos*, the vehicles under test. Behind them there may be a
//! follower with a latched emergency brake or, in *reach*, with a control law. Two vehicles collide if their gap is
//! zero or less at any time from instant 0 to instant N. A claim over intervals holds for every member: every initial
//! state, every acceleration within its bounds.
//!
//! - *Avoidable*: if the egos follow the stated profile, which is within their limits, no collision occurs.
//! - *Unavoidable*: every choice of ego accelerations within their limits leads to a collision.
//! - *Gap bound*: no such choice keeps every gap larger than stated.
//! - *Reach*: with the stated network, no initial state in the verified parts of the box leads to a collision. Instead
//!   of following a script, the leader may brake arbitrarily within a limit.
//! - *Invariant*: from every state of a set, the stated controller never collides with a leader within limits.
//! - *Kernel*, *rate*, *fails less often*: these concern no single scene; their modules state them.
//!
//! # What is assumed
//! The certificate must list its [`Assumption`]s. Numbers in the file are read as the nearest 64-bit floating-point
//! numbers. `crumple check`, not this crate, compares them with the scenario text in the file. Motion is that of real
//! numbers. A simulator rounds at each step by about 1e-13 m within a kilometre of its origin, and by 1e-10 m a
//! thousand kilometres from it. Beyond that, a reader must trust this crate, its compiler, and IEEE 754 arithmetic.
//!
//! # Checking by hand
//! A car at 20 m/s that can brake at 8 m/s² is 1 m behind a standing vehicle of 2 m; steps take 0.1 s. One condition of
//! an escape suffices: at instant 1 the car must be behind the bumper, x_1 - 1 ≤ 0. With multiplier 1 its left side is
//! the sum L of [`unavoidable`]. Full braking makes it smallest: L = 20 · 0.1 - 8 · 0.1² / 2 - 1 = 0.96. This is above
//! 0, so the collision is unavoidable.
//!
//! ```
//! let text = r#"{
//!     "version": 1,
//!     "provenance": {"crumple": "0.1.0", "scenario": "by hand", "scenario_sha256": ""},
//!     "assumptions": ["exact-motion", "scripted-leader", "ego-within-limits"],
//!     "statement": {"unavoidable": {
//!         "scene": {
//!             "step_s": 0.1, "steps": 10,
//!             "leader": {"position_m": 3, "length_m": 2, "speed_mps": 0, "acceleration_mps2": [[10, 0]]},
//!             "egos": [{"position_m": 0, "length_m": 2, "speed_mps": 20, "max_brake_mps2": 8, "max_accel_mps2": 3}],
//!             "follower": null
//!         },
//!         "branches": [{"first": 0, "last": 10, "front": [[1, 1]]}]
//!     }}
//! }"#;
//! let certificate = crumple_verify::Certificate::from_json(text)?;
//! match crumple_verify::check(&certificate) {
//!     Ok(crumple_verify::ProvedClaim::Unavoidable { overlap_m, .. }) => assert!((overlap_m - 0.96).abs() < 1e-12),
//!     other => panic!("{other:?}"),
//! }
//! # Ok::<(), crumple_verify::CertificateParseError>(())
//! ```

pub mod avoidable;
mod binding;
mod bounded;
mod canonical;
pub mod certificate;
pub mod claim;
pub mod interval;
pub mod invariant;
pub mod kernel;
pub mod motion;
pub mod polynomial;
pub mod rate;
pub mod reach;
pub mod scope;
pub mod unavoidable;
pub mod work;

pub use certificate::{
    Assumption, AvoidableClaim, Branch, Certificate, CertificateParseError, CertificateProvenance,
    GapBoundClaim, MultiplierRows, Statement, UnavoidableClaim,
};
pub use claim::{ConstantPiece, Scene, SceneEgo, SceneFollower, SceneLeader};
pub use interval::Interval;
pub use invariant::InvariantClaim;
pub use kernel::KernelClaim;
pub use rate::{ComparisonClaim, RateClaim, Registration};
pub use reach::ReachClaim;
pub use scope::Scope;
use work::OpBudget;
pub use work::WorkLimit;

/// A proved claim.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ProvedClaim {
    /// The stated profile leads to no collision.
    Avoidable {
        /// Lower bound of all gaps, in metres.
        min_gap_m: f64,
        /// Time from the start for which the bound holds, in seconds.
        horizon_s: f64,
        /// Safety after that time.
        after_horizon: SafetyAfterHorizon,
    },
    /// Every ego behaviour leads to a collision.
    Unavoidable {
        /// Lower bound of the overlap of two vehicles if they could pass through each other, in metres.
        overlap_m: f64,
        /// Time from the start within which it occurs, in seconds.
        horizon_s: f64,
    },
    /// Every ego behaviour makes some gap small.
    GapBound {
        /// Proved upper bound of the smallest gap, at most as large as stated, in metres.
        gap_m: f64,
        /// Time from the start within which it occurs, in seconds.
        horizon_s: f64,
    },
    /// The stated kernel is exactly the set of states from which a collision can be avoided.
    Kernel,
    /// A failure rate is bounded.
    Rate {
        /// Upper bound of the rate.
        max_rate: f64,
        /// Confidence level.
        confidence: f64,
    },
    /// The first of two controllers fails less often than the second.
    FailsLessOften {
        /// Confidence level.
        confidence: f64,
    },
    /// No initial state in the verified parts of a box leads to a collision.
    Reach {
        /// Verified share of the volume.
        verified_share: f64,
        /// Share of the cells with a member that is known to collide.
        falsified_share: f64,
        /// Lower bound of all gaps in the verified cells, in metres.
        min_gap_m: f64,
        /// Time from the start for which the bound holds, in seconds.
        horizon_s: f64,
        /// True if there is a follower.
        has_follower: bool,
        /// Limit within which the leader brakes arbitrarily, in m/s²; `None` for a scripted leader.
        leader_brakes_at_most_mps2: Option<f64>,
    },
    /// No state of a set ever leads to a collision.
    Invariant {
        /// Lower bound of the set's share of the region's volume.
        share: f64,
        /// Lower bound of all gaps, in metres.
        min_gap_m: f64,
        /// True if the own speed provably stays within the table; otherwise the claim ends if it leaves.
        own_speed_is_kept: bool,
    },
}

/// Safety after a stated profile has ended without a collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SafetyAfterHorizon {
    /// Every vehicle behind the leader can stop within the gap ahead: safe for any leader.
    ForAnyLeader,
    /// Every vehicle behind the leader can slow down to the slowest ahead: safe if the leader brakes no more.
    UnlessLeaderBrakes,
    /// Nothing is shown.
    Unproved,
}

impl SafetyAfterHorizon {
    /// Returns the name in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ForAnyLeader => "whatever-the-leader-does",
            Self::UnlessLeaderBrakes => "if-the-leader-does-not-brake",
            Self::Unproved => "not-shown",
        }
    }
}

impl std::fmt::Display for SafetyAfterHorizon {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::ForAnyLeader => {
                "and a collision remains avoidable afterwards, whatever the leader does"
            }
            Self::UnlessLeaderBrakes => {
                "and a collision remains avoidable afterwards, if the leader does not brake again"
            }
            Self::Unproved => "nothing is proved about the time afterwards",
        })
    }
}

impl std::fmt::Display for ProvedClaim {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Avoidable { min_gap_m: smallest_gap_m, horizon_s, after_horizon: afterwards } => write!(
                formatter,
                "avoidable: on the stated profile no gap is ever smaller than {} m for {horizon_s} s; \
                 {afterwards}",
                scope::round_down(*smallest_gap_m)
            ),
            Self::Unavoidable { overlap_m, horizon_s } => write!(
                formatter,
                "unavoidable: for every command, two vehicles would overlap by {} m or more within \
                 {horizon_s} s",
                scope::round_down(*overlap_m)
            ),
            Self::GapBound { gap_m, horizon_s } => {
                let gap_m = scope::round_up(*gap_m);
                write!(formatter, "gap bound: for every command, some gap is at most {gap_m} m within {horizon_s} s")
            }
            Self::Kernel => formatter.write_str(
                "kernel: full braking avoids a collision from every state in it, and no command does from \
                 any other state",
            ),
            Self::Rate { max_rate: at_most, confidence } => {
                let at_most = scope::round_up(*at_most);
                write!(formatter, "rate: at most {at_most} at confidence {confidence}, if its counts are right")
            }
            Self::FailsLessOften { confidence } => write!(
                formatter,
                "comparison: the first controller fails less often, at confidence {confidence}, if its counts are right"
            ),
            // Shares are lower bounds: rounded down.
            Self::Reach { verified_share, falsified_share, .. } if *verified_share <= 0.0 => write!(
                formatter,
                "reach: nothing is proved about any part of the box; {:.2} % of its volume is in cells with an \
                 initial state that ends in a collision",
                (1e4 * falsified_share).floor() / 1e2
            ),
            Self::Reach {
                verified_share,
                falsified_share,
                min_gap_m: smallest_gap_m,
                horizon_s,
                has_follower,
                leader_brakes_at_most_mps2: limit,
                ..
            } => write!(
                formatter,
                "reach: in {:.2} % of the box's volume no gap is ever smaller than {} m for {horizon_s} s, {}{}; {:.2} \
                 % of it is in cells with an initial state that ends in a collision",
                (1e4 * verified_share).floor() / 1e2,
                scope::round_down(*smallest_gap_m),
                limit.map_or_else(String::new, |limit| format!("however the leader brakes at up to {limit} m/s², ")),
                if *has_follower { "with a vehicle behind" } else { "with no vehicle behind" },
                (1e4 * falsified_share).floor() / 1e2
            ),
            Self::Invariant { share, min_gap_m, own_speed_is_kept } => write!(
                formatter,
                "invariant: from a set with {:.2} % of the region's volume, no gap is ever smaller than {} m{}",
                (1e4 * share).floor() / 1e2,
                scope::round_down(*min_gap_m),
                if *own_speed_is_kept { "" } else { ", until the own speed leaves its range" }
            ),
        }
    }
}

/// Reason for which a certificate proves nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// A field has an invalid value.
    #[error("`{field}` {problem}")]
    Invalid {
        /// Name of the field.
        field: String,
        /// Description of the problem.
        problem: &'static str,
    },
    /// The assumptions are not those that the statement needs.
    #[error("`assumptions` must be {needed:?}, and only noise-of-seed may be added")]
    Assumptions {
        /// Assumptions that the statement needs.
        needed: Vec<Assumption>,
    },
    /// Two vehicles may collide on the stated profile.
    #[error(
        "vehicle {front_vehicle} and its follower may collide in step {step}: only a gap of {gap_m} m is proved"
    )]
    MayCollide {
        /// Index of the vehicle ahead, 0 for the leader.
        front_vehicle: usize,
        /// Index of the step, from 0.
        step: u32,
        /// Proved lower bound of the gap, in metres.
        gap_m: f64,
    },
    /// The smallest gap is not proved to be as large as stated.
    #[error("`min_gap_m_at_least` is {stated_m}, and only {min_gap_m} m is proved")]
    GapTooSmall {
        /// Stated bound, in metres.
        stated_m: f64,
        /// Proved bound, in metres.
        min_gap_m: f64,
    },
    /// The branches do not cover the firing instants one after the other.
    #[error(
        "`branches[{branch}]` must begin where the previous one ends, and end no later than instant N"
    )]
    Tiling {
        /// Index of the branch.
        branch: usize,
    },
    /// The multipliers of a branch prove nothing.
    #[error("`branches[{branch}]` is not proved: its sum may be as low as {sum_m} m")]
    Unproved {
        /// Index of the branch.
        branch: usize,
        /// Lower bound of the sum, in metres.
        sum_m: f64,
    },
    /// No gap is proved to get as small as stated.
    #[error("`gap_m` is {stated_m}, and only {gap_m} m is proved")]
    GapBound {
        /// Stated gap, in metres.
        stated_m: f64,
        /// Proved gap, in metres.
        gap_m: f64,
    },
    /// The policy file is missing, is not the one of the claim, or is not usable.
    #[error("the policy file {problem}")]
    Policy {
        /// Description of the problem.
        problem: String,
    },
    /// The claim about a cell of a partition is not proved.
    #[error("leaf {leaf} of `partition`: {problem}")]
    Leaf {
        /// Index among the cells that are not cut.
        leaf: usize,
        /// Reason.
        problem: String,
    },
    /// A state of a set may leave it.
    #[error("cell {cell} of the set: a state may leave the set; {missing_m} m are missing")]
    LeavesSet {
        /// Index of the cell.
        cell: usize,
        /// Missing height, in metres.
        missing_m: f64,
    },
    /// Checking exceeds the operation limit: the claim stays undecided.
    #[error("the check takes more than the allowed {limit} operations")]
    BudgetExceeded {
        /// Allowed number of operations.
        limit: WorkLimit,
    },
    /// The observation, or a better one, is too probable if the claim is false.
    #[error(
        "the observed counts, or better ones, may have probability {} if the claim is false, and at most {} is allowed",
        scope::format_number(*tail_probability),
        scope::format_number(*max_tail_probability)
    )]
    NotSignificant {
        /// Upper bound of the probability.
        tail_probability: f64,
        /// 1 - confidence.
        max_tail_probability: f64,
    },
}

impl Rejection {
    fn invalid(field: impl Into<String>, problem: &'static str) -> Self {
        Self::Invalid {
            field: field.into(),
            problem,
        }
    }
}

/// Checks a certificate that needs no other file.
///
/// # Errors
/// [`Rejection`] if it does not prove its statement, or checking it exceeds the default limit.
pub fn check(certificate: &Certificate) -> Result<ProvedClaim, Rejection> {
    check_with(certificate, None, WorkLimit::default())
}

/// Checks a certificate with the bytes of its policy file and an operation limit.
///
/// # Errors
/// [`Rejection`] if it does not prove its statement, or checking it exceeds `limit`.
pub fn check_with(
    certificate: &Certificate,
    policy: Option<&[u8]>,
    limit: WorkLimit,
) -> Result<ProvedClaim, Rejection> {
    if !certificate.has_required_assumptions() {
        return Err(Rejection::Assumptions {
            needed: certificate.statement.assumptions(),
        });
    }
    if !certificate.is_first_version() {
        binding::check(certificate)?;
    }
    let work = &OpBudget::new(limit);
    match &certificate.statement {
        Statement::Avoidable(claim) => avoidable::check(claim, work),
        Statement::Unavoidable(claim) => unavoidable::check(claim, work),
        Statement::GapBound(claim) => unavoidable::check_gap_bound(claim, work),
        Statement::Kernel(claim) => kernel::check(claim, work),
        Statement::Rate(claim) => rate::check_rate(claim, work),
        Statement::Comparison(claim) => rate::check_comparison(claim, work),
        Statement::Reach(claim) => {
            reach::check(claim, policy, certificate.is_first_version(), work)
        }
        Statement::Invariant(claim) => invariant::check(claim, policy, work),
    }
}
