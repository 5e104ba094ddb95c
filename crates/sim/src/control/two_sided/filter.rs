//! The filter: passes a command if a plan exists after it, and executes the stored plan otherwise.

use super::params::{FollowerClass, FollowerTrigger, NOTICED_BRAKE_MPS2, TwoSidedParams};
use super::state::{FollowerPhase, FollowerState, Plan, PlanShape, TwoSidedState};
use super::trial::{FIRING_WORK, Paths, Trial};
use crate::control::shield::CommandMemory;
use crate::control::{Override, clamp_command};
use crate::observation::Observation;

/// Shares of full braking until the follower's brake fires.
const BRAKE_SHARES: [f64; 5] = [1.0, 0.8, 0.6, 0.4, 0.2];

/// Speeds below that of the follower at which a plan stops braking and holds its speed, in m/s.
const SLOWER_BY_MPS: [f64; 5] = [5.0, 7.5, 10.0, 12.5, 16.0];

/// Work of a search at most, except for the first one and for those after commands that another controller has
/// replaced. Beyond, the step executes the stored plan, which stays safe.
const MAX_WORK_PER_STEP: usize = 40 * FIRING_WORK;

/// Work of a search at most below the level to keep. A filter that tests fewer plans there executes its plan sooner,
/// and raises the level before the leader needs it: when commands returned at 20 m/s³, `shield2:idm` collided in 24
/// instead of 57 of 2000 scenarios of `high-risk`; with half of this work, in 10, but more often with a `human` behind,
/// and it braked more often without need.
const MAX_WORK_BELOW_LEVEL: usize = 20 * FIRING_WORK;

/// Steps in which a filter that replaces commands has tried all shapes of plans once.
const PLAN_ROTATION: usize = 7;

/// Shares of the level to keep, for a state that has a plan only at a lower level.
const LEVEL_SHARES: [f64; 9] = [0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1];

/// Factors of the follower's deceleration for a state that has no plan.
const OPTIMISTIC_FACTORS: [f64; 4] = [1.0, 1.3, 1.7, 3.0];

/// Largest change of commands that the filter chooses itself, in m/s³, except for those of its plan.
const MAX_CHANGE_MPS3: f64 = 20.0;

/// Largest increase of a command after a replaced one, at the level to keep, in m/s³. With a faster return, `idm` is
/// soon at the boundary of the set again, and the filter intervenes more often: in 500 drives of `traffic`, 14.4 times
/// an hour with 20 m/s³, and 9.4 times with 5 m/s³. With a slower one, it collides more often with a `human` behind: in
/// 18.4 % of their scenarios of `followers` with 20 m/s³, and in 20.5 % with 5 m/s³.
const MAX_RETURN_MPS3: f64 = 5.0;

/// Increase of the level that a step attempts, in m/s².
const LEVEL_STEP_MPS2: f64 = 0.25;

/// Lowest level, in m/s².
const MIN_LEVEL_MPS2: f64 = 0.1;

/// Share of the follower's least deceleration below which it no longer brakes.
const RELEASED_SHARE: f64 = 0.5;

/// Time after which a follower that does not brake is taken to have released its brake, in seconds.
const RELEASE_S: f64 = 0.5;

/// Share of the margin that a plan keeps when it is evaluated again at the firing of the follower's brake.
const MARGIN_SHARE_AT_FIRING: f64 = 0.9;

/// Mean deceleration of the leader from which raising begins, in m/s². No leader of the space `traffic` brakes so hard;
/// `predictive` calls it `everyday_brake_mps2`.
const RAISING_BRAKE_MPS2: f64 = 2.65;

/// Mean acceleration of the leader at which raising ends, in m/s².
const RAISING_ENDS_MPS2: f64 = 0.5;

/// Share of a new acceleration in the mean.
const MEAN_SHARE: f64 = 0.05;

/// Searches plans.
#[derive(Debug)]
pub(super) struct Planner {
    pub(super) params: TwoSidedParams,
    paths: Paths,
    /// Work that may still be done.
    pub(super) budget: usize,
}

impl Planner {
    pub(super) fn new(params: TwoSidedParams) -> Self {
        Self {
            params,
            paths: Paths::default(),
            budget: 0,
        }
    }

