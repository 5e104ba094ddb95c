//! Imitation of a controller before reinforcement learning: DAgger (Ross, Gordon and Bagnell, 2011).
//!
//! In the first round the expert drives, in each later one the policy. In all rounds the expert's answer to the present
//! situation is recorded at every decision, and the actor is fitted to all rows so far. The rows therefore contain more
//! and more situations that the policy itself causes.

use rand::seq::SliceRandom;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::config_error::{TrainingConfigError, check_range};
use super::environment::{EpisodeConstants, EpisodeEnding, TrainingEpisode, action_bounds};
use super::privileged::has_unaware_follower;
use super::serde_helpers::deserialize_f32_no_underflow;
use super::trainer::{Trainer, TrainingError};
use crumple_core::text_file::is_default;
use crumple_measure::EASY_BRAKE_MPS2;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{Run, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::{FrameStack, Network, Policy, Workspace};
use crumple_sim::random::{self, Purpose};
use crumple_sim::scenario::Scenario;

/// Imitation of a controller (DAgger), and its weight in reinforcement learning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ImitationConfig {
    /// Built-in controller that is imitated, with settings as on the command line.
    pub expert: String,
    /// Expert for scenarios in which the follower has nothing but an emergency brake (`baseline`), if it differs from
    /// `expert`. The policy does not observe which driver the follower has, so it learns the mean of both experts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expert_if_unaware: Option<String>,
    /// Estimator of the expert. With `truth` it knows more than the policy, which learns the mean of its answers.
    pub expert_estimator: EstimatorKind,
    /// Rounds of driving and fitting.
    pub rounds: u32,
    /// Decisions that each round adds.
    pub rows: u64,
    /// Passes of each fit over all rows.
    pub passes: u32,
    /// Rows per step of the optimiser.
    pub batch: usize,
    /// Learning rate (Adam) at the start of a fit; it decreases linearly to 0.
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub rate: f32,
    /// Loss of a difference between the policy's action and the expert's.
    pub loss: ImitationLoss,
    /// Weight of the squared difference between the changes of both actions up to the next decision, relative to the
    /// loss. Keeps noise of the observations out of the actions; 0 for none.
    #[serde(
        default,
        skip_serializing_if = "is_default",
        deserialize_with = "deserialize_f32_no_underflow"
    )]
    pub change_weight: f32,
    /// Weight of a penalty on hard braking in spaces whose `cost_multiplier` is above 1, relative to the loss; 0 for
    /// none.
    /// The penalty is the squared difference by which the policy brakes harder than both the expert and
    /// [`EASY_BRAKE_MPS2`].
    #[serde(
        default,
        skip_serializing_if = "is_default",
        deserialize_with = "deserialize_f32_no_underflow"
    )]
    pub hard_brake_weight: f32,
    /// Weight of the mean squared difference in the actor's loss in the first episode of reinforcement learning
    /// (Fujimoto and Gu, 2021, with a factor that decays).
    #[serde(deserialize_with = "deserialize_f32_no_underflow")]
    pub weight: f32,
    /// Factor on that weight after each episode.
    pub weight_decay: f64,
}

/// Loss of a difference between two actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ImitationLoss {
    /// Squared difference; fits the mean of the answers.
    Squared,
    /// Absolute difference; fits their median.
    Absolute,
}

/// Result of a round.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ImitationRound {
    /// Number of the round, from 1.
    pub round: u32,
    /// Number of rounds.
    pub rounds: u32,
    /// Rows so far.
    pub rows: u64,
    /// Share of the round's episodes that ended in a collision.
    pub collision_share: f64,
    /// Mean loss in the last pass.
    pub loss: f64,
}

/// Episodes that are simulated at once. Fixed, so that the number of threads has no influence.
const EPISODES_AT_ONCE: u64 = 64;
/// Separates the scenarios of imitation from those of reinforcement learning.
const SEED_INDEX: u64 = u64::MAX - 4;

/// Observations and the expert's actions, row after row.
#[derive(Debug, Clone, Default, PartialEq)]
struct Rows {
    states: Vec<f32>,
    actions: Vec<f32>,
    /// Factor on the loss of each row.
    weights: Vec<f32>,
    /// Least action of each row that is not hard braking; -1 where hard braking costs nothing.
    hard_actions: Vec<f32>,
    /// True for the last decision of an episode.
    is_last: Vec<bool>,
    collisions: u64,
    episodes: u64,
}

impl Rows {
    /// Appends the rows of an episode.
    fn append(&mut self, of_episode: Self) {
        self.states.extend(of_episode.states);
        self.actions.extend(of_episode.actions);
        self.weights.extend(of_episode.weights);
        self.hard_actions.extend(of_episode.hard_actions);
        self.is_last.extend(of_episode.is_last);
        self.collisions += of_episode.collisions;
    }

    /// Drops the rows after the first `count`, with `state_width` numbers for each observation.
    fn truncate(&mut self, count: usize, state_width: usize) {
        self.actions.truncate(count);
        self.weights.truncate(count);
        self.hard_actions.truncate(count);
        self.is_last.truncate(count);
        if let Some(last) = self.is_last.last_mut() {
            *last = true;
        }
        self.states.truncate(count * state_width);
    }
}

