//! A run of a suite in the form that build servers read.

use quick_junit::{NonSuccessKind, Property, Report, SerializeError, TestCase, TestCaseStatus, TestSuite};

use super::words::{least_margins, verdict, within_in_words};
use crumple_search::suite::{SuiteResult, TestResult, TestVerdict, Tested};
use crumple_world::quoted::Lines;

/// What cannot be written as JUnit.
pub type JunitError = SerializeError;

/// Every test and controller as a test case: a contact is a failure, a controller that fails an error, what cannot be run is skipped.
///
/// # Errors
/// [`JunitError`] if the XML cannot be written.
pub fn xml(result: &SuiteResult) -> Result<String, JunitError> {
    let mut report = Report::new("crumple suite");
    for clause in &result.clauses {
        let mut suite = TestSuite::new(format!("{} {}", result.suite, clause.clause));
        suite.add_property(Property::new("statement", result.statement));
        suite.add_property(Property::new("document", format!("{}, {}", result.document, result.edition)));
        for test in &clause.tests {
            for tested in &test.controllers {
                suite.add_test_case(case(test, tested));
            }
        }
        report.add_test_suite(suite);
    }
    Ok(Lines(&report.to_string()?).to_string())
}

fn case(test: &TestResult, tested: &Tested) -> TestCase {
    let within = tested.within.as_ref().filter(|within| within.verdict.is_failure());
    let mut status = match &tested.verdict {
        TestVerdict::Passed if within.is_some() => TestCaseStatus::non_success(NonSuccessKind::Failure),
        TestVerdict::Passed => TestCaseStatus::success(),
        TestVerdict::Failed { .. } => TestCaseStatus::non_success(NonSuccessKind::Failure),
        TestVerdict::ControllerFailed { .. } => TestCaseStatus::non_success(NonSuccessKind::Error),
        TestVerdict::Refused { .. } => TestCaseStatus::skipped(),
    };
    match within {
        _ if !tested.verdict.is_passed() => {
            status.set_message(verdict(&tested.verdict));
        }
        Some(within) => {
            status.set_message(within_in_words(within));
        }
        None => {}
    }
    let mut case = TestCase::new(format!("{}: {}", test.name, tested.controller), status);
    case.set_system_out(least_margins(&tested.margins).join("\n"));
    case
}
