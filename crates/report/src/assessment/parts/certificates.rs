//! Certificates of an assessment: of kernels, of counted rates, and given ones.

use crumple_controllers::Controllers;
use crumple_verify::{
    Assumption, Certificate, ComparisonClaim, ProvedClaim, RateClaim, Registration, Statement,
    WorkLimit,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::certificate_subject::{certificate_subject, describe_statement, includes_others};
use super::rate_certificates::{planned_rate_counts, recount_controllers, unbounded_status};
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, MIN_CONFIDENCE_PERCENT, Property,
    RandomScenario, Strength, Subject,
};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::file_stem;
use crate::assessment::{AssessError, AssessmentPlan, CacheError, Rounded};
use crumple_evidence::{CertificateReport, RateInterval, kernel_certificate, shipped_kernels};
use crumple_sim::control::{MIN_MARGIN_M, ShieldKind, ShieldSettings, ViabilityKernel};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{PAPER_STEP_S, VehicleClass};

/// A certificate and the result of its check.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CheckedCertificate {
    /// Name of the certificate.
    pub name: String,
    /// Kind of statement.
    pub statement: &'static str,
    /// Description of the certificate's content.
    pub about: String,
    /// Path relative to the report folder; absent if the checker did not accept the certificate, which is not written.
    pub file: Option<String>,
    /// SHA-256 of the certificate, as `crumple check` prints it.
    pub sha256: String,
    /// Claim of this report that the certificate supports.
    pub subject: CertificateSubject,
    /// Result of the check.
    pub status: CertificateStatus,
    /// Assumptions of the statement.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<String>"))]
    pub assumptions: Vec<Assumption>,
    #[serde(skip)]
    pub(in crate::assessment) text: String,
    /// Controllers that `check --rerun` needs as arguments; `None` if it cannot repeat counts of the certificate.
    #[serde(skip)]
    pub(super) recount_controllers: Option<Vec<String>>,
    /// Seed of the counted runs.
    #[serde(skip)]
    counted_seed: Option<u64>,
    /// Statement, if it is about a kernel.
    #[serde(skip)]
    kernel: Option<Statement>,
    /// Statement, if it compares two controllers.
    #[serde(skip)]
    comparison: Option<ComparisonClaim>,
    /// Statement, if it is about a rate and counts only failures of the controller.
    #[serde(skip)]
    rate: Option<RateClaim>,
    /// First counted run that this assessment found to violate the statement.
    #[serde(skip)]
    pub(super) first_violation: Option<RandomScenario>,
    /// Missing answers in the counted runs, each after a semicolon; empty if there are none, or if they are unknown.
    #[serde(skip)]
    pub(super) unanswered: String,
}

/// Counted runs that two controllers made in the same scenarios.
#[derive(Debug, Clone)]
pub(in crate::assessment) struct CountedPairs {
    /// Runs in which only the first, and only the second, failed.
    pub(in crate::assessment) only_one_failed: [u64; 2],
    pub(in crate::assessment) runs: u64,
    /// Confidence level of the comparison.
    pub(in crate::assessment) confidence: f64,
    /// Missing answers, each after a semicolon.
    pub(in crate::assessment) unanswered: String,
}

/// The result of checking a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum CertificateStatus {
    /// The certificate proves its statement.
    Accepted {
        /// Proved statement in words.
        shown: String,
        /// Strength for the claim about a controller; absent if it makes none.
        strength: Option<Strength>,
    },
    /// The registered runs were counted, and do not show the claim, or refute it.
    NothingShown {
        /// Counts in words.
        counted: String,
        /// Strength for the claim.
        strength: Strength,
    },
    /// The certificate proves nothing.
    Rejected {
        /// Reason in words.
        reason: String,
    },
}

/// The claim of a report that a certificate supports; decided by hashes, never by names.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum CertificateSubject {
    /// A claim about a controller of the report, with equal hashes.
    Claim(Box<AssuranceClaim>),
    /// The kernel that shields use for a pair of brake limits.
    Kernel,
    /// A scene or a profile, without any controller.
    NoController,
    /// Nothing in this report.
    Unrelated {
        /// Reason in words.
        reason: String,
    },
}

impl CertificateSubject {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Claim(claim) => {
                let Subject {
                    controller,
                    estimator,
                } = &claim.subject;
                format!("{}, {}", controller.name, describe_estimator(*estimator))
            }
            Self::Kernel => "shields".to_owned(),
            Self::NoController => "no controller".to_owned(),
            Self::Unrelated { reason } => format!("none: {reason}"),
        }
    }
}