    /// Tests a plan after the commands `prefix_mps2`.
    pub(super) fn test(
        &mut self,
        state: TwoSidedState,
        prefix_mps2: impl Iterator<Item = f64> + Clone,
        shape: PlanShape,
        level_mps2: f64,
    ) -> Option<Plan> {
        self.trial(state, prefix_mps2, shape, level_mps2).plan()
    }

    fn trial(
        &mut self,
        state: TwoSidedState,
        prefix_mps2: impl Iterator<Item = f64> + Clone,
        shape: PlanShape,
        level_mps2: f64,
    ) -> Trial<'_> {
        let workplace = (&self.params, &mut self.paths, &mut self.budget);
        Trial::new(workplace, state, prefix_mps2, shape, level_mps2)
    }

    /// Returns a plan after the commands `prefix_mps2` at a level; tries `first` before those of `choice`.
    pub(super) fn search(
        &mut self,
        state: TwoSidedState,
        prefix_mps2: impl Iterator<Item = f64> + Clone,
        level_mps2: f64,
        first: Option<PlanShape>,
        choice: PlanChoice,
    ) -> Option<Plan> {
        let full_braking = PlanShape {
            brake_mps2: self.params.brake_mps2,
            brake_steps: None,
            accel_mps2: 0.0,
        };
        let trial = self.trial(state, prefix_mps2.clone(), full_braking, level_mps2);
        if !trial.avoids_leader() {
            return None;
        }
        let speed_mps = self.predicted_speed_mps(state, prefix_mps2.clone());
        let shapes = PlanShapes {
            state,
            speed_mps,
            params: self.params,
        };
        let chosen = shapes
            .all()
            .enumerate()
            .filter(|(index, _)| choice.includes(*index))
            .map(|(_, shape)| shape);
        first.into_iter().chain(chosen).find_map(|shape| {
            (self.budget >= FIRING_WORK)
                .then(|| self.test(state, prefix_mps2.clone(), shape, level_mps2))
                .flatten()
        })
    }

    /// Returns the firings that the last test has computed: step, and steps of acceleration after it.
    pub(super) fn firings(&self) -> &[(usize, usize)] {
        &self.paths.firings
    }

    fn predicted_speed_mps(
        &self,
        state: TwoSidedState,
        prefix_mps2: impl Iterator<Item = f64>,
    ) -> f64 {
        let params = &self.params;
        let mut response_mps2 = state.response_mps2;
        prefix_mps2.fold(state.speed_mps[1], |speed_mps, command_mps2| {
            response_mps2 = params.response_mps2(response_mps2, command_mps2);
            (speed_mps + response_mps2 * params.step_s).max(0.0)
        })
    }
}

/// Choice among the shapes of plans.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PlanChoice {
    All,
    /// No further one.
    None,
    /// Every [`PLAN_ROTATION`]-th, beginning with another one at each step.
    Rotating(usize),
}

impl PlanChoice {
    fn includes(self, index: usize) -> bool {
        match self {
            Self::All => true,
            Self::None => false,
            Self::Rotating(step) => (index + step).is_multiple_of(PLAN_ROTATION),
        }
    }
}

/// Shapes of plans for a state.
struct PlanShapes {
    state: TwoSidedState,
    /// Own speed after pending commands, in m/s.
    speed_mps: f64,
    params: TwoSidedParams,
}

impl PlanShapes {
    /// Returns all shapes, likely ones first.
    fn all(self) -> impl Iterator<Item = PlanShape> {
        let waits = self
            .state
            .follower
            .is_some_and(|follower| !follower.has_fired());
        let reacts = self
            .params
            .follower
            .is_some_and(|class| class.trigger == FollowerTrigger::LeaderBrakes);
        let accel_mps2 = self.params.plan_accel_mps2();
        let accelerates = !reacts && self.params.response_fraction == 1.0 && accel_mps2 > 0.0;
        let brakes = if waits || reacts {
            BRAKE_SHARES.len()
        } else {
            1
        };
        let holds = if waits && !reacts {
            SLOWER_BY_MPS.len()
        } else {
            0
        };
        let full_mps2 = self.params.brake_mps2;
        let braking = BRAKE_SHARES
            .into_iter()
            .take(brakes)
            .map(move |share| (share * full_mps2, None));
        let holding = SLOWER_BY_MPS
            .into_iter()
            .take(holds)
            .map(move |slower_mps| (full_mps2, Some(self.steps_until_slower_by(slower_mps))));
        let accels = if accelerates { 2 } else { 1 };
        braking
            .chain(holding)
            .flat_map(move |(brake_mps2, brake_steps)| {
                [0.0, accel_mps2]
                    .into_iter()
                    .take(accels)
                    .map(move |accel_mps2| PlanShape {
                        brake_mps2,
                        brake_steps,
                        accel_mps2,
                    })
            })
    }

