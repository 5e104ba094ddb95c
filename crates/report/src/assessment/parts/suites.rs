//! Suites of tests that are modelled on regulations, each with its matrix.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::json;

use super::distinct_failure::EscapeFile;
use super::suite_json::SuiteJson;
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength,
};
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::planned_suite::PlannedSuite;
use crate::assessment::report_block::ReportBlock;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::run_ends::note_unanswered;
use crate::assessment::table::{CellMark, ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, CrumpleCommand};
use crate::suite::{
    describe_min_margins, describe_outcome, describe_preventability, describe_verdict,
    describe_warning, describe_worst_in_tolerance,
};
use crumple_core::digest::sha256;
use crumple_sim::engine::{FailedControllerRuns, NamedController};
use crumple_sim::scenario::file;
use crumple_suites::{
    ClauseResult, ControllerResult, DISCLAIMER, FailedPoint, SuiteResult, TestResult, TestVerdict,
    run,
};

const ANCHOR: &str = "suites";

pub(in crate::assessment) fn gather_suite(
    planned: &PlannedSuite,
    work: &GatherContext<'_>,
) -> Result<SuiteCacheEntry, AssessError> {
    let plan = work.plan;
    let tested: Vec<NamedController> = planned
        .controller_indices
        .iter()
        .filter_map(|&index| plan.controllers.get(index).cloned())
        .collect();
    let identities: Vec<_> = tested
        .iter()
        .map(|controller| plan.identity(controller))
        .collect();
    let inputs = json!([planned.content_id.sha256, identities]);
    let name = format!("suite {}", planned.content_id.name);
    let entry = work.get_or_gather(&name, &inputs, || run_planned_suite(plan, planned, &tested))?;
    work.add_runs(planned.run_count())?;
    Ok(entry)
}

/// The results of all suites.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Suites {
    /// Disclaimer of the suites.
    pub statement: &'static str,
    /// One entry per suite.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<SuiteJson<'_>>"))]
    pub suites: Vec<PlannedSuiteResult>,
    /// Failed scenarios by path, relative to the report folder.
    #[serde(skip)]
    files: BTreeMap<String, String>,
}

/// The result of one suite, and where the report has its failures.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedSuiteResult {
    /// Identifier of the suite.
    pub content_id: ContentId,
    /// Tested controllers, in the order of the results of each test.
    pub controllers: Vec<String>,
    /// Result of the suite.
    pub result: SuiteResult,
    failures: Vec<FailuresOfTest>,
}

/// Failure of each controller with the highest impact speed, in the order of the controllers.
type FailuresOfTest = Vec<Option<SuiteFailure>>;

/// Scenario files and commands of a failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SuiteFailure {
    /// Path of the scenario file, relative to the report folder.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Command that simulates the failure; absent for an external controller and for one that failed.
    pub replay: Option<CrumpleCommand>,
    /// Escape, if the failure is avoidable.
    pub escape: Option<EscapeFile>,
}

/// The result of a test for one controller.
#[derive(Debug, Clone, Copy)]
pub struct SuiteOutcome<'s> {
    /// Clause of the document.
    pub clause: &'s ClauseResult,
    /// Test of the clause.
    pub test: &'s TestResult,
    /// Result of the controller.
    pub tested: &'s ControllerResult,
    /// Failure with the highest impact speed.
    pub failure: Option<&'s SuiteFailure>,
}

#[derive(Serialize, Deserialize)]
pub(in crate::assessment) struct SuiteCacheEntry {
    result: SuiteResult,
    failures: Vec<FailuresOfTest>,
    files: BTreeMap<String, String>,
}

impl Suites {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if plan.suites.is_empty() {
            return Ok(None);
        }
        let mut suites = Vec::new();
        let mut files = BTreeMap::new();
        for planned in &plan.suites {
            let gathered = gather_suite(planned, work)?;
            let controllers = planned.controller_indices.iter();
            let controllers = controllers.filter_map(|&index| plan.controllers.get(index));
            suites.push(PlannedSuiteResult {
                content_id: planned.content_id.clone(),
                controllers: controllers.map(|tested| tested.name.clone()).collect(),
                result: gathered.result,
                failures: gathered.failures,
            });
            files.extend(gathered.files);
        }
        Ok(Some(Self {
            statement: DISCLAIMER,
            suites,
            files,
        }))
    }

    /// Returns the outcomes of a controller in the suite with that index in the plan.
    pub(in crate::assessment) fn controller_outcomes<'s>(
        &'s self,
        suite_index: usize,
        controller: &'s str,
    ) -> impl Iterator<Item = SuiteOutcome<'s>> {
        let suite = self.suites.get(suite_index).into_iter();
        suite.flat_map(move |suite| suite.outcomes_of(controller))
    }

    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.suites
            .iter()
            .flat_map(PlannedSuiteResult::replay_commands)
    }
}

