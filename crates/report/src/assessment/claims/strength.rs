//! How strongly a claim is supported.

use serde::{Deserialize, Serialize};

use crate::assessment::Rounded;
use crate::assessment::table::CellMark;
use crumple_world::sim::FailedControllerRuns;

/// Least confidence, in percent, with which counting decides a claim.
pub const MIN_CONFIDENCE_PERCENT: f64 = 95.0;

/// How strongly a claim is supported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// The share of failures lies between these, with the stated confidence.
    Between {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence of each bound, in percent.
        confidence_percent: Rounded<1>,
        /// On how many runs they rest.
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
        /// Confidence of each bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// It follows from counted runs, with the stated confidence.
    Counted {
        /// The confidence, in percent.
        confidence_percent: Rounded<1>,
        /// How many runs.
        runs: u64,
    },
    /// Runs were counted to show it with that confidence, and did not.
    #[serde(rename = "counted_in_vain")]
    NotShownByCounting {
        /// The confidence, in percent.
        confidence_percent: Rounded<1>,
        /// How many runs.
        runs: u64,
    },
    /// How often it and another failed in the same runs.
    Compared {
        /// How often it failed.
        own: u64,
        /// How often the other did.
        other: u64,
        /// Of so many runs.
        runs: u64,
    },
    /// It failed: there are runs to show for it.
    Refuted {
        /// How often.
        failures: u64,
        /// Of so many tries.
        runs: u64,
    },
    /// Its controller gave no answer in some runs, which ended there: these are failures of the controller, and no contacts, no braking and
    /// no driving of which anything could be said.
    Unanswered {
        /// In how many.
        unanswered: u64,
        /// How many others refute the claim.
        failures: u64,
        /// Of so many runs in all.
        runs: u64,
        /// When the first of them ended, and why.
        because: String,
        /// Whether that refutes the claim by itself: it does where a controller that fails is what is claimed not to be.
        refutes: bool,
    },
    /// The other controller gave no answer in so many of the runs that this does not show which of the two fails less often.
    OtherUnanswered {
        /// In how many.
        unanswered: u64,
        /// Of so many runs.
        runs: u64,
        /// When the first of them ended, and why.
        because: String,
    },
    /// A search made it fail.
    #[serde(rename = "found")]
    Falsified {
        /// In how many distinct ways.
        failures: usize,
        /// How many of them another driver would have avoided.
        avoidable: usize,
        /// Of those in which the controller gave no answer: when and why, in the severest.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        because: Option<String>,
    },
    /// A braking of the leader makes it fail.
    #[serde(rename = "defeated")]
    AttackFound {
        /// The hardest deceleration of the mildest one found, in m/s².
        peak_brake_mps2: Rounded<2>,
    },
    /// The checker accepted a certificate about part of a box of starts.
    #[serde(rename = "proved_in")]
    PartlyProved {
        /// The part, in percent, rounded down.
        share_percent: Rounded<2>,
    },
    /// Some evidence says that it holds and some that it does not: one of them is wrong.
    Contradicted,
    /// There is no evidence for it or against it.
    Untried,
}

impl Strength {
    /// Of the claim that nothing fails, after `failures` in `runs`.
    #[must_use]
    pub fn from_counts(failures: u64, runs: u64) -> Self {
        match (failures, runs) {
            (_, 0) => Self::Untried,
            (0, _) => Self::Tested { runs },
            _ => Self::Refuted { failures, runs },
        }
    }

    /// The same where in some of the runs, which are not among the `failures`, the controller gave no answer. Of a claim about contacts that
    /// is a failure (`refutes`); of one about how it drives, nothing to go by.
    #[must_use]
    pub(crate) fn from_counts_with_unanswered(
        failures: u64,
        runs: u64,
        unanswered: Option<&FailedControllerRuns>,
        refutes: bool,
    ) -> Self {
        match unanswered {
            None => Self::from_counts(failures, runs),
            Some(FailedControllerRuns { runs: unanswered, because }) => {
                Self::Unanswered { unanswered: *unanswered, failures, runs, because: because.clone(), refutes }
            }
        }
    }