    /// Returns the steps of full braking until the ego vehicle is slower than the follower by `slower_mps`.
    fn steps_until_slower_by(&self, slower_mps: f64) -> usize {
        let follower_mps = self
            .state
            .follower
            .map_or(0.0, |follower| follower.speed_mps[1]);
        let change_mps = self.speed_mps - (follower_mps - slower_mps).max(0.0);
        (change_mps / (self.params.brake_mps2 * self.params.step_s)).max(0.0) as usize
    }
}

/// Determines the phase of the follower from observations.
#[derive(Debug, Default)]
struct FollowerTracker {
    /// Steps since the trigger, if it has occurred.
    steps: Option<usize>,
    /// True if the ego vehicle stood at the last observation.
    stood: bool,
}

impl FollowerTracker {
    /// Takes into account an observation, or that the time by which the brake must have fired is over.
    fn update(
        &mut self,
        params: &TwoSidedParams,
        state: &TwoSidedState,
        observation: &Observation,
        must_have_fired: bool,
    ) {
        let (Some(class), Some(rear), Some(follower)) =
            (params.follower, observation.behind, state.follower)
        else {
            return;
        };
        self.steps = self.steps.map(|steps| steps + 1);
        match class.trigger {
            FollowerTrigger::TimeToCollision(ttc_s) => {
                // The expression of the followers' emergency brakes, so that both agree to the bit.
                let closing_mps = follower.speed_mps[0] - state.speed_mps[1];
                let fires = follower.gap_m[1] - ttc_s * closing_mps < 0.0;
                if self.has_released(params, class, rear.acceleration_mps2, rear.speed_mps) {
                    self.steps = None;
                }
                if self.steps.is_none() && (fires || must_have_fired) {
                    self.steps = Some(0);
                }
            }
            FollowerTrigger::LeaderBrakes => {
                let braked = state.response_mps2 + params.noise_mps2 <= -NOTICED_BRAKE_MPS2;
                let stands = state.speed_mps[1] <= 0.0;
                self.steps = match (braked || stands && self.stood, stands) {
                    (true, _) => Some(self.steps.unwrap_or(1)),
                    // It came to a stop with less braking, and stands from now on.
                    (false, true) => Some(0),
                    (false, false) => None,
                };
                self.stood = stands;
            }
        }
    }

    fn has_released(
        &self,
        params: &TwoSidedParams,
        class: FollowerClass,
        acceleration_mps2: f64,
        speed_mps: f64,
    ) -> bool {
        let since_s = self.steps.map_or(0.0, |steps| steps as f64 * params.step_s);
        since_s > class.reaction_s + RELEASE_S
            && acceleration_mps2 > -RELEASED_SHARE * class.brake_mps2
            && speed_mps > params.rear_errors.speed_mps
    }

    fn phase(&self, params: &TwoSidedParams) -> FollowerPhase {
        match (self.steps, params.follower) {
            (Some(steps), Some(class)) => {
                FollowerPhase::Braking((class.reaction_s - steps as f64 * params.step_s).max(0.0))
            }
            (None, Some(class))
                if matches!(class.trigger, FollowerTrigger::TimeToCollision(_))
                    && !params.observes_firing() =>
            {
                FollowerPhase::Unknown
            }
            _ => FollowerPhase::Waiting,
        }
    }
}

