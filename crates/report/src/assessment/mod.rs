//! The assessment: which controller is safer, how we know, and where it still fails.
//!
//! [`assess`] gathers evidence into one typed value, an [`AssessmentReport`]; Markdown, HTML and JSON are all rendered from it.
//! It is made of parts, each with its own evidence type and its own rendering (see [`ReportPart`]); adding one means a file
//! under `parts/`, a field of [`AssessmentReport`] and a line in [`AssessmentReport::parts`].

mod avoidance;
mod cache;
mod case;
mod claims;
mod commands;
mod config;
mod document;
mod evidence_tasks;
mod gate;
mod gather_context;
mod junit;
mod page;
mod parts;
mod plan;
mod planned_suite;
mod prose;
mod rounded;
mod shard;
mod table;

use crate::markdown;

use maud::Markup;
use serde::Serialize;

pub use crate::markdown::Markdown;
pub use avoidance::RoundedAvoidance;
pub use cache::{CacheError, EvidenceCache, EvidenceHash};
pub use case::{CaseResult, CaseVerdict, PileUp, RoundedContact, RoundedLeadMeasures, STILL_CLOSING_TTC_S};
pub use claims::{
    AssuranceClaim, ClaimStatus, ContentId, Domain, Evidence, EvidenceSource, InferenceRule, Ledger,
    MIN_CONFIDENCE_PERCENT, Property, SecondaryEvidence, Strength, Subject, UncomparedText,
};
pub use commands::{CommandFile, CrumpleCommand};
pub use config::{AssessConfig, AssessConfigError, CONFIG_VERSION, RatesConfig, SearchConfig};
pub use document::ReportDocument;
pub use gate::{AssessmentGate, GateResult};
pub use parts::{
    Argument, AssessmentChange, AssessmentComparison, AssessmentLimits, AssessmentProvenance, BRAKING_MPS2,
    BrakingTimes, BuildInfo, CertificateStatus, CertificateSubject, CheckedCertificate, ClaimRow, ClaimSummary,
    ComparisonError, ControllerSample, ControllerUsefulness, DistinctFailure, EXAMPLE_MPS, EarlierAssessment,
    EscapeFile, FailureMap, FailureMapAxis, FailureMaps, FailureSearch, FailureSearches, FileScenarios, FirstPage,
    FixedParameter, Glossary, GsnElement, GsnElementKind, KernelGap, LearnedPolicies, LearnedPolicy,
    LimitingAssumption, MAX_EVIDENCE_BYTES, MapCell, MapRow, MethodResult, MildestAttack, NameExplanation,
    PairedCounts, PaperScenarios, ParameterDescription, PercentInterval, Proofs, SafetyAnswer, ScenarioCases,
    SpaceDescription, SpaceDescriptions, SpaceSample, SpaceSamples, SpaceSearches, SpaceSpecificationSearches,
    SpecificationSearch, SpecificationSearches, SpecificationViolation, StringStabilityVerdict, SuiteFailure,
    SuiteFindings, SuiteOutcome, SuiteTest, Suites, UnknownCell, UsefulnessReport, WorstProfile, WorstProfiles,
};
pub use plan::AssessmentPlan;
pub use planned_suite::SuiteConfig;
pub use rounded::Rounded;
pub use shard::{ASSESSMENT_SHARD_KIND, EvidenceShardError, MergedEvidence, gather_shard};

use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_evidence::{InvalidRate, RateError};
use crumple_search::falsify::campaign::CampaignError;
use crumple_search::worst_case::AttackError;
use crumple_store::run_folder::{MANIFEST_FILE, manifest_text};
use crumple_suites::SuiteRunError;
use crumple_world::measure::SpecificationError;
use crumple_world::scenario::InvalidField;
use crumple_world::sim::{RefusedController, RunError};
use gather_context::GatherContext;
use parts::GatheredEvidence;

/// The version of the JSON evidence this release writes.
pub const EVIDENCE_VERSION: u32 = 3;