    /// Of the claim that it fails in fewer of the same runs than another: how often each did, and how many of its runs were cut
    /// short, of which it is not known how they would have ended.
    #[must_use]
    pub(crate) fn from_paired_counts(
        [own, own_cut_short]: [u64; 2],
        [other, other_cut_short]: [u64; 2],
        runs: u64,
    ) -> Self {
        let (own_most, other_most) = (own + own_cut_short, other + other_cut_short);
        if own_cut_short + other_cut_short == 0 {
            Self::Compared { own, other, runs }
        } else if own_most < other {
            Self::Compared { own: own_most, other, runs }
        } else if own > other_most {
            Self::Compared { own, other: other_most, runs }
        } else {
            Self::Untried
        }
    }

    /// What bounds on a share say of the claim that it is at most `percent`; nothing if these are no bounds.
    #[must_use]
    pub(crate) fn decide_rate_claim(&self, percent: f64) -> Option<Self> {
        let Self::Between { lower_percent, upper_percent, confidence_percent, .. } = *self else { return None };
        // Rounded outwards, so that what is shown decides. A bound of little confidence decides nothing.
        Some(if confidence_percent.value() < MIN_CONFIDENCE_PERCENT {
            Self::Undecided { lower_percent, upper_percent, confidence_percent }
        } else if upper_percent.value() <= percent {
            Self::Bounded { upper_percent, confidence_percent }
        } else if lower_percent.value() > percent {
            Self::Exceeded { lower_percent, confidence_percent }
        } else {
            Self::Undecided { lower_percent, upper_percent, confidence_percent }
        })
    }

    /// Whether it says that the claim does not hold.
    #[must_use]
    pub(crate) fn is_refutation(&self) -> bool {
        match self {
            Self::Refuted { .. } | Self::Falsified { .. } | Self::AttackFound { .. } | Self::Exceeded { .. } => true,
            Self::Compared { own, other, .. } => own > other,
            Self::Unanswered { failures, refutes, .. } => *refutes || *failures > 0,
            _ => false,
        }
    }

    /// Whether it says that the claim holds, and not only that it was tried.
    #[must_use]
    pub(crate) fn is_assurance(&self) -> bool {
        matches!(self, Self::Proved { .. } | Self::Bounded { .. } | Self::Counted { .. })
    }

    /// By what two readings of one claim are ordered: a refutation before everything, then proofs, bounds, tests. Within
    /// one kind the sharper bound and the larger test.
    pub(in crate::assessment) fn weight(&self) -> f64 {
        let within = |value: f64| value.max(0.0) / (1.0 + value.max(0.0));
        match self {
            Self::Refuted { failures, .. } => 8.0 + within(*failures as f64),
            Self::Falsified { failures, .. } => 8.0 + within(*failures as f64),
            Self::Unanswered { unanswered, failures, .. } if self.is_refutation() => {
                8.0 + within((unanswered + failures) as f64)
            }
            Self::Unanswered { .. } | Self::OtherUnanswered { .. } => 1.4,
            Self::AttackFound { .. } | Self::Exceeded { .. } | Self::Contradicted => 8.0,
            Self::Proved { certificates } => 7.0 + within(*certificates as f64),
            Self::PartlyProved { share_percent } => 6.0 + within(share_percent.value()),
            Self::Bounded { upper_percent, .. } => 5.0 - within(upper_percent.value()),
            Self::Counted { confidence_percent, .. } => 4.0 + 0.005 * confidence_percent.value(),
            Self::Compared { own, other, .. } if own > other => 8.0,
            Self::Compared { own, other, .. } if own < other => 3.0,
            Self::Compared { .. } => 1.5,
            Self::Tested { runs } => 3.0 + within(*runs as f64),
            Self::Undecided { lower_percent, upper_percent, .. } => {
                2.0 - within(upper_percent.value() - lower_percent.value())
            }
            Self::NotShownByCounting { .. } => 1.2,
            Self::Between { .. } => 1.0,
            Self::Untried => 0.0,
        }
    }

