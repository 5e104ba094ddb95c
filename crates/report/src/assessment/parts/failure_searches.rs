//! The failure search: scope, effort and results for each controller.

use std::path::Path;

use maud::html;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::ScenarioCases;
use super::distinct_failure::{DistinctFailure, MethodResult, involves_vehicle_under_test};
use crate::assessment::case::{MotionRetention, largest, run_cases};
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength, Subject,
};
use crate::assessment::commands::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::markdown::{Inline, Markdown};
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::prose::prose_to_html;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, CrumpleCommand, ReportPart, Rounded};
use crumple_evidence::RateInterval;
use crumple_search::confirmation::ReplayShare;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress, CampaignSummary};
use crumple_search::falsify::counterexample::{AvoidabilityClass, Counterexample};
use crumple_store::disk::DiskError;
use crumple_world::scenario::file;
use crumple_world::sim::{FailedControllerRuns, NamedController};

/// Maximum number of shown failures of one search; a campaign of a few hundred runs finds fewer.
const MAX_SHOWN: usize = 100;
const MAX_DRAWN: usize = 3;
/// Maximum number of failures that Markdown lists for a controller that is not a main one.
const MAX_LISTED: usize = 3;

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
    #[serde(rename = "known")]
    pub content_id: ContentId,
    /// Purpose and content of the space.
    pub about: String,
    /// One entry per controller.
    pub controllers: Vec<FailureSearch>,
}

/// The search of one controller in one scenario space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureSearch {
    /// Name of the controller.
    pub controller: String,
    /// Command that repeats the search; absent for an external controller.
    pub command: Option<CrumpleCommand>,
    /// Result of each method: the search, then the reference searches.
    pub methods: Vec<MethodResult>,
    /// Number of distinct failures, by class.
    pub distinct: Vec<(AvoidabilityClass, usize)>,
    /// Severest of the distinct failures.
    pub failures: Vec<DistinctFailure>,
    /// Number of distinct collisions of other vehicles, which are no failures of the controller.
    #[serde(rename = "others")]
    pub collisions_of_others: usize,
    /// True for the first controller, the subject and the learned ones.
    #[serde(skip)]
    is_main: bool,
    #[serde(skip)]
    drawn_cases: Vec<ScenarioCases>,
}

impl FailureSearches {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let controllers = || plan.controllers.iter().enumerate();
        let pairs: Vec<_> =
            plan.search_spaces.iter().flat_map(|space| controllers().map(move |one| (space, one))).collect();
        let found = pairs.into_par_iter().map(|(space, controller)| FailureSearch::gather(space, controller, work));
        let mut found = found.collect::<Result<Vec<_>, _>>()?.into_iter();
        let spaces = plan.search_spaces.iter().map(|named| SpaceSearches {
            name: named.name.clone(),
            content_id: named.content_id.clone(),
            about: named.space.spec().about.clone(),
            controllers: found.by_ref().take(plan.controllers.len()).collect(),
        });
        Ok(Self { spaces: spaces.collect() })
    }

    /// Returns the severest failures of a controller over all spaces, for figures, under unique names.
    pub(in crate::assessment) fn worst_failures(&self, controller: &str, most: usize) -> Vec<ScenarioCases> {
        let own = self.spaces.iter().filter_map(|space| Some((space, space.find(controller)?)));
        let drawn = own
            .flat_map(|(space, search)| search.failures.iter().zip(&search.drawn_cases).map(move |one| (space, one)));
        let mut drawn: Vec<_> = drawn.collect();
        drawn.sort_by(|(_, (a, _)), (_, (b, _))| {
            let severity = |failure: &DistinctFailure| failure.impact_speed_mps.map_or(0.0, Rounded::value);
            severity(b).total_cmp(&severity(a))
        });
        let named = |(rank, (space, (_, cases))): (usize, (&SpaceSearches, (&DistinctFailure, &ScenarioCases)))| {
            let mut cases = cases.clone();
            cases.scenario = format!("failure {} of {}", rank + 1, space.content_id.name);
            cases
        };
        drawn.into_iter().take(most).enumerate().map(named).collect()
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let all = self
            .spaces
            .iter()
            .flat_map(|space| plan.claim_subjects().into_iter().zip(&space.controllers).map(move |pair| (space, pair)));
        let of = |(space, (subject, search)): (&SpaceSearches, (Subject, &FailureSearch))| {
            let (runs, unanswered) = (search.conclusive_evaluations(), search.unanswered());
            let strength = match search.distinct_count() {
                0 => Strength::from_counts(search.methods.iter().map(|reached| reached.failures).sum(), runs),
                // No collision was found, only failures to answer.
                failures if failures == search.unanswered_failures().count() => {
                    Strength::from_counts_with_unanswered(0, runs, unanswered.as_ref(), true)
                }
                failures => Strength::Falsified {
                    failures,
                    avoidable: search.count(AvoidabilityClass::Avoidable),
                    reason: unanswered.map(|unanswered| unanswered.because),
                },
            };
            let claim = AssuranceClaim { subject, property: Property::NoContact, domain: space.domain(plan) };
            let source = EvidenceSource::from_part("search", format!("{} simulations", search.evaluations()));
            Evidence { claim, strength, source }
        };
        all.map(of).collect()
    }

    pub(in crate::assessment) fn failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.spaces.iter().flat_map(|space| &space.controllers).flat_map(|search| &search.failures)
    }
}

