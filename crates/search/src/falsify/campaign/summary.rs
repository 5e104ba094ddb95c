//! Summary of a campaign, for programs and for readers.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::run::MAX_EXAMINED_KINDS;
use super::{CampaignError, SearchObjective};
use crate::StudySubject;
use crate::confirmation::ReplayShare;
use crate::falsify::FailureCriterionRecord;
use crate::falsify::counterexample::{AvoidabilityClass, Counterexample, name_braking_ego};
use crumple_core::digits::format_or_hyphen;
use crumple_core::non_finite;
use crumple_core::quoting::TerminalText;
use crumple_measure::Specification;
use crumple_sim::engine::FailedControllerRuns;

pub(super) const SUMMARY_VERSION: u32 = 1;

/// Results of a campaign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CampaignSummary {
    /// Version of the format: 1.
    pub version: u32,
    /// SHA-256 of `campaign.toml`.
    pub configuration_sha256: String,
    /// Controller, estimator, space, specification and seed.
    #[serde(flatten)]
    pub subject: StudySubject,
    /// Additional condition for a failure to count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "contrast")]
    pub failure_criterion: Option<FailureCriterionRecord>,
    /// Requested method.
    pub method: String,
    /// Objective of the search after the first failure.
    #[serde(default = "default_objective")]
    #[serde(alias = "aim")]
    pub objective: String,
    /// Evaluations of each method.
    pub budget: u64,
    /// Evaluations of the requested method.
    pub evaluations: u64,
    /// True if any method found a failure.
    pub falsified: bool,
    /// Number of the first failing evaluation of the requested method, from 1.
    pub first_falsification: Option<u64>,
    /// Smallest robustness that the requested method found.
    #[serde(with = "non_finite::optional")]
    pub best_robustness: Option<f64>,
    /// Distinct failures, the severest first.
    pub counterexamples: Vec<Counterexample>,
    /// Number of avoidable distinct failures; `None` if they were not classified.
    #[serde(default)]
    pub avoidability: Option<AvoidabilitySummary>,
    /// Results of the replays with the multi-body plant.
    #[serde(default)]
    pub multi_body: ConfirmationSummary,
    /// Results of each method: the requested one, then the reference searches.
    pub methods: Vec<MethodSummary>,
    /// Kinds of failures, the most frequent first.
    pub failures: Vec<FailureKindSummary>,
}

fn default_objective() -> String {
    SearchObjective::default().name().to_owned()
}

/// Numbers of distinct failures by avoidability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AvoidabilitySummary {
    /// Number of failures with an escape.
    pub avoidable: usize,
    /// Number of failures with a proof that there is none.
    pub unavoidable: usize,
    /// Number of failures with neither.
    pub undecided: usize,
    /// Share of avoidable failures among all three.
    pub avoidable_percent: f64,
}

impl AvoidabilitySummary {
    /// Counts the classes of distinct failures; `None` if none was classified.
    #[must_use]
    pub fn from_counterexamples(counterexamples: &[Counterexample]) -> Option<Self> {
        let [avoidable, unavoidable, undecided] = [
            AvoidabilityClass::Avoidable,
            AvoidabilityClass::Unavoidable,
            AvoidabilityClass::Undecided,
        ]
        .map(|class| {
            counterexamples
                .iter()
                .filter(|counterexample| counterexample.avoidability.class() == class)
                .count()
        });
        let all = avoidable + unavoidable + undecided;
        let avoidable_percent = 100.0 * avoidable as f64 / all as f64;
        (all > 0).then_some(Self {
            avoidable,
            unavoidable,
            undecided,
            avoidable_percent,
        })
    }
}

/// Shares of distinct failures and escapes that survive a replay with the multi-body plant.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ConfirmationSummary {
    /// Share of failures that fail again; `None` without a replay.
    pub failures: Option<ReplayShare>,
    /// Share of escapes without a collision; `None` without an escape.
    pub escapes: Option<ReplayShare>,
}

impl ConfirmationSummary {
    /// Counts the replays of distinct failures.
    #[must_use]
    pub fn from_counterexamples(counterexamples: &[Counterexample]) -> Self {
        let survivals = counterexamples
            .iter()
            .filter_map(|counterexample| counterexample.survives_multi_body);
        let escape_survivals = counterexamples
            .iter()
            .filter_map(|counterexample| counterexample.escape_survives_multi_body);
        Self {
            failures: ReplayShare::from_results(survivals),
            escapes: ReplayShare::from_results(escape_survivals),
        }
    }

    /// Describes each share that is present. A search selects its failures, so the interval of a share means nothing
    /// to a reader who does not know how.
    pub fn describe(&self) -> impl Iterator<Item = String> {
        let shares = [
            (self.failures, "failures fail, too"),
            (self.escapes, "escapes have no collision"),
        ];
        shares.into_iter().filter_map(|(share, what)| {
            let ReplayShare { count, replays, .. } = share?;
            Some(format!("{count} of {replays} {what}"))
        })
    }
}

