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
use crate::assessment::markdown::Inline;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::prose::prose_to_html;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, CrumpleCommand, ReportPart, Rounded};
use crumple_evidence::RateInterval;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress, CampaignSummary};
use crumple_search::falsify::counterexample::{AvoidabilityClass, Counterexample};
use crumple_store::disk::DiskError;
use crumple_world::scenario::file;
use crumple_world::sim::{FailedControllerRuns, NamedController};

/// Maximum number of shown failures of one search; a campaign of a few hundred runs finds fewer.
const MAX_SHOWN: usize = 100;
const MAX_DRAWN: usize = 3;

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
    pub others: usize,
    #[serde(skip)]
    drawn_cases: Vec<ScenarioCases>,
}

impl FailureSearches {
    pub(in crate::assessment) fn gather(plan: &AssessmentPlan, work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let pairs: Vec<_> = plan
            .spaces
            .iter()
            .flat_map(|space| plan.controllers.iter().enumerate().map(move |one| (space, one)))
            .collect();
        let found =
            pairs.into_par_iter().map(|(space, controller)| FailureSearch::gather(plan, space, controller, work));
        let mut found = found.collect::<Result<Vec<_>, _>>()?.into_iter();
        let spaces = plan.spaces.iter().map(|named| SpaceSearches {
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
            let strength = match search.distinct_count() {
                0 => Strength::from_counts(
                    search.methods.iter().map(|reached| reached.failures).sum(),
                    search.conclusive_evaluations(),
                ),
                // No collision was found, only failures to answer.
                failures if failures == search.unanswered_failures().count() => Strength::from_counts_with_unanswered(
                    0,
                    search.conclusive_evaluations(),
                    search.unanswered().as_ref(),
                    true,
                ),
                failures => Strength::Falsified {
                    failures,
                    avoidable: search.count(AvoidabilityClass::Avoidable),
                    because: search.unanswered().map(|silent| silent.because),
                },
            };
            let claim = AssuranceClaim { subject, property: Property::NoContact, domain: space.domain(plan) };
            Evidence {
                claim,
                strength,
                source: EvidenceSource::from_part("search", format!("{} evaluations", search.evaluations())),
            }
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
                ("severest impact (m/s)", &|search| ReportCell::optional(search.max_impact_speed_mps())),
                ("first after (runs)", &|search| first(search.methods.first())),
                ("uniform: first after", &|search| first(search.method_result(Method::Uniform))),
                ("share failing", &|search| {
                    ReportCell::optional(search.uniform_failure_percent().map(|share| format!("{share} %")))
                }),
                ("Halton: first after", &|search| first(search.method_result(Method::Halton))),
            ],
        )
    }
}

impl FailureSearch {
    pub(in crate::assessment) fn gather(
        plan: &AssessmentPlan,
        named: &NamedSpace,
        (index, controller): (usize, &NamedController),
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
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
        let drawn = if is_drawn(plan, index, controller) {
            simulate_failures(plan, controller, &failures)?
        } else {
            Vec::new()
        };
        Ok(Self {
            controller: controller.name.clone(),
            command,
            methods: summary.methods.iter().map(|method| MethodResult::new(method, &summary, &nominal)).collect(),
            distinct: classes.map(|class| (class, count(class))).into_iter().filter(|(_, n)| *n > 0).collect(),
            failures,
            others: summary.counterexamples.len() - own.len(),
            drawn_cases: drawn,
        })
    }

