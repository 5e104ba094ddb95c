//! Checks what crumple claims to have proved about a traffic scene, sharing no code with it.
//!
//! crumple simulates, searches and solves convex programs. What it concludes is written to a file together with a proof, and
//! this crate accepts or rejects the file. It depends on no simulator, solver or random number. Read it in this order:
//!
//! 1. [`interval`]: numbers that are never wrong, only wide;
//! 2. [`claim`]: what a scene is; [`motion`]: where its vehicles are;
//! 3. [`avoidable`]: a profile is replayed, and nobody touches;
//! 4. [`unavoidable`]: whatever is done, somebody touches;
//! 5. [`kernel`]: from which states contact can be avoided for ever; [`polynomial`] is its arithmetic;
//! 6. [`rate`]: what counted failures show;
//! 7. [`reach`]: where a learned policy, or a network from outside, can take a whole box of starts;
//! 8. [`cruise`]: the same of a public benchmark with other dynamics;
//! 9. [`certificate`]: the file; [`scope`]: how far what it says reaches; [`work`]: how long it may keep the checker busy.
//!
//! # What is claimed
//! A leader moves as scripted. Behind it drive one or more *egos*, the vehicles under test; behind them, perhaps, a follower
//! with a latched emergency brake, or, in *reach*, one that follows by a law. Two vehicles touch when the gap between them is zero or less at any time from instant 0
//! to instant N. A claim over intervals holds for every member: every start, every acceleration within its bounds.
//!
//! - *Avoidable*: if the egos follow the stated profile, which is within their limits, nobody touches.
//! - *Unavoidable*: for no accelerations of the egos within their limits, however they are decided, does nobody touch.
//! - *Gap bound*: for no such accelerations does every gap stay larger than stated.
//! - *Reach*: driven by the stated network, nobody touches from any start in the parts of the box marked so; instead of a script, the
//!   leader may brake anyhow within a limit there.
//! - *Adaptive cruise*: in a public benchmark the stated network keeps its distance.
//! - *Kernel*, *rate*, *fails less often*: about no one scene; said where they are checked.
//!
//! # What is assumed
//! What the certificate lists as [`Assumption`]s, and has to list. The numbers are those in the file, read as the nearest
//! 64-bit floating-point numbers; that they describe the scenario whose text is in the file is not checked here, but by `crumple
//! check`. Motion is that of real numbers: a simulator rounds, at each step by about 1e-13 m within a kilometre of its origin and by
//! 1e-10 m a thousand kilometres from it. The rest is trust in this crate, its compiler, and IEEE 754 arithmetic.
//!
//! # Checking by hand
//! A car at 20 m/s that can brake at 8 m/s², 1 m behind a standing vehicle of 2 m, steps of 0.1 s. One row says it all: at
//! instant 1 the car must be behind the bumper, x_1 ≤ 1. With multiplier 1 on it q falls from 0.1 to 0, never below, so the
//! sum is least for full braking: L = 20 · 0.1 - 8 · 0.1² / 2 - 1 = 0.96 > 0. Nobody could have avoided it.
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
//!     Ok(crumple_verify::Accepted::Unavoidable { overlap_m, .. }) => assert!((overlap_m - 0.96).abs() < 1e-12),
//!     other => panic!("{other:?}"),
//! }
//! # Ok::<(), crumple_verify::ParseError>(())
//! ```

pub mod avoidable;
mod binding;
mod bounded;
mod canonical;
pub mod certificate;
pub mod claim;
pub mod cruise;
pub mod interval;
pub mod kernel;
pub mod motion;
pub mod polynomial;
pub mod rate;
pub mod reach;
pub mod scope;
pub mod unavoidable;
pub mod work;

pub use certificate::{
    Assumption, AvoidableClaim, Branch, Certificate, CertificateParseError, CertificateProvenance, GapBoundClaim,
    MultiplierRows, Statement, UnavoidableClaim,
};
pub use claim::{ConstantPiece, Scene, SceneEgo, SceneFollower, SceneLeader};
pub use cruise::CruiseClaim;
pub use interval::Interval;
pub use kernel::KernelClaim;
pub use rate::{ComparisonClaim, RateClaim, Registration};
pub use reach::ReachClaim;
pub use scope::Scope;
use work::OpBudget;
pub use work::WorkLimit;