impl PlannedSuiteResult {
    /// Iterates over the tests, each with the outcomes of all controllers.
    pub fn tests(&self) -> impl Iterator<Item = Vec<SuiteOutcome<'_>>> {
        self.result
            .tests()
            .zip(&self.failures)
            .map(|((clause, test), failures)| {
                let results = test.controllers.iter().zip(failures);
                let outcomes = results.map(|(tested, failure)| SuiteOutcome {
                    clause,
                    test,
                    tested,
                    failure: failure.as_ref(),
                });
                outcomes.collect()
            })
    }

    /// Iterates over the outcomes of a controller.
    pub(in crate::assessment) fn outcomes_of<'s>(
        &'s self,
        controller: &'s str,
    ) -> impl Iterator<Item = SuiteOutcome<'s>> {
        self.tests()
            .flatten()
            .filter(move |outcome| outcome.tested.controller == controller)
    }
}

impl Serialize for PlannedSuiteResult {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        SuiteJson::new(self).serialize(serializer)
    }
}

fn claims(plan: &AssessmentPlan, planned: &PlannedSuite) -> Vec<Option<AssuranceClaim>> {
    (0..plan.controllers.len())
        .map(|index| claim(plan, planned, index))
        .collect()
}

/// Returns the claim about a controller; `None` if the suite does not test it.
fn claim(plan: &AssessmentPlan, planned: &PlannedSuite, index: usize) -> Option<AssuranceClaim> {
    let subject = plan
        .claim_subject(index, plan.config.estimator)
        .filter(|_| planned.controller_indices.contains(&index))?;
    let domain = Domain::Suite {
        suite: planned.content_id.clone(),
    };
    Some(AssuranceClaim {
        subject,
        property: Property::PassesTests,
        domain,
    })
}

fn run_planned_suite(
    plan: &AssessmentPlan,
    planned: &PlannedSuite,
    tested: &[NamedController],
) -> Result<SuiteCacheEntry, AssessError> {
    let result = run(&planned.suite, tested, plan.config.estimator)?;
    let mut files = BTreeMap::new();
    let mut failures = Vec::new();
    for (_, test) in result.tests() {
        let mut failures_of_test = Vec::new();
        for (result, controller) in test.controllers.iter().zip(tested) {
            let failed = result.fastest_failure();
            let failure =
                failed.map(|failed| SuiteFailure::new(failed, controller, plan, &mut files));
            failures_of_test.push(failure.transpose()?.flatten());
        }
        failures.push(failures_of_test);
    }
    Ok(SuiteCacheEntry {
        result,
        failures,
        files,
    })
}

impl SuiteOutcome<'_> {
    fn table_cell(&self) -> ReportCell {
        let Self { tested, .. } = self;
        // The reason for no answer is below the table, because it may be long.
        let unanswered = tested
            .total_unanswered()
            .map_or(0, |unanswered| unanswered.runs);
        let fastest = tested.fastest_failure();
        let collision = fastest.filter(|_| unanswered < tested.points_failed() as u64);
        let passed = tested.passed_points;
        let mut text = match (tested.points, tested.outcome(), collision) {
            (0, ..) => "not run".to_owned(),
            (points, None, _) => format!("{passed} of {points}; the others cannot be run"),
            (points, Some(_), Some(fastest)) => {
                format!(
                    "{passed} of {points}; {}",
                    describe_verdict(&fastest.verdict)
                )
            }
            (points, Some(_), None) => format!("{passed} of {points}"),
        };
        if unanswered > 0 {
            let runs = tested.points_run();
            text += &format!("; no answer in {unanswered} of {runs} runs");
        }
        let mark = match tested.outcome() {
            None => CellMark::Neutral,
            Some(true) => CellMark::Good,
            Some(false) => CellMark::Bad,
        };
        ReportCell::with_mark(text, mark)
    }
}

