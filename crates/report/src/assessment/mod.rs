//! The assessment: which controller is safer, with evidence and remaining failures.
//!
//! [`assess`] gathers results into [`GatheredResults`], and derives an [`AssessmentReport`] from them: evidence,
//! claims, gates and the answer. It is written as HTML, Markdown, JSON, JUnit and a safety case. Each part of the
//! report is a file under `parts/`, which implements the trait `ReportPart`.

mod avoidance;
mod cache;
mod case;
mod claim_draft;
mod claims;
mod commands;
mod config;
mod controller_arg;
mod document;
mod followers;
mod gate;
mod gate_rules;
mod gather_context;
mod identity;
mod junit;
mod page;
mod parts;
mod plan;
mod planned_suite;
mod portable_config;
mod prose;
mod report;
mod report_block;
mod report_folder;
mod report_part;
mod rich_text;
mod rounded;
mod run_ends;
mod run_info;
mod table;
#[cfg(feature = "schema")]
mod tagged_schema;

pub use cache::{CacheError, EvidenceCache, EvidenceHash};
pub use case::{
    CaseResult, CaseVerdict, PileUp, RoundedCollision, RoundedLeadMeasures, STILL_CLOSING_TTC_S,
};
pub use claims::{
    AssuranceClaim, ClaimStatus, ContentId, Domain, Evidence, EvidenceSource, InferenceRule,
    Ledger, MIN_CONFIDENCE_PERCENT, Property, RandomScenario, SecondaryEvidence, Strength,
    StrengthLevel, Subject, UncomparedText,
};
pub use commands::{CommandFile, CrumpleCommand};
pub use config::{
    AssessConfig, AssessConfigError, BrakeAfterCollision, CONFIG_VERSION, HarmConfig, RatesConfig,
    SearchConfig, default_configuration,
};
pub use gate::GateConfig;
pub use gate_rules::{AssessmentGate, GateResult, IndicatorInterval, SafetyIndicator};
pub use identity::ReportIdentity;
pub use parts::*;
pub use plan::AssessmentPlan;
pub use planned_suite::SuiteConfig;
pub use report::{AssessmentReport, EVIDENCE_VERSION, REPORT_FOLDERS, REPORT_KIND};
pub use report_folder::{EVIDENCE_FOLDER, LISTING_FILE, ReportFolder, ReportFolderError};
pub use report_part::ReportSection;
pub use rounded::Rounded;
pub use run_ends::RunEnds;

use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_evidence::drives::DriveError;
use crumple_evidence::{InvalidRate, RateError};
use crumple_measure::GainError;
use crumple_search::falsify::campaign::CampaignError;
use crumple_sim::engine::{RefusedController, RunError};
use crumple_sim::scenario::InvalidField;
use crumple_suites::SuiteRunError;
use gather_context::GatherContext;

impl From<GainError> for AssessError {
    fn from(error: GainError) -> Self {
        match error {
            GainError::Scenario(invalid) => Self::Draw(invalid),
            GainError::Run(error) => Self::Run(error),
        }
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
    /// A controller contradicted itself, or can no longer be started.
    #[error(transparent)]
    Refused(#[from] RefusedController),
    /// A recorded drive cannot be simulated.
    #[error(transparent)]
    Drive(#[from] DriveError),
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
    let results = GatheredResults::gather(&work)?;
    work.ensure_all_trusted()?;
    let configuration = plan.configuration_file(&results.proofs)?;
    let identity = ReportIdentity::new(plan, &configuration);
    let provenance = AssessmentProvenance::new(plan, cache, &plan.compared_config(&results.proofs));
    let mut files = plan.command_files()?;
    files.push(configuration);
    files.extend(plan.earlier_file(against.map(EarlierAssessment::text)));
    Ok(AssessmentReport::derive(
        plan,
        results,
        provenance,
        (identity, files),
        against,
    ))
}
