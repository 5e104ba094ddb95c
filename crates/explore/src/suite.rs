//! Tests of suites on the page, with their margins and the scenarios behind them.

use std::sync::{Arc, Mutex, TryLockError};

use crumple_core::quoting::TerminalText;
use crumple_report::suite::{
    describe_ghost, describe_impact_limit, describe_outcome, describe_parameters, describe_verdict,
    describe_warning, describe_worst_in_tolerance, format_points, min_margins,
};
use crumple_sim::control::TestDriverSettings;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_suites::{
    ClauseResult, ClauseSpec, ControllerResult, DISCLAIMER, FailedPoint, Margin, MarginEnd,
    SuiteResult, TestSpec, run,
};
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use crate::catalog::{self, Catalog, CatalogSuite};
use crate::error::RequestError;
use crate::render::{escape_markup, escape_text};

/// Results of suites that this server has run; locked while a suite runs.
#[derive(Debug, Default)]
pub(crate) struct SuiteResults {
    kept: Mutex<Vec<KeptResult>>,
}

#[derive(Debug)]
struct KeptResult {
    suite: usize,
    controller: String,
    estimator: EstimatorKind,
    result: Arc<SuiteResult>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SuiteRequest {
    suite: usize,
    controllers: Vec<String>,
    #[serde(default)]
    estimator: EstimatorKind,
}

#[derive(Debug, Serialize)]
pub(crate) struct SuiteResponse {
    summaries: Vec<String>,
    /// Tables of the tests, one for each clause.
    tests: String,
}

/// Request for the scenario of a test.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TestRequest {
    suite: usize,
    /// Index among the tests of all clauses.
    test: usize,
    /// Index among the controllers of the page.
    controller: usize,
    #[serde(default)]
    pub(crate) estimator: EstimatorKind,
    #[serde(default)]
    point: TestPoint,
}

/// Point of a test.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum TestPoint {
    /// First point of the grid.
    #[default]
    First,
    /// Failure with that index, in the grid or within the tolerances.
    Failure(usize),
    /// Last value that passes, of the margin with that index.
    PassesAt(usize),
    /// First value that fails, of the margin with that index.
    FailsAt(usize),
}

/// Scenario of a test, with the test driver of its vehicle under test.
pub(crate) struct TestScenario {
    pub(crate) scenario: Scenario,
    pub(crate) controller: String,
    pub(crate) test_driver: Option<TestDriverSettings>,
    /// Result of the suite at the point, and the test driver.
    pub(crate) note: String,
}

impl SuiteResults {
    /// Returns the result of a suite with one controller, which is run unless it was run before.
    fn get_or_run(
        &self,
        index: usize,
        suite: &CatalogSuite,
        controller: &NamedController,
        estimator: EstimatorKind,
    ) -> Result<Arc<SuiteResult>, RequestError> {
        let mut kept = match self.kept.try_lock() {
            Ok(kept) => kept,
            // A run that panicked has added no result.
            Err(TryLockError::Poisoned(kept)) => kept.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(RequestError::Busy("the results of a suite"));
            }
        };
        let is_wanted = |result: &&KeptResult| {
            (result.suite, &*result.controller, result.estimator)
                == (index, &*controller.name, estimator)
        };
        if let Some(result) = kept.iter().find(is_wanted) {
            return Ok(Arc::clone(&result.result));
        }
        let result = run(&suite.suite, std::slice::from_ref(controller), estimator)
            .map_err(|error| RequestError::invalid("controllers", error))?;
        let result = Arc::new(result);
        kept.push(KeptResult {
            suite: index,
            controller: controller.name.clone(),
            estimator,
            result: Arc::clone(&result),
        });
        Ok(result)
    }
}

/// Runs a suite as `crumple suite run` does, and renders its tests.
pub(crate) fn show_suite(
    request: &SuiteRequest,
    catalog: &Catalog,
) -> Result<SuiteResponse, RequestError> {
    let suite = catalog::find(&catalog.suites, request.suite, "suite", "suites")?;
    let results = catalog
        .find_controllers(&request.controllers)?
        .into_iter()
        .map(|controller| {
            let kept = &catalog.suite_results;
            kept.get_or_run(request.suite, suite, controller, request.estimator)
        })
        .collect::<Result<Vec<_>, RequestError>>()?;
    let view = SuiteView {
        request,
        catalog,
        results,
    };
    Ok(SuiteResponse {
        summaries: view.summaries(suite),
        tests: escape_markup(&view.tables(suite)),
    })
}

/// Results of a suite, one for each requested controller.
struct SuiteView<'a> {
    request: &'a SuiteRequest,
    catalog: &'a Catalog,
    results: Vec<Arc<SuiteResult>>,
}