/// Knowledge of an ego vehicle about its run: its commands, and the phase of the follower.
#[derive(Debug)]
pub(super) struct ObservedRun {
    pub(super) commands: CommandMemory,
    follower: FollowerTracker,
}

impl ObservedRun {
    pub(super) fn new(params: &TwoSidedParams) -> Self {
        Self {
            commands: CommandMemory::new(
                [params.brake_mps2, params.accel_mps2],
                params.delay_steps,
                params.response_fraction,
            ),
            follower: FollowerTracker::default(),
        }
    }

    /// Returns the worst state that an observation allows, with the phase of the follower.
    pub(super) fn observe(
        &mut self,
        params: &TwoSidedParams,
        observation: &Observation,
        must_have_fired: bool,
    ) -> TwoSidedState {
        let mut state = worst_state(params, observation, self.commands.response_mps2());
        self.follower
            .update(params, &state, observation, must_have_fired);
        if let Some(follower) = &mut state.follower {
            follower.phase = self.follower.phase(params);
        }
        state
    }
}

/// A plan and the level at which it is safe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoredPlan {
    pub(super) plan: Plan,
    /// Deceleration of the leader up to which it is safe, in m/s².
    pub(super) level_mps2: f64,
}

/// Replaces commands after which no plan avoids a collision on both sides.
#[derive(Debug)]
pub struct TwoSidedFilter {
    planner: Planner,
    run: ObservedRun,
    stored: Option<StoredPlan>,
    /// True if this step searches all plans without a limit of work, as at the first step and after a command that
    /// another controller has replaced: a plan that is not found then costs a collision. After a step outside the set,
    /// nothing is promised, so that later searches are limited.
    searches_all: bool,
    /// Mean acceleration of the leader, in m/s².
    leader_mean_mps2: f64,
    is_raising: bool,
    /// Last command, in m/s².
    last_mps2: f64,
    step: usize,
    overrides: Vec<Override>,
}

impl TwoSidedFilter {
    /// Creates a filter for a vehicle without pending commands.
    #[must_use]
    pub fn new(params: TwoSidedParams) -> Self {
        Self {
            run: ObservedRun::new(&params),
            planner: Planner::new(params),
            stored: None,
            searches_all: true,
            leader_mean_mps2: 0.0,
            is_raising: false,
            last_mps2: 0.0,
            step: 0,
            overrides: Vec::new(),
        }
    }

    /// Returns the periods in which commands were replaced.
    #[must_use]
    pub fn overrides(&self) -> &[Override] {
        &self.overrides
    }

    /// Returns the level that the filter keeps, in m/s²: no collision occurs on either side as long as the leader
    /// brakes at most so hard and the follower is of the class; `None` if it knows none.
    #[must_use]
    pub fn level_mps2(&self) -> Option<f64> {
        self.stored
            .map(|stored| stored.level_mps2)
            .filter(|&level_mps2| level_mps2 > 0.0)
    }

    /// Returns the command to execute in place of `wanted_mps2`, in m/s².
    pub fn decide(&mut self, observation: &Observation, wanted_mps2: f64) -> f64 {
        let params = self.planner.params;
        let wanted_mps2 = clamp_command(wanted_mps2, params.brake_mps2, params.accel_mps2);
        self.planner.budget = self.max_work();
        let state = self.observed_state(observation);
        self.observe_leader(observation);
        let command_mps2 = self.filtered(state, wanted_mps2, observation);
        if command_mps2 != wanted_mps2 {
            self.record_override();
        }
        self.run.commands.advance(command_mps2);
        self.last_mps2 = command_mps2;
        self.searches_all = false;
        self.step += 1;
        command_mps2
    }

    /// Returns the work that a search may do.
    fn max_work(&self) -> usize {
        if self.searches_all {
            usize::MAX
        } else if self.keeps_level() {
            MAX_WORK_PER_STEP
        } else {
            MAX_WORK_BELOW_LEVEL
        }
    }

    /// Returns the largest increase of a command after a replaced one, in m/s².
    fn max_return_mps2(&self) -> f64 {
        let change_mps3 = if self.keeps_level() {
            MAX_RETURN_MPS3
        } else {
            MAX_CHANGE_MPS3
        };
        change_mps3 * self.planner.params.step_s
    }

