//! The failure search: for each controller, what was searched, how hard, and what was found.

use std::path::Path;

use maud::html;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::ScenarioCases;
use super::distinct_failure::{Failure, MethodResult, is_own};
use crate::assessment::case::{Motion, largest, run_cases};
use crate::assessment::claims::{Claim, Domain, Evidence, Known, Property, Source, Strength, Subject};
use crate::assessment::commands::controller_arg;
use crate::assessment::document::Document;
use crate::assessment::markdown::Inline;
use crate::assessment::figure_layout::{NamedSpace, file_stem};
use crate::assessment::prose::prose;
use crate::assessment::table::{Cell, Table};
use crate::assessment::gather_context::Work;
use crate::assessment::{AssessError, AssessmentPlan, Command, Part, Rounded, StoreError};
use crumple_evidence::RateInterval;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress, Summary};
use crumple_search::falsify::counterexample::{AvoidabilityClass, Counterexample};
use crumple_store::disk::DiskError;
use crumple_world::scenario::file;
use crumple_world::sim::{NamedController, Unanswered};

/// Failures of one search that are shown, the severest first: more than a campaign of a few hundred runs tells apart.
const MAX_SHOWN: usize = 100;
/// Failures of one search that are drawn.
const MAX_DRAWN: usize = 3;

/// What was searched for failures, and what was found.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureSearches {
    /// One entry a space.
    pub spaces: Vec<SpaceSearches>,
}

/// Every controller in one space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceSearches {
    /// The space, as `--space` takes it.
    pub name: String,
    /// The space.
    #[serde(rename = "known")]
    pub content_id: Known,
    /// What the space covers and why.
    pub about: String,
    /// One entry a controller.
    pub controllers: Vec<FailureSearch>,
}

/// One controller in one space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureSearch {
    /// The controller.
    pub controller: String,
    /// How to search again; none of a controller from outside.
    pub command: Option<Command>,
    /// What each method reached: the search, then the reference searches.
    pub methods: Vec<MethodResult>,
    /// Distinct failures found, by class.
    pub distinct: Vec<(AvoidabilityClass, usize)>,
    /// The severest of them.
    pub failures: Vec<Failure>,
    /// Distinct ways in which only vehicles touched that are not under test: they are no failures of the controller.
    pub others: usize,
    #[serde(skip)]
    drawn_cases: Vec<ScenarioCases>,
}

impl FailureSearches {
    pub(in crate::assessment) fn gather(plan: &AssessmentPlan, work: &Work<'_>) -> Result<Self, AssessError> {
        let pairs: Vec<_> = plan
            .spaces
            .iter()
            .flat_map(|space| plan.controllers.iter().enumerate().map(move |one| (space, one)))
            .collect();
        let found = pairs.into_par_iter().map(|(space, controller)| FailureSearch::gather(plan, space, controller, work));
        let mut found = found.collect::<Result<Vec<_>, _>>()?.into_iter();
        let spaces = plan.spaces.iter().map(|named| SpaceSearches {
            name: named.name.clone(),
            known: named.known.clone(),
            about: named.space.spec().about.clone(),
            controllers: found.by_ref().take(plan.controllers.len()).collect(),
        });
        Ok(Self { spaces: spaces.collect() })
    }

    /// The severest failures of a controller over all spaces, drawn, each under a name of its own.
    pub(in crate::assessment) fn worst_failures(&self, controller: &str, most: usize) -> Vec<ScenarioCases> {
        let own = self.spaces.iter().filter_map(|space| Some((space, space.of(controller)?)));
        let drawn =
            own.flat_map(|(space, search)| search.failures.iter().zip(&search.drawn).map(move |one| (space, one)));
        let mut drawn: Vec<_> = drawn.collect();
        drawn.sort_by(|(_, (a, _)), (_, (b, _))| {
            let severity = |failure: &Failure| failure.impact_speed_mps.map_or(0.0, Rounded::value);
            severity(b).total_cmp(&severity(a))
        });
        let named = |(rank, (space, (_, cases))): (usize, (&SpaceSearches, (&Failure, &ScenarioCases)))| {
            let mut cases = cases.clone();
            cases.scenario = format!("failure {} of {}", rank + 1, space.known.name);
            cases
        };
        drawn.into_iter().take(most).enumerate().map(named).collect()
    }

