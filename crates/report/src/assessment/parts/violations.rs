//! The first random scenario that violates each refuted claim about the subject, and the claim of each failed gate.

use serde::Serialize;

use super::summary::ClaimRow;
use super::{GatheredResults, PAPER_ANCHOR};
use crate::assessment::claims::{
    AssuranceClaim, ClaimStatus, ContentId, Domain, Evidence, Ledger, Property, RandomScenario,
    Strength, StrengthLevel,
};
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::plan::file_stem;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, CrumpleCommand, GateResult};
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::{Scenario, file};

/// Folder of the report with the scenarios that violate claims.
const FOLDER: &str = "violations";

/// Scenarios that violate claims.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct ViolatingScenarios {
    /// One entry per claim.
    pub scenarios: Vec<ViolatingScenario>,
}

/// A scenario that violates a claim about a controller.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ViolatingScenario {
    /// Name of the controller.
    pub controller: String,
    /// Claim in words.
    pub claim: String,
    /// Path of the scenario file, relative to the report folder.
    pub file: String,
    /// Command that simulates the scenario; absent for a controller that is no file of the report folder.
    pub replay: Option<CrumpleCommand>,
    #[serde(skip)]
    violated: AssuranceClaim,
    #[serde(skip)]
    text: String,
}

/// A claim of a report about one controller.
struct ReportedClaim<'a> {
    row: &'a ClaimRow,
    claim: &'a AssuranceClaim,
    status: &'a ClaimStatus,
    controller: &'a NamedController,
}

/// A scenario and the path of its file.
struct ScenarioFile {
    path: String,
    scenario: Scenario,
}

impl ViolatingScenarios {
    /// Finds the scenarios of refuted claims about the subject, and of the claims of failed gates.
    pub(in crate::assessment) fn new(
        plan: &AssessmentPlan,
        results: &GatheredResults,
        evidence: &Ledger,
        claims: &[ClaimRow],
        gates: &[GateResult],
    ) -> Self {
        let mut scenarios = Vec::new();
        for row in claims {
            let of_controllers = plan.controllers.iter().zip(&row.claims).zip(&row.statuses);
            for (index, ((controller, claim), status)) in of_controllers.enumerate() {
                let Some(claim) = claim else { continue };
                let is_refuted = index == plan.subject_index
                    && status.strength.level() == StrengthLevel::Refuted;
                if is_refuted || gates.iter().any(|gate| gate.is_failed_about(claim)) {
                    let reported = ReportedClaim {
                        row,
                        claim,
                        status,
                        controller,
                    };
                    scenarios.extend(reported.violation(plan, results, evidence));
                }
            }
        }
        Self { scenarios }
    }

    /// Returns the file of the scenario that violates a claim, if there is one.
    pub(in crate::assessment) fn find(&self, claim: &AssuranceClaim) -> Option<&str> {
        let mut scenarios = self.scenarios.iter();
        let violating = scenarios.find(|scenario| scenario.violated == *claim)?;
        Some(&violating.file)
    }

    pub(in crate::assessment) fn is_empty(&self) -> bool {
        self.scenarios.is_empty()
    }

    /// Returns the commands that simulate the scenarios.
    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let scenarios = self.scenarios.iter();
        scenarios.filter_map(|scenario| scenario.replay.as_ref())
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.scenarios,
            &[
                ("controller", &|scenario| {
                    ReportCell::text(&scenario.controller)
                }),
                ("violated claim", &|scenario| {
                    ReportCell::text(&scenario.claim)
                }),
                ("scenario, or its simulation", &|scenario| {
                    let replay = scenario.replay.as_ref();
                    replay.map_or_else(|| ReportCell::code(&scenario.file), ReportCell::code)
                }),
            ],
        )
    }
}

