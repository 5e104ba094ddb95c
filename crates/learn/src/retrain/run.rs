//! Running a retraining, from its first search to its report.

use std::path::Path;
use std::sync::Arc;

use super::cases::Cases;
use super::files::{
    CHECKPOINTS, TEST_SET, VALIDATION_SET, LEARNER, PLAN, POLICY, RECORD, REPORT, TRAINING_CASES, read_json, write_json,
};
use super::test_set::{Judged, witnesses};
use super::plan::{VALIDATION_SET_SEED, RetrainingPlan};
use super::progress::RetrainingProgress;
use super::regression_spaces::RegressionSpaces;
use super::report::{Ending, Report};
use super::round::{Round, RoundContext, RoundFindings, gathered, in_round, selection};
use super::{RetrainError, Standing};
use crumple_core::observer::Observer;
use crumple_store::work::WorkError;
use crumple_world::policy::Policy;
use crumple_world::sim::{ControllerKind, NamedController};

/// What the policy at the end is called in tables.
const RETRAINED_NAME: &str = "retrained";

impl RetrainingPlan {
    /// Runs the retraining in `folder`, or continues it with `resume`; of a complete one, reads the report.
    ///
    /// # Errors
    /// [`RetrainError`] if the folder cannot be used, or holds half-done work of another build, a search or a training fails, hardly anything in the space
    /// is avoidable, or `watch` stops the retraining.
    pub fn run(
        &self,
        folder: &Path,
        resume: bool,
        watch: &dyn Observer<RetrainingProgress>,
    ) -> Result<Report, RetrainError> {
        self.check()?;
        let work = self.work(folder, resume)?;
        if work.is_complete() {
            let report = read_json(&work, REPORT)?;
            return report.ok_or_else(|| WorkError::missing(&work.path(REPORT)).into());
        }
        work.write(PLAN, self.to_toml()?)?;
        let wanted = self.settings.kept_aside;
        let kept_aside = gathered(self, &work, (VALIDATION_SET, VALIDATION_SET_SEED, wanted), watch)?;
        let selection = selection(self, &work, watch)?;
        let mut policy = Arc::clone(&self.first);
        let regression = RegressionSpaces::new(self)?;
        let first = Standing::of(&policy, self, &kept_aside, &regression)?;
        let mut standing = first.clone();
        let mut cases = Cases::none(&self.space)?;
        let mut rounds: Vec<Round> = Vec::new();
        let ending = loop {
            if rounds.len() as u64 == self.settings.rounds {
                break Ending::RoundsSpent;
            }
            let before = RoundContext {
                plan: self,
                work: &work,
                kept_aside: &kept_aside,
                selection: &selection,
                regression: &regression,
                policy: Arc::clone(&policy),
                standing: standing.clone(),
                cases: cases.clone(),
                last: rounds.last(),
            };
            let found = before.search(watch)?;
            if found.is_nothing() {
                break Ending::NothingFound { search: Box::new(found) };
            }
            cases = before.extended_cases(&found)?;
            let number = rounds.len() as u64 + 1;
            let round: Round = match read_json(&work, &before.name(RECORD))? {
                Some(round) => round,
                None => before.finish(found, &cases, watch)?,
            };
            work.changes().remove(&in_round(number, CHECKPOINTS)).remove(&in_round(number - 1, LEARNER)).commit()?;
            if round.acceptance.is_accepted() {
                policy = Arc::new(round.candidate(&work)?);
                standing = round.after.clone();
            }
            rounds.push(round);
        };
        let last = in_round(rounds.len() as u64, LEARNER);
        work.changes().remove(&last).write(POLICY, policy.to_bytes()?).commit()?;
        write_json(&work, TRAINING_CASES, &cases)?;
        let contender = |name: &str, policy: &Arc<Policy>| NamedController {
            name: name.to_owned(),
            kind: ControllerKind::Policy(Arc::clone(policy)),
        };
        let contenders = witnesses(&[contender(&self.first_name, &self.first), contender(RETRAINED, &policy)]);
        let judged = Judged::at((&work, TEST_SET), self, &contenders, watch)?;
        let report = Report::new(self, &work, (first, standing), rounds, ending, judged)?;
        report.write(&work, (self.picture)(&report))?;
        work.finish()?;
        Ok(report)
    }
}

impl RoundFindings {
    fn is_empty(&self) -> bool {
        self.avoidable == 0 && self.draws_avoidable.indices.is_empty()
    }
}
