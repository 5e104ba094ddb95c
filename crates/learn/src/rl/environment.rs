//! Simulation of the paper's Markov decision process (section "Markov decision process").

use std::ops::ControlFlow;
use std::sync::Arc;

use super::config::{EnvironmentConfig, TimeLimit};
use super::reward::RewardTracker;
use super::source::{EGO, ScenarioSource};
use crumple_measure::harm;
use crumple_sim::engine::{Motion, Run, StepView, Stepper};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::{ActionBounds, FrameStack, HeldAction, ObservationScaling};

/// Time for which all vehicles must have stood before an episode ends at rest, in seconds. It spans several decisions.
const MIN_REST_S: f64 = 0.5;

/// Ending of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum EpisodeEnding {
    /// The episode continues.
    None,
    /// Termination by a collision.
    #[serde(alias = "contact")]
    Collision,
    /// Termination at permanent standstill of all vehicles; the rest of the reward is credited.
    AtRest,
    /// Time limit of the scenario: truncation, or termination if configured.
    #[serde(alias = "time-over")]
    TimeLimit,
}

/// Result of a decision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOutcome {
    /// Scaled reward. At rest it includes the value of all further standstill.
    pub reward: f32,
    /// Ending of the episode, if it ended.
    pub ending: EpisodeEnding,
    /// True if the value of the next state is bootstrapped.
    pub continues: bool,
    /// Action of the expert at the decision, in `[-1, 1]`; none without one.
    pub expert_action: Option<f32>,
}

/// Constants of all episodes of a configuration, shared to save memory traffic when many episodes are stepped in turn.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeConstants {
    environment: EnvironmentConfig,
    discount: f64,
    scaling: ObservationScaling,
    action_bounds: ActionBounds,
}

impl EpisodeConstants {
    /// Creates the constants of a configuration. `discount` is per decision.
    #[must_use]
    pub fn new(config: EnvironmentConfig, discount: f64) -> Arc<Self> {
        Arc::new(Self {
            discount,
            scaling: config.observation.scaling(),
            action_bounds: action_bounds(&config),
            environment: config,
        })
    }

    /// Returns the constants of episode `index` of a source, which can scale the costs.
    #[must_use]
    pub fn for_episode(
        self: &Arc<Self>,
        source: &dyn ScenarioSource,
        seed: u64,
        index: u64,
    ) -> Arc<Self> {
        match source.cost_multiplier(seed, index) {
            1.0 => Arc::clone(self),
            times => {
                let costs = self.environment.costs.scaled_by(times);
                Self::new(
                    EnvironmentConfig {
                        costs,
                        ..self.environment.clone()
                    },
                    self.discount,
                )
            }
        }
    }

    /// Returns the numbers of an observation, without its history.
    #[must_use]
    pub fn state_width(&self) -> usize {
        self.scaling.width()
    }

    /// Returns the environment.
    #[must_use]
    pub fn environment(&self) -> &EnvironmentConfig {
        &self.environment
    }
}

/// Episode in progress.
pub struct TrainingEpisode {
    stepper: Stepper,
    config: Arc<EpisodeConstants>,
    reward_tracker: RewardTracker,
    held_action: HeldAction,
    total_steps: usize,
    min_rest_steps: usize,
    steps_at_rest: usize,
    undiscounted_return: f64,
}

/// Rewards of the steps between two decisions.
struct DecisionRewards<'e> {
    tracker: &'e mut RewardTracker,
    config: &'e EnvironmentConfig,
    min_rest_steps: usize,
    steps_at_rest: &'e mut usize,
    sum: f64,
    of_last_step: f64,
    ending: EpisodeEnding,
}

impl DecisionRewards<'_> {
    /// Adds the reward of a step. Breaks if the episode ended.
    fn record(&mut self, now: &StepView<'_>) -> ControlFlow<()> {
        self.of_last_step = self.tracker.step_reward(now, self.config);
        self.sum += self.of_last_step;
        let at_rest = now.motion.iter().all(|motion| motion.speed_mps == 0.0);
        *self.steps_at_rest = if at_rest { *self.steps_at_rest + 1 } else { 0 };
        self.ending = if now.has_collided {
            EpisodeEnding::Collision
        } else if now.has_ended {
            EpisodeEnding::TimeLimit
        } else if *self.steps_at_rest >= self.min_rest_steps {
            EpisodeEnding::AtRest
        } else {
            EpisodeEnding::None
        };
        if self.ending == EpisodeEnding::None {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    }
}

/// Steps until the next decision, with a command or under the expert. Returns the expert's first answer, in m/s².
fn step_with_expert(
    stepper: &mut Stepper,
    command_mps2: Option<f64>,
    rewards: &mut DecisionRewards<'_>,
) -> Option<f64> {
    let mut first_answer_mps2 = None;
    for _ in 0..rewards.config.action_repeat {
        if stepper.observe(EGO).is_none() {
            break;
        }
        if let Some(command_mps2) = command_mps2 {
            stepper.command(EGO, command_mps2);
        }
        stepper.step();
        first_answer_mps2 = first_answer_mps2.or(stepper.consulted_mps2(EGO));
        if rewards.record(&stepper.view(EGO)).is_break() || stepper.has_ended() {
            break;
        }
    }
    first_answer_mps2
}

impl TrainingEpisode {
    /// Starts an episode of a run with one vehicle under test behind the leader.
    #[must_use]
    pub fn new(run: &Run, constants: &Arc<EpisodeConstants>) -> Self {
        let stepper = Stepper::without_summaries(run);
        Self {
            reward_tracker: RewardTracker::new(
                &stepper,
                run.scenario().spec().step_s,
                &constants.environment.costs,
            ),
            stepper,
            config: Arc::clone(constants),
            held_action: HeldAction::default(),
            total_steps: run.scenario().steps(),
            min_rest_steps: (MIN_REST_S / run.scenario().spec().step_s).round() as usize,
            steps_at_rest: 0,
            undiscounted_return: 0.0,
        }
    }

