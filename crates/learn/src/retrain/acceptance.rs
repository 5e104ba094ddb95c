//! Acceptance of a round.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::RegressionResults;
use super::regression_spaces::{RegressionSpaceResult, SIGNIFICANCE};
use crate::rl::{TIME_GAP_RANGE_S, TrafficUsefulness};
use crumple_core::digits::format_rounded;
use crumple_evidence::DiscordantPairs;

/// Decision on a candidate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Acceptance {
    /// The candidate replaces the policy before it.
    Accepted,
    /// The candidate is discarded; the learner continues.
    Rejected {
        /// All reasons.
        objections: Vec<RejectionReason>,
    },
}

/// Reason to reject a candidate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum RejectionReason {
    /// The candidate collides in scenarios of the paper in which the policy before it did not.
    Paper {
        /// Scenarios, each with the estimator.
        scenarios: Vec<String>,
    },
    /// The candidate collides in random scenarios of the paper's distribution in which the policy before it did not.
    Nominal {
        /// Indices of the scenarios.
        draws: Vec<u64>,
    },
    /// The candidate collides more often in the validation set.
    #[serde(alias = "kept-aside")]
    ValidationSet {
        /// Collisions of the policy before it.
        before: usize,
        /// Collisions of the candidate.
        after: usize,
    },
    /// The candidate collides significantly more often in a regression space.
    #[serde(alias = "worse")]
    MoreCollisions {
        /// Name of the space.
        space: String,
        /// Scenarios in which exactly one of the two policies collides.
        #[serde(alias = "contacts")]
        collisions: DiscordantPairs,
    },
    /// The candidate is useful significantly less often in a regression space in which `idm` always is.
    LessUseful {
        /// Name of the space.
        space: String,
        /// Scenarios in which exactly one of the two policies is useful.
        drives: DiscordantPairs,
    },
    /// The candidate is less useful in everyday traffic or in recorded drives.
    WorseInTraffic {
        /// Measures that are worse, each with the value that it is compared with, and the candidate's.
        measures: Vec<(String, f64, f64)>,
    },
    /// A line of vehicles amplifies a disturbance more than before, or collides, or does not settle any more.
    LineGain {
        /// Gain of the policy before it.
        before: Option<f64>,
        /// Gain of the candidate; none if the line collides or does not settle.
        after: Option<f64>,
    },
    /// The candidate has no fewer collisions in the validation set, and none fewer in the cases.
    NothingFixed,
    /// No checkpoint was better than the policy before it.
    Unchanged,
    /// The training diverged, and there is no candidate.
    Diverged {
        /// Description of the divergence.
        problem: String,
    },
}

/// Difference between two ordered lists of failures.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailureChange {
    /// Failures before.
    pub before: usize,
    /// Failures after.
    pub after: usize,
    /// Failures that are fixed.
    pub fixed: usize,
    /// Failures that are new.
    pub regressed: usize,
}

impl FailureChange {
    pub(crate) fn between<T: PartialEq>(before: &[T], after: &[T]) -> Self {
        Self {
            before: before.len(),
            after: after.len(),
            fixed: only_in_first(before, after).count(),
            regressed: only_in_first(after, before).count(),
        }
    }
}

impl fmt::Display for FailureChange {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            before,
            after,
            fixed,
            regressed,
        } = self;
        write!(out, "{before} → {after} ({fixed}, {regressed})")
    }
}

fn only_in_first<'a, T: PartialEq>(first: &'a [T], second: &'a [T]) -> impl Iterator<Item = &'a T> {
    first.iter().filter(|item| !second.contains(item))
}

/// Accepts a candidate if it has fewer collisions in the validation set or in the cases, no more in the validation set,
/// no new failure in the paper's scenarios and distribution, and is not worse in any regression space and in traffic.
/// In the regression spaces, McNemar's exact one-sided test on paired scenarios ([`DiscordantPairs`]) at
/// [`SIGNIFICANCE`] decides for each space and property. `in_cases` counts the collisions in the cases. Comfort may be
/// 1 % worse than that of the `initial` policy of the retraining, so that tolerances of rounds do not add up.
#[must_use]
pub fn decide_acceptance(
    initial: &RegressionResults,
    before: &RegressionResults,
    after: &RegressionResults,
    in_cases: &FailureChange,
) -> Acceptance {
    let mut objections = Vec::new();
    let scenarios: Vec<String> = only_in_first(&after.paper, &before.paper)
        .cloned()
        .collect();
    if !scenarios.is_empty() {
        objections.push(RejectionReason::Paper { scenarios });
    }
    let draws: Vec<u64> = only_in_first(&after.nominal, &before.nominal)
        .copied()
        .collect();
    if !draws.is_empty() {
        objections.push(RejectionReason::Nominal { draws });
    }
    for after in &after.regression {
        if let Some(before) = before
            .regression
            .iter()
            .find(|before| before.space == after.space)
        {
            objections.extend(objections_in_space(before, after));
        }
    }
    if let (Some(initial), Some(before), Some(after)) =
        (&initial.usefulness, &before.usefulness, &after.usefulness)
    {
        objections.extend(objections_in_traffic(initial, before, after));
    }
    let [before, after] = [before, after].map(|results| results.validation_set.len());
    if after > before {
        objections.push(RejectionReason::ValidationSet { before, after });
    }
    if after >= before && in_cases.after >= in_cases.before {
        objections.push(RejectionReason::NothingFixed);
    }
    if objections.is_empty() {
        Acceptance::Accepted
    } else {
        Acceptance::Rejected { objections }
    }
}

