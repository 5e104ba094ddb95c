//! The level of a state: the hardest braking of the leader for which a plan avoids a collision on both sides.

use super::commands::PlanCommands;
use super::filter::{ObservedRun, PlanChoice, Planner};
use super::params::TwoSidedParams;
use super::state::{Plan, PlanShape, TwoSidedState};
use super::trial::largest_with;
use crate::observation::Observation;

/// Highest level, in m/s²: no road vehicle brakes harder.
pub const MAX_LEVEL_MPS2: f64 = 12.0;

/// Levels per m/s²: a level is a multiple of 0.01 m/s².
const LEVELS_PER_MPS2: f64 = 100.0;

/// Computes the levels of the states of a run, step by step.
#[derive(Debug)]
pub struct LevelMeter {
    planner: Planner,
    run: ObservedRun,
    /// The state at the present step.
    state: Option<TwoSidedState>,
    /// Shape of the last plan, which is likely to suit the next state.
    last: Option<PlanShape>,
    /// The last level, in hundredths of m/s².
    last_level: usize,
}

impl LevelMeter {
    /// Creates a meter for a vehicle without pending commands; the level to keep in the parameters has no effect.
    #[must_use]
    pub fn new(params: TwoSidedParams) -> Self {
        Self {
            planner: Planner::new(params),
            run: ObservedRun::new(&params),
            state: None,
            last: None,
            last_level: 0,
        }
    }

    /// Takes the observation of the next step into account. [`Self::record_command`] follows each call.
    pub fn observe(&mut self, observation: &Observation) {
        self.state = Some(self.run.observe(&self.planner.params, observation, false));
    }

    /// Returns the level of the observed state, in m/s²: rounded down to 0.01, at most [`MAX_LEVEL_MPS2`], and 0 if no
    /// level is above 0, or nothing was observed.
    #[must_use]
    pub fn level_mps2(&mut self) -> f64 {
        let most = (MAX_LEVEL_MPS2 * LEVELS_PER_MPS2).round() as usize;
        // Levels change little from step to step.
        let guess = self.last_level;
        let keeps = |level: usize| level == 0 || self.keeps(level as f64 / LEVELS_PER_MPS2);
        let level = largest_with(keeps, guess, most).unwrap_or(0);
        self.last_level = level;
        level as f64 / LEVELS_PER_MPS2
    }

    /// True if the observed state is in S for a leader that brakes at up to `level_mps2`.
    #[must_use]
    pub fn keeps(&mut self, level_mps2: f64) -> bool {
        self.state
            .and_then(|state| self.plan(state, level_mps2))
            .is_some()
    }

    /// Returns a plan from the observed state on that avoids a collision on both sides with a leader that brakes at up
    /// to `level_mps2`; `None` if there is none, or nothing was observed.
    #[must_use]
    pub fn plan_commands(&mut self, level_mps2: f64) -> Option<PlanCommands> {
        let state = self.state?;
        let plan = self.plan(state, level_mps2)?;
        let params = &self.planner.params;
        let pending_mps2 = self.run.commands.pending_mps2();
        let firings = self.planner.firings();
        Some(PlanCommands::new(
            params,
            &state,
            pending_mps2,
            plan,
            firings,
        ))
    }

    fn plan(&mut self, state: TwoSidedState, level_mps2: f64) -> Option<Plan> {
        self.planner.budget = usize::MAX;
        let pending_mps2 = self.run.commands.pending_mps2();
        let plan =
            self.planner
                .search(state, pending_mps2, level_mps2, self.last, PlanChoice::All)?;
        self.last = Some(plan.shape(self.planner.params.brake_mps2));
        Some(plan)
    }

    /// Accounts for the command of this step, in m/s².
    pub fn record_command(&mut self, command_mps2: f64) {
        self.run.commands.advance(command_mps2);
    }
}
