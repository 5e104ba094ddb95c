//! Certificates of an assessment: those of kernels, those counted for it, those that were given.

use crumple_verify::reach::Ranges;
use crumple_verify::{Accepted, Assumption, Certificate, Reach, Registration, Statement, check_with};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::assessment::work::Work;
use crate::assessment::{AssessError, AssessmentPlan, StoreError};
use crumple_search::evidence::{RateConfig, RatePlan, shipped_kernels};
use crumple_world::digest::sha256;
use crumple_world::scenario::space::{Space, built_in_space};
use crumple_world::sim::{ControllerKind, NamedController};

/// A certificate and what the checker said of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proof {
    /// Its name.
    pub name: String,
    /// What kind of statement it makes.
    pub statement: &'static str,
    /// What it is about.
    pub about: String,
    /// Where it lies, from the folder of the report.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Which of this report's controllers it is about: one, or the two compared.
    pub controllers: Vec<String>,
    /// The confidence with which it holds; none if it holds without a doubt.
    pub confidence: Option<f64>,
    /// What the checker said.
    pub status: ProofStatus,
    /// What it takes for granted.
    pub assumptions: Vec<Assumption>,
    /// The file itself.
    #[serde(skip)]
    pub(in crate::assessment) text: String,
}

/// What the checker said of a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ProofStatus {
    /// It proves what it states.
    Accepted {
        /// What that is.
        shown: String,
        /// Upper bound of a rate, rounded by nobody.
        rate_at_most: Option<f64>,
        /// Share of a box that is free of contact, rounded by nobody.
        verified_share: Option<f64>,
    },
    /// It proves nothing.
    Rejected {
        /// Why.
        reason: String,
    },
}

impl ProofStatus {
    pub(super) fn words(&self) -> String {
        match self {
            Self::Accepted { shown, .. } => shown.clone(),
            Self::Rejected { reason } => format!("rejected: {reason}"),
        }
    }

    fn of(certificate: &Certificate, policy: Option<&[u8]>) -> Self {
        let accepted = match check_with(certificate, policy) {
            Ok(accepted) => accepted,
            Err(rejection) => return Self::Rejected { reason: rejection.to_string() },
        };
        let (mut rate_at_most, mut verified_share) = (None, None);
        match accepted {
            Accepted::Rate { at_most, .. } => rate_at_most = Some(at_most),
            Accepted::Reach { verified_share: share, .. } => verified_share = Some(share),
            _ => {}
        }
        Self::Accepted { shown: shown(&accepted), rate_at_most, verified_share }
    }
}

impl Proof {
    /// Whether the checker accepted it.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        matches!(self.status, ProofStatus::Accepted { .. })
    }

    /// The upper bound of that controller's rate, and the share of a box it keeps free of contact, where accepted.
    pub(super) fn shown_of(&self, controller: &str) -> (Option<f64>, Option<f64>) {
        match self.status {
            ProofStatus::Accepted { rate_at_most, verified_share, .. } if self.controllers == [controller] => {
                (rate_at_most, verified_share)
            }
            _ => (None, None),
        }
    }
}

/// What was accepted, with numbers a reader can take in: gaps and shares rounded down, rates up.
fn shown(accepted: &Accepted) -> String {
    let down = |value: f64| (100.0 * value).floor() / 100.0;
    match accepted {
        Accepted::Rate { at_most, confidence } => {
            format!("at most {:.4} % of runs fail, at confidence {} %", 100.0 * at_most + 5e-5, 100.0 * confidence)
        }
        Accepted::Reach { verified_share, smallest_gap_m, .. } => format!(
            "from {:.2} % of the box nobody touches, and no gap is ever smaller than {:.2} m",
            down(100.0 * verified_share),
            down(*smallest_gap_m)
        ),
        other => other.to_string(),
    }
}

/// Kernels, counted rates of every learned controller, a comparison with the first controller, and what was given.
pub(super) fn gather(plan: &AssessmentPlan, work: &Work<'_>) -> Result<Vec<Proof>, AssessError> {
    let mut proofs = shipped_kernels()
        .into_iter()
        .map(|(name, certificate)| proof(plan, name, &certificate, None, work))
        .collect::<Result<Vec<_>, _>>()?;
    proofs.extend(counted(plan, work)?);
    let given = plan.certificates.par_iter();
    let given = given.map(|one| proof(plan, one.name.clone(), &one.certificate, one.policy.as_deref(), work));
    proofs.extend(given.collect::<Result<Vec<_>, _>>()?);
    Ok(proofs)
}

fn proof(
    plan: &AssessmentPlan,
    name: String,
    certificate: &Certificate,
    policy: Option<&[u8]>,
    work: &Work<'_>,
) -> Result<Proof, AssessError> {
    let text = serde_json::to_string_pretty(certificate).map_err(StoreError::encoding)? + "\n";
    let sha256 = sha256(&text);
    // Whatever the policy is, the statement names it by its hash.
    let status = work
        .store
        .get(&format!("certificate {name}"), &sha256, || Ok::<_, AssessError>(ProofStatus::of(certificate, policy)))?;
    Ok(Proof {
        statement: certificate.statement.name(),
        about: about(certificate),
        file: format!("certificates/{name}.json"),
        sha256,
        controllers: controllers(plan, &certificate.statement),
        confidence: match &certificate.statement {
            Statement::Rate(rate) => Some(rate.registration.confidence),
            Statement::Comparison(two) => Some(two.registration.confidence),
            _ => None,
        },
        status,
        assumptions: certificate.assumptions.clone(),
        text,
        name,
    })
}

