//! The stepwise scalar engine: one run, one step at a time. A caller may command a vehicle in place of its driver.

mod short_line;

use std::ops::ControlFlow;

use self::short_line::FallbackReason;
use super::actuator::{Actuator, Disturbance, add_noise_unless_at_rest};
use super::platoon::PlatoonState;
use super::recorder::{VehicleExtremes, assemble_result, raise_max_brake, summarize_vehicle};
use super::run::{TimeGrid, VehicleController, true_state};
use super::shielding::interventions;
use super::{
    AfterCollision, FailedController, Impact, Intervention, Motion, RecordingLevel, Run,
    SimulationResult, Trace,
};
use crate::control::{Controller, ControllerFailure};
use crate::estimate::EgoEstimator;
use crate::observation::{EstimatorKind, Observation};
use crate::scenario::LeadProfile;

/// A run in progress.
///
/// [`step`](Self::step) lets all vehicles decide and move. Before it, [`observe`](Self::observe) returns the
/// observation of a vehicle and [`command`](Self::command) commands it in place of its driver.
pub struct Stepper {
    time_grid: TimeGrid,
    platoon: PlatoonState,
    loops: Vec<VehicleLoop>,
    next_acceleration_mps2: Vec<f64>,
    extremes: Vec<VehicleExtremes>,
    trace: Option<Trace>,
    impacts: Vec<Impact>,
    failed: Option<FailedController>,
    step: usize,
    ended: bool,
}

/// State of a run after a step of [`Stepper::drive`].
#[derive(Debug, Clone, Copy)]
pub struct StepView<'a> {
    /// Motion of every vehicle, front to rear.
    pub motion: &'a [Motion],
    /// Gap ahead of the driven vehicle, in metres; `None` without a leader.
    pub gap_m: Option<f64>,
    /// True after a collision.
    pub has_collided: bool,
    /// True if the run has ended.
    pub has_ended: bool,
}

impl Stepper {
    /// Creates a run in its initial state.
    #[must_use]
    pub fn new(run: &Run, keep: RecordingLevel) -> Self {
        let platoon = run.initial_platoon();
        let loops: Vec<VehicleLoop> = (0..platoon.motion.len())
            .map(|index| VehicleLoop::new(run, index, &platoon))
            .collect();
        let mut extremes = vec![VehicleExtremes::INITIAL; loops.len()];
        update_min_ttc(&mut extremes, &platoon);
        Self {
            time_grid: run.time_grid,
            trace: Trace::begin(keep, &platoon, run.scenario().steps() * run.substeps() + 1),
            next_acceleration_mps2: vec![0.0; loops.len()],
            platoon,
            loops,
            extremes,
            impacts: Vec::new(),
            failed: None,
            step: 0,
            ended: run.scenario().steps() == 0,
        }
    }

    /// Creates a stepper without per-vehicle summaries (minimum TTC, maximum deceleration). RL uses it, because it
    /// reads every step itself. [`finish`](Self::finish) returns no vehicle summaries.
    #[must_use]
    pub fn without_summaries(run: &Run) -> Self {
        Self {
            extremes: Vec::new(),
            ..Self::new(run, RecordingLevel::Summary)
        }
    }

    /// Returns the number of completed steps of the scenario, including one that ended in a collision.
    #[must_use]
    pub fn step_count(&self) -> usize {
        self.step
    }

    /// True if the duration is over, or a collision or a failed controller ended the run.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// True after a collision.
    #[must_use]
    pub fn has_collided(&self) -> bool {
        !self.impacts.is_empty()
    }

    /// Returns the motion of every vehicle, front to rear.
    #[must_use]
    pub fn motion(&self) -> &[Motion] {
        &self.platoon.motion
    }

    /// Returns the gap ahead of vehicle `index`, in metres; `None` without a leader or without such a vehicle.
    #[must_use]
    pub fn gap_m(&self, index: usize) -> Option<f64> {
        self.platoon.gap_m(index)
    }

    /// Returns the current observation of vehicle `index`; `None` without such a vehicle.
    pub fn observe(&mut self, index: usize) -> Option<Observation> {
        let vehicle = self.loops.get_mut(index)?;
        Some(vehicle.observe(&self.platoon, index))
    }

