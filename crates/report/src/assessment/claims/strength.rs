//! The strength of evidence for a claim.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use super::StrengthLevel;
use crate::assessment::Rounded;
use crate::assessment::table::CellMark;
use crumple_sim::engine::FailedControllerRuns;

/// Minimum confidence level, in percent, at which a count decides a claim.
pub const MIN_CONFIDENCE_PERCENT: f64 = 95.0;

/// Largest gain of a line that damps oscillations, after rounding to three decimals.
pub(in crate::assessment) const MAX_GAIN: f64 = 1.0;

/// The strength of evidence for a claim. JSON has its [`StrengthLevel`] as `strength`, and its kind as `basis`. Before
/// 0.4.0 the field `strength` had the kind; such files are still read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "Strength", transform = super::level::add_to_schema)
)]
#[serde(remote = "Self", tag = "basis", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Strength {
    /// The checker accepted the certificates in this run; valid under their assumptions.
    Proved {
        /// Number of certificates.
        certificates: usize,
    },
    /// The property held in all runs; nothing more is known.
    Tested {
        /// Number of runs, at least one.
        runs: u64,
    },
    /// The property held in all runs that decide it; others ended too early.
    PartlyTested {
        /// Number of runs that decide nothing.
        undecided: u64,
        /// Number of runs in all.
        runs: u64,
    },
    /// The failure rate lies between these bounds, at the stated confidence level.
    Between {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence level of each bound, in percent.
        confidence_percent: Rounded<1>,
        /// Number of runs behind the bounds.
        runs: u64,
    },
    /// The failure rate is at most this, at the stated confidence level.
    Bounded {
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence level of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The failure rate exceeds the claimed one, at the stated confidence level.
    Exceeded {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Confidence level of the bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// The claimed rate lies between the bounds.
    Undecided {
        /// Lower bound in percent, rounded down.
        lower_percent: Rounded<2>,
        /// Upper bound in percent, rounded up.
        upper_percent: Rounded<2>,
        /// Confidence level of each bound, in percent.
        confidence_percent: Rounded<1>,
    },
    /// Counted runs show the claim, at the stated confidence level.
    Counted {
        /// Confidence level, in percent.
        confidence_percent: Rounded<1>,
        /// Number of runs.
        runs: u64,
    },
    /// Counted runs do not show the claim at that confidence level.
    #[serde(alias = "counted_in_vain")]
    NotShownByCounting {
        /// Confidence level, in percent.
        confidence_percent: Rounded<1>,
        /// Number of runs.
        runs: u64,
    },
    /// Counted runs show at that confidence level that the subject fails more often than another controller.
    CountedAgainst {
        /// Runs in which only the subject failed.
        only_own: u64,
        /// Runs in which only the other controller failed, or gave no answer.
        only_other: u64,
        /// Runs without an answer of the subject, which count as its failures.
        unanswered: u64,
        /// Confidence level, in percent.
        confidence_percent: Rounded<1>,
        /// Number of runs.
        runs: u64,
    },
    /// Failures of the subject and of another controller in the same runs.
    Compared {
        /// Failures of the subject.
        own: u64,
        /// Failures of the other controller.
        other: u64,
        /// Number of runs.
        runs: u64,
        /// Runs without an answer of the subject, which count as its failures.
        #[serde(default)]
        unanswered: u64,
    },
    /// The largest measured gain; the claim allows at most 1.000.
    Gain {
        /// Largest gain.
        largest: Rounded<3>,
        /// Number of operating points.
        points: u64,
    },
    /// Vehicles collided, or an oscillation grew, at some operating points: mean speeds and frequencies.
    FailedPoints {
        /// Number of operating points with a collision or a gain above the limit.
        failures: u64,
        /// Number of operating points.
        points: u64,
    },
    /// The subject failed in some runs.
    Refuted {
        /// Number of failures.
        failures: u64,
        /// Number of runs.
        runs: u64,
    },
    /// The controller gave no answer in some runs, which are failures but no evidence about collisions or braking.
    Unanswered {
        /// Number of runs without an answer.
        unanswered: u64,
        /// Number of other runs that refute the claim.
        failures: u64,
        /// Number of runs in all.
        runs: u64,
        /// Time and reason of the first failure to answer.
        #[serde(alias = "because")]
        reason: String,
        /// True if a failure to answer refutes the claim by itself, because the claim excludes such failures.
        refutes: bool,
    },
    /// The other controller gave no answer in so many runs that the comparison is open.
    OtherUnanswered {
        /// Number of runs without an answer.
        unanswered: u64,
        /// Number of runs in all.
        runs: u64,
        /// Time and reason of the first failure to answer.
        #[serde(alias = "because")]
        reason: String,
    },
    /// A search found counterexamples.
    #[serde(alias = "found")]
    Falsified {
        /// Number of distinct counterexamples.
        failures: usize,
        /// Number of those that another driver would have avoided.
        avoidable: usize,
        /// Time and reason, if the controller gave no answer in the severest counterexample.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[serde(alias = "because")]
        reason: Option<String>,
    },
    /// The checker accepted a certificate about part of a box of initial states.
    #[serde(alias = "proved_in")]
    PartlyProved {
        /// Share of the box in percent, rounded down.
        share_percent: Rounded<2>,
    },
    /// Some evidence asserts the claim and some refutes it: one piece is wrong.
    Contradicted,
    /// Evidence about the claim or a part of its domain was gathered, and decides nothing.
    NotShown,
    /// No evidence about the claim was gathered.
    Untried,
}

/// JSON form of a strength.
#[derive(Serialize)]
struct StrengthForm<'a> {
    strength: StrengthLevel,
    #[serde(flatten, serialize_with = "Strength::serialize")]
    basis: &'a Strength,
}

