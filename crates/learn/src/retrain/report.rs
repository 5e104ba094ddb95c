//! Report of a retraining as JSON, Markdown and SVG.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::acceptance::{FailureChange, TRAFFIC_MEASURES, discordant_pairs, to_thousandths, traffic_measures};
use super::files::{
    POLICY, REPORT_JSON, REPORT_MARKDOWN, REPORT_SVG, SELECTION_SET, TEST_SET, TRAINING_CASES, VALIDATION_SET, to_json,
};
use super::plan::{RETRAIN_VERSION, RetrainingPlan, RetrainingSettings};
use super::regression_spaces::SIGNIFICANCE;
use super::round::Round;
use super::search::RoundFindings;
use super::test_set::{CONFIDENCE, ControllerTally, PairedOutcomes, TestSetResults};
use super::{RegressionResults, RetrainError};
use crumple_core::digest::sha256;
use crumple_core::quoting::{MarkdownCode, MarkdownText};
use crumple_store::run_folder::RunFolder;

/// Returns the present name of a preset: files keep the name `harden` of the preset `retrain`.
fn preset_name(name: &str) -> &str {
    if name == "harden" { "retrain" } else { name }
}

/// Reason why a retraining ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum RetrainingEnding {
    /// All rounds are done.
    #[serde(rename = "rounds-spent")]
    RoundsExhausted,
    /// A search found no avoidable counterexample.
    NothingFound {
        /// Results of that search.
        search: Box<RoundFindings>,
    },
}

/// A file and its hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileHash {
    /// Name in the folder.
    pub file: String,
    /// SHA-256.
    pub sha256: String,
}

/// The file `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetrainingReport {
    /// Version of the format: 1.
    pub version: u32,
    /// Version of crumple.
    pub crumple: String,
    /// SHA-256 of `retrain.toml`.
    pub plan_sha256: String,
    /// Name or path of the initial policy.
    pub first: String,
    /// SHA-256 of the initial policy.
    pub first_sha256: String,
    /// SHA-256 of the final policy.
    pub retrained_sha256: String,
    /// Name of the space, or names of the spaces.
    pub space: String,
    /// Name of the training configuration.
    pub preset: String,
    /// Name of the search method.
    pub method: String,
    /// Seed.
    pub seed: u64,
    /// Sizes of all parts.
    pub settings: RetrainingSettings,
    /// Records of the rounds.
    pub rounds: Vec<Round>,
    /// Reason of the end.
    pub ending: RetrainingEnding,
    /// Results of the initial policy.
    #[serde(rename = "first_standing")]
    pub first_results: RegressionResults,
    /// Results of the retrained policy.
    #[serde(rename = "retrained_standing")]
    pub retrained_results: RegressionResults,
    /// Avoidable random scenarios of the test set.
    #[serde(rename = "judged_draws")]
    pub test_draws: u64,
    /// Results of each controller in the test set.
    pub tallies: Vec<ControllerTally>,
    /// Paired results of the two policies.
    pub pairs: PairedOutcomes,
    /// Hashes of the policy and the corpora.
    pub files: Vec<FileHash>,
}

