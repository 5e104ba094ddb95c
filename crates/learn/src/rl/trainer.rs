//! One training: episodes, updates, evaluations, and the best policy so far.

mod episode;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::episode::{EpisodeSetup, LossSums};

use super::config::{TimeLimit, TrainingConfig};
use super::config_error::TrainingConfigError;
use super::environment::{EpisodeEnding, action_bounds};
use super::evaluation::{EvaluationSet, PolicyEvaluation};
use super::learner::Learner;
use super::replay::{Batch, ReplayBuffer, Transition};
use super::source::{PaperSource, ScenarioSource, unsuitability};
use crumple_core::digits::format_rounded;
use crumple_core::observer::Stopped;
use crumple_sim::engine::RunError;
use crumple_sim::policy::{FrameStack, Network, POLICY_VERSION, Policy, PolicyError, PolicyHeader};
use crumple_sim::random;
use crumple_sim::scenario::{InvalidField, PAPER_STEP_S, Scenario};
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// A batch whose mean value exceeds the largest possible value by this factor counts as diverged.
const DIVERGENCE_FACTOR: f64 = 10.0;

/// Reason why a training stops early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainingError {
    /// The networks hold numbers that are not finite, or values that no return can have.
    #[error(
        "seed {seed} diverged in episode {episode}: critic loss {}, mean value {} (no value can exceed {}); lower the \
         learning rates or scale the reward",
        format_rounded(*critic_loss, 4),
        format_rounded(*mean_value, 4),
        format_rounded(*largest_value, 4)
    )]
    Diverged {
        /// Seed of the training.
        seed: u64,
        /// Episode, from 1.
        episode: u64,
        /// Mean critic loss of the episode's updates.
        critic_loss: f64,
        /// Mean value over the episode's updates.
        mean_value: f64,
        /// Largest possible value.
        largest_value: f64,
    },
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] TrainingConfigError),
    /// The agent cannot be trained on a scenario that was drawn.
    #[error("scenario `{name}` cannot be trained on: {problem}")]
    UnsuitableScenario {
        /// Name of the scenario.
        name: String,
        /// Reason, as a clause.
        problem: String,
    },
    /// A scenario cannot be drawn.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A run cannot be created.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The policy cannot be created.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The observer stopped the training.
    #[error("the training was {0}")]
    Stopped(#[from] Stopped),
    /// A checkpoint cannot be used.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
    /// The identity of the scenario source cannot be encoded.
    #[error("the scenarios of the training cannot be written: {0}")]
    SourceEncoding(#[from] serde_json::Error),
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A folder or the running program cannot be read.
    #[error(transparent)]
    Disk(#[from] DiskError),
}

/// Record of one episode in the log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Number, from 1.
    pub episode: u64,
    /// Reward as in the paper, at most 22 500.
    pub reward: f64,
    /// Steps simulated.
    pub steps: usize,
    /// Ending of the episode.
    pub ending: EpisodeEnding,
    /// Mean critic loss of the episode's updates.
    pub critic_loss: f64,
    /// Mean value over the episode's updates.
    pub mean_value: f64,
}

/// The best policy so far.
#[derive(Debug, Clone, PartialEq)]
pub struct BestPolicy {
    /// Episode after which the policy was evaluated.
    pub episode: u64,
    /// Evaluation of the policy.
    pub evaluation: PolicyEvaluation,
    /// Actor of the policy.
    pub network: Network,
}

/// A training under way.
#[derive(Debug, Clone)]
pub struct Trainer {
    pub(super) config: TrainingConfig,
    pub(super) seed: u64,
    pub(super) learner: Learner,
    pub(super) replay: ReplayBuffer,
    pub(super) episode: u64,
    pub(super) decisions: u64,
    pub(super) best: Option<BestPolicy>,
    pub(super) mastered: bool,
    /// True if the actor started from a policy, which an imitation must not spoil.
    pub(super) has_initial_policy: bool,
    /// Mean of the actor's weights over updates; none if it is not used, and before the first update.
    pub(super) weight_average: Option<Network>,
    pub(super) source: Arc<dyn ScenarioSource>,
    batch: Batch,
}

impl Trainer {
    /// Creates a training on the paper's distribution.
    #[must_use]
    pub fn new(config: &TrainingConfig, seed: u64) -> Self {
        Self::with_source(config, seed, Arc::new(PaperSource))
    }

    /// Creates a training on any source. The spaces in `config` must be those of the source, because policy files name
    /// the spaces of `config`.
    #[must_use]
    pub fn with_source(
        config: &TrainingConfig,
        seed: u64,
        source: Arc<dyn ScenarioSource>,
    ) -> Self {
        Self {
            learner: Learner::new(config, seed),
            replay: ReplayBuffer::new(config.replay.capacity, config.transition_layout()),
            config: config.clone(),
            seed,
            episode: 0,
            decisions: 0,
            best: None,
            mastered: false,
            has_initial_policy: false,
            weight_average: None,
            source,
            batch: Batch::default(),
        }
    }

    /// Starts the actor and its target from the weights of `policy`, if it has the same shape. Critics start anew. An
    /// imitation then starts from the policy, and preserves its good behaviour in spaces with a cost multiplier above
    /// 1.
    #[must_use]
    pub fn with_initial_policy(mut self, policy: &Policy) -> Self {
        let actor = &mut self.learner.actor;
        if actor.network.sizes() == policy.network().sizes() {
            actor.network = policy.network().clone();
            actor.target = policy.network().clone();
            self.has_initial_policy = true;
        }
        self
    }

    /// Continues with another source until `episodes` are done; resets only the best policy.
    pub fn switch_source(&mut self, source: Arc<dyn ScenarioSource>, episodes: u64) {
        self.source = source;
        self.config.episodes = episodes;
        (self.best, self.mastered) = (None, false);
    }

    /// Returns the seed.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Returns the number of completed episodes.
    #[must_use]
    pub fn episode(&self) -> u64 {
        self.episode
    }

    /// Returns the best policy so far.
    #[must_use]
    pub fn best(&self) -> Option<&BestPolicy> {
        self.best.as_ref()
    }

    /// True if all episodes are done, or the policy masters the task ([`PolicyEvaluation::is_mastered`]).
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.mastered || self.episode >= self.config.episodes
    }

    /// True if an evaluation is due after the last episode.
    #[must_use]
    pub fn is_evaluation_due(&self) -> bool {
        self.is_evaluation_episode(self.episode) || self.episode == self.config.episodes
    }

    /// True if an evaluation is due after `episode`, independent of the total number of episodes.
    pub(super) fn is_evaluation_episode(&self, episode: u64) -> bool {
        episode.is_multiple_of(self.config.evaluation.every_episodes)
            && episode > self.config.exploration.learning_starts_episode
    }

    /// Simulates one episode and learns from it.
    ///
    /// # Errors
    /// [`TrainingError::Diverged`] if the training diverges; [`TrainingError::Scenario`] and
    /// [`TrainingError::UnsuitableScenario`] if the source draws a scenario that is invalid or cannot be trained on.
    pub fn run_episode(&mut self) -> Result<EpisodeRecord, TrainingError> {
        // A derived seed keeps training scenarios apart from every seed that a user may assess with.
        let draws_seed = random::derived_seed(self.seed, u64::MAX);
        let scenario = self.draw(draws_seed, self.episode)?;
        let mut setup = EpisodeSetup::new(self, &scenario, draws_seed)?;
        self.prepare_learner();
        let mut losses = LossSums::default();
        let ending = self.make_decisions(&mut setup, &mut losses);
        self.episode += 1;
        let record = EpisodeRecord {
            episode: self.episode,
            reward: setup.episode.total_reward(),
            steps: setup.episode.steps_made(),
            ending,
            critic_loss: losses.mean(losses.sums.critic_loss),
            mean_value: losses.mean(losses.sums.mean_value),
        };
        self.check_divergence(&record, scenario.steps())?;
        Ok(record)
    }

    /// Sets what depends on the number of the episode.
    fn prepare_learner(&mut self) {
        let index = self.episode;
        let learning_starts = self.config.exploration.learning_starts_episode;
        self.learner.is_actor_frozen = index < learning_starts;
        if let Some(imitation) = &self.config.imitation {
            self.learner.imitation_weight =
                imitation.weight * libm::pow(imitation.weight_decay, index as f64) as f32;
        }
        if let Some(decay) = &self.config.learning.lr_decay {
            self.learner.lr_factor = decay.factor(index, learning_starts) as f32;
        }
    }

    /// Decides, and learns from the decisions, until the episode ends.
    fn make_decisions(
        &mut self,
        setup: &mut EpisodeSetup<'_>,
        losses: &mut LossSums,
    ) -> EpisodeEnding {
        let mut past = FrameStack::default();
        let mut state = setup.episode.observe(&mut past).to_vec();
        setup.privileged.observe(&setup.episode);
        loop {
            let action = setup.exploration.choose_action(&mut self.learner, &state);
            let after = setup.episode.step(action);
            let next_state = setup.episode.observe(&mut past);
            setup.privileged.observe(&setup.episode);
            self.replay.push(&Transition {
                state: &state,
                next_state,
                privileged: setup.privileged.numbers(),
                action,
                reward: after.reward,
                continues: after.continues,
                collision: after.ending == EpisodeEnding::Collision,
                expert_action: after.expert_action,
            });
            state.copy_from_slice(next_state);
            setup.privileged.advance();
            self.decisions += 1;
            if setup.exploration.follows_actor() {
                self.learn_if_due(setup, losses);
            }
            if after.ending != EpisodeEnding::None {
                return after.ending;
            }
        }
    }

    /// Updates the networks if an update is due, and the replay memory has enough transitions.
    fn learn_if_due(&mut self, setup: &mut EpisodeSetup<'_>, losses: &mut LossSums) {
        let learning = &self.config.learning;
        let interval = u64::from(learning.decisions_per_update);
        if !self.decisions.is_multiple_of(interval) || self.replay.len() < learning.batch {
            return;
        }
        self.replay.sample(
            &mut setup.replay_draws,
            learning.batch,
            self.config.replay.collision_fraction,
            &mut self.batch,
        );
        losses.add(&self.learner.update(&self.batch, &mut setup.target_noise));
        self.update_weight_average();
    }

    /// Returns a scenario of the source, if the agent can be trained on it.
    pub(super) fn draw(&self, seed: u64, index: u64) -> Result<Scenario, TrainingError> {
        let scenario = self.source.draw(seed, index)?;
        match unsuitability(&scenario) {
            Some(problem) => Err(TrainingError::UnsuitableScenario {
                name: scenario.spec().name.clone(),
                problem,
            }),
            None => Ok(scenario),
        }
    }

    fn check_divergence(&self, record: &EpisodeRecord, steps: usize) -> Result<(), TrainingError> {
        let environment = &self.config.environment;
        let decision_reward = environment.step_reward * f64::from(environment.action_repeat);
        let discounted = decision_reward / (1.0 - self.config.learning.discount);
        // With termination at the time limit, no value exceeds the reward of one episode.
        let paid = match environment.time_limit {
            TimeLimit::Truncation => discounted,
            TimeLimit::Termination => discounted.min(steps as f64 * environment.step_reward),
        };
        let most_cost = (self.source.max_cost_multiplier() * environment.costs.max_cost()).max(1.0);
        // The harm of two vehicles is at most 2.
        let dearest_collision = -environment.collision_reward - 2.0 * environment.harm_reward;
        let largest_value = environment.reward_scale * most_cost * paid.max(dearest_collision);
        let critic_loss = record.critic_loss;
        let mean_value = record.mean_value;
        // ReLU turns NaN into 0, so the outputs of a broken network can be finite.
        let is_whole = self
            .learner
            .networks()
            .all(|network| network.parameters().iter().all(|value| value.is_finite()));
        if is_whole
            && critic_loss.is_finite()
            && mean_value.abs() <= DIVERGENCE_FACTOR * largest_value
        {
            return Ok(());
        }
        Err(TrainingError::Diverged {
            seed: self.seed,
            episode: record.episode,
            critic_loss,
            mean_value,
            largest_value,
        })
    }

    /// Evaluates the actor and keeps it if it is the best so far. Before the first episode, an actor that masters the
    /// task does not end the training.
    ///
    /// # Errors
    /// [`TrainingError::Run`] and [`TrainingError::Policy`], for a configuration that does not fit the scenarios.
    pub fn evaluate(
        &mut self,
        held_out: &EvaluationSet,
    ) -> Result<PolicyEvaluation, TrainingError> {
        let network = self.evaluation_network().clone();
        let policy = Arc::new(self.build_policy(network.clone(), self.episode)?);
        let evaluation = held_out.evaluate(&policy)?;
        let better = self
            .best
            .as_ref()
            .is_none_or(|best| evaluation.score() > best.evaluation.score());
        if better {
            self.best = Some(BestPolicy {
                episode: self.episode,
                evaluation,
                network,
            });
        }
        let master_gap_m = self.config.evaluation.master_gap_m;
        self.mastered |=
            self.episode > 0 && master_gap_m > 0.0 && evaluation.is_mastered(master_gap_m);
        Ok(evaluation)
    }

    /// Returns the best policy so far, or the present one before the first evaluation.
    ///
    /// # Errors
    /// [`TrainingError::Policy`] in principle; the trainer creates only valid ones.
    pub fn policy(&self) -> Result<Policy, TrainingError> {
        match &self.best {
            Some(best) => self.build_policy(best.network.clone(), best.episode),
            None => self.build_policy(self.evaluation_network().clone(), self.episode),
        }
    }

    fn evaluation_network(&self) -> &Network {
        self.weight_average
            .as_ref()
            .unwrap_or(&self.learner.actor.network)
    }

    /// Adds the actor's weights to their mean: a plain mean over the first updates, an exponential one after that.
    fn update_weight_average(&mut self) {
        let over = self.config.evaluation.weight_average_updates;
        if over == 0 {
            return;
        }
        let actor = &self.learner.actor.network;
        let mean = self.weight_average.get_or_insert_with(|| actor.clone());
        let share = 1.0 / self.learner.updates.clamp(1, over) as f32;
        for (mean, &weight) in mean.parameters_mut().iter_mut().zip(actor.parameters()) {
            *mean += share * (weight - *mean);
        }
    }

    pub(super) fn build_policy(
        &self,
        network: Network,
        episode: u64,
    ) -> Result<Policy, TrainingError> {
        let mut training = self
            .config
            .to_header_value()
            .map_err(|e| TrainingError::Checkpoint(e.to_string()))?;
        if let (Some(training), Some(source)) = (training.as_object_mut(), self.source.identity()?)
        {
            training.insert("scenarios".to_owned(), source.into());
        }
        let header = PolicyHeader {
            version: POLICY_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            hidden: self.config.network.hidden.clone(),
            observation: self.config.environment.observation.scaling(),
            action: action_bounds(&self.config.environment),
            decision_interval_s: f64::from(self.config.environment.action_repeat) * PAPER_STEP_S,
            estimator: self.config.environment.estimator,
            seed: self.seed,
            episode,
            training,
        };
        Ok(Policy::new(header, network)?)
    }
}