impl SpaceSearches {
    pub(in crate::assessment) fn domain(&self, plan: &AssessmentPlan) -> Domain {
        let (seed, budget) = (plan.config.seed, plan.config.search.budget);
        Domain::Search { space: self.content_id.clone(), seed, budget }
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&FailureSearch> {
        self.controllers.iter().find(|search| search.controller == controller)
    }

    fn table(&self) -> ReportTable {
        let first = |reached: Option<&MethodResult>| {
            let first = reached.and_then(|reached| reached.first_failure);
            ReportCell::number(first.map_or("none".to_owned(), |first| first.to_string()))
        };
        ReportTable::from_items(
            &self.controllers,
            &[
                ("controller", &|search| ReportCell::text(&search.controller)),
                ("distinct failures", &|search| {
                    ReportCell::with_verdict(search.distinct_count(), search.distinct_count() == 0)
                }),
                ("avoidable", &|search| ReportCell::number(search.count(AvoidabilityClass::Avoidable))),
                ("unavoidable", &|search| ReportCell::number(search.count(AvoidabilityClass::Unavoidable))),
                ("undecided", &|search| ReportCell::number(search.count(AvoidabilityClass::Undecided))),
                ("multi-body: failures", &|search| {
                    describe_share(search.multi_body_share(|one| one.survives_multi_body))
                }),
                ("multi-body: escapes", &|search| {
                    describe_share(search.multi_body_share(DistinctFailure::escape_survives))
                }),
                ("max impact (m/s)", &|search| ReportCell::optional(search.max_impact_speed_mps())),
                ("first failure (run)", &|search| first(search.methods.first())),
                ("uniform: first (run)", &|search| first(search.method_result(Method::Uniform))),
                ("uniform: failures (%)", &|search| ReportCell::optional(search.format_uniform_share())),
                ("Halton: first (run)", &|search| first(search.method_result(Method::Halton))),
            ],
        )
    }
}

impl FailureSearch {
    pub(in crate::assessment) fn gather(
        named: &NamedSpace,
        (index, controller): (usize, &NamedController),
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let plan = work.plan;
        let space = &named.space;
        let campaign = Campaign {
            estimator: plan.config.estimator,
            budget: plan.config.search.budget,
            seed: plan.config.seed,
            ..Campaign::new(controller.clone(), space.clone())
        };
        let item = format!("search {} in {}", controller.name, space.name());
        let inputs = json!([plan.identity(controller), named.text, campaign.budget, campaign.seed]);
        let (summary, texts) = run_campaign(&campaign, (&item, &inputs), MAX_SHOWN, work)?;
        let place = format!("counterexamples/{}/{}", file_stem(space.name()), plan.controller_slug(index));
        let word = controller_arg(&controller.kind);
        let seeing = plan.estimator_args().iter().copied();
        let replay = |file: &str| {
            let simulate =
                CrumpleCommand::new(["simulate", file, "--controller", word.as_deref()?]).with_args(seeing.clone());
            Some(simulate.with_args(["--expect", "collision"]))
        };
        let nominal = space.scenario(&space.nominal())?;
        let is_own =
            |found: &&Counterexample| involves_vehicle_under_test([found.front_vehicle, found.rear_vehicle], &nominal);
        let found = summary.counterexamples.iter().zip(texts).filter(|(found, _)| is_own(found));
        let failures: Vec<_> =
            found.map(|(found, text)| DistinctFailure::from_counterexample(found, &place, text, &replay)).collect();
        let exported = failures.into_par_iter().map(|one| one.with_simulator_files(controller, plan.config.estimator));
        let failures = exported.collect::<Result<Vec<_>, _>>()?;
        let classes = [
            AvoidabilityClass::Avoidable,
            AvoidabilityClass::Unavoidable,
            AvoidabilityClass::Undecided,
            AvoidabilityClass::NotAsked,
        ];
        let own: Vec<_> = summary.counterexamples.iter().filter(is_own).collect();
        let count = |class| own.iter().filter(|one| one.avoidability.class() == class).count();
        let [budget, seed] = [campaign.budget, campaign.seed].map(|number| number.to_string());
        let out = format!("searches/{}/{}", file_stem(space.name()), plan.controller_slug(index));
        let command = word.as_deref().map(|word| {
            let what =
                ["falsify", "--controller", word, "--space", &named.to_arg(), "--budget", &budget, "--seed", &seed];
            CrumpleCommand::new(what).with_args(["--out", &out]).with_args(seeing.clone())
        });
        let is_main = is_main_controller(plan, index, controller);
        let drawn_cases = if is_main { simulate_failures(plan, controller, &failures)? } else { Vec::new() };
        Ok(Self {
            controller: controller.name.clone(),
            command,
            methods: summary.methods.iter().map(|method| MethodResult::new(method, &summary, &nominal)).collect(),
            distinct: classes.map(|class| (class, count(class))).into_iter().filter(|(_, n)| *n > 0).collect(),
            failures,
            collisions_of_others: summary.counterexamples.len() - own.len(),
            is_main,
            drawn_cases,
        })
    }

