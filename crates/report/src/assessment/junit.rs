//! Gates in JUnit format, for build servers.

use super::{AssessmentReport, GateResult};
use crate::junit::{self, JunitCase, JunitStatus, JunitSuite};

/// Renders gates as test cases, and claims about controllers as properties.
pub(super) fn render_junit(assessment: &AssessmentReport) -> String {
    let mut gates = JunitSuite {
        name: "gates".to_owned(),
        ..JunitSuite::default()
    };
    gates.cases = assessment.summary.gates.iter().map(gate_case).collect();
    for row in &assessment.summary.claims {
        let claims = row
            .claims
            .iter()
            .zip(&row.statuses)
            .filter(|(claim, _)| claim.is_some());
        for (claim, status) in claims {
            let controller = claim
                .as_ref()
                .map_or("", |claim| claim.subject.controller.name.as_str());
            gates
                .properties
                .push((format!("{controller}: {}", row.claim), status.describe()));
        }
    }
    junit::render_xml("crumple assess", &[gates])
}

fn gate_case(gate: &GateResult) -> JunitCase {
    JunitCase {
        name: gate.gate.to_string(),
        status: if gate.holds {
            JunitStatus::Passed
        } else {
            JunitStatus::Failed
        },
        message: (!gate.holds).then(|| gate.reason.clone()),
        output: gate.reason.clone(),
    }
}
