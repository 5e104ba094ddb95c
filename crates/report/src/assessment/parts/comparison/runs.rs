//! Random runs behind results. Results of another number of runs, or of another seed, differ also for an equal
//! controller.

use std::cmp::Ordering;

use serde::Deserialize;
use serde_json::Value;

use super::fact::read;
use super::order::counted_failures;
use crate::assessment::claims::{AssuranceClaim, Domain, EvidenceSource, Property, Strength};
use crumple_evidence::RateInterval;
use crumple_sim::observation::EstimatorKind;

/// Confidence level of the intervals of two failure rates from different runs: if these are disjoint, the rates differ.
const CONFIDENCE: f64 = 0.999;

/// Source of random runs. Only runs of one source can be compared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RunOrigin {
    pub(super) controller: String,
    pub(super) estimator: EstimatorKind,
    pub(super) space_sha256: String,
    pub(super) is_search: bool,
}

/// Random scenarios, or points of a search, that a controller ran.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RandomRuns {
    pub(super) origin: RunOrigin,
    pub(super) seed: Option<u64>,
    /// Number of random scenarios, or simulations of each method of a search.
    pub(super) count: u64,
    /// Bounds of the failure rate in percent, if the runs bound it.
    pub(super) bounds_percent: Option<[f64; 2]>,
}

impl RandomRuns {
    /// Returns the runs behind a piece of evidence; `None` if these are not random.
    pub(super) fn from_evidence(evidence: &Value) -> Option<Self> {
        let claim: AssuranceClaim = read(evidence, "claim").ok()?;
        // The derived function of that name does not read files of 0.3.0.
        let strength = <Strength as Deserialize>::deserialize(evidence).ok()?;
        let source: EvidenceSource = read(evidence, "source").ok()?;
        let (space, is_search, seed, count) = match &claim.domain {
            Domain::Draws { space, seed, draws } => (space, false, Some(*seed), *draws),
            Domain::Search {
                space,
                seed,
                budget,
            } => (space, true, Some(*seed), *budget),
            Domain::Space { space } => (space, false, source.seed, counted_runs(&strength)?),
            _ => return None,
        };
        let bounds = strength.rate_bounds();
        Some(Self {
            origin: RunOrigin {
                controller: claim.subject.controller.name.clone(),
                estimator: claim.subject.estimator,
                space_sha256: space.sha256.clone(),
                is_search,
            },
            seed,
            count,
            bounds_percent: bounds.map(|bounds| [bounds.lower_percent(), bounds.upper_percent()]),
        })
    }

    /// Returns the runs behind all evidence of an `assessment.json`.
    pub(super) fn all(evidence: &Value) -> Vec<Self> {
        let pieces = evidence.get("evidence").and_then(Value::as_array);
        let pieces = pieces.into_iter().flatten();
        pieces.filter_map(Self::from_evidence).collect()
    }

    /// True for the search of a space, by the hash of its content, with a controller.
    pub(super) fn is_search_of(&self, controller: &str, space: &str) -> bool {
        let origin = &self.origin;
        origin.is_search && origin.controller == controller && origin.space_sha256 == space
    }

    /// Describes the difference from earlier runs of the same controller in the same space; `None` if there is none, or
    /// if the runs are of another kind.
    pub(super) fn difference(&self, before: &Self) -> Option<&'static str> {
        if self.origin != before.origin {
            return None;
        }
        let order = self.count.cmp(&before.count);
        match (self.origin.is_search, self.seed == before.seed, order) {
            (_, true, Ordering::Equal) => None,
            (true, true, Ordering::Greater) => Some("larger search"),
            (true, true, Ordering::Less) => Some("smaller search"),
            (true, false, _) => Some("search with another seed"),
            (false, true, Ordering::Greater) => Some("more runs"),
            (false, true, Ordering::Less) => Some("fewer runs"),
            (false, false, _) => Some("runs of another seed"),
        }
    }

    /// Describes the difference from the runs of an earlier assessment; `None` if they contain these, or it has no such
    /// runs.
    pub(super) fn difference_from_all(&self, earlier: &[Self]) -> Option<&'static str> {
        let like = earlier.iter().filter(|runs| runs.origin == self.origin);
        let contains = |runs: &&Self| {
            runs.seed == self.seed && runs.seed.is_some() && runs.count >= self.count
        };
        if like.clone().any(|runs| contains(&runs)) {
            return None;
        }
        let best = like.max_by_key(|runs| (runs.seed == self.seed, runs.count));
        best.and_then(|runs| self.difference(runs))
    }
}