    fn unanswered_failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.failures.iter().filter(|failure| failure.reason.is_some())
    }

    fn unanswered(&self) -> Option<FailedControllerRuns> {
        let runs = self.methods.iter().map(|reached| reached.unanswered).sum();
        let reason = self.unanswered_failures().find_map(|failure| failure.reason.clone());
        let because = reason.unwrap_or_else(|| "the reason is unknown".to_owned());
        (runs > 0).then_some(FailedControllerRuns { runs, because })
    }

    pub(in crate::assessment) fn describe_unanswered(&self) -> Option<String> {
        Some(self.unanswered()?.describe(self.evaluations()))
    }

    /// Returns the number of distinct failures of a class.
    #[must_use]
    pub fn count(&self, class: AvoidabilityClass) -> usize {
        self.distinct.iter().filter(|(of, _)| *of == class).map(|(_, count)| count).sum()
    }

    /// Returns the number of all distinct failures.
    #[must_use]
    pub fn distinct_count(&self) -> usize {
        self.distinct.iter().map(|(_, count)| count).sum()
    }

    /// Returns the number of simulations of all methods.
    #[must_use]
    pub fn evaluations(&self) -> u64 {
        self.methods.iter().map(|reached| reached.evaluations).sum()
    }

    /// Returns the number of simulations that are evidence about the controller.
    #[must_use]
    pub fn conclusive_evaluations(&self) -> u64 {
        self.evaluations() - self.methods.iter().map(|reached| reached.collisions_of_others).sum::<u64>()
    }