    /// Consults the driver of vehicle `index` at every step from now on, also when the vehicle is commanded from
    /// outside. The driver observes through `estimator`, whatever [`observe`](Self::observe) returns.
    pub fn consult(&mut self, index: usize, estimator: EstimatorKind) {
        if let Some(vehicle) = self.loops.get_mut(index) {
            vehicle.consulted = Some((estimator, 0.0));
        }
    }

    /// Returns the answer of a [consulted](Self::consult) driver in the last step, in m/s².
    #[must_use]
    pub fn consulted_mps2(&self, index: usize) -> Option<f64> {
        self.loops
            .get(index)?
            .consulted
            .map(|(_, answer_mps2)| answer_mps2)
    }

    /// Returns the impacts so far, in order of time.
    #[must_use]
    pub fn impacts(&self) -> &[Impact] {
        &self.impacts
    }

    /// Returns the state after a step, seen from vehicle `index`.
    #[must_use]
    pub fn view(&self, index: usize) -> StepView<'_> {
        StepView {
            motion: self.motion(),
            gap_m: self.gap_m(index),
            has_collided: self.has_collided(),
            has_ended: self.ended,
        }
    }

    /// Commands an acceleration of vehicle `index` for the next step, in m/s².
    pub fn command(&mut self, index: usize, acceleration_mps2: f64) {
        if let Some(vehicle) = self.loops.get_mut(index) {
            vehicle.command_mps2 = Some(acceleration_mps2);
        }
    }

    /// Drives vehicle `index` for up to `steps` steps. `command` maps its observation to an acceleration in m/s².
    /// Ends early if the run ends or `after`, called after each step, breaks.
    pub fn drive(
        &mut self,
        index: usize,
        steps: usize,
        mut command: impl FnMut(&Observation) -> f64,
        mut after: impl FnMut(&StepView<'_>) -> ControlFlow<()>,
    ) {
        let last = self.step.saturating_add(steps);
        while self.step < last && !self.ended {
            let reason = match self.loops.len() {
                2 => self.drive_short_line::<2>(index, last, &mut command, &mut after),
                3 => self.drive_short_line::<3>(index, last, &mut command, &mut after),
                4 => self.drive_short_line::<4>(index, last, &mut command, &mut after),
                _ => FallbackReason::CommandsPending,
            };
            match reason {
                FallbackReason::Finished => return,
                FallbackReason::CommandsReady => {}
                FallbackReason::CommandsPending => {
                    if let Some(observation) = self.observe(index) {
                        self.command(index, command(&observation));
                    }
                    self.decide();
                }
            }
            self.move_vehicles();
            if after(&self.view(index)).is_break() {
                return;
            }
        }
    }

    /// Simulates one step of the scenario; does nothing after the end of the run.
    pub fn step(&mut self) {
        if !self.ended {
            self.decide();
            self.move_vehicles();
        }
    }

    fn span_s(&self) -> [f64; 2] {
        [
            self.time_grid.time_s(self.step, 0),
            self.time_grid.time_s(self.step + 1, 0),
        ]
    }

    fn decide(&mut self) {
        let span_s = self.span_s();
        // All vehicles decide on the state at the start of the step, before any vehicle moves.
        for (index, (vehicle, decided_mps2)) in self
            .loops
            .iter_mut()
            .zip(&mut self.next_acceleration_mps2)
            .enumerate()
        {
            match vehicle.decide(&self.platoon, index, span_s) {
                Ok(acceleration_mps2) => *decided_mps2 = acceleration_mps2,
                Err(failure) => {
                    let failed = FailedController {
                        time_s: span_s[0],
                        vehicle: index,
                        failure,
                    };
                    self.failed.get_or_insert(failed);
                }
            }
        }
    }

    fn move_vehicles(&mut self) {
        if self.failed.is_some() {
            self.ended = true;
            return;
        }
        for (motion, &acceleration_mps2) in self
            .platoon
            .motion
            .iter_mut()
            .zip(&self.next_acceleration_mps2)
        {
            motion.acceleration_mps2 = acceleration_mps2;
        }
        if self.has_collided() {
            self.platoon.share_acceleration();
        }
        for substep in 0..self.time_grid.substeps {
            self.advance_substep(self.time_grid.time_s(self.step, substep));
            if self.ended {
                break;
            }
        }
        self.step += 1;
        self.ended |= self.step == self.time_grid.steps;
    }

    fn advance_substep(&mut self, from_s: f64) {
        let Self {
            platoon,
            extremes,
            trace,
            impacts,
            ..
        } = self;
        if let Some(trace) = trace {
            trace.push_sample(from_s, platoon.motion.iter().copied());
        }
        for (extremes, motion) in extremes.iter_mut().zip(&platoon.motion) {
            extremes.max_brake_mps2 =
                raise_max_brake(extremes.max_brake_mps2, motion.acceleration_mps2);
        }
        let TimeGrid {
            dt_s,
            after_collision,
            ..
        } = self.time_grid;
        let done_s = platoon.advance(from_s, dt_s, after_collision, impacts);
        update_min_ttc(extremes, platoon);
        if after_collision == AfterCollision::Stop && !impacts.is_empty() {
            if let Some(trace) = trace {
                trace.push_sample(from_s + done_s, platoon.motion.iter().copied());
            }
            self.ended = true;
        }
    }

    /// Returns the interventions of all shields, front to rear.
    fn interventions(&self) -> Vec<Intervention> {
        let step_s = self.time_grid.step_s;
        self.loops
            .iter()
            .enumerate()
            .flat_map(|(index, vehicle)| match &vehicle.driver {
                VehicleController::Controller(controller) => {
                    interventions(controller.overrides(), index, step_s)
                }
                VehicleController::Profile(_) => Vec::new(),
            })
            .collect()
    }

    /// Returns the result of the run.
    #[must_use]
    pub fn finish(mut self) -> SimulationResult {
        if let Some(trace) = &mut self.trace
            && (self.impacts.is_empty() || self.time_grid.after_collision.continues())
        {
            trace.push_sample(
                self.time_grid.time_s(self.step, 0),
                self.platoon.motion.iter().copied(),
            );
        }
        let interventions = self.interventions();
        if let Some(trace) = &mut self.trace {
            for (vehicle, track) in trace.vehicles.iter_mut().enumerate() {
                track.in_lane_s = self.platoon.lane.in_lane_s(vehicle);
            }
        }
        let vehicles = self
            .platoon
            .min_gap_m
            .iter()
            .zip(self.extremes)
            .zip(&self.platoon.motion);
        let vehicles = vehicles
            .map(|((&min_gap_m, extremes), motion)| {
                summarize_vehicle(min_gap_m, extremes, motion.speed_mps)
            })
            .collect();
        assemble_result(
            self.impacts,
            vehicles,
            interventions,
            self.trace,
            self.failed,
        )
    }
}