impl SuiteFailure {
    /// Adds the files of a failure to `files`; `None` if the failure has no scenario.
    fn new(
        failed: &FailedPoint,
        controller: &NamedController,
        plan: &AssessmentPlan,
        files: &mut BTreeMap<String, String>,
    ) -> Result<Option<Self>, CacheError> {
        let Some(scenario) = &failed.scenario else {
            return Ok(None);
        };
        let text = file::to_toml(scenario).map_err(CacheError::encoding)?;
        let file = format!("counterexamples/suites/{}.toml", failed.scenario_name);
        let escape = match &failed.escape {
            None => None,
            Some(escape) => Some(EscapeFile::new(
                &file,
                file::to_toml(escape).map_err(CacheError::encoding)?,
                failed.escape_survives_multi_body,
            )),
        };
        files.extend(
            escape
                .iter()
                .map(|escape| (escape.file.clone(), escape.text.clone())),
        );
        let text_sha256 = sha256(&text);
        files.insert(file.clone(), text);
        // A controller without an answer causes no collision.
        let expected = match failed.verdict {
            TestVerdict::Failed { .. } => "collision",
            _ => "failure",
        };
        let replay = failure_command(&file, expected, failed, controller, plan);
        Ok(Some(Self {
            file,
            sha256: text_sha256,
            replay,
            escape,
        }))
    }

    fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.replay
            .iter()
            .chain(self.escape.iter().map(|escape| &escape.replay))
    }
}

/// Returns the command that simulates a failure, and expects it; `None` for an external controller.
fn failure_command(
    file: &str,
    expected: &str,
    failed: &FailedPoint,
    controller: &NamedController,
    plan: &AssessmentPlan,
) -> Option<CrumpleCommand> {
    let argument = failed.with_test_driver(&controller_arg(&*controller.source)?);
    let simulate = CrumpleCommand::new(["simulate", file, "--controller", argument.as_str()])
        .with_args(plan.estimator_args().iter().copied());
    Some(simulate.with_args(["--expect", expected]))
}

impl PlannedSuiteResult {
    fn matrix(&self) -> ReportTable {
        let names = self.controllers.iter().map(String::as_str);
        let mut table = ReportTable::new(
            &["test", "clause"]
                .into_iter()
                .chain(names)
                .collect::<Vec<_>>(),
        );
        for ((clause, test), outcomes) in self.result.tests().zip(self.tests()) {
            let chosen = if test.is_as_stated {
                ""
            } else {
                " (crumple chose some values)"
            };
            let head = [
                ReportCell::text(format!("{}{chosen}", test.name)),
                ReportCell::text(&clause.clause),
            ];
            table.push_row(
                head.into_iter()
                    .chain(outcomes.iter().map(SuiteOutcome::table_cell))
                    .collect(),
            );
        }
        table
    }

    fn details_table(&self) -> ReportTable {
        ReportTable::from_items(
            self.tests().flatten(),
            &[
                ("test", &|outcome| ReportCell::text(&outcome.test.name)),
                ("controller", &|outcome| {
                    ReportCell::text(&outcome.tested.controller)
                }),
                ("verdict", &|outcome| {
                    let verdict = describe_outcome(outcome.tested);
                    let warning = outcome.tested.warning.map(describe_warning);
                    ReportCell::text(match warning {
                        Some(warning) => format!("{verdict}; {warning}"),
                        None => verdict,
                    })
                }),
                ("margins", &|outcome| {
                    let margins = describe_min_margins(&outcome.tested.margins).join("; ");
                    text_or_dash(Some(margins).filter(|margins| !margins.is_empty()))
                }),
                ("worst within tolerances", &|outcome| {
                    let worst = outcome.tested.worst_in_tolerance.as_ref();
                    text_or_dash(worst.map(describe_worst_in_tolerance))
                }),
                ("preventable by", &|outcome| {
                    let worst = outcome.tested.fastest_failure();
                    text_or_dash(worst.map(|worst| {
                        format!("{}: {}", worst.point, describe_preventability(worst))
                    }))
                }),
            ],
        )
    }

    fn unanswered_notes(&self) -> Vec<String> {
        self.controllers
            .iter()
            .filter_map(|controller| self.unanswered_note(controller))
            .collect()
    }

    fn unanswered_note(&self, controller: &str) -> Option<String> {
        let mut unanswered = None;
        let mut runs = 0;
        for outcome in self.outcomes_of(controller) {
            FailedControllerRuns::merge(&mut unanswered, outcome.tested.total_unanswered());
            runs += outcome.tested.points_run() as u64;
        }
        Some(note_unanswered(controller, &unanswered?, runs))
    }

    fn describe(&self) -> String {
        let SuiteResult {
            document,
            edition,
            parameter_source,
            ..
        } = &self.result;
        format!(
            "Modelled on {document}, {edition}. Source of the parameters: {parameter_source} {DISCLAIMER}"
        )
    }

    fn replay_commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let failures = self.failures.iter().flatten().flatten();
        failures.flat_map(SuiteFailure::commands)
    }
}

fn text_or_dash(text: Option<String>) -> ReportCell {
    ReportCell::text(text.unwrap_or_else(|| "–".to_owned()))
}

const INTRODUCTION: &str = "Each test is a grid of scenarios, and passes if no vehicle collides before its end. A cell \
    gives the passed scenarios and the fastest impact. Other requirements of the documents are outside the model.";

