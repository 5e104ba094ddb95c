//! The failure search of one controller in one scenario space.

use serde::Serialize;
use serde_json::json;

use super::ScenarioCases;
use super::distinct_failure::{DistinctFailure, MethodResult, involves_vehicle_under_test};
use super::search_campaign::{CounterexampleFiles, run_campaign, simulate_failures};
use crate::assessment::case::largest;
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::rich_text::RichText;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, Rounded};
use crumple_evidence::RateInterval;
use crumple_search::confirmation::ReplayShare;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignSummary};
use crumple_search::falsify::counterexample::{AvoidabilityClass, Counterexample};
use crumple_sim::engine::{FailedControllerRuns, NamedController};
use crumple_sim::scenario::Scenario;

/// Maximum number of shown failures of one search; a campaign of a few hundred runs finds fewer.
const MAX_SHOWN: usize = 100;

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
    pub collisions_of_others: usize,
    #[serde(skip)]
    pub(super) drawn_cases: Vec<ScenarioCases>,
}

/// A search of a plan: one controller in one scenario space.
struct PlannedSearch<'a> {
    plan: &'a AssessmentPlan,
    named: &'a NamedSpace,
    /// Index of the controller in the plan.
    index: usize,
    controller: &'a NamedController,
}

impl PlannedSearch<'_> {
    fn campaign(&self) -> Campaign {
        let config = &self.plan.config;
        Campaign {
            estimator: config.estimator,
            seed: config.seed,
            ..Campaign::new(self.controller.clone(), self.named.space.clone())
                .with_budget(config.search.budget)
        }
    }

    fn run(
        &self,
        work: &GatherContext<'_>,
    ) -> Result<(CampaignSummary, Vec<CounterexampleFiles>), AssessError> {
        let campaign = self.campaign();
        let item = format!(
            "search {} in {}",
            self.controller.name,
            self.named.space.name()
        );
        let inputs = json!([
            self.plan.identity(self.controller),
            self.named.text,
            campaign.search.budget,
            campaign.seed
        ]);
        run_campaign(&campaign, (&item, &inputs), MAX_SHOWN, work)
    }

    /// Returns the folder of the search below `root`.
    fn folder(&self, root: &str) -> String {
        let space = file_stem(self.named.space.name());
        format!("{root}/{space}/{}", self.plan.controller_slug(self.index))
    }

    /// Returns the failures of the controller, each with its file and its commands.
    fn failures(
        &self,
        summary: &CampaignSummary,
        texts: Vec<CounterexampleFiles>,
        nominal: &Scenario,
    ) -> Vec<DistinctFailure> {
        let folder = self.folder("counterexamples");
        summary
            .counterexamples
            .iter()
            .zip(texts)
            .filter(|(counterexample, _)| is_own_failure(counterexample, nominal))
            .map(|(counterexample, texts)| {
                DistinctFailure::from_counterexample(
                    counterexample,
                    &folder,
                    texts,
                    &|file, expected| self.replay_command(file, expected),
                )
            })
            .collect()
    }

    /// Returns the command that simulates a failure, and expects it; `None` for an external controller.
    fn replay_command(&self, file: &str, expected: &str) -> Option<CrumpleCommand> {
        let controller = controller_arg(&*self.controller.source)?;
        let simulate = CrumpleCommand::new(["simulate", file, "--controller", controller.as_str()])
            .with_args(self.plan.estimator_args().iter().copied());
        Some(simulate.with_args(["--expect", expected]))
    }

    /// Returns the command that repeats the search; `None` for an external controller.
    fn command(&self) -> Option<CrumpleCommand> {
        let controller = controller_arg(&*self.controller.source)?;
        let config = &self.plan.config;
        let falsify = CrumpleCommand::new(["falsify", "--controller", controller.as_str()])
            .with_args(["--space".to_owned(), self.named.to_arg()])
            .with_args(["--budget".to_owned(), config.search.budget.to_string()])
            .with_args(["--seed".to_owned(), config.seed.to_string()])
            .with_args(["--out".to_owned(), self.folder("searches")])
            .with_args(self.plan.estimator_args().iter().copied());
        Some(falsify)
    }

    /// True for the first controller, the subject and the learned ones.
    fn is_main(&self) -> bool {
        self.index == 0
            || self.index == self.plan.subject_index
            || self.controller.source.is_learned()
    }
}

