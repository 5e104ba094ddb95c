//! Severity against likelihood: the failures that no other beats in both.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

use super::{FailureCandidate, FailureKind};
use crumple_world::measure::Specification;
use crumple_world::scenario::Scenario;

/// Most failures kept: a front of random points has some ten, and memory must not grow with the budget whatever they are.
const MAX_FAILURES: usize = 1000;

/// The Pareto front of all failing evaluations, the severest first: smaller robustness against greater likelihood, equal
/// likelihoods by nearness to nominal.
#[derive(Debug, Clone, Default)]
pub(super) struct ParetoFront {
    failures: Vec<FailureCandidate>,
}

/// A failure that no other one beats both in severity and in likelihood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Which method found it.
    pub method: String,
    /// At which of its evaluations, from 1: the row of the log.
    pub evaluation: u64,
    /// What happens, in words.
    pub kind: String,
    /// Robustness: the smaller, the severer.
    #[serde(with = "crate::falsify::non_finite")]
    pub robustness: f64,
    /// Difference of the speeds of the two vehicles that touch first, in m/s, if any do.
    pub impact_speed_mps: Option<f64>,
    /// Logarithm of the density under the space's distribution, relative to one that is even over the ranges.
    #[serde(with = "crate::falsify::non_finite")]
    pub ln_likelihood: f64,
    /// Distance from nominal, from 0 to 1: mean over the parameters of the difference, relative to the range.
    #[serde(rename = "departure")]
    pub distance_from_nominal: f64,
}

fn compare_likelihood(one: &FailureCandidate, other: &FailureCandidate) -> Ordering {
    let key = |candidate: &FailureCandidate| (candidate.ln_likelihood, -candidate.distance_from_nominal);
    key(one).partial_cmp(&key(other)).unwrap_or(Ordering::Equal)
}

impl ParetoFront {
    /// Of what another front held; in any order.
    pub(super) fn from_failures(failures: Vec<FailureCandidate>) -> Self {
        let mut front = Self::default();
        failures.iter().for_each(|failure| front.insert(failure, usize::MAX));
        front
    }

    pub(super) fn add(&mut self, candidate: &FailureCandidate) {
        self.insert(candidate, MAX_FAILURES);
    }

    /// Takes in one of another front; of equal ones the earlier stays. Whatever the order, all that nothing beats is there in the end.
    pub(super) fn merge(&mut self, candidate: &FailureCandidate, is_earlier: impl Fn(&FailureCandidate) -> bool) {
        let is_equal = |known: &&mut FailureCandidate| {
            known.verdict.robustness.total_cmp(&candidate.verdict.robustness) == Ordering::Equal
                && compare_likelihood(known, candidate) == Ordering::Equal
        };
        match self.failures.iter_mut().find(is_equal) {
            Some(known) if is_earlier(known) => *known = candidate.clone(),
            Some(_) => {}
            None => self.insert(candidate, usize::MAX),
        }
    }

    /// All of it; of more than are kept, some evenly over its length.
    pub(super) fn thin(mut self) -> Self {
        let all = self.failures.len();
        if all > MAX_FAILURES {
            let last = all - 1;
            let mut chosen = (0..MAX_FAILURES).map(|place| place * last / (MAX_FAILURES - 1)).peekable();
            let mut index = 0..all;
            self.failures.retain(|_| index.next().is_some_and(|index| chosen.next_if_eq(&index).is_some()));
        }
        self
    }

    pub(super) fn failures(&self) -> &[FailureCandidate] {
        &self.failures
    }

    fn insert(&mut self, candidate: &FailureCandidate, most: usize) {
        // Severest first means least likely first; a failure that beats the new one is at its place or before it.
        let severity = |known: &FailureCandidate| known.verdict.robustness.total_cmp(&candidate.verdict.robustness);
        let place = self.failures.partition_point(|known| severity(known) == Ordering::Less);
        let milder = self.failures.partition_point(|known| severity(known) != Ordering::Greater);
        let likeliest_before = milder.checked_sub(1).and_then(|index| self.failures.get(index));
        if likeliest_before.is_some_and(|known| compare_likelihood(known, candidate) != Ordering::Less) {
            return;
        }
        let beaten = self.failures.iter().skip(place);
        let beaten = beaten.take_while(|known| compare_likelihood(known, candidate) != Ordering::Greater).count();
        if beaten == 0 && self.failures.len() >= most {
            return;
        }
        self.failures.splice(place..place + beaten, [candidate.clone()]);
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
        /// What is kept is what brute force finds, whatever the order, the ties and the infinities.
        #[test]
        fn the_front_is_that_of_brute_force(found in prop::collection::vec((0..9_i8, 0..9_i8, 0..3_i8), 1..60)) {
            let candidates: Vec<FailureCandidate> = found.iter().zip(1..).map(|(&(deep, likely, far), number)| FailureCandidate {
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