impl RetrainingReport {
    pub(super) fn new(
        plan: &RetrainingPlan,
        work: &RunFolder,
        (first_standing, retrained_standing): (RegressionResults, RegressionResults),
        rounds: Vec<Round>,
        ending: RetrainingEnding,
        evaluated: TestSetResults,
    ) -> Result<Self, RetrainError> {
        let hash = |name: &str| -> Result<FileHash, RetrainError> {
            Ok(FileHash { file: name.to_owned(), sha256: sha256(work.read_required(name)?) })
        };
        let files = [POLICY, TRAINING_CASES, SELECTION_SET, VALIDATION_SET, TEST_SET]
            .map(hash)
            .into_iter()
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            version: RETRAIN_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            plan_sha256: sha256(plan.to_toml()?),
            first: plan.initial_policy_name.clone(),
            first_sha256: plan.initial_policy.digest(),
            retrained_sha256: hash(POLICY)?.sha256,
            space: plan.spaces.name(),
            preset: plan.training.name.clone(),
            method: plan.method.name().to_owned(),
            seed: plan.seed,
            settings: plan.settings,
            rounds,
            ending,
            first_results: first_standing,
            retrained_results: retrained_standing,
            test_draws: evaluated.corpus.avoidable,
            tallies: evaluated.tallies,
            pairs: evaluated.pairs,
            files,
        })
    }

    /// True if any round was accepted.
    #[must_use]
    pub fn is_retrained(&self) -> bool {
        self.rounds.iter().any(|round| round.acceptance.is_accepted())
    }

    pub(super) fn write_files(&self, work: &RunFolder, picture: String) -> Result<(), RetrainError> {
        let mut changes = work.transaction();
        changes
            .write(REPORT_MARKDOWN, self.to_markdown())
            .write(REPORT_SVG, picture)
            .write(REPORT_JSON, to_json(self)?);
        Ok(changes.commit()?)
    }

    /// Returns a lower bound of the factor by which the collision rate decreased: the lower end of the initial policy's
    /// interval over the upper end of the retrained policy's. Each end is wrong with a probability of at most 2.5 %, so
    /// the bound has a confidence level of 95 %.
    pub(crate) fn min_improvement_factor(&self) -> Option<f64> {
        let [first, retrained, ..] = self.tallies.as_slice() else { return None };
        Some(first.interval(self.test_draws).lower / retrained.interval(self.test_draws).upper)
    }

    /// Returns the text of `report.md`.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_markdown(&mut text);
        text
    }

    fn write_markdown(&self, out: &mut String) -> std::fmt::Result {
        let RetrainingSettings { rounds, episodes, budget, draws, validation_draws, nominal, .. } = self.settings;
        let is_one = !self.space.contains(", ");
        let (spaces, each) = if is_one { ("the space", "the") } else { ("the spaces", "each") };
        writeln!(out, "# Retraining of {} in {spaces} {}\n", MarkdownCode(&self.first), MarkdownCode(&self.space))?;
        let learning = if episodes == 0 { "imitation".to_owned() } else { format!("{episodes} episodes") };
        writeln!(
            out,
            "At most {rounds} round{} of {learning} (preset {}, seed {}): {:.0} % of the episodes from the \
             paper's distribution, {:.0} % of the others from collected cases, the rest random scenarios of \
             {spaces}. Each search: {budget} evaluations of `{}` and of each reference search, and {draws} random \
             scenarios. {}\n",
            if rounds == 1 { "" } else { "s" },
            MarkdownCode(preset_name(&self.preset)),
            self.seed,
            100.0 * self.settings.nominal_share,
            100.0 * self.settings.case_share,
            self.method,
            self.ending_sentence()
        )?;
        out.push_str("## Test set\n\n");
        self.write_test_set(out)?;
        out.push_str("\n## Rounds\n\n![Collisions of every checkpoint](report.svg)\n\n");
        self.write_rounds(out)?;
        writeln!(
            out,
            "\nA change shows the collisions of the policy before the round → of the candidate (fixed, new). *Cases* \
             are all avoidable scenarios collected up to the round. The *validation set* has {validation_draws} \
             avoidable random scenarios of {each} space. *paper-1..3* are the paper's scenarios, each through the \
             filter and with the true state. *paper's distribution* stands for {nominal} random scenarios of it. A \
             round is accepted if there is no new failure in the last two columns, no more collisions in the \
             validation set, and the candidate is not significantly worse in any regression space.\n"
        )?;
        self.write_regression(out)?;
        out.push_str("## Files\n\n| file | SHA-256 |\n|---|---|\n");
        for FileHash { file, sha256 } in &self.files {
            writeln!(out, "| `{file}` | `{sha256}` |")?;
        }
        writeln!(out, "\nFirst policy: `{}`. Plan: `{}`.", self.first_sha256, self.plan_sha256)
    }

    /// Returns a sentence that states why the retraining ended.
    #[must_use]
    pub fn ending_sentence(&self) -> String {
        let accepted = self.rounds.iter().filter(|round| round.acceptance.is_accepted()).count();
        let made = format!("{} made, {accepted} accepted", self.rounds.len());
        match &self.ending {
            RetrainingEnding::RoundsExhausted => format!("It ended with its last round: {made}."),
            RetrainingEnding::NothingFound { search } => format!(
                "It ended because a search of {} evaluations and {} random scenarios found no avoidable collision: \
                 {made}.",
                search.evaluations, search.draws
            ),
        }
    }

    fn write_test_set(&self, out: &mut String) -> std::fmt::Result {
        let runs = self.test_draws;
        writeln!(
            out,
            "| controller | collisions in {runs} | into the leader | from behind | rate | exact {:.0} % interval |",
            100.0 * CONFIDENCE
        )?;
        out.push_str("|---|---|---|---|---|---|\n");
        for tally in &self.tallies {
            let interval = tally.interval(runs);
            writeln!(
                out,
                "| {} | {} | {} | {} | {:.3} % | {:.3} to {:.3} % |",
                MarkdownText(&tally.controller),
                tally.contacts,
                tally.into_the_leader,
                tally.contacts - tally.into_the_leader,
                100.0 * tally.contacts as f64 / runs.max(1) as f64,
                100.0 * interval.lower,
                100.0 * interval.upper
            )?;
        }
        let PairedOutcomes { both, first_only, retrained_only, neither } = self.pairs;
        writeln!(
            out,
            "\nOf the first policy's collisions, {first_only} are fixed and {both} remain; {retrained_only} are new; \
             {neither} scenarios have no collision with either policy. A collision is avoidable in every scenario."
        )?;
        let comparison = match self.min_improvement_factor() {
            Some(factor) if factor > 1.0 => format!("at least {factor:.2} times rarer"),
            Some(_) => "not shown to be rarer".to_owned(),
            None => return Ok(()),
        };
        writeln!(out, "Collisions are {comparison} than with the first policy, at a confidence level of 95 %.")
    }

    /// Writes the changes of the initial policy's failures in regression spaces.
    fn write_regression(&self, out: &mut String) -> std::fmt::Result {
        if self.first_results.regression.is_empty() {
            return Ok(());
        }
        writeln!(
            out,
            "## Regression spaces\n\nSignificantly worse: McNemar's exact one-sided test on the same random \
             scenarios, p below {SIGNIFICANCE} for each space and column. A drive is not useful if it ends in a \
             collision, has braking harder than 4 m/s² where less than 3 m/s² was justified, or leaves the vehicle \
             behind; this counts where `idm` is always useful.\n\n| space | random scenarios | collisions | not \
             useful |\n|---|---|---|---|"
        )?;
        for (was, is) in self.first_results.regression.iter().zip(&self.retrained_results.regression) {
            let change = |was: &[u64], is: &[u64]| {
                format!("{} (p = {:.2})", FailureChange::between(was, is), discordant_pairs(was, is).p_value())
            };
            let drives = was.not_useful.as_ref().zip(is.not_useful.as_ref());
            writeln!(
                out,
                "| {} | {} | {} | {} |",
                MarkdownText(&is.space),
                is.sample_count,
                change(&was.contacts, &is.contacts),
                drives.map_or("–".to_owned(), |(was, is)| change(was, is))
            )?;
        }
        out.push('\n');
        let (Some(was), Some(is)) = (&self.first_results.usefulness, &self.retrained_results.usefulness) else {
            return Ok(());
        };
        writeln!(out, "| in {} drives of everyday traffic | first | retrained |\n|---|---|---|", is.scenario_count)?;
        let values = traffic_measures(was).into_iter().zip(traffic_measures(is));
        for (name, (was, is)) in TRAFFIC_MEASURES.into_iter().zip(values) {
            writeln!(out, "| {name} | {} | {} |", to_thousandths(was), to_thousandths(is))?;
        }
        out.push('\n');
        Ok(())
    }

    fn write_rounds(&self, out: &mut String) -> std::fmt::Result {
        out.push_str(
            "| round | found: distinct (avoidable, unavoidable, undecided) | random scenarios with collision \
             (avoidable) | episodes (best after) | cases | validation set | paper-1..3 | paper's distribution | \
             acceptance |\n|---|---|---|---|---|---|---|---|---|\n",
        );
        for round in &self.rounds {
            let RoundFindings { avoidable, unavoidable, undecided, colliding_draws, avoidable_draws, .. } =
                &round.findings;
            writeln!(
                out,
                "| {} | {} ({avoidable}, {unavoidable}, {undecided}) | {colliding_draws} ({}) | {} ({}) | {} | {} | {} \
                 | {} | {} |",
                round.round,
                avoidable + unavoidable + undecided,
                avoidable_draws.indices.len(),
                round.training.to_episode,
                round.training.best_episode,
                round.in_cases,
                round.in_validation_set,
                round.in_paper,
                round.in_nominal,
                round.acceptance
            )?;
        }
        Ok(())
    }
}