/// True if a vehicle under test collides.
fn is_own_failure(counterexample: &Counterexample, nominal: &Scenario) -> bool {
    let vehicles = [counterexample.front_vehicle, counterexample.rear_vehicle];
    involves_vehicle_under_test(vehicles, nominal)
}

/// Counts failures by their class, without empty classes.
fn count_classes(failures: &[&Counterexample]) -> Vec<(AvoidabilityClass, usize)> {
    let classes = [
        AvoidabilityClass::Avoidable,
        AvoidabilityClass::Unavoidable,
        AvoidabilityClass::Undecided,
        AvoidabilityClass::NotAsked,
    ];
    let counts = classes.map(|class| {
        let members = failures
            .iter()
            .filter(|failure| failure.avoidability.class() == class);
        (class, members.count())
    });
    counts.into_iter().filter(|(_, count)| *count > 0).collect()
}

impl FailureSearch {
    pub(in crate::assessment) fn gather(
        named: &NamedSpace,
        (index, controller): (usize, &NamedController),
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let plan = work.plan;
        let search = PlannedSearch {
            plan,
            named,
            index,
            controller,
        };
        let (summary, texts) = search.run(work)?;
        let nominal = named.space.scenario(&named.space.nominal())?;
        let failures = search.failures(&summary, texts, &nominal);
        let counterexamples = summary.counterexamples.iter();
        let own: Vec<_> = counterexamples
            .filter(|counterexample| is_own_failure(counterexample, &nominal))
            .collect();
        let methods = summary.methods.iter();
        let drawn_cases = match search.is_main() {
            true => simulate_failures(plan, controller, &failures)?,
            false => Vec::new(),
        };
        Ok(Self {
            controller: controller.name.clone(),
            command: search.command(),
            methods: methods
                .map(|method| MethodResult::new(method, &summary, &nominal))
                .collect(),
            distinct: count_classes(&own),
            failures,
            collisions_of_others: summary.counterexamples.len() - own.len(),
            drawn_cases,
        })
    }