impl Serialize for Strength {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let form = StrengthForm {
            strength: self.level(),
            basis: self,
        };
        form.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Strength {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut fields = Map::<String, Value>::deserialize(deserializer)?;
        if !fields.contains_key("basis")
            && let Some(kind) = fields.remove("strength")
        {
            fields.insert("basis".to_owned(), kind);
        }
        Self::deserialize(Value::Object(fields)).map_err(D::Error::custom)
    }
}

impl Strength {
    /// Returns the strength of the claim that no run fails, after `failures` in `runs`.
    #[must_use]
    pub fn from_counts(failures: u64, runs: u64) -> Self {
        match (failures, runs) {
            (_, 0) => Self::NotShown,
            (0, _) => Self::Tested { runs },
            _ => Self::Refuted { failures, runs },
        }
    }

    /// Returns the strength if some of the runs without a failure decide nothing, because they ended too early.
    #[must_use]
    pub(crate) fn with_undecided(self, undecided: u64) -> Self {
        match self {
            Self::Tested { runs } if undecided > 0 => Self::PartlyTested { undecided, runs },
            other => other,
        }
    }

    /// Returns the strength where the controller gave no answer in some runs, which do not count among the `failures`.
    /// Such a run refutes a claim about collisions (`refutes`); about other properties it is no evidence.
    #[must_use]
    pub(crate) fn from_counts_with_unanswered(
        failures: u64,
        runs: u64,
        unanswered: Option<&FailedControllerRuns>,
        refutes: bool,
    ) -> Self {
        match unanswered {
            None => Self::from_counts(failures, runs),
            Some(FailedControllerRuns {
                runs: unanswered,
                reason,
            }) => Self::Unanswered {
                unanswered: *unanswered,
                failures,
                runs,
                reason: reason.clone(),
                refutes,
            },
        }
    }

    /// Returns the strength of the claim to fail in fewer of the same runs than another controller. The arguments are
    /// the failures of each, and the number of its runs that ended early, whose results are unknown; the number of all
    /// runs, and of those without an answer of the subject, which are among its failures.
    #[must_use]
    pub(crate) fn from_paired_counts(
        [own, own_ended_by_others]: [u64; 2],
        [other, other_ended_by_others]: [u64; 2],
        runs: u64,
        unanswered: u64,
    ) -> Self {
        let compared = |own, other| Self::Compared {
            own,
            other,
            runs,
            unanswered,
        };
        let own_most = own + own_ended_by_others;
        let other_most = other + other_ended_by_others;
        if own_ended_by_others + other_ended_by_others == 0 {
            compared(own, other)
        } else if own_most < other {
            compared(own_most, other)
        } else if own > other_most {
            compared(own, other_most)
        } else {
            Self::NotShown
        }
    }

    /// Returns the strength that bounds give to a rate of at most `percent`; `None` unless `self` is `Between`.
    #[must_use]
    pub(crate) fn decide_rate_claim(&self, percent: f64) -> Option<Self> {
        let Self::Between {
            lower_percent,
            upper_percent,
            confidence_percent,
            ..
        } = *self
        else {
            return None;
        };
        // The shown numbers decide: they are rounded outwards.
        Some(if confidence_percent.value() < MIN_CONFIDENCE_PERCENT {
            Self::Undecided {
                lower_percent,
                upper_percent,
                confidence_percent,
            }
        } else if upper_percent.value() <= percent {
            Self::Bounded {
                upper_percent,
                confidence_percent,
            }
        } else if lower_percent.value() > percent {
            Self::Exceeded {
                lower_percent,
                confidence_percent,
            }
        } else {
            Self::Undecided {
                lower_percent,
                upper_percent,
                confidence_percent,
            }
        })
    }

