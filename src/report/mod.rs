//! The assessment: which controller is safer, how we know, and where it still fails.
//!
//! [`assess`] gathers evidence into one typed value, an [`Assessment`]; Markdown, HTML and JSON are all rendered from it.
//! It is made of parts, each with its own evidence type and its own rendering (see [`Part`]); adding one means a file
//! under `parts/`, a field of [`Assessment`] and a line in [`Assessment::parts`].

mod best;
mod case;
mod config;
mod interval;
mod page;
mod parts;
mod rounded;
mod table;

use maud::Markup;
use serde::Serialize;
use sha2::{Digest, Sha256};

pub use best::Best;
pub use case::{Case, PileUp, RoundedContact, STILL_CLOSING_TTC_S, Towards, Verdict};
pub use config::{AssessConfig, CONFIG_VERSION, ConfigError, Plan};
pub use interval::RateInterval;
pub use parts::{
    BRAKING_MPS2, Braking, Claim, Distribution, EXAMPLE_MPS, FailureMap, FailureMaps, Held, KernelProof, KernelStatus,
    Learned, LearnedPolicy, Limits, MapAxis, MapCell, MapRow, Mildest, Paired, PaperScenarios, Percent, Proofs,
    Provenance, Sampled, ScenarioCases, Strength, Summary, Traffic, UnknownCell, WorstProfile, WorstProfiles,
};
pub use rounded::Rounded;

use crate::scenario::InvalidField;
use crate::sim::RunError;
use crate::worst_case::AttackError;

/// The version of the JSON evidence this release writes.
pub const EVIDENCE_VERSION: u32 = 1;

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
    /// The mildest lead braking against each controller.
    pub worst_profiles: Option<WorstProfiles>,
    /// What each controller survives over two parameters, and what nobody does.
    pub failure_maps: Option<FailureMaps>,
    /// What is proved.
    pub proofs: Proofs,
    /// How the learned policies drive; none if there are none among the controllers.
    pub learned: Option<Learned>,
    /// What this does not show.
    pub limits: Limits,
    /// Where the evidence comes from.
    pub provenance: Provenance,
}

/// One part of an assessment.
pub trait Part {
    /// Anchor of the part in the page.
    fn id(&self) -> &'static str;
    /// Heading.
    fn title(&self) -> String;
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
}

/// Gathers the evidence a plan asks for.
///
/// `done` is told after each stage how many of the plan's runs are done.
///
/// # Errors
/// [`AssessError`] if a scenario cannot be run or drawn.
pub fn assess(plan: &Plan, done: &dyn Fn(u64)) -> Result<Assessment, AssessError> {
    let paper_scenarios = PaperScenarios::gather(plan)?;
    done(plan.paper_runs());
    let distribution = Distribution::gather(plan, &|draws| done(plan.paper_runs() + draws))?;
    done(plan.paper_runs() + plan.distribution_runs());
    let traffic = Traffic::gather(plan)?;
    let worst_profiles = WorstProfiles::gather(plan)?;
    let failure_maps = FailureMaps::gather(plan)?;
    done(plan.runs());
    let proofs = Proofs::gather();
    Ok(Assessment {
        version: EVIDENCE_VERSION,
        summary: Summary::of(plan, &paper_scenarios, &distribution, traffic.as_ref(), worst_profiles.as_ref(), &proofs),
        learned: Learned::of(plan, &paper_scenarios),
        limits: Limits::of(plan),
        provenance: Provenance::of(plan),
        paper_scenarios,
        distribution,
        traffic,
        worst_profiles,
        failure_maps,
        proofs,
    })
}

impl Plan {
    fn paper_runs(&self) -> u64 {
        2 * (crate::scenario::built_in_names().len() * self.controllers.len()) as u64
    }

    fn distribution_runs(&self) -> u64 {
        self.config.draws * self.controllers.len() as u64
    }

    /// How many runs the plan asks for, besides those of searches.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.paper_runs() + self.distribution_runs() + 2 * (self.traffic.len() * self.controllers.len()) as u64
    }
}

impl Assessment {
    /// The parts in the order of the report.
    #[must_use]
    pub fn parts(&self) -> Vec<&dyn Part> {
        let mut parts: Vec<&dyn Part> = vec![&self.summary, &self.paper_scenarios, &self.distribution];
        parts.extend(self.traffic.as_ref().map(|traffic| traffic as &dyn Part));
        parts.extend(self.worst_profiles.as_ref().map(|worst| worst as &dyn Part));
        parts.extend(self.failure_maps.as_ref().map(|maps| maps as &dyn Part));
        parts.push(&self.proofs);
        parts.extend(self.learned.as_ref().map(|learned| learned as &dyn Part));
        parts.extend([&self.limits as &dyn Part, &self.provenance]);
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
}

/// SHA-256 of a text, in hexadecimal.
fn sha256(text: &str) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}