    /// What each search says.
    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let all = self
            .spaces
            .iter()
            .flat_map(|space| plan.claimants().into_iter().zip(&space.controllers).map(move |pair| (space, pair)));
        let of = |(space, (subject, search)): (&SpaceSearches, (Subject, &FailureSearch))| {
            let strength = match search.total() {
                0 => Strength::of(search.methods.iter().map(|reached| reached.failures).sum(), search.telling()),
                // Nothing but that: no contact was found.
                failures if failures == search.silent().count() => {
                    Strength::from_counts_with_unanswered(0, search.telling(), search.unanswered().as_ref(), true)
                }
                failures => Strength::Found {
                    failures,
                    avoidable: search.count(AvoidabilityClass::Avoidable),
                    because: search.unanswered().map(|silent| silent.because),
                },
            };
            let claim = Claim { subject, property: Property::NoContact, domain: space.domain(plan) };
            Evidence {
                claim,
                strength,
                source: Source::part("search", format!("{} evaluations", search.evaluations())),
            }
        };
        all.map(of).collect()
    }

    /// Every failure that is shown.
    pub(in crate::assessment) fn failures(&self) -> impl Iterator<Item = &Failure> {
        self.spaces.iter().flat_map(|space| &space.controllers).flat_map(|search| &search.failures)
    }
}

impl SpaceSearches {
    /// What was tried of the space, as a domain.
    pub(in crate::assessment) fn domain(&self, plan: &AssessmentPlan) -> Domain {
        let (seed, budget) = (plan.config.seed, plan.config.search.budget);
        Domain::Search { space: self.known.clone(), seed, budget }
    }

    /// Of one controller.
    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&FailureSearch> {
        self.controllers.iter().find(|search| search.controller == controller)
    }

    fn table(&self) -> Table {
        let first = |reached: Option<&MethodResult>| {
            let first = reached.and_then(|reached| reached.first_failure);
            Cell::number(first.map_or("none".to_owned(), |first| first.to_string()))
        };
        Table::of(
            &self.controllers,
            &[
                ("controller", &|search| Cell::text(&search.controller)),
                ("distinct failures", &|search| Cell::judged(search.total(), search.total() == 0)),
                ("avoidable", &|search| Cell::number(search.count(AvoidabilityClass::Avoidable))),
                ("unavoidable", &|search| Cell::number(search.count(AvoidabilityClass::Unavoidable))),
                ("undecided", &|search| Cell::number(search.count(AvoidabilityClass::Undecided))),
                ("severest impact (m/s)", &|search| Cell::optional(search.max_impact_speed_mps())),
                ("first after (runs)", &|search| first(search.methods.first())),
                ("uniform: first after", &|search| first(search.reached(Method::Uniform))),
                ("share failing", &|search| Cell::optional(search.uniform_failure_percent().map(|share| format!("{share} %")))),
                ("Halton: first after", &|search| first(search.reached(Method::Halton))),
            ],
        )
    }
}

impl FailureSearch {
    pub(in crate::assessment) fn gather(
        plan: &AssessmentPlan,
        named: &NamedSpace,
        (index, controller): (usize, &NamedController),
        work: &Work<'_>,
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
        let (summary, texts) = searched(&campaign, (&item, &inputs), MOST_SHOWN, work)?;
        let place = format!("counterexamples/{}/{}", file_stem(space.name()), plan.slug(index));
        let word = controller_arg(&controller.kind);
        let seeing = plan.estimator_args().iter().copied();
        let replay = |file: &str| {
            let simulate = Command::new(["simulate", file, "--controller", word.as_deref()?]).and(seeing.clone());
            Some(simulate.and(["--expect", "collision"]))
        };
        let nominal = space.scenario(&space.nominal())?;
        let is_own = |found: &&Counterexample| is_own([found.front_vehicle, found.rear_vehicle], &nominal);
        let found = summary.counterexamples.iter().zip(texts).filter(|(found, _)| is_own(found));
        let failures: Vec<_> = found.map(|(found, text)| Failure::of(found, &place, text, &replay)).collect();
        let exported = failures.into_par_iter().map(|one| one.exported(controller, plan.config.estimator));
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
        let out = format!("searches/{}/{}", file_stem(space.name()), plan.slug(index));
        let command = word.as_deref().map(|word| {
            let what =
                ["falsify", "--controller", word, "--space", &named.word(), "--budget", &budget, "--seed", &seed];
            Command::new(what).and(["--out", &out]).and(seeing.clone())
        });
        let drawn = if is_drawn(plan, index, controller) { draw(plan, controller, &failures)? } else { Vec::new() };
        Ok(Self {
            controller: controller.name.clone(),
            command,
            methods: summary.methods.iter().map(|method| MethodResult::of(method, &summary, &nominal)).collect(),
            distinct: classes.map(|class| (class, count(class))).into_iter().filter(|(_, n)| *n > 0).collect(),
            failures,
            others: summary.counterexamples.len() - own.len(),
            drawn,
        })
    }