    fn keeps_level(&self) -> bool {
        let keep_mps2 = self.planner.params.level_mps2;
        self.level_mps2()
            .is_some_and(|level_mps2| level_mps2 >= keep_mps2)
    }

    /// Accounts for another command than the one returned by [`Self::decide`], in m/s².
    pub fn record_command(&mut self, command_mps2: f64) {
        self.stored = None;
        self.searches_all = true;
        self.run.commands.replace_last(command_mps2);
    }

    /// Returns the worst state that an observation allows, with the phase of the follower.
    fn observed_state(&mut self, observation: &Observation) -> TwoSidedState {
        let must_have_fired = self.stored.is_some_and(|stored| {
            matches!(
                stored.plan,
                Plan::Waiting {
                    latest_steps: Some(0),
                    ..
                }
            )
        });
        self.run
            .observe(&self.planner.params, observation, must_have_fired)
    }

    /// Updates the mean acceleration of the leader, and whether a plan is executed early.
    fn observe_leader(&mut self, observation: &Observation) {
        let leader_mps2 = observation
            .ahead
            .map_or(0.0, |ahead| ahead.acceleration_mps2);
        self.leader_mean_mps2 += MEAN_SHARE * (leader_mps2 - self.leader_mean_mps2);
        if self.leader_mean_mps2 < -RAISING_BRAKE_MPS2 {
            self.is_raising = true;
        } else if self.leader_mean_mps2 > RAISING_ENDS_MPS2 {
            self.is_raising = false;
        }
    }

    /// Returns the wanted command if a plan exists after it; otherwise one near the last command after which a plan
    /// exists, or else the first command of the stored plan.
    fn filtered(
        &mut self,
        state: TwoSidedState,
        wanted_mps2: f64,
        observation: &Observation,
    ) -> f64 {
        let keep_mps2 = self.planner.params.level_mps2;
        // After a replaced command, the command returns to the wanted one without a jump.
        let target_mps2 = if self.was_replaced() {
            wanted_mps2.min(self.last_mps2 + self.max_return_mps2())
        } else {
            wanted_mps2
        };
        let choice = self.choice();
        if self.passes(state, target_mps2, keep_mps2, choice) {
            return target_mps2;
        }
        self.replan_at_firing(state);
        if self.level_mps2().is_none() {
            self.stored = self.plan_for_present_state(state);
        }
        let Some(level_mps2) = self.level_mps2() else {
            self.stored = self.last_resort(state, observation);
            return self.execute_stored();
        };
        if self.is_raising_now(state, level_mps2) {
            self.raise_level(state);
            return self.execute_stored();
        }
        if !self.keeps_level() && self.passes_at_lower_level(state, target_mps2, level_mps2, choice)
        {
            return target_mps2;
        }
        if let Some(command_mps2) = self.gentle_command_mps2(state, target_mps2, level_mps2) {
            return command_mps2;
        }
        self.raise_level(state);
        self.execute_stored()
    }

    /// Returns a command below `target_mps2`, near the last one, after which a plan exists at this level.
    fn gentle_command_mps2(
        &mut self,
        state: TwoSidedState,
        target_mps2: f64,
        level_mps2: f64,
    ) -> Option<f64> {
        let TwoSidedParams {
            brake_mps2, step_s, ..
        } = self.planner.params;
        let (planned_mps2, _) = self.stored?.plan.next(brake_mps2);
        let last_mps2 = self.last_mps2;
        let choices = [
            (last_mps2, PlanChoice::None),
            (last_mps2 - MAX_CHANGE_MPS3 * step_s, PlanChoice::None),
            (
                0.5 * (last_mps2 + planned_mps2),
                PlanChoice::Rotating(self.step),
            ),
        ];
        choices.into_iter().find_map(|(command_mps2, choice)| {
            let command_mps2 = command_mps2.max(-brake_mps2);
            let passes =
                command_mps2 < target_mps2 && self.passes(state, command_mps2, level_mps2, choice);
            passes.then_some(command_mps2)
        })
    }

