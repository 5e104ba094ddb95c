//! Pareto front of severity and likelihood.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

use super::{FailureCandidate, FailureKind};
use crumple_world::measure::Specification;
use crumple_world::scenario::Scenario;

/// Maximum number of failures on the front. A front of random points has about ten failures. The limit keeps memory
/// independent of the budget.
const MAX_FAILURES: usize = 1000;

/// The Pareto front of severity and likelihood, the severest failure first. Of two failures with equal likelihood, the
/// one nearer to nominal counts as likelier.
#[derive(Debug, Clone, Default)]
pub(super) struct ParetoFront {
    failures: Vec<FailureCandidate>,
}

/// A failure on the Pareto front of severity and likelihood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Method that found it.
    pub method: String,
    /// Number of the evaluation of this method, from 1; identifies the row of the log.
    pub evaluation: u64,
    /// Description of the failure.
    pub kind: String,
    /// Robustness; smaller is severer.
    #[serde(with = "crate::falsify::non_finite")]
    pub robustness: f64,
    /// Relative speed of the first collision, in m/s; `None` without a collision.
    pub impact_speed_mps: Option<f64>,
    /// Logarithm of the density under the space's distribution, relative to the uniform density.
    #[serde(with = "crate::falsify::non_finite")]
    pub ln_likelihood: f64,
    /// Distance from nominal, from 0 to 1: mean over the parameters of the difference relative to the range.
    #[serde(rename = "departure")]
    pub distance_from_nominal: f64,
}

fn compare_likelihood(one: &FailureCandidate, other: &FailureCandidate) -> Ordering {
    let key = |candidate: &FailureCandidate| (candidate.ln_likelihood, -candidate.distance_from_nominal);
    key(one).partial_cmp(&key(other)).unwrap_or(Ordering::Equal)
}

impl ParetoFront {
    pub(super) fn add(&mut self, candidate: &FailureCandidate) {
        // The front is sorted by severity, so likelihood increases along it. A failure that dominates the new one is at
        // the index of the new one or before.
        let severity = |known: &FailureCandidate| known.verdict.robustness.total_cmp(&candidate.verdict.robustness);
        let place = self.failures.partition_point(|known| severity(known) == Ordering::Less);
        let milder = self.failures.partition_point(|known| severity(known) != Ordering::Greater);
        let likeliest_before = milder.checked_sub(1).and_then(|index| self.failures.get(index));
        if likeliest_before.is_some_and(|known| compare_likelihood(known, candidate) != Ordering::Less) {
            return;
        }
        let dominated = self.failures.iter().skip(place);
        let dominated = dominated.take_while(|known| compare_likelihood(known, candidate) != Ordering::Greater).count();
        if dominated == 0 && self.failures.len() >= MAX_FAILURES {
            return;
        }
        self.failures.splice(place..place + dominated, [candidate.clone()]);
    }

    pub(super) fn points(&self, specification: &Specification, nominal: &Scenario) -> Vec<FrontPoint> {
        let point = |failure: &FailureCandidate| FrontPoint {
            method: failure.method.name().to_owned(),
            evaluation: failure.number,
            kind: FailureKind::from_verdict(&failure.verdict, specification)
                .map_or(String::new(), |kind| kind.describe(nominal)),
            robustness: failure.verdict.robustness,
            impact_speed_mps: failure.verdict.contact.map(|contact| contact.impact_speed_mps),
            ln_likelihood: failure.ln_likelihood,
            distance_from_nominal: failure.distance_from_nominal,
        };
        self.failures.iter().map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::Method;
    use crumple_world::measure::RunVerdict;
    use proptest::prelude::*;

    proptest! {
        /// The front equals that of a brute-force search, for any order, ties and infinities.
        #[test]
        fn the_front_is_that_of_brute_force(found in prop::collection::vec((0..9_i8, 0..9_i8, 0..3_i8), 1..60)) {
            let candidates: Vec<_> = found.iter().zip(1..).map(|(&(deep, likely, far), number)| FailureCandidate {
                method: Method::Uniform,
                number,
                values: Vec::new(),
                verdict: RunVerdict::new(-1.0 - f64::from(deep)),
                ln_likelihood: if likely == 0 { f64::NEG_INFINITY } else { f64::from(likely) },
                distance_from_nominal: f64::from(far) / 4.0,
            }).collect();
            let mut front = ParetoFront::default();
            candidates.iter().for_each(|candidate| front.add(candidate));
            let key = |c: &FailureCandidate| (-c.verdict.robustness, (c.ln_likelihood, -c.distance_from_nominal));
            let beats = |a: &FailureCandidate, b: &FailureCandidate| {
                let ((s, l), (t, m)) = (key(a), key(b));
                s >= t && l >= m && ((s, l) != (t, m) || a.number < b.number)
            };
            let mut expected: Vec<u64> = candidates
                .iter()
                .filter(|one| !candidates.iter().any(|other| other.number != one.number && beats(other, one)))
                .map(|one| one.number)
                .collect();
            let mut kept: Vec<u64> = front.failures.iter().map(|one| one.number).collect();
            prop_assert!(front.failures.is_sorted_by(|a, b| key(a).0 > key(b).0 && key(a).1 < key(b).1));
            expected.sort_unstable();
            kept.sort_unstable();
            prop_assert_eq!(kept, expected);
        }
    }
}
