//! Proved claims and their assumptions.

use crumple_verify::Assumption;
use serde::Serialize;

use super::certificates::{
    self, CertificateStatus, CertificateSubject, CheckedCertificate, CountedPairs,
    describe_estimator, kernel_domain, shield_kernels,
};
use super::failure_searches;
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Evidence, Property, Strength};
use crate::assessment::commands::CHECK_ARGUMENTS;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::rich_text::RichText;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, Rounded};
use crumple_sim::engine::NamedController;

pub(super) const ANCHOR: &str = "proofs";

/// Certificates, each checked in this run.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Proofs {
    /// All certificates.
    pub certificates: Vec<CheckedCertificate>,
    /// Further conditions for a shield to prevent a collision with the leader.
    pub conditions: [&'static str; 4],
}

const CONDITIONS: [&str; 4] = [
    "the vehicle starts inside the kernel; outside it, a shield brakes fully and reports that a collision is possible",
    "the estimation error stays within the bounds of the shield: zero with the true state, six standard deviations of \
     the noise with the Kalman filter, or the values that the user states",
    "the leader has the assumed class, and the shield knows the friction of the road",
    "the code of the shield implements the kernel; this is tested, not proved",
];

impl CertificateStatus {
    /// Returns the confidence level of a bound or comparison that the certificate proves.
    fn confidence_percent(&self) -> Option<f64> {
        match self {
            Self::Accepted {
                strength:
                    Some(
                        Strength::Between {
                            confidence_percent, ..
                        }
                        | Strength::Counted {
                            confidence_percent, ..
                        },
                    ),
                ..
            } => Some(confidence_percent.value()),
            _ => None,
        }
    }
}

impl Proofs {
    /// Checks all certificates, with those that `parts` found.
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
        parts: &[&dyn ReportPart],
    ) -> Result<Self, AssessError> {
        let scenes = parts.iter().flat_map(|part| part.certificates());
        Ok(Self {
            certificates: certificates::gather_certificates(work, scenes)?,
            conditions: CONDITIONS,
        })
    }

    /// Returns the path of a certificate in the report folder; `None` if the checker rejected it.
    pub(in crate::assessment) fn certificate_file(&self, name: &str) -> Option<&str> {
        let mut certificates = self.certificates.iter();
        certificates
            .find(|proof| proof.name == name)
            .and_then(|proof| proof.file.as_deref())
    }

    /// Returns the counts of the certificate that compares two controllers in a space, if there is one.
    pub(in crate::assessment) fn counted_pairs(
        &self,
        controller: &str,
        than: &str,
        space: &ContentId,
    ) -> Option<CountedPairs> {
        let mut certificates = self.certificates.iter();
        certificates.find_map(|proof| proof.counted_pairs(controller, than, space))
    }

    /// Returns the claims of certificates about boxes of initial states, each domain once.
    fn reach_claims(&self) -> Vec<&AssuranceClaim> {
        let mut boxes: Vec<&AssuranceClaim> = Vec::new();
        for proof in &self.certificates {
            if let CertificateSubject::Claim(claim) = &proof.subject
                && matches!(claim.domain, Domain::Box { .. })
                && !boxes.iter().any(|other| other.domain == claim.domain)
            {
                boxes.push(claim);
            }
        }
        boxes
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.certificates,
            &[
                ("certificate", &|proof| ReportCell::text(&proof.name)),
                ("about", &|proof| ReportCell::text(&proof.about)),
                ("shown", &|proof| match proof.status {
                    CertificateStatus::NothingShown { ref strength, .. }
                        if !strength.is_refutation() =>
                    {
                        ReportCell::text(proof.status.describe())
                    }
                    _ => ReportCell::with_verdict(proof.status.describe(), proof.is_accepted()),
                }),
                ("controller", &|proof| {
                    ReportCell::text(proof.subject.describe())
                }),
                ("SHA-256", &|proof| match proof.file {
                    Some(_) => ReportCell::text(format!("`{}`", proof.sha256)),
                    None => ReportCell::text("– (not written)"),
                }),
            ],
        )
    }

    /// Returns the command that repeats the counts in the report folder; `None` if there are none that it can repeat.
    pub(in crate::assessment) fn recount_command(&self) -> Option<CrumpleCommand> {
        let counted = self
            .certificates
            .iter()
            .filter_map(|proof| proof.recount_controllers.as_ref().zip(proof.file.clone()));
        let mut arguments: Vec<String> = Vec::new();
        let mut files: Vec<String> = Vec::new();
        for (controllers, file) in counted {
            for controller in controllers {
                if !arguments.contains(controller) {
                    arguments.extend(["--controller".to_owned(), controller.clone()]);
                }
            }
            files.push(file);
        }
        (!files.is_empty()).then(|| {
            CrumpleCommand::new(["check", "--rerun"])
                .with_args(arguments)
                .with_args(files)
        })
    }

    /// Returns the joint confidence level of all bounds, if there are several (Bonferroni: `1 - sum of (1 - c_i)`).
    fn joint_confidence(&self) -> Option<String> {
        let risks_percent: Vec<f64> = self
            .certificates
            .iter()
            .filter_map(|proof| proof.status.confidence_percent())
            .map(|confidence_percent| 100.0 - confidence_percent)
            .collect();
        let joint = Rounded::<4>::down((100.0 - risks_percent.iter().sum::<f64>()).max(0.0));
        let bounds = risks_percent.len();
        (bounds > 1).then(|| {
            format!(
                "all {bounds} bounds of rates and comparisons hold together at confidence {joint} % (Bonferroni)"
            )
        })
    }

    /// States the result of the checks in this run.
    fn describe_checks(&self) -> String {
        let written = self
            .certificates
            .iter()
            .filter(|proof| proof.file.is_some());
        let is_rejected = |proof: &&CheckedCertificate| {
            matches!(proof.status, CertificateStatus::Rejected { .. })
        };
        let rejected = self.certificates.iter().filter(is_rejected).count();
        let rejected = match rejected {
            0 => String::new(),
            count => format!(" It rejected {count}, which are not written."),
        };
        format!(
            "In this run the checker accepted {} certificates, the files in the folder `certificates`.{rejected}",
            written.count()
        )
    }

    fn assumptions(&self) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        let mut written: Vec<(&str, &[Assumption])> = Vec::new();
        for proof in &self.certificates {
            let own = (proof.statement, proof.assumptions.as_slice());
            if !written.contains(&own) {
                written.push(own);
                let assumptions: Vec<_> = proof
                    .assumptions
                    .iter()
                    .map(Assumption::to_string)
                    .collect();
                lines.push(format!(
                    "{} assumes: {}",
                    proof.statement,
                    assumptions.join("; ")
                ));
            }
        }
        lines.extend(self.joint_confidence());
        lines.extend(
            self.conditions
                .iter()
                .map(|condition| format!("a shield also requires: {condition}")),
        );
        lines
    }
}