    fn unanswered_failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.failures.iter().filter(|failure| failure.because.is_some())
    }

    fn unanswered(&self) -> Option<FailedControllerRuns> {
        let runs = self.methods.iter().map(|reached| reached.unanswered).sum();
        let because = self.unanswered_failures().find_map(|failure| failure.because.clone());
        (runs > 0).then(|| FailedControllerRuns {
            runs,
            because: because.unwrap_or_else(|| "of none of them is it known why".to_owned()),
        })
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
        self.evaluations() - self.methods.iter().map(|reached| reached.others).sum::<u64>()
    }

    /// Returns the share of uniform samples that fail, in percent.
    pub(super) fn uniform_failure_percent(&self) -> Option<Rounded<1>> {
        let uniform = self.method_result(Method::Uniform)?;
        Some(Rounded::new(100.0 * uniform.failures as f64 / uniform.evaluations.max(1) as f64))
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
                ("class", &|failure| ReportCell::text(failure.describe_class())),
                ("delta-v (m/s)", &|failure| ReportCell::optional(failure.max_delta_v_mps)),
                ("vehicles", &|failure| ReportCell::number(failure.vehicles)),
                ("rank by likelihood", &|failure| ReportCell::number(failure.likelihood_rank)),
                ("found by", &|failure| ReportCell::text(format!("{}, run {}", failure.found_by, failure.found_at))),
                ("what is not nominal", &|failure| ReportCell::text(failure.changed.join(", "))),
            ],
        )
    }

    fn summary(&self) -> String {
        let avoidable = self.count(AvoidabilityClass::Avoidable);
        match self.distinct_count() {
            0 => "no failure found".to_owned(),
            1 => format!("one failure, {}", if avoidable == 1 { "avoidable" } else { "not known to be avoidable" }),
            total => format!("{total} distinct failures, {avoidable} of them avoidable"),
        }
    }

    /// Describes the effort of the search, and the result of uniform samples.
    fn describe_effort(&self) -> String {
        let (Some(main), Some(uniform)) = (self.methods.first(), self.method_result(Method::Uniform)) else {
            return String::new();
        };
        let random = match uniform.failures {
            0 => {
                let upper = RateInterval::clopper_pearson(0, uniform.evaluations, 0.9).upper;
                format!(
                    "of {} uniform points none fails, so that with 95 % confidence a random point fails with a probability below \
                     {} % and random search would need more than {:.0} runs on average",
                    uniform.evaluations,
                    Rounded::<2>::up(100.0 * upper),
                    (1.0 / upper).floor()
                )
            }
            failures => format!(
                "of {} uniform points {failures} fail, one in {:.1}",
                uniform.evaluations,
                uniform.evaluations as f64 / failures as f64
            ),
        };
        let first = match main.first_failure {
            Some(first) => format!("`{}` met its first failure in run {first} of {}", main.method, main.evaluations),
            None => format!("`{}` met none in {} runs", main.method, main.evaluations),
        };
        let rest = self.distinct_count().saturating_sub(self.failures.len());
        let rest = if rest == 0 { String::new() } else { format!(" {rest} further distinct failures are not listed.") };
        let others = match self.others {
            0 => String::new(),
            others => format!(
                " {} runs ended when vehicles touched that are not under test, in {others} ways: these say nothing of the \
                 controller.",
                self.evaluations() - self.conclusive_evaluations()
            ),
        };
        format!("{first}; {random}.{rest}{others}")
    }
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

fn is_drawn(plan: &AssessmentPlan, index: usize, controller: &NamedController) -> bool {
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

const INTRODUCTION: &str = "A search looks for contacts; points drawn evenly over the ranges (uniform) and a Halton sequence get the same budget. Failures are \
    replayed at the scenario's step and at a tenth of it, shrunk towards the nominal scenario, told apart, ranked by severity \
    and by likelihood, and classed: avoidable, if a driver who knows the future has an escape; unavoidable, if the checker has \
    accepted a proof that nobody has one; the escape lies beside the file of the failure, as `…-escape.toml`, and `avoid` shows the proof again. A failure says that something can \
    happen, not how often: it may need values from the far tails of the law, which a search takes as readily as others.";

const COMMANDS_NOTE: &str = "Commands run in the folder of this report, where policies and spaces that are not built in lie beside it; \
    `replay.sh` checks the files of the report and runs all that show a failure or an escape. A controller from outside that is no file of its own \
    (a process, an FMU) has no commands here.";

impl FailureSearch {
    fn write(&self, out: &mut ReportDocument) {
        out.push_html(html! {
            details {
                summary { (self.controller) ": " (self.summary()) }
                p { (prose_to_html(&self.describe_effort())) }
                @if !self.failures.is_empty() {
                    (self.table().to_html())
                    ul { @for command in self.failures.iter().flat_map(DistinctFailure::commands) { li { code { (command) } } } }
                }
                @if let Some(command) = &self.command { p { "Search again: " code { (command) } } }
                @if !self.drawn_cases.is_empty() {
                    details {
                        summary { "the severest, drawn" }
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
        let with_command = |words: Inline, before: &str, command: &Option<CrumpleCommand>| match command {
            Some(command) => words.and_prose(before).and_code(command),
            None => words,
        };
        let words = Inline::prose(&format!("{}: {}", self.controller, self.describe_effort()));
        out.markdown_mut().paragraph(with_command(words, " Search again: ", &self.command));
        out.markdown_mut().list(self.failures.iter().map(|failure| {
            let (words, class) = (failure.describe(), failure.describe_class());
            let words = Inline::prose(&format!("{words}, {class}, rank {} by likelihood", failure.likelihood_rank));
            with_command(words, ": ", &failure.replay)
        }));
    }
}

impl ReportPart for FailureSearches {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("search", "Failure search".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&format!("{INTRODUCTION} {COMMANDS_NOTE}"));
        for space in &self.spaces {
            out.heading(&format!("Space {}", space.name));
            out.paragraph(&space.about);
            out.table(&space.table());
            space.controllers.iter().for_each(|search| search.write(out));
        }
    }
}