impl SuiteView<'_> {
    fn summaries(&self, suite: &CatalogSuite) -> Vec<String> {
        let spec = suite.suite.spec();
        let mut summaries = vec![
            format!("{}: {}, {}", spec.name, spec.document, spec.edition),
            DISCLAIMER.to_owned(),
        ];
        summaries.extend(self.results.iter().filter_map(|result| {
            let all: Vec<_> = result
                .tests()
                .flat_map(|(_, test)| &test.controllers)
                .collect();
            let passed = all.iter().filter(|tested| tested.is_passed()).count();
            let name = &all.first()?.controller;
            Some(format!("{name}: {passed} of {} tests pass", all.len()))
        }));
        summaries.iter().map(|line| escape_text(line)).collect()
    }

    fn tables(&self, suite: &CatalogSuite) -> Markup {
        let mut first_test = 0;
        let clauses = suite.suite.spec().clauses.iter().enumerate();
        let tables = clauses.map(|(index, clause)| {
            let table = self.clause_table(index, clause, first_test);
            first_test += clause.tests.len();
            table
        });
        tables.fold(html! {}, |before, next| html! { (before) (next) })
    }

    fn clause_table(&self, index: usize, clause: &ClauseSpec, first_test: usize) -> Markup {
        let results: Vec<&ClauseResult> = self
            .results
            .iter()
            .filter_map(|result| result.clauses.get(index))
            .collect();
        html! { div.scroll tabindex="0" { table.tests {
            caption { (TerminalText(&format!("{}: {}", clause.clause, clause.summary))) }
            thead { tr {
                th scope="col" { "test" } th scope="col" { "controller" } th scope="col" { "verdict" }
                th scope="col" { "margins and failures" }
            } }
            tbody { @for (test_index, test) in clause.tests.iter().enumerate() {
                @for (row, result) in results.iter().enumerate() {
                    @if let Some(tested) = result.tests.get(test_index).and_then(|test| test.controllers.first()) {
                        tr {
                            @if row == 0 { th scope="row" rowspan=(results.len()) { (describe_test(test)) } }
                            (self.controller_cells(first_test + test_index, tested))
                        }
                    }
                }
            } }
        } } }
    }

    /// Returns the cells of a test with a controller.
    fn controller_cells(&self, test: usize, tested: &ControllerResult) -> Markup {
        let outcome = format!("{}{}", describe_outcome(tested), format_points(tested));
        let failures: Vec<&FailedPoint> = tested.failures().collect();
        let quality = if tested.is_passed() { "good" } else { "bad" };
        let class = (!tested.verdict.is_refusal()).then_some(quality);
        html! {
            td { (TerminalText(&tested.controller)) }
            td class=[class] {
                @if tested.points == 0 { (TerminalText(&outcome)) }
                @else { (self.link(test, tested, "", html! { (TerminalText(&outcome)) })) }
            }
            td { ul {
                @if let Some(warning) = tested.warning { li { (describe_warning(warning)) } }
                @for least in min_margins(&tested.margins) {
                    li { (least.describe()) (self.margin_links(test, tested, least.index, least.margin)) }
                }
                @if let Some(within) = &tested.worst_in_tolerance {
                    li { (TerminalText(&describe_worst_in_tolerance(within))) }
                }
                @for (index, failed) in failures.into_iter().enumerate() {
                    @let query = format!("&failure={index}");
                    @let label = match index < tested.failed_points.len() {
                        true => "fails at ",
                        false => "worst point within the tolerances: ",
                    };
                    li { (self.link(test, tested, &query, html! { (label) (failed.point) })) }
                }
            } }
        }
    }

    /// Returns links to both sides of a margin.
    fn margin_links(
        &self,
        test: usize,
        tested: &ControllerResult,
        index: usize,
        margin: &Margin,
    ) -> Markup {
        let [passes, fails] = ["passes", "fails"].map(|end| format!("&{end}_at={index}"));
        let has_pass = !matches!(margin.end, MarginEnd::None { .. });
        let has_failure = !matches!(margin.end, MarginEnd::Holds { .. });
        html! { " ("
            @if has_pass { (self.link(test, tested, &passes, html! { "simulate the last pass" })) }
            @if has_pass && has_failure { ", " }
            @if has_failure { (self.link(test, tested, &fails, html! { "the first failure" })) }
        ")" }
    }

    /// Returns a link to a point of a test on the page of scenarios.
    fn link(&self, test: usize, tested: &ControllerResult, query: &str, content: Markup) -> Markup {
        let SuiteRequest {
            suite, estimator, ..
        } = self.request;
        let mut controllers = self.catalog.controllers.iter();
        let is_tested = |controller: &NamedController| controller.name == tested.controller;
        let controller = controllers.position(is_tested).unwrap_or_default();
        let name = estimator.name();
        let address =
            format!("./?suite={suite}&test={test}&controller={controller}&estimator={name}{query}");
        html! { a href=(address) { (content) } }
    }
}

fn describe_test(test: &TestSpec) -> Markup {
    html! {
        (test.name)
        span.note { (describe_parameters(&test.parameters, &test.ranges)) }
        @if let Some(ghost) = describe_ghost(&test.parameters) { span.note { (ghost) } }
        @if let Some(limit) = &test.impact_at_most { span.note { (describe_impact_limit(limit)) } }
    }
}

