//! Kinds of follower: every controller in emergencies and in everyday driving, by the kind of the vehicle behind.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::everyday_drives::EverydayDrive;
use super::first_scenarios::FirstScenarios;
use super::sampling::{batches, draw_scenarios};
use super::share::{CONFIDENCE, PercentInterval};
use super::usefulness::{drive_each, space_id};
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, RandomScenario,
    Strength, Subject,
};
use crate::assessment::config::{EVERYDAY_SPACE, FOLLOWER_SPACES};
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::{describe_followers, follower_kind, follower_kinds};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::run_ends::{RunEnds, note_unanswered};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan};
use crumple_measure::{EASY_BRAKE_MPS2, FAR_BEHIND_M, FAR_BEHIND_S, HARD_BRAKE_MPS2};
use crumple_sim::engine::RunOptions;
use crumple_spaces::{ScenarioSpace, built_in_space};

const ANCHOR: &str = "followers";

/// Every controller in emergencies and in everyday driving, with followers of several kinds.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FollowerReport {
    /// Emergencies (`followers`), and everyday driving (`everyday`).
    pub spaces: Vec<FollowerSpace>,
}

/// Every controller on the same random scenarios of a space.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FollowerSpace {
    /// Scenario space.
    pub space: ContentId,
    /// Number of random scenarios for each controller.
    pub random_scenarios: u64,
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Confidence level of the bounds.
    pub confidence: f64,
    /// Kinds of follower, in the order of the space.
    pub kinds: Vec<String>,
    /// One entry per controller.
    pub controllers: Vec<ControllerFollowers>,
}

/// The results of one controller.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerFollowers {
    /// Name of the controller.
    pub controller: String,
    /// Results with any follower.
    pub all: KindCounts,
    /// Results with each kind of follower.
    pub by_kind: BTreeMap<String, KindCounts>,
    /// First scenarios that violate a claim.
    #[serde(default, skip_serializing_if = "FirstScenarios::is_empty")]
    pub first: FirstScenarios,
}

/// Counts of random scenarios of one controller.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct KindCounts {
    /// Number of random scenarios.
    pub random_scenarios: u64,
    /// Ends of the runs.
    #[serde(flatten)]
    pub ends: RunEnds,
    /// Scenarios with unnecessary braking.
    pub unnecessary_braking: u64,
    /// Scenarios with hard braking where little braking was required.
    pub hard_braking: u64,
    /// Scenarios at whose end the vehicle had fallen behind.
    pub left_behind: u64,
}

impl KindCounts {
    fn add(&mut self, drive: &EverydayDrive) {
        self.random_scenarios += 1;
        self.ends.add(drive.verdict());
        if let Some(measures) = drive.answered_measures() {
            self.unnecessary_braking += u64::from(!measures.unnecessary.is_empty());
            self.hard_braking += u64::from(!measures.hard.is_empty());
            let following = measures.following;
            let fell_behind = following.is_some_and(|following| following.fell_behind);
            self.left_behind += u64::from(fell_behind);
        }
    }

    /// Returns the share of failures, with exact bounds.
    #[must_use]
    pub fn failure_percent(&self) -> PercentInterval {
        let counts = [self.ends.failures(), self.ends.ended_by_others];
        PercentInterval::clopper_pearson(counts, self.random_scenarios)
    }

    /// Returns the strength of a claim that `count` scenarios violate. A drive without an answer is no evidence.
    fn strength(&self, count: u64) -> Strength {
        let unanswered = self.ends.unanswered.as_ref();
        Strength::from_counts_with_unanswered(count, self.random_scenarios, unanswered, false)
    }
}

/// Returns the built-in spaces, and the number of random scenarios of each: `everyday_draws` for each kind of follower.
fn planned_spaces(plan: &AssessmentPlan) -> impl Iterator<Item = (ScenarioSpace, u64)> {
    let draws = plan.config.everyday_draws;
    FOLLOWER_SPACES
        .into_iter()
        .filter_map(built_in_space)
        .map(move |space| {
            let kinds = follower_kinds(&space).len() as u64;
            (space, draws.saturating_mul(kinds))
        })
}

impl FollowerSpace {
    fn run(
        space: &ScenarioSpace,
        count: u64,
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let config = &work.plan.config;
        let mut controllers: Vec<_> = work
            .plan
            .controllers
            .iter()
            .map(|controller| ControllerFollowers {
                controller: controller.name.clone(),
                all: KindCounts::default(),
                by_kind: BTreeMap::new(),
                first: FirstScenarios::default(),
            })
            .collect();
        for indices in batches(count) {
            let scenarios = draw_scenarios(space, config.seed, indices.clone())?;
            let kinds: Vec<_> = indices
                .map(|index| follower_kind(space, config.seed, index))
                .collect();
            for (controller, results) in work.plan.controllers.iter().zip(&mut controllers) {
                let options =
                    RunOptions::new(controller.source.clone()).with_estimator(config.estimator);
                let drives = drive_each(&scenarios, &options, work)?;
                for (drive, kind) in drives.iter().zip(&kinds) {
                    results.add(drive, kind);
                }
            }
        }
        Ok(Self {
            space: space_id(space)?,
            random_scenarios: count,
            seed: config.seed,
            confidence: CONFIDENCE,
            kinds: follower_kinds(space),
            controllers,
        })
    }

