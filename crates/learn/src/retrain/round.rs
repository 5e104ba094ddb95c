//! One round: search, training, evaluation and decision.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::acceptance::{Acceptance, FailureChange, RejectionReason, decide_acceptance};
use super::cases::{Cases, CollidingDraws};
use super::corpus::{Corpus, classify_scenarios, colliding_indices};
use super::files::{LEARNER, ROUND_RECORD, read_json, write_json};
use super::plan::RetrainingPlan;
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::regression_spaces::RegressionSpace;
use super::test_set::witnesses;
use super::{RegressionResults, RetrainError};
use crate::rl::TrainingError;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_store::run_folder::{RunFolder, RunFolderError};
use crumple_world::policy::Policy;
use crumple_world::scenario::{Scenario, file};
use crumple_world::sim::{ControllerKind, NamedController};

/// Results of a search.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundFindings {
    /// Evaluations of the campaign, by all its methods.
    pub evaluations: u64,
    /// Evaluations that ended in a collision.
    pub failures: u64,
    /// Distinct avoidable counterexamples.
    pub avoidable: usize,
    /// Counterexamples that are proved unavoidable.
    pub unavoidable: usize,
    /// Undecided counterexamples.
    pub undecided: usize,
    /// Random scenarios of the space that were simulated besides.
    pub draws: u64,
    /// Random scenarios that ended in a collision.
    #[serde(rename = "draws_touched")]
    pub colliding_draws: usize,
    /// Avoidable random scenarios among them.
    #[serde(rename = "draws_avoidable")]
    pub avoidable_draws: CollidingDraws,
    /// Avoidable counterexamples, by the file of the scenario.
    pub counterexamples: Vec<String>,
}

/// Record of the training of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundTraining {
    /// Seed of the learner, which continues from round to round unless a training diverges.
    pub seed: u64,
    /// Episodes before the round.
    pub from_episode: u64,
    /// Episodes after the round; 0 if the training diverged.
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
    pub(super) regression_spaces: &'a [RegressionSpace],
    pub(super) policy: Arc<Policy>,
    pub(super) results: RegressionResults,
    pub(super) cases: Cases,
    pub(super) previous_round: Option<&'a Round>,
}