impl ReportedClaim<'_> {
    fn violation(
        &self,
        plan: &AssessmentPlan,
        results: &GatheredResults,
        evidence: &Ledger,
    ) -> Option<ViolatingScenario> {
        let ScenarioFile { path, scenario } = match &self.claim.domain {
            Domain::Scenarios { all, .. } if self.row.part == PAPER_ANCHOR => {
                self.paper_scenario(all, results)
            }
            _ => self.random_scenario(plan, evidence),
        }?;
        Some(ViolatingScenario {
            controller: self.controller.name.clone(),
            claim: self.row.claim.clone(),
            replay: self.replay_command(plan, &path),
            text: file::to_toml(&scenario).ok()?,
            file: path,
            violated: self.claim.clone(),
        })
    }

    fn paper_scenario(
        &self,
        domain: &[ContentId],
        results: &GatheredResults,
    ) -> Option<ScenarioFile> {
        let mut scenarios = results.paper_scenarios.as_ref()?.scenarios.iter();
        let failing = scenarios.find(|scenario| {
            scenario.fails(&self.controller.name) && domain.contains(&scenario.content_id())
        })?;
        Some(ScenarioFile {
            path: format!("{FOLDER}/{}.toml", file_stem(&failing.scenario)),
            scenario: failing.full_scenario.clone(),
        })
    }

    /// Draws the scenario again that the evidence names.
    fn random_scenario(&self, plan: &AssessmentPlan, evidence: &Ledger) -> Option<ScenarioFile> {
        let deciding = self.status.evidence.first();
        let deciding = deciding.and_then(|&index| evidence.evidence().get(index));
        let own = evidence.evidence().iter();
        let own = own.filter(|piece| piece.claim == *self.claim);
        let mut pieces = deciding.into_iter().chain(own);
        let (space, drawn) = pieces.find_map(drawn_violation)?;
        let scenario_space = plan.find_space(space)?;
        Some(ScenarioFile {
            path: format!(
                "{FOLDER}/{}-{}-{}.toml",
                file_stem(&space.name),
                drawn.seed,
                drawn.index
            ),
            scenario: scenario_space.draw(drawn.seed, drawn.index).ok()?,
        })
    }

    fn replay_command(&self, plan: &AssessmentPlan, file: &str) -> Option<CrumpleCommand> {
        let controller = controller_arg(&*self.controller.source)?;
        let simulate = CrumpleCommand::new(["simulate", file, "--controller", controller.as_str()])
            .with_args(plan.estimator_args().iter().copied());
        // A controller that can fail may have given no answer instead, unless all its failures are collisions.
        let collides = !self.controller.source.can_fail()
            || matches!(self.status.strength, Strength::Refuted { .. });
        let expected = if collides { "collision" } else { "failure" };
        Some(match self.is_about_collisions() {
            true => simulate.with_args(["--expect", expected]),
            false => simulate,
        })
    }

    fn is_about_collisions(&self) -> bool {
        matches!(
            self.claim.property,
            Property::NoCollision
                | Property::RateAtMost { .. }
                | Property::FailsLessOften { .. }
                | Property::OthersKeepClear
        )
    }
}

/// Returns the space and the first random scenario that violates the claim of a piece of evidence.
fn drawn_violation(evidence: &Evidence) -> Option<(&ContentId, RandomScenario)> {
    match &evidence.claim.domain {
        Domain::Draws { space, .. } | Domain::Space { space } => {
            Some((space, evidence.first_violation?))
        }
        _ => None,
    }
}

impl ReportPart for ViolatingScenarios {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::RandomScenarios,
            anchor: "violations",
            title: "Scenarios that violate claims",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(
            "The first scenario that violates each refuted claim about the assessed controller, and the claim of each \
             failed gate. A failure that a search found is in the section of the search, and a failed test of a suite \
             in that of the suite.",
        );
        out.table(self.table());
    }

    fn is_shown(&self) -> bool {
        !self.is_empty()
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        let mut files: Vec<(String, Vec<u8>)> = Vec::new();
        for scenario in &self.scenarios {
            if files.iter().all(|(path, _)| *path != scenario.file) {
                files.push((scenario.file.clone(), scenario.text.clone().into_bytes()));
            }
        }
        files
    }
}