    #[must_use]
    pub(crate) fn is_refutation(&self) -> bool {
        match self {
            Self::Refuted { .. } | Self::Falsified { .. } | Self::Exceeded { .. } => true,
            Self::CountedAgainst { .. } | Self::FailedPoints { .. } => true,
            Self::Compared { own, other, .. } => own > other,
            Self::Gain { largest, .. } => largest.value() > MAX_GAIN,
            Self::Unanswered {
                failures, refutes, ..
            } => *refutes || *failures > 0,
            _ => false,
        }
    }

    /// True for a measured gain that supports the claim.
    #[must_use]
    pub(crate) fn is_gain_in_limit(&self) -> bool {
        matches!(self, Self::Gain { .. }) && !self.is_refutation()
    }

    /// True if the claim is shown to hold, not only tested.
    #[must_use]
    pub(crate) fn is_assurance(&self) -> bool {
        matches!(
            self,
            Self::Proved { .. } | Self::Bounded { .. } | Self::Counted { .. }
        )
    }

    /// Returns the rank among evidence of one claim: refutations, then proofs, bounds, tests. Within one kind, sharper
    /// bounds and larger tests rank higher.
    pub(in crate::assessment) fn weight(&self) -> f64 {
        match self {
            Self::Refuted { failures, .. } | Self::FailedPoints { failures, .. } => {
                8.0 + squash(*failures as f64)
            }
            Self::Falsified { failures, .. } => 8.0 + squash(*failures as f64),
            Self::Unanswered {
                unanswered,
                failures,
                ..
            } if self.is_refutation() => 8.0 + squash((unanswered + failures) as f64),
            Self::Unanswered { .. } | Self::OtherUnanswered { .. } => 1.4,
            Self::Exceeded { .. } | Self::CountedAgainst { .. } | Self::Contradicted => 8.0,
            Self::Proved { certificates } => 7.0 + squash(*certificates as f64),
            Self::PartlyProved { share_percent } => 6.0 + squash(share_percent.value()),
            Self::Bounded { upper_percent, .. } => 5.0 - squash(upper_percent.value()),
            Self::Counted {
                confidence_percent, ..
            } => 4.0 + 0.005 * confidence_percent.value(),
            Self::Compared { own, other, .. } if own > other => 8.0,
            Self::Compared { own, other, .. } if own < other => 3.0,
            Self::Compared { .. } => 1.5,
            Self::PartlyTested { .. } => 1.45,
            Self::Tested { runs } => 3.0 + squash(*runs as f64),
            Self::Gain { largest, .. } if self.is_refutation() => 8.0 + squash(largest.value()),
            Self::Gain { points, .. } => 3.0 + squash(*points as f64),
            Self::Undecided {
                lower_percent,
                upper_percent,
                ..
            } => 2.0 - squash(upper_percent.value() - lower_percent.value()),
            Self::NotShownByCounting { .. } => 1.2,
            Self::Between { .. } => 1.0,
            Self::NotShown => 0.5,
            Self::Untried => 0.0,
        }
    }

    /// Returns the word for the strength.
    #[must_use]
    pub fn level(&self) -> StrengthLevel {
        match self {
            _ if self.is_refutation() => StrengthLevel::Refuted,
            Self::Proved { .. } => StrengthLevel::Proved,
            Self::Bounded { .. } | Self::Counted { .. } | Self::Between { .. } => {
                StrengthLevel::Bounded
            }
            Self::Tested { .. } | Self::Gain { .. } => StrengthLevel::Tested,
            Self::Compared { own, other, .. } if own < other => StrengthLevel::Tested,
            Self::Untried => StrengthLevel::NotExamined,
            _ => StrengthLevel::NotShown,
        }
    }

    pub(in crate::assessment) fn mark(&self) -> CellMark {
        match (self.rank(), self.level()) {
            (0, _) => CellMark::Bad,
            (1, _) => CellMark::Neutral,
            (_, StrengthLevel::Tested) => CellMark::Tested,
            _ => CellMark::Good,
        }
    }

    /// Describes the strength in words that follow the claim and a colon: its level, and the facts.
    pub(in crate::assessment) fn describe(&self) -> String {
        self.level().introduce(&self.describe_facts())
    }