    /// Those of the failures that are shown in which the controller gave no answer.
    fn unanswered_failures(&self) -> impl Iterator<Item = &Failure> {
        self.failures.iter().filter(|failure| failure.because.is_some())
    }

    /// Evaluations in which it gave none, and why.
    fn unanswered(&self) -> Option<Unanswered> {
        let runs = self.methods.iter().map(|reached| reached.unanswered).sum();
        let because = self.silent().find_map(|failure| failure.because.clone());
        (runs > 0).then(|| Unanswered {
            runs,
            because: because.unwrap_or_else(|| "of none of them is it known why".to_owned()),
        })
    }

    /// The same in words.
    pub(in crate::assessment) fn describe_unanswered(&self) -> Option<String> {
        Some(self.unanswered()?.words(self.evaluations()))
    }

    /// Distinct failures of a class.
    #[must_use]
    pub fn count(&self, class: AvoidabilityClass) -> usize {
        self.distinct.iter().filter(|(of, _)| *of == class).map(|(_, count)| count).sum()
    }

    /// All distinct failures.
    #[must_use]
    pub fn distinct_count(&self) -> usize {
        self.distinct.iter().map(|(_, count)| count).sum()
    }

    /// Evaluations of all methods together.
    #[must_use]
    pub fn evaluations(&self) -> u64 {
        self.methods.iter().map(|reached| reached.evaluations).sum()
    }

    /// Those that say something of the controller.
    #[must_use]
    pub fn conclusive_evaluations(&self) -> u64 {
        self.evaluations() - self.methods.iter().map(|reached| reached.others).sum::<u64>()
    }

    /// Share of uniform points that fail, in percent.
    pub(super) fn uniform_failure_percent(&self) -> Option<Rounded<1>> {
        let uniform = self.reached(Method::Uniform)?;
        Some(Rounded::new(100.0 * uniform.failures as f64 / uniform.evaluations.max(1) as f64))
    }

    /// The largest impact speed of all that are shown, in m/s.
    fn max_impact_speed_mps(&self) -> Option<Rounded<1>> {
        largest(self.failures.iter().map(|failure| failure.impact_speed_mps.map(Rounded::value))).map(Rounded::new)
    }

    fn method_result(&self, method: Method) -> Option<&MethodResult> {
        self.methods.iter().find(|reached| reached.method == method.name())
    }

    fn table(&self) -> Table {
        Table::of(
            &self.failures,
            &[
                ("failure", &|failure| Cell::text(failure.short_name())),
                ("what happens", &|failure| Cell::text(failure.words())),
                ("class", &|failure| Cell::text(failure.describe_class())),
                ("delta-v (m/s)", &|failure| Cell::optional(failure.max_delta_v_mps)),
                ("vehicles", &|failure| Cell::number(failure.vehicles)),
                ("rank by likelihood", &|failure| Cell::number(failure.likelihood_rank)),
                ("found by", &|failure| Cell::text(format!("{}, run {}", failure.found_by, failure.found_at))),
                ("what is not nominal", &|failure| Cell::text(failure.changed.join(", "))),
            ],
        )
    }

    fn summary(&self) -> String {
        let avoidable = self.count(AvoidabilityClass::Avoidable);
        match self.total() {
            0 => "no failure found".to_owned(),
            1 => format!("one failure, {}", if avoidable == 1 { "avoidable" } else { "not known to be avoidable" }),
            total => format!("{total} distinct failures, {avoidable} of them avoidable"),
        }
    }

