//! The assessment: which controller is safer, how we know, and where it still fails.
//!
//! [`assess`] gathers evidence into one typed value, an [`Assessment`]; Markdown, HTML and JSON are all rendered from it.
//! It is made of parts, each with its own evidence type and its own rendering (see [`Part`]); adding one means a file
//! under `parts/`, a field of [`Assessment`] and a line in [`Assessment::parts`].

mod best;
mod case;
mod config;
mod gate;
mod junit;
mod page;
mod parts;
mod plan;
mod prose;
mod rounded;
mod store;
mod table;
mod work;

use maud::Markup;
use serde::Serialize;

pub use best::Best;
pub use case::{Case, CaseVerdict, PileUp, RoundedContact, STILL_CLOSING_TTC_S, Towards};
pub use config::{AssessConfig, CONFIG_VERSION, ConfigError, RatesConfig, SearchConfig};
pub use gate::{Gate, GateResult};
pub use parts::{
    Argument, BRAKING_MPS2, Braking, Change, Claim, Comparison, ComparisonError, Distribution, EXAMPLE_MPS, Earlier,
    Element, ElementKind, Failure, FailureMap, FailureMaps, Held, KernelGap, Learned, LearnedPolicy, Limits,
    LineVerdict, MapAxis, MapCell, MapRow, MethodReached, Mildest, Paired, PaperScenarios, Percent, Proof, ProofStatus,
    Proofs, Provenance, Sampled, ScenarioCases, Search, Searches, SpaceSearches, Strength, Summary, Traffic,
    UnknownCell, Useful, Usefulness, WorstProfile, WorstProfiles,
};
pub use plan::AssessmentPlan;
pub use rounded::Rounded;
pub use store::{EvidenceHash, Store, StoreError};

use crumple_search::evidence::{InvalidRate, RateError};
use crumple_search::falsify::campaign::CampaignError;
use crumple_search::worst_case::AttackError;
use crumple_world::scenario::InvalidField;
use crumple_world::sim::RunError;
use work::Work;

/// The version of the JSON evidence this release writes.
pub const EVIDENCE_VERSION: u32 = 2;

/// Everything an assessment found out.
#[derive(Debug, Clone, Serialize)]
pub struct Assessment {
    /// Version of the evidence format.
    pub version: u32,
    /// The verdict: claims, and how strongly each is supported.
    pub summary: Summary,
    /// The paper's three scenarios.
    pub paper_scenarios: PaperScenarios,
    /// The paper's distribution.
    pub distribution: Distribution,
    /// Scenarios from files; none if the configuration names none.
    pub traffic: Option<Traffic>,
    /// What a search for failures found.
    pub searches: Searches,
    /// The mildest lead braking against each controller.
    pub worst_profiles: Option<WorstProfiles>,
    /// What each controller survives over two parameters, and what no driver does.
    pub failure_maps: Option<FailureMaps>,
    /// What is proved.
    pub proofs: Proofs,
    /// How the learned policies drive; none if there are none among the controllers.
    pub learned: Option<Learned>,
    /// What this does not show.
    pub limits: Limits,
    /// The verdict as a goal structure.
    pub argument: Argument,
    /// What changed since an earlier assessment; none if there is none to compare with.
    pub comparison: Option<Comparison>,
    /// Where the evidence comes from.
    pub provenance: Provenance,
}

