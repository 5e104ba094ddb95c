//! Result of a suite in the form that build servers read.

use super::description::{least_margins, verdict, within_in_words};
use crate::junit::{self, Case, Status, Suite};
use crumple_suites::{SuiteResult, TestResult, TestVerdict, Tested};

/// Renders every test of every controller as a test case. A contact is a failure, a failing controller an error, and a test that
/// cannot run is skipped.
#[must_use]
pub fn render_junit(result: &SuiteResult) -> String {
    let suites = result.clauses.iter().map(|clause| {
        let document = format!("{}, {}", result.document, result.edition);
        let tests = clause.tests.iter().flat_map(|test| test.controllers.iter().map(move |tested| case(test, tested)));
        Suite {
            name: format!("{} {}", result.suite, clause.clause),
            properties: vec![("statement".to_owned(), result.statement.to_string()), ("document".to_owned(), document)],
            cases: tests.collect(),
        }
    });
    junit::xml("crumple suite", &suites.collect::<Vec<_>>())
}

fn junit_case(test: &TestResult, tested: &Tested) -> Case {
    let within = tested.within.as_ref().filter(|within| within.verdict.is_failure());
    Case {
        name: format!("{}: {}", test.name, tested.controller),
        status: match &tested.verdict {
            TestVerdict::Passed if within.is_none() => Status::Passed,
            TestVerdict::Passed | TestVerdict::Failed { .. } => Status::Failed,
            TestVerdict::ControllerFailed { .. } => Status::Error,
            TestVerdict::Refused { .. } => Status::Skipped,
        },
        message: match within {
            _ if !tested.verdict.is_passed() => Some(verdict(&tested.verdict)),
            Some(within) => Some(within_in_words(within)),
            None => None,
        },
        output: least_margins(&tested.margins).join("\n"),
    }
}
