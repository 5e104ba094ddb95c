//! Results of evaluations.

use super::failures::Failures;
use super::resolved_config::ResolvedConfig;
use super::{EvaluatedPoint, FailureKind};
use crate::falsify::Method;

#[derive(Debug, Clone)]
pub(super) struct MethodResults {
    pub(super) method: Method,
    pub(super) evaluations: u64,
    pub(super) first: Option<u64>,
    pub(super) failures: u64,
    pub(super) best: f64,
    /// Evaluations for which the partner controller gave no answer.
    pub(super) second_missing_answers: Option<UnansweredPartnerRuns>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct UnansweredPartnerRuns {
    pub(super) runs: u64,
    /// Number of the first one, its values, and the reason.
    pub(super) first: u64,
    pub(super) values: Vec<f64>,
    pub(super) reason: String,
}

#[derive(Debug, Clone)]
pub(super) struct CampaignFindings {
    pub(super) method_results: Vec<MethodResults>,
    pub(super) failures: Failures,
}

impl MethodResults {
    pub(super) fn new(method: Method) -> Self {
        Self {
            method,
            evaluations: 0,
            first: None,
            failures: 0,
            best: f64::INFINITY,
            second_missing_answers: None,
        }
    }

    pub(super) fn add(&mut self, evaluated: &EvaluatedPoint, fails: bool) {
        self.evaluations += 1;
        if fails {
            self.failures += 1;
            self.first = self.first.or(Some(evaluated.number));
        }
        // If the own verdict is no violation, the failure is that of the partner controller.
        if evaluated.verdict.failure.is_some() && !evaluated.verdict.is_violation() {
            let unanswered =
                self.second_missing_answers
                    .get_or_insert_with(|| UnansweredPartnerRuns {
                        runs: 0,
                        first: evaluated.number,
                        values: evaluated.values.clone(),
                        reason: String::new(),
                    });
            unanswered.runs += 1;
        }
        self.best = self.best.min(evaluated.verdict.robustness);
    }
}

impl CampaignFindings {
    pub(super) fn new(config: &ResolvedConfig) -> Self {
        Self {
            method_results: Vec::new(),
            failures: Failures::new(config.specification.clone()),
        }
    }

    pub(super) fn add(&mut self, reached: &mut MethodResults, evaluated: &EvaluatedPoint) {
        let fails =
            FailureKind::from_verdict(&evaluated.verdict, &self.failures.specification).is_some();
        reached.add(evaluated, fails);
        self.failures.add(&reached.method, evaluated);
    }
}
