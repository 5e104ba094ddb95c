//! One round: training, evaluation and decision.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::acceptance::{Acceptance, FailureChange, RejectionReason, decide_acceptance};
use super::cases::Cases;
use super::corpus::{Corpus, colliding_indices};
use super::files::{LEARNER, ROUND_RECORD};
use super::plan::RetrainingPlan;
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::regression_spaces::RegressionSet;
use super::search::RoundFindings;
use super::test_set::witnesses;
use super::{RegressionResults, RetrainError};
use crate::rl::TrainingError;
use crumple_sim::control::IntoSource;
use crumple_sim::engine::{NamedController, RunError};
use crumple_sim::policy::Policy;
use crumple_sim::scenario::Scenario;
use crumple_store::run_folder::{RunFolder, RunFolderError, encode_json};

/// Record of the training of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundTraining {
    /// Seed of the learner, which continues from round to round unless a training diverges.
    pub seed: u64,
    /// Episodes before the round.
    pub from_episode: u64,
    /// Episodes after the round; 0 if the training diverged, or is an imitation alone.
    pub to_episode: u64,
    /// Episode after which the candidate was taken.
    pub best_episode: u64,
    /// Evaluated checkpoints, in order.
    pub checkpoints: Vec<Checkpoint>,
}

/// Evaluation of a checkpoint on the selection set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// Episodes done.
    pub episode: u64,
    /// Collisions in the selection set; none if the policy collides in the paper's scenarios or the screening.
    #[serde(alias = "contacts")]
    pub collisions: Option<u64>,
}

/// Record of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Round {
    /// Number, from 1.
    pub round: u64,
    /// SHA-256 of the policy that was searched.
    pub before_sha256: String,
    /// Results of the search.
    #[serde(alias = "found")]
    pub findings: RoundFindings,
    /// Number of cases of all rounds so far.
    pub cases: usize,
    /// Record of the training.
    #[serde(alias = "trained")]
    pub training: RoundTraining,
    /// SHA-256 of the candidate; none if the training diverged.
    pub candidate_sha256: Option<String>,
    /// Collisions in the cases, before and after.
    pub in_cases: FailureChange,
    /// Collisions in the validation set.
    #[serde(alias = "in_kept_aside")]
    pub in_validation_set: FailureChange,
    /// Collisions in the paper's scenarios, with the filter and with the true state.
    pub in_paper: FailureChange,
    /// Collisions in random scenarios of the paper's distribution.
    pub in_nominal: FailureChange,
    /// Decision on the candidate.
    pub acceptance: Acceptance,
    /// Results of the candidate.
    pub after: RegressionResults,
}

pub(super) struct RoundContext<'a> {
    pub(super) plan: &'a RetrainingPlan,
    pub(super) run_folder: &'a RunFolder,
    pub(super) validation_set: &'a Corpus,
    pub(super) selection_set: &'a Corpus,
    pub(super) regression: &'a RegressionSet,
    pub(super) policy: &'a Arc<Policy>,
    /// Results of the initial policy.
    pub(super) initial_results: &'a RegressionResults,
    pub(super) results: &'a RegressionResults,
    pub(super) cases: &'a Cases,
    pub(super) previous_round: Option<&'a Round>,
}

/// The policy that a training gave, or the description of its divergence.
type Candidate = Result<Arc<Policy>, String>;

const CANDIDATE: &str = "candidate.safetensors";

pub(super) fn round_path(round: u64, name: &str) -> String {
    format!("rounds/{round:02}/{name}")
}

impl Round {
    /// Reads the candidate and checks its hash.
    pub(super) fn candidate(&self, work: &RunFolder) -> Result<Policy, RetrainError> {
        let name = round_path(self.round, CANDIDATE);
        let candidate = Policy::from_bytes(&work.read_required(&name)?)?;
        if self.candidate_sha256.as_ref() != Some(&candidate.digest()) {
            let problem = format!("differs from the policy of {ROUND_RECORD}");
            return Err(RunFolderError::damaged(&work.path(&name), problem).into());
        }
        Ok(candidate)
    }
}