pub(super) fn describe_estimator(estimator: EstimatorKind) -> &'static str {
    match estimator {
        EstimatorKind::Truth => "with the true state",
        EstimatorKind::Kalman => "with the Kalman filter",
    }
}

impl CertificateStatus {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Accepted { shown, .. } => shown.clone(),
            Self::NothingShown { counted, strength } if strength.is_refutation() => {
                format!("refuted: {counted}")
            }
            Self::NothingShown { counted, .. } => format!("not shown: {counted}"),
            Self::Rejected { reason } => format!("rejected: {reason}"),
        }
    }

    /// Returns the strength for the claim about a controller, if the certificate makes one and was not rejected.
    fn strength(&self) -> Option<&Strength> {
        match self {
            Self::Accepted { strength, .. } => strength.as_ref(),
            Self::NothingShown { strength, .. } => Some(strength),
            Self::Rejected { .. } => None,
        }
    }

    fn check(
        certificate: &Certificate,
        policy: Option<&[u8]>,
        counts_others: bool,
        controllers: Controllers,
    ) -> Self {
        let report = CertificateReport::check(
            String::new(),
            certificate,
            policy,
            WorkLimit::default(),
            controllers,
        );
        let accepted = match report
            .map_err(|refused| refused.to_string())
            .and_then(|report| report.accepted)
        {
            Ok(accepted) => accepted,
            Err(reason) => return Self::Rejected { reason },
        };
        if let Statement::Rate(rate) = &certificate.statement
            && rate.rate_at_most >= 1.0
        {
            return unbounded_status(rate, counts_others, "");
        }
        Self::Accepted {
            shown: accepted.to_string(),
            strength: accepted_strength(&accepted, &certificate.statement, counts_others),
        }
    }
}

fn accepted_strength(
    accepted: &ProvedClaim,
    statement: &Statement,
    counts_others: bool,
) -> Option<Strength> {
    match (accepted, statement) {
        (ProvedClaim::Rate { max_rate, .. }, Statement::Rate(rate)) => {
            Some(rate_strength(rate, *max_rate, counts_others))
        }
        // Below the minimum confidence level it shows nothing.
        (ProvedClaim::FailsLessOften { confidence }, Statement::Comparison(comparison)) => {
            let confidence_percent = Rounded::down(100.0 * confidence);
            let runs = comparison.registration.runs;
            Some(match confidence_percent.value() >= MIN_CONFIDENCE_PERCENT {
                true => Strength::Counted {
                    confidence_percent,
                    runs,
                },
                false => Strength::NotShownByCounting {
                    confidence_percent,
                    runs,
                },
            })
        }
        // The certificate contains an initial state that ends in a collision.
        (
            ProvedClaim::Reach {
                falsified_share, ..
            },
            _,
        ) if *falsified_share > 0.0 => Some(Strength::Refuted {
            failures: 1,
            runs: 1,
        }),
        (ProvedClaim::Reach { verified_share, .. }, _) if *verified_share >= 1.0 => {
            Some(Strength::Proved { certificates: 1 })
        }
        (ProvedClaim::Reach { verified_share, .. }, _) => {
            let share_percent = Rounded::down(100.0 * verified_share);
            (share_percent.value() > 0.0).then_some(Strength::PartlyProved { share_percent })
        }
        _ => None,
    }
}

/// Returns the bounds from counted runs: the upper one as certified, the lower one from the same count at the same
/// confidence level. The lower bound is 0 if the count includes collisions of other vehicles.
pub(super) fn rate_strength(rate: &RateClaim, max_rate: f64, counts_others: bool) -> Strength {
    let Registration {
        runs, confidence, ..
    } = rate.registration;
    let failures = if counts_others { 0 } else { rate.failures };
    let interval = RateInterval::clopper_pearson(failures, runs, 2.0 * confidence - 1.0);
    Strength::Between {
        lower_percent: Rounded::down(100.0 * interval.lower),
        upper_percent: Rounded::up(100.0 * max_rate),
        confidence_percent: Rounded::down(100.0 * confidence),
        runs,
    }
}

