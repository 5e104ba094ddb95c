//! What is proved, and what the proofs take for granted.

use crumple_verify::{Assumption, Certificate, Statement, check};
use maud::{Markup, html};
use serde::Serialize;

use crate::control::Kernel;
use crate::evidence::shipped_kernels;
use crate::report::table::{Cell, Table};
use crate::report::{Part, Rounded, sha256};
use crate::scenario::VehicleClass;

/// The shield's kernels, checked in this very run.
#[derive(Debug, Clone, Serialize)]
pub struct Proofs {
    /// One entry a pair of vehicle classes.
    pub kernels: Vec<KernelProof>,
    /// What the certificates take for granted.
    pub assumptions: Vec<Assumption>,
    /// What has to hold besides for a shield to keep the vehicle ahead untouched.
    pub conditions: [&'static str; 4],
}

/// The kernel of a pair of vehicle classes on a dry road: the states from which contact with the vehicle ahead can be avoided.
#[derive(Debug, Clone, Serialize)]
pub struct KernelProof {
    /// Name of the pair, and of the file that `crumple verify shield` writes.
    pub pair: String,
    /// What the own vehicle can brake at, in m/s².
    pub own_brake_mps2: Rounded<2>,
    /// What the vehicle ahead never brakes harder than, in m/s².
    pub ahead_brake_mps2: Rounded<2>,
    /// Gap demanded at [`EXAMPLE_MPS`], in metres, rounded up.
    pub example_gap_m: Rounded<2>,
    /// What the checker said.
    pub status: KernelStatus,
    /// SHA-256 of the certificate as `crumple verify shield` writes it.
    pub certificate_sha256: String,
}

/// Own speed and speed ahead for which demanded gaps are shown, in m/s.
pub const EXAMPLE_MPS: [f64; 2] = [25.0, 20.0];

/// What the checker said of a certificate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum KernelStatus {
    /// It proves what it states.
    Accepted,
    /// It proves nothing.
    Rejected {
        /// Why.
        reason: String,
    },
}

/// The way from a kernel to a vehicle that does not touch the one ahead.
const CONDITIONS: [&str; 4] = [
    "the vehicle starts inside the kernel; from outside it a shield brakes fully and reports that contact cannot be ruled out",
    "what the shield sees is off by no more than its bounds: nothing with the true state, six standard deviations of the \
     noise with the Kalman filter, or what the user states",
    "the vehicle ahead is of the class assumed, and the road's friction is known to the shield",
    "the code of the shield does what the kernel says: that is tested, not proved",
];

impl Proofs {
    pub(in crate::report) fn gather() -> Self {
        let shipped = shipped_kernels();
        let assumptions = shipped.first().map(|(_, certificate)| certificate.assumptions.clone()).unwrap_or_default();
        let pairs = VehicleClass::ALL.into_iter().flat_map(|own| VehicleClass::ALL.map(|ahead| (own, ahead)));
        let named = |own: VehicleClass, ahead: VehicleClass| format!("{}-behind-{}", own.name(), ahead.name());
        let kernels = pairs.filter_map(|(own, ahead)| {
            let (pair, certificate) = shipped.iter().find(|(name, _)| *name == named(own, ahead))?;
            Some(KernelProof::of(pair, (own.max_brake_mps2(), ahead.max_brake_mps2()), certificate))
        });
        Self { kernels: kernels.collect(), assumptions, conditions: CONDITIONS }
    }

    /// How many certificates were accepted, if all were and there is one for each pair of classes.
    pub(super) fn accepted(&self) -> Option<usize> {
        let pairs = VehicleClass::ALL.len().pow(2);
        let all = self.kernels.len() == pairs && self.kernels.iter().all(|k| k.status == KernelStatus::Accepted);
        all.then_some(pairs)
    }

    fn table(&self) -> Table {
        let [own, ahead] = EXAMPLE_MPS;
        let example = format!("gap demanded at {own} m/s behind {ahead} m/s (m)");
        let mut table = Table::new(&[
            "own class behind class ahead",
            "own brake (m/s²)",
            "hardest brake ahead (m/s²)",
            &example,
            "checked in this run",
            "certificate, SHA-256",
        ]);
        for kernel in &self.kernels {
            let (words, accepted) = match &kernel.status {
                KernelStatus::Accepted => ("proved".to_owned(), true),
                KernelStatus::Rejected { reason } => (format!("rejected: {reason}"), false),
            };
            table.row(vec![
                Cell::text(&kernel.pair),
                Cell::number(kernel.own_brake_mps2),
                Cell::number(kernel.ahead_brake_mps2),
                Cell::number(kernel.example_gap_m),
                Cell::judged(words, accepted),
                Cell::text(format!("{}…", kernel.certificate_sha256.get(..16).unwrap_or_default())),
            ]);
        }
        table
    }

    fn lines(&self) -> Vec<String> {
        let assumed = self.assumptions.iter().map(|assumption| format!("assumed: {assumption}"));
        assumed.chain(self.conditions.iter().map(|condition| format!("also needed: {condition}"))).collect()
    }
}

impl KernelProof {
    fn of(pair: &str, (own_brake_mps2, ahead_brake_mps2): (f64, f64), certificate: &Certificate) -> Self {
        let status = match (check(certificate), &certificate.statement) {
            (Ok(_), Statement::Kernel(_)) => KernelStatus::Accepted,
            (Ok(_), _) => KernelStatus::Rejected { reason: "it is not about a kernel".to_owned() },
            (Err(rejection), _) => KernelStatus::Rejected { reason: rejection.to_string() },
        };
        let [own, ahead] = EXAMPLE_MPS;
        let written = serde_json::to_string_pretty(certificate).unwrap_or_default() + "\n";
        Self {
            pair: pair.to_owned(),
            own_brake_mps2: own_brake_mps2.into(),
            ahead_brake_mps2: ahead_brake_mps2.into(),
            example_gap_m: Rounded::up(Kernel { own_brake_mps2, ahead_brake_mps2 }.demanded_gap_m(own, ahead)),
            status,
            certificate_sha256: sha256(&written),
        }
    }
}

const INTRODUCTION: &str = "A shield (shield:policy, or before any other controller) lets an action through only if the \
    state stays in a kernel: the gaps, at given speeds, from which full braking avoids the vehicle ahead however that one \
    brakes within its limit. For each pair of vehicle classes a certificate states that full braking keeps every state of \
    the kernel free of contact and that nothing keeps any other. The checker, which shares no code with the simulation, \
    confirmed them in exact arithmetic while this report was made. On another friction the demanded gaps scale by its \
    inverse. Nothing is proved of the vehicle behind, nor that a shielded vehicle drives well.";

const RECHECK: &str = "crumple verify shield --out shield && crumple check shield/*.json";

impl Part for Proofs {
    fn id(&self) -> &'static str {
        "proofs"
    }

    fn title(&self) -> String {
        "Proofs".to_owned()
    }

    fn html(&self) -> Markup {
        html! {
            p { (INTRODUCTION) }
            (self.table().html())
            ul { @for line in self.lines() { li { (line) } } }
            p { "Check again: " code { (RECHECK) } }
        }
    }

    fn markdown(&self) -> String {
        let lines = self.lines().into_iter().map(|line| format!("- {line}\n")).collect::<String>();
        format!("{INTRODUCTION}\n\n{}\n{lines}\nCheck again: `{RECHECK}`\n", self.table().markdown())
    }
}
