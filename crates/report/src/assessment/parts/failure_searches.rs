//! The failure search: scope, effort and results for each controller.

use rayon::prelude::*;
use serde::Serialize;

use super::ScenarioCases;
use super::distinct_failure::{DistinctFailure, MethodResult};
use super::failure_search::FailureSearch;
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength, Subject,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, Rounded};
use crumple_search::confirmation::ReplayShare;
use crumple_search::falsify::Method;
use crumple_search::falsify::counterexample::AvoidabilityClass;

pub(super) const ANCHOR: &str = "search";

/// The results of all failure searches.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureSearches {
    /// One entry per scenario space.
    pub spaces: Vec<SpaceSearches>,
}

/// The searches of every controller in one scenario space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceSearches {
    /// Scenario space, in the syntax of `--space`.
    pub name: String,
    /// Identifier of the scenario space.
    pub content_id: ContentId,
    /// Purpose and content of the space.
    pub about: String,
    /// One entry per controller.
    pub controllers: Vec<FailureSearch>,
}

impl FailureSearches {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let pairs: Vec<_> = plan
            .search_spaces
            .iter()
            .flat_map(|space| {
                let controllers = plan.controllers.iter().enumerate();
                controllers.map(move |controller| (space, controller))
            })
            .collect();
        let mut searches = pairs
            .into_par_iter()
            .map(|(space, controller)| FailureSearch::gather(space, controller, work))
            .collect::<Result<Vec<_>, _>>()?
            .into_iter();
        let spaces = plan.search_spaces.iter().map(|named| SpaceSearches {
            name: named.name.clone(),
            content_id: named.content_id.clone(),
            about: named.space.spec().about.clone(),
            controllers: searches.by_ref().take(plan.controllers.len()).collect(),
        });
        Ok(Self {
            spaces: spaces.collect(),
        })
    }

    /// Returns the severest failures of a controller over all spaces, for figures, under unique names.
    pub(in crate::assessment) fn worst_failures(
        &self,
        controller: &str,
        max_count: usize,
    ) -> Vec<ScenarioCases> {
        let mut drawn: Vec<(f64, &SpaceSearches, &ScenarioCases)> = Vec::new();
        for space in &self.spaces {
            let Some(search) = space.find(controller) else {
                continue;
            };
            for (failure, cases) in search.failures.iter().zip(&search.drawn_cases) {
                let severity_mps = failure.impact_speed_mps.map_or(0.0, Rounded::value);
                drawn.push((severity_mps, space, cases));
            }
        }
        drawn.sort_by(|(a, ..), (b, ..)| b.total_cmp(a));
        drawn
            .into_iter()
            .take(max_count)
            .enumerate()
            .map(|(rank, (_, space, cases))| {
                let mut cases = cases.clone();
                cases.scenario = format!("failure {} of {}", rank + 1, space.content_id.name);
                cases
            })
            .collect()
    }

    pub(in crate::assessment) fn failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.spaces
            .iter()
            .flat_map(|space| &space.controllers)
            .flat_map(|search| &search.failures)
    }
}

impl SpaceSearches {
    pub(in crate::assessment) fn domain(&self, plan: &AssessmentPlan) -> Domain {
        Domain::Search {
            space: self.content_id.clone(),
            seed: plan.config.seed,
            budget: plan.config.search.budget,
        }
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&FailureSearch> {
        self.controllers
            .iter()
            .find(|search| search.controller == controller)
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.controllers,
            &[
                ("controller", &|search| ReportCell::text(&search.controller)),
                ("distinct failures", &|search| {
                    ReportCell::with_verdict(search.distinct_count(), search.distinct_count() == 0)
                }),
                ("avoidable", &|search| {
                    ReportCell::number(search.count(AvoidabilityClass::Avoidable))
                }),
                ("unavoidable", &|search| {
                    ReportCell::number(search.count(AvoidabilityClass::Unavoidable))
                }),
                ("undecided", &|search| {
                    ReportCell::number(search.count(AvoidabilityClass::Undecided))
                }),
                ("multi-body: failures", &|search| {
                    describe_share(search.multi_body_share(|failure| failure.survives_multi_body))
                }),
                ("multi-body: escapes", &|search| {
                    describe_share(search.multi_body_share(DistinctFailure::escape_survives))
                }),
                ("max impact (m/s)", &|search| {
                    ReportCell::optional(search.max_impact_speed_mps())
                }),
                ("first failure (run)", &|search| {
                    first_failure_cell(search.methods.first())
                }),
                ("uniform: first (run)", &|search| {
                    first_failure_cell(search.method_result(Method::Uniform))
                }),
                ("uniform: failures (%)", &|search| {
                    ReportCell::optional(search.format_uniform_share())
                }),
                ("Halton: first (run)", &|search| {
                    first_failure_cell(search.method_result(Method::Halton))
                }),
            ],
        )
    }
}

