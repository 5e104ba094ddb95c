//! Searches for violations of specifications other than collisions, such as unnecessary or induced braking.

use maud::html;
use serde::Serialize;
use serde_json::json;

use super::failure_searches::{CounterexampleFiles, run_campaign};
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength};
use crate::assessment::commands::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::markdown::Inline;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, ReportPart, Rounded};
use crumple_core::digest::sha256;
use crumple_search::falsify::campaign::{Campaign, CampaignSummary};
use crumple_search::falsify::counterexample::{ChangedParameter, Counterexample};
use crumple_world::measure::{DrivingRule, Specification};
use crumple_world::sim::{FailedControllerRuns, NamedController};

const ANCHOR: &str = "rules";

/// The results of all searches for violations of specifications.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpecificationSearches {
    /// One entry per scenario space and specification.
    pub searches: Vec<SpaceSpecificationSearches>,
}

/// The searches of every controller for one scenario space and specification.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceSpecificationSearches {
    /// Scenario space.
    pub space: ContentId,
    /// Specification, in the syntax of `--spec`.
    #[serde(rename = "rule")]
    pub specification: String,
    /// One entry per controller.
    pub controllers: Vec<SpecificationSearch>,
}

/// The search of one controller.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpecificationSearch {
    /// Name of the controller.
    pub controller: String,
    /// Number of simulations of all methods.
    pub evaluations: u64,
    /// Number of simulations that violate the specification.
    pub violations: u64,
    /// Simulations without an answer of the controller: neither satisfied nor violated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Number of distinct violations.
    pub distinct: usize,
    /// Index of the search's simulation with the first violation, from 1.
    pub first: Option<u64>,
    /// Violation with the least robustness.
    pub worst: Option<SpecificationViolation>,
    /// Command that repeats the search; absent for an external controller.
    pub command: Option<CrumpleCommand>,
}

/// A run that violates a specification, after shrinking.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpecificationViolation {
    /// Path of the scenario file, relative to the report folder.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Command that simulates the violation; absent for an external controller.
    pub replay: Option<CrumpleCommand>,
    /// Robustness: negative, in the unit of the specification.
    pub robustness: Rounded<3>,
    /// Parameters that are not nominal.
    pub changed: Vec<String>,
    #[serde(skip)]
    text: String,
}

pub(in crate::assessment) struct SpecificationSearchPlan<'p> {
    pub(in crate::assessment) space: &'p NamedSpace,
    pub(in crate::assessment) specification: &'p str,
    pub(in crate::assessment) controller: (usize, &'p NamedController),
}

impl<'p> SpecificationSearchPlan<'p> {
    pub(in crate::assessment) fn from_plan(plan: &'p AssessmentPlan) -> impl Iterator<Item = Self> {
        plan.search_spaces.iter().flat_map(move |space| {
            plan.config.search.specifications.iter().flat_map(move |specification| {
                plan.controllers.iter().enumerate().map(move |controller| Self { space, specification, controller })
            })
        })
    }

    /// Returns a name for readers, unique in a plan.
    pub(in crate::assessment) fn name(&self) -> String {
        format!("search {} in {} by {}", self.controller.1.name, self.space.name, self.specification)
    }

    pub(in crate::assessment) fn gather(
        &self,
        work: &GatherContext<'_>,
    ) -> Result<(CampaignSummary, Vec<CounterexampleFiles>), AssessError> {
        let plan = work.plan;
        let (controller, space) = (self.controller.1, &self.space.space);
        let nominal = space.scenario(&space.nominal())?;
        let campaign = Campaign {
            estimator: plan.config.estimator,
            specification: Specification::parse(self.specification, &nominal)?,
            budget: plan.config.search.budget,
            seed: plan.config.seed,
            ..Campaign::new(controller.clone(), space.clone())
        };
        let item = self.name();
        let inputs =
            json!([plan.identity(controller), self.space.text, self.specification, campaign.budget, campaign.seed]);
        run_campaign(&campaign, (&item, &inputs), 1, work)
    }

