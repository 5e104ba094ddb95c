//! Runs that are counted for certificates of a report.

use crumple_verify::{Certificate, Registration, Statement};

use super::certified::{Proof, ProofStatus, between, counts_others, proof};
use crate::assessment::claims::Strength;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::work::Work;
use crate::assessment::{AssessError, AssessmentPlan, Rounded, StoreError};
use crumple_evidence::{RateConfig, RatePlan, shipped_kernels};
use crumple_world::sim::NamedController;

/// The seed of counted runs: not that of the draws that are reported elsewhere.
const SEED_APART: u64 = 0x5eed;

/// What is counted for a certificate: under which name, in which space, of whom, against whom.
struct Counted<'a> {
    name: String,
    space: &'a NamedSpace,
    controller: NamedController,
    against: Option<NamedController>,
}

/// The names of certificates that are made for a report.
pub(in crate::assessment) fn made_here(plan: &AssessmentPlan) -> Vec<String> {
    let kernels = shipped_kernels().into_iter().map(|(name, _)| name);
    kernels.chain(to_be_counted(plan).into_iter().map(|counted| counted.name)).collect()
}

fn to_be_counted(plan: &AssessmentPlan) -> Vec<Counted<'_>> {
    if plan.config.rates.runs == 0 {
        return Vec::new();
    }
    let learned = plan.controllers.iter().enumerate().filter(|(_, controller)| controller.kind.is_learned());
    let mut wanted: Vec<(String, NamedController, Option<NamedController>)> =
        learned.map(|(index, one)| (format!("rate-{}", plan.slug(index)), one.clone(), None)).collect();
    if let (Some(subject), Some(first)) = (plan.subject(), plan.controllers.first())
        && plan.subject != 0
    {
        wanted.push((
            format!("{}-against-{}", plan.slug(plan.subject), plan.slug(0)),
            subject.clone(),
            Some(first.clone()),
        ));
    }
    // Only what states an identity can be spoken of.
    wanted.retain(|(_, one, other)| std::iter::once(one).chain(other).all(|of| of.kind.identity().is_some()));
    let several = plan.distributions.len() > 1;
    let mut counted = Vec::new();
    for space in &plan.distributions {
        for (name, controller, against) in wanted.clone() {
            let name = if several { format!("{name}-{}", file_stem(space.space.name())) } else { name };
            counted.push(Counted { name, space, controller, against });
        }
    }
    counted
}

pub(super) fn gather(plan: &AssessmentPlan, work: &Work<'_>) -> Result<Vec<Proof>, AssessError> {
    let proofs = to_be_counted(plan).into_iter().map(|counted| count(plan, work, counted));
    proofs.collect()
}

/// The names of those that are counted.
pub(in crate::assessment) fn names(plan: &AssessmentPlan) -> Vec<String> {
    to_be_counted(plan).into_iter().map(|counted| counted.name).collect()
}

/// That of a name.
pub(in crate::assessment) fn gather_one(plan: &AssessmentPlan, name: &str, work: &Work<'_>) -> Result<(), AssessError> {
    let named = to_be_counted(plan).into_iter().find(|counted| counted.name == name);
    named.map_or(Ok(()), |counted| count(plan, work, counted).map(drop))
}

fn count(plan: &AssessmentPlan, work: &Work<'_>, counted: Counted<'_>) -> Result<Proof, AssessError> {
    let Counted { name, space, controller, against } = counted;
    let rates = RatePlan::new(RateConfig {
        against,
        seed: plan.config.seed ^ SEED_APART,
        estimator: plan.config.estimator,
        confidence: plan.config.rates.confidence,
        ..RateConfig::new(controller, space.space.clone(), plan.config.rates.runs)
    })?;
    // A line with the certificate, and one with who gave no answer, if somebody did.
    let kept: String = work.get(&name, rates.registration(), || {
        let mut tally = rates.tally();
        while tally.runs < plan.config.rates.runs {
            let before = tally.runs;
            rates.count_block(&mut tally)?;
            work.did(tally.runs - before)?;
        }
        let text = serde_json::to_string(&rates.certificate(&tally)).map_err(StoreError::encoding)?;
        Ok::<_, AssessError>(match tally.unanswered_words() {
            silent if silent.is_empty() => text,
            silent => format!("{text}\n{silent}"),
        })
    })?;
    let (text, silent) = kept.split_once('\n').unwrap_or((&kept, ""));
    let certificate = Certificate::from_json(text).map_err(|error| AssessError::Certificate(error.to_string()))?;
    let mut proof = proof(plan, name, &certificate, None)?;
    let counts_others = counts_others(plan, &certificate.statement);
    if let Some(status) = in_vain(&certificate.statement, counts_others, silent).filter(|_| !proof.is_accepted()) {
        proof.status = status;
    }
    Ok(proof)
}

/// What becomes of counts that were made here and do not show what they were to show: they are no proof, and none that was
/// tampered with.
fn in_vain(statement: &Statement, counts_others: bool, silent: &str) -> Option<ProofStatus> {
    match statement {
        Statement::Comparison(two) => {
            let (only_first, only_second) = (two.only_first_failed, two.only_second_failed);
            let Registration { runs, confidence, .. } = two.registration;
            Some(ProofStatus::NothingShown {
                counted: format!(
                    "only the first failed in {only_first} runs, only the second in {only_second}{silent}"
                ),
                strength: Strength::CountedInVain { confidence_percent: Rounded::down(100.0 * confidence), runs },
            })
        }
        Statement::Rate(rate) => Some(ProofStatus::NothingShown {
            counted: format!("{} of {} runs failed{silent}", rate.failures, rate.registration.runs),
            strength: between(rate, 1.0, counts_others),
        }),
        _ => None,
    }
}