impl CheckedCertificate {
    /// True if the checker accepted the certificate.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        matches!(self.status, CertificateStatus::Accepted { .. })
    }

    fn evidence(&self) -> Vec<Evidence> {
        let CertificateSubject::Claim(claim) = &self.subject else {
            return Vec::new();
        };
        let Some(strength) = self.status.strength() else {
            return Vec::new();
        };
        let own = Evidence {
            claim: (**claim).clone(),
            strength: strength.clone(),
            source: self.source(),
            first_violation: self.first_violation,
        };
        std::iter::once(own)
            .chain(self.counted_runs_evidence(claim))
            .collect()
    }

    /// Returns the counted runs that two controllers of the report made in a space, if the certificate compares them.
    pub(super) fn counted_pairs(
        &self,
        controller: &str,
        than: &str,
        space: &ContentId,
    ) -> Option<CountedPairs> {
        let comparison = self.comparison.as_ref()?;
        let CertificateSubject::Claim(claim) = &self.subject else {
            return None;
        };
        let is_same_pair = claim.subject.controller.name == controller
            && matches!(&claim.property, Property::FailsLessOften { than: other } if other.name == than);
        let is_in_space =
            matches!(&claim.domain, Domain::Space { space: counted } if counted == space);
        let is_rejected = matches!(self.status, CertificateStatus::Rejected { .. });
        (is_same_pair && is_in_space && !is_rejected).then_some(CountedPairs {
            only_one_failed: [comparison.only_first_failed, comparison.only_second_failed],
            runs: comparison.registration.runs,
            confidence: comparison.registration.confidence,
            unanswered: self.unanswered.clone(),
        })
    }

    /// Returns the counted runs as evidence about random scenarios, where a failure refutes the claim.
    fn counted_runs_evidence(&self, claim: &AssuranceClaim) -> Option<Evidence> {
        let Domain::Space { space } = &claim.domain else {
            return None;
        };
        let rate = self.rate.as_ref()?;
        let draws = rate.registration.runs;
        let domain = Domain::Draws {
            space: space.clone(),
            seed: self.counted_seed?,
            draws,
        };
        let claim = AssuranceClaim {
            subject: claim.subject.clone(),
            property: Property::NoCollision,
            domain,
        };
        Some(Evidence {
            claim,
            strength: Strength::from_counts(rate.failures, draws),
            source: self.source(),
            first_violation: self.first_violation,
        })
    }

    pub(super) fn source(&self) -> EvidenceSource {
        let file = self.file.clone();
        let sha256 = file.as_ref().map(|_| self.sha256.clone());
        EvidenceSource {
            part: "proofs".to_owned(),
            what: format!("certificate `{}`", self.name),
            file,
            sha256,
            seed: self.counted_seed,
        }
    }
}

/// Returns the certificates of kernels, of `scenes`, of rates of the learned controllers, of the comparison, and the
/// given ones.
pub(super) fn gather_certificates<'a>(
    work: &GatherContext<'_>,
    scenes: impl Iterator<Item = (&'a str, &'a Certificate)>,
) -> Result<Vec<CheckedCertificate>, AssessError> {
    let plan = work.plan;
    let mut proofs = Vec::new();
    for (name, certificate) in shipped_kernels() {
        proofs.push(check_certificate(plan, name, &certificate, None)?);
    }
    for (scenario, certificate) in scenes {
        proofs.push(check_certificate(
            plan,
            format!("scene-{}", file_stem(scenario)),
            certificate,
            None,
        )?);
    }
    for counted in planned_rate_counts(plan) {
        proofs.push(counted.gather(work)?);
    }
    let given = plan.certificates.par_iter();
    let given = given.map(|given| {
        check_certificate(
            plan,
            given.name.clone(),
            &given.certificate,
            given.policy.as_deref(),
        )
    });
    proofs.extend(given.collect::<Result<Vec<_>, _>>()?);
    Ok(proofs)
}

