//! The assessment: which controller is safer, with evidence and remaining failures.
//!
//! [`assess`] gathers evidence into an [`AssessmentReport`], which is rendered as Markdown, HTML and JSON. Each part
//! has its own evidence type and rendering (see [`ReportPart`]). A new part needs a file under `parts/`, a field of
//! [`AssessmentReport`] and a line in [`AssessmentReport::parts`].

mod avoidance;
mod cache;
mod case;
mod claims;
mod commands;
mod config;
mod controller_arg;
mod document;
mod followers;
mod gate;
mod gate_evaluation;
mod gather_context;
mod junit;
mod page;
mod parts;
mod plan;
mod planned_suite;
mod prose;
mod rounded;
mod run_ends;
mod table;

use maud::Markup;
use serde::Serialize;

pub use avoidance::RoundedAvoidance;
pub use cache::{CacheError, EvidenceCache, EvidenceHash};
pub use case::{
    CaseResult, CaseVerdict, PileUp, RoundedContact, RoundedLeadMeasures, STILL_CLOSING_TTC_S,
};
pub use claims::{
    AssuranceClaim, ClaimStatus, ContentId, Domain, Evidence, EvidenceSource, InferenceRule,
    Ledger, MIN_CONFIDENCE_PERCENT, Property, SecondaryEvidence, Strength, Subject, UncomparedText,
};
pub use commands::{CommandFile, CrumpleCommand};
pub use config::{
    AssessConfig, AssessConfigError, CONFIG_VERSION, HarmConfig, RatesConfig, SearchConfig,
};
use crumple_core::markdown::Markdown;
pub use document::ReportDocument;
pub use gate::AssessmentGate;
pub use gate_evaluation::GateResult;
pub use parts::{
    ACTIVATION_MPS2, Argument, AssessmentChange, AssessmentComparison, AssessmentLimits,
    AssessmentProvenance, CertificateStatus, CertificateSubject, CheckedCertificate, ClaimRow,
    ClaimSummary, ControllerHarm, ControllerSample, ControllerUsefulness, DistinctFailure,
    EarlierAssessment, EscapeFile, FailureSearch, FailureSearches, FileScenarios, FirstPage,
    GainCurve, Glossary, HarmGroup, HarmReport, LargestGain, LimitingAssumption,
    MAX_EVIDENCE_BYTES, MethodResult, NameExplanation, OscillationGain, PairedCounts,
    PaperScenarios, ParameterDescription, PercentInterval, Proofs, RunInfo, SafetyAnswer,
    ScenarioCases, SpaceDescription, SpaceDescriptions, SpaceSample, SpaceSamples, SpaceSearches,
    SuiteFailure, SuiteFindings, SuiteOutcome, SuiteTest, Suites, UsefulnessReport,
};
pub use plan::AssessmentPlan;
pub use planned_suite::SuiteConfig;
pub use rounded::Rounded;
pub use run_ends::RunEnds;

use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_evidence::{InvalidRate, RateError};
use crumple_measure::GainError;
use crumple_search::falsify::campaign::CampaignError;
use crumple_sim::engine::{RefusedController, RunError};
use crumple_sim::scenario::InvalidField;
use crumple_store::run_folder::{MANIFEST_FILE, manifest_text};
use crumple_suites::SuiteRunError;
use gather_context::GatherContext;

/// Version of the JSON evidence that this release writes.
pub const EVIDENCE_VERSION: u32 = 4;

/// All results of an assessment.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentReport {
    /// Version of the evidence format.
    pub version: u32,
    /// First page: the question and its answer.
    pub first_page: FirstPage,
    /// Verdict: claims, and the strength of their evidence.
    pub summary: ClaimSummary,
    /// All evidence, each piece with its claim.
    pub evidence: Ledger,
    /// Paper's three scenarios; absent if the plan leaves the paper out.
    pub paper_scenarios: Option<PaperScenarios>,
    /// Failures counted on random scenarios of scenario spaces.
    #[serde(rename = "distributions")]
    pub rate_spaces: SpaceSamples,
    /// Collisions ahead and behind, and harm; absent unless the configuration asks for them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub harm: Option<HarmReport>,
    /// Scenarios from files; absent if the configuration names none.
    #[serde(rename = "traffic")]
    pub file_scenarios: Option<FileScenarios>,
    /// Tests that are modelled on regulations; absent if the configuration names no suites.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suites: Option<Suites>,
    /// Results of searches for failures.
    pub searches: FailureSearches,
    /// Behaviour of each controller in everyday traffic; absent if the plan makes no such drives.
    pub usefulness: Option<UsefulnessReport>,
    /// Proved claims.
    pub proofs: Proofs,
    /// Statistics of the scenario spaces.
    #[serde(rename = "domains")]
    pub space_descriptions: SpaceDescriptions,
    /// Limits of the assessment.
    pub limits: AssessmentLimits,
    /// Safety case: the verdict as a goal structure, in `assessment.gsn.yaml`.
    #[serde(skip)]
    pub argument: Argument,
    /// Changes since an earlier assessment; absent if there is none to compare with.
    pub comparison: Option<AssessmentComparison>,
    /// Provenance of the evidence.
    pub provenance: AssessmentProvenance,
    /// Files that commands of the report need.
    pub command_files: Vec<CommandFile>,
}

