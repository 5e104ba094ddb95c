//! One round: training, evaluation and decision.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::acceptance::{Acceptance, FailureChange, RejectionReason, decide_acceptance};
use super::cases::Cases;
use super::corpus::{Corpus, colliding_indices};
use super::files::{LEARNER, ROUND_RECORD, write_json};
use super::plan::RetrainingPlan;
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::regression_spaces::RegressionSet;
use super::search::RoundFindings;
use super::test_set::witnesses;
use super::{RegressionResults, RetrainError};
use crate::rl::TrainingError;
use crumple_sim::control::IntoSource;
use crumple_sim::engine::NamedController;
use crumple_sim::policy::Policy;
use crumple_store::run_folder::{RunFolder, RunFolderError};

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
    pub contacts: Option<u64>,
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
    #[serde(rename = "found")]
    pub findings: RoundFindings,
    /// Number of cases of all rounds so far.
    pub cases: usize,
    /// Record of the training.
    #[serde(rename = "trained")]
    pub training: RoundTraining,
    /// SHA-256 of the candidate; none if the training diverged.
    pub candidate_sha256: Option<String>,
    /// Collisions in the cases, before and after.
    pub in_cases: FailureChange,
    /// Collisions in the validation set.
    #[serde(rename = "in_kept_aside")]
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
    pub(super) policy: Arc<Policy>,
    /// Results of the initial policy.
    pub(super) initial_results: &'a RegressionResults,
    pub(super) results: RegressionResults,
    pub(super) cases: Cases,
    pub(super) previous_round: Option<&'a Round>,
}

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
        found: RoundFindings,
        cases: &Cases,
        watch: &RetrainingObserver<'_>,
    ) -> Result<Round, RetrainError> {
        let scenarios = cases.scenarios(&self.plan.spaces)?;
        let (trained, candidate, problem) = match self.train(cases, watch) {
            Ok((trained, candidate)) => (trained, Some(Arc::new(candidate)), None),
            Err(RetrainError::Training(diverged @ TrainingError::Diverged { .. })) => {
                self.run_folder
                    .transaction()
                    .remove(&self.path(LEARNER))
                    .commit()?;
                let (seed, from_episode) = self.learner_start();
                let trained = RoundTraining {
                    seed,
                    from_episode,
                    to_episode: 0,
                    best_episode: 0,
                    checkpoints: Vec::new(),
                };
                (trained, None, Some(diverged.to_string()))
            }
            Err(other) => return Err(other),
        };
        watch.notify(&RetrainingProgress::Evaluating {
            round: self.round_number(),
        })?;
        let after = match &candidate {
            Some(candidate) => RegressionResults::evaluate(
                candidate,
                self.plan,
                self.validation_set,
                self.regression,
            )?,
            None => self.results.clone(),
        };
        let is_new = candidate
            .as_ref()
            .is_some_and(|candidate| candidate.network() != self.policy.network());
        let collided = |policy: &Arc<Policy>| {
            colliding_indices(
                &scenarios,
                &Arc::clone(policy).into_source(),
                self.plan.estimator(),
            )
        };
        let in_cases = FailureChange::between(
            &collided(&self.policy)?,
            &collided(candidate.as_ref().unwrap_or(&self.policy))?,
        );
        let acceptance = match problem {
            Some(problem) => Acceptance::Rejected {
                objections: vec![RejectionReason::Diverged { problem }],
            },
            None if !is_new => Acceptance::Rejected {
                objections: vec![RejectionReason::Unchanged],
            },
            None => decide_acceptance(self.initial_results, &self.results, &after, &in_cases),
        };
        let round = Round {
            round: self.round_number(),
            before_sha256: self.policy.digest(),
            findings: found,
            cases: scenarios.len(),
            training: trained,
            candidate_sha256: candidate.as_ref().map(|candidate| candidate.digest()),
            in_cases,
            in_validation_set: FailureChange::between(
                &self.results.validation_set,
                &after.validation_set,
            ),
            in_paper: FailureChange::between(&self.results.paper, &after.paper),
            in_nominal: FailureChange::between(&self.results.nominal, &after.nominal),
            acceptance,
            after,
        };
        if let Some(candidate) = &candidate {
            self.run_folder
                .write(&self.path(CANDIDATE), candidate.to_bytes()?)?;
        }
        write_json(self.run_folder, &self.path(ROUND_RECORD), &round)?;
        Ok(round)
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
