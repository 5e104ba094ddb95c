//! Reasons for which a certificate is rejected.

use crate::assumption::Assumption;
use crate::number::format_number;
use crate::work::WorkLimit;

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
        "if the claim is false, counts as good as these may have a probability of {}, and at most {} is allowed",
        format_number(*tail_probability),
        format_number(*max_tail_probability)
    )]
    NotSignificant {
        /// Upper bound of the probability.
        tail_probability: f64,
        /// 1 - confidence.
        max_tail_probability: f64,
    },
}

impl Rejection {
    pub(crate) fn invalid(field: impl Into<String>, problem: &'static str) -> Self {
        Self::Invalid {
            field: field.into(),
            problem,
        }
    }
}