impl From<GainError> for AssessError {
    fn from(error: GainError) -> Self {
        match error {
            GainError::Scenario(invalid) => Self::Draw(invalid),
            GainError::Run(error) => Self::Run(error),
        }
    }
}

/// One part of an assessment.
pub trait ReportPart {
    /// Writes the part, without its heading.
    fn write(&self, out: &mut ReportDocument);

    /// Returns the part as HTML, without its heading.
    fn to_html(&self) -> Markup {
        self.to_document().into_html()
    }

    /// Returns the part as Markdown, without its heading.
    fn to_markdown(&self) -> Markdown {
        self.to_document().into_markdown()
    }

    #[doc(hidden)]
    fn to_document(&self) -> ReportDocument {
        let mut document = ReportDocument::default();
        self.write(&mut document);
        document
    }
}

/// A part of an assessment, with its heading and its anchor in the page.
#[derive(Clone, Copy)]
pub struct ReportSection<'a> {
    /// Anchor in the page.
    pub anchor: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Part below the heading.
    pub part: &'a dyn ReportPart,
}

impl<'a> ReportSection<'a> {
    fn new(anchor: &'static str, title: &'static str, part: &'a dyn ReportPart) -> Self {
        Self {
            anchor,
            title,
            part,
        }
    }

    fn optional(
        anchor: &'static str,
        title: &'static str,
        part: Option<&'a impl ReportPart>,
    ) -> Option<Self> {
        part.map(|part| Self::new(anchor, title, part))
    }
}