/// Everything an assessment found out.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentReport {
    /// Version of the evidence format.
    pub version: u32,
    /// The first page: the question and its answer.
    pub first_page: FirstPage,
    /// The verdict: claims, and how strongly each is supported.
    pub summary: ClaimSummary,
    /// All evidence, each piece with the claim that it speaks for.
    pub evidence: Ledger,
    /// The paper's three scenarios; none if the plan leaves the paper out.
    pub paper_scenarios: Option<PaperScenarios>,
    /// Failures counted on draws of spaces.
    pub distributions: SpaceSamples,
    /// Scenarios from files; none if the configuration names none.
    #[serde(rename = "traffic")]
    pub file_scenarios: Option<FileScenarios>,
    /// Tests after regulations; none if the configuration names no suites.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suites: Option<Suites>,
    /// What a search for failures found.
    pub searches: FailureSearches,
    /// What searches for broken rules found; none if the configuration names no rules.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(rename = "rules")]
    pub specification_searches: Option<SpecificationSearches>,
    /// The mildest lead braking against each controller.
    pub worst_profiles: Option<WorstProfiles>,
    /// What each controller survives over two parameters, and what no driver does.
    pub failure_maps: Option<FailureMaps>,
    /// What each controller does where nothing threatens; none if the plan makes no such drives.
    pub usefulness: Option<UsefulnessReport>,
    /// What is proved.
    pub proofs: Proofs,
    /// How the learned policies drive; none if there are none among the controllers.
    pub learned: Option<LearnedPolicies>,
    /// The spaces in numbers.
    #[serde(rename = "domains")]
    pub space_descriptions: SpaceDescriptions,
    /// What this does not show.
    pub limits: AssessmentLimits,
    /// The verdict as a goal structure.
    pub argument: Argument,
    /// What changed since an earlier assessment; none if there is none to compare with.
    pub comparison: Option<AssessmentComparison>,
    /// Where the evidence comes from.
    pub provenance: AssessmentProvenance,
    /// Files that commands of the report need.
    pub command_files: Vec<CommandFile>,
}

