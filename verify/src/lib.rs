//! Checks crumple's proofs about traffic scenes, and uses no code of its simulator, search or solver.
//!
//! crumple simulates, searches and solves convex programs. It writes each conclusion to a file together with a proof.
//! This crate accepts or rejects the file, without random numbers. Modules in reading order: [`interval`], [`claim`],
//! [`motion`], [`avoidable`], [`unavoidable`], [`gap_bound`], [`polynomial`], [`kernel`], [`registration`], [`rate`],
//! [`comparison`], [`reach`], [`invariant`], [`two_sided`], [`assumption`], [`certificate`], [`scope`], [`work`],
//! [`pool`]. Each kind of claim is a variant of [`Statement`], and has a file.
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
//! - *Two-sided*: a filter, or the plan of one run, avoids any leader within limits and any follower of a class.
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

pub mod assumption;
pub mod avoidable;
mod binding;
mod bounded;
mod canonical;
pub mod certificate;
pub mod claim;
pub mod comparison;
pub mod gap_bound;
pub mod interval;
pub mod invariant;
pub mod kernel;
pub mod motion;
mod number;
pub mod polynomial;
pub mod pool;
pub mod rate;
pub mod reach;
pub mod registration;
pub mod rejection;
pub mod scope;
pub mod two_sided;
pub mod unavoidable;
pub mod work;

use serde::{Deserialize, Serialize};

pub use assumption::Assumption;
pub use avoidable::{AvoidableClaim, SafetyAfterHorizon};
pub use certificate::{Certificate, CertificateParseError, CertificateProvenance};
pub use claim::{ConstantPiece, Scene, SceneEgo, SceneFollower, SceneLeader};
pub use comparison::ComparisonClaim;
pub use gap_bound::GapBoundClaim;
pub use interval::Interval;
pub use invariant::InvariantClaim;
pub use kernel::KernelClaim;
pub use pool::{Pool, PoolRejection, PooledRate};
pub use rate::RateClaim;
pub use reach::ReachClaim;
pub use registration::Registration;
pub use rejection::Rejection;
pub use scope::Scope;
pub use two_sided::TwoSidedClaim;
pub use unavoidable::{Branch, MultiplierRows, UnavoidableClaim};
pub use work::WorkLimit;

use number::{round_down, round_up};
use registration::CertifiedBlock;
use work::OpBudget;

/// A claim with its proof: one variant for each kind of claim. The type of a variant states all that is particular to
/// the kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Statement {
    /// One profile of ego accelerations avoids a collision.
    Avoidable(AvoidableClaim),
    /// No profile of ego accelerations avoids a collision.
    Unavoidable(UnavoidableClaim),
    /// No profile of ego accelerations keeps every gap larger than stated.
    GapBound(GapBoundClaim),
    /// From exactly these states a collision can be avoided.
    Kernel(KernelClaim),
    /// A bound of a controller's failure rate.
    Rate(RateClaim),
    /// One controller fails less often than another.
    Comparison(ComparisonClaim),
    /// A policy avoids collisions from parts of a box.
    Reach(ReachClaim),
    /// A controller keeps a set of states, in which it never collides.
    Invariant(Box<InvariantClaim>),
    /// A filter, or a plan in one run, avoids collisions with the leader and with a follower of a class.
    TwoSided(Box<TwoSidedClaim>),
}

impl Statement {
    fn claim(&self) -> &dyn Claim {
        match self {
            Self::Avoidable(claim) => claim,
            Self::Unavoidable(claim) => claim,
            Self::GapBound(claim) => claim,
            Self::Kernel(claim) => claim,
            Self::Rate(claim) => claim,
            Self::Comparison(claim) => claim,
            Self::Reach(claim) => claim,
            Self::Invariant(claim) => &**claim,
            Self::TwoSided(claim) => &**claim,
        }
    }

    /// Returns the name in a file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.claim().name()
    }

    /// Returns the subject.
    #[must_use]
    pub fn subject(&self) -> ClaimSubject<'_> {
        self.claim().subject()
    }

    /// Returns the scene of the statement, if it has one.
    #[must_use]
    pub fn scene(&self) -> Option<&Scene> {
        match self.subject() {
            ClaimSubject::Scene { scene, .. } => Some(scene),
            _ => None,
        }
    }

    /// Returns the assumptions of the statement.
    #[must_use]
    pub fn assumptions(&self) -> Vec<Assumption> {
        self.claim().assumptions()
    }

    /// Returns the counts and the hash of each block of runs, in order; `None` if the claim counts nothing.
    #[must_use]
    pub fn counted_blocks(&self) -> Option<Vec<CertifiedBlock<[u64; 2]>>> {
        self.claim().counted_blocks()
    }
}

/// One kind of claim, with its proof.
trait Claim {
    /// Returns the name in a file: that of the variant of [`Statement`].
    fn name(&self) -> &'static str;

    /// Returns the subject, which decides what texts a certificate must contain.
    fn subject(&self) -> ClaimSubject<'_>;