fn update_min_ttc(extremes: &mut [VehicleExtremes], platoon: &PlatoonState) {
    if platoon.lane.is_constant() {
        // In most runs the leader is the previous vehicle in the list.
        let pairs = platoon.motion.windows(2).zip(&platoon.length_m);
        for (extremes, (pair, length_m)) in extremes.iter_mut().skip(1).zip(pairs) {
            let [front, rear] = pair else { continue };
            extremes.update_min_ttc(
                front.position_m - length_m - rear.position_m,
                rear.speed_mps - front.speed_mps,
            );
        }
        return;
    }
    for (rear, extremes) in extremes.iter_mut().enumerate() {
        if let Some(front) = platoon.lane.ahead(rear) {
            let closing_mps = platoon.motion[rear].speed_mps - platoon.motion[front].speed_mps;
            extremes.update_min_ttc(platoon.gap_between_m(front, rear), closing_mps);
        }
    }
}

struct VehicleLoop {
    driver: VehicleController<LeadProfile>,
    /// `None` for the true state. Boxed to keep `VehicleLoop` small when thousands of runs are stepped in turn.
    estimator: Option<Box<EgoEstimator>>,
    actuator: Actuator,
    disturbance: Option<Disturbance>,
    /// Observation of this step, if it was requested: filters accept one measurement per step.
    observation: Option<Observation>,
    /// Leader and follower that the filters track.
    tracked_neighbours: [Option<usize>; 2],
    /// External command for this step.
    command_mps2: Option<f64>,
    /// Command after the vehicle has hit its leader, in m/s²; `None` if its driver decides.
    after_impact_mps2: Option<f64>,
    /// For a consulted driver: the estimator of its observations, and its last answer in m/s².
    consulted: Option<(EstimatorKind, f64)>,
}