    /// Returns the share of uniform samples that fail, in percent.
    pub(super) fn uniform_failure_percent(&self) -> Option<Rounded<1>> {
        let uniform = self.method_result(Method::Uniform)?;
        Some(Rounded::new(100.0 * uniform.failures as f64 / uniform.evaluations.max(1) as f64))
    }

    /// Returns the share of listed failures for which a replay with the multi-body plant has a result.
    fn multi_body_share(&self, result: fn(&DistinctFailure) -> Option<bool>) -> Option<ReplayShare> {
        ReplayShare::from_results(self.failures.iter().filter_map(result))
    }

    fn max_impact_speed_mps(&self) -> Option<Rounded<1>> {
        largest(self.failures.iter().map(|failure| failure.impact_speed_mps.map(Rounded::value))).map(Rounded::new)
    }

    fn method_result(&self, method: Method) -> Option<&MethodResult> {
        self.methods.iter().find(|reached| reached.method == method.name())
    }

    fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.failures,
            &[
                ("failure", &|failure| ReportCell::text(failure.short_name())),
                ("what happens", &|failure| ReportCell::text(failure.describe())),
                ("impact (m/s)", &|failure| ReportCell::optional(failure.impact_speed_mps)),
                ("time (s)", &|failure| ReportCell::optional(failure.contact_time_s)),
                ("gap of the escape (m)", &|failure| ReportCell::text(failure.describe_escape())),
                ("multi-body", &|failure| ReportCell::text(failure.describe_multi_body())),
                ("delta-v (m/s)", &|failure| ReportCell::optional(failure.max_delta_v_mps)),
                ("vehicles", &|failure| ReportCell::number(failure.vehicles)),
                ("rank by likelihood", &|failure| ReportCell::number(failure.likelihood_rank)),
                ("found by", &|failure| ReportCell::text(format!("{}, run {}", failure.found_by, failure.found_at))),
                ("changed from nominal", &|failure| ReportCell::text(failure.changed.join(", "))),
            ],
        )
    }

    fn summary(&self) -> String {
        let avoidable = self.count(AvoidabilityClass::Avoidable);
        match self.distinct_count() {
            0 => "no failure found".to_owned(),
            1 => format!("one distinct failure, {avoidable} avoidable"),
            total => format!("{total} distinct failures, {avoidable} avoidable"),
        }
    }

    /// Describes the effort of the search, and the result of uniform samples.
    fn describe_effort(&self) -> String {
        let (Some(main), Some(uniform)) = (self.methods.first(), self.method_result(Method::Uniform)) else {
            return String::new();
        };
        let random = match uniform.failures {
            0 => format!(
                "no uniform point of {} fails, so the probability of a failure is below {} % at 95 % confidence",
                uniform.evaluations,
                uniform_upper_bound_percent(uniform)
            ),
            failures => format!("{failures} of {} uniform points fail", uniform.evaluations),
        };
        let first = match main.first_failure {
            Some(first) => format!("`{}` found the first failure in run {first} of {}", main.method, main.evaluations),
            None => format!("`{}` found no failure in {} runs", main.method, main.evaluations),
        };
        let rest = self.distinct_count().saturating_sub(self.failures.len());
        let rest = if rest == 0 { String::new() } else { format!(" {rest} further distinct failures are not listed.") };
        let others = self.describe_others().map_or_else(String::new, |others| format!(" {others}"));
        format!("{first}; {random}.{rest}{others}")
    }

    /// Returns the share of failing uniform points in percent; if there are none, with its upper bound at 95 %.
    fn format_uniform_share(&self) -> Option<String> {
        let uniform = self.method_result(Method::Uniform)?;
        let share = self.uniform_failure_percent()?;
        Some(match uniform.failures {
            0 => format!("{share} (< {})", uniform_upper_bound_percent(uniform)),
            _ => share.to_string(),
        })
    }

    fn describe_others(&self) -> Option<String> {
        let runs = self.evaluations() - self.conclusive_evaluations();
        (self.collisions_of_others > 0).then(|| {
            format!(
                "{runs} runs ended with {} distinct collisions of other vehicles, which are no evidence about the \
                 controller.",
                self.collisions_of_others
            )
        })
    }

    /// Returns the failures that Markdown lists.
    fn listed(&self) -> &[DistinctFailure] {
        let most = if self.is_main { self.failures.len() } else { self.failures.len().min(MAX_LISTED) };
        self.failures.get(..most).unwrap_or_default()
    }
}