/// Rows of one step of the optimiser.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct ImitationBatch {
    /// Observations; then those of the next decisions, if changes count.
    pub(super) states: Vec<f32>,
    /// Actions of the expert.
    pub(super) actions: Vec<f32>,
    /// Actions of the expert at the next decisions, if changes count.
    pub(super) next_actions: Vec<f32>,
    /// Factors on the loss.
    pub(super) weights: Vec<f32>,
    /// Least actions that are not hard braking; -1 where hard braking costs nothing.
    pub(super) hard_actions: Vec<f32>,
}

impl ImitationBatch {
    fn clear(&mut self) {
        let Self {
            states,
            actions,
            next_actions,
            weights,
            hard_actions,
        } = self;
        [states, actions, next_actions, weights, hard_actions]
            .into_iter()
            .for_each(Vec::clear);
    }
}

impl ImitationConfig {
    /// Returns the expert in a scenario.
    ///
    /// # Errors
    /// [`TrainingConfigError::Field`] if it is no built-in controller.
    pub fn expert_in(&self, scenario: &Scenario) -> Result<BuiltInController, TrainingConfigError> {
        match &self.expert_if_unaware {
            Some(expert) if has_unaware_follower(scenario) => {
                find_expert("expert_if_unaware", expert)
            }
            _ => find_expert("expert", &self.expert),
        }
    }

    pub(super) fn check(&self) -> Result<(), TrainingConfigError> {
        find_expert("expert", &self.expert)?;
        if let Some(expert) = &self.expert_if_unaware {
            find_expert("expert_if_unaware", expert)?;
        }
        for (field, value, range) in [
            ("rounds", f64::from(self.rounds), [1.0, 1000.0]),
            ("rows", self.rows as f64, [1.0, 1e8]),
            ("passes", f64::from(self.passes), [1.0, 1000.0]),
            ("batch", self.batch as f64, [1.0, 65_536.0]),
            ("rate", f64::from(self.rate), [0.0, 1.0]),
            ("change_weight", f64::from(self.change_weight), [0.0, 1e6]),
            (
                "hard_brake_weight",
                f64::from(self.hard_brake_weight),
                [0.0, 1e6],
            ),
            ("weight", f64::from(self.weight), [0.0, 1e6]),
            ("weight_decay", self.weight_decay, [0.0, 1.0]),
        ] {
            check_range(&format!("imitation.{field}"), value, range)?;
        }
        Ok(())
    }
}

fn find_expert(field: &str, text: &str) -> Result<BuiltInController, TrainingConfigError> {
    let problem =
        |problem: String| TrainingConfigError::field(format!("imitation.{field}"), problem);
    match BuiltInController::parse(text) {
        Some(Ok(expert)) => Ok(expert),
        Some(Err(error)) => Err(problem(error.to_string())),
        None => Err(problem(format!(
            "`{text}` is no built-in controller: see `crumple list`"
        ))),
    }
}

impl Trainer {
    /// Fits the actor to the expert, if there is one, and calls `done` after each round. If the actor started from a
    /// policy, it also drives in the first round, and imitation must not spoil what the policy already does well: in
    /// spaces whose costs count more than once the actor imitates the policy instead of the expert (Li and Hoiem,
    /// 2018), and at the end its weights are the mean of those before and after (Wortsman et al., 2022).
    ///
    /// # Errors
    /// [`TrainingError`] if a scenario cannot be run; the error of `done`.
    pub(super) fn imitate<E: From<TrainingError>>(
        &mut self,
        mut done: impl FnMut(&ImitationRound) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(imitation) = self.config.imitation.clone() else {
            return Ok(());
        };
        let initial = self.actor_if(self.has_initial_policy)?;
        let mut rows = Rows::default();
        for round in 0..imitation.rounds {
            let collisions_before = rows.collisions;
            let episodes_before = rows.episodes;
            let wanted = imitation.rows.saturating_mul(u64::from(round) + 1);
            let driver = self.actor_if(round > 0 || self.has_initial_policy)?;
            self.collect(
                &imitation,
                [driver.as_ref(), initial.as_ref()],
                wanted,
                &mut rows,
            )?;
            let loss = self.fit(&imitation, &rows, round);
            let collisions = rows.collisions - collisions_before;
            let episodes = rows.episodes - episodes_before;
            done(&ImitationRound {
                round: round + 1,
                rounds: imitation.rounds,
                rows: rows.actions.len() as u64,
                collision_share: collisions as f64 / episodes.max(1) as f64,
                loss,
            })?;
        }
        let actor = &mut self.learner.actor;
        if let Some(initial) = &initial {
            average_parameters(&mut actor.network, initial.network());
        }
        actor.target = actor.network.clone();
        Ok(())
    }