    fn summarize(
        &self,
        plan: &AssessmentPlan,
        (summary, texts): (CampaignSummary, Vec<CounterexampleFiles>),
    ) -> SpecificationSearch {
        let (index, controller) = self.controller;
        let word = controller_arg(&controller.kind);
        let seeing = plan.estimator_args().iter().copied();
        let (space, rule) = (file_stem(self.space.space.name()), file_stem(self.specification));
        let stem = format!("{space}/{rule}/{}", plan.controller_slug(index));
        let is_unanswered = |found: &&Counterexample| found.because.is_some();
        let severest = summary.counterexamples.first().filter(|found| !is_unanswered(found));
        let worst =
            severest.zip(texts.into_iter().next()).map(|(found, CounterexampleFiles { counterexample: text, .. })| {
                let file = format!("counterexamples/rules/{stem}.toml");
                let replay = word.as_deref().map(|word| {
                    let simulate = ["simulate", &file, "--controller", word, "--spec", self.specification];
                    CrumpleCommand::new(simulate).with_args(seeing.clone()).with_args(["--expect", "violated"])
                });
                SpecificationViolation {
                    sha256: sha256(&text),
                    robustness: Rounded::new(found.robustness),
                    changed: found.changed.iter().map(ChangedParameter::to_string).collect(),
                    file,
                    replay,
                    text,
                }
            });
        let [budget, seed] = [plan.config.search.budget, plan.config.seed].map(|number| number.to_string());
        let out = format!("searches/rules/{stem}");
        let command = word.as_deref().map(|word| {
            let space = self.space.to_arg();
            let what = ["falsify", "--controller", word, "--space", &space, "--spec", self.specification];
            let how = ["--budget", &budget, "--seed", &seed, "--out", &out];
            CrumpleCommand::new(what).with_args(how).with_args(seeing.clone())
        });
        let unanswered = summary.failures.iter().filter(|kind| kind.failed_vehicle.is_some());
        let runs: u64 = unanswered.clone().map(|kind| kind.count).sum();
        let reason = unanswered.filter_map(|kind| kind.because.clone()).next();
        let because = reason.unwrap_or_else(|| "the reason is unknown".to_owned());
        let breaking = summary.failures.iter().filter(|kind| kind.failed_vehicle.is_none());
        let by_method = breaking.flat_map(|kind| &kind.by_method).filter(|by| by.method == summary.method);
        let failures: u64 = summary.methods.iter().map(|method| method.failures).sum();
        SpecificationSearch {
            controller: controller.name.clone(),
            evaluations: summary.methods.iter().map(|method| method.evaluations).sum(),
            violations: failures.saturating_sub(runs),
            unanswered: (runs > 0).then_some(FailedControllerRuns { runs, because }),
            distinct: summary.counterexamples.iter().filter(|found| !is_unanswered(found)).count(),
            first: by_method.map(|by| by.first).min(),
            worst,
            command,
        }
    }
}

impl SpecificationSearches {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let mut searches: Vec<SpaceSpecificationSearches> = Vec::new();
        for one in SpecificationSearchPlan::from_plan(plan) {
            let found = one.summarize(plan, one.gather(work)?);
            if one.controller.0 == 0 {
                let (space, rule) = (one.space.content_id.clone(), one.specification.to_owned());
                searches.push(SpaceSpecificationSearches { space, specification: rule, controllers: Vec::new() });
            }
            if let Some(last) = searches.last_mut() {
                last.controllers.push(found);
            }
        }
        Ok((!searches.is_empty()).then_some(Self { searches }))
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let of = |searches: &SpaceSpecificationSearches| {
            let domain = searches.domain(plan);
            let claimants = plan.claim_subjects().into_iter().zip(&searches.controllers);
            let each = claimants.map(|(subject, search)| Evidence {
                claim: AssuranceClaim { subject, property: searches.property(), domain: domain.clone() },
                strength: search.strength(),
                source: EvidenceSource::from_part(ANCHOR, format!("{} simulations", search.evaluations)),
            });
            each.collect::<Vec<_>>()
        };
        self.searches.iter().flat_map(of).collect()
    }

    fn violations(&self) -> impl Iterator<Item = &SpecificationViolation> {
        self.searches.iter().flat_map(|one| &one.controllers).filter_map(|search| search.worst.as_ref())
    }

    pub(in crate::assessment) fn files(&self) -> impl Iterator<Item = (String, Vec<u8>)> {
        self.violations().map(|one| (one.file.clone(), one.text.clone().into_bytes()))
    }

    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.violations().filter_map(|one| one.replay.as_ref())
    }
}

