//! The result of a suite as JUnit, for build servers.

use super::description::{describe_min_margins, describe_outcome, describe_warning};
use crate::junit::{self, JunitCase, JunitStatus, JunitSuite};
use crumple_suites::{ControllerResult, SuiteResult, TestResult, TestVerdict};

/// Renders every test of every controller as a test case: a collision is a failure, a failing controller an error.
#[must_use]
pub fn render_junit(result: &SuiteResult) -> String {
    let suites = result.clauses.iter().map(|clause| {
        let tests = clause.tests.iter().flat_map(|test| {
            test.controllers
                .iter()
                .map(move |tested| junit_case(&result.suite, test, tested))
        });
        JunitSuite {
            name: format!("{} {}", result.suite, clause.clause),
            cases: tests.collect(),
            ..JunitSuite::default()
        }
    });
    junit::render_xml("crumple suite", None, &suites.collect::<Vec<_>>())
}

fn junit_case(suite: &str, test: &TestResult, tested: &ControllerResult) -> JunitCase {
    let status = match &tested.verdict {
        _ if tested.is_passed() => JunitStatus::Passed,
        TestVerdict::Passed | TestVerdict::Failed { .. } | TestVerdict::Braked { .. } => {
            JunitStatus::Failed
        }
        TestVerdict::ControllerFailed { .. } => JunitStatus::Error,
        TestVerdict::Refused { .. } => JunitStatus::Skipped,
    };
    JunitCase {
        class: junit::join_class(&["crumple", "suites", suite, &tested.controller]),
        name: format!("{}: {}", test.name, tested.controller),
        file: None,
        verifier: test.name.clone(),
        requirements: test.requirement.clone(),
        status,
        message: (status != JunitStatus::Passed).then(|| describe_outcome(tested)),
        output: describe_output(tested),
    }
}

/// Describes the warning, if the driver brakes after one, and the margins.
fn describe_output(tested: &ControllerResult) -> String {
    let warning = tested.warning.map(describe_warning).map(str::to_owned);
    let lines: Vec<String> = warning
        .into_iter()
        .chain(describe_min_margins(&tested.margins))
        .collect();
    lines.join("\n")
}
