//! Gates as tests, in the form that build servers read.

use quick_junit::{NonSuccessKind, Property, Report, SerializeError, TestCase, TestCaseStatus, TestSuite};

use super::{Assessment, Gate, GateResult, SuiteFindings};
use crumple_search::suite::STATEMENT;
use crumple_world::quoted::Lines;

/// The gates, each a test, and the tests of suites: a build is red where a gate does not hold, and for nothing else. What is claimed of each controller
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
    for (suite, found) in assessment.suites.iter().flat_map(|suites| suites.suites.iter().enumerate()) {
        report.add_test_suite(tests(assessment, suite, found));
    }
    Ok(Lines(&report.to_string()?).to_string())
}

/// The tests of a suite: one that fails is a failure where a gate asks for the suite, and else skipped, with what happened.
fn tests(assessment: &Assessment, place: usize, found: &SuiteFindings) -> TestSuite {
    let mut suite = TestSuite::new(format!("suite {}", found.suite.name));
    suite.add_property(Property::new("statement", STATEMENT));
    suite.add_property(Property::new("document", found.document.as_str()));
    let config = &assessment.provenance.config;
    let is_asked = |controller: &str| {
        config.gates.iter().any(|gate| {
            matches!(gate, Gate::SuitePassed { controller: of, suite } if of == controller
                && config.suites.get(place).is_some_and(|named| named.suite == *suite))
        })
    };
    for test in &found.tests {
        for (controller, outcome) in found.controllers.iter().zip(&test.outcomes) {
            let mut status = match outcome.passed {
                Some(true) => TestCaseStatus::success(),
                Some(false) if is_asked(controller) => TestCaseStatus::non_success(NonSuccessKind::Failure),
                Some(false) | None => TestCaseStatus::skipped(),
            };
            if outcome.passed != Some(true) {
                status.set_message(outcome.worst.as_ref().map_or(&*outcome.verdict, |worst| &*worst.what));
            }
            let mut case = TestCase::new(format!("{}: {controller}", test.test), status);
            case.set_system_out(outcome.margins.join("\n"));
            suite.add_test_case(case);
        }
    }
    suite
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
