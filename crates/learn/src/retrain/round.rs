//! One round: search, keep, train on, judge.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::acceptance::{Acceptance, Change, RejectionReason, rule};
use super::cases::{Cases, CollidingDraws};
use super::corpus::{Corpus, classes, drive};
use super::files::{LEARNER, RECORD, SELECTION_SET, read_json, write_json};
use super::test_set::witnesses;
use super::plan::{RetrainingPlan, SELECTION_SEED};
use super::progress::{RetrainingProgress, RetrainingObserver};
use super::regression_spaces::RegressionSpaces;
use super::{RetrainError, Standing};
use crate::rl::TrainingError;
use crumple_search::falsify::campaign::{Campaign, CampaignOptions, CampaignProgress};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_store::work::{Work, WorkError};
use crumple_world::policy::Policy;
use crumple_world::scenario::{Scenario, ScenarioSpec, file};
use crumple_world::sim::{ControllerKind, NamedController};

/// What a search found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundFindings {
    /// Evaluations of the campaign, of all its methods together.
    pub evaluations: u64,
    /// Those that ended in contact.
    pub failures: u64,
    /// Distinct counterexamples among them that a driver could have avoided.
    pub avoidable: usize,
    /// Those that no driver could have avoided, by proof.
    pub unavoidable: usize,
    /// Those of which neither is known.
    pub undecided: usize,
    /// Draws of the space that were driven beside.
    pub draws: u64,
    /// Those that ended in contact.
    #[serde(rename = "draws_touched")]
    pub colliding_draws: usize,
    /// Those of them that a driver could have avoided.
    #[serde(rename = "draws_avoidable")]
    pub avoidable_draws: CollidingDraws,
    /// The avoidable counterexamples, as scenarios.
    pub counterexamples: Vec<String>,
}

/// How a round trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundTraining {
    /// Seed of the learner. It goes on from round to round, unless a training diverges.
    pub seed: u64,
    /// Episodes it had done before the round.
    pub from_episode: u64,
    /// Episodes it has done after it; 0 if it diverged.
    pub to_episode: u64,
    /// Episode after which the candidate was taken.
    pub best_episode: u64,
    /// Its checkpoints, in order.
    pub checkpoints: Vec<Checkpoint>,
}

/// A policy on the way, as the selection saw it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// Episodes done.
    pub episode: u64,
    /// Contacts among the avoidable draws of the selection; none if it touched a vehicle in the paper's scenarios or draws.
    pub contacts: Option<u64>,
}

/// The record of a round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Round {
    /// Number, from 1.
    pub round: u64,
    /// SHA-256 of the policy that was searched for failures.
    pub before_sha256: String,
    /// What the search found.
    #[serde(rename = "found")]
    pub findings: RoundFindings,
    /// Cases trained on: those of all rounds so far.
    pub cases: usize,
    /// The training.
    #[serde(rename = "trained")]
    pub training: RoundTraining,
    /// SHA-256 of the candidate; none if the training diverged.
    pub candidate_sha256: Option<String>,
    /// Contacts in all cases, before and after.
    pub in_cases: Change,
    /// In draws kept aside.
    #[serde(rename = "in_kept_aside")]
    pub in_validation_set: Change,
    /// In the paper's scenarios, through the filter and with the true state.
    pub in_paper: Change,
    /// In draws of the paper's distribution.
    pub in_nominal: Change,
    /// The decision.
    pub acceptance: Acceptance,
    /// Where the candidate stands.
    pub after: Standing,
}

/// What a round starts from.
pub(super) struct RoundContext<'a> {
    pub(super) plan: &'a RetrainingPlan,
    pub(super) run_folder: &'a Work,
    pub(super) validation_set: &'a Corpus,
    pub(super) selection_set: &'a Corpus,
    pub(super) regression_spaces: &'a RegressionSpaces,
    pub(super) policy: Arc<Policy>,
    pub(super) results: Standing,
    pub(super) cases: Cases,
    pub(super) previous_round: Option<&'a Round>,
}

/// The file of a candidate.
const CANDIDATE: &str = "candidate.safetensors";
/// What the search found.
const FINDINGS: &str = "found.json";
/// The folder of the search.
const SEARCH: &str = "search";

/// Where a file of a round is in the folder of the retraining.
pub(super) fn round_path(round: u64, name: &str) -> String {
    format!("rounds/{round:02}/{name}")
}