/// Returns the scenario of a point of a test.
pub(crate) fn open_test(
    request: &TestRequest,
    catalog: &Catalog,
) -> Result<TestScenario, RequestError> {
    let chosen = ChosenTest::find(request, catalog)?;
    match request.point {
        TestPoint::First => {
            let grid = chosen.test.lead.map(|_| chosen.test.grid());
            let values = grid.as_ref().and_then(|grid| grid.first());
            let values = values.ok_or_else(no_such_point)?;
            chosen.scenario(values, "The first point of the grid.")
        }
        TestPoint::Failure(index) => chosen.failure(index),
        TestPoint::PassesAt(index) | TestPoint::FailsAt(index) => {
            let tested = chosen.result()?;
            let margin = tested.margins.get(index).ok_or_else(no_such_point)?;
            let value = margin_end(margin, request.point).ok_or_else(no_such_point)?;
            let values = chosen.test.margin_point(index, value);
            let end = match request.point {
                TestPoint::FailsAt(_) => "The first value at which the test does not pass.",
                _ => "The last value at which the test passes.",
            };
            chosen.scenario(&values.ok_or_else(no_such_point)?, end)
        }
    }
}

/// A test of a suite, and a controller.
struct ChosenTest<'c> {
    request: &'c TestRequest,
    results: &'c SuiteResults,
    suite: &'c CatalogSuite,
    clause: &'c ClauseSpec,
    test: &'c TestSpec,
    controller: &'c NamedController,
}

impl<'c> ChosenTest<'c> {
    fn find(request: &'c TestRequest, catalog: &'c Catalog) -> Result<Self, RequestError> {
        let suite = catalog::find(&catalog.suites, request.suite, "suite", "suites")?;
        let clauses = &suite.suite.spec().clauses;
        let all: Vec<(&ClauseSpec, &TestSpec)> = clauses
            .iter()
            .flat_map(|clause| clause.tests.iter().map(move |test| (clause, test)))
            .collect();
        let &(clause, test) = catalog::find(&all, request.test, "test", "tests")?;
        let controllers = &catalog.controllers;
        Ok(Self {
            request,
            results: &catalog.suite_results,
            suite,
            clause,
            test,
            controller: catalog::find(
                controllers,
                request.controller,
                "controller",
                "controllers",
            )?,
        })
    }

    /// Returns the result of the test.
    fn result(&self) -> Result<ControllerResult, RequestError> {
        let TestRequest {
            suite,
            test,
            estimator,
            ..
        } = *self.request;
        let result = self
            .results
            .get_or_run(suite, self.suite, self.controller, estimator)?;
        let test = result.tests().nth(test);
        let tested = test.and_then(|(_, test)| test.controllers.first().cloned());
        tested.ok_or_else(no_such_point)
    }

    fn failure(&self, index: usize) -> Result<TestScenario, RequestError> {
        let tested = self.result()?;
        let failed = tested.failures().nth(index).ok_or_else(no_such_point)?;
        let verdict = describe_verdict(&failed.verdict);
        Ok(TestScenario::new(
            failed.scenario.clone().ok_or_else(no_such_point)?,
            self.controller,
            failed.test_driver.clone(),
            &format!("In the suite: {verdict}."),
        ))
    }

    /// Returns the scenario of a point with these values.
    fn scenario(&self, values: &[f64], note: &str) -> Result<TestScenario, RequestError> {
        let Self { clause, test, .. } = self;
        let point = test.describe_point(values);
        let about = format!(
            "{}: {} ({point}.) {DISCLAIMER}",
            clause.clause, clause.summary
        );
        let name = format!("{}-{}", self.suite.suite.spec().name, test.name);
        Ok(TestScenario::new(
            test.scenario(&name, &about, values)?,
            self.controller,
            test.test_driver(values),
            note,
        ))
    }
}

fn no_such_point() -> RequestError {
    RequestError::invalid("point", "the test has no such point with this controller")
}

/// Returns the value at an end of a margin; `None` if the margin does not have this end.
fn margin_end(margin: &Margin, point: TestPoint) -> Option<f64> {
    match (margin.end, point) {
        (MarginEnd::Boundary { fails_at, .. }, TestPoint::FailsAt(_)) => Some(fails_at),
        (MarginEnd::Boundary { passes_at, .. }, _) => Some(passes_at),
        (MarginEnd::None { .. }, TestPoint::FailsAt(_)) => Some(margin.from),
        (MarginEnd::Holds { .. }, TestPoint::PassesAt(_)) => Some(margin.to),
        (MarginEnd::None { .. } | MarginEnd::Holds { .. }, _) => None,
    }
}

impl TestScenario {
    fn new(
        scenario: Scenario,
        controller: &NamedController,
        test_driver: Option<TestDriverSettings>,
        note: &str,
    ) -> Self {
        let driver = test_driver.as_ref().map(|driver| {
            let name = driver.name_prefix();
            format!(
                " The driver of the test is simulated: {}.",
                name.trim_end_matches(':')
            )
        });
        Self {
            scenario,
            controller: controller.name.clone(),
            note: note.to_owned() + &driver.unwrap_or_default(),
            test_driver,
        }
    }
}
