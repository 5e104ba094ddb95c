//! Proved claims and their assumptions.

use crumple_verify::Assumption;
use maud::html;
use serde::Serialize;

use super::ScenarioCases;
use super::certificates::{self, CertificateStatus, CertificateSubject, CheckedCertificate};
use crate::assessment::claims::{AssuranceClaim, Domain, Evidence, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, ReportPart, Rounded};
use crumple_world::control::ViabilityKernel;
use crumple_world::scenario::VehicleClass;

/// Certificates, each checked in this run.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Proofs {
    /// Gaps that the shield's kernels demand, one entry per pair of vehicle classes.
    pub kernels: Vec<KernelGap>,
    /// All certificates.
    pub certificates: Vec<CheckedCertificate>,
    /// Further conditions for a shield to prevent a collision with the leader.
    pub conditions: [&'static str; 4],
}

/// The gap that the kernel of a pair of vehicle classes demands on a dry road.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct KernelGap {
    /// Name of the pair, and of the certificate.
    pub pair: String,
    /// Brake limit of the ego vehicle, in m/s².
    pub own_brake_mps2: Rounded<2>,
    /// Brake limit of the leader, in m/s².
    pub ahead_brake_mps2: Rounded<2>,
    /// Gap demanded at [`EXAMPLE_MPS`], in metres, rounded up.
    pub example_gap_m: Rounded<2>,
}

/// Speeds of the ego vehicle and the leader for which demanded gaps are shown, in m/s.
pub const EXAMPLE_MPS: [f64; 2] = [25.0, 20.0];

const CONDITIONS: [&str; 4] = [
    "the vehicle starts inside the kernel; from outside it a shield brakes fully and reports that contact cannot be ruled out",
    "what the shield sees is off by no more than its bounds: nothing with the true state, six standard deviations of the \
     noise with the Kalman filter, or what the user states",
    "the vehicle ahead is of the class assumed, and the road's friction is known to the shield",
    "the code of the shield does what the kernel says: that is tested, not proved",
];

impl Proofs {
    pub(in crate::assessment) fn gather<'a>(
        plan: &AssessmentPlan,
        work: &GatherContext<'_>,
        scenarios: impl Iterator<Item = &'a ScenarioCases>,
    ) -> Result<Self, AssessError> {
        let pairs = VehicleClass::ALL.iter().flat_map(|&own| VehicleClass::ALL.iter().map(move |&ahead| (own, ahead)));
        Ok(Self {
            kernels: pairs.map(|(own, ahead)| KernelGap::new(own, ahead)).collect(),
            certificates: certificates::gather_certificates(
                plan,
                work,
                scenarios.filter_map(ScenarioCases::named_certificate),
            )?,
            conditions: CONDITIONS,
        })
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        certificates::evidence(plan, &self.certificates)
    }

    /// Returns the claims of certificates about boxes of initial states, each domain once.
    pub(super) fn reach_claims(&self) -> Vec<&AssuranceClaim> {
        let mut boxes: Vec<&AssuranceClaim> = Vec::new();
        for proof in &self.certificates {
            if let CertificateSubject::Claim(claim) = &proof.subject
                && matches!(claim.domain, Domain::Box { .. })
                && !boxes.iter().any(|known| known.domain == claim.domain)
            {
                boxes.push(claim);
            }
        }
        boxes
    }

    fn gap_table(&self) -> ReportTable {
        let [own, ahead] = EXAMPLE_MPS;
        let example = format!("gap demanded at {own} m/s behind {ahead} m/s (m)");
        ReportTable::from_items(
            &self.kernels,
            &[
                ("own class behind class ahead", &|kernel| ReportCell::text(&kernel.pair)),
                ("own brake (m/s²)", &|kernel| ReportCell::number(kernel.own_brake_mps2)),
                ("hardest brake ahead (m/s²)", &|kernel| ReportCell::number(kernel.ahead_brake_mps2)),
                (&example, &|kernel| ReportCell::number(kernel.example_gap_m)),
            ],
        )
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.certificates,
            &[
                ("certificate", &|proof| ReportCell::text(&proof.name)),
                ("about", &|proof| ReportCell::text(&proof.about)),
                ("what is shown", &|proof| match proof.status {
                    CertificateStatus::NothingShown { .. } => ReportCell::text(proof.status.describe()),
                    _ => ReportCell::with_verdict(proof.status.describe(), proof.is_accepted()),
                }),
                ("of whom here", &|proof| ReportCell::text(proof.subject.describe())),
                ("SHA-256", &|proof| ReportCell::digest(&proof.sha256)),
            ],
        )
    }

    /// Returns the joint confidence level of all bounds, if there are several (Bonferroni: `1 - sum of (1 - c_i)`).
    fn joint_confidence(&self) -> Option<String> {
        let open = |proof: &CheckedCertificate| match &proof.status {
            CertificateStatus::Accepted {
                strength:
                    Some(Strength::Between { confidence_percent, .. } | Strength::Counted { confidence_percent, .. }),
                ..
            } => Some(100.0 - confidence_percent.value()),
            _ => None,
        };
        let open: Vec<f64> = self.certificates.iter().filter_map(open).collect();
        let together = Rounded::<4>::down((100.0 - open.iter().sum::<f64>()).max(0.0));
        (open.len() > 1).then(|| {
            format!("all {} bounds of rates and comparisons hold at once at confidence {together} %, the sum of what each leaves open", open.len())
        })
    }

    fn assumptions(&self) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        let mut said: Vec<(&str, &[Assumption])> = Vec::new();
        for proof in &self.certificates {
            let own = (proof.statement, proof.assumptions.as_slice());
            if !said.contains(&own) {
                said.push(own);
                let all: Vec<_> = proof.assumptions.iter().map(Assumption::to_string).collect();
                lines.push(format!("{} assumes that {}", proof.statement, all.join("; that ")));
            }
        }
        lines.extend(self.joint_confidence());
        lines.extend(self.conditions.iter().map(|condition| format!("a shield needs besides: {condition}")));
        lines
    }
}

