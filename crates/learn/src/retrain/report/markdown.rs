//! Text of the report: the file `report.md`.

use std::fmt::Write;

use super::super::acceptance::{FailureChange, TRAFFIC_MEASURES, discordant_pairs, to_thousandths};
use super::super::plan::RetrainingSettings;
use super::super::regression_spaces::SIGNIFICANCE;
use super::super::round::Round;
use super::super::search::RoundFindings;
use super::super::test_set::{CONFIDENCE, ControllerTally, PairedOutcomes};
use super::{FileHash, RetrainingEnding, RetrainingReport};
use crate::rl::TrafficUsefulness;
use crumple_core::digits::{format_fixed_down, format_rounded};
use crumple_core::markdown::Markdown;
use crumple_core::quoting::MarkdownCode;
use crumple_evidence::DiscordantPairs;

/// Returns the present name of a preset: files keep the name `harden` of the preset `retrain`.
fn preset_name(name: &str) -> &str {
    if name == "harden" { "retrain" } else { name }
}

impl RetrainingReport {
    /// Returns the text of `report.md`.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_markdown(&mut text);
        text
    }

    fn write_markdown(&self, out: &mut String) -> std::fmt::Result {
        self.write_settings(out)?;
        out.push_str("## Test set\n\n");
        self.write_test_set(out)?;
        out.push_str("\n## Rounds\n\n");
        self.write_rounds(out);
        let validation_draws = self.settings.validation_draws;
        let nominal = self.settings.nominal;
        let each = if self.has_one_space() { "the" } else { "each" };
        writeln!(
            out,
            "\nA change shows the collisions of the policy before the round → of the candidate (fixed, new). *Cases* \
             are all avoidable scenarios collected up to the round. The *validation set* has {validation_draws} \
             avoidable random scenarios of {each} space. *paper-1..3* are the paper's scenarios, each through the \
             filter and with the true state. *paper's distribution* stands for {nominal} random scenarios of it. A \
             round is accepted if there is no new failure in *paper-1..3* and *paper's distribution*, no more \
             collisions in the validation set, fewer there or in the cases, no worse usability, and the candidate is \
             not significantly worse in any regression space.\n"
        )?;
        self.write_regression(out)?;
        out.push_str("## Files\n\n");
        let files = self.files.iter();
        let rows =
            files.map(|FileHash { file, sha256 }| vec![format!("`{file}`"), format!("`{sha256}`")]);
        write_table(out, &["file", "SHA-256"], rows);
        writeln!(
            out,
            "\nFirst policy: `{}`. Plan: `{}`.",
            self.first_sha256, self.plan_sha256
        )
    }

    fn has_one_space(&self) -> bool {
        !self.space.contains(", ")
    }

    /// Writes the heading and a paragraph about the settings.
    fn write_settings(&self, out: &mut String) -> std::fmt::Result {
        let RetrainingSettings {
            rounds,
            episodes,
            budget,
            draws,
            ..
        } = self.settings;
        let spaces = if self.has_one_space() {
            "the space"
        } else {
            "the spaces"
        };
        writeln!(
            out,
            "# Retraining of {} in {spaces} {}\n",
            MarkdownCode(&self.first),
            MarkdownCode(&self.space)
        )?;
        let learning = if episodes == 0 {
            "imitation".to_owned()
        } else {
            format!("{episodes} episodes")
        };
        let from_paper = match self.settings.nominal_share {
            0.0 => String::new(),
            share => {
                format!(
                    "{:.0} % of the episodes from the paper's distribution, and of the others ",
                    100.0 * share
                )
            }
        };
        writeln!(
            out,
            "At most {rounds} round{} of {learning} (preset {}, seed {}): {from_paper}{:.0} % from collected cases, \
             the rest random scenarios of {spaces}. Each search: {budget} evaluations of `{}` and of each reference \
             search, and {draws} random scenarios. {}\n",
            if rounds == 1 { "" } else { "s" },
            MarkdownCode(preset_name(&self.preset)),
            self.seed,
            100.0 * self.settings.case_share,
            self.method,
            self.ending_sentence()
        )
    }

    /// Returns a sentence that states why the retraining ended.
    #[must_use]
    pub fn ending_sentence(&self) -> String {
        let accepted = self
            .rounds
            .iter()
            .filter(|round| round.acceptance.is_accepted())
            .count();
        let counts = format!("{} made, {accepted} accepted", self.rounds.len());
        match &self.ending {
            RetrainingEnding::RoundsExhausted => format!("It ended with its last round: {counts}."),
            RetrainingEnding::NothingFound { search } => format!(
                "It ended because a search of {} evaluations and {} random scenarios found no avoidable collision: \
                 {counts}.",
                search.evaluations, search.draws
            ),
        }
    }

    fn write_test_set(&self, out: &mut String) -> std::fmt::Result {
        let runs = self.test_draws;
        let header = [
            "controller",
            &format!("collisions in {runs}"),
            "into the leader",
            "from behind",
            "rate",
            &format!("exact {:.0} % interval", 100.0 * CONFIDENCE),
        ];
        let rows = self.tallies.iter().map(|tally| tally_row(tally, runs));
        write_table(out, &header, rows);
        let PairedOutcomes {
            both,
            first_only,
            retrained_only,
            neither,
        } = self.pairs;
        let fewer = DiscordantPairs {
            only_second_fails: first_only,
            only_first_fails: retrained_only,
        };
        writeln!(
            out,
            "\nOf the first policy's collisions, {first_only} are fixed and {both} remain; {retrained_only} are new; \
             {neither} scenarios have no collision with either policy. A collision is avoidable in every scenario. \
             McNemar's exact one-sided test that collisions are fewer: p = {}.",
            format_rounded(fewer.p_value(), 2)
        )?;
        if let Some(factor) = self.min_improvement_factor().filter(|&factor| factor > 1.0) {
            writeln!(
                out,
                "Collisions are at least {} times rarer, at a confidence level of 95 %.",
                format_fixed_down(factor, 2)
            )?;
        }
        Ok(())
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
             behind; this counts where `idm` is always useful.\n"
        )?;
        let first = self.first_results.regression.iter();
        let pairs = first.zip(&self.retrained_results.regression);
        let rows = pairs.map(|(first, retrained)| {
            let drives = first.not_useful.as_ref().zip(retrained.not_useful.as_ref());
            vec![
                retrained.space.clone(),
                retrained.sample_count.to_string(),
                describe_change(&first.collisions, &retrained.collisions),
                drives.map_or("–".to_owned(), |(first, retrained)| {
                    describe_change(first, retrained)
                }),
            ]
        });
        let header = ["space", "random scenarios", "collisions", "not useful"];
        write_table(out, &header, rows);
        out.push('\n');
        if let Some(first) = &self.first_results.usefulness
            && let Some(retrained) = &self.retrained_results.usefulness
        {
            write_traffic_measures(out, first, retrained);
        }
        Ok(())
    }

    fn write_rounds(&self, out: &mut String) {
        let header = [
            "round",
            "found: distinct (avoidable, unavoidable, undecided)",
            "random scenarios with collision (avoidable)",
            "episodes (best after)",
            "cases",
            "validation set",
            "paper-1..3",
            "paper's distribution",
            "acceptance",
        ];
        write_table(out, &header, self.rounds.iter().map(round_row));
    }
}