impl ReportPart for Suites {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::StatedScenarios,
            anchor: ANCHOR,
            title: "Tests modelled on regulations",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        plan.suites.iter().map(PlannedSuite::run_count).sum()
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(format!("{INTRODUCTION} {}", self.statement));
        self.suites.iter().for_each(|suite| suite.write(out));
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let suites = plan.suites.iter().zip(&self.suites);
        suites
            .flat_map(|(planned, suite)| suite.evidence(plan, planned))
            .collect()
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        plan.suites
            .iter()
            .map(|planned| ClaimDraft::new(ANCHOR, claims(plan, planned)))
            .collect()
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        self.files
            .iter()
            .map(|(name, text)| (name.clone(), text.clone().into_bytes()))
            .collect()
    }
}

impl PlannedSuiteResult {
    fn write(&self, out: &mut ReportDocument) {
        out.heading(&self.content_id.name);
        out.paragraph(self.describe());
        out.table(self.matrix());
        for note in self.unanswered_notes() {
            out.paragraph(note);
        }
        out.collapsible(
            "verdicts, margins and worst points within tolerances",
            self.details_table(),
        );
        let mut omissions = ReportDocument::new();
        let omitted = &self.result.omitted_parameters;
        omissions.list(self.result.not_modelled.iter().chain(omitted));
        out.collapsible("not modelled, or omitted", omissions);
        let commands = self.replay_commands().map(ToString::to_string);
        out.push(ReportBlock::Commands(commands.collect()));
    }

    fn evidence(&self, plan: &AssessmentPlan, planned: &PlannedSuite) -> Vec<Evidence> {
        let claims = claims(plan, planned);
        let tested = planned.controller_indices.iter().zip(&self.controllers);
        tested
            .filter_map(|(&index, controller)| {
                let claim = claims.get(index)?.clone()?;
                Some(self.evidence_for(claim, &self.counts(controller)))
            })
            .collect()
    }

    /// Adds up the outcomes of all tests for one controller.
    fn counts(&self, controller: &str) -> SuiteCounts {
        let mut counts = SuiteCounts::default();
        for outcome in self.outcomes_of(controller) {
            counts.add(outcome.tested);
        }
        counts
    }

    /// A search concentrates on failures, so its failures count only if the tests themselves refute nothing.
    fn evidence_for(&self, claim: AssuranceClaim, counts: &SuiteCounts) -> Evidence {
        let tests_strength = counts.strength_of_tests();
        if tests_strength.is_refutation() {
            let description = format!("{} points of the tests", counts.points);
            return Evidence {
                claim,
                strength: tests_strength,
                first_violation: None,
                source: EvidenceSource::from_part(ANCHOR, description),
            };
        }
        let description = format!("{} points of tests and search", counts.runs);
        Evidence {
            claim,
            strength: counts.strength_with_search(),
            first_violation: None,
            source: EvidenceSource::from_part(ANCHOR, description),
        }
    }
}

/// The outcomes of all tests of a suite for one controller.
#[derive(Debug, Default)]
struct SuiteCounts {
    points: u64,
    points_failed: u64,
    /// Failed points without an answer of the controller.
    unanswered: Option<FailedControllerRuns>,
    runs: u64,
    failures: u64,
    /// Failed points of the search without an answer of the controller.
    unanswered_in_tolerance: Option<FailedControllerRuns>,
}

impl SuiteCounts {
    fn add(&mut self, tested: &ControllerResult) {
        let failed = tested.failed_points.len();
        self.points += (failed + tested.passed_points) as u64;
        self.points_failed += failed as u64;
        self.runs += tested.points_run() as u64;
        self.failures += tested.points_failed() as u64;
        FailedControllerRuns::merge(&mut self.unanswered, tested.unanswered());
        let in_tolerance = tested.unanswered_in_tolerance();
        FailedControllerRuns::merge(&mut self.unanswered_in_tolerance, in_tolerance);
    }

    fn strength_of_tests(&self) -> Strength {
        point_strength(self.points_failed, self.points, self.unanswered.as_ref())
    }

    fn strength_with_search(&self) -> Strength {
        let unanswered = self.unanswered_in_tolerance.as_ref();
        point_strength(self.failures, self.runs, unanswered)
    }
}

/// A point without an answer is a failure of the controller, but no collision.
fn point_strength(failed: u64, points: u64, unanswered: Option<&FailedControllerRuns>) -> Strength {
    let collisions = failed.saturating_sub(unanswered.map_or(0, |unanswered| unanswered.runs));
    Strength::from_counts_with_unanswered(collisions, points, unanswered, true)
}
