//! How strongly a claim is supported.

use serde::{Deserialize, Serialize};

use crate::assessment::Rounded;
use crate::assessment::table::Mark;

/// How strongly a claim is supported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "strength", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Strength {
    /// The checker accepted the certificates in this run; it holds under the assumptions that go with them.
    Proved {
        /// How many certificates.
        certificates: usize,
    },
    /// It held whenever it was tried, so many times; that is all that is known.
    Tested {
        /// How often it was tried, at least once.
        runs: u64,
    },
    /// The share of failures is at most this, with the stated confidence.
    Bounded {
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The share of failures is more than claimed, with the stated confidence.
    Exceeded {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Confidence of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The bounds lie on both sides of what is claimed.
    Undecided {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
    },
    /// It failed: there are runs to show for it.
    Refuted {
        /// How often.
        failures: u64,
        /// Out of how many.
        runs: u64,
    },
    /// A search found what makes it fail, so nothing follows about how often it does.
    Defeated {
        /// Hardest deceleration of the leader, in m/s².
        peak_brake_mps2: Rounded<2>,
    },
    /// A search found distinct failures.
    Found {
        /// How many.
        failures: usize,
        /// How many of them another driver would have avoided.
        avoidable: usize,
    },
    /// The checker accepted a certificate about part of a box of starts.
    ProvedIn {
        /// The part, in percent, rounded down.
        share_percent: Rounded<2>,
    },
    /// There is no evidence for it or against it.
    Untried,
}

impl Strength {
    /// Of the claim that nothing fails, after `failures` in `runs`.
    pub(super) fn of(failures: u64, runs: u64) -> Self {
        match (failures, runs) {
            (_, 0) => Self::Untried,
            (0, _) => Self::Tested { runs },
            _ => Self::Refuted { failures, runs },
        }
    }

    pub(in crate::assessment) fn mark(&self) -> Mark {
        match self {
            Self::Proved { .. } | Self::ProvedIn { .. } | Self::Tested { .. } | Self::Bounded { .. } => Mark::Good,
            Self::Undecided { .. } | Self::Untried => Mark::None,
            Self::Exceeded { .. } | Self::Refuted { .. } | Self::Defeated { .. } | Self::Found { .. } => Mark::Bad,
        }
    }

    pub(in crate::assessment) fn words(&self) -> String {
        match self {
            Self::Found { failures, avoidable } => {
                format!("refuted: {failures} distinct failures, {avoidable} avoidable")
            }
            Self::ProvedIn { share_percent } => format!("proved for {share_percent} % of the box, see Proofs"),
            Self::Proved { .. } => "proved under assumptions, see Proofs".to_owned(),
            Self::Tested { runs } => format!("tested: 0 of {runs} collide"),
            Self::Bounded { upper_percent, confidence_percent } => {
                format!("bounded: at most {upper_percent} %, confidence {confidence_percent} %")
            }
            Self::Exceeded { lower_percent, confidence_percent } => {
                format!("exceeded: at least {lower_percent} %, confidence {confidence_percent} %")
            }
            Self::Undecided { lower_percent, upper_percent } => {
                format!("undecided: {lower_percent} to {upper_percent} %")
            }
            Self::Refuted { failures, runs } => format!("refuted: {failures} of {runs} collide"),
            Self::Defeated { peak_brake_mps2 } => {
                format!("refuted by a leader that brakes at up to {peak_brake_mps2} m/s²")
            }
            Self::Untried => "not shown".to_owned(),
        }
    }

    /// How good it is to hear, for comparisons: what is refuted, what is not known, what was tried, what is proved.
    pub(in crate::assessment) fn rank(&self) -> u8 {
        match self {
            Self::Refuted { .. } | Self::Defeated { .. } | Self::Exceeded { .. } | Self::Found { .. } => 0,
            Self::Untried | Self::Undecided { .. } => 1,
            Self::Tested { .. } | Self::Bounded { .. } => 2,
            Self::Proved { .. } | Self::ProvedIn { .. } => 3,
        }
    }
}
