//! Acceptance of a round.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::RegressionResults;
use super::regression_spaces::SIGNIFICANCE;
use crate::rl::{TRAINING_LIMITS, TrafficUsefulness};
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
    #[serde(rename = "kept-aside")]
    ValidationSet {
        /// Collisions of the policy before it.
        before: usize,
        /// Collisions of the candidate.
        after: usize,
    },
    /// The candidate collides significantly more often in a regression space.
    #[serde(rename = "worse")]
    MoreCollisions {
        /// Name of the space.
        space: String,
        /// Scenarios in which exactly one of the two policies collides.
        contacts: DiscordantPairs,
    },
    /// The candidate is useful significantly less often in a regression space in which `idm` always is.
    LessUseful {
        /// Name of the space.
        space: String,
        /// Scenarios in which exactly one of the two policies is useful.
        drives: DiscordantPairs,
    },
    /// The candidate is less useful in everyday traffic.
    WorseInTraffic {
        /// Measures that are worse, each with its value before and after.
        measures: Vec<(String, f64, f64)>,
    },
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
        let Self { before, after, fixed, regressed } = self;
        write!(out, "{before} → {after} ({fixed}, {regressed})")
    }
}

fn only_in_first<'a, T: PartialEq>(one: &'a [T], other: &'a [T]) -> impl Iterator<Item = &'a T> {
    one.iter().filter(|item| !other.contains(item))
}

/// Accepts a candidate if it has no new failure in the paper's scenarios and distribution, no more collisions in the
/// validation set, and is not worse in any regression space. The latter is McNemar's exact one-sided test on paired
/// scenarios ([`DiscordantPairs`]) at [`SIGNIFICANCE`] for each space and property.
#[must_use]
pub fn decide_acceptance(before: &RegressionResults, after: &RegressionResults) -> Acceptance {
    let mut objections = Vec::new();
    let scenarios: Vec<String> = only_in_first(&after.paper, &before.paper).cloned().collect();
    if !scenarios.is_empty() {
        objections.push(RejectionReason::Paper { scenarios });
    }
    let draws: Vec<u64> = only_in_first(&after.nominal, &before.nominal).copied().collect();
    if !draws.is_empty() {
        objections.push(RejectionReason::Nominal { draws });
    }
    for after in &after.regression {
        let Some(before) = before.regression.iter().find(|before| before.space == after.space) else { continue };
        let contacts = discordant_pairs(&before.contacts, &after.contacts);
        if contacts.is_worse(SIGNIFICANCE) {
            objections.push(RejectionReason::MoreCollisions { space: after.space.clone(), contacts });
        }
        let usefulness = before.not_useful.as_ref().zip(after.not_useful.as_ref());
        let drives = usefulness.map(|(before, after)| discordant_pairs(before, after));
        if let Some(drives) = drives.filter(|drives| drives.is_worse(SIGNIFICANCE)) {
            objections.push(RejectionReason::LessUseful { space: after.space.clone(), drives });
        }
    }
    if let (Some(before), Some(after)) = (&before.usefulness, &after.usefulness) {
        let measures = worse_in_traffic(before, after);
        if !measures.is_empty() {
            objections.push(RejectionReason::WorseInTraffic { measures });
        }
    }
    let (before, after) = (before.validation_set.len(), after.validation_set.len());
    if after > before {
        objections.push(RejectionReason::ValidationSet { before, after });
    }
    if objections.is_empty() { Acceptance::Accepted } else { Acceptance::Rejected { objections } }
}

/// Names of the values of [`traffic_measures`].
pub(super) const TRAFFIC_MEASURES: [&str; 6] = [
    "collisions",
    "hard unnecessary braking",
    "left behind",
    "rms acceleration, times idm",
    "rms jerk, times idm",
    "mean time gap, s",
];

pub(super) fn traffic_measures(useful: &TrafficUsefulness) -> [f64; 6] {
    [
        useful.contacts as f64,
        useful.hard_braking as f64,
        useful.fell_behind as f64,
        useful.acceleration_times_idm,
        useful.jerk_times_idm,
        useful.mean_time_gap_s,
    ]
}