    pub(in crate::assessment) fn mark(&self) -> CellMark {
        match self.rank() {
            0 => CellMark::Bad,
            1 => CellMark::Neutral,
            _ => CellMark::Good,
        }
    }

    pub(in crate::assessment) fn describe(&self) -> String {
        match self {
            Self::Falsified { failures, avoidable, because } => {
                let plural = if *failures == 1 { "" } else { "s" };
                let silent = because.as_ref().map_or(String::new(), |because| format!("; it gave no answer {because}"));
                format!("refuted: {failures} distinct failure{plural}, {avoidable} avoidable{silent}")
            }
            Self::Unanswered { unanswered, failures: 0, runs, because, refutes } => {
                let how = if *refutes { "refuted" } else { "not shown" };
                format!("{how}: gave no answer in {unanswered} of {runs}: {because}")
            }
            Self::Unanswered { unanswered, failures, runs, because, .. } => {
                format!("refuted: {failures} of {runs} fail, and it gave no answer in {unanswered}: {because}")
            }
            Self::OtherUnanswered { unanswered, runs, because } => {
                format!("not shown: the other gave no answer in {unanswered} of {runs}: {because}")
            }
            Self::PartlyProved { share_percent } => format!("proved for {share_percent} % of the box, see Proofs"),
            Self::Proved { .. } => "proved under assumptions, see Proofs".to_owned(),
            Self::Tested { runs: 1 } => "tested: one run, and it holds".to_owned(),
            Self::Tested { runs } => format!("tested: 0 of {runs} fail"),
            Self::Between { lower_percent, upper_percent, confidence_percent, .. } => {
                format!("{lower_percent} to {upper_percent} %, confidence {confidence_percent} % each")
            }
            Self::Bounded { upper_percent, confidence_percent } => {
                format!("bounded: at most {upper_percent} %, confidence {confidence_percent} %")
            }
            Self::Exceeded { lower_percent, confidence_percent } => {
                format!("exceeded: at least {lower_percent} %, confidence {confidence_percent} %")
            }
            Self::Undecided { lower_percent, upper_percent, confidence_percent } => {
                format!("undecided: {lower_percent} to {upper_percent} %, confidence {confidence_percent} % each")
            }
            Self::Counted { confidence_percent, .. } => format!("shown by counting, confidence {confidence_percent} %"),
            Self::NotShownByCounting { runs, .. } => format!("not shown by {runs} counted runs"),
            Self::Compared { own, other, runs } => match own.cmp(other) {
                std::cmp::Ordering::Less => format!("{own} against {other} of {runs} fail"),
                std::cmp::Ordering::Equal => format!("not shown: each fails in {own} of {runs}"),
                std::cmp::Ordering::Greater => format!("refuted: {own} against {other} of {runs} fail"),
            },
            Self::Refuted { failures, runs } => format!("refuted: {failures} of {runs} fail"),
            Self::AttackFound { peak_brake_mps2 } => {
                format!("refuted by a leader that brakes at up to {peak_brake_mps2} m/s²")
            }
            Self::Contradicted => "contradicted: see what is beside".to_owned(),
            Self::Untried => "not shown".to_owned(),
        }
    }

    /// How good it is to hear, for comparisons: what is refuted, what is not known, what was tried, what is proved.
    pub(in crate::assessment) fn rank(&self) -> u8 {
        match self {
            Self::Proved { .. } => 3,
            Self::Tested { .. } | Self::Bounded { .. } | Self::Counted { .. } => 2,
            Self::Contradicted => 0,
            Self::Compared { own, other, .. } if own < other => 2,
            _ if self.is_refutation() => 0,
            _ => 1,
        }
    }
}