impl KernelGap {
    fn new(own: VehicleClass, ahead: VehicleClass) -> Self {
        let kernel = ViabilityKernel { own_brake_mps2: own.max_brake_mps2(), ahead_brake_mps2: ahead.max_brake_mps2() };
        let [own_mps, ahead_mps] = EXAMPLE_MPS;
        Self {
            pair: format!("{}-behind-{}", own.name(), ahead.name()),
            own_brake_mps2: kernel.own_brake_mps2.into(),
            ahead_brake_mps2: kernel.ahead_brake_mps2.into(),
            example_gap_m: Rounded::up(kernel.demanded_gap_m(own_mps, ahead_mps)),
        }
    }
}

const INTRODUCTION: &str = "Each claim here is a file that the checker accepted; it shares no code with the simulation, the \
    search, the training or the solver. A kernel is the set of gaps, at given speeds, from which full braking avoids the \
    vehicle ahead however that one brakes within its limit, and nothing avoids it from any other: a shield (shield:policy, \
    or before any other controller) lets an action through only if the state stays inside. A rate bounds the share of \
    failures from counted runs that were registered before the first of them; a comparison says which of two controllers \
    fails less often. Both rest on counts: those made here are of this run, and whoever has only the file counts again by --rerun. Reach bounds the closed loop of a policy over a whole box of starts. A gap bound says of a scenario how \
    close two vehicles get whoever drives; an unavoidable one, that they touch. Nothing is proved of the vehicle behind a shield, \
    nor that a shielded vehicle drives well; on another friction the gaps of a kernel scale by its inverse.";

const RECHECK: &str = "Check again, in the folder of this report: `crumple check --rerun certificates/*.json`";

impl ReportPart for Proofs {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("proofs", "Proofs".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(INTRODUCTION);
        out.table(&self.table());
        out.paragraph(RECHECK);
        out.push_html(html! { h3 { "What the kernels demand" } });
        out.table(&self.gap_table());
        out.push_html(html! { h3 { "What the proofs take for granted" } });
        out.list(&self.assumptions());
    }
}