pub(super) fn check_certificate(
    plan: &AssessmentPlan,
    name: String,
    certificate: &Certificate,
    policy: Option<&[u8]>,
) -> Result<CheckedCertificate, AssessError> {
    let text = serde_json::to_string_pretty(certificate).map_err(CacheError::encoding)? + "\n";
    let counts_others = includes_others(plan, &certificate.statement);
    // Checked in every run, never cached: checking is cheap, and cached results could have been edited.
    let status = CertificateStatus::check(
        certificate,
        policy,
        counts_others,
        plan.config.controllers_of_files,
    );
    let is_rejected = matches!(status, CertificateStatus::Rejected { .. });
    Ok(CheckedCertificate {
        statement: certificate.statement.name(),
        about: describe_statement(plan, &name, certificate, policy),
        file: (!is_rejected).then(|| format!("certificates/{name}.json")),
        sha256: certificate.digest(),
        subject: certificate_subject(plan, &name, certificate, policy),
        recount_controllers: (!is_rejected)
            .then(|| recount_controllers(plan, certificate))
            .flatten(),
        status,
        assumptions: certificate.assumptions.clone(),
        counted_seed: counted_seed(&certificate.statement),
        rate: match &certificate.statement {
            Statement::Rate(rate) if !counts_others => Some(rate.clone()),
            _ => None,
        },
        comparison: match &certificate.statement {
            Statement::Comparison(comparison) => Some(comparison.clone()),
            _ => None,
        },
        kernel: matches!(certificate.statement, Statement::Kernel(_))
            .then(|| certificate.statement.clone()),
        text,
        name,
        first_violation: None,
        unanswered: String::new(),
    })
}

fn counted_seed(statement: &Statement) -> Option<u64> {
    let registration = match statement {
        Statement::Rate(claim) => &claim.registration,
        Statement::Comparison(claim) => &claim.registration,
        _ => return None,
    };
    registration.configuration.get("seed")?.parse().ok()
}

/// Returns the evidence of accepted certificates, about controllers and about shields whose kernels they prove.
pub(super) fn evidence(plan: &AssessmentPlan, proofs: &[CheckedCertificate]) -> Vec<Evidence> {
    let mut evidence: Vec<_> = proofs
        .iter()
        .flat_map(CheckedCertificate::evidence)
        .collect();
    for (index, controller) in plan.controllers.iter().enumerate() {
        let kernels = shield_kernels(controller);
        let certificates: Option<Vec<&CheckedCertificate>> = kernels
            .iter()
            .map(|kernel| find_kernel_proof(proofs, kernel))
            .collect();
        if let (Some(certificates), Some(subject)) = (
            certificates,
            plan.claim_subject(index, plan.config.estimator),
        ) && let Some(first) = certificates.first()
        {
            let claim = AssuranceClaim {
                subject,
                property: Property::NoCollisionAhead,
                domain: kernel_domain(&kernels),
            };
            let mut source = first.source();
            source.what = format!("{} certificates of safety kernels", certificates.len());
            evidence.push(Evidence {
                claim,
                strength: Strength::Proved {
                    certificates: certificates.len(),
                },
                source,
                first_violation: None,
            });
        }
    }
    evidence
}

fn find_kernel_proof<'a>(
    proofs: &'a [CheckedCertificate],
    kernel: &ViabilityKernel,
) -> Option<&'a CheckedCertificate> {
    let expected = kernel_certificate(kernel, PAPER_STEP_S, MIN_MARGIN_M)?.statement;
    proofs
        .iter()
        .find(|proof| proof.is_accepted() && proof.kernel.as_ref() == Some(&expected))
}

/// Returns the kernels of a controller's shield, for all pairs of vehicle classes. Empty without a shield, or if a user
/// set its error bounds, which this report cannot verify.
pub(super) fn shield_kernels(controller: &NamedController) -> Vec<ViabilityKernel> {
    let Some(shielded) = controller.source.as_shield() else {
        return Vec::new();
    };
    let ShieldKind::Ahead(ShieldSettings {
        ahead_brake_mps2,
        errors,
    }) = shielded.settings
    else {
        return Vec::new();
    };
    if errors.is_some() {
        return Vec::new();
    }
    let limits = VehicleClass::ALL.iter().map(|class| class.max_brake_mps2());
    let ahead: Vec<f64> =
        ahead_brake_mps2.map_or_else(|| limits.clone().collect(), |limit| vec![limit]);
    limits
        .flat_map(|own_brake_mps2| {
            ahead.iter().map(move |&ahead_brake_mps2| ViabilityKernel {
                own_brake_mps2,
                ahead_brake_mps2,
            })
        })
        .collect()
}

pub(super) fn kernel_domain(kernels: &[ViabilityKernel]) -> Domain {
    let limits_mps2 = kernels
        .iter()
        .map(|kernel| [kernel.own_brake_mps2, kernel.ahead_brake_mps2].map(Rounded::new))
        .collect();
    Domain::Kernels { limits_mps2 }
}
