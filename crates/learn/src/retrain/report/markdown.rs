//! Text of the report: the file `report.md`.

use std::fmt::Write;

use super::super::acceptance::{
    FailureChange, TRAFFIC_MEASURES, discordant_pairs, to_thousandths, traffic_measures,
};
use super::super::plan::RetrainingSettings;
use super::super::regression_spaces::SIGNIFICANCE;
use super::super::search::RoundFindings;
use super::super::test_set::{CONFIDENCE, PairedOutcomes};
use super::{FileHash, RetrainingEnding, RetrainingReport};
use crate::rl::TrafficUsefulness;
use crumple_core::digits::format_rounded;
use crumple_core::quoting::{MarkdownCode, MarkdownText};
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
        let RetrainingSettings {
            rounds,
            episodes,
            budget,
            draws,
            validation_draws,
            nominal,
            ..
        } = self.settings;
        let is_one = !self.space.contains(", ");
        let (spaces, each) = if is_one {
            ("the space", "the")
        } else {
            ("the spaces", "each")
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
        )?;
        out.push_str("## Test set\n\n");
        self.write_test_set(out)?;
        out.push_str("\n## Rounds\n\n");
        // An imitation has a single checkpoint.
        self.write_rounds(out)?;
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
        out.push_str("## Files\n\n| file | SHA-256 |\n|---|---|\n");
        for FileHash { file, sha256 } in &self.files {
            writeln!(out, "| `{file}` | `{sha256}` |")?;
        }
        writeln!(
            out,
            "\nFirst policy: `{}`. Plan: `{}`.",
            self.first_sha256, self.plan_sha256
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
                "Collisions are at least {factor:.2} times rarer, at a confidence level of 95 %."
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
             behind; this counts where `idm` is always useful.\n\n| space | random scenarios | collisions | not \
             useful |\n|---|---|---|---|"
        )?;
        for (was, is) in self
            .first_results
            .regression
            .iter()
            .zip(&self.retrained_results.regression)
        {
            let change = |was: &[u64], is: &[u64]| {
                format!(
                    "{} (p = {:.2})",
                    FailureChange::between(was, is),
                    discordant_pairs(was, is).p_value()
                )
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
        let (Some(was), Some(is)) = (
            &self.first_results.usefulness,
            &self.retrained_results.usefulness,
        ) else {
            return Ok(());
        };
        writeln!(
            out,
            "| in {} drives of everyday traffic | first | retrained |\n|---|---|---|",
            is.scenario_count
        )?;
        let values = traffic_measures(was).into_iter().zip(traffic_measures(is));
        for (name, (was, is)) in TRAFFIC_MEASURES.into_iter().zip(values) {
            writeln!(
                out,
                "| {name} | {} | {} |",
                to_thousandths(was),
                to_thousandths(is)
            )?;
        }
        let gain = |found: &TrafficUsefulness| {
            found
                .line_gain
                .map_or("–".to_owned(), |gain| format!("{gain:.2}"))
        };
        writeln!(
            out,
            "| gain of a line of five | {} | {} |\n",
            gain(was),
            gain(is)
        )
    }

    fn write_rounds(&self, out: &mut String) -> std::fmt::Result {
        out.push_str(
            "| round | found: distinct (avoidable, unavoidable, undecided) | random scenarios with collision \
             (avoidable) | episodes (best after) | cases | validation set | paper-1..3 | paper's distribution | \
             acceptance |\n|---|---|---|---|---|---|---|---|---|\n",
        );
        for round in &self.rounds {
            let RoundFindings {
                avoidable,
                unavoidable,
                undecided,
                colliding_draws,
                avoidable_draws,
                ..
            } = &round.findings;
            let episodes = match round.training.to_episode {
                0 => "–".to_owned(),
                last => format!("{last} ({})", round.training.best_episode),
            };
            writeln!(
                out,
                "| {} | {} ({avoidable}, {unavoidable}, {undecided}) | {colliding_draws} ({}) | {episodes} | {} | {} \
                 | {} | {} | {} |",
                round.round,
                avoidable + unavoidable + undecided,
                avoidable_draws.indices.len(),
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