    /// True if the plan is executed before it must be.
    fn is_raising_now(&self, state: TwoSidedState, level_mps2: f64) -> bool {
        let params = &self.planner.params;
        let waits = state.follower.is_some_and(|follower| !follower.has_fired());
        params.raises && self.is_raising && waits && level_mps2 < params.level_mps2
    }

    fn was_replaced(&self) -> bool {
        self.overrides
            .last()
            .is_some_and(|last| last.last_step + 1 == self.step)
    }

    /// Returns the first command of the stored plan; full braking without one.
    fn execute_stored(&mut self) -> f64 {
        let brake_mps2 = self.planner.params.brake_mps2;
        let Some(stored) = &mut self.stored else {
            return -brake_mps2;
        };
        let (command_mps2, rest) = stored.plan.next(brake_mps2);
        stored.plan = rest;
        command_mps2
    }

    /// True if a plan at this level exists after the command; it is stored.
    fn passes(
        &mut self,
        state: TwoSidedState,
        command_mps2: f64,
        level_mps2: f64,
        choice: PlanChoice,
    ) -> bool {
        let first = self.stored_shape();
        let prefix_mps2 = self
            .run
            .commands
            .pending_mps2()
            .chain(std::iter::once(command_mps2));
        let plan = self
            .planner
            .search(state, prefix_mps2, level_mps2, first, choice);
        if let Some(plan) = plan {
            self.stored = Some(StoredPlan { plan, level_mps2 });
        }
        plan.is_some()
    }

    /// Returns the plans to try: not all if the last step has replaced the command or the level is lower than the one
    /// to keep.
    fn choice(&self) -> PlanChoice {
        if self.searches_all {
            return PlanChoice::All;
        }
        if self.was_replaced() || !self.keeps_level() {
            PlanChoice::Rotating(self.step)
        } else {
            PlanChoice::All
        }
    }

    fn stored_shape(&self) -> Option<PlanShape> {
        let brake_mps2 = self.planner.params.brake_mps2;
        self.stored.map(|stored| stored.plan.shape(brake_mps2))
    }

    /// True if the command may pass although the level is lower than the one to keep.
    fn passes_at_lower_level(
        &mut self,
        state: TwoSidedState,
        command_mps2: f64,
        level_mps2: f64,
        choice: PlanChoice,
    ) -> bool {
        let raised_mps2 = (level_mps2 + LEVEL_STEP_MPS2).min(self.planner.params.level_mps2);
        self.passes(state, command_mps2, raised_mps2, PlanChoice::None)
            || self.passes(state, command_mps2, level_mps2, choice)
    }

    /// Replaces the stored plan by one with a higher level, if there is one for the present state.
    fn raise_level(&mut self, state: TwoSidedState) {
        let params = self.planner.params;
        let Some(stored) = self
            .stored
            .filter(|stored| stored.level_mps2 < params.level_mps2)
        else {
            return;
        };
        let level_mps2 = (stored.level_mps2 + LEVEL_STEP_MPS2).min(params.level_mps2);
        let shape = stored.plan.shape(params.brake_mps2);
        let pending_mps2 = self.run.commands.pending_mps2();
        if let Some(plan) = self.planner.test(state, pending_mps2, shape, level_mps2) {
            self.stored = Some(StoredPlan { plan, level_mps2 });
        }
    }

    /// Fixes the second phase of the stored plan once the follower's brake has fired.
    fn replan_at_firing(&mut self, state: TwoSidedState) {
        let Some(StoredPlan {
            plan:
                Plan::Waiting {
                    shape,
                    fixed_steps: None,
                    ..
                },
            level_mps2,
        }) = self.stored
        else {
            return;
        };
        let has_fired = state.follower.is_none_or(|follower| follower.has_fired());
        if !has_fired {
            return;
        }
        let margin_m = self.planner.params.margin_m;
        self.planner.params.margin_m = MARGIN_SHARE_AT_FIRING * margin_m;
        // The plan was tested with this follower; the steps follow from the leader alone.
        let ahead_only = TwoSidedState {
            follower: None,
            ..state
        };
        let follower = self.planner.params.follower.take();
        // This one test must not depend on the work before.
        let budget = std::mem::replace(&mut self.planner.budget, usize::MAX);
        let pending_mps2 = self.run.commands.pending_mps2();
        let plan = self
            .planner
            .test(ahead_only, pending_mps2, shape, level_mps2)
            .unwrap_or(Plan::Committed {
                accel_mps2: 0.0,
                steps: 0,
            });
        self.planner.budget = budget;
        self.planner.params.follower = follower;
        self.planner.params.margin_m = margin_m;
        self.stored = Some(StoredPlan { plan, level_mps2 });
    }

