//! Runs that are counted for certificates of a report.

use crumple_verify::{Certificate, Registration, Statement};

use super::certificate_subject::includes_others;
use super::certificates::{
    CertificateStatus, CheckedCertificate, check_certificate, rate_strength,
};
use crate::assessment::claims::Strength;
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, Rounded};
use crumple_evidence::{RateConfig, RatePlan, Rerun, shipped_kernels};
use crumple_world::sim::NamedController;

/// Mask of the seed of counted runs, so that it differs from the seed of the reported samples.
const COUNT_SEED_MASK: u64 = 0x5eed;

/// A planned count: name of the certificate, scenario space, controller, and the other controller of a comparison.
#[derive(Clone)]
pub(in crate::assessment) struct PlannedRateCount<'a> {
    pub(in crate::assessment) name: String,
    space: &'a NamedSpace,
    controller: NamedController,
    against: Option<NamedController>,
}

pub(in crate::assessment) fn generated_certificate_names(plan: &AssessmentPlan) -> Vec<String> {
    let kernels = shipped_kernels().into_iter().map(|(name, _)| name);
    kernels
        .chain(
            planned_rate_counts(plan)
                .into_iter()
                .map(|counted| counted.name),
        )
        .collect()
}

pub(in crate::assessment) fn planned_rate_counts(
    plan: &AssessmentPlan,
) -> Vec<PlannedRateCount<'_>> {
    if plan.config.rates.runs == 0 {
        return Vec::new();
    }
    let learned = plan
        .controllers
        .iter()
        .enumerate()
        .filter(|(_, controller)| controller.source.is_learned());
    let mut wanted: Vec<(String, NamedController, Option<NamedController>)> = learned
        .map(|(index, one)| {
            (
                format!("rate-{}", plan.controller_slug(index)),
                one.clone(),
                None,
            )
        })
        .collect();
    if let (Some(subject), Some(first)) = (plan.subject(), plan.controllers.first())
        && plan.subject_index != 0
    {
        let name = format!(
            "{}-against-{}",
            plan.controller_slug(plan.subject_index),
            plan.controller_slug(0)
        );
        wanted.push((name, subject.clone(), Some(first.clone())));
    }
    // A claim needs a controller with an identity.
    wanted.retain(|(_, one, other)| {
        std::iter::once(one)
            .chain(other)
            .all(|of| of.source.identity().is_some())
    });
    let several = plan.rate_spaces.len() > 1;
    let mut counted = Vec::new();
    for space in &plan.rate_spaces {
        for (name, controller, against) in wanted.clone() {
            let name = if several {
                format!("{name}-{}", file_stem(space.space.name()))
            } else {
                name
            };
            counted.push(PlannedRateCount {
                name,
                space,
                controller,
                against,
            });
        }
    }
    counted
}

impl PlannedRateCount<'_> {
    pub(in crate::assessment) fn gather(
        self,
        work: &GatherContext<'_>,
    ) -> Result<CheckedCertificate, AssessError> {
        let plan = work.plan;
        let rates = RatePlan::new(RateConfig {
            second_controller: self.against,
            seed: plan.config.seed ^ COUNT_SEED_MASK,
            estimator: plan.config.estimator,
            confidence: plan.config.rates.confidence,
            ..RateConfig::new(
                self.controller,
                self.space.space.clone(),
                plan.config.rates.runs,
            )
        })?;
        // First line: the certificate. Second line, if needed: the controllers that gave no answer.
        let kept: String = work.get_or_gather(&self.name, rates.registration(), || {
            let mut tally = rates.empty_tally();
            while tally.runs < plan.config.rates.runs {
                let before = tally.runs;
                rates.count_batch(&mut tally)?;
                work.add_runs(tally.runs - before)?;
            }
            let text =
                serde_json::to_string(&rates.certificate(&tally)).map_err(CacheError::encoding)?;
            Ok::<_, AssessError>(match tally.missing_answers_summary() {
                unanswered if unanswered.is_empty() => text,
                unanswered => format!("{text}\n{unanswered}"),
            })
        })?;
        let (text, unanswered) = kept.split_once('\n').unwrap_or((&kept, ""));
        let certificate = Certificate::from_json(text)
            .map_err(|error| AssessError::Certificate(error.to_string()))?;
        let mut proof = check_certificate(plan, self.name, &certificate, None)?;
        let counts_others = includes_others(plan, &certificate.statement);
        if let Some(status) = not_shown_status(&certificate.statement, counts_others, unanswered)
            .filter(|_| !proof.is_accepted())
        {
            proof.status = status;
        }
        Ok(proof)
    }
}

/// Returns the controllers, as arguments in the report folder, with which `check --rerun` repeats the counts of a
/// certificate; `None` if it has no counts, or the folder lacks a controller.
pub(super) fn recount_controllers(
    plan: &AssessmentPlan,
    certificate: &Certificate,
) -> Option<Vec<String>> {
    let registration = match &certificate.statement {
        Statement::Rate(claim) => &claim.registration,
        Statement::Comparison(claim) => &claim.registration,
        _ => return None,
    };
    if Rerun::new(certificate, &[], plan.config.controllers_of_files).is_ok() {
        return Some(Vec::new());
    }
    Rerun::new(
        certificate,
        &plan.controllers,
        plan.config.controllers_of_files,
    )
    .ok()?;
    let identities =
        ["controller_sha256", "against_sha256"].map(|key| registration.configuration.get(key));
    let argument = |identity: &String| {
        let is_it = |one: &&NamedController| one.source.identity().as_ref() == Some(identity);
        controller_arg(&*plan.controllers.iter().find(is_it)?.source)
    };
    identities.into_iter().flatten().map(argument).collect()
}

/// Returns the status of a count that does not show its claim: no proof, and no sign of tampering.
fn not_shown_status(
    statement: &Statement,
    counts_others: bool,
    unanswered: &str,
) -> Option<CertificateStatus> {
    match statement {
        Statement::Comparison(two) => {
            let (only_first, only_second) = (two.only_first_failed, two.only_second_failed);
            let Registration {
                runs, confidence, ..
            } = two.registration;
            Some(CertificateStatus::NothingShown {
                counted: format!(
                    "only the first failed in {only_first} runs, only the second in {only_second}{unanswered}"
                ),
                strength: Strength::NotShownByCounting {
                    confidence_percent: Rounded::down(100.0 * confidence),
                    runs,
                },
            })
        }
        Statement::Rate(rate) => Some(CertificateStatus::NothingShown {
            counted: format!(
                "{} of {} runs failed{unanswered}",
                rate.failures, rate.registration.runs
            ),
            strength: rate_strength(rate, 1.0, counts_others),
        }),
        _ => None,
    }
}