/// Lists the properties that are significantly worse in a regression space.
fn objections_in_space(
    before: &RegressionSpaceResult,
    after: &RegressionSpaceResult,
) -> impl Iterator<Item = RejectionReason> {
    let collisions = discordant_pairs(&before.collisions, &after.collisions);
    let more_collisions =
        collisions
            .is_worse(SIGNIFICANCE)
            .then(|| RejectionReason::MoreCollisions {
                space: after.space.clone(),
                collisions,
            });
    let less_useful = before
        .not_useful
        .as_ref()
        .zip(after.not_useful.as_ref())
        .map(|(before, after)| discordant_pairs(before, after))
        .filter(|drives| drives.is_worse(SIGNIFICANCE))
        .map(|drives| RejectionReason::LessUseful {
            space: after.space.clone(),
            drives,
        });
    more_collisions.into_iter().chain(less_useful)
}

/// Lists what is worse in everyday traffic.
fn objections_in_traffic(
    initial: &TrafficUsefulness,
    before: &TrafficUsefulness,
    after: &TrafficUsefulness,
) -> impl Iterator<Item = RejectionReason> {
    let measures = worse_in_traffic(initial, before, after);
    let worse = (!measures.is_empty()).then_some(RejectionReason::WorseInTraffic { measures });
    let is_amplified = match (before.line_gain, after.line_gain) {
        (before, Some(after)) => after > before.map_or(1.0, |before| before.max(1.0)),
        (before, None) => before.is_some(),
    };
    let amplified = is_amplified.then_some(RejectionReason::LineGain {
        before: before.line_gain,
        after: after.line_gain,
    });
    worse.into_iter().chain(amplified)
}

/// Measure of usefulness that a round must not make worse.
pub(super) struct TrafficMeasure {
    pub(super) name: &'static str,
    /// Returns the value; none if it was not measured.
    pub(super) value: fn(&TrafficUsefulness) -> Option<f64>,
    /// Range in which no value is worse than another: no fault, and the comfort of `idm`.
    good_range: [f64; 2],
    /// True for a number of faults; false for comfort.
    is_fault: bool,
}

impl TrafficMeasure {
    const fn fault(name: &'static str, value: fn(&TrafficUsefulness) -> Option<f64>) -> Self {
        Self {
            name,
            value,
            good_range: [0.0, 0.0],
            is_fault: true,
        }
    }

    const fn comfort(
        name: &'static str,
        good_range: [f64; 2],
        value: fn(&TrafficUsefulness) -> Option<f64>,
    ) -> Self {
        Self {
            name,
            value,
            good_range,
            is_fault: false,
        }
    }
}

/// Range of a measure relative to `idm`.
const LIKE_IDM: [f64; 2] = [0.0, 1.0];

pub(super) const TRAFFIC_MEASURES: [TrafficMeasure; 10] = [
    TrafficMeasure::fault("collisions", |useful| Some(useful.collisions as f64)),
    TrafficMeasure::fault("hard unnecessary braking", |useful| {
        Some(useful.hard_braking as f64)
    }),
    TrafficMeasure::fault("falls behind", |useful| Some(useful.fell_behind as f64)),
    TrafficMeasure::fault("faults in everyday", |useful| {
        Some(useful.everyday.unwrap_or_default().faults as f64)
    }),
    TrafficMeasure::fault("faults in recorded drives", |useful| {
        Some(useful.recorded?.faults as f64)
    }),
    TrafficMeasure::comfort("rms acceleration, times idm", LIKE_IDM, |useful| {
        Some(useful.acceleration_times_idm)
    }),
    TrafficMeasure::comfort("rms jerk, times idm", LIKE_IDM, |useful| {
        Some(useful.jerk_times_idm)
    }),
    TrafficMeasure::comfort("rms jerk in everyday, times idm", LIKE_IDM, |useful| {
        Some(useful.everyday.unwrap_or_default().jerk_times_idm)
    }),
    TrafficMeasure::comfort(
        "rms jerk in recorded drives, times idm",
        LIKE_IDM,
        |useful| Some(useful.recorded?.jerk_times_idm),
    ),
    TrafficMeasure::comfort("mean time gap, s", TIME_GAP_RANGE_S, |useful| {
        Some(useful.mean_time_gap_s)
    }),
];