/// Returns the number of counted runs behind a rate or a comparison.
fn counted_runs(strength: &Strength) -> Option<u64> {
    match strength {
        Strength::Between { runs, .. }
        | Strength::Counted { runs, .. }
        | Strength::NotShownByCounting { runs, .. }
        | Strength::CountedAgainst { runs, .. } => Some(*runs),
        _ => None,
    }
}

/// Compares two strengths of a claim from different runs: greater is better. `None` if the difference may be that of
/// the runs.
pub(super) fn compare_other_runs(
    (before, before_runs): (&Strength, &RandomRuns),
    (now, now_runs): (&Strength, &RandomRuns),
) -> Option<Ordering> {
    if before == now {
        return Some(Ordering::Equal);
    }
    if now_runs.origin.is_search {
        return compare_searches(before, now)
            .filter(|order| is_better_not_smaller(*order, before_runs, now_runs));
    }
    if let (Some(before), Some(now)) = (before_runs.bounds_percent, now_runs.bounds_percent) {
        return compare_disjoint(before, now);
    }
    match (before, now) {
        (Strength::Counted { .. }, Strength::CountedAgainst { .. }) => Some(Ordering::Less),
        (Strength::CountedAgainst { .. }, Strength::Counted { .. }) => Some(Ordering::Greater),
        _ => compare_counts(
            (counted_failures(before)?, before_runs),
            (counted_failures(now)?, now_runs),
        ),
    }
}

/// Compares two searches of which only one found a failure.
fn compare_searches(before: &Strength, now: &Strength) -> Option<Ordering> {
    match (before, now) {
        (Strength::Tested { .. }, Strength::Falsified { .. }) => Some(Ordering::Less),
        (Strength::Falsified { .. }, Strength::Tested { .. }) => Some(Ordering::Greater),
        _ => None,
    }
}

/// True if the search without a failure is not the smaller one, and both have the same seed.
fn is_better_not_smaller(order: Ordering, before: &RandomRuns, now: &RandomRuns) -> bool {
    let is_larger = match order {
        Ordering::Less => before.count >= now.count,
        _ => now.count >= before.count,
    };
    is_larger && before.seed == now.seed && now.seed.is_some()
}

/// Compares failing and all runs: by those that both made, which are the first of one seed, or else by the intervals of
/// both rates.
fn compare_counts(
    (before, before_runs): ([u64; 2], &RandomRuns),
    (now, now_runs): ([u64; 2], &RandomRuns),
) -> Option<Ordering> {
    let common = before_runs.count.min(now_runs.count);
    let failures_in_common = |[failures, _]: [u64; 2], runs: &RandomRuns| {
        let others = runs.count - common;
        [failures.saturating_sub(others), failures.min(common)].map(|failures| failures as f64)
    };
    let has_common = before_runs.seed == now_runs.seed && now_runs.seed.is_some();
    let in_common = has_common.then(|| {
        let before = failures_in_common(before, before_runs);
        compare_disjoint(before, failures_in_common(now, now_runs))
    });
    let interval = |[failures, runs]: [u64; 2]| {
        let interval = RateInterval::clopper_pearson(failures.min(runs), runs, CONFIDENCE);
        [interval.lower, interval.upper]
    };
    in_common
        .flatten()
        .or_else(|| compare_disjoint(interval(before), interval(now)))
}

/// Compares two ranges of failures: the lower one is better, if they are disjoint.
fn compare_disjoint(before: [f64; 2], now: [f64; 2]) -> Option<Ordering> {
    if now[0] > before[1] {
        Some(Ordering::Less)
    } else if now[1] < before[0] {
        Some(Ordering::Greater)
    } else {
        None
    }
}

/// Returns a text that is equal for claims which differ in the number or the seed of their random runs only; `None` for
/// a claim about other domains.
pub(super) fn family(claim: &AssuranceClaim, part: &str) -> Option<String> {
    let (space, kind) = match &claim.domain {
        Domain::Draws { space, .. } => (space, "draws"),
        Domain::Search { space, .. } => (space, "search"),
        _ => return None,
    };
    let estimator = claim.subject.estimator.name();
    let property = match &claim.property {
        Property::FailsLessOften { than } => format!("fails less often than {}", than.name),
        property => format!("{property:?}"),
    };
    Some(format!(
        "{part} {kind} {} {estimator} {property}",
        space.sha256
    ))
}