fn about(certificate: &Certificate) -> String {
    match &certificate.statement {
        Statement::Rate(rate) => {
            let of = |key: &str| rate.registration.configuration.get(key).map_or("", String::as_str);
            format!("{} in {} runs of space `{}`", of("controller"), rate.registration.runs, of("space"))
        }
        Statement::Comparison(two) => {
            let of = |key: &str| two.registration.configuration.get(key).map_or("", String::as_str);
            let (first, second) = (of("controller"), of("against"));
            format!("{first} against {second} in {} runs of space `{}`", two.registration.runs, of("space"))
        }
        Statement::Reach(reach) => {
            format!("a box of starts around {}: {}", certificate.provenance.scenario, ranges(reach))
        }
        Statement::Kernel(_) => "any two vehicles of these classes, on a dry road".to_owned(),
        _ => certificate.provenance.scenario.clone(),
    }
}

/// What varies in a box, in the order of the certificate.
fn ranges(reach: &Reach) -> String {
    let Ranges { gap_ahead_m, gap_behind_m, leader_speed_mps, ego_speed_mps, .. } = reach.ranges;
    let Ranges { follower_speed_mps, leader_brake_mps2, follower_brake_mps2, onset_steps, .. } = reach.ranges;
    let in_seconds = |steps: f64| steps * reach.step_s;
    let all = [
        ("gap ahead", "m", (gap_ahead_m.low(), gap_ahead_m.high())),
        ("gap behind", "m", (gap_behind_m.low(), gap_behind_m.high())),
        ("leader", "m/s", (leader_speed_mps.low(), leader_speed_mps.high())),
        ("ego", "m/s", (ego_speed_mps.low(), ego_speed_mps.high())),
        ("follower", "m/s", (follower_speed_mps.low(), follower_speed_mps.high())),
        ("leader brakes at", "m/s²", (leader_brake_mps2.low(), leader_brake_mps2.high())),
        ("from", "s", (in_seconds(onset_steps.low()), in_seconds(onset_steps.high()))),
        ("follower brakes at", "m/s²", (follower_brake_mps2.low(), follower_brake_mps2.high())),
    ];
    let words = all.map(|(name, unit, (low, high))| match low == high {
        true => format!("{name} {low} {unit}"),
        false => format!("{name} {low} to {high} {unit}"),
    });
    words.join(", ")
}

fn controllers(plan: &AssessmentPlan, statement: &Statement) -> Vec<String> {
    let registered = |registration: &Registration, keys: &[&str]| {
        keys.iter().filter_map(|&key| registration.configuration.get(key).cloned()).collect()
    };
    match statement {
        Statement::Rate(rate) => registered(&rate.registration, &["controller"]),
        Statement::Comparison(two) => registered(&two.registration, &["controller", "against"]),
        // The policy as it is: a shield before it makes another controller.
        Statement::Reach(reach) => {
            let is_it = |one: &&NamedController| {
                !matches!(one.kind, ControllerKind::Shielded(_))
                    && one.policy().is_some_and(|policy| policy.digest() == reach.policy_sha256)
            };
            plan.controllers.iter().find(is_it).map(|one| one.name.clone()).into_iter().collect()
        }
        _ => Vec::new(),
    }
}

/// The seed of counted runs: not that of the draws that are reported elsewhere.
const SEED_APART: u64 = 0x5eed;

fn counted(plan: &AssessmentPlan, work: &Work<'_>) -> Result<Vec<Proof>, AssessError> {
    let Some(space) = built_in_space("paper").filter(|_| plan.config.rates.runs > 0) else { return Ok(Vec::new()) };
    let learned = plan.controllers.iter().enumerate().filter(|(_, controller)| controller.policy().is_some());
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
    let counted =
        wanted.into_iter().map(|(name, controller, against)| count(plan, work, &name, &space, controller, against));
    // Counts that do not show that one controller fails less often are no proof of anything, and none that was rejected.
    let says_something = |proof: &Proof| proof.statement != "comparison" || proof.is_accepted();
    counted.filter(|proof| proof.as_ref().map_or(true, says_something)).collect()
}

fn count(
    plan: &AssessmentPlan,
    work: &Work<'_>,
    name: &str,
    space: &Space,
    controller: NamedController,
    against: Option<NamedController>,
) -> Result<Proof, AssessError> {
    let identities: Vec<_> = std::iter::once(&controller).chain(&against).map(|one| plan.identity(one)).collect();
    let rates = RatePlan::new(RateConfig {
        controllers: (controller, against),
        space: ("paper".to_owned(), space.clone()),
        seed: plan.config.seed ^ SEED_APART,
        estimator: plan.config.estimator,
        runs: plan.config.rates.runs,
        confidence: plan.config.rates.confidence,
    })?;
    let inputs = json!([rates.registration(), identities]);
    let text: String = work.store.get(name, &inputs, || {
        let mut tally = rates.tally();
        while tally.runs < plan.config.rates.runs {
            let before = tally.runs;
            rates.count_block(&mut tally)?;
            work.did(tally.runs - before);
        }
        Ok::<_, AssessError>(serde_json::to_string(&rates.certificate(&tally)).map_err(StoreError::encoding)?)
    })?;
    let certificate = Certificate::from_json(&text).map_err(|error| AssessError::Certificate(error.to_string()))?;
    proof(plan, name.to_owned(), &certificate, None, work)
}