    /// Returns the assumptions, in the order of their definition.
    fn assumptions(&self) -> Vec<Assumption>;

    /// Returns the scope, without a description of the subject.
    fn scope(&self) -> Scope;

    /// Checks fields that version 2 requires and the proof does not use.
    fn check_fields(&self, _provenance: &CertificateProvenance) -> Result<(), Rejection> {
        Ok(())
    }

    /// Checks the proof.
    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection>;

    /// Returns the failures of the first and second controller, and the hash, of each block of runs.
    fn counted_blocks(&self) -> Option<Vec<CertifiedBlock<[u64; 2]>>> {
        None
    }
}

/// Input of the check of a proof, besides the claim.
struct CheckInput<'a> {
    /// Content of the policy file.
    policy: Option<&'a [u8]>,
    is_first_version: bool,
    work: &'a OpBudget,
}

/// The subject of a claim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClaimSubject<'a> {
    /// Any two vehicles with the stated limits. The certificate contains no text.
    AnyVehicles,
    /// A vehicle between any leader and any follower with the stated limits. The certificate contains no text.
    AnyNeighbours,
    /// A scene, which a scenario describes.
    Scene {
        /// The scene.
        scene: &'a Scene,
        /// Accelerations of each ego, for a claim about one profile; `None` for a claim about every profile.
        profile: Option<&'a [Vec<ConstantPiece<f64>>]>,
    },
    /// A box of initial states around a scenario.
    InitialStates(&'a ReachClaim),
    /// A region of states, with the limits of a scenario.
    Region(&'a InvariantClaim),
    /// Runs in a scenario space.
    Runs(&'a Registration),
}

/// A proved claim, one variant for each kind.
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
        /// Upper bound of the rate; 1 if the counts show none.
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
    /// No collision with the leader or with a follower of a class.
    TwoSided {
        /// The class; `None` without a follower.
        follower: Option<two_sided::CoveredFollowers>,
        /// Limit of the leader's braking, in m/s².
        leader_brakes_at_most_mps2: f64,
        /// True for the plan of one run, false for a filter.
        is_one_run: bool,
    },
}

impl std::fmt::Display for ProvedClaim {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Avoidable { min_gap_m: smallest_gap_m, horizon_s, after_horizon: afterwards } => write!(
                formatter,
                "avoidable: on the stated profile no gap is ever smaller than {} m for {horizon_s} s; \
                 {afterwards}",
                round_down(*smallest_gap_m)
            ),
            Self::Unavoidable { overlap_m, horizon_s } => write!(
                formatter,
                "unavoidable: for every command, two vehicles would overlap by {} m or more within \
                 {horizon_s} s",
                round_down(*overlap_m)
            ),
            Self::GapBound { gap_m, horizon_s } => {
                let gap_m = round_up(*gap_m);
                write!(formatter, "gap bound: for every command, some gap is at most {gap_m} m within {horizon_s} s")
            }
            Self::Kernel => formatter.write_str(
                "kernel: full braking avoids a collision from every state in it, and no command does from \
                 any other state",
            ),
            Self::Rate { max_rate, confidence } => {
                let bound = rate::describe_bound(*max_rate);
                write!(formatter, "rate: {bound} at confidence {confidence}, if its counts are right")
            }
            Self::FailsLessOften { confidence } => write!(
                formatter,
                "comparison: the first controller fails less often, at confidence {confidence}, if its counts are right"
            ),
            // Shares are lower bounds: rounded down.
            Self::Reach { verified_share, falsified_share, .. } if *verified_share <= 0.0 => write!(
                formatter,
                "reach: nothing is proved about any part of the box; cells of the box that contain an initial state \
                 with a collision make up {:.2} % of its volume",
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
                "reach: in {:.2} % of the box's volume no gap is ever smaller than {} m for {horizon_s} s, {}{}; cells \
                 of the box that contain an initial state with a collision make up {:.2} % of its volume",
                (1e4 * verified_share).floor() / 1e2,
                round_down(*smallest_gap_m),
                limit.map_or_else(String::new, |limit| format!("however the leader brakes at up to {limit} m/s², ")),
                if *has_follower { "with a vehicle behind" } else { "with no vehicle behind" },
                (1e4 * falsified_share).floor() / 1e2
            ),
            Self::Invariant { share, min_gap_m, own_speed_is_kept } => write!(
                formatter,
                "invariant: from a set with {:.2} % of the region's volume, no gap is ever smaller than {} m{}",
                (1e4 * share).floor() / 1e2,
                round_down(*min_gap_m),
                if *own_speed_is_kept { "" } else { ", until the own speed leaves its range" }
            ),
            Self::TwoSided { follower, leader_brakes_at_most_mps2, is_one_run } => formatter.write_str(
                &two_sided::describe_proved(follower.as_ref(), *leader_brakes_at_most_mps2, *is_one_run),
            ),
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
    certificate.statement.claim().check(&CheckInput {
        policy,
        is_first_version: certificate.is_first_version(),
        work: &OpBudget::new(limit),
    })
}