/// Results of a method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodSummary {
    /// Name of the method.
    pub method: String,
    /// Number of evaluations.
    pub evaluations: u64,
    /// Number of its first failing evaluation, from 1.
    pub first_falsification: Option<u64>,
    /// Number of failing evaluations.
    pub failures: u64,
    /// Smallest robustness.
    #[serde(with = "non_finite::optional")]
    pub best_robustness: Option<f64>,
    /// Evaluations whose partner simulation gave no answer; they do not count as failures.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        alias = "other_unanswered"
    )]
    pub second_missing_answers: Option<FailedControllerRuns>,
}

/// Failures of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailureKindSummary {
    /// Description of the kind.
    pub kind: String,
    /// Time and reason of the controller's failure in the severest examined case; only for a controller failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(alias = "because")]
    pub reason: Option<String>,
    /// Index of the vehicle whose controller gave no answer; `None` for other kinds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed_vehicle: Option<u32>,
    /// Index of the vehicle that is hit; `None` without a collision.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub front_vehicle: Option<u32>,
    /// Index of the vehicle that hits it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rear_vehicle: Option<u32>,
    /// Number of failures.
    pub count: u64,
    /// Number of failures by method.
    pub by_method: Vec<FailuresByMethod>,
}

/// Failures of one kind found by one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailuresByMethod {
    /// Name of the method.
    pub method: String,
    /// Number of failures.
    pub count: u64,
    /// Number of its first failing evaluation, from 1.
    pub first: u64,
}

/// Report of a campaign, for programs. Some fields of the summary refer to the requested method and some to all
/// methods; the two additional fields distinguish them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CampaignReport<'a> {
    /// Summary of the campaign.
    #[serde(flatten)]
    pub summary: &'a CampaignSummary,
    /// Results of the requested method.
    pub requested_method: Option<&'a MethodSummary>,
    /// Results of all methods.
    pub all_methods: AllMethodsSummary,
}

/// Joint results of the requested method and the reference searches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AllMethodsSummary {
    /// Number of methods.
    pub methods: usize,
    /// Number of evaluations.
    pub evaluations: u64,
    /// Number of failing evaluations.
    pub failures: u64,
    /// True if any method found a failure.
    pub falsified: bool,
    /// Failures after de-duplication, as listed in `counterexamples`.
    pub distinct_failures: usize,
    /// Smallest robustness.
    #[serde(serialize_with = "non_finite::optional::serialize")]
    pub best_robustness: Option<f64>,
}

impl<'a> CampaignReport<'a> {
    /// Creates the report of a campaign.
    #[must_use]
    pub fn new(summary: &'a CampaignSummary) -> Self {
        Self {
            summary,
            requested_method: summary.methods.first(),
            all_methods: AllMethodsSummary::new(summary),
        }
    }
}

impl AllMethodsSummary {
    fn new(summary: &CampaignSummary) -> Self {
        let methods = &summary.methods;
        let best_robustness = methods
            .iter()
            .filter_map(|method| method.best_robustness)
            .reduce(f64::min);
        Self {
            methods: methods.len(),
            evaluations: methods.iter().map(|method| method.evaluations).sum(),
            failures: methods.iter().map(|method| method.failures).sum(),
            falsified: summary.falsified,
            distinct_failures: summary.counterexamples.len(),
            best_robustness,
        }
    }
}

impl CampaignSummary {
    /// Returns the text of `summary.json`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] in principle, if the writer fails.
    pub fn to_json(&self) -> Result<String, CampaignError> {
        Ok(serde_json::to_string_pretty(self).map_err(CampaignError::from_encoding_error)? + "\n")
    }

    /// Reads `summary.json`.
    ///
    /// # Errors
    /// [`CampaignError::Encoding`] for any other content.
    pub fn from_json(text: &str) -> Result<Self, CampaignError> {
        serde_json::from_str(text).map_err(CampaignError::from_encoding_error)
    }

