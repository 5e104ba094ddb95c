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
    Contact,
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
        if let Some(seen) = self.stepper.observe(EGO) {
            self.config
                .scaling
                .write_state(&seen, last_answer_mps2, state);
        }
    }

    /// Returns the present observation and its history.
    pub fn observe<'p>(&mut self, past: &'p mut FrameStack) -> &'p [f32] {
        let last_answer_mps2 = self.held_action.last_answer_mps2();
        match self.stepper.observe(EGO) {
            Some(seen) => past.push(&self.config.scaling, &seen, last_answer_mps2),
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
        let Self {
            stepper,
            config: constants,
            reward_tracker,
            held_action,
            steps_at_rest,
            ..
        } = self;
        let mut expert_action = None;
        let EpisodeConstants {
            environment: config,
            action_bounds: bounds,
            ..
        } = &**constants;
        let (mut reward, mut of_last_step, mut ending) = (0.0, 0.0, EpisodeEnding::None);
        let acceleration_mps2 = held_action.acceleration_mps2(bounds);
        let mut after = |now: &StepView<'_>| {
            of_last_step = reward_tracker.step_reward(now, config);
            reward += of_last_step;
            let at_rest = now.motion.iter().all(|motion| motion.speed_mps == 0.0);
            *steps_at_rest = if at_rest { *steps_at_rest + 1 } else { 0 };
            ending = if now.has_collided {
                EpisodeEnding::Contact
            } else if now.has_ended {
                EpisodeEnding::TimeLimit
            } else if *steps_at_rest >= self.min_rest_steps {
                EpisodeEnding::AtRest
            } else {
                EpisodeEnding::None
            };
            if ending == EpisodeEnding::None {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        };
        if stepper.consulted_mps2(EGO).is_some() {
            for _ in 0..config.action_repeat {
                if stepper.observe(EGO).is_none() {
                    break;
                }
                if is_commanded {
                    stepper.command(EGO, acceleration_mps2);
                }
                stepper.step();
                let answer_mps2 = stepper.consulted_mps2(EGO);
                expert_action =
                    expert_action.or(answer_mps2.map(|answer_mps2| bounds.action(answer_mps2)));
                if after(&stepper.view(EGO)).is_break() || stepper.has_ended() {
                    break;
                }
            }
            if !is_commanded && let Some(last_mps2) = stepper.consulted_mps2(EGO) {
                held_action.set_last_answer_mps2(last_mps2);
            }
        } else {
            stepper.drive(
                EGO,
                config.action_repeat as usize,
                |_| acceleration_mps2,
                after,
            );
        }
        if ending == EpisodeEnding::Contact && config.harm_reward != 0.0 {
            reward += config.harm_reward * harm(stepper.impacts(), stepper.motion().len());
        }
        self.undiscounted_return += reward;
        let mut to_learn = reward;
        if ending == EpisodeEnding::AtRest {
            let steps_left = (self.total_steps - self.stepper.step_count()) as f64;
            self.undiscounted_return += steps_left * of_last_step;
            let decisions_left = steps_left / f64::from(self.config.environment.action_repeat);
            to_learn += self.config.discount * self.standstill_return(of_last_step, decisions_left);
        }
        let over = matches!(ending, EpisodeEnding::Contact | EpisodeEnding::AtRest)
            || (ending == EpisodeEnding::TimeLimit
                && self.config.environment.time_limit == TimeLimit::Termination);
        StepOutcome {
            reward: (to_learn * self.config.environment.reward_scale) as f32,
            ending,
            continues: !over,
            expert_action,
        }
    }

    /// Returns the discounted reward of standing still for the decisions that are left. If the time limit is a
    /// truncation, the reward continues for ever.
    fn standstill_return(&self, step_reward: f64, decisions_left: f64) -> f64 {
        let each = step_reward * f64::from(self.config.environment.action_repeat);
        let for_ever = each / (1.0 - self.config.discount);
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