    /// Returns a plan for the present state at the level to keep, or else at the highest lower one.
    fn plan_for_present_state(&mut self, state: TwoSidedState) -> Option<StoredPlan> {
        let keep_mps2 = self.planner.params.level_mps2;
        if let Some(plan) = self.plan_now(state, keep_mps2) {
            let level_mps2 = keep_mps2;
            return Some(StoredPlan { plan, level_mps2 });
        }
        // The lower the level, the more states have a plan.
        self.plan_now(state, MIN_LEVEL_MPS2)?;
        LEVEL_SHARES.iter().find_map(|share| {
            let level_mps2 = (share * keep_mps2).max(MIN_LEVEL_MPS2);
            let plan = self.plan_now(state, level_mps2)?;
            Some(StoredPlan { plan, level_mps2 })
        })
    }

    /// Returns a plan for the present state. Each call has its own limit of work, if there is one.
    fn plan_now(&mut self, state: TwoSidedState, level_mps2: f64) -> Option<Plan> {
        self.planner.budget = self.max_work();
        let choice = self.choice();
        let pending_mps2 = self.run.commands.pending_mps2();
        self.planner
            .search(state, pending_mps2, level_mps2, None, choice)
    }

    /// Returns a plan that is safe at no level: for a leader that goes on as it does, and a follower that brakes harder
    /// than the class states.
    fn last_resort(
        &mut self,
        state: TwoSidedState,
        observation: &Observation,
    ) -> Option<StoredPlan> {
        let leader_mps2 = observation
            .ahead
            .map_or(0.0, |ahead| -ahead.acceleration_mps2);
        let keep_mps2 = self.planner.params.level_mps2;
        let level_mps2 = leader_mps2.clamp(MIN_LEVEL_MPS2, keep_mps2.max(MIN_LEVEL_MPS2));
        let class = self.planner.params.follower;
        let plan = OPTIMISTIC_FACTORS.iter().find_map(|factor| {
            self.planner.params.follower = class.map(|class| FollowerClass {
                brake_mps2: factor * class.brake_mps2,
                ..class
            });
            self.plan_now(state, level_mps2)
        });
        self.planner.params.follower = class;
        plan.map(|plan| StoredPlan {
            plan,
            level_mps2: 0.0,
        })
    }

    fn record_override(&mut self) {
        let step = self.step;
        let keep_mps2 = self.planner.params.level_mps2;
        let level_mps2 = self.level_mps2();
        let outside_kernel = level_mps2.is_none_or(|level| level < keep_mps2);
        let rear_conflict = level_mps2.is_none();
        Override::record(&mut self.overrides, step, outside_kernel, rear_conflict);
    }
}

/// Returns the worst state that an observation allows. The follower's phase is still unknown.
pub(super) fn worst_state(
    params: &TwoSidedParams,
    observation: &Observation,
    response_mps2: f64,
) -> TwoSidedState {
    let errors = params.errors;
    let rear = params.rear_errors;
    let around = |value: f64, error: f64| [(value - error).max(0.0), value + error];
    TwoSidedState {
        gap_m: observation
            .ahead
            .map_or(f64::INFINITY, |ahead| ahead.gap_m - errors.gap_m),
        ahead_mps: observation.ahead.map_or(0.0, |ahead| {
            (ahead.speed_mps - errors.ahead_speed_mps).max(0.0)
        }),
        speed_mps: around(observation.speed_mps, errors.speed_mps),
        response_mps2,
        follower: observation.behind.map(|behind| FollowerState {
            gap_m: [behind.gap_m - rear.gap_m, behind.gap_m + rear.gap_m],
            speed_mps: around(behind.speed_mps, rear.speed_mps),
            phase: FollowerPhase::Unknown,
        }),
    }
}