    pub(super) fn unanswered_failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.failures
            .iter()
            .filter(|failure| failure.reason.is_some())
    }

    pub(super) fn unanswered(&self) -> Option<FailedControllerRuns> {
        let runs = self.methods.iter().map(|method| method.unanswered).sum();
        let reason = self
            .unanswered_failures()
            .find_map(|failure| failure.reason.clone());
        let reason = reason.unwrap_or_else(|| "the reason is unknown".to_owned());
        (runs > 0).then_some(FailedControllerRuns { runs, reason })
    }

    pub(in crate::assessment) fn describe_unanswered(&self) -> Option<String> {
        Some(self.unanswered()?.describe(self.evaluations()))
    }

    /// Returns the number of distinct failures of a class.
    #[must_use]
    pub fn count(&self, class: AvoidabilityClass) -> usize {
        self.distinct
            .iter()
            .filter(|(other, _)| *other == class)
            .map(|(_, count)| count)
            .sum()
    }

    /// Returns the number of all distinct failures.
    #[must_use]
    pub fn distinct_count(&self) -> usize {
        self.distinct.iter().map(|(_, count)| count).sum()
    }

    /// Returns the number of simulations of all methods.
    #[must_use]
    pub fn evaluations(&self) -> u64 {
        self.methods.iter().map(|method| method.evaluations).sum()
    }

    /// Returns the number of simulations that are evidence about the controller.
    #[must_use]
    pub fn conclusive_evaluations(&self) -> u64 {
        self.evaluations()
            - self
                .methods
                .iter()
                .map(|method| method.collisions_of_others)
                .sum::<u64>()
    }

    /// Returns the share of listed failures for which a replay with the multi-body plant has a result.
    pub(super) fn multi_body_share(
        &self,
        result: fn(&DistinctFailure) -> Option<bool>,
    ) -> Option<ReplayShare> {
        ReplayShare::from_results(self.failures.iter().filter_map(result))
    }

    pub(super) fn max_impact_speed_mps(&self) -> Option<Rounded<1>> {
        largest(
            self.failures
                .iter()
                .map(|failure| failure.impact_speed_mps.map(Rounded::value)),
        )
        .map(Rounded::new)
    }

    pub(super) fn method_result(&self, method: Method) -> Option<&MethodResult> {
        self.methods
            .iter()
            .find(|result| result.method == method.name())
    }

    pub(super) fn table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.failures,
            &[
                ("failure", &|failure| ReportCell::text(failure.short_name())),
                ("what happens", &|failure| {
                    ReportCell::text(failure.describe())
                }),
                ("impact (m/s)", &|failure| {
                    ReportCell::optional(failure.impact_speed_mps)
                }),
                ("time (s)", &|failure| {
                    ReportCell::optional(failure.collision_time_s)
                }),
                ("gap of the escape (m)", &|failure| {
                    ReportCell::text(failure.describe_escape())
                }),
                ("multi-body", &|failure| {
                    ReportCell::text(failure.describe_multi_body())
                }),
                ("delta-v (m/s)", &|failure| {
                    ReportCell::optional(failure.max_delta_v_mps)
                }),
                ("vehicles", &|failure| ReportCell::number(failure.vehicles)),
                ("rank by likelihood", &|failure| {
                    ReportCell::number(failure.likelihood_rank)
                }),
                ("found by", &|failure| {
                    ReportCell::text(format!("{}, run {}", failure.found_by, failure.found_at))
                }),
                ("changed from nominal", &|failure| {
                    ReportCell::text(failure.changed.join(", "))
                }),
            ],
        )
    }

    pub(super) fn summary(&self) -> String {
        let avoidable = self.count(AvoidabilityClass::Avoidable);
        match self.distinct_count() {
            0 => "no failure found".to_owned(),
            1 => format!("one distinct failure, {avoidable} avoidable"),
            total => format!("{total} distinct failures, {avoidable} avoidable"),
        }
    }

    /// Returns the share of failing uniform points in percent; if there are none, with its upper bound at 95 %.
    pub(super) fn format_uniform_share(&self) -> Option<String> {
        let &MethodResult {
            failures,
            evaluations,
            ..
        } = self.method_result(Method::Uniform)?;
        let share = Rounded::<1>::new(100.0 * failures as f64 / evaluations.max(1) as f64);
        let bound =
            || Rounded::<2>::up(100.0 * RateInterval::clopper_pearson(0, evaluations, 0.9).upper);
        Some(if failures == 0 {
            format!("{share} (< {})", bound())
        } else {
            share.to_string()
        })
    }

    pub(super) fn describe_others(&self) -> Option<String> {
        let runs = self.evaluations() - self.conclusive_evaluations();
        (self.collisions_of_others > 0).then(|| {
            format!(
                "{runs} runs ended with {} distinct collisions of other vehicles, which are no evidence about the \
                 controller.",
                self.collisions_of_others
            )
        })
    }
}

impl FailureSearch {
    /// Writes all listed failures, folded behind a summary.
    pub(super) fn write_details(&self, out: &mut ReportDocument) {
        let mut details = ReportDocument::new();
        let unlisted = self.distinct_count().saturating_sub(self.failures.len());
        if unlisted > 0 {
            details.paragraph(format!(
                "{unlisted} further distinct failures are not listed."
            ));
        }
        if let Some(others) = self.describe_others() {
            details.paragraph(others);
        }
        if !self.failures.is_empty() {
            details.table(self.table());
            let commands = self.failures.iter().flat_map(DistinctFailure::commands);
            details.list(commands.map(RichText::code));
        }
        if let Some(command) = &self.command {
            details.paragraph(RichText::from("Search again: ").and_code(command));
        }
        if !self.drawn_cases.is_empty() {
            details.collapsible("figures of the severest failures", self.figures());
        }
        out.collapsible(format!("{}: {}", self.controller, self.summary()), details);
    }

    fn figures(&self) -> ReportDocument {
        let mut figures = ReportDocument::new();
        for cases in &self.drawn_cases {
            for case in &cases.cases {
                figures.figure(cases.figure(case));
            }
        }
        figures
    }
}