/// Rounds a measure for a text, in which counts have no decimal places.
pub(super) fn to_thousandths(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}

/// Distance of a measure of comfort outside its range that counts as unchanged, relative to the nearer end.
const COMFORT_TOLERANCE: f64 = 0.01;

/// Lists the measures that are worse, with the value that they are compared with: more faults than `before`, or comfort
/// further outside its range than that of the `initial` policy.
fn worse_in_traffic(
    initial: &TrafficUsefulness,
    before: &TrafficUsefulness,
    after: &TrafficUsefulness,
) -> Vec<(String, f64, f64)> {
    let worse = TRAFFIC_MEASURES.iter().filter_map(|measure| {
        let reference = if measure.is_fault { before } else { initial };
        let tolerance = if measure.is_fault {
            0.0
        } else {
            COMFORT_TOLERANCE
        };
        let [after, reference] = [(measure.value)(after)?, (measure.value)(reference)?];
        let [excess_after, excess] =
            [after, reference].map(|value| excess_over_range(value, measure.good_range));
        (excess_after > excess + tolerance).then(|| (measure.name.to_owned(), reference, after))
    });
    worse.collect()
}

/// Returns how far a value is outside a range, relative to the nearer end if that is above 1.
fn excess_over_range(value: f64, [low, high]: [f64; 2]) -> f64 {
    ((low - value) / low.max(1.0))
        .max((value - high) / high.max(1.0))
        .max(0.0)
}

pub(super) fn discordant_pairs(before: &[u64], after: &[u64]) -> DiscordantPairs {
    DiscordantPairs {
        only_second_fails: only_in_first(after, before).count() as u64,
        only_first_fails: only_in_first(before, after).count() as u64,
    }
}

impl Acceptance {
    /// True if the candidate replaces the policy before it.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        *self == Self::Accepted
    }
}

impl fmt::Display for Acceptance {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Accepted => out.write_str("accepted"),
            Self::Rejected { objections } => {
                let words: Vec<String> = objections.iter().map(ToString::to_string).collect();
                write!(out, "rejected: {}", words.join("; "))
            }
        }
    }
}

fn describe_worse_measure((measure, before, after): &(String, f64, f64)) -> String {
    format!(
        "{measure} {} instead of {}",
        to_thousandths(*after),
        to_thousandths(*before)
    )
}

fn describe_gain(gain: Option<f64>) -> String {
    gain.map_or("none".to_owned(), |gain| to_thousandths(gain).to_string())
}

impl fmt::Display for RejectionReason {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Paper { scenarios } => write!(out, "new collision in {}", scenarios.join(", ")),
            Self::Nominal { draws } => write!(
                out,
                "{} new collisions in random scenarios of the paper's distribution",
                draws.len()
            ),
            Self::ValidationSet { before, after } => write!(
                out,
                "{after} collisions in the validation set instead of {before}"
            ),
            Self::MoreCollisions { space, collisions } => write!(
                out,
                "{} new collisions and {} fixed in {space} (p = {})",
                collisions.only_second_fails,
                collisions.only_first_fails,
                format_rounded(collisions.p_value(), 2)
            ),
            Self::LessUseful { space, drives } => write!(
                out,
                "{} drives no longer useful and {} newly useful in {space} (p = {})",
                drives.only_second_fails,
                drives.only_first_fails,
                format_rounded(drives.p_value(), 2)
            ),
            Self::WorseInTraffic { measures } => {
                let measures: Vec<String> = measures.iter().map(describe_worse_measure).collect();
                write!(out, "in traffic {}", measures.join(", "))
            }
            Self::LineGain { before, after } => write!(
                out,
                "gain of a line of five {} instead of {}",
                describe_gain(*after),
                describe_gain(*before)
            ),
            Self::NothingFixed => {
                out.write_str("no fewer collisions in the validation set and in the cases")
            }
            Self::Unchanged => {
                out.write_str("no checkpoint was better than the policy before the round")
            }
            Self::Diverged { problem } => write!(out, "the training diverged: {problem}"),
        }
    }
}

#[cfg(test)]
mod tests;
