//! Claims and gates as tests, in the form that build servers read.

use quick_junit::{NonSuccessKind, Report, SerializeError, TestCase, TestCaseStatus, TestSuite};

use super::Assessment;
use super::table::Mark;

/// One suite for the gates, and one a claim with a test a controller: what is refuted fails, what was not tried or not decided
/// is skipped.
pub(super) fn xml(assessment: &Assessment) -> Result<String, SerializeError> {
    let mut report = Report::new("crumple assess");
    let mut gates = TestSuite::new("gates");
    for gate in &assessment.summary.gates {
        let mark = if gate.holds { Mark::Good } else { Mark::Bad };
        gates.add_test_case(case(&gate.gate, mark, &gate.because));
    }
    report.add_test_suite(gates);
    for claim in &assessment.summary.claims {
        let mut suite = TestSuite::new(claim.claim.as_str());
        for (controller, strength) in assessment.summary.controllers.iter().zip(&claim.strengths) {
            suite.add_test_case(case(controller, strength.mark(), &strength.words()));
        }
        report.add_test_suite(suite);
    }
    report.to_string()
}

fn case(name: &str, mark: Mark, words: &str) -> TestCase {
    let mut status = match mark {
        Mark::Good => TestCaseStatus::success(),
        Mark::Bad => TestCaseStatus::non_success(NonSuccessKind::Failure),
        Mark::None | Mark::Number => TestCaseStatus::skipped(),
    };
    if mark != Mark::Good {
        status.set_message(words);
    }
    let mut case = TestCase::new(name, status);
    case.set_system_out(words);
    case
}