/// One part of an assessment.
pub trait Part {
    /// Anchor of the part in the page, and its heading.
    fn heading(&self) -> (&'static str, String);
    /// The part as HTML, without its heading.
    fn html(&self) -> Markup;
    /// The part as Markdown, without its heading.
    fn markdown(&self) -> String;
}

/// Why an assessment could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AssessError {
    /// A scenario cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A draw of the paper's distribution is not a valid scenario.
    #[error("a draw of the paper's distribution is invalid: {0}")]
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
    Store(#[from] StoreError),
}

/// Gathers the evidence a plan asks for; what `store` has kept of it is not gathered again. Nothing is kept where a
/// controller states no identity.
///
/// `told` hears how many of the plan's runs are done.
///
/// # Errors
/// [`AssessError`] if a scenario cannot be run or drawn, or evidence not kept.
///
/// ```
/// use crumple_report::assessment::{AssessConfig, AssessmentPlan, Store, assess};
/// use std::path::Path;
///
/// let mut config = AssessConfig::default();
/// config.controllers = vec!["baseline".to_owned(), "idm".to_owned()];
/// config.gates.clear();
/// (config.draws, config.search.spaces, config.rates.runs) = (20, Vec::new(), 0);
/// let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
/// let assessment = assess(&plan, &Store::none(), None, &|_| {}).unwrap();
/// assert!(assessment.html().contains("</html>"));
/// ```
pub fn assess(
    plan: &AssessmentPlan,
    store: &Store,
    against: Option<&Earlier>,
    told: &(dyn Fn(u64) + Sync),
) -> Result<Assessment, AssessError> {
    let nothing_kept = Store::none();
    let store = if plan.has_identities() { store } else { &nothing_kept };
    let work = Work::new(store, told);
    let paper_scenarios = PaperScenarios::gather(plan, &work)?;
    let distribution = Distribution::gather(plan, &work)?;
    let traffic = Traffic::gather(plan, &work)?;
    let searches = Searches::gather(plan, &work)?;
    let worst_profiles = WorstProfiles::gather(plan, &work)?;
    let failure_maps = FailureMaps::gather(plan, &work)?;
    let proofs = Proofs::gather(plan, &work)?;
    let limits = Limits::of(plan);
    let (with_traffic, with_worst) = (traffic.as_ref(), worst_profiles.as_ref());
    let summary = Summary::of(plan, &paper_scenarios, &distribution, with_traffic, with_worst, &searches, &proofs);
    let argument = Argument::of(plan, &summary, &distribution, &searches, &proofs, &limits);
    let mut assessment = Assessment {
        version: EVIDENCE_VERSION,
        learned: Learned::of(plan, &paper_scenarios),
        provenance: Provenance::of(plan, store),
        comparison: None,
        summary,
        paper_scenarios,
        distribution,
        traffic,
        searches,
        worst_profiles,
        failure_maps,
        proofs,
        limits,
        argument,
    };
    assessment.comparison = against.and_then(|earlier| Comparison::of(earlier, &assessment));
    // Gates come last: they judge everything else.
    assessment.summary.gates = plan.config.gates.iter().map(|gate| gate.judge(&assessment)).collect();
    Ok(assessment)
}

impl AssessmentPlan {
    /// How many runs the plan asks for, roughly: searches may end early.
    #[must_use]
    pub fn runs(&self) -> u64 {
        let controllers = self.controllers.len() as u64;
        let scenarios = (crumple_world::scenario::built_in_names().len() + self.traffic.len()) as u64;
        // A search has a method and two reference searches.
        let searches = 3 * self.spaces.len() as u64 * self.config.search.budget;
        let each = scenarios + self.config.draws + searches + parts::BUDGET as u64;
        let learned = self.controllers.iter().filter(|controller| controller.policy().is_some()).count() as u64;
        controllers.saturating_mul(each) + (learned + 1).saturating_mul(self.config.rates.runs)
    }
}

impl Assessment {
    /// The parts in the order of the report.
    #[must_use]
    pub fn parts(&self) -> Vec<&dyn Part> {
        let mut parts: Vec<&dyn Part> = vec![&self.summary];
        parts.extend(self.comparison.as_ref().map(|comparison| comparison as &dyn Part));
        parts.push(&self.paper_scenarios);
        parts.extend(self.traffic.as_ref().map(|traffic| traffic as &dyn Part));
        parts.push(&self.searches);
        parts.extend(self.worst_profiles.as_ref().map(|worst| worst as &dyn Part));
        parts.extend(self.failure_maps.as_ref().map(|maps| maps as &dyn Part));
        parts.extend([&self.distribution as &dyn Part, &self.proofs]);
        parts.extend(self.learned.as_ref().map(|learned| learned as &dyn Part));
        parts.extend([&self.limits as &dyn Part, &self.argument, &self.provenance]);
        parts
    }

    /// The report as one self-contained HTML page.
    #[must_use]
    pub fn html(&self) -> String {
        page::html(self)
    }

    /// The report as Markdown, without figures.
    #[must_use]
    pub fn markdown(&self) -> String {
        page::markdown(self)
    }

    /// The evidence as JSON.
    ///
    /// # Errors
    /// None in practice; the serializer's error is passed on rather than hidden.
    pub fn json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self).map(|json| json + "\n")
    }

    /// Every file of the report, by its path from the folder of the report.
    ///
    /// # Errors
    /// [`RenderError`] in principle, if a writer fails.
    pub fn files(&self) -> Result<Vec<(String, String)>, RenderError> {
        let mut files = vec![
            ("assessment.html".to_owned(), self.html()),
            ("assessment.md".to_owned(), self.markdown()),
            ("assessment.json".to_owned(), self.json()?),
            ("assessment.junit.xml".to_owned(), junit::xml(self)?),
            ("assessment.gsn.yaml".to_owned(), self.argument.yaml()),
        ];
        files.extend(self.paper_scenarios.plates().map(|(name, svg)| (name, svg.document())));
        files.extend(self.searches.failures().map(|failure| (failure.file.clone(), failure.text.clone())));
        files.extend(self.proofs.certificates.iter().map(|proof| (proof.file.clone(), proof.text.clone())));
        Ok(files)
    }
}

/// The files that stood beside the evidence of an earlier report, by their paths from its folder: counterexamples and
/// certificates. None of what is no such evidence, and no path that leads out of the folder.
#[must_use]
pub fn files_of_evidence(json: &str) -> Vec<String> {
    let evidence: serde_json::Value = serde_json::from_str(json).unwrap_or_default();
    let list = |value: &serde_json::Value| value.as_array().cloned().unwrap_or_default();
    let searches = list(&evidence["searches"]["spaces"]).into_iter().flat_map(|space| list(&space["controllers"]));
    let failures = searches.flat_map(|search| list(&search["failures"]));
    let files = failures.chain(list(&evidence["proofs"]["certificates"]));
    let names = files.filter_map(|file| file["file"].as_str().map(str::to_owned));
    let is_own = |name: &String| {
        (name.starts_with("counterexamples/") || name.starts_with("certificates/")) && !name.contains("..")
    };
    names.filter(is_own).collect()
}

/// Why a report cannot be written down.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The JSON cannot be written.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The JUnit XML cannot be written.
    #[error(transparent)]
    Junit(#[from] quick_junit::SerializeError),
}