fn first_failure_cell(method: Option<&MethodResult>) -> ReportCell {
    let run = method.and_then(|method| method.first_failure);
    ReportCell::number(run.map_or("none".to_owned(), |run| run.to_string()))
}

fn describe_share(share: Option<ReplayShare>) -> ReportCell {
    ReportCell::optional(share.map(
        |ReplayShare {
             count,
             replays,
             interval,
         }| { format!("{count} of {replays} ({} %)", interval.to_percent_text(0)) },
    ))
}

const INTRODUCTION: &str = "A search looks for collisions; uniform points and a Halton sequence get the same budget. \
    Each failure is simulated again at a tenth of the step, shrunk towards the nominal scenario, and classified: \
    avoidable with the smallest gap of the best escape found, unavoidable if the checker accepted a proof, or \
    undecided. A counterexample shows that a failure is possible, not how often it occurs; its values may be unlikely. \
    If no uniform point fails, brackets have an upper bound of the share that fails, at 95 % confidence. Columns \
    `multi-body`: shares of failures that fail again, and of escapes without a collision, in a replay of vehicles with \
    suspension, tyres, brake pressure and an anti-lock braking system. The 95 % intervals are exact for independent \
    samples; failures of one search are not independent.";

const COMMANDS_NOTE: &str = "Run commands in the folder of this report. `replay.sh` checks the files and runs all \
    commands that show failures or escapes; the escape of `NAME.toml` is `NAME-escape.toml`. The folder \
    `controllers` has copies of policies, networks, processes and FMUs. There is no copy and no command \
    of a process whose controller file lists no `files`, or whose program is in the folder of its controller file.";

impl SpaceSearches {
    fn write(&self, out: &mut ReportDocument) {
        out.heading(format!("Space {}", self.content_id.name));
        out.table(self.table());
        for search in &self.controllers {
            search.write_details(out);
        }
    }
}

impl ReportPart for FailureSearches {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Searches,
            anchor: ANCHOR,
            title: "Counterexamples found by search",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        // A search has a method and two reference searches.
        plan.runs_of_all(3 * plan.search_spaces.len() as u64 * plan.config.search.budget)
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(format!("{INTRODUCTION} {COMMANDS_NOTE}"));
        self.spaces.iter().for_each(|space| space.write(out));
    }

    fn is_shown(&self) -> bool {
        !self.spaces.is_empty()
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        self.spaces
            .iter()
            .flat_map(|space| space.evidence(plan))
            .collect()
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        self.spaces
            .iter()
            .map(|space| {
                ClaimDraft::about_all(plan, ANCHOR, Property::NoCollision, space.domain(plan))
            })
            .collect()
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        self.failures().flat_map(DistinctFailure::files).collect()
    }
}

impl SpaceSearches {
    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let subjects = plan.claim_subjects().into_iter();
        subjects
            .zip(&self.controllers)
            .map(|(subject, search)| search.evidence(subject, self.domain(plan)))
            .collect()
    }
}

impl FailureSearch {
    fn evidence(&self, subject: Subject, domain: Domain) -> Evidence {
        let description = format!("{} simulations", self.evaluations());
        Evidence {
            claim: AssuranceClaim {
                subject,
                property: Property::NoCollision,
                domain,
            },
            strength: self.strength(),
            first_violation: None,
            source: EvidenceSource::from_part(ANCHOR, description),
        }
    }

    fn strength(&self) -> Strength {
        let runs = self.conclusive_evaluations();
        let unanswered = self.unanswered();
        match self.distinct_count() {
            0 => Strength::from_counts(
                self.methods.iter().map(|method| method.failures).sum(),
                runs,
            ),
            // No collision was found, only failures to answer.
            failures if failures == self.unanswered_failures().count() => {
                Strength::from_counts_with_unanswered(0, runs, unanswered.as_ref(), true)
            }
            failures => Strength::Falsified {
                failures,
                avoidable: self.count(AvoidabilityClass::Avoidable),
                reason: unanswered.map(|unanswered| unanswered.reason),
            },
        }
    }
}