impl RoundContext<'_> {
    pub(super) fn round_number(&self) -> u64 {
        self.previous_round.map_or(1, |last| last.round + 1)
    }

    pub(super) fn path(&self, name: &str) -> String {
        round_path(self.round_number(), name)
    }

    /// Trains and evaluates the candidate, decides on it, and writes the record of the round.
    pub(super) fn finish(
        &self,
        findings: RoundFindings,
        cases: &Cases,
        observer: &RetrainingObserver<'_>,
    ) -> Result<Round, RetrainError> {
        let scenarios = cases.scenarios(&self.plan.spaces)?;
        let (training, candidate) = self.train_candidate(cases, observer)?;
        let number = self.round_number();
        observer.notify(&RetrainingProgress::Evaluating { round: number })?;
        let after = match &candidate {
            Ok(candidate) => self.evaluate(candidate)?,
            Err(_) => self.results.clone(),
        };
        let new_policy = candidate.as_ref().unwrap_or(self.policy);
        let in_cases = FailureChange::between(
            &self.colliding_indices(&scenarios, self.policy)?,
            &self.colliding_indices(&scenarios, new_policy)?,
        );
        let before = self.results;
        let round = Round {
            round: number,
            before_sha256: self.policy.digest(),
            findings,
            cases: scenarios.len(),
            training,
            candidate_sha256: candidate.as_ref().ok().map(|policy| policy.digest()),
            in_validation_set: FailureChange::between(
                &before.validation_set,
                &after.validation_set,
            ),
            in_paper: FailureChange::between(&before.paper, &after.paper),
            in_nominal: FailureChange::between(&before.nominal, &after.nominal),
            acceptance: self.decide(&candidate, &after, &in_cases),
            in_cases,
            after,
        };
        self.write(&round, candidate.ok().as_deref())?;
        Ok(round)
    }

    /// Trains the candidate.
    fn train_candidate(
        &self,
        cases: &Cases,
        observer: &RetrainingObserver<'_>,
    ) -> Result<(RoundTraining, Candidate), RetrainError> {
        let diverged = match self.train(cases, observer) {
            Ok((training, policy)) => return Ok((training, Ok(Arc::new(policy)))),
            Err(RetrainError::Training(diverged @ TrainingError::Diverged { .. })) => diverged,
            Err(other) => return Err(other),
        };
        self.run_folder
            .transaction()
            .remove(&self.path(LEARNER))
            .commit()?;
        let start = self.learner_start();
        let training = RoundTraining {
            seed: start.seed,
            from_episode: start.episode,
            to_episode: 0,
            best_episode: 0,
            checkpoints: Vec::new(),
        };
        Ok((training, Err(diverged.to_string())))
    }

    fn evaluate(&self, policy: &Arc<Policy>) -> Result<RegressionResults, RetrainError> {
        RegressionResults::evaluate(policy, self.plan, self.validation_set, self.regression)
    }

    fn colliding_indices(
        &self,
        scenarios: &[Scenario],
        policy: &Arc<Policy>,
    ) -> Result<Vec<usize>, RunError> {
        let controller = Arc::clone(policy).into_source();
        colliding_indices(scenarios, &controller, self.plan.estimator())
    }

    fn decide(
        &self,
        candidate: &Candidate,
        after: &RegressionResults,
        in_cases: &FailureChange,
    ) -> Acceptance {
        let objection = match candidate {
            Err(problem) => RejectionReason::Diverged {
                problem: problem.clone(),
            },
            Ok(candidate) if candidate.network() == self.policy.network() => {
                RejectionReason::Unchanged
            }
            Ok(_) => return decide_acceptance(self.initial_results, self.results, after, in_cases),
        };
        Acceptance::Rejected {
            objections: vec![objection],
        }
    }

    fn write(&self, round: &Round, candidate: Option<&Policy>) -> Result<(), RetrainError> {
        if let Some(candidate) = candidate {
            self.run_folder
                .write(&self.path(CANDIDATE), candidate.to_bytes()?)?;
        }
        let record = encode_json(ROUND_RECORD, round)?;
        Ok(self.run_folder.write(&self.path(ROUND_RECORD), record)?)
    }
}

pub(super) fn named_policy(name: &str, policy: &Arc<Policy>) -> NamedController {
    NamedController {
        name: name.to_owned(),
        source: Arc::clone(policy).into_source(),
    }
}

/// Reads a corpus of the plan from its file, or builds it.
pub(super) fn load_corpus(
    plan: &RetrainingPlan,
    work: &RunFolder,
    (name, seed, wanted): (&'static str, u64, u64),
    watch: &RetrainingObserver<'_>,
) -> Result<Corpus, RetrainError> {
    let witnesses = witnesses(&[named_policy(
        &plan.initial_policy_name,
        &plan.initial_policy,
    )]);
    Corpus::load_or_build(
        (work, name),
        &plan.spaces,
        (seed, wanted),
        &witnesses,
        plan.estimator(),
        watch,
    )
}