/// Rounds a measure for a text, in which counts have no decimal places.
pub(super) fn to_thousandths(value: f64) -> f64 {
    (1000.0 * value).round() / 1000.0
}

/// Relative increase of a measure of comfort that does not count as worse.
const COMFORT_TOLERANCE: f64 = 0.02;

/// Lists the measures that are worse: any more faults; comfort and mean time gap if clearly above both the value before
/// and that of `idm` or the limit.
fn worse_in_traffic(before: &TrafficUsefulness, after: &TrafficUsefulness) -> Vec<(String, f64, f64)> {
    let limits = [None, None, None, Some(1.0), Some(1.0), Some(TRAINING_LIMITS.time_gap_range_s[1])];
    let values = traffic_measures(before).into_iter().zip(traffic_measures(after));
    let all = TRAFFIC_MEASURES.into_iter().zip(limits).zip(values);
    all.filter(|((_, limit), (before, after))| {
        *after > limit.map_or(*before, |limit: f64| limit.max(*before) * (1.0 + COMFORT_TOLERANCE))
    })
    .map(|((name, _), (before, after))| (name.to_owned(), before, after))
    .collect()
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

impl fmt::Display for RejectionReason {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Paper { scenarios } => write!(out, "new collision in {}", scenarios.join(", ")),
            Self::Nominal { draws } => {
                write!(out, "{} new collisions in random scenarios of the paper's distribution", draws.len())
            }
            Self::ValidationSet { before, after } => {
                write!(out, "{after} collisions in the validation set instead of {before}")
            }
            Self::MoreCollisions {
                space,
                contacts: pairs @ DiscordantPairs { only_second_fails, only_first_fails },
            } => {
                let p = format_rounded(pairs.p_value(), 2);
                write!(out, "{only_second_fails} new collisions and {only_first_fails} fixed in {space} (p = {p})")
            }
            Self::LessUseful { space, drives: pairs @ DiscordantPairs { only_second_fails, only_first_fails } } => {
                let (new, fixed, p) = (only_second_fails, only_first_fails, format_rounded(pairs.p_value(), 2));
                write!(out, "{new} drives no longer useful and {fixed} newly useful in {space} (p = {p})")
            }
            Self::WorseInTraffic { measures } => {
                let each = measures.iter().map(|(measure, before, after)| {
                    format!("{measure} {} instead of {}", to_thousandths(*after), to_thousandths(*before))
                });
                write!(out, "in traffic {}", each.collect::<Vec<_>>().join(", "))
            }
            Self::Unchanged => out.write_str("no checkpoint was better than the policy before the round"),
            Self::Diverged { problem } => write!(out, "the training diverged: {problem}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::retrain::RegressionSpaceResult;

    fn results(paper: &[&str], nominal: &[u64], kept_aside: &[u64]) -> RegressionResults {
        RegressionResults {
            paper: paper.iter().map(|&name| name.to_owned()).collect(),
            nominal: nominal.to_vec(),
            validation_set: kept_aside.to_vec(),
            ..RegressionResults::default()
        }
    }

    fn objections(before: &RegressionResults, after: &RegressionResults) -> Vec<RejectionReason> {
        match decide_acceptance(before, after) {
            Acceptance::Accepted => Vec::new(),
            Acceptance::Rejected { objections } => objections,
        }
    }

    #[test]
    fn each_objection_alone_rejects_and_old_failures_do_not() {
        let before = results(&["paper-3 (truth)"], &[4], &[1, 2, 3]);
        assert_eq!(decide_acceptance(&before, &before), Acceptance::Accepted, "no worse");
        let objections = |after| objections(&before, &after);
        assert_eq!(objections(results(&[], &[], &[7, 8, 9])), [], "others kept aside, but no more");
        let paper = RejectionReason::Paper { scenarios: vec!["paper-1 (kalman)".to_owned()] };
        assert_eq!(objections(results(&["paper-1 (kalman)"], &[4], &[])), [paper]);
        // A new failure is a regression even if the number of failures stays.
        assert_eq!(objections(results(&[], &[5], &[])), [RejectionReason::Nominal { draws: vec![5] }]);
        let validation_set = RejectionReason::ValidationSet { before: 3, after: 4 };
        assert_eq!(objections(results(&[], &[], &[1, 2, 3, 4])), [validation_set]);
        assert_eq!(objections(results(&["paper-1 (kalman)"], &[5], &[1, 2, 3, 4])).len(), 3);
    }

    #[test]
    fn one_space_cannot_be_traded_for_another() {
        let in_spaces = |high_risk: &[u64], of_no_use: &[u64]| {
            let space = |name: &str, contacts: &[u64], of_no_use| RegressionSpaceResult {
                space: name.to_owned(),
                sample_count: 100,
                contacts: contacts.to_vec(),
                not_useful: of_no_use,
            };
            let traffic = space("traffic", &[], Some(of_no_use.to_vec()));
            RegressionResults {
                regression: vec![space("high-risk", high_risk, None), traffic],
                ..results(&[], &[], &[1, 2])
            }
        };
        let before = in_spaces(&[1, 2, 3], &[5]);
        let objections = |high_risk: &[u64], of_no_use: &[u64]| {
            let after = RegressionResults { validation_set: vec![], ..in_spaces(high_risk, of_no_use) };
            objections(&before, &after)
        };
        assert!(objections(&[4, 5, 6, 7], &[5, 6]).is_empty(), "within chance");
        let many: Vec<u64> = (10..30).collect();
        let contacts = DiscordantPairs { only_second_fails: 20, only_first_fails: 3 };
        let worse = RejectionReason::MoreCollisions { space: "high-risk".to_owned(), contacts };
        assert_eq!(objections(&many, &[]), [worse]);
        let drives = DiscordantPairs { only_second_fails: 20, only_first_fails: 1 };
        assert_eq!(objections(&[], &many), [RejectionReason::LessUseful { space: "traffic".to_owned(), drives }]);
    }

    #[test]
    fn one_measure_of_usability_cannot_be_traded_for_another() {
        let useful = TrafficUsefulness {
            scenario_count: 1000,
            contacts: 0,
            hard_braking: 3,
            fell_behind: 0,
            acceleration_times_idm: 1.1,
            jerk_times_idm: 0.9,
            mean_time_gap_s: 1.9,
        };
        let before = RegressionResults { usefulness: Some(useful), ..results(&[], &[], &[]) };
        let worse = |usefulness| {
            let after = RegressionResults { usefulness: Some(usefulness), ..before.clone() };
            objections(&before, &after).iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert!(worse(TrafficUsefulness { acceleration_times_idm: 1.12, jerk_times_idm: 1.01, ..useful }).is_empty());
        assert!(worse(TrafficUsefulness { hard_braking: 2, mean_time_gap_s: 1.99, ..useful }).is_empty());
        let hard = worse(TrafficUsefulness { hard_braking: 4, jerk_times_idm: 0.5, ..useful });
        assert_eq!(hard, ["in traffic hard unnecessary braking 4 instead of 3"]);
        let jerk = worse(TrafficUsefulness { hard_braking: 0, jerk_times_idm: 1.1, ..useful });
        assert_eq!(jerk, ["in traffic rms jerk, times idm 1.1 instead of 0.9"]);
    }

    proptest! {
        #[test]
        fn changes_add_up(
            before in proptest::collection::btree_set(0..40_u64, 0..20),
            after in proptest::collection::btree_set(0..40_u64, 0..20),
        ) {
            let lists = [before, after].map(|set| set.into_iter().collect::<Vec<_>>());
            let change = FailureChange::between(&lists[0], &lists[1]);
            prop_assert_eq!(change.before - change.fixed, change.after - change.regressed);
            let passed = decide_acceptance(&results(&[], &lists[0], &[]), &results(&[], &lists[1], &[])).is_accepted();
            prop_assert_eq!(passed, change.regressed == 0);
        }
    }
}
