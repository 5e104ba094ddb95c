//! The failure search of one controller in one scenario space.

use maud::html;
use serde::Serialize;
use serde_json::json;

use super::ScenarioCases;
use super::distinct_failure::{DistinctFailure, MethodResult, involves_vehicle_under_test};
use super::search_campaign::{run_campaign, simulate_failures};
use crate::assessment::case::largest;
use crate::assessment::controller_arg::controller_arg;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::{NamedSpace, file_stem};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CrumpleCommand, Rounded};
use crumple_evidence::RateInterval;
use crumple_search::confirmation::ReplayShare;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::Campaign;
use crumple_search::falsify::counterexample::{AvoidabilityClass, Counterexample};
use crumple_sim::engine::{FailedControllerRuns, NamedController};

/// Maximum number of shown failures of one search; a campaign of a few hundred runs finds fewer.
const MAX_SHOWN: usize = 100;
/// Maximum number of failures that Markdown lists for a controller that is not a main one.
const MAX_LISTED: usize = 3;

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
    pub(super) drawn_cases: Vec<ScenarioCases>,
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
            seed: plan.config.seed,
            ..Campaign::new(controller.clone(), space.clone())
                .with_budget(plan.config.search.budget)
        };
        let item = format!("search {} in {}", controller.name, space.name());
        let inputs = json!([
            plan.identity(controller),
            named.text,
            campaign.search.budget,
            campaign.seed
        ]);
        let (summary, texts) = run_campaign(&campaign, (&item, &inputs), MAX_SHOWN, work)?;
        let place = format!(
            "counterexamples/{}/{}",
            file_stem(space.name()),
            plan.controller_slug(index)
        );
        let word = controller_arg(&*controller.source);
        let seeing = plan.estimator_args().iter().copied();
        let replay = |file: &str| {
            let simulate =
                CrumpleCommand::new(["simulate", file, "--controller", word.as_deref()?])
                    .with_args(seeing.clone());
            Some(simulate.with_args(["--expect", "collision"]))
        };
        let nominal = space.scenario(&space.nominal())?;
        let is_own = |found: &&Counterexample| {
            involves_vehicle_under_test([found.front_vehicle, found.rear_vehicle], &nominal)
        };
        let found = summary
            .counterexamples
            .iter()
            .zip(texts)
            .filter(|(found, _)| is_own(found));
        let failures: Vec<_> = found
            .map(|(found, text)| DistinctFailure::from_counterexample(found, &place, text, &replay))
            .collect();
        let classes = [
            AvoidabilityClass::Avoidable,
            AvoidabilityClass::Unavoidable,
            AvoidabilityClass::Undecided,
            AvoidabilityClass::NotAsked,
        ];
        let own: Vec<_> = summary.counterexamples.iter().filter(is_own).collect();
        let count = |class| {
            own.iter()
                .filter(|one| one.avoidability.class() == class)
                .count()
        };
        let [budget, seed] =
            [campaign.search.budget, campaign.seed].map(|number| number.to_string());
        let out = format!(
            "searches/{}/{}",
            file_stem(space.name()),
            plan.controller_slug(index)
        );
        let command = word.as_deref().map(|word| {
            let what = [
                "falsify",
                "--controller",
                word,
                "--space",
                &named.to_arg(),
                "--budget",
                &budget,
                "--seed",
                &seed,
            ];
            CrumpleCommand::new(what)
                .with_args(["--out", &out])
                .with_args(seeing.clone())
        });
        let is_main = is_main_controller(plan, index, controller);
        let drawn_cases = if is_main {
            simulate_failures(plan, controller, &failures)?
        } else {
            Vec::new()
        };
        Ok(Self {
            controller: controller.name.clone(),
            command,
            methods: summary
                .methods
                .iter()
                .map(|method| MethodResult::new(method, &summary, &nominal))
                .collect(),
            distinct: classes
                .map(|class| (class, count(class)))
                .into_iter()
                .filter(|(_, n)| *n > 0)
                .collect(),
            failures,
            collisions_of_others: summary.counterexamples.len() - own.len(),
            is_main,
            drawn_cases,
        })
    }

    pub(super) fn unanswered_failures(&self) -> impl Iterator<Item = &DistinctFailure> {
        self.failures
            .iter()
            .filter(|failure| failure.reason.is_some())
    }

    pub(super) fn unanswered(&self) -> Option<FailedControllerRuns> {
        let runs = self.methods.iter().map(|reached| reached.unanswered).sum();
        let reason = self
            .unanswered_failures()
            .find_map(|failure| failure.reason.clone());
        let because = reason.unwrap_or_else(|| "the reason is unknown".to_owned());
        (runs > 0).then_some(FailedControllerRuns { runs, because })
    }

    pub(in crate::assessment) fn describe_unanswered(&self) -> Option<String> {
        Some(self.unanswered()?.describe(self.evaluations()))
    }

    /// Returns the number of distinct failures of a class.
    #[must_use]
    pub fn count(&self, class: AvoidabilityClass) -> usize {
        self.distinct
            .iter()
            .filter(|(of, _)| *of == class)
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
        self.methods.iter().map(|reached| reached.evaluations).sum()
    }

    /// Returns the number of simulations that are evidence about the controller.
    #[must_use]
    pub fn conclusive_evaluations(&self) -> u64 {
        self.evaluations()
            - self
                .methods
                .iter()
                .map(|reached| reached.collisions_of_others)
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
            .find(|reached| reached.method == method.name())
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
                    ReportCell::optional(failure.contact_time_s)
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

    /// Returns the failures that Markdown lists.
    pub(super) fn listed(&self) -> &[DistinctFailure] {
        let most = if self.is_main {
            self.failures.len()
        } else {
            self.failures.len().min(MAX_LISTED)
        };
        self.failures.get(..most).unwrap_or_default()
    }
}

fn is_main_controller(plan: &AssessmentPlan, index: usize, controller: &NamedController) -> bool {
    index == 0 || index == plan.subject_index || controller.source.is_learned()
}

impl FailureSearch {
    pub(super) fn write(&self, out: &mut ReportDocument) {
        out.push_html(html! {
            details {
                summary { (self.controller) ": " (self.summary()) }
                @let unlisted = self.distinct_count().saturating_sub(self.failures.len());
                @if unlisted > 0 { p { (unlisted) " further distinct failures are not listed." } }
                @if let Some(others) = self.describe_others() { p { (others) } }
                @if !self.failures.is_empty() {
                    (self.table().to_html())
                    @let commands = self.failures.iter().flat_map(DistinctFailure::commands);
                    ul { @for command in commands { li { code { (command) } } } }
                }
                @if let Some(command) = &self.command { p { "Search again: " code { (command) } } }
                @if !self.drawn_cases.is_empty() {
                    details {
                        summary { "figures of the severest failures" }
                        @for cases in &self.drawn_cases {
                            @for case in &cases.cases { figure { (cases.figure(case)) } }
                        }
                    }
                }
            }
        });
    }
}