    /// Describes the facts behind the strength, without its level; empty if there are none.
    pub(in crate::assessment) fn describe_facts(&self) -> String {
        match self {
            Self::Falsified {
                failures,
                avoidable,
                reason,
            } => {
                let plural = if *failures == 1 { "" } else { "s" };
                let unanswered = reason
                    .as_ref()
                    .map_or(String::new(), |reason| format!("; no answer {reason}"));
                format!("{failures} distinct failure{plural}, {avoidable} avoidable{unanswered}")
            }
            Self::Unanswered {
                unanswered,
                failures,
                runs,
                reason,
                ..
            } => match failures {
                0 => format!("no answer in {unanswered} of {runs}: {reason}"),
                _ => format!("{failures} of {runs} fail, no answer in {unanswered}: {reason}"),
            },
            Self::OtherUnanswered {
                unanswered,
                runs,
                reason,
            } => {
                format!("the other controller gave no answer in {unanswered} of {runs}: {reason}")
            }
            Self::PartlyProved { share_percent } => {
                format!("{share_percent} % of the box are proved")
            }
            Self::Proved { .. } | Self::NotShown | Self::Untried => String::new(),
            Self::Tested { runs: 1 } => "holds in one run".to_owned(),
            Self::Tested { runs } => format!("0 of {runs} fail"),
            Self::PartlyTested { undecided, runs } => {
                format!("0 of {runs} fail, {undecided} undecided")
            }
            Self::Gain { largest, points } => {
                format!(
                    "largest gain {largest}, measured at {points} operating points (mean speed and frequency)"
                )
            }
            Self::Between { .. } | Self::Bounded { .. } | Self::Exceeded { .. } => {
                self.describe_bounds()
            }
            Self::Undecided { .. } => self.describe_bounds(),
            Self::Counted {
                confidence_percent, ..
            } => format!("shown by counts, confidence {confidence_percent} %"),
            Self::NotShownByCounting { runs, .. } => format!("{runs} counted runs do not show it"),
            Self::CountedAgainst { .. } | Self::Compared { .. } => self.describe_comparison(),
            Self::Refuted { failures, runs } => format!("{failures} of {runs} fail"),
            Self::FailedPoints { failures, points } => {
                format!("{failures} of {points} operating points (mean speed and frequency) fail")
            }
            Self::Contradicted => "contradictory evidence".to_owned(),
        }
    }

    /// Describes the strength in a cell of the table of claims: its level, and numbers that the legend explains.
    pub(in crate::assessment) fn table_text(&self) -> String {
        self.level().introduce(&self.table_numbers())
    }

    /// Returns the numbers of a cell of the table of claims; empty if there are none.
    fn table_numbers(&self) -> String {
        match self {
            Self::Falsified {
                failures,
                avoidable,
                ..
            } => format!("{failures} ({avoidable} avoidable)"),
            Self::Unanswered {
                unanswered,
                failures,
                runs,
                ..
            } => match failures {
                0 => format!("no answer in {unanswered} of {runs}"),
                _ => format!("{failures} of {runs}, no answer in {unanswered}"),
            },
            Self::PartlyProved { share_percent } => format!("{share_percent} % proved"),
            Self::Tested { runs } => format!("0 of {runs}"),
            Self::PartlyTested { undecided, runs } => {
                format!("0 of {runs}, {undecided} undecided")
            }
            Self::Gain { largest, .. } => format!("gain {largest}"),
            Self::Refuted { failures, runs } => format!("{failures} of {runs}"),
            Self::FailedPoints { failures, points } => format!("{failures} of {points} points"),
            Self::Bounded { .. }
            | Self::Exceeded { .. }
            | Self::Between { .. }
            | Self::Undecided { .. } => self
                .rate_bounds()
                .map_or_else(String::new, |bounds| bounds.table_text()),
            Self::Counted {
                confidence_percent, ..
            } => format!("fewer ({confidence_percent} %)"),
            Self::NotShownByCounting { runs, .. } => format!("{runs} counted"),
            Self::CountedAgainst {
                confidence_percent, ..
            } => format!("more ({confidence_percent} %)"),
            Self::Compared { own, other, .. } => format!("{own} against {other}"),
            Self::Contradicted => "contradictory".to_owned(),
            Self::OtherUnanswered { .. } | Self::Proved { .. } => String::new(),
            Self::NotShown | Self::Untried => String::new(),
        }
    }