fn describe_share(share: Option<ReplayShare>) -> ReportCell {
    ReportCell::optional(share.map(|ReplayShare { count, replays, interval }| {
        let [low, high] = [interval.lower, interval.upper].map(|share| 100.0 * share);
        format!("{count} of {replays} ({low:.0} to {high:.0} %)")
    }))
}

/// Returns the upper bound of the failure probability of a uniform point in percent, at 95 %, if no point failed.
fn uniform_upper_bound_percent(uniform: &MethodResult) -> Rounded<2> {
    Rounded::up(100.0 * RateInterval::clopper_pearson(0, uniform.evaluations, 0.9).upper)
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::assessment) struct CounterexampleFiles {
    pub(super) counterexample: String,
    pub(super) escape: Option<String>,
}

/// Runs a campaign, or resumes it; returns its summary and the files of its severest failures, which are cached.
pub(super) fn run_campaign(
    campaign: &Campaign,
    (item, inputs): (&str, &Value),
    most: usize,
    work: &GatherContext<'_>,
) -> Result<(CampaignSummary, Vec<CounterexampleFiles>), AssessError> {
    work.get_or_gather(item, inputs, || {
        let folder = work.cache.scratch_folder(item, inputs)?;
        let options = CampaignOptions { resume: campaign.controller.kind.identity().is_some(), ..Default::default() };
        let done = AtomicU64::new(0);
        let summary = campaign.run(folder.path(), options, &|progress: &CampaignProgress| {
            let more = progress.evaluations - done.swap(progress.evaluations, Ordering::Relaxed);
            if work.add_runs(more).is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        })?;
        let shown = summary.counterexamples.iter().take(most);
        let read = |name: &String| read_file(&folder.path().join(name));
        let texts = shown.map(|found| {
            let escape = found.escape_file.as_ref().map(read).transpose()?;
            Ok::<_, AssessError>(CounterexampleFiles { counterexample: read(&found.file)?, escape })
        });
        let texts = texts.collect::<Result<Vec<_>, _>>()?;
        folder.remove()?;
        Ok((summary, texts))
    })
}

fn is_main_controller(plan: &AssessmentPlan, index: usize, controller: &NamedController) -> bool {
    index == 0 || index == plan.subject_index || controller.kind.is_learned()
}

fn simulate_failures(
    plan: &AssessmentPlan,
    controller: &NamedController,
    failures: &[DistinctFailure],
) -> Result<Vec<ScenarioCases>, AssessError> {
    let mut drawn = Vec::new();
    for failure in failures.iter().take(MAX_DRAWN) {
        // A file that a campaign wrote and read back can be read again.
        let Ok(scenario) = file::from_toml(&failure.text, Path::new(&failure.file)) else { continue };
        // Add the failure's name, to be unique on the page: scenarios are named after their space.
        let named = scenario.edited(|spec| spec.name = format!("{} {}", spec.name, failure.short_name()))?;
        let one = std::slice::from_ref(controller);
        let cases = run_cases(&[&named], one, plan.config.estimator, MotionRetention::Keep)?;
        let replay =
            CrumpleCommand::new(["simulate", failure.file.as_str()]).with_args(plan.estimator_args().iter().copied());
        drawn.extend(cases.into_iter().map(|cases| ScenarioCases::new(&named, replay.clone(), cases)));
    }
    Ok(drawn)
}

fn read_file(path: &Path) -> Result<String, AssessError> {
    Ok(std::fs::read_to_string(path).map_err(DiskError::at(path)).map_err(CacheError::from)?)
}