/// What has been proved.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ProvedClaim {
    /// With the stated profile nobody touches.
    Avoidable {
        /// No gap is ever smaller, in metres...
        min_gap_m: f64,
        /// ... within this time from the start, in seconds.
        horizon_s: f64,
        /// What holds after that.
        after_horizon: SafetyAfterHorizon,
    },
    /// Whatever the egos do, somebody touches.
    Unavoidable {
        /// Whatever they do, two vehicles would overlap by at least this if they could, in metres...
        overlap_m: f64,
        /// ... within this time from the start, in seconds.
        horizon_s: f64,
    },
    /// Whatever the egos do, some gap gets small.
    GapBound {
        /// As small as this at least, in metres: what is proved, and no more than stated...
        gap_m: f64,
        /// ... within this time from the start, in seconds.
        horizon_s: f64,
    },
    /// The stated kernel is exactly the set of states that can be kept free of contact.
    Kernel,
    /// A failure rate is bounded.
    Rate {
        /// The bound.
        max_rate: f64,
        /// Its confidence.
        confidence: f64,
    },
    /// The first of two controllers fails less often than the second.
    FailsLessOften {
        /// With this confidence.
        confidence: f64,
    },
    /// From every start in parts of a box nobody touches.
    Reach {
        /// Their share of its volume.
        verified_share: f64,
        /// Share of the cells of which a member is known to touch.
        falsified_share: f64,
        /// No gap is ever smaller in the verified ones, in metres...
        min_gap_m: f64,
        /// ... within this time from the start, in seconds.
        horizon_s: f64,
        /// Whether somebody drives behind.
        has_follower: bool,
        /// The limit within which the leader brakes as it likes, in m/s²; none if it brakes as scripted.
        leader_brakes_at_most_mps2: Option<f64>,
        /// The law from which the policy departs, if it does.
        residual_over: Option<reach::ResidualPolicy>,
    },
    /// From every start of the benchmark of adaptive cruise control the distance is kept.
    Cruise {
        /// D_rel - 10 - 1.4 v_ego is never smaller, in metres, for 5 s.
        margin_m: f64,
        /// All x_ego at the end lie in an interval of this width, in metres.
        x_ego_width_m: f64,
    },
}

/// What holds once the stated profile has ended without contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SafetyAfterHorizon {
    /// Everybody behind the leader can stop within the gap ahead: nobody need ever touch, whatever the leader does.
    ForAnyLeader,
    /// Everybody behind the leader can slow down to the slowest ahead: nobody need ever touch if the leader does not brake any more.
    UnlessLeaderBrakes,
    /// Nothing is shown.
    Unproved,
}

impl SafetyAfterHorizon {
    /// Its name in results.
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
            Self::ForAnyLeader => "and nobody need touch afterwards, whatever the leader does",
            Self::UnlessLeaderBrakes => "and nobody need touch afterwards, if the leader does not brake any more",
            Self::Unproved => "nothing is shown of what comes afterwards",
        })
    }
}

impl std::fmt::Display for ProvedClaim {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Avoidable { min_gap_m: smallest_gap_m, horizon_s, after_horizon: afterwards } => write!(
                formatter,
                "avoidable: on the stated profile no gap is ever smaller than {smallest_gap_m} m for {horizon_s} s; {afterwards}"
            ),
            Self::Unavoidable { overlap_m, horizon_s } => write!(
                formatter,
                "unavoidable: whatever is done, two vehicles would overlap by {overlap_m} m or more within {horizon_s} s"
            ),
            Self::GapBound { gap_m, horizon_s } => write!(
                formatter,
                "gap bound: whatever is done, some gap gets as small as {gap_m} m within {horizon_s} s"
            ),
            Self::Kernel => formatter
                .write_str("kernel: full braking keeps every state of it free of contact, and nothing any other"),
            Self::Rate { max_rate: at_most, confidence } => {
                write!(formatter, "rate: at most {at_most} at confidence {confidence}, if its counts are right")
            }
            Self::FailsLessOften { confidence } => write!(
                formatter,
                "comparison: the first controller fails less often, at confidence {confidence}, if its counts are right"
            ),
            Self::Cruise { margin_m, x_ego_width_m } => write!(
                formatter,
                "adaptive cruise: D_rel - 10 - 1.4 v_ego is never smaller than {margin_m} m for 5 s; all x_ego at the end lie within \
                 {x_ego_width_m} m"
            ),
            // Shares are lower bounds: rounded down.
            Self::Reach { verified_share, falsified_share, .. } if *verified_share <= 0.0 => write!(
                formatter,
                "reach: nothing is shown of any part of the box; {:.2} % of its volume is in cells with a start that ends in contact",
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
                "reach: in {:.2} % of the box's volume no gap is ever smaller than {smallest_gap_m} m for {horizon_s} s, {}{}; \
                 {:.2} % of it is in cells with a start that ends in contact",
                (1e4 * verified_share).floor() / 1e2,
                limit.map_or_else(String::new, |limit| format!("however the leader brakes at up to {limit} m/s², ")),
                if *has_follower { "with a vehicle behind" } else { "with nobody behind" },
                (1e4 * falsified_share).floor() / 1e2
            ),
        }
    }
}