    /// Returns the bounds of a rate, for the strengths that have them.
    pub(in crate::assessment) fn rate_bounds(&self) -> Option<RateBounds> {
        match *self {
            Self::Bounded {
                upper_percent,
                confidence_percent,
            } => Some(RateBounds {
                bounds: PercentBounds::AtMost(upper_percent),
                confidence_percent,
            }),
            Self::Exceeded {
                lower_percent,
                confidence_percent,
            } => Some(RateBounds {
                bounds: PercentBounds::AtLeast(lower_percent),
                confidence_percent,
            }),
            Self::Undecided {
                lower_percent,
                upper_percent,
                confidence_percent,
            }
            | Self::Between {
                lower_percent,
                upper_percent,
                confidence_percent,
                ..
            } => Some(RateBounds {
                bounds: PercentBounds::Within(lower_percent, upper_percent),
                confidence_percent,
            }),
            _ => None,
        }
    }

    /// Describes the failures of two controllers in the same runs; empty for other strengths.
    fn describe_comparison(&self) -> String {
        match self {
            Self::CountedAgainst {
                only_own,
                only_other,
                unanswered,
                confidence_percent,
                runs,
            } => format!(
                "in {only_own} of {runs} counted runs, it fails and the other does not; in {only_other}, the other \
                 fails and it does not{}; confidence {confidence_percent} %",
                describe_unanswered(*unanswered)
            ),
            Self::Compared {
                own,
                other,
                runs,
                unanswered,
            } => {
                let unanswered = describe_unanswered(*unanswered);
                match own == other {
                    true => format!("both fail in {own} of {runs}{unanswered}"),
                    false => format!("{own} against {other} of {runs} fail{unanswered}"),
                }
            }
            _ => String::new(),
        }
    }

    fn describe_bounds(&self) -> String {
        self.rate_bounds()
            .map_or_else(String::new, |bounds| bounds.describe())
    }

    /// Returns a rank for comparisons of assessments: 0 refuted, 1 undecided, 2 tested or bounded, 3 proved.
    pub(in crate::assessment) fn rank(&self) -> u8 {
        match self {
            Self::Proved { .. } => 3,
            Self::Tested { .. } | Self::Bounded { .. } | Self::Counted { .. } => 2,
            Self::Contradicted => 0,
            Self::Compared { own, other, .. } if own < other => 2,
            _ if self.is_refutation() => 0,
            Self::Gain { .. } => 2,
            _ => 1,
        }
    }
}

/// Describes runs without an answer of the subject, after a comma; empty if there are none.
fn describe_unanswered(runs: u64) -> String {
    match runs {
        0 => String::new(),
        runs => format!(", it gives no answer in {runs}"),
    }
}

/// Maps numbers from 0 upwards to [0, 1), larger ones to larger ones.
fn squash(value: f64) -> f64 {
    value.max(0.0) / (1.0 + value.max(0.0))
}

/// Bounds of a rate at a confidence level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::assessment) struct RateBounds {
    bounds: PercentBounds,
    confidence_percent: Rounded<1>,
}

/// Bounds in percent, rounded outwards.
#[derive(Debug, Clone, Copy, PartialEq)]
enum PercentBounds {
    AtMost(Rounded<2>),
    AtLeast(Rounded<2>),
    Within(Rounded<2>, Rounded<2>),
}

impl RateBounds {
    pub(in crate::assessment) fn lower_percent(&self) -> f64 {
        match self.bounds {
            PercentBounds::AtMost(_) => 0.0,
            PercentBounds::AtLeast(lower) | PercentBounds::Within(lower, _) => lower.value(),
        }
    }

    pub(in crate::assessment) fn upper_percent(&self) -> f64 {
        match self.bounds {
            PercentBounds::AtLeast(_) => 100.0,
            PercentBounds::AtMost(upper) | PercentBounds::Within(_, upper) => upper.value(),
        }
    }

    pub(in crate::assessment) fn confidence_percent(&self) -> f64 {
        self.confidence_percent.value()
    }

    fn describe(&self) -> String {
        let confidence = self.confidence_percent;
        match self.bounds {
            PercentBounds::AtMost(upper) => format!("at most {upper} %, confidence {confidence} %"),
            PercentBounds::AtLeast(lower) => {
                format!("at least {lower} %, confidence {confidence} %")
            }
            PercentBounds::Within(lower, upper) => {
                format!("{lower} to {upper} %, each bound at confidence {confidence} %")
            }
        }
    }

    fn table_text(&self) -> String {
        let confidence = self.confidence_percent;
        match self.bounds {
            PercentBounds::AtMost(upper) => format!("≤ {upper} % ({confidence} %)"),
            PercentBounds::AtLeast(lower) => format!("≥ {lower} % ({confidence} %)"),
            PercentBounds::Within(lower, upper) => {
                format!("{lower} to {upper} % ({confidence} %)")
            }
        }
    }
}
