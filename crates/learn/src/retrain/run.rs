//! Running a retraining, from its first search to its report.

use std::path::Path;
use std::sync::Arc;

use super::cases::Cases;
use super::files::{read_json, write_json};
use super::judged::{Judged, witnesses};
use super::plan::{KEPT_ASIDE_SEED, PLAN, RetrainingPlan};
use super::regression::Regression;
use super::report::{Ending, REPORT, Report};
use super::round::{RECORD, Round, RoundContext, RoundFindings, gathered, in_round, selection};
use super::training::{CHECKPOINTS, LEARNER};
use super::{RetrainError, Standing};
use crumple_search::falsify::campaign;
use crumple_search::work::WorkError;
use crumple_world::policy::Policy;
use crumple_world::sim::{ControllerKind, NamedController};

/// How far a retraining is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// Draws are classed for a corpus.
    Gathering {
        /// Its file.
        what: &'static str,
        /// Avoidable ones so far.
        done: u64,
        /// How many are wanted.
        wanted: u64,
    },
    /// A campaign is under way.
    Searching {
        /// Round, from 1.
        round: u64,
        /// How far the campaign is.
        state: campaign::Progress,
    },
    /// Draws of the space are driven and classed.
    Drawing {
        /// Round, from 1.
        round: u64,
        /// How many.
        draws: u64,
    },
    /// The learner is at work.
    Training {
        /// Round, from 1.
        round: u64,
        /// Episode of the round, from 1.
        episode: u64,
        /// Episodes of the round.
        episodes: u64,
        /// Fewest contacts of any checkpoint in the selection.
        fewest: Option<u64>,
    },
    /// A candidate is judged.
    Judging {
        /// Round, from 1.
        round: u64,
    },
}

/// What is told of the progress.
pub(super) type Show<'a> = dyn FnMut(Progress) + 'a;

/// What the policy at the end is called in tables.
const RETRAINED: &str = "retrained";

/// The files of the results.
pub(super) const POLICY: &str = "policy.safetensors";
pub(super) const RETRAINED_ON: &str = "retrained-on.json";
pub(super) const JUDGED_ON: &str = "judged-on.json";
pub(super) const KEPT_ASIDE: &str = "kept-aside.json";
pub(super) const SELECTION: &str = "selection.json";

impl RetrainingPlan {
    /// Runs the retraining in `folder`, or goes on with it where `resume` says so; of a complete one, the report is read.
    ///
    /// # Errors
    /// [`RetrainError`] if the folder cannot be used, or holds half-done work of another build, a search or a training fails, or hardly anything in the space is avoidable.
    pub fn run(&self, folder: &Path, resume: bool, show: &mut dyn FnMut(Progress)) -> Result<Report, RetrainError> {
        self.check()?;
        let work = self.work(folder, resume)?;
        if work.is_complete() {
            let report = read_json(&work, REPORT)?;
            return report.ok_or_else(|| WorkError::missing(&work.path(REPORT)).into());
        }
        work.write(PLAN, self.to_toml()?)?;
        let wanted = self.settings.kept_aside;
        let kept_aside = gathered(self, &work, (KEPT_ASIDE, KEPT_ASIDE_SEED, wanted), show)?;
        let selection = selection(self, &work, show)?;
        let mut policy = Arc::clone(&self.first);
        let regression = Regression::new(self)?;
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
            let found = before.search(show)?;
            if found.is_nothing() {
                break Ending::NothingFound { search: Box::new(found) };
            }
            cases = before.cases_with(&found)?;
            let number = rounds.len() as u64 + 1;
            let round: Round = match read_json(&work, &before.name(RECORD))? {
                Some(round) => round,
                None => before.finish(found, &cases, show)?,
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
        write_json(&work, RETRAINED_ON, &cases)?;
        let contender = |name: &str, policy: &Arc<Policy>| NamedController {
            name: name.to_owned(),
            kind: ControllerKind::Policy(Arc::clone(policy)),
        };
        let contenders = witnesses(&[contender(&self.first_name, &self.first), contender(RETRAINED, &policy)]);
        let judged = Judged::at((&work, JUDGED_ON), self, &contenders, &mut |done| {
            show(Progress::Gathering { what: JUDGED_ON, done, wanted: self.settings.judged });
        })?;
        let report = Report::new(self, &work, (first, standing), rounds, ending, judged)?;
        report.write(&work, (self.picture)(&report))?;
        work.finish()?;
        Ok(report)
    }
}

impl RoundFindings {
    fn is_nothing(&self) -> bool {
        self.avoidable == 0 && self.draws_avoidable.indices.is_empty()
    }
}