/// An error of an assessment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssessError {
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A random scenario of a space is invalid.
    #[error("a random scenario is invalid: {0}")]
    Draw(#[from] InvalidField),
    /// The search for failures fails.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// Failures cannot be counted.
    #[error(transparent)]
    Rates(#[from] InvalidRate),
    /// A run cannot be counted.
    #[error(transparent)]
    Rate(#[from] RateError),
    /// A certificate that was just written cannot be read back.
    #[error("a certificate that was just written cannot be read: {0}")]
    Certificate(String),
    /// Evidence cannot be cached.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// A specification does not fit a space.
    /// A controller contradicted itself, or can no longer be started.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// A suite cannot be run.
    #[error(transparent)]
    Suite(#[from] SuiteRunError),
    /// The observer stopped the assessment. If that happened during a search, the error is that of the campaign.
    #[error("the assessment was {0}")]
    Stopped(#[from] Stopped),
}

/// Gathers the evidence that a plan asks for, except for evidence that `cache` holds. Nothing is cached if a controller
/// has no identity. If `observer` stops the assessment, `cache` keeps the evidence gathered so far.
///
/// # Errors
/// [`AssessError`] if a scenario cannot be run or drawn, evidence cannot be cached, or `observer` stops the assessment.
///
/// ```
/// use crumple_core::observer::Quiet;
/// use crumple_report::assessment::{AssessConfig, AssessmentPlan, EvidenceCache, assess};
/// use std::path::Path;
///
/// let mut config = AssessConfig::default();
/// config.controllers = vec!["idm".to_owned()];
/// config.gates.clear();
/// (config.paper, config.draws, config.everyday_draws, config.rates.runs) = (false, 20, 4, 0);
/// (config.search.spaces, config.certificates) = (Some(Vec::new()), Some(Vec::new()));
/// let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
/// let assessment = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
/// assert!(assessment.to_html().contains("</html>"));
/// ```
pub fn assess(
    plan: &AssessmentPlan,
    cache: &EvidenceCache,
    against: Option<&EarlierAssessment>,
    observer: &dyn Observer<RunProgress>,
) -> Result<AssessmentReport, AssessError> {
    let disabled = EvidenceCache::disabled();
    let cache = if plan.first_without_identity().is_none() {
        cache
    } else {
        &disabled
    };
    let work = GatherContext::new(
        plan,
        cache,
        ProgressCounter::new(observer, Some(plan.runs())),
    );
    let paper_scenarios = PaperScenarios::gather(&work)?;
    let rate_spaces = SpaceSamples::gather(&work)?;
    let harm = HarmReport::gather(&work)?;
    let traffic = FileScenarios::gather(&work)?;
    let suites = Suites::gather(&work)?;
    let searches = FailureSearches::gather(&work)?;
    let usefulness = UsefulnessReport::gather(&work)?;
    let scenarios = paper_scenarios.iter().flat_map(|paper| &paper.scenarios);
    let scenarios = scenarios.chain(traffic.iter().flat_map(|traffic| &traffic.scenarios));
    let proofs = Proofs::gather(&work, scenarios)?;
    work.ensure_all_trusted()?;
    let mut assessment = AssessmentReport {
        version: EVIDENCE_VERSION,
        provenance: AssessmentProvenance::new(plan, cache),
        comparison: None,
        space_descriptions: SpaceDescriptions::new(plan),
        command_files: plan.command_files()?,
        // These depend on the other parts.
        evidence: Ledger::default(),
        summary: ClaimSummary::default(),
        first_page: FirstPage::default(),
        argument: Argument::default(),
        paper_scenarios,
        rate_spaces,
        harm,
        file_scenarios: traffic,
        suites,
        searches,
        usefulness,
        proofs,
        limits: AssessmentLimits::new(plan),
    };
    assessment.evidence = assessment.collect_ledger(plan);
    assessment.summary = ClaimSummary::new(plan, &assessment);
    assessment.first_page = FirstPage::new(plan, &assessment);
    assessment.argument = Argument::new(plan, &assessment.summary, &assessment.limits);
    assessment.comparison =
        against.and_then(|earlier| AssessmentComparison::new(earlier, &assessment));
    // Gates come last: they evaluate all other results.
    let gates: Vec<_> = plan
        .config
        .gates
        .iter()
        .map(|gate| gate.evaluate(plan, &assessment))
        .collect();
    assessment.first_page.gates.clone_from(&gates);
    assessment.summary.gates = gates;
    Ok(assessment)
}

impl AssessmentPlan {
    /// Returns the approximate number of runs of the plan: searches may end early.
    #[must_use]
    pub fn runs(&self) -> u64 {
        let controllers = self.controllers.len() as u64;
        let scenarios = (crumple_sim::scenario::built_in_scenario_names().len()
            + self.file_scenarios.len()) as u64;
        // A search has a method and two reference searches.
        let searches = 3 * self.search_spaces.len() as u64 * self.config.search.budget;
        let drawn = self.config.draws
            * self.rate_spaces.len() as u64
            * if self.config.harm.is_some() { 2 } else { 1 };
        let each = scenarios + drawn + searches;
        let learned = self
            .controllers
            .iter()
            .filter(|controller| controller.source.is_learned())
            .count() as u64;
        let driven = controllers.saturating_mul(2 * self.config.everyday_draws);
        let counted = self.rate_spaces.len() as u64 * (learned + 1);
        let tested: u64 = self
            .suites
            .iter()
            .map(planned_suite::PlannedSuite::run_count)
            .sum();
        tested
            + driven
            + controllers.saturating_mul(each)
            + counted.saturating_mul(self.config.rates.runs)
    }
}

impl AssessmentReport {
    fn collect_ledger(&self, plan: &AssessmentPlan) -> Ledger {
        let mut all = Vec::new();
        all.extend(
            self.paper_scenarios
                .iter()
                .flat_map(|part| part.evidence(plan)),
        );
        all.extend(self.rate_spaces.evidence(plan));
        all.extend(
            self.file_scenarios
                .iter()
                .flat_map(|part| part.evidence(plan)),
        );
        all.extend(self.suites.iter().flat_map(|part| part.evidence(plan)));
        all.extend(self.searches.evidence(plan));
        all.extend(self.usefulness.iter().flat_map(|part| part.evidence(plan)));
        all.extend(self.proofs.evidence(plan));
        Ledger::new(all)
    }

    /// Adds the time, program and machine of the assessment.
    #[must_use]
    pub fn with_run_info(mut self, made: RunInfo) -> Self {
        self.provenance.run_info = Some(made);
        self
    }

    /// Returns the parts in the order of the report, without the appendix.
    #[must_use]
    pub fn parts(&self) -> Vec<ReportSection<'_>> {
        let rate_spaces = Some(&self.rate_spaces).filter(|drawn| !drawn.spaces.is_empty());
        let searches = Some(&self.searches).filter(|searches| !searches.spaces.is_empty());
        let harm = "Collisions ahead avoided, collisions behind caused, and harm";
        let parts = [
            ReportSection::optional("answer", "Result", Some(&self.first_page)),
            ReportSection::optional("verdict", "Claims", Some(&self.summary)),
            ReportSection::optional(
                "changes",
                "Changes since the earlier assessment",
                self.comparison.as_ref(),
            ),
            ReportSection::optional(
                "paper",
                "The paper's scenarios",
                self.paper_scenarios.as_ref(),
            ),
            ReportSection::optional(
                "traffic",
                "Scenario files and recordings",
                self.file_scenarios.as_ref(),
            ),
            ReportSection::optional(
                "suites",
                "Tests modelled on regulations",
                self.suites.as_ref(),
            ),
            ReportSection::optional("distribution", "Collision rates", rate_spaces),
            ReportSection::optional("harm", harm, self.harm.as_ref()),
            ReportSection::optional("search", "Counterexamples found by search", searches),
            ReportSection::optional(
                "usefulness",
                "Comfort and unnecessary braking",
                self.usefulness.as_ref(),
            ),
            ReportSection::optional("proofs", "Proofs", Some(&self.proofs)),
            ReportSection::optional("limits", "Limits", Some(&self.limits)),
        ];
        parts.into_iter().flatten().collect()
    }

    /// Returns the parts of the appendix.
    #[must_use]
    pub fn appendix(&self) -> Vec<ReportSection<'_>> {
        vec![
            ReportSection::new("domain", "Scenario spaces", &self.space_descriptions),
            ReportSection::new("glossary", "Glossary", &Glossary),
            ReportSection::new("provenance", "Provenance", &self.provenance),
        ]
    }

    /// Returns the report as one self-contained HTML page.
    #[must_use]
    pub fn to_html(&self) -> String {
        page::render_html(self)
    }

    /// Returns the first page as a self-contained HTML page: question, answer and reasons.
    #[must_use]
    pub fn first_page_to_html(&self) -> String {
        page::render_first_page(self)
    }

    /// Returns the report as Markdown, without figures.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        page::render_markdown(self)
    }

    /// Returns the evidence as JSON.
    ///
    /// # Errors
    /// None in practice; an error of the serializer is passed on.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self).map(|json| json + "\n")
    }

    /// Returns every file of the report, with its path relative to the report folder.
    ///
    /// # Errors
    /// None in practice; an error of the serializer is passed on.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, serde_json::Error> {
        let mut texts = vec![
            ("assessment.html".to_owned(), self.to_html()),
            ("assessment.md".to_owned(), self.to_markdown()),
            ("assessment.json".to_owned(), self.to_json()?),
            ("assessment.junit.xml".to_owned(), junit::render_junit(self)),
            ("assessment.gsn.yaml".to_owned(), self.argument.to_yaml()),
            (
                "replay.sh".to_owned(),
                commands::replay_script(self.proofs.recount_command().as_ref(), self.commands()),
            ),
        ];
        texts.extend(
            self.harm
                .iter()
                .map(|harm| ("runs.csv".to_owned(), harm.runs_csv.clone())),
        );
        let figures = self
            .paper_scenarios
            .iter()
            .flat_map(PaperScenarios::figure_files);
        texts.extend(figures.map(|(name, svg)| (name, svg.document())));
        let written = self
            .proofs
            .certificates
            .iter()
            .filter_map(|proof| Some((proof.file.clone()?, proof.text.clone())));
        texts.extend(written);
        let texts = texts
            .into_iter()
            .map(|(name, text)| (name, text.into_bytes()));
        let needed = self
            .command_files
            .iter()
            .map(|needed| (needed.file.clone(), needed.contents.clone()));
        let failures = self.searches.failures().flat_map(DistinctFailure::files);
        let of_suites = self.suites.iter().flat_map(Suites::files);
        let mut all: Vec<_> = texts
            .chain(failures)
            .chain(of_suites)
            .chain(needed)
            .collect();
        let contents = all
            .iter()
            .map(|(name, contents)| (name.as_str(), contents.as_slice()));
        let manifest = manifest_text(REPORT_KIND, &self.provenance.config_sha256, contents)?;
        all.push((MANIFEST_FILE.to_owned(), manifest.into_bytes()));
        Ok(all)
    }

    /// Returns every command that reproduces a result of the report, in its order.
    pub fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let failures = self.searches.failures().flat_map(DistinctFailure::commands);
        let of_suites = self.suites.iter().flat_map(Suites::commands);
        failures.chain(of_suites)
    }
}

/// Content of a report folder, as its `work.json` states it.
pub const REPORT_KIND: &str = "report of an assessment";

/// Subfolders of a report whose files may differ between reports.
pub const REPORT_FOLDERS: [&str; 5] = [
    "counterexamples/",
    "certificates/",
    "controllers/",
    "spaces/",
    "scenarios/",
];
