//! Execution of a retraining, from the first search to the report.

use std::path::Path;
use std::sync::Arc;

use super::cases::Cases;
use super::files::{
    CHECKPOINTS, LEARNER, PLAN, POLICY, REPORT_JSON, ROUND_RECORD, SELECTION_SET, TEST_SET,
    TRAINING_CASES, VALIDATION_SET, read_json, write_json,
};
use super::plan::{RetrainingPlan, SELECTION_SEED, VALIDATION_SET_SEED};
use super::progress::RetrainingProgress;
use super::regression_spaces::RegressionSet;
use super::report::{RetrainingEnding, RetrainingReport};
use super::round::{Round, RoundContext, load_corpus, named_policy, round_path};
use super::test_set::{TestSetResults, witnesses};
use super::{RegressionResults, RetrainError};
use crumple_core::observer::Observer;
use crumple_store::run_folder::RunFolderError;

const RETRAINED_NAME: &str = "retrained";

impl RetrainingPlan {
    /// Runs the retraining in `folder`, or continues it with `resume`. Of a complete one, reads the report.
    ///
    /// # Errors
    /// [`RetrainError`] if the folder is unusable, a part fails, or `watch` stops the retraining.
    pub fn run(
        &self,
        folder: &Path,
        resume: bool,
        watch: &dyn Observer<RetrainingProgress>,
    ) -> Result<RetrainingReport, RetrainError> {
        self.check_policy()?;
        let work = self.open_run_folder(folder, resume)?;
        if work.is_complete() {
            let report = read_json(&work, REPORT_JSON)?;
            return report.ok_or_else(|| RunFolderError::missing(&work.path(REPORT_JSON)).into());
        }
        work.write(PLAN, self.to_toml()?)?;
        let wanted = self.spaces.total(self.settings.validation_draws);
        let kept_aside = load_corpus(
            self,
            &work,
            (VALIDATION_SET, VALIDATION_SET_SEED, wanted),
            watch,
        )?;
        // An imitation alone has one checkpoint.
        let wanted = if self.settings.episodes == 0 {
            0
        } else {
            self.training.evaluation.ranking_draws
        };
        let selection = load_corpus(self, &work, (SELECTION_SET, SELECTION_SEED, wanted), watch)?;
        let mut policy = Arc::clone(&self.initial_policy);
        let regression = RegressionSet::new(self)?;
        let first = RegressionResults::evaluate(&policy, self, &kept_aside, &regression)?;
        let mut standing = first.clone();
        let mut cases = Cases::empty(&self.spaces)?;
        let mut rounds: Vec<Round> = Vec::new();
        let ending = loop {
            let number = rounds.len() as u64 + 1;
            if number > self.settings.rounds {
                break RetrainingEnding::RoundsExhausted;
            }
            let before = RoundContext {
                plan: self,
                run_folder: &work,
                validation_set: &kept_aside,
                selection_set: &selection,
                regression: &regression,
                policy: Arc::clone(&policy),
                initial_results: &first,
                results: standing.clone(),
                cases: cases.clone(),
                previous_round: rounds.last(),
            };
            let found = before.search(watch)?;
            if found.avoidable == 0 && found.avoidable_draws.indices.is_empty() {
                break RetrainingEnding::NothingFound {
                    search: Box::new(found),
                };
            }
            cases = before.extended_cases(&found)?;
            let round: Round = match read_json(&work, &before.path(ROUND_RECORD))? {
                Some(round) => round,
                None => before.finish(found, &cases, watch)?,
            };
            work.transaction()
                .remove(&round_path(number, CHECKPOINTS))
                .remove(&round_path(number - 1, LEARNER))
                .commit()?;
            if round.acceptance.is_accepted() {
                policy = Arc::new(round.candidate(&work)?);
                standing = round.after.clone();
            }
            rounds.push(round);
        };
        let last = round_path(rounds.len() as u64, LEARNER);
        work.transaction()
            .remove(&last)
            .write(POLICY, policy.to_bytes()?)
            .commit()?;
        write_json(&work, TRAINING_CASES, &cases)?;
        let initial = named_policy(&self.initial_policy_name, &self.initial_policy);
        let contenders = witnesses(&[initial, named_policy(RETRAINED_NAME, &policy)]);
        let evaluated =
            TestSetResults::load_or_evaluate((&work, TEST_SET), self, &contenders, watch)?;
        let report =
            RetrainingReport::new(self, &work, (first, standing), rounds, ending, evaluated)?;
        report.write_files(&work)?;
        work.finish()?;
        Ok(report)
    }
}
