//! Suites of tests that are modelled on regulations, each with its matrix.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::distinct_failure::EscapeFile;
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
    describe_min_margins, describe_preventability, describe_verdict, describe_warning,
    describe_worst_in_tolerance,
};
use crumple_core::digest::sha256;
use crumple_sim::engine::{FailedControllerRuns, NamedController};
use crumple_sim::scenario::file;
use crumple_suites::{ControllerResult, DISCLAIMER, FailedPoint, TestVerdict, run};

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

/// The findings of all suites.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Suites {
    /// Disclaimer of the suites.
    pub statement: &'static str,
    /// One entry per suite.
    pub suites: Vec<SuiteFindings>,
    /// Failed scenarios by path, relative to the report folder.
    #[serde(skip)]
    files: BTreeMap<String, String>,
}

/// The findings of one suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SuiteFindings {
    /// Identifier of the suite.
    pub suite: ContentId,
    /// Document that the suite is modelled on, and its edition.
    pub document: String,
    /// Source of the parameters.
    pub parameter_source: String,
    /// Requirements of the document that the model cannot represent.
    pub not_modelled: Vec<String>,
    /// Omitted parameters, each with the reason.
    pub omitted_parameters: Vec<String>,
    /// Tested controllers, in the order of the outcomes of each test.
    pub controllers: Vec<String>,
    /// Tests of the suite.
    pub tests: Vec<SuiteTest>,
}

/// The findings of one test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SuiteTest {
    /// Clause of the document.
    pub clause: String,
    /// Name of the test.
    pub name: String,
    /// Names of the requirements that the test verifies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub requirement: Vec<String>,
    /// True if the document states all parameters; otherwise crumple chose some.
    pub is_as_stated: bool,
    /// One entry per controller.
    pub outcomes: Vec<SuiteOutcome>,
}

/// The outcome of a test for one controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SuiteOutcome {
    /// True if the test passed; absent if it could not be run.
    pub passed: Option<bool>,
    /// Worst point of the grid, in words.
    pub verdict: String,
    /// Number of points of the grid.
    pub points: u64,
    /// Number of points that passed.
    pub points_passed: u64,
    /// Number of points that failed; the rest cannot be run.
    pub points_failed: u64,
    /// Failed points at which the controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Number of simulated points, of the grid and of the search within ranges and tolerances.
    pub runs: u64,
    /// Number of simulated points that failed.
    pub failures: u64,
    /// Failed points of the search at which the controller gave no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "unanswered_within")]
    pub unanswered_in_tolerance: Option<FailedControllerRuns>,
    /// Warning after which the driver brakes, in words; absent in tests without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
    /// Margins to failure, in words.
    pub margins: Vec<String>,
    /// Worst point found within the ranges and tolerances of the clause, in words; absent if the clause has none.
    #[serde(alias = "within")]
    pub worst_in_tolerance: Option<String>,
    /// Failure with the highest impact speed.
    pub worst: Option<SuiteFailure>,
}

/// A point that failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SuiteFailure {
    /// Path of the scenario file, relative to the report folder.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Command that simulates the failure; absent for an external controller and for one that failed.
    pub replay: Option<CrumpleCommand>,
    /// Parameters of the point.
    pub point: String,
    /// Description of the failure.
    #[serde(alias = "what")]
    pub description: String,
    /// Preventability by reference drivers.
    pub preventable: String,
    /// Escape, if the failure is avoidable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape: Option<EscapeFile>,
}

#[derive(Serialize, Deserialize)]
pub(in crate::assessment) struct SuiteCacheEntry {
    #[serde(alias = "found")]
    findings: SuiteFindings,
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
            suites.push(gathered.findings);
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
    ) -> impl Iterator<Item = (&'s SuiteTest, &'s SuiteOutcome)> {
        let suite = self.suites.get(suite_index).into_iter();
        suite.flat_map(move |findings| findings.outcomes_of(controller))
    }

    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.suites.iter().flat_map(SuiteFindings::replay_commands)
    }
}

impl SuiteFindings {
    /// Returns the tests with the outcomes of a controller.
    pub(in crate::assessment) fn outcomes_of<'s>(
        &'s self,
        controller: &str,
    ) -> impl Iterator<Item = (&'s SuiteTest, &'s SuiteOutcome)> + use<'s> {
        let mut controllers = self.controllers.iter();
        let column = controllers.position(|name| name == controller);
        self.tests
            .iter()
            .filter_map(move |test| Some((test, test.outcomes.get(column?)?)))
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
    let mut tests = Vec::new();
    for (clause, test) in result.tests() {
        let mut outcomes = Vec::new();
        for (tested, controller) in test.controllers.iter().zip(tested) {
            outcomes.push(SuiteOutcome::new(tested, controller, plan, &mut files)?);
        }
        tests.push(SuiteTest {
            clause: clause.clause.clone(),
            name: test.name.clone(),
            requirement: test.requirement.clone(),
            is_as_stated: test.is_as_stated,
            outcomes,
        });
    }
    let findings = SuiteFindings {
        suite: planned.content_id.clone(),
        document: format!("{}, {}", result.document, result.edition),
        parameter_source: result.parameter_source,
        not_modelled: result.not_modelled,
        omitted_parameters: result.omitted_parameters,
        controllers: tested
            .iter()
            .map(|controller| controller.name.clone())
            .collect(),
        tests,
    };
    Ok(SuiteCacheEntry { findings, files })
}