impl Round {
    /// The candidate that was judged, and no other.
    pub(super) fn candidate(&self, work: &Work) -> Result<Policy, RetrainError> {
        let name = in_round(self.round, CANDIDATE);
        let candidate = Policy::from_bytes(&work.read_required(&name)?)?;
        if self.candidate_sha256.as_ref() != Some(&candidate.digest()) {
            let problem = format!("not the policy that {RECORD} judges");
            return Err(WorkError::Damaged { path: work.path(&name), problem }.into());
        }
        Ok(candidate)
    }
}

impl RoundContext<'_> {
    pub(super) fn round_number(&self) -> u64 {
        self.last.map_or(1, |last| last.round + 1)
    }

    /// Where a file of this round is in the folder of the retraining.
    pub(super) fn path(&self, name: &str) -> String {
        in_round(self.number(), name)
    }

    /// Searches for failures; all that was kept is in the result.
    pub(super) fn search(&self, watch: &RetrainingObserver<'_>) -> Result<RoundFindings, RetrainError> {
        if let Some(found) = read_json(self.work, &self.name(FINDINGS))? {
            return Ok(found);
        }
        self.work.write(&self.name("before.safetensors"), self.policy.to_bytes()?)?;
        let (plan, round) = (self.plan, self.number());
        let folder = self.name(SEARCH);
        // Relative to the folder of the counterexamples, so that their recorded verdicts can be replayed.
        let name = "../../before.safetensors".to_owned();
        let campaign = Campaign {
            estimator: plan.estimator(),
            method: plan.method.clone(),
            budget: plan.settings.budget,
            seed: plan.search_seed(round),
            ..Campaign::new(
                NamedController { name, kind: ControllerKind::Policy(Arc::clone(&self.policy)) },
                plan.space.clone(),
            )
        };
        let path = self.work.path(&folder);
        let searching =
            |state: &CampaignProgress| watch.observe(&RetrainingProgress::Searching { round, state: state.clone() });
        let options = CampaignOptions { resume: true, ..CampaignOptions::default() };
        let summary = campaign.run(&path, options, &searching)?;
        self.work.include(&folder)?;
        let classed = |class| summary.counterexamples.iter().filter(move |one| one.avoidability.class() == class);
        let [avoidable, unavoidable, undecided] =
            [AvoidabilityClass::Avoidable, AvoidabilityClass::Unavoidable, AvoidabilityClass::Undecided]
                .map(|class| classed(class).count());
        let counterexamples = classed(AvoidabilityClass::Avoidable).map(|one| one.file.clone()).collect();
        let (draws_touched, draws_avoidable) = self.draws(watch)?;
        let found = RoundFindings {
            evaluations: summary.methods.iter().map(|method| method.evaluations).sum(),
            failures: summary.methods.iter().map(|method| method.failures).sum(),
            avoidable,
            unavoidable,
            undecided,
            draws: plan.settings.draws,
            draws_touched,
            draws_avoidable,
            counterexamples,
        };
        write_json(self.work, &self.name(FINDINGS), &found)?;
        Ok(found)
    }

    /// Draws that end in contact: how many, and which of them could have been avoided.
    fn find_colliding_draws(&self, watch: &RetrainingObserver<'_>) -> Result<(usize, CollidingDraws), RetrainError> {
        let (plan, round) = (self.plan, self.number());
        let seed = plan.search_seed(round);
        watch.notify(&RetrainingProgress::Drawing { round, draws: plan.settings.draws })?;
        let all = (0..plan.settings.draws).map(|index| plan.space.draw(seed, index)).collect::<Result<Vec<_>, _>>()?;
        let contacts = drive(&all, &ControllerKind::Policy(Arc::clone(&self.policy)), plan.estimator())?;
        let touched = all.into_iter().enumerate().zip(contacts).filter(|(_, contact)| contact.is_some());
        let (indices, touched): (Vec<usize>, Vec<Scenario>) = touched.map(|(one, _)| one).unzip();
        let mut survived = vec![false; touched.len()];
        for witness in witnesses(&[]) {
            let contacts = drive(&touched, &witness.kind, plan.estimator())?;
            survived.iter_mut().zip(contacts).for_each(|(survived, contact)| *survived |= contact.is_none());
        }
        let classes = classes(&touched, &survived);
        let avoidable = indices.into_iter().zip(classes).filter(|(_, class)| *class == AvoidabilityClass::Avoidable);
        let indices = avoidable.map(|(index, _)| index as u64).collect();
        Ok((touched.len(), CollidingDraws { round, seed, indices }))
    }

    /// The cases so far and those of this round.
    pub(super) fn extended_cases(&self, found: &RoundFindings) -> Result<Cases, RetrainError> {
        let search = self.work.path(&self.name(SEARCH));
        let read = |name: &String| file::load(&search.join(name)).map(|scenario| scenario.spec().clone());
        let counterexamples: Vec<ScenarioSpec> = found
            .counterexamples
            .iter()
            .map(read)
            .collect::<Result<_, _>>()
            .map_err(|error| RetrainError::Folder(error.to_string()))?;
        self.cases.clone().extended(&self.plan.space, found.draws_avoidable.clone(), counterexamples)
    }

    /// Trains on, judges and decides; leaves the record of the round behind.
    pub(super) fn finish(&self, found: RoundFindings, cases: &Cases, watch: &RetrainingObserver<'_>) -> Result<Round, RetrainError> {
        let scenarios = cases.scenarios(&self.plan.space)?;
        let (trained, candidate, problem) = match self.train(cases, watch) {
            Ok((trained, candidate)) => (trained, Some(Arc::new(candidate)), None),
            Err(RetrainError::Training(diverged @ TrainingError::Diverged { .. })) => {
                self.work.changes().remove(&self.name(LEARNER)).commit()?;
                let (seed, from_episode) = self.learner_start();
                let trained = RoundTraining { seed, from_episode, to_episode: 0, best_episode: 0, checkpoints: Vec::new() };
                (trained, None, Some(diverged.to_string()))
            }
            Err(other) => return Err(other),
        };
        watch.notify(&RetrainingProgress::Judging { round: self.number() })?;
        let after = match &candidate {
            Some(candidate) => Standing::of(candidate, self.plan, self.kept_aside, self.regression)?,
            None => self.standing.clone(),
        };
        let is_new = candidate.as_ref().is_some_and(|candidate| candidate.network() != self.policy.network());
        let acceptance = match problem {
            Some(problem) => Acceptance::Rejected { objections: vec![RejectionReason::Diverged { problem }] },
            None if !is_new => Acceptance::Rejected { objections: vec![RejectionReason::Unchanged] },
            None => rule(&self.standing, &after),
        };
        let touched = |policy: &Arc<Policy>| -> Result<Vec<usize>, RetrainError> {
            let contacts = drive(&scenarios, &ControllerKind::Policy(Arc::clone(policy)), self.plan.estimator())?;
            Ok((0..scenarios.len()).zip(contacts).filter(|(_, contact)| contact.is_some()).map(|(at, _)| at).collect())
        };
        let round = Round {
            round: self.number(),
            before_sha256: self.policy.digest(),
            found,
            cases: scenarios.len(),
            trained,
            candidate_sha256: candidate.as_ref().map(|candidate| candidate.digest()),
            in_cases: Change::between(&touched(&self.policy)?, &touched(candidate.as_ref().unwrap_or(&self.policy))?),
            in_kept_aside: Change::between(&self.standing.kept_aside, &after.kept_aside),
            in_paper: Change::between(&self.standing.paper, &after.paper),
            in_nominal: Change::between(&self.standing.nominal, &after.nominal),
            acceptance,
            after,
        };
        if let Some(candidate) = &candidate {
            self.work.write(&self.name(CANDIDATE), candidate.to_bytes()?)?;
        }
        write_json(self.work, &self.name(RECORD), &round)?;
        Ok(round)
    }
}

/// The avoidable draws that select checkpoints.
pub(super) fn load_selection_set(plan: &RetrainingPlan, work: &Work, watch: &RetrainingObserver<'_>) -> Result<Corpus, RetrainError> {
    gathered(plan, work, (SELECTION_SET, SELECTION_SEED, plan.training.evaluation.ranking_draws), watch)
}

/// A corpus of the plan in its file.
pub(super) fn load_corpus(
    plan: &RetrainingPlan,
    work: &Work,
    (name, seed, wanted): (&'static str, u64, u64),
    watch: &RetrainingObserver<'_>,
) -> Result<Corpus, RetrainError> {
    let first =
        NamedController { name: plan.first_name.clone(), kind: ControllerKind::Policy(Arc::clone(&plan.first)) };
    let witnesses = witnesses(&[first]);
    Corpus::at((work, name), &plan.space, (seed, wanted), &witnesses, plan.estimator(), watch)
}