const CANDIDATE: &str = "candidate.safetensors";
const FINDINGS: &str = "found.json";
const SEARCH: &str = "search";

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

    /// Searches for counterexamples, or returns the stored result.
    pub(super) fn search(&self, watch: &RetrainingObserver<'_>) -> Result<RoundFindings, RetrainError> {
        if let Some(found) = read_json(self.run_folder, &self.path(FINDINGS))? {
            return Ok(found);
        }
        self.run_folder.write(&self.path("before.safetensors"), self.policy.to_bytes()?)?;
        let (plan, round) = (self.plan, self.round_number());
        let folder = self.path(SEARCH);
        // Relative to the folder of the counterexamples, so that their recorded verdicts can be replayed.
        let controller = named_policy("../../before.safetensors", &self.policy);
        let campaign = Campaign {
            estimator: plan.estimator(),
            method: plan.method.clone(),
            budget: plan.settings.budget,
            seed: plan.search_seed(round),
            ..Campaign::new(controller, plan.space.clone())
        };
        let path = self.run_folder.path(&folder);
        let searching =
            |state: &CampaignProgress| watch.observe(&RetrainingProgress::Searching { round, progress: state.clone() });
        let options = CampaignOptions { resume: true, ..CampaignOptions::default() };
        let summary = campaign.run(&path, options, &searching)?;
        self.run_folder.include(&folder)?;
        let classed = |class| summary.counterexamples.iter().filter(move |one| one.avoidability.class() == class);
        let [avoidable, unavoidable, undecided] =
            [AvoidabilityClass::Avoidable, AvoidabilityClass::Unavoidable, AvoidabilityClass::Undecided]
                .map(|class| classed(class).count());
        let counterexamples = classed(AvoidabilityClass::Avoidable).map(|one| one.file.clone()).collect();
        let (colliding_draws, avoidable_draws) = self.find_colliding_draws(watch)?;
        let found = RoundFindings {
            evaluations: summary.methods.iter().map(|method| method.evaluations).sum(),
            failures: summary.methods.iter().map(|method| method.failures).sum(),
            avoidable,
            unavoidable,
            undecided,
            draws: plan.settings.draws,
            colliding_draws,
            avoidable_draws,
            counterexamples,
        };
        write_json(self.run_folder, &self.path(FINDINGS), &found)?;
        Ok(found)
    }

    /// Counts the random scenarios that end in a collision, and returns the avoidable ones.
    fn find_colliding_draws(&self, watch: &RetrainingObserver<'_>) -> Result<(usize, CollidingDraws), RetrainError> {
        let (plan, round) = (self.plan, self.round_number());
        let seed = plan.search_seed(round);
        watch.notify(&RetrainingProgress::SimulatingDraws { round, draws: plan.settings.draws })?;
        let all = (0..plan.settings.draws).map(|index| plan.space.draw(seed, index)).collect::<Result<Vec<_>, _>>()?;
        let indices = colliding_indices(&all, &ControllerKind::Policy(Arc::clone(&self.policy)), plan.estimator())?;
        let collided: Vec<Scenario> = indices.iter().map(|&index| all[index].clone()).collect();
        let classed = classify_scenarios(&collided, &witnesses(&[]), plan.estimator())?;
        let avoidable =
            indices.into_iter().zip(classed).filter(|(_, (class, _))| *class == AvoidabilityClass::Avoidable);
        let indices = avoidable.map(|(index, _)| index as u64).collect();
        Ok((collided.len(), CollidingDraws { round, seed, indices }))
    }

    pub(super) fn extended_cases(&self, found: &RoundFindings) -> Result<Cases, RetrainError> {
        let search = self.run_folder.path(&self.path(SEARCH));
        let read = |name: &String| file::load(&search.join(name)).map(|scenario| scenario.spec().clone());
        let counterexamples = found.counterexamples.iter().map(read).collect::<Result<_, _>>();
        let counterexamples = counterexamples.map_err(|error| RetrainError::Folder(error.to_string()))?;
        self.cases.clone().with_round(&self.plan.space, found.avoidable_draws.clone(), counterexamples)
    }

    /// Trains and evaluates the candidate, decides on it, and writes the record of the round.
    pub(super) fn finish(
        &self,
        found: RoundFindings,
        cases: &Cases,
        watch: &RetrainingObserver<'_>,
    ) -> Result<Round, RetrainError> {
        let scenarios = cases.scenarios(&self.plan.space)?;
        let (trained, candidate, problem) = match self.train(cases, watch) {
            Ok((trained, candidate)) => (trained, Some(Arc::new(candidate)), None),
            Err(RetrainError::Training(diverged @ TrainingError::Diverged { .. })) => {
                self.run_folder.transaction().remove(&self.path(LEARNER)).commit()?;
                let (seed, from_episode) = self.learner_start();
                let trained =
                    RoundTraining { seed, from_episode, to_episode: 0, best_episode: 0, checkpoints: Vec::new() };
                (trained, None, Some(diverged.to_string()))
            }
            Err(other) => return Err(other),
        };
        watch.notify(&RetrainingProgress::Evaluating { round: self.round_number() })?;
        let after = match &candidate {
            Some(candidate) => {
                RegressionResults::evaluate(candidate, self.plan, self.validation_set, self.regression_spaces)?
            }
            None => self.results.clone(),
        };
        let is_new = candidate.as_ref().is_some_and(|candidate| candidate.network() != self.policy.network());
        let acceptance = match problem {
            Some(problem) => Acceptance::Rejected { objections: vec![RejectionReason::Diverged { problem }] },
            None if !is_new => Acceptance::Rejected { objections: vec![RejectionReason::Unchanged] },
            None => decide_acceptance(&self.results, &after),
        };
        let collided = |policy: &Arc<Policy>| {
            colliding_indices(&scenarios, &ControllerKind::Policy(Arc::clone(policy)), self.plan.estimator())
        };
        let round = Round {
            round: self.round_number(),
            before_sha256: self.policy.digest(),
            findings: found,
            cases: scenarios.len(),
            training: trained,
            candidate_sha256: candidate.as_ref().map(|candidate| candidate.digest()),
            in_cases: FailureChange::between(
                &collided(&self.policy)?,
                &collided(candidate.as_ref().unwrap_or(&self.policy))?,
            ),
            in_validation_set: FailureChange::between(&self.results.validation_set, &after.validation_set),
            in_paper: FailureChange::between(&self.results.paper, &after.paper),
            in_nominal: FailureChange::between(&self.results.nominal, &after.nominal),
            acceptance,
            after,
        };
        if let Some(candidate) = &candidate {
            self.run_folder.write(&self.path(CANDIDATE), candidate.to_bytes()?)?;
        }
        write_json(self.run_folder, &self.path(ROUND_RECORD), &round)?;
        Ok(round)
    }
}

pub(super) fn named_policy(name: &str, policy: &Arc<Policy>) -> NamedController {
    NamedController { name: name.to_owned(), kind: ControllerKind::Policy(Arc::clone(policy)) }
}

/// Reads a corpus of the plan from its file, or builds it.
pub(super) fn load_corpus(
    plan: &RetrainingPlan,
    work: &RunFolder,
    (name, seed, wanted): (&'static str, u64, u64),
    watch: &RetrainingObserver<'_>,
) -> Result<Corpus, RetrainError> {
    let witnesses = witnesses(&[named_policy(&plan.initial_policy_name, &plan.initial_policy)]);
    Corpus::load_or_build((work, name), &plan.space, (seed, wanted), &witnesses, plan.estimator(), watch)
}