    pub(in crate::assessment) fn domain(&self) -> Domain {
        Domain::Draws {
            space: self.space.clone(),
            seed: self.seed,
            draws: self.random_scenarios,
        }
    }

    fn is_everyday(&self) -> bool {
        self.space.name == EVERYDAY_SPACE
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&ControllerFollowers> {
        self.controllers
            .iter()
            .find(|results| results.controller == controller)
    }

    /// Returns the properties that the report claims of the space, each with the strength of its evidence.
    fn strengths(&self, results: &KindCounts) -> Vec<(Property, Strength)> {
        let collisions = results.ends.strength(self.random_scenarios);
        let mut strengths = vec![(Property::NoCollision, collisions)];
        if self.is_everyday() {
            let braking = results.strength(results.unnecessary_braking);
            let keeps_up = results.strength(results.left_behind);
            strengths.push((Property::NoUnnecessaryBraking, braking));
            strengths.push((Property::KeepsUp, keeps_up));
        }
        strengths
    }

    fn evidence_about(&self, subject: &Subject, results: &ControllerFollowers) -> Vec<Evidence> {
        let description = format!(
            "{} random scenarios, seed {}",
            self.random_scenarios, self.seed
        );
        let strengths = self.strengths(&results.all).into_iter();
        strengths
            .map(|(property, strength)| Evidence {
                first_violation: RandomScenario::new(self.seed, results.first.violating(&property)),
                claim: AssuranceClaim {
                    subject: subject.clone(),
                    property,
                    domain: self.domain(),
                },
                strength,
                source: EvidenceSource::from_part(ANCHOR, description.clone()),
            })
            .collect()
    }

    /// Returns the number of scenarios with a kind of follower, the same for each controller.
    fn scenarios_with(&self, kind: &str) -> Option<u64> {
        let counts = self.controllers.first()?.by_kind.get(kind)?;
        Some(counts.random_scenarios)
    }

    /// Returns a table with a row for each controller and a column for each kind of follower, with its number of
    /// scenarios.
    fn kind_table(&self, heading: &str, cell: impl Fn(&KindCounts) -> ReportCell) -> ReportTable {
        let names: Vec<_> = self
            .kinds
            .iter()
            .map(|kind| match self.scenarios_with(kind) {
                Some(count) => format!("{kind} behind ({count})"),
                None => format!("{kind} behind"),
            })
            .collect();
        let header = std::iter::once(heading).chain(names.iter().map(String::as_str));
        let mut table = ReportTable::new(&header.collect::<Vec<_>>());
        for results in &self.controllers {
            let cells = self.kinds.iter().map(|kind| {
                let counts = results.by_kind.get(kind);
                counts.map_or_else(|| ReportCell::number("–"), &cell)
            });
            let name = ReportCell::text(&results.controller);
            table.push_row(std::iter::once(name).chain(cells).collect());
        }
        table
    }

    /// Returns the main results by kind of follower, for the first page.
    fn first_page_table(&self) -> ReportTable {
        let space = &self.space.name;
        if self.is_everyday() {
            let heading = format!("failures; hard unnecessary braking; falls behind, in {space}");
            self.kind_table(&heading, |counts| {
                ReportCell::number(format!(
                    "{}; {}; {}",
                    counts.ends.failures(),
                    counts.hard_braking,
                    counts.left_behind
                ))
            })
        } else {
            let heading = format!("failures; hard unnecessary braking, in {space}");
            self.kind_table(&heading, |counts| {
                ReportCell::number(format!(
                    "{}; {}",
                    counts.ends.failures(),
                    counts.hard_braking
                ))
            })
        }
    }

    fn bounds_table(&self) -> ReportTable {
        let heading = format!("failures in {} (%)", self.space.name);
        self.kind_table(&heading, |counts| {
            let percent = counts.failure_percent();
            ReportCell::number(format!(
                "{} ({})",
                percent.observed,
                percent.format_bounds()
            ))
        })
    }

    /// Returns the counts of all random scenarios.
    fn total_table(&self) -> ReportTable {
        let name = format!("{}, any follower", self.space.name);
        let mut table = ReportTable::new(&[
            &name,
            "hits leader",
            "hit from behind",
            "no answer",
            "unnecessary braking",
            "hard unnecessary braking",
            "falls behind",
        ]);
        for results in &self.controllers {
            let KindCounts { ends, .. } = &results.all;
            let counts = [
                ends.hit,
                ends.was_hit,
                ends.unanswered_runs(),
                results.all.unnecessary_braking,
                results.all.hard_braking,
                results.all.left_behind,
            ];
            let cells = counts.map(ReportCell::number);
            let name = ReportCell::text(&results.controller);
            table.push_row(std::iter::once(name).chain(cells).collect());
        }
        table
    }

    fn unanswered_notes(&self) -> impl Iterator<Item = String> {
        self.controllers.iter().filter_map(|results| {
            let unanswered = results.all.ends.unanswered.as_ref()?;
            let controller = format!("{} in `{}`", results.controller, self.space.name);
            Some(note_unanswered(
                &controller,
                unanswered,
                self.random_scenarios,
            ))
        })
    }
}

impl ControllerFollowers {
    fn add(&mut self, drive: &EverydayDrive, kind: &str) {
        self.first.add_drive(self.all.random_scenarios, drive);
        self.all.add(drive);
        self.by_kind.entry(kind.to_owned()).or_default().add(drive);
    }
}

impl FollowerReport {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if plan.config.everyday_draws == 0 {
            return Ok(None);
        }
        let spaces: Vec<_> = planned_spaces(plan).collect();
        let ids = spaces.iter().map(|(space, _)| space_id(space));
        let inputs = json!([
            ids.collect::<Result<Vec<_>, _>>()?,
            plan.config.everyday_draws,
            plan.config.seed,
            plan.config.estimator.name(),
            plan.identities()
        ]);
        work.get_or_gather("followers", &inputs, || {
            let spaces = spaces
                .iter()
                .map(|(space, count)| FollowerSpace::run(space, *count, work))
                .collect::<Result<_, _>>()?;
            Ok(Some(Self { spaces }))
        })
    }

