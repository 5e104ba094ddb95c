//! Results of evaluations, of a whole campaign or of a shard. The order of merging does not matter.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::coverage::Coverage;
use super::failures::Failures;
use super::regions::{LabelledPoints, MAX_POINTS, Region};
use super::resolved_config::ResolvedConfig;
use super::{EvaluatedPoint, FailureKind};
use crate::falsify::Method;

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MethodResults {
    pub(super) method: Method,
    pub(super) evaluations: u64,
    pub(super) first: Option<u64>,
    pub(super) failures: u64,
    #[serde(with = "crate::falsify::non_finite")]
    pub(super) best: f64,
    pub(super) coverage: Coverage,
    /// Failing evaluations among the first points, in order; only for a reference search.
    pub(super) failing: Vec<u64>,
    /// Evaluations for which the partner controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) other_unanswered: Option<UnansweredPartnerRuns>,
    /// Evaluations of infinite robustness: there is no partner scenario, or no vehicle to collide with.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub(super) unbounded: u64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct UnansweredPartnerRuns {
    pub(super) runs: u64,
    /// Number of the first one, its values, and the reason.
    pub(super) first: u64,
    pub(super) values: Vec<f64>,
    pub(super) because: String,
}

#[derive(Debug, Clone)]
pub(super) struct CampaignFindings {
    pub(super) method_results: Vec<MethodResults>,
    pub(super) failures: Failures,
}

impl MethodResults {
    pub(super) fn new(method: Method, dimension: usize) -> Self {
        Self {
            method,
            evaluations: 0,
            first: None,
            failures: 0,
            best: f64::INFINITY,
            coverage: Coverage::new(dimension),
            failing: Vec::new(),
            other_unanswered: None,
            unbounded: 0,
        }
    }

    pub(super) fn add(&mut self, evaluated: &EvaluatedPoint, fails: bool) {
        self.evaluations += 1;
        if fails {
            self.failures += 1;
            self.first = self.first.or(Some(evaluated.number));
            if self.method.is_non_adaptive() && evaluated.number <= MAX_POINTS as u64 {
                self.failing.push(evaluated.number);
            }
        }
        self.unbounded +=
            u64::from(evaluated.verdict.failure.is_none() && evaluated.verdict.robustness == f64::INFINITY);
        // If the own verdict is no violation, the failure is that of the partner controller.
        if evaluated.verdict.failure.is_some() && !evaluated.verdict.is_violation() {
            let silent = self.other_unanswered.get_or_insert_with(|| UnansweredPartnerRuns {
                runs: 0,
                first: evaluated.number,
                values: evaluated.values.clone(),
                because: String::new(),
            });
            silent.runs += 1;
        }
        self.best = self.best.min(evaluated.verdict.robustness);
        self.coverage.add(&evaluated.point);
    }

    fn merge(&mut self, other: Self) {
        self.evaluations = self.evaluations.saturating_add(other.evaluations);
        self.failures = self.failures.saturating_add(other.failures);
        self.first = self.first.into_iter().chain(other.first).min();
        self.best = self.best.min(other.best);
        self.unbounded = self.unbounded.saturating_add(other.unbounded);
        match (&mut self.other_unanswered, other.other_unanswered) {
            (Some(known), Some(other)) => {
                let runs = known.runs.saturating_add(other.runs);
                if other.first < known.first {
                    *known = other;
                }
                known.runs = runs;
            }
            (None, other) => self.other_unanswered = other,
            (Some(_), None) => {}
        }
        self.coverage.merge(&other.coverage);
        self.failing.extend(other.failing);
        self.failing.sort_unstable();
    }

    /// Returns true if the evaluations `made`, in a space of that dimension, can have these results.
    pub(super) fn is_consistent_with(&self, made: &Range<u64>, dimension: usize) -> bool {
        let is_made = |number: &u64| made.contains(&number.wrapping_sub(1));
        let sampled = if self.method.is_non_adaptive() { MAX_POINTS as u64 } else { 0 };
        self.evaluations == made.end - made.start
            && self.failures.saturating_add(self.unbounded) <= self.evaluations
            && self
                .other_unanswered
                .iter()
                .all(|silent| is_made(&silent.first) && (1..=self.evaluations - self.failures).contains(&silent.runs))
            && self.first.is_some() == (self.failures > 0)
            && self.first.iter().all(is_made)
            && !self.best.is_nan()
            && (self.best < 0.0) == (self.failures > 0)
            && self.coverage.has_dimension(dimension)
            && self.failing.is_sorted_by(|one, other| one < other)
            && self.failing.iter().all(|number| is_made(number) && *number <= sampled)
            && self.failing.len() as u64 <= self.failures
    }
}

impl CampaignFindings {
    pub(super) fn new(terms: &ResolvedConfig) -> Self {
        Self { method_results: Vec::new(), failures: Failures::new(terms.specification.clone()) }
    }

    pub(super) fn merge(&mut self, other: Self, methods: &[Method]) {
        if self.method_results.is_empty() {
            self.method_results = other.method_results;
        } else {
            self.method_results.iter_mut().zip(other.method_results).for_each(|(own, other)| own.merge(other));
        }
        self.failures.merge(other.failures, methods);
    }

    pub(super) fn add(&mut self, reached: &mut MethodResults, evaluated: &EvaluatedPoint) {
        let fails = FailureKind::from_verdict(&evaluated.verdict, &self.failures.specification).is_some();
        reached.add(evaluated, fails);
        self.failures.add(&reached.method, evaluated);
    }

    /// Finds regions with the first points of the reference searches, generated again. Skips missing evaluations.
    pub(super) fn find_regions(&self, terms: &ResolvedConfig, missing: &[Range<u64>]) -> Vec<Region> {
        let mut sample = LabelledPoints::default();
        let is_missing = |index: u64| {
            let after = missing.partition_point(|range| range.end <= index);
            missing.get(after).is_some_and(|range| range.contains(&index))
        };
        for reached in self.method_results.iter().filter(|reached| reached.method.is_non_adaptive()) {
            let mut search = reached.method.start(&terms.cube, terms.record.seed);
            let most = terms.record.budget.min(MAX_POINTS as u64);
            let mut points = Vec::new().into_iter();
            for index in 0..most {
                if sample.is_full() {
                    break;
                }
                if points.len() == 0 {
                    points = search.ask().into_iter();
                }
                if let (Some(point), false) = (points.next(), is_missing(index)) {
                    sample.add(terms.space.values(&point), reached.failing.binary_search(&(index + 1)).is_ok());
                }
            }
        }
        sample.find_regions(&terms.space)
    }
}