impl SuiteOutcome {
    fn new(
        tested: &ControllerResult,
        controller: &NamedController,
        plan: &AssessmentPlan,
        files: &mut BTreeMap<String, String>,
    ) -> Result<Self, AssessError> {
        let is_refused = matches!(tested.verdict, TestVerdict::Refused { .. });
        let within = tested.worst_in_tolerance.as_ref();
        let worst = tested.failures().max_by(|a, b| {
            let impact_mps = a.verdict.impact_speed_mps();
            impact_mps.total_cmp(&b.verdict.impact_speed_mps())
        });
        let failed = tested.failed_points.len() as u64;
        let passed = tested.passed_points as u64;
        Ok(Self {
            passed: (tested.is_passed() || !is_refused).then(|| tested.is_passed()),
            verdict: describe_verdict(&tested.verdict),
            points: tested.points as u64,
            points_passed: passed,
            points_failed: failed,
            unanswered: tested.unanswered(),
            runs: passed + failed + within.map_or(0, |within| within.points_run as u64),
            failures: failed + within.map_or(0, |within| within.failures as u64),
            unanswered_in_tolerance: within.and_then(|within| within.unanswered.clone()),
            warning: tested.warning.map(describe_warning).map(str::to_owned),
            margins: describe_min_margins(&tested.margins),
            worst_in_tolerance: within.map(describe_worst_in_tolerance),
            worst: worst
                .map(|worst| SuiteFailure::new(worst, controller, plan, files))
                .transpose()?,
        })
    }

    /// Returns the number of runs without an answer, of grid and search, and the reason of the first.
    pub(in crate::assessment) fn total_unanswered(&self) -> Option<FailedControllerRuns> {
        let mut unanswered = self.unanswered.clone();
        FailedControllerRuns::merge(&mut unanswered, self.unanswered_in_tolerance.clone());
        unanswered
    }

    fn table_cell(&self) -> ReportCell {
        // The reason for no answer is below the table, because it may be long.
        let unanswered = self
            .total_unanswered()
            .map_or(0, |unanswered| unanswered.runs);
        let collision = self.worst.as_ref().filter(|_| unanswered < self.failures);
        let mut text = match (self.points, self.passed, collision) {
            (0, ..) => "not run".to_owned(),
            (points, None, _) => format!(
                "{} of {points}; the others cannot be run",
                self.points_passed
            ),
            (points, Some(_), Some(worst)) => {
                format!("{} of {points}; {}", self.points_passed, worst.description)
            }
            (points, Some(_), None) => format!("{} of {points}", self.points_passed),
        };
        if unanswered > 0 {
            text += &format!("; no answer in {unanswered} of {} runs", self.runs);
        }
        let mark = self.passed.map_or(CellMark::Neutral, |passed| {
            if passed {
                CellMark::Good
            } else {
                CellMark::Bad
            }
        });
        ReportCell::with_mark(text, mark)
    }
}

impl SuiteFailure {
    fn new(
        failed: &FailedPoint,
        controller: &NamedController,
        plan: &AssessmentPlan,
        files: &mut BTreeMap<String, String>,
    ) -> Result<Self, CacheError> {
        let text = file::to_toml(&failed.scenario).map_err(CacheError::encoding)?;
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
        // A controller without an answer causes no collision, which the command expects.
        let replay = match failed.verdict {
            TestVerdict::Failed { .. } => collision_command(&file, failed, controller, plan),
            _ => None,
        };
        Ok(Self {
            file,
            sha256: text_sha256,
            replay,
            point: failed.point.clone(),
            description: describe_verdict(&failed.verdict),
            preventable: describe_preventability(failed),
            escape,
        })
    }

    fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.replay
            .iter()
            .chain(self.escape.iter().map(|escape| &escape.replay))
    }
}

/// Returns the command that simulates a collision; `None` for an external controller.
fn collision_command(
    file: &str,
    failed: &FailedPoint,
    controller: &NamedController,
    plan: &AssessmentPlan,
) -> Option<CrumpleCommand> {
    let argument = failed.with_test_driver(&controller_arg(&*controller.source)?);
    let simulate = CrumpleCommand::new(["simulate", file, "--controller", argument.as_str()])
        .with_args(plan.estimator_args().iter().copied());
    Some(simulate.with_args(["--expect", "collision"]))
}