    /// Makes the run's controller the expert: it answers at every step, and observes as `estimator` says.
    #[must_use]
    pub fn with_expert(mut self, estimator: EstimatorKind) -> Self {
        self.stepper.consult(EGO, estimator);
        self
    }

    /// Writes the present observation, [`ObservationScaling::width`] numbers.
    pub fn write_state(&mut self, state: &mut [f32]) {
        let last_answer_mps2 = self.held_action.last_answer_mps2();
        if let Some(observation) = self.stepper.observe(EGO) {
            self.config
                .scaling
                .write_state(&observation, last_answer_mps2, state);
        }
    }

    /// Returns the present observation and its history.
    pub fn observe<'p>(&mut self, past: &'p mut FrameStack) -> &'p [f32] {
        let last_answer_mps2 = self.held_action.last_answer_mps2();
        match self.stepper.observe(EGO) {
            Some(observation) => past.push(&self.config.scaling, &observation, last_answer_mps2),
            None => &[],
        }
    }

    /// Holds an action, in `[-1, 1]`, until the next decision.
    pub fn step(&mut self, action: f32) -> StepOutcome {
        self.held_action.set(action);
        self.advance(true)
    }

    /// Lets the expert drive until the next decision.
    pub fn step_by_expert(&mut self) -> StepOutcome {
        self.advance(false)
    }

    fn advance(&mut self, is_commanded: bool) -> StepOutcome {
        let EpisodeConstants {
            environment: config,
            action_bounds: bounds,
            ..
        } = &*self.config;
        let acceleration_mps2 = self.held_action.acceleration_mps2(bounds);
        let mut rewards = DecisionRewards {
            tracker: &mut self.reward_tracker,
            config,
            min_rest_steps: self.min_rest_steps,
            steps_at_rest: &mut self.steps_at_rest,
            sum: 0.0,
            of_last_step: 0.0,
            ending: EpisodeEnding::None,
        };
        let mut expert_action = None;
        if self.stepper.consulted_mps2(EGO).is_some() {
            let command_mps2 = is_commanded.then_some(acceleration_mps2);
            let first_answer_mps2 = step_with_expert(&mut self.stepper, command_mps2, &mut rewards);
            expert_action = first_answer_mps2.map(|answer_mps2| bounds.action(answer_mps2));
            if !is_commanded && let Some(last_mps2) = self.stepper.consulted_mps2(EGO) {
                self.held_action.set_last_answer_mps2(last_mps2);
            }
        } else {
            self.stepper.drive(
                EGO,
                config.action_repeat as usize,
                |_| acceleration_mps2,
                |now: &StepView<'_>| rewards.record(now),
            );
        }
        let mut reward = rewards.sum;
        let of_last_step = rewards.of_last_step;
        let ending = rewards.ending;
        if ending == EpisodeEnding::Collision && config.harm_reward != 0.0 {
            reward +=
                config.harm_reward * harm(self.stepper.impacts(), self.stepper.motion().len());
        }
        self.undiscounted_return += reward;
        let mut to_learn = reward;
        if ending == EpisodeEnding::AtRest {
            let steps_left = (self.total_steps - self.stepper.step_count()) as f64;
            self.undiscounted_return += steps_left * of_last_step;
            let decisions_left = steps_left / f64::from(config.action_repeat);
            to_learn += self.config.discount * self.standstill_return(of_last_step, decisions_left);
        }
        StepOutcome {
            reward: (to_learn * self.config.environment.reward_scale) as f32,
            ending,
            continues: !self.is_terminal(ending),
            expert_action,
        }
    }

    /// True if no reward follows an ending, so that the value of the next state does not count.
    fn is_terminal(&self, ending: EpisodeEnding) -> bool {
        match ending {
            EpisodeEnding::Collision | EpisodeEnding::AtRest => true,
            EpisodeEnding::TimeLimit => {
                self.config.environment.time_limit == TimeLimit::Termination
            }
            EpisodeEnding::None => false,
        }
    }

    /// Returns the discounted reward of standing still for the decisions that are left. If the time limit is a
    /// truncation, the reward continues for ever.
    fn standstill_return(&self, step_reward: f64, decisions_left: f64) -> f64 {
        let decision_reward = step_reward * f64::from(self.config.environment.action_repeat);
        let for_ever = decision_reward / (1.0 - self.config.discount);
        match self.config.environment.time_limit {
            TimeLimit::Truncation => for_ever,
            TimeLimit::Termination => for_ever * (1.0 - self.config.discount.powf(decisions_left)),
        }
    }

    /// Returns the reward so far as in the paper: undiscounted and unscaled, 22 500 for an episode without a collision.
    pub(crate) fn total_reward(&self) -> f64 {
        self.undiscounted_return
    }

    /// Returns the motion of all vehicles, front to rear.
    #[must_use]
    pub fn motion(&self) -> &[Motion] {
        self.stepper.motion()
    }

    pub(crate) fn steps_made(&self) -> usize {
        self.stepper.step_count()
    }
}

/// Returns the range of accelerations of the actions.
#[must_use]
pub fn action_bounds(config: &EnvironmentConfig) -> ActionBounds {
    ActionBounds {
        high_mps2: config.max_accel_mps2,
        ..ActionBounds::default()
    }
}

#[cfg(test)]
mod tests;