    /// Returns the actor as a policy if a condition holds.
    fn actor_if(&self, condition: bool) -> Result<Option<Policy>, TrainingError> {
        condition
            .then(|| self.build_policy(self.learner.actor.network.clone(), 0))
            .transpose()
    }

    /// Adds rows until there are `wanted`. Without a `driver` the expert drives. The `initial` policy, if any, replaces
    /// the expert's answers in spaces whose costs count more than once.
    fn collect(
        &self,
        imitation: &ImitationConfig,
        [driver, initial]: [Option<&Policy>; 2],
        wanted: u64,
        rows: &mut Rows,
    ) -> Result<(), TrainingError> {
        let constants = EpisodeConstants::new(
            self.config.environment.clone(),
            self.config.learning.discount,
        );
        let seed = random::derived_seed(self.seed, SEED_INDEX);
        let hard_action = action_bounds(&self.config.environment).action(-EASY_BRAKE_MPS2);
        while (rows.actions.len() as u64) < wanted {
            let episodes = rows.episodes..rows.episodes + EPISODES_AT_ONCE;
            let driven = episodes.into_par_iter().map(|index| {
                let scenario = self.draw(seed, index)?;
                let options = RunOptions::new(imitation.expert_in(&scenario)?)
                    .with_estimator(self.config.environment.estimator);
                let run = Run::new(&scenario, options)?;
                let episode =
                    TrainingEpisode::new(&run, &constants).with_expert(imitation.expert_estimator);
                let weight = self.source.cost_multiplier(seed, index) as f32;
                let mut rows = drive(episode, driver, initial.filter(|_| weight > 1.0));
                rows.weights.resize(rows.actions.len(), weight);
                let hard = if weight > 1.0 { hard_action } else { -1.0 };
                rows.hard_actions
                    .extend(rows.actions.iter().map(|action| action.min(hard)));
                Ok(rows)
            });
            for of_episode in driven.collect::<Result<Vec<_>, TrainingError>>()? {
                rows.append(of_episode);
            }
            rows.episodes += EPISODES_AT_ONCE;
        }
        rows.truncate(wanted as usize, self.config.environment.observation.width());
        Ok(())
    }

    /// Fits the actor to all rows; returns the mean loss in the last pass.
    fn fit(&mut self, imitation: &ImitationConfig, rows: &Rows, round: u32) -> f64 {
        let width = self.config.environment.observation.width();
        let mut order: Vec<usize> = (0..rows.actions.len()).collect();
        let mut stream = random::stream(self.seed, Purpose::Imitation, u64::from(round));
        let mut adam = Adam::new(self.learner.actor.network.parameters().len());
        let steps = (order.len().div_ceil(imitation.batch) * imitation.passes as usize) as f32;
        let mut sample = ImitationBatch::default();
        let mut last_loss = 0.0;
        for _ in 0..imitation.passes {
            order.shuffle(&mut stream);
            last_loss = 0.0;
            for batch in order.chunks(imitation.batch) {
                sample.clear();
                for &row in batch {
                    sample
                        .states
                        .extend_from_slice(&rows.states[row * width..(row + 1) * width]);
                    sample.actions.push(rows.actions[row]);
                    sample.weights.push(rows.weights[row]);
                    sample.hard_actions.push(rows.hard_actions[row]);
                }
                if imitation.change_weight > 0.0 {
                    for next in batch
                        .iter()
                        .map(|&row| row + usize::from(!rows.is_last[row]))
                    {
                        sample
                            .states
                            .extend_from_slice(&rows.states[next * width..(next + 1) * width]);
                        sample.next_actions.push(rows.actions[next]);
                    }
                }
                let rate = imitation.rate * (1.0 - adam.steps as f32 / steps);
                last_loss += self.learner.imitate(&sample, imitation, &mut adam, rate);
            }
        }
        last_loss / order.len().max(1) as f64
    }
}

/// Replaces each parameter by its mean with that of another network.
fn average_parameters(network: &mut Network, other: &Network) {
    for (parameter, &other) in network.parameters_mut().iter_mut().zip(other.parameters()) {
        *parameter = 0.5 * *parameter + 0.5 * other;
    }
}

/// Drives an episode and records the actions of the expert, or of `instead`.
fn drive(mut episode: TrainingEpisode, driver: Option<&Policy>, instead: Option<&Policy>) -> Rows {
    let mut past = FrameStack::default();
    let mut space = Workspace::default();
    let mut rows = Rows::default();
    loop {
        let state = episode.observe(&mut past);
        rows.states.extend_from_slice(state);
        let answer = instead.map(|policy| policy.choose(state, &mut space));
        let outcome = match driver {
            Some(policy) => {
                let action = policy.choose(state, &mut space);
                episode.step(action)
            }
            None => episode.step_by_expert(),
        };
        rows.actions
            .push(answer.or(outcome.expert_action).unwrap_or_default());
        rows.is_last.push(outcome.ending != EpisodeEnding::None);
        if outcome.ending != EpisodeEnding::None {
            rows.collisions = u64::from(outcome.ending == EpisodeEnding::Collision);
            return rows;
        }
    }
}