/// One part of an assessment.
pub trait ReportPart {
    /// Anchor of the part in the page, and its heading.
    fn anchor_and_title(&self) -> (&'static str, String);
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

/// Why an assessment could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssessError {
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A draw of a space is not a valid scenario.
    #[error("a draw is invalid: {0}")]
    Draw(#[from] InvalidField),
    /// The worst braking cannot be looked for.
    #[error(transparent)]
    Attack(#[from] AttackError),
    /// Failures cannot be searched for.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// Failures cannot be counted.
    #[error(transparent)]
    Rates(#[from] InvalidRate),
    /// A run cannot be counted.
    #[error(transparent)]
    Rate(#[from] RateError),
    /// A certificate that was just written cannot be read back.
    #[error("a certificate cannot be read back: {0}")]
    Certificate(String),
    /// Evidence cannot be kept.
    #[error(transparent)]
    Cache(#[from] CacheError),
    /// A rule does not fit a space.
    #[error("a rule does not fit: {0}")]
    Specification(#[from] SpecificationError),
    /// A controller contradicted itself, or cannot be started any more.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// A suite cannot be run.
    #[error(transparent)]
    Suite(#[from] SuiteRunError),
    /// The observer stopped the assessment. If that happened during a search, the error is that of the campaign.
    #[error("the assessment was {0}")]
    Stopped(#[from] Stopped),
}

/// Gathers the evidence that a plan asks for. Evidence in `store` is not gathered again. Nothing is kept if a controller states no identity.
/// If `observer` stops the assessment, `store` keeps what was gathered.
///
/// # Errors
/// [`AssessError`] if a scenario cannot be run or drawn, evidence cannot be kept, or `observer` stops the assessment.
///
/// ```
/// use crumple_core::observer::Quiet;
/// use crumple_report::assessment::{AssessConfig, AssessmentPlan, Store, assess};
/// use std::path::Path;
///
/// let mut config = AssessConfig::default();
/// config.controllers = vec!["idm".to_owned()];
/// config.gates.clear();
/// (config.paper, config.draws, config.everyday_draws, config.rates.runs) = (false, 20, 4, 0);
/// (config.search.spaces, config.certificates) = (Some(Vec::new()), Some(Vec::new()));
/// let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
/// let assessment = assess(&plan, &Store::none(), None, &Quiet).unwrap();
/// assert!(assessment.html().contains("</html>"));
/// ```
pub fn assess(
    plan: &AssessmentPlan,
    store: &EvidenceCache,
    against: Option<&EarlierAssessment>,
    observer: &dyn Observer<RunProgress>,
) -> Result<AssessmentReport, AssessError> {
    let nothing_kept = EvidenceCache::disabled();
    let store = if plan.first_without_identity().is_none() { store } else { &nothing_kept };
    let work = GatherContext::new(store, ProgressCounter::new(observer, Some(plan.runs())))
        .with_controllers(&plan.controllers);
    let paper_scenarios = PaperScenarios::gather(plan, &work)?;
    let distributions = SpaceSamples::gather(plan, &work)?;
    let traffic = FileScenarios::gather(plan, &work)?;
    let suites = Suites::gather(plan, &work)?;
    let searches = FailureSearches::gather(plan, &work)?;
    let rules = SpecificationSearches::gather(plan, &work)?;
    let worst_profiles = WorstProfiles::gather(plan, &work)?;
    let failure_maps = FailureMaps::gather(plan, &work)?;
    let usefulness = UsefulnessReport::gather(plan, &work)?;
    let scenarios = paper_scenarios.iter().flat_map(|paper| &paper.scenarios);
    let scenarios = scenarios.chain(traffic.iter().flat_map(|traffic| &traffic.scenarios));
    let proofs = Proofs::gather(plan, &work, scenarios)?;
    work.ensure_all_trusted()?;
    let limits = AssessmentLimits::new(plan);
    let found = GatheredEvidence {
        paper: paper_scenarios.as_ref(),
        distributions: &distributions,
        traffic: traffic.as_ref(),
        suites: suites.as_ref(),
        worst: worst_profiles.as_ref(),
        searches: &searches,
        rules: rules.as_ref(),
        usefulness: usefulness.as_ref(),
        proofs: &proofs,
    };
    let evidence = found.collect_ledger(plan);
    let summary = ClaimSummary::new(plan, &found, &evidence);
    let first_page = FirstPage::new(plan, &summary, &searches, usefulness.as_ref(), &limits);
    let argument = Argument::new(plan, &summary, &limits);
    let mut assessment = AssessmentReport {
        version: EVIDENCE_VERSION,
        learned: paper_scenarios.as_ref().and_then(|paper| LearnedPolicies::new(plan, paper)),
        provenance: AssessmentProvenance::new(plan, store),
        comparison: None,
        space_descriptions: SpaceDescriptions::new(plan, usefulness.as_ref()),
        command_files: plan.command_files()?,
        first_page,
        summary,
        evidence,
        paper_scenarios,
        distributions,
        file_scenarios: traffic,
        suites,
        searches,
        specification_searches: rules,
        worst_profiles,
        failure_maps,
        usefulness,
        proofs,
        limits,
        argument,
    };
    assessment.comparison = against.and_then(|earlier| AssessmentComparison::new(earlier, &assessment));
    // Gates come last: they judge everything else.
    let gates: Vec<_> = plan.config.gates.iter().map(|gate| gate.evaluate(plan, &assessment)).collect();
    assessment.first_page.gates.clone_from(&gates);
    assessment.summary.gates = gates;
    Ok(assessment)
}

impl AssessmentPlan {
    /// How many runs the plan asks for, roughly: searches may end early.
    #[must_use]
    pub fn runs(&self) -> u64 {
        let controllers = self.controllers.len() as u64;
        let scenarios = (crumple_world::scenario::built_in_scenario_names().len() + self.file_scenarios.len()) as u64;
        // A search has a method and two reference searches.
        let searched_by = 1 + self.config.search.specifications.len() as u64;
        let searches = 3 * self.spaces.len() as u64 * self.config.search.budget * searched_by;
        let each =
            scenarios + self.config.draws * self.distributions.len() as u64 + searches + parts::ATTACK_BUDGET as u64;
        let learned = self.controllers.iter().filter(|controller| controller.kind.is_learned()).count() as u64;
        let driven = controllers.saturating_mul(2 * self.config.everyday_draws);
        let counted = self.distributions.len() as u64 * (learned + 1);
        let tested: u64 = self.suites.iter().map(planned_suite::PlannedSuite::run_count).sum();
        tested + driven + controllers.saturating_mul(each) + counted.saturating_mul(self.config.rates.runs)
    }
}

impl AssessmentReport {
    /// The same with when and where it was made.
    #[must_use]
    pub fn with_build_info(mut self, made: BuildInfo) -> Self {
        self.provenance.build_info = Some(made);
        self
    }

    /// The parts in the order of the report, without the appendix.
    #[must_use]
    pub fn parts(&self) -> Vec<&dyn ReportPart> {
        let mut parts: Vec<&dyn ReportPart> = vec![&self.first_page, &self.summary];
        parts.extend(self.comparison.as_ref().map(|comparison| comparison as &dyn ReportPart));
        parts.extend(self.paper_scenarios.as_ref().map(|paper| paper as &dyn ReportPart));
        parts.extend(self.file_scenarios.as_ref().map(|traffic| traffic as &dyn ReportPart));
        parts.extend(self.suites.as_ref().map(|suites| suites as &dyn ReportPart));
        let (is_drawn, is_searched) = (!self.distributions.spaces.is_empty(), !self.searches.spaces.is_empty());
        parts.extend(is_drawn.then_some(&self.distributions as &dyn ReportPart));
        parts.extend(is_searched.then_some(&self.searches as &dyn ReportPart));
        parts.extend(self.specification_searches.as_ref().map(|rules| rules as &dyn ReportPart));
        parts.extend(self.usefulness.as_ref().map(|usefulness| usefulness as &dyn ReportPart));
        parts.extend([&self.proofs as &dyn ReportPart, &self.limits]);
        parts
    }

    /// The parts of the appendix.
    #[must_use]
    pub fn appendix(&self) -> Vec<&dyn ReportPart> {
        let mut parts: Vec<&dyn ReportPart> = vec![&self.argument];
        parts.extend(self.worst_profiles.as_ref().map(|worst| worst as &dyn ReportPart));
        parts.extend(self.failure_maps.as_ref().map(|maps| maps as &dyn ReportPart));
        parts.extend(self.learned.as_ref().map(|learned| learned as &dyn ReportPart));
        parts.extend([&self.space_descriptions as &dyn ReportPart, &Glossary, &self.provenance]);
        parts
    }

    /// The report as one self-contained HTML page.
    #[must_use]
    pub fn to_html(&self) -> String {
        page::render_html(self)
    }

    /// The first page alone, as a self-contained HTML page: question, answer and reasons.
    #[must_use]
    pub fn first_page_to_html(&self) -> String {
        page::render_first_page(self)
    }

    /// The report as Markdown, without figures.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        page::render_markdown(self)
    }

    /// The evidence as JSON.
    ///
    /// # Errors
    /// None in practice; the serializer's error is passed on rather than hidden.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self).map(|json| json + "\n")
    }

    /// Every file of the report, by its path from the folder of the report.
    ///
    /// # Errors
    /// [`RenderError`] in principle, if a writer fails.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, RenderError> {
        let mut texts = vec![
            ("assessment.html".to_owned(), self.to_html()),
            ("assessment.md".to_owned(), self.to_markdown()),
            ("assessment.json".to_owned(), self.to_json()?),
            ("assessment.junit.xml".to_owned(), junit::render_junit(self)),
            ("assessment.gsn.yaml".to_owned(), self.argument.to_yaml()),
            ("replay.sh".to_owned(), commands::replay_script(self.commands())),
        ];
        texts.extend(
            self.paper_scenarios
                .iter()
                .flat_map(PaperScenarios::figure_files)
                .map(|(name, svg)| (name, svg.document())),
        );
        texts.extend(self.proofs.certificates.iter().map(|proof| (proof.file.clone(), proof.text.clone())));
        let texts = texts.into_iter().map(|(name, text)| (name, text.into_bytes()));
        let needed = self.command_files.iter().map(|needed| (needed.file.clone(), needed.contents.clone()));
        let failures = self.searches.failures().flat_map(DistinctFailure::files);
        let of_suites = self.suites.iter().flat_map(Suites::files);
        let of_rules = self.specification_searches.iter().flat_map(SpecificationSearches::files);
        let mut all: Vec<_> = texts.chain(failures).chain(of_suites).chain(of_rules).chain(needed).collect();
        // Runs for other simulators are made of the counterexamples, and may be left out where a report is kept.
        let is_kept = |(name, _): &&(String, Vec<u8>)| !name.ends_with(".xosc") && !name.ends_with(".xodr");
        let contents = all.iter().filter(is_kept).map(|(name, contents)| (name.as_str(), contents.as_slice()));
        let manifest = manifest_text(REPORT_KIND, &self.provenance.config_sha256, contents)?;
        all.push((MANIFEST_FILE.to_owned(), manifest.into_bytes()));
        Ok(all)
    }

    /// Every command that shows again what the report shows, in its order.
    pub fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let failures = self.searches.failures().flat_map(DistinctFailure::commands);
        let of_suites = self.suites.iter().flat_map(Suites::commands);
        let of_rules = self.specification_searches.iter().flat_map(SpecificationSearches::commands);
        failures.chain(of_suites).chain(of_rules).chain(self.worst_profiles.iter().flat_map(WorstProfiles::commands))
    }
}

/// What a folder with a report holds, as `work.json` there says.
pub const REPORT_KIND: &str = "report of an assessment";

/// The folders of a report that hold files which another report may not have.
pub const REPORT_FOLDERS: [&str; 5] = ["counterexamples/", "certificates/", "controllers/", "spaces/", "scenarios/"];

/// Why a report cannot be written down.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The JSON cannot be written.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
}