    /// In a sentence or two: how hard was looked, and what random points made of it.
    fn describe_effort(&self) -> String {
        let (Some(main), Some(uniform)) = (self.methods.first(), self.reached(Method::Uniform)) else {
            return String::new();
        };
        let random = match uniform.failures {
            0 => {
                let upper = RateInterval::exact(0, uniform.evaluations, 0.9).upper;
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
        let rest = self.total().saturating_sub(self.failures.len());
        let rest = if rest == 0 { String::new() } else { format!(" {rest} further distinct failures are not listed.") };
        let others = match self.others {
            0 => String::new(),
            others => format!(
                " {} runs ended when vehicles touched that are not under test, in {others} ways: these say nothing of the \
                 controller.",
                self.evaluations() - self.telling()
            ),
        };
        format!("{first}; {random}.{rest}{others}")
    }
}

/// The files of a counterexample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::assessment) struct CounterexampleFiles {
    /// The scenario.
    pub(super) counterexample: String,
    /// The escape from it, where it is avoidable.
    pub(super) escape: Option<String>,
}

/// A campaign's summary, and the files of its severest failures; kept, and gone on with where it was interrupted.
pub(super) fn run_campaign(
    campaign: &Campaign,
    (item, inputs): (&str, &Value),
    most: usize,
    work: &Work<'_>,
) -> Result<(Summary, Vec<CounterexampleFiles>), AssessError> {
    work.get(item, inputs, || {
        let folder = work.store.workplace(item, inputs)?;
        let options = CampaignOptions { resume: campaign.controller.kind.identity().is_some(), ..Default::default() };
        let done = AtomicU64::new(0);
        let summary = campaign.run(folder.path(), options, &|progress: &CampaignProgress| {
            let more = progress.evaluations - done.swap(progress.evaluations, Ordering::Relaxed);
            if work.did(more).is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        })?;
        let shown = summary.counterexamples.iter().take(most);
        let read = |name: &String| read(&folder.path().join(name));
        let texts = shown.map(|found| {
            let escape = found.escape_file.as_ref().map(read).transpose()?;
            Ok::<_, AssessError>(CounterexampleFiles { counterexample: read(&found.file)?, escape })
        });
        let texts = texts.collect::<Result<Vec<_>, _>>()?;
        folder.remove()?;
        Ok((summary, texts))
    })
}

/// Those whose failures are drawn: the first controller and the learned ones.
fn is_drawn(plan: &AssessmentPlan, index: usize, controller: &NamedController) -> bool {
    index == 0 || index == plan.subject || controller.kind.is_learned()
}

fn simulate_failures(
    plan: &AssessmentPlan,
    controller: &NamedController,
    failures: &[Failure],
) -> Result<Vec<ScenarioCases>, AssessError> {
    let mut drawn = Vec::new();
    for failure in failures.iter().take(MOST_DRAWN) {
        // What a campaign wrote and read back can be read again.
        let Ok(scenario) = file::from_toml(&failure.text, Path::new(&failure.file)) else { continue };
        // Unique on the page, with the controller's: names of scenarios are those of spaces.
        let named = scenario.edited(|spec| spec.name = format!("{} {}", spec.name, failure.short_name()))?;
        let one = std::slice::from_ref(controller);
        let cases = run_cases(&[&named], one, plan.config.estimator, Motion::Kept)?;
        let replay = Command::new(["simulate", failure.file.as_str()]).and(plan.estimator_args().iter().copied());
        drawn.extend(cases.into_iter().map(|cases| ScenarioCases::new(&named, replay.clone(), cases)));
    }
    Ok(drawn)
}

fn read_file(path: &Path) -> Result<String, AssessError> {
    Ok(std::fs::read_to_string(path).map_err(DiskError::at(path)).map_err(StoreError::from)?)
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
    fn write(&self, out: &mut Document) {
        out.html(html! {
            details {
                summary { (self.controller) ": " (self.summary()) }
                p { (prose(&self.effort())) }
                @if !self.failures.is_empty() {
                    (self.table().html())
                    ul { @for command in self.failures.iter().flat_map(Failure::commands) { li { code { (command) } } } }
                }
                @if let Some(command) = &self.command { p { "Search again: " code { (command) } } }
                @if !self.drawn.is_empty() {
                    details {
                        summary { "the severest, drawn" }
                        @for (rank, cases) in self.drawn.iter().enumerate() {
                            @for case in &cases.cases {
                                figure { (cases.figure(case)) }
                                @if rank == 0 { figure { (cases.animation(case)) } }
                            }
                        }
                    }
                }
            }
        });
        let with_command = |words: Inline, before: &str, command: &Option<Command>| match command {
            Some(command) => words.and(before).and_code(command),
            None => words,
        };
        let words = Inline::prose(&format!("{}: {}", self.controller, self.effort()));
        out.markdown().paragraph(with_command(words, " Search again: ", &self.command));
        out.markdown().list(self.failures.iter().map(|failure| {
            let (words, class) = (failure.words(), failure.describe_class());
            let words = Inline::prose(&format!("{words}, {class}, rank {} by likelihood", failure.likelihood_rank));
            with_command(words, ": ", &failure.replay)
        }));
    }
}

impl Part for FailureSearches {
    fn heading(&self) -> (&'static str, String) {
        ("search", "Failure search".to_owned())
    }

    fn write(&self, out: &mut Document) {
        out.paragraph(&format!("{INTRODUCTION} {WHERE}"));
        for space in &self.spaces {
            out.heading(&format!("Space {}", space.name));
            out.paragraph(&space.about);
            out.table(&space.table());
            space.controllers.iter().for_each(|search| search.write(out));
        }
    }
}