impl SuiteFindings {
    fn matrix(&self) -> ReportTable {
        let names = self.controllers.iter().map(String::as_str);
        let mut table = ReportTable::new(
            &["test", "clause"]
                .into_iter()
                .chain(names)
                .collect::<Vec<_>>(),
        );
        for test in &self.tests {
            let chosen = if test.is_as_stated {
                ""
            } else {
                " (some parameters chosen)"
            };
            let head = [
                ReportCell::text(format!("{}{chosen}", test.name)),
                ReportCell::text(&test.clause),
            ];
            table.push_row(
                head.into_iter()
                    .chain(test.outcomes.iter().map(SuiteOutcome::table_cell))
                    .collect(),
            );
        }
        table
    }

    fn details_table(&self) -> ReportTable {
        let outcomes = self.tests.iter().flat_map(|test| {
            self.controllers
                .iter()
                .zip(&test.outcomes)
                .map(move |(controller, outcome)| (test, controller, outcome))
        });
        ReportTable::from_items(
            outcomes,
            &[
                ("test", &|(test, ..)| ReportCell::text(&test.name)),
                ("controller", &|(_, controller, _)| {
                    ReportCell::text(controller)
                }),
                ("verdict", &|(.., outcome)| {
                    let parts = [Some(&outcome.verdict), outcome.warning.as_ref()];
                    let parts: Vec<&str> =
                        parts.into_iter().flatten().map(String::as_str).collect();
                    ReportCell::text(parts.join("; "))
                }),
                ("margins", &|(.., outcome)| {
                    let margins = outcome.margins.join("; ");
                    text_or_dash(Some(margins).filter(|margins| !margins.is_empty()))
                }),
                ("worst within tolerances", &|(.., outcome)| {
                    text_or_dash(outcome.worst_in_tolerance.clone())
                }),
                ("preventable by", &|(.., outcome)| {
                    let worst = outcome.worst.as_ref();
                    text_or_dash(
                        worst.map(|worst| format!("{}: {}", worst.point, worst.preventable)),
                    )
                }),
            ],
        )
    }

    fn unanswered_notes(&self) -> Vec<String> {
        self.controllers
            .iter()
            .enumerate()
            .filter_map(|(column, controller)| self.unanswered_note(column, controller))
            .collect()
    }

    fn unanswered_note(&self, column: usize, controller: &str) -> Option<String> {
        let mut unanswered = None;
        let mut runs = 0;
        for outcome in self
            .tests
            .iter()
            .filter_map(|test| test.outcomes.get(column))
        {
            FailedControllerRuns::merge(&mut unanswered, outcome.total_unanswered());
            runs += outcome.runs;
        }
        Some(note_unanswered(controller, &unanswered?, runs))
    }

    fn describe(&self) -> String {
        format!(
            "Modelled on {}. Source of the parameters: {} {DISCLAIMER}",
            self.document, self.parameter_source
        )
    }

    fn replay_commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let outcomes = self.tests.iter().flat_map(|test| &test.outcomes);
        outcomes
            .filter_map(|outcome| outcome.worst.as_ref())
            .flat_map(SuiteFailure::commands)
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
        self.suites.iter().for_each(|findings| findings.write(out));
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let suites = plan.suites.iter().zip(&self.suites);
        suites
            .flat_map(|(planned, findings)| findings.evidence(plan, planned))
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

impl SuiteFindings {
    fn write(&self, out: &mut ReportDocument) {
        out.heading(&self.suite.name);
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
        omissions.list(self.not_modelled.iter().chain(&self.omitted_parameters));
        out.collapsible("not modelled, or omitted", omissions);
        let commands = self.replay_commands().map(ToString::to_string);
        out.push(ReportBlock::Commands(commands.collect()));
    }

    fn evidence(&self, plan: &AssessmentPlan, planned: &PlannedSuite) -> Vec<Evidence> {
        let claims = claims(plan, planned);
        planned
            .controller_indices
            .iter()
            .enumerate()
            .filter_map(|(column, &index)| {
                let claim = claims.get(index)?.clone()?;
                Some(self.evidence_for(claim, &self.counts(column)))
            })
            .collect()
    }

    /// Adds up the outcomes of all tests for one controller.
    fn counts(&self, column: usize) -> SuiteCounts {
        let mut counts = SuiteCounts::default();
        for test in &self.tests {
            if let Some(outcome) = test.outcomes.get(column) {
                counts.add(outcome);
            }
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
                source: EvidenceSource::from_part(ANCHOR, description),
            };
        }
        let description = format!("{} points of tests and search", counts.runs);
        Evidence {
            claim,
            strength: counts.strength_with_search(),
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
    fn add(&mut self, outcome: &SuiteOutcome) {
        self.points += outcome.points_failed + outcome.points_passed;
        self.points_failed += outcome.points_failed;
        self.runs += outcome.runs;
        self.failures += outcome.failures;
        FailedControllerRuns::merge(&mut self.unanswered, outcome.unanswered.clone());
        let in_tolerance = outcome.unanswered_in_tolerance.clone();
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
