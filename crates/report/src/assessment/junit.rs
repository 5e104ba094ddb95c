//! Gates as tests, in the form that build servers read.

use quick_junit::{NonSuccessKind, Property, Report, SerializeError, TestCase, TestCaseStatus, TestSuite};

use super::{Assessment, GateResult};
use crumple_world::quoted::Lines;

/// The gates, each a test: a build is red where one does not hold, and for nothing else. What is claimed of each controller
/// stands among the properties, where it fails no build.
pub(super) fn xml(assessment: &Assessment) -> Result<String, SerializeError> {
    let mut report = Report::new("crumple assess");
    let mut gates = TestSuite::new("gates");
    for gate in &assessment.summary.gates {
        gates.add_test_case(case(gate));
    }
    for row in &assessment.summary.claims {
        let made = row.claims.iter().zip(&row.standings).filter(|(claim, _)| claim.is_some());
        for (claim, standing) in made {
            let controller = claim.as_ref().map_or("", |claim| claim.subject.controller.name.as_str());
            gates.add_property(Property::new(format!("{controller}: {}", row.claim), standing.words()));
        }
    }
    report.add_test_suite(gates);
    Ok(Lines(&report.to_string()?).to_string())
}

fn case(gate: &GateResult) -> TestCase {
    let mut status = match gate.holds {
        true => TestCaseStatus::success(),
        false => TestCaseStatus::non_success(NonSuccessKind::Failure),
    };
    if !gate.holds {
        status.set_message(&*gate.because);
    }
    let mut case = TestCase::new(gate.gate.as_str(), status);
    case.set_system_out(&gate.because);
    case
}