const INTRODUCTION: &str = "A search looks for collisions; uniform points and a Halton sequence get the same budget. \
    Each failure is simulated again at a tenth of the step, shrunk towards the nominal scenario, and classified: \
    avoidable with the smallest gap of the best escape found, unavoidable if the checker accepted a proof, or \
    undecided. A counterexample shows that a failure is possible, not how often it occurs; its values may be unlikely. \
    If no uniform point fails, the share has an upper bound at 95 % confidence. Columns `multi-body`: shares of \
    failures that fail again, and of escapes without a collision, in a replay of vehicles with suspension, tyres, \
    brake pressure and an anti-lock braking system, with the exact 95 % interval of independent samples.";

const COMMANDS_NOTE: &str = "Run commands in the folder of this report. `replay.sh` checks the files and runs all \
    commands that show \
    failures or escapes; the escape of `NAME.toml` is `NAME-escape.toml`. Processes and FMUs have no commands here.";

impl FailureSearch {
    fn write(&self, out: &mut ReportDocument) {
        out.push_html(html! {
            details {
                summary { (self.controller) ": " (self.summary()) }
                p { (prose_to_html(&self.describe_effort())) }
                @if !self.failures.is_empty() {
                    (self.table().to_html())
                    @let commands = self.failures.iter().flat_map(DistinctFailure::commands);
                    ul { @for command in commands { li { code { (command) } } } }
                }
                @if let Some(command) = &self.command { p { "Search again: " code { (command) } } }
                @if !self.drawn_cases.is_empty() {
                    details {
                        summary { "figures of the severest failures" }
                        @for (rank, cases) in self.drawn_cases.iter().enumerate() {
                            @for case in &cases.cases {
                                figure { (cases.figure(case)) }
                                @if rank == 0 { figure { (cases.animation(case)) } }
                            }
                        }
                    }
                }
            }
        });
    }
}

impl SpaceSearches {
    /// Writes the severest failures of all controllers into one table; HTML has a table for each controller.
    fn write_markdown(&self, out: &mut Markdown) {
        let listed: Vec<&DistinctFailure> = self.controllers.iter().flat_map(FailureSearch::listed).collect();
        if !listed.is_empty() {
            let table = ReportTable::from_items(
                listed.iter().copied(),
                &[
                    ("controller and file", &|failure| ReportCell::text(failure.name_with_folder())),
                    ("what happens", &|failure| ReportCell::text(failure.describe())),
                    ("impact (m/s)", &|failure| ReportCell::optional(failure.impact_speed_mps)),
                    ("gap of the escape (m)", &|failure| ReportCell::text(failure.describe_escape())),
                    ("multi-body", &|failure| ReportCell::text(failure.describe_multi_body())),
                    ("rank by likelihood", &|failure| ReportCell::number(failure.likelihood_rank)),
                ],
            );
            table.write_markdown(out);
        }
        let unlisted = self.controllers.iter().filter_map(|search| {
            let count = search.distinct_count().saturating_sub(search.listed().len());
            (count > 0).then(|| format!("{count} of {}", search.controller))
        });
        let unlisted: Vec<_> = unlisted.collect();
        if !unlisted.is_empty() {
            out.paragraph(format!(
                "Further failures, less severe, in assessment.html and in the folder `counterexamples`: {}.",
                unlisted.join(", ")
            ));
        }
        for search in &self.controllers {
            if let Some(others) = search.describe_others() {
                out.paragraph(format!("{}: {others}", search.controller));
            }
        }
        let replay = listed.iter().find_map(|failure| failure.replay.as_ref());
        let search = self.controllers.iter().find_map(|search| search.command.as_ref());
        let examples = [("First counterexample: ", replay), ("First search: ", search)];
        out.list(examples.into_iter().filter_map(|(what, command)| Some(Inline::prose(what).and_code(command?))));
    }
}

impl ReportPart for FailureSearches {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("search", "Counterexamples found by search".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&format!("{INTRODUCTION} {COMMANDS_NOTE}"));
        for space in &self.spaces {
            out.heading(&format!("Space {}", space.name));
            out.table(&space.table());
            space.controllers.iter().for_each(|search| search.write(out));
            space.write_markdown(out.markdown_mut());
        }
    }
}