/// Why a certificate proves nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// A field has a value that makes no sense.
    #[error("`{field}` {problem}")]
    Invalid {
        /// Where.
        field: String,
        /// What is wrong.
        problem: &'static str,
    },
    /// The assumptions are not those that the statement needs.
    #[error("`assumptions` must be {needed:?}, and at most noise-of-seed besides")]
    Assumptions {
        /// What it needs.
        needed: Vec<Assumption>,
    },
    /// On the stated profile two vehicles may touch.
    #[error(
        "vehicle {front_vehicle} and the one behind it may touch in step {step}: only a gap of {gap_m} m is proved"
    )]
    MayCollide {
        /// The vehicle ahead, 0 for the leader.
        front_vehicle: usize,
        /// The step, 0 for the first.
        step: u32,
        /// What is proved of the gap, in metres.
        gap_m: f64,
    },
    /// The smallest gap is not proved to be as large as stated.
    #[error("`min_gap_m_at_least` is {stated_m}, and only {min_gap_m} m is proved")]
    GapTooSmall {
        /// What is stated, in metres.
        stated_m: f64,
        /// What is proved, in metres.
        min_gap_m: f64,
    },
    /// The branches do not cover the firing instants one after the other.
    #[error("`branches[{branch}]` must begin where the one before ends, and end no later than instant N")]
    Tiling {
        /// Which branch.
        branch: usize,
    },
    /// The multipliers of a branch prove nothing.
    #[error("`branches[{branch}]` is not proved: its sum may be as low as {sum_m} m")]
    Unproved {
        /// Which branch.
        branch: usize,
        /// The lower bound found, in metres.
        sum_m: f64,
    },
    /// It is not proved that some gap gets as small as stated.
    #[error("`gap_m` is {stated_m}, and only {gap_m} m is proved")]
    GapBound {
        /// What is stated, in metres.
        stated_m: f64,
        /// What is proved, in metres.
        gap_m: f64,
    },
    /// The policy file is missing, another one, or not usable.
    #[error("the policy file {problem}")]
    Policy {
        /// What is wrong.
        problem: String,
    },
    /// What is said of a cell of a partition is not proved.
    #[error("leaf {leaf} of `partition`: {problem}")]
    Leaf {
        /// Which one, among those that are not cut.
        leaf: usize,
        /// What stands against it.
        problem: String,
    },
    /// Checking takes more work than is allowed: nothing is said for or against the claim.
    #[error("checking it takes more than {limit} operations, and no more are allowed")]
    BudgetExceeded {
        /// What is allowed.
        limit: WorkLimit,
    },
    /// What was observed is not rare enough where the claim is false.
    #[error(
        "what was observed, or better, may have probability {} if the claim is false, and {} is allowed",
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
        Self::Invalid { field: field.into(), problem }
    }
}

/// Checks a certificate that needs no other file.
///
/// # Errors
/// [`Rejection`] if it does not prove what it states, or checking it takes more work than the default limit.
pub fn check(certificate: &Certificate) -> Result<ProvedClaim, Rejection> {
    check_with(certificate, None, WorkLimit::default())
}

/// Checks a certificate with the bytes of the policy file that it is about, and a limit of work.
///
/// # Errors
/// [`Rejection`] if it does not prove what it states, or checking it takes more work than `limit`.
pub fn check_with(
    certificate: &Certificate,
    policy: Option<&[u8]>,
    limit: WorkLimit,
) -> Result<ProvedClaim, Rejection> {
    if !certificate.has_required_assumptions() {
        return Err(Rejection::Assumptions { needed: certificate.statement.assumptions() });
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
        Statement::AdaptiveCruise(claim) => cruise::check(claim, policy, work),
        Statement::Reach(claim) => reach::check(claim, policy, certificate.is_first_version(), work),
    }
}