    pub(in crate::assessment) fn find_space(&self, name: &str) -> Option<&FollowerSpace> {
        self.spaces.iter().find(|space| space.space.name == name)
    }

    fn introduction(&self) -> String {
        let spaces: Vec<_> = self.spaces.iter().map(FollowerSpace::describe).collect();
        format!(
            "Every controller drives {}. The follower decides whether a collision from behind happens, so the tables \
             name it. `late` is `baseline` that brakes 0.5 s later, and `weak` is `baseline` with 0.7 times its \
             deceleration. Failures are collisions and missing answers. Bounds are exact (Clopper–Pearson, {} %) for \
             each number by itself. Braking is hard and \
             unnecessary above {HARD_BRAKE_MPS2} m/s² where less than {EASY_BRAKE_MPS2} m/s² was required.",
            spaces.join(", and "),
            100.0 * CONFIDENCE
        )
    }

    /// Writes the main results of the first page.
    pub(super) fn write_first_page(&self, out: &mut ReportDocument) {
        for space in &self.spaces {
            out.table(space.first_page_table());
        }
        let spaces: Vec<_> = self.spaces.iter().map(FollowerSpace::describe).collect();
        out.paragraph(format!(
            "Numbers of scenarios by kind of follower, in {}. In brackets: all scenarios with this kind. {}",
            spaces.join(", and "),
            falls_behind_note()
        ));
    }
}

/// States the limit from which a controller falls behind.
pub(super) fn falls_behind_note() -> String {
    format!(
        "Falls behind: at the end of a drive, the vehicle is slower than half its leader's speed, or its gap is longer \
         than at the start and than {FAR_BEHIND_M} m plus {FAR_BEHIND_S} s times the leader's speed. A controller that \
         falls behind is not useful."
    )
}

impl FollowerSpace {
    fn describe(&self) -> String {
        format!(
            "{} random scenarios of `{}` (seed {}; {})",
            self.random_scenarios,
            self.space.name,
            self.seed,
            describe_followers(&self.kinds)
        )
    }
}

impl ReportPart for FollowerReport {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::EverydayTraffic,
            anchor: ANCHOR,
            title: "Kinds of follower",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        let runs = planned_spaces(plan).map(|(_, count)| plan.runs_of_all(count));
        runs.fold(0, u64::saturating_add)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(self.introduction());
        out.paragraph(falls_behind_note());
        for space in &self.spaces {
            out.table(space.bounds_table());
            out.table(space.total_table());
            for note in space.unanswered_notes() {
                out.paragraph(note);
            }
        }
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let subjects = plan.claim_subjects();
        let mut evidence = Vec::new();
        for space in &self.spaces {
            for (subject, results) in subjects.iter().zip(&space.controllers) {
                evidence.extend(space.evidence_about(subject, results));
            }
        }
        evidence
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let mut claims = Vec::new();
        for space in &self.spaces {
            let properties = space.strengths(&KindCounts::default());
            claims.extend(properties.into_iter().map(|(property, _)| {
                ClaimDraft::about_all(plan, ANCHOR, property, space.domain())
            }));
        }
        claims
    }
}

#[cfg(test)]
mod tests;