    /// Returns the summary for a reader.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        self.write_subject(out)?;
        if self.falsified {
            self.write_falsification(out)?;
        } else {
            writeln!(
                out,
                "  no failure found; this does not prove that none exists"
            )?;
        }
        self.write_methods(out)?;
        self.write_unanswered(out)?;
        self.write_failure_kinds(out)?;
        self.write_counterexamples(out)
    }

    /// Writes what the search looked for, and in which space.
    fn write_subject(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "{} in `{}`: specification `{}`, estimator {}, seed {}",
            TerminalText(&self.subject.controller),
            TerminalText(&self.subject.space),
            TerminalText(&self.subject.specification),
            self.subject.estimator.name(),
            self.subject.seed
        )?;
        if self.objective != SearchObjective::default().name() {
            writeln!(out, "  objective of the search: {}", self.objective)?;
        }
        if let Some(criterion) = &self.failure_criterion {
            writeln!(
                out,
                "  the search counts only failures {}",
                TerminalText(&criterion.describe())
            )?;
        }
        if self.subject.nondeterministic {
            writeln!(
                out,
                "  the controller declares that it is not deterministic: the same campaign may have other results"
            )?;
        }
        Ok(())
    }

    /// Writes how many distinct failures there are, how many are avoidable, and how many survive with another plant.
    fn write_falsification(&self, out: &mut String) -> std::fmt::Result {
        let count = self.counterexamples.len();
        let failures = if count == 1 { "failure" } else { "failures" };
        let kinds = if self.failures.len() > MAX_EXAMINED_KINDS {
            format!("each of the {MAX_EXAMINED_KINDS} most frequent kinds")
        } else {
            "each kind".to_owned()
        };
        writeln!(
            out,
            "  FALSIFIED: {count} distinct {failures}, among the severest, likeliest and first failure of {kinds}"
        )?;
        if let Some(AvoidabilitySummary {
            avoidable,
            unavoidable,
            undecided,
            avoidable_percent,
        }) = self.avoidability
        {
            let unanswered = self.describe_unanalysed();
            writeln!(
                out,
                "  {avoidable} of them ({avoidable_percent:.0} %) avoidable, {unavoidable} unavoidable, \
                 {undecided} undecided{unanswered}"
            )?;
        }
        self.multi_body
            .describe()
            .try_for_each(|share| writeln!(out, "  with the multi-body plant, {share}"))
    }

    /// Describes the counterexamples whose controller gave no answer; empty without any.
    fn describe_unanalysed(&self) -> String {
        let unanswered = self
            .counterexamples
            .iter()
            .filter(|counterexample| counterexample.reason.is_some());
        match unanswered.count() {
            0 => String::new(),
            count => format!("; {count} not analysed, because the controller gave no answer"),
        }
    }

    fn write_methods(&self, out: &mut String) -> std::fmt::Result {
        writeln!(
            out,
            "\n  {:<14} {:>11} {:>14} {:>9} {:>17}",
            "method", "evaluations", "first failure", "failures", "lowest robustness"
        )?;
        for (index, method) in self.methods.iter().enumerate() {
            let first = method
                .first_falsification
                .map_or("-".to_owned(), |first| first.to_string());
            let lowest = format_or_hyphen(method.best_robustness, 3);
            let note = if index > 0 {
                "  (reference search)"
            } else {
                ""
            };
            writeln!(
                out,
                "  {:<14} {:>11} {first:>14} {:>9} {lowest:>17}{note}",
                method.method, method.evaluations, method.failures
            )?;
        }
        if self.goes_by_collisions() && self.failure_criterion.is_none() {
            writeln!(
                out,
                "  robustness: smallest gap in m; after a collision, the negative impact speed in m/s"
            )?;
        }
        Ok(())
    }

    /// Writes how many evaluations of a differential search have no answer of the second controller.
    fn write_unanswered(&self, out: &mut String) -> std::fmt::Result {
        let Some(FailureCriterionRecord::Differential { controller, .. }) = &self.failure_criterion
        else {
            return Ok(());
        };
        for method in &self.methods {
            if let Some(unanswered) = &method.second_missing_answers {
                writeln!(
                    out,
                    "  NOT COMPARED: `{}` {} ({}); these do not count as failures",
                    TerminalText(controller),
                    unanswered.describe(method.evaluations),
                    method.method
                )?;
            }
        }
        Ok(())
    }

    fn write_failure_kinds(&self, out: &mut String) -> std::fmt::Result {
        if self.failures.is_empty() {
            return Ok(());
        }
        writeln!(
            out,
            "\n  kinds of failures, and the evaluation at which each method found them first"
        )?;
        for kind in &self.failures {
            let firsts: Vec<_> = kind
                .by_method
                .iter()
                .map(|by| format!("{} {}", by.method, by.first))
                .collect();
            writeln!(
                out,
                "  {:>9} x  {}  [{}]",
                kind.count,
                name_braking_ego(&kind.kind),
                firsts.join(", ")
            )?;
            if let Some(reason) = &kind.reason {
                writeln!(out, "               {reason}")?;
            }
        }
        Ok(())
    }

    fn write_counterexamples(&self, out: &mut String) -> std::fmt::Result {
        if self.counterexamples.is_empty() {
            return Ok(());
        }
        let shows_specification = !self.goes_by_collisions();
        let order = match shows_specification {
            true => "violation of the specification",
            false => "impact speed of the first collision",
        };
        writeln!(
            out,
            "\n  distinct failures, each made simpler (it may be milder than before), by {order} \
             (likelihood rank 1: the likeliest)"
        )?;
        let count = self.counterexamples.len();
        for counterexample in &self.counterexamples {
            counterexample.write(out, shows_specification, count)?;
        }
        Ok(())
    }

    fn goes_by_collisions(&self) -> bool {
        self.subject.specification.parse() == Ok(Specification::NoCollision)
    }
}
