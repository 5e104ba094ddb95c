//! Runs that are counted for certificates of a report.

use crumple_verify::rate::binomial_tail_upper_bound;
use crumple_verify::{Certificate, ComparisonClaim, RateClaim, Registration, Statement};
use serde::{Deserialize, Serialize};

use super::certificate_subject::includes_others;
use super::certificates::{
    CertificateStatus, CheckedCertificate, check_certificate, rate_strength,
};
use super::sampling::{draw_scenarios, simulate_each};
use crate::assessment::claims::{MIN_CONFIDENCE_PERCENT, RandomScenario, Strength};
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, Rounded};
use crumple_evidence::{CountTally, RateConfig, RatePlan, Rerun, shipped_kernels};
use crumple_sim::engine::{NamedController, Outcome, RecordingLevel, RunOptions};

/// Mask of the seed of counted runs, so that it differs from the seed of the reported samples.
pub(super) const COUNT_SEED_MASK: u64 = 0x5eed;

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
    let mut counts = Vec::new();
    for space in &plan.rate_spaces {
        counts.extend(planned_counts_in(plan, space));
    }
    // A claim needs a controller with an identity.
    counts.retain(PlannedRateCount::has_identities);
    counts
}

/// Returns the counts in one space: each learned controller, and the subject against the first controller.
fn planned_counts_in<'a>(
    plan: &AssessmentPlan,
    space: &'a NamedSpace,
) -> Vec<PlannedRateCount<'a>> {
    let suffix = if plan.rate_spaces.len() > 1 {
        format!("-{}", file_stem(space.space.name()))
    } else {
        String::new()
    };
    let mut counts = Vec::new();
    for (index, controller) in plan.controllers.iter().enumerate() {
        if controller.source.is_learned() {
            counts.push(PlannedRateCount {
                name: format!("rate-{}{suffix}", plan.controller_slug(index)),
                space,
                controller: controller.clone(),
                against: None,
            });
        }
    }
    if let (Some(subject), Some(first)) = (plan.subject(), plan.controllers.first())
        && plan.subject_index != 0
    {
        let own = plan.controller_slug(plan.subject_index);
        let other = plan.controller_slug(0);
        counts.push(PlannedRateCount {
            name: format!("{own}-against-{other}{suffix}"),
            space,
            controller: subject.clone(),
            against: Some(first.clone()),
        });
    }
    counts
}

impl PlannedRateCount<'_> {
    fn has_identities(&self) -> bool {
        std::iter::once(&self.controller)
            .chain(&self.against)
            .all(|controller| controller.source.identity().is_some())
    }

    pub(in crate::assessment) fn gather(
        self,
        work: &GatherContext<'_>,
    ) -> Result<CheckedCertificate, AssessError> {
        let plan = work.plan;
        let seed = plan.config.seed ^ COUNT_SEED_MASK;
        let rates = RatePlan::new(RateConfig {
            second_controller: self.against.clone(),
            seed,
            estimator: plan.config.estimator,
            confidence: plan.config.rates.confidence,
            ..RateConfig::new(
                self.controller.clone(),
                self.space.space.clone(),
                plan.config.rates.runs,
            )
        })?;
        let counted: CountedRuns = work.get_or_gather(&self.name, rates.registration(), || {
            self.count_runs(&rates, work)
        })?;
        let certificate = Certificate::from_json(&counted.certificate)
            .map_err(|error| AssessError::Certificate(error.to_string()))?;
        let mut proof = check_certificate(plan, self.name, &certificate, None)?;
        proof.first_violation = RandomScenario::new(seed, counted.first_violation);
        let counts_others = includes_others(plan, &certificate.statement);
        match &mut proof.status {
            CertificateStatus::Accepted { shown, .. } => shown.push_str(&counted.unanswered),
            status => {
                let not_shown = not_shown_status(&certificate.statement, counts_others, &counted);
                if let Some(not_shown) = not_shown {
                    *status = not_shown;
                }
            }
        }
        proof.unanswered = counted.unanswered;
        Ok(proof)
    }

    fn count_runs(
        &self,
        rates: &RatePlan,
        work: &GatherContext<'_>,
    ) -> Result<CountedRuns, AssessError> {
        let mut tally = rates.empty_tally();
        while tally.runs < work.plan.config.rates.runs {
            let before = tally.runs;
            rates.count_batch(&mut tally)?;
            work.add_runs(tally.runs - before)?;
        }
        let certificate = rates.certificate(&tally);
        Ok(CountedRuns {
            certificate: serde_json::to_string(&certificate).map_err(CacheError::encoding)?,
            unanswered: tally.missing_answers_summary(),
            unanswered_runs: tally
                .missing_answers()
                .map(|missing| missing.map_or(0, |missing| missing.runs)),
            first_violation: self.find_violation(rates, &tally, work.plan)?,
        })
    }

    /// Returns the index of the first run in which the controller failed and, if there is another one, that did not.
    /// Simulates the runs of one block again, because a tally has only their counts.
    fn find_violation(
        &self,
        rates: &RatePlan,
        tally: &CountTally,
        plan: &AssessmentPlan,
    ) -> Result<Option<u64>, AssessError> {
        let mut blocks = tally.blocks.iter();
        let block = blocks.position(|block| match self.against {
            Some(_) => block.only_first_failed > 0,
            None => block.failures > 0,
        });
        let Some(block) = block else {
            return Ok(None);
        };
        let runs = rates.run_range(block as u64);
        let seed = plan.config.seed ^ COUNT_SEED_MASK;
        let scenarios = draw_scenarios(&self.space.space, seed, runs.clone())?;
        let fails = |controller: &NamedController| {
            let options =
                RunOptions::new(controller.source.clone()).with_estimator(plan.config.estimator);
            simulate_each(
                &scenarios,
                &options,
                RecordingLevel::Summary,
                |_, simulated| !matches!(simulated.outcome, Outcome::NoCollision),
            )
        };
        let own = fails(&self.controller)?;
        let other = match &self.against {
            Some(against) => fails(against)?,
            None => vec![false; own.len()],
        };
        let mut failures = runs.zip(own.into_iter().zip(other));
        let first = failures.find(|(_, (own, other))| *own && !*other);
        Ok(first.map(|(index, _)| index))
    }
}