impl VehicleLoop {
    fn new(run: &Run, index: usize, platoon: &PlatoonState) -> Self {
        Self {
            driver: match run.start_driver(index) {
                VehicleController::Profile(profile) => VehicleController::Profile(profile.clone()),
                VehicleController::Controller(controller) => {
                    VehicleController::Controller(controller)
                }
            },
            estimator: run.estimator(index, platoon).map(Box::new),
            actuator: Actuator::new(run.scenario(), index),
            disturbance: Disturbance::new(run.scenario(), index),
            observation: None,
            tracked_neighbours: [platoon.lane.ahead(index), platoon.lane.behind(index)],
            command_mps2: None,
            after_impact_mps2: run.command_after_impact_mps2(index),
            consulted: None,
        }
    }

    fn observe(&mut self, platoon: &PlatoonState, index: usize) -> Observation {
        if let Some(observation) = self.observation {
            return observation;
        }
        let truth = true_state(platoon, index);
        let observation = match &mut self.estimator {
            Some(estimator) => {
                let neighbours = [platoon.lane.ahead(index), platoon.lane.behind(index)];
                if neighbours != self.tracked_neighbours {
                    let changed =
                        [0, 1].map(|side| neighbours[side] != self.tracked_neighbours[side]);
                    estimator.switch_neighbours(&truth, changed);
                    self.tracked_neighbours = neighbours;
                }
                estimator.observe(&truth)
            }
            None => truth.observation,
        };
        *self.observation.insert(observation)
    }

    fn decide(
        &mut self,
        platoon: &PlatoonState,
        index: usize,
        [from_s, to_s]: [f64; 2],
    ) -> Result<f64, ControllerFailure> {
        // An estimator must be fed at every step. Without one the observation is computed on demand.
        if self.estimator.is_some() {
            self.observe(platoon, index);
        }
        let hides_follower = self.after_impact_mps2.is_some() && platoon.is_hit_from_behind(index);
        let observation = self.observation.take();
        let observation = observation.map(|seen| seen.hiding_follower(hides_follower));
        let truth = || {
            true_state(platoon, index)
                .observation
                .hiding_follower(hides_follower)
        };
        if let (Some(_), VehicleController::Controller(controller)) =
            (&observation, &mut self.driver)
        {
            controller.perceive(&truth());
        }
        let speed_mps = platoon.motion[index].speed_mps;
        if self.consulted.is_some() {
            self.consult_driver(observation, &truth())?;
        }
        let command_mps2 = match (self.command_mps2.take(), &mut self.driver) {
            (Some(command_mps2), _) => command_mps2,
            (None, VehicleController::Profile(profile)) => {
                profile.acceleration_mps2(from_s, to_s, speed_mps)
            }
            (None, VehicleController::Controller(controller)) => match observation {
                Some(observation) => controller.decide(&observation)?,
                None => controller.decide(&truth())?,
            },
        };
        let command_mps2 = match self.after_impact_mps2 {
            Some(after_mps2) if platoon.locked_to_front[index] => after_mps2,
            _ => command_mps2,
        };
        Ok(self.actuate(command_mps2, speed_mps, platoon.is_locked(index)))
    }

    /// Consults the driver, whose answer is also the command if there is none from outside.
    fn consult_driver(
        &mut self,
        estimate: Option<Observation>,
        truth: &Observation,
    ) -> Result<(), ControllerFailure> {
        let VehicleController::Controller(controller) = &mut self.driver else {
            return Ok(());
        };
        let Some((estimator, answer_mps2)) = &mut self.consulted else {
            return Ok(());
        };
        *answer_mps2 = match (estimator, estimate) {
            (EstimatorKind::Kalman, Some(estimate)) => controller.decide(&estimate)?,
            _ => controller.decide(truth)?,
        };
        match self.command_mps2 {
            Some(command_mps2) => controller.record_command(command_mps2),
            None => self.command_mps2 = Some(*answer_mps2),
        }
        Ok(())
    }

    #[inline]
    fn actuate(&mut self, command_mps2: f64, speed_mps: f64, is_locked: bool) -> f64 {
        let acceleration_mps2 = self.actuator.respond(command_mps2, speed_mps);
        let noise_mps2 = self
            .disturbance
            .as_mut()
            .map_or(0.0, Disturbance::next_mps2);
        match is_locked {
            true => acceleration_mps2 + noise_mps2,
            false => add_noise_unless_at_rest(acceleration_mps2, noise_mps2, speed_mps),
        }
    }
}

#[cfg(test)]
mod tests;