/// Returns the row of a round.
fn round_row(round: &Round) -> Vec<String> {
    let RoundFindings {
        avoidable,
        unavoidable,
        undecided,
        colliding_draws,
        avoidable_draws,
        ..
    } = &round.findings;
    let distinct = avoidable + unavoidable + undecided;
    // An imitation has a single checkpoint.
    let episodes = match round.training.to_episode {
        0 => "–".to_owned(),
        last => format!("{last} ({})", round.training.best_episode),
    };
    vec![
        round.round.to_string(),
        format!("{distinct} ({avoidable}, {unavoidable}, {undecided})"),
        format!("{colliding_draws} ({})", avoidable_draws.indices.len()),
        episodes,
        round.in_cases.to_string(),
        round.in_validation_set.to_string(),
        round.in_paper.to_string(),
        round.in_nominal.to_string(),
        round.acceptance.to_string(),
    ]
}

/// Returns the row of a controller in a test set of `runs` scenarios.
fn tally_row(tally: &ControllerTally, runs: u64) -> Vec<String> {
    let interval = tally.interval(runs);
    let rate = tally.collisions as f64 / runs.max(1) as f64;
    vec![
        tally.controller.clone(),
        tally.collisions.to_string(),
        tally.into_the_leader.to_string(),
        (tally.collisions - tally.into_the_leader).to_string(),
        format!("{:.3} %", 100.0 * rate),
        format!("{} %", interval.to_percent_text(3)),
    ]
}

/// Writes the measures of everyday traffic of both policies.
fn write_traffic_measures(
    out: &mut String,
    first: &TrafficUsefulness,
    retrained: &TrafficUsefulness,
) {
    let measured = TRAFFIC_MEASURES.iter().filter_map(|measure| {
        let [first, retrained] = [(measure.value)(first)?, (measure.value)(retrained)?];
        let [first, retrained] = [first, retrained].map(|value| to_thousandths(value).to_string());
        Some(vec![measure.name.to_owned(), first, retrained])
    });
    let [first_gain, retrained_gain] = [first, retrained].map(|usefulness| {
        usefulness
            .line_gain
            .map_or("–".to_owned(), |gain| format!("{gain:.2}"))
    });
    let gains = vec![
        "gain of a line of five".to_owned(),
        first_gain,
        retrained_gain,
    ];
    let drives = format!("in {} drives of everyday traffic", retrained.scenario_count);
    let rows = measured.chain(std::iter::once(gains));
    write_table(out, &[&drives, "first", "retrained"], rows);
    out.push('\n');
}

fn describe_change(before: &[u64], after: &[u64]) -> String {
    let change = FailureChange::between(before, after);
    let p_value = discordant_pairs(before, after).p_value();
    format!("{change} (p = {p_value:.2})")
}

fn write_table(out: &mut String, header: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    let mut table = Markdown::default();
    table.plain_table(header, rows);
    out.push_str(&table.into_string());
}