const INTRODUCTION: &str = "The checker uses no code of the simulator, the search or the solver. A kernel certificate \
    is about the safety kernel of a shield. A rate certificate bounds the failure rate by counted runs, whose seed and \
    number were registered before the first run. A comparison shows which of two controllers fails less often. \
    `--rerun` repeats the counts. Reach is about all initial states of a box. A gap bound is about every driver of a \
    scenario. No proof covers the vehicle behind a shielded one, or usefulness. On a road with another friction the \
    gaps of a kernel scale by its inverse.";

impl ReportPart for Proofs {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Proofs,
            anchor: ANCHOR,
            title: "Proofs",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        let controllers = plan.controllers.iter();
        let learned = controllers.filter(|controller| controller.source.is_learned());
        let counts = plan.rate_spaces.len() as u64 * (learned.count() as u64 + 1);
        counts.saturating_mul(plan.config.rates.runs)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(format!("{} {INTRODUCTION}", self.describe_checks()));
        out.table(self.table());
        out.paragraph(format!(
            "Repeat the checks in the folder of this report: `crumple {CHECK_ARGUMENTS}`"
        ));
        if let Some(command) = self.recount_command() {
            out.paragraph(RichText::from("Repeat the counts: ").and_code(command));
        }
        out.heading("Assumptions of the proofs");
        out.list(self.assumptions());
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        certificates::evidence(plan, &self.certificates)
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let mut claims = whole_space_claims(plan);
        claims.extend(
            self.reach_claims()
                .into_iter()
                .map(|claim| reach_claim(plan, claim)),
        );
        claims.extend(shield_claims(plan));
        claims
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        self.certificates
            .iter()
            .filter_map(|proof| Some((proof.file.clone()?, proof.text.clone().into_bytes())))
            .collect()
    }
}

/// For a whole space only a proof could support the claim; one failure refutes it.
fn whole_space_claims(plan: &AssessmentPlan) -> Vec<ClaimDraft> {
    let sampled = plan.rate_spaces.iter().filter(|_| plan.config.draws > 0);
    let mut spaces: Vec<&ContentId> = Vec::new();
    for named in sampled.chain(&plan.search_spaces) {
        if !spaces.contains(&&named.content_id) {
            spaces.push(&named.content_id);
        }
    }
    spaces
        .into_iter()
        .map(|space| {
            let domain = Domain::Space {
                space: space.clone(),
            };
            ClaimDraft::about_all(
                plan,
                failure_searches::ANCHOR,
                Property::NoCollision,
                domain,
            )
        })
        .collect()
}

fn reach_claim(plan: &AssessmentPlan, claim: &AssuranceClaim) -> ClaimDraft {
    let estimator = claim.subject.estimator;
    let claim_text = format!("{}, {}", claim.describe(), describe_estimator(estimator));
    let property = claim.property.clone();
    ClaimDraft::with_estimator(plan, estimator, ANCHOR, property, claim.domain.clone())
        .with_text(claim_text)
}

/// Claims for each shield that its kernels avoid the leader. Shields with other limits prove other claims.
fn shield_claims(plan: &AssessmentPlan) -> Vec<ClaimDraft> {
    let shielded = plan.controllers.iter().filter_map(shield_domain);
    shielded.map(|domain| shield_claim(plan, &domain)).collect()
}

fn shield_claim(plan: &AssessmentPlan, domain: &Domain) -> ClaimDraft {
    let claims = plan.controllers.iter().enumerate();
    let claims = claims.map(|(index, controller)| {
        shield_domain(controller).filter(|own| own == domain)?;
        Some(AssuranceClaim {
            subject: plan.claim_subject(index, plan.config.estimator)?,
            property: Property::NoCollisionAhead,
            domain: domain.clone(),
        })
    });
    ClaimDraft::new(ANCHOR, claims.collect())
}

/// Returns the domain of a shield's claims; `None` without a shield.
fn shield_domain(controller: &NamedController) -> Option<Domain> {
    controller.source.as_shield()?;
    Some(kernel_domain(&shield_kernels(controller)))
}
