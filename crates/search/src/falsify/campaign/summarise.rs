//! Creation of a summary from findings.

use super::failures::FailureGroup;
use super::findings::{CampaignFindings, MethodResults};
use super::resolved_config::ResolvedConfig;
use super::summary::{
    AvoidabilitySummary, CampaignSummary, ConfirmationSummary, FailureKindSummary,
    FailuresByMethod, MethodSummary, SUMMARY_VERSION,
};
use super::{Campaign, CampaignError};
use crate::falsify::counterexample::Counterexample;
use crumple_core::digest::sha256;
use crumple_sim::engine::FailedControllerRuns;

impl CampaignSummary {
    /// Creates the summary from findings and the recorded distinct failures.
    pub(super) fn from_findings(
        campaign: &Campaign,
        config: &ResolvedConfig,
        findings: &CampaignFindings,
        counterexamples: Vec<Counterexample>,
    ) -> Result<Self, CampaignError> {
        let CampaignFindings {
            method_results: results,
            failures,
        } = findings;
        let record = &config.record;
        let main = results.first();
        Ok(Self {
            version: SUMMARY_VERSION,
            configuration_sha256: sha256(record.to_toml()?),
            subject: campaign.subject()?,
            failure_criterion: record.failure_criterion.clone(),
            method: record.search.method.name().to_owned(),
            objective: record.search.objective.name().to_owned(),
            budget: record.search.budget,
            evaluations: main.map_or(0, |results| results.evaluations),
            falsified: results.iter().any(|results| results.failures > 0),
            first_falsification: main.and_then(|results| results.first),
            best_robustness: main.and_then(|results| finite_or_none(results.best)),
            methods: results.iter().map(MethodSummary::from_results).collect(),
            failures: failures
                .by_frequency()
                .into_iter()
                .map(|kind| FailureKindSummary::from_failures(kind, config, &counterexamples))
                .collect(),
            avoidability: AvoidabilitySummary::from_counterexamples(&counterexamples),
            multi_body: ConfirmationSummary::from_counterexamples(&counterexamples),
            counterexamples,
        })
    }
}

impl MethodSummary {
    fn from_results(results: &MethodResults) -> Self {
        Self {
            method: results.method.name().to_owned(),
            evaluations: results.evaluations,
            first_falsification: results.first,
            failures: results.failures,
            best_robustness: finite_or_none(results.best),
            second_missing_answers: results.second_missing_answers.as_ref().map(|unanswered| {
                FailedControllerRuns {
                    runs: unanswered.runs,
                    reason: unanswered.reason.clone(),
                }
            }),
        }
    }
}

impl FailureKindSummary {
    fn from_failures(
        kind: &FailureGroup,
        config: &ResolvedConfig,
        examined: &[Counterexample],
    ) -> Self {
        let by_method =
            |(method, count, first): &(crate::falsify::Method, u64, u64)| FailuresByMethod {
                method: method.name().to_owned(),
                count: *count,
                first: *first,
            };
        let description = kind.kind.describe(&config.nominal);
        Self {
            reason: examined
                .iter()
                .find(|failure| failure.kind == description)
                .and_then(|failure| failure.reason.clone()),
            kind: description,
            failed_vehicle: match kind.kind {
                super::FailureKind::ControllerFailed { vehicle } => Some(vehicle),
                _ => None,
            },
            front_vehicle: kind.kind.vehicles().map(|[front, _]| front),
            rear_vehicle: kind.kind.vehicles().map(|[_, rear]| rear),
            count: kind.count(),
            by_method: kind.by_method.iter().map(by_method).collect(),
        }
    }
}

fn finite_or_none(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}
