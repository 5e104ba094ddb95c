//! One episode of a training, before its first decision, and the choice of its actions.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::super::config::TrainingConfig;
use super::super::environment::{EpisodeConstants, TrainingEpisode};
use super::super::learner::{Learner, Losses};
use super::super::privileged::PrivilegedInfo;
use super::{Trainer, TrainingError};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{Run, RunOptions};
use crumple_sim::random::{self, Purpose, Stream};
use crumple_sim::scenario::Scenario;

/// An episode before its first decision, with its random streams.
pub(super) struct EpisodeSetup<'s> {
    pub(super) episode: TrainingEpisode,
    pub(super) exploration: Exploration,
    pub(super) privileged: PrivilegedPair<'s>,
    pub(super) replay_draws: Stream,
    pub(super) target_noise: Stream,
}

impl<'s> EpisodeSetup<'s> {
    /// Creates the next episode of a training in a scenario of the source, which was drawn with `draws_seed`.
    pub(super) fn new(
        trainer: &Trainer,
        scenario: &'s Scenario,
        draws_seed: u64,
    ) -> Result<Self, TrainingError> {
        let config = &trainer.config;
        let index = trainer.episode;
        let privileged = config.learning.privileged_critic.then(|| {
            let cost_multiplier = trainer.source.cost_multiplier(draws_seed, index);
            PrivilegedInfo::new(scenario, cost_multiplier)
        });
        Ok(Self {
            episode: start_episode(trainer, scenario, draws_seed)?,
            exploration: Exploration::new(
                config,
                index,
                random::stream(trainer.seed, Purpose::Exploration, index),
            ),
            privileged: PrivilegedPair {
                info: privileged,
                numbers: Vec::new(),
            },
            replay_draws: random::stream(trainer.seed, Purpose::ReplaySampling, index),
            target_noise: random::stream(trainer.seed, Purpose::TargetNoise, index),
        })
    }
}

fn start_episode(
    trainer: &Trainer,
    scenario: &Scenario,
    draws_seed: u64,
) -> Result<TrainingEpisode, TrainingError> {
    let config = &trainer.config;
    // Actions replace the ego vehicle's controller at every step; an expert is only consulted.
    let controller = match &config.imitation {
        Some(imitation) => imitation.expert_in(scenario)?,
        None => BuiltInController::MatchLeader(Default::default()),
    };
    let options = RunOptions::new(controller).with_estimator(config.environment.estimator);
    let run = Run::new(scenario, options)?;
    let constants = EpisodeConstants::new(config.environment.clone(), config.learning.discount)
        .for_episode(trainer.source.as_ref(), draws_seed, trainer.episode);
    let episode = TrainingEpisode::new(&run, &constants);
    Ok(match &config.imitation {
        Some(imitation) => episode.with_expert(imitation.expert_estimator),
        None => episode,
    })
}

/// Choice of the actions of an episode.
pub(super) struct Exploration {
    stream: Stream,
    choice: ActionChoice,
}

enum ActionChoice {
    /// Random actions, before learning starts.
    Random {
        /// Number of decisions for which each action holds, and number of decisions until now.
        decisions_held: u64,
        decisions: u64,
        held_action: f32,
    },
    /// The action of the actor with normal noise of this deviation.
    Actor { noise: f32 },
}

impl Exploration {
    fn new(config: &TrainingConfig, index: u64, stream: Stream) -> Self {
        let exploration = &config.exploration;
        let learned_episodes = index.checked_sub(exploration.learning_starts_episode);
        // An imitation follows its actor from the first episode.
        let learned_episodes = learned_episodes.or(config.imitation.as_ref().map(|_| 0));
        let choice = match learned_episodes {
            Some(episodes) => {
                let decay = exploration.noise_decay.powf(episodes as f64);
                ActionChoice::Actor {
                    noise: (exploration.noise * decay) as f32,
                }
            }
            None => {
                let held_action = exploration.random_hold_steps / config.environment.action_repeat;
                ActionChoice::Random {
                    decisions_held: u64::from(held_action).max(1),
                    decisions: 0,
                    held_action: 0.0,
                }
            }
        };
        Self { stream, choice }
    }

    /// Returns whether actions are those of the actor, which then learns.
    pub(super) fn follows_actor(&self) -> bool {
        matches!(self.choice, ActionChoice::Actor { .. })
    }

    pub(super) fn choose_action(&mut self, learner: &mut Learner, state: &[f32]) -> f32 {
        match &mut self.choice {
            ActionChoice::Random {
                decisions_held,
                decisions,
                held_action,
            } => {
                if decisions.is_multiple_of(*decisions_held) {
                    *held_action = self.stream.random_range(-1.0..=1.0);
                }
                *decisions += 1;
                *held_action
            }
            ActionChoice::Actor { noise } => {
                let normal: f32 = StandardNormal.sample(&mut self.stream);
                let chosen = learner.act(state).first().copied().unwrap_or_default();
                (chosen + *noise * normal).clamp(-1.0, 1.0)
            }
        }
    }
}

/// Inputs of a privileged critic before and after a decision; without such a critic there are none.
pub(super) struct PrivilegedPair<'s> {
    info: Option<PrivilegedInfo<'s>>,
    numbers: Vec<f32>,
}

impl PrivilegedPair<'_> {
    /// Appends the inputs at the present step.
    pub(super) fn observe(&mut self, episode: &TrainingEpisode) {
        let inputs = self.info.as_ref().map(|info| info.observe(episode));
        self.numbers.extend(inputs.into_iter().flatten());
    }

    /// Returns the inputs before a decision, and then those after it.
    pub(super) fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Removes the inputs before the decision: those after it are before the next one.
    pub(super) fn advance(&mut self) {
        self.numbers.drain(..self.numbers.len() / 2);
    }
}

/// Sums of the losses of an episode's updates.
#[derive(Default)]
pub(super) struct LossSums {
    pub(super) sums: Losses,
    updates: u32,
}

impl LossSums {
    pub(super) fn add(&mut self, losses: &Losses) {
        self.sums.critic_loss += losses.critic_loss;
        self.sums.mean_value += losses.mean_value;
        self.updates += 1;
    }

    /// Returns the mean of a sum; 0 without updates.
    pub(super) fn mean(&self, sum: f64) -> f64 {
        sum / f64::from(self.updates.max(1))
    }
}
