//! The order of two strengths of one claim.

use std::cmp::Ordering;

use crate::assessment::claims::{RateBounds, Strength};

/// Compares two strengths of a claim: greater is better. `None` if neither is better.
///
/// A claim that is no longer refuted, or is shown, is better, whatever its evidence. Numbers are compared only if they
/// count the same: more failures are worse, and a failure that became unavoidable is not better. `has_other_domain`
/// states that the evidence is about other runs, such as a search in place of random scenarios.
pub(super) fn compare_strengths(
    before: &Strength,
    now: &Strength,
    has_other_domain: bool,
) -> Option<Ordering> {
    match now.rank().cmp(&before.rank()) {
        Ordering::Equal if before == now => Some(Ordering::Equal),
        Ordering::Equal if has_other_domain => None,
        Ordering::Equal => compare_numbers(before, now),
        decided => Some(decided),
    }
}

/// Compares the numbers of two strengths of equal rank.
fn compare_numbers(before: &Strength, now: &Strength) -> Option<Ordering> {
    if let (Some(before), Some(now)) = (failing_runs(before), failing_runs(now)) {
        return compare_failures(before, now);
    }
    match (before, now) {
        (
            Strength::Falsified {
                failures: before,
                avoidable: before_avoidable,
                ..
            },
            Strength::Falsified {
                failures,
                avoidable,
                ..
            },
        ) => compare_searches([before, before_avoidable], [failures, avoidable]),
        (Strength::Tested { runs: before }, Strength::Tested { runs }) => Some(runs.cmp(before)),
        (
            Strength::PartlyTested {
                undecided: before,
                runs: before_runs,
            },
            Strength::PartlyTested { undecided, runs },
        ) if runs == before_runs => Some(before.cmp(undecided)),
        (Strength::Proved { .. }, Strength::Proved { .. }) => Some(Ordering::Equal),
        (
            Strength::PartlyProved {
                share_percent: before,
            },
            Strength::PartlyProved { share_percent },
        ) => Some(share_percent.value().total_cmp(&before.value())),
        (
            Strength::Counted {
                confidence_percent: before,
                ..
            },
            Strength::Counted {
                confidence_percent, ..
            },
        ) => Some(confidence_percent.value().total_cmp(&before.value())),
        // More failures of the other controller are no improvement of the subject.
        (
            Strength::Compared {
                own: before,
                runs: before_runs,
                ..
            },
            Strength::Compared { own, runs, .. },
        ) => (own != before && runs == before_runs).then(|| before.cmp(own)),
        (
            Strength::Gain {
                largest: before, ..
            },
            Strength::Gain { largest, .. },
        ) => Some(before.value().total_cmp(&largest.value())),
        _ => compare_bounds(before.rate_bounds()?, now.rate_bounds()?),
    }
}

/// Compares the distinct and the avoidable failures of two searches.
fn compare_searches(
    [before, before_avoidable]: [&usize; 2],
    [failures, avoidable]: [&usize; 2],
) -> Option<Ordering> {
    match (failures.cmp(before), avoidable.cmp(before_avoidable)) {
        (Ordering::Greater, _) | (Ordering::Equal, Ordering::Greater) => Some(Ordering::Less),
        (Ordering::Equal, Ordering::Equal) => Some(Ordering::Equal),
        (Ordering::Equal, Ordering::Less) | (Ordering::Less, Ordering::Greater) => None,
        (Ordering::Less, _) => Some(Ordering::Greater),
    }
}

/// Returns the failing runs, those without an answer among them, and all runs, also without a failure. For a
/// comparison, those of the subject.
pub(super) fn counted_failures(strength: &Strength) -> Option<[u64; 2]> {
    match *strength {
        Strength::Tested { runs } => Some([0, runs]),
        Strength::Compared { own, runs, .. } => Some([own, runs]),
        _ => failing_runs(strength),
    }
}

/// Returns the failing runs, those without an answer among them, and all runs.
fn failing_runs(strength: &Strength) -> Option<[u64; 2]> {
    match *strength {
        Strength::Refuted { failures, runs } => Some([failures, runs]),
        Strength::FailedPoints { failures, points } => Some([failures, points]),
        Strength::Unanswered {
            unanswered,
            failures,
            runs,
            ..
        } => Some([unanswered.saturating_add(failures), runs]),
        _ => None,
    }
}

/// Compares failing and all runs. Fewer failures are better only if their share is not larger.
fn compare_failures(
    [before, before_runs]: [u64; 2],
    [failures, runs]: [u64; 2],
) -> Option<Ordering> {
    let share_before = before as f64 / before_runs.max(1) as f64;
    let share = failures as f64 / runs.max(1) as f64;
    match failures.cmp(&before) {
        Ordering::Less if share > share_before => None,
        order => Some(order.reverse()),
    }
}

/// Compares bounds of equal confidence levels: lower ones are better, and narrower ones are neither.
fn compare_bounds(before: RateBounds, now: RateBounds) -> Option<Ordering> {
    if before.confidence_percent() != now.confidence_percent() {
        return None;
    }
    let lower = before.lower_percent().total_cmp(&now.lower_percent());
    let upper = before.upper_percent().total_cmp(&now.upper_percent());
    match (lower, upper) {
        (lower, upper) if lower == upper => Some(lower),
        (Ordering::Equal, order) | (order, Ordering::Equal) => Some(order),
        _ => None,
    }
}