impl SpecificationSearch {
    fn strength(&self) -> Strength {
        Strength::from_counts_with_unanswered(self.violations, self.evaluations, self.unanswered.as_ref(), false)
    }
}

impl SpaceSpecificationSearches {
    pub(in crate::assessment) fn domain(&self, plan: &AssessmentPlan) -> Domain {
        Domain::Search { space: self.space.clone(), seed: plan.config.seed, budget: plan.config.search.budget }
    }

    pub(in crate::assessment) fn property(&self) -> Property {
        match self.specification.parse() {
            Ok(DrivingRule::NoUnnecessaryBraking) => Property::NoUnnecessaryBraking,
            _ => Property::Satisfies { rule: self.specification.clone() },
        }
    }

    fn table(&self) -> ReportTable {
        let worst = |search: &SpecificationSearch, words: fn(&SpecificationViolation) -> String| {
            search.worst.as_ref().map(words)
        };
        ReportTable::from_items(
            &self.controllers,
            &[
                ("controller", &|search| ReportCell::text(&search.controller)),
                ("violations", &|search| {
                    let is_kept = search.violations == 0 && search.unanswered.is_none();
                    ReportCell::with_verdict(format!("{} of {}", search.violations, search.evaluations), is_kept)
                }),
                ("distinct", &|search| ReportCell::number(search.distinct)),
                ("first violation (run)", &|search| ReportCell::optional(search.first)),
                ("robustness", &|search| ReportCell::optional(worst(search, |one| one.robustness.to_string()))),
                ("changed from nominal", &|search| {
                    ReportCell::text(worst(search, |one| one.changed.join(", ")).unwrap_or_else(|| "–".to_owned()))
                }),
            ],
        )
    }

    fn unanswered_notes(&self) -> impl Iterator<Item = String> {
        let unanswered = self.controllers.iter().filter_map(|search| Some((search, search.unanswered.as_ref()?)));
        unanswered
            .map(|(search, unanswered)| format!("{} {}.", search.controller, unanswered.describe(search.evaluations)))
    }

    fn replay_commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.controllers.iter().filter_map(|search| search.worst.as_ref()?.replay.as_ref())
    }

    fn title(&self) -> String {
        format!("{} in {}", self.specification, self.space.name)
    }
}

const INTRODUCTION: &str = "A controller without collisions may still drive badly. A search and two reference searches \
    look for violations of each specification; the worst one is shrunk and stored. Robustness is the signed distance \
    from a violation, negative if the specification is violated.";

impl ReportPart for SpecificationSearches {
    fn anchor_and_title(&self) -> (&'static str, String) {
        (ANCHOR, "Violated specifications".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(INTRODUCTION);
        for one in &self.searches {
            out.heading(&one.title());
            out.table(&one.table());
            one.unanswered_notes().for_each(|line| out.paragraph(&line));
            out.push_html(html! { p.replay { @for command in one.replay_commands() { code { (command) } " " } } });
            out.collapsible("commands that repeat the searches", |out| {
                out.commands(one.controllers.iter().filter_map(|search| search.command.as_ref()));
            });
            out.markdown_mut().list(one.replay_commands().map(Inline::code));
        }
    }
}
