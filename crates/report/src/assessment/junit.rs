//! Gates and suite tests in JUnit format, for build servers.

use super::{AssessmentGate, AssessmentReport, GateResult, SuiteFindings};
use crate::junit::{self, JunitCase, JunitStatus, JunitSuite};
use crumple_suites::DISCLAIMER;

/// Renders gates and tests as test cases. Only gates fail a build; claims about controllers are properties.
pub(super) fn render_junit(assessment: &AssessmentReport) -> String {
    let mut gates = JunitSuite { name: "gates".to_owned(), ..JunitSuite::default() };
    gates.cases = assessment.summary.gates.iter().map(gate_case).collect();
    for row in &assessment.summary.claims {
        let made = row.claims.iter().zip(&row.statuses).filter(|(claim, _)| claim.is_some());
        for (claim, status) in made {
            let controller = claim.as_ref().map_or("", |claim| claim.subject.controller.name.as_str());
            gates.properties.push((format!("{controller}: {}", row.claim), status.describe()));
        }
    }
    let suites = assessment.suites.iter().flat_map(|suites| suites.suites.iter().enumerate());
    let suites = suites.map(|(place, found)| suite_tests(assessment, place, found));
    junit::render_xml("crumple assess", &[gates].into_iter().chain(suites).collect::<Vec<_>>())
}

/// Lists the tests of a suite. A failed test is a failure if a gate requires the suite, and is skipped otherwise.
fn suite_tests(assessment: &AssessmentReport, place: usize, found: &SuiteFindings) -> JunitSuite {
    let config = &assessment.provenance.config;
    let is_required = |controller: &str| {
        config.gates.iter().any(|gate| {
            matches!(gate, AssessmentGate::SuitePassed { controller: of, suite } if of == controller
                && config.suites.get(place).is_some_and(|named| named.suite == *suite))
        })
    };
    let mut cases = Vec::new();
    for test in &found.tests {
        for (controller, outcome) in found.controllers.iter().zip(&test.outcomes) {
            let status = match outcome.passed {
                Some(true) => JunitStatus::Passed,
                Some(false) if is_required(controller) => JunitStatus::Failed,
                Some(false) | None => JunitStatus::Skipped,
            };
            let message = outcome.worst.as_ref().map_or(&*outcome.verdict, |worst| &*worst.description);
            cases.push(JunitCase {
                name: format!("{}: {controller}", test.test),
                status,
                message: (status != JunitStatus::Passed).then(|| message.to_owned()),
                output: outcome.margins.join("\n"),
            });
        }
    }
    let properties = [("statement", DISCLAIMER), ("document", &found.document)];
    JunitSuite {
        name: format!("suite {}", found.suite.name),
        properties: properties.map(|(name, value)| (name.to_owned(), value.to_owned())).into(),
        cases,
    }
}

fn gate_case(gate: &GateResult) -> JunitCase {
    JunitCase {
        name: gate.gate.to_string(),
        status: if gate.holds { JunitStatus::Passed } else { JunitStatus::Failed },
        message: (!gate.holds).then(|| gate.reason.clone()),
        output: gate.reason.clone(),
    }
}