/// Counted runs, in the form of the cache.
#[derive(Serialize, Deserialize)]
struct CountedRuns {
    /// Text of the certificate.
    certificate: String,
    /// Controllers that gave no answer, in words; empty if there are none.
    unanswered: String,
    /// Runs without an answer of the controller, and of the other one.
    unanswered_runs: [u64; 2],
    /// Index of the first run that violates the statement.
    first_violation: Option<u64>,
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
    identities
        .into_iter()
        .flatten()
        .map(|identity| {
            let controller = plan
                .controllers
                .iter()
                .find(|controller| controller.source.identity().as_ref() == Some(identity))?;
            controller_arg(&*controller.source)
        })
        .collect()
}

/// Returns the status of a count that does not show its claim: no proof, and no sign of tampering.
fn not_shown_status(
    statement: &Statement,
    counts_others: bool,
    counted: &CountedRuns,
) -> Option<CertificateStatus> {
    let unanswered = &counted.unanswered;
    match statement {
        Statement::Comparison(comparison) => Some(CertificateStatus::NothingShown {
            counted: format!(
                "only the first failed in {} runs, only the second in {}{unanswered}",
                comparison.only_first_failed, comparison.only_second_failed
            ),
            strength: strength_without_proof(comparison, counted.unanswered_runs),
        }),
        Statement::Rate(rate) => Some(unbounded_status(rate, counts_others, unanswered)),
        _ => None,
    }
}

/// Returns the strength of a comparison that the checker did not accept. The count refutes it if the same test, at the
/// same confidence level, shows that the first controller fails more often.
fn strength_without_proof(
    comparison: &ComparisonClaim,
    [unanswered, other_unanswered]: [u64; 2],
) -> Strength {
    let Registration {
        runs, confidence, ..
    } = comparison.registration;
    let confidence_percent = Rounded::down(100.0 * confidence);
    let only_own = comparison.only_first_failed;
    // The count leaves out runs without an answer of the second controller: here each is a failure of only this one.
    let only_other = comparison
        .only_second_failed
        .saturating_add(other_unanswered);
    let tail = binomial_tail_upper_bound(only_other, only_own.saturating_add(only_other), 0.5);
    if tail <= 1.0 - confidence && confidence_percent.value() >= MIN_CONFIDENCE_PERCENT {
        Strength::CountedAgainst {
            only_own,
            only_other,
            unanswered,
            confidence_percent,
            runs,
        }
    } else {
        Strength::NotShownByCounting {
            confidence_percent,
            runs,
        }
    }
}

/// Returns the status of a count that bounds no rate.
pub(super) fn unbounded_status(
    rate: &RateClaim,
    counts_others: bool,
    unanswered: &str,
) -> CertificateStatus {
    CertificateStatus::NothingShown {
        counted: format!(
            "{} of {} runs failed{unanswered}",
            rate.failures, rate.registration.runs
        ),
        strength: rate_strength(rate, 1.0, counts_others),
    }
}
