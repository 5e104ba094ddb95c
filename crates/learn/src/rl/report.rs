//! Reports of trainings, as text and as JSON.

use serde::Serialize;

use super::{SeedResult, TrainingConfig, UNSEEN_DRAWS};

/// Content of `training.json`: all finished trainings in a folder.
#[derive(Debug, Serialize)]
pub struct TrainingResult<'a> {
    /// Version of crumple.
    pub version: &'static str,
    /// Configuration of the trainings.
    pub config: &'a TrainingConfig,
    /// Results, one per seed.
    pub seeds: &'a [SeedResult],
}

impl<'a> TrainingResult<'a> {
    /// Describes the trainings of seeds with this version.
    #[must_use]
    pub fn new(config: &'a TrainingConfig, seeds: &'a [SeedResult]) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            config,
            seeds,
        }
    }
}

/// Returns a table of trainings for a reader. The validation set has `validation_scenarios` random scenarios.
#[must_use]
pub fn format_table(results: &[SeedResult], validation_scenarios: u64) -> String {
    let mut text = format!(
        "{:>6} {:>8} {:>6}  {:<9} {:<9} {:<9} {:>10} {:>10} {:>7}  {}\n",
        "seed",
        "episodes",
        "best",
        "paper-1",
        "paper-2",
        "paper-3",
        "validation",
        "test",
        "gap m",
        "policy"
    );
    for result in results {
        text += &result.format_row(validation_scenarios);
    }
    text + "gap: smallest gap outside the test set\n"
}

impl SeedResult {
    /// Returns a row of the table; empty without an evaluation.
    fn format_row(&self, validation_scenarios: u64) -> String {
        let Some(evaluation) = &self.evaluation else {
            return String::new();
        };
        let [paper_1, paper_2, paper_3] = evaluation
            .is_safe_in_paper
            .map(|is_safe| if is_safe { "safe" } else { "COLLISION" });
        let validation = match evaluation.ranking_collisions {
            Some(collisions) => format!("{collisions}/{validation_scenarios}"),
            None => format!("{:.0} % safe", 100.0 * evaluation.safe_share),
        };
        let test = format!("{}/{UNSEEN_DRAWS}", self.unseen_collisions);
        let digest = self.policy_sha256.as_ref();
        format!(
            "{:>6} {:>8} {:>6}  {paper_1:<9} {paper_2:<9} {paper_3:<9} {validation:>10} {test:>10} {:>7.2}  {}\n",
            self.seed,
            self.episodes,
            self.best_episode.unwrap_or_default(),
            evaluation.smallest_gap_m,
            digest
                .and_then(|digest| digest.get(..12))
                .unwrap_or("none: nothing learned")
        )
    }
}
