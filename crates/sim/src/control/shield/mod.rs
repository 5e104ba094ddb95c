//! A shield: passes commands after which a collision can still be avoided, and brakes fully otherwise.
//!
//! A state is (g, v, w): gap, own speed, speed of the leader. K = { g > D(v, w) } is the set of states from which a
//! collision can be avoided for every leader within its brake limit ([`ViabilityKernel`]). A command passes if, for a
//! leader at its limit,
//!
//! - the state after the step is in K, and
//! - the gap stays open at every instant of the step.
//!
//! The first does not imply the second: a vehicle that brakes harder than its leader can be closest within the step. A
//! test of step ends alone could miss an overlap of up to 0.046 (b - c) h², with the brake limits b and c of the two
//! vehicles and the step h: seven micrometres for a car behind a truck at 0.01 s. Full braking needs no test: it keeps
//! the state in K at every instant.
//!
//! The shield also handles:
//!
//! - *Estimation error*: the test uses the worst gap and speeds within the bounds. A true state in K stays there.
//! - *Delay*: the test uses the state after all pending commands, with a leader that brakes at its limit.
//! - *Lag*: the kernel uses v + τ' (r + b) in place of v, with the response r of the actuator and the effective lag τ'
//!   ([`ShieldParams::lag_s`]).
//! - *Noise* on accelerations: six standard deviations (exceeded twice in 10⁹ samples) reduce the own brake limit and
//!   raise the leader's.
//!
//! No guarantee holds for a vehicle that its follower pushes, nor behind a leader that an impact stops.
//!
//! Simulation and proofs use the same code: [`ShieldParams::admits`] and its callees are generic over [`Real`] (exact
//! quotients, terms of `verify/obligations`). A margin covers rounding ([`MotionBounds::margin_m`]).
//!
//! - Proved in Coq, of the formulas, for all limits: kernel and lag (`docs/kernel-theorems.md`).
//! - Proved by SMT solvers, of these functions, for the limits of each pair of vehicle classes (`verify/obligations`):
//!   kernel, motion, the test at every instant of the step, and lag. Also proved: with errors within the bounds and
//!   with noise, the predicted state is the worst possible.
//! - Proved in Coq of these functions in double precision: effects of rounding on gaps in full braking and on spare
//!   gaps.
//! - Derived on paper from these: the margin.
//! - Tested only: the loop in this file, which applies the error bounds and predicts one step per step of delay.
//! - Assumed: an estimator keeps its stated bounds, which are six standard deviations if its noise is unbounded.

mod admission;
mod command_memory;
mod firing;
mod kernel;
mod params;
mod real;
mod rounding;
mod settings;
mod source;

pub use admission::ShieldState;
pub(super) use command_memory::CommandMemory;
pub use firing::{FiringRule, FiringSpeeds, MotionSample, min_quadratic};
pub use kernel::{ViabilityKernel, distance_and_speed_after, max_closing_m};
pub use params::{ErrorBounds, RearVehicleParams, ShieldParams};
pub use real::Real;
pub use rounding::MIN_MARGIN_M;
pub(crate) use rounding::{MAX_MARGIN_M, MotionBounds};
pub use settings::{ShieldKind, ShieldSettings};
pub use source::{ShieldRefusal, ShieldedSource};

use super::{Controller, ControllerFailure, clamp_command};
use crate::observation::Observation;

/// Successive steps in which a shield replaced the command, or the state was outside the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Override {
    /// First step.
    pub first_step: usize,
    /// Last step.
    pub last_step: usize,
    /// True if the state was outside the kernel in one of them: a collision could no longer be excluded.
    pub outside_kernel: bool,
    /// True if in one of them the follower could not avoid the fully braking ego vehicle: no command was safe for both.
    pub rear_conflict: bool,
}

impl Override {
    /// Adds a step to the last override, or a new override if a step between them had none.
    pub(super) fn record(
        overrides: &mut Vec<Self>,
        step: usize,
        outside_kernel: bool,
        rear_conflict: bool,
    ) {
        match overrides
            .last_mut()
            .filter(|last| last.last_step + 1 == step)
        {
            Some(last) => {
                last.last_step = step;
                last.outside_kernel |= outside_kernel;
                last.rear_conflict |= rear_conflict;
            }
            None => overrides.push(Self {
                first_step: step,
                last_step: step,
                outside_kernel,
                rear_conflict,
            }),
        }
    }
}

struct ShieldedController {
    controller: Box<dyn Controller>,
    params: ShieldParams,
    commands: CommandMemory,
    step: usize,
    overrides: Vec<Override>,
}

impl ShieldedController {
    fn new(controller: Box<dyn Controller>, params: ShieldParams) -> Self {
        Self {
            controller,
            commands: CommandMemory::new(
                [params.brake_mps2, params.accel_mps2],
                params.delay_steps,
                params.response_fraction,
            ),
            params,
            step: 0,
            overrides: Vec::new(),
        }
    }

    /// Returns the worst possible state in which a command given now takes effect; `None` without a leader.
    fn worst_state(&self, observation: &Observation) -> Option<ShieldState> {
        let ahead = observation.ahead?;
        let ErrorBounds {
            gap_m,
            speed_mps,
            ahead_speed_mps,
        } = self.params.errors;
        let mut state = ShieldState {
            gap_m: ahead.gap_m - gap_m,
            speed_mps: observation.speed_mps + speed_mps,
            ahead_mps: (ahead.speed_mps - ahead_speed_mps).max(0.0),
            response_mps2: self.commands.response_mps2(),
        };
        for command_mps2 in self.commands.pending_mps2() {
            state = self.params.after(state, command_mps2);
        }
        Some(state)
    }
}

impl Controller for ShieldedController {
    fn perceive(&mut self, truth: &Observation) {
        self.controller.perceive(truth);
    }

    fn is_warning(&self) -> bool {
        self.controller.is_warning()
    }

    fn overrides(&self) -> &[Override] {
        &self.overrides
    }

    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let wanted_mps2 = clamp_command(
            self.controller.decide(observation)?,
            self.params.brake_mps2,
            self.params.accel_mps2,
        );
        let mut command_mps2 = wanted_mps2;
        if let Some(state) = self.worst_state(observation)
            && !self.params.admits(state, wanted_mps2)
        {
            command_mps2 = -self.params.brake_mps2;
            let outside_kernel = self.params.spare_m(state) < 0.5 * self.params.margin_m;
            // Full braking by the controller is no override, but is recorded outside the kernel.
            if wanted_mps2 > command_mps2 || outside_kernel {
                Override::record(
                    &mut self.overrides,
                    self.step,
                    outside_kernel,
                    self.params.endangers_rear(observation),
                );
            }
            if wanted_mps2 > command_mps2 {
                self.controller.record_command(command_mps2);
            }
        }
        self.commands.advance(command_mps2);
        self.step += 1;
        Ok(command_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.controller.record_command(command_mps2);
        self.commands.replace_last(command_mps2);
    }
}

impl ShieldParams {
    /// True if the follower, which holds its speed until it reacts, would collide if the ego vehicle brakes fully.
    ///
    /// Until the follower reacts, the gap behind is a concave function of time, so it is smallest at the begin or the
    /// end of the reaction time.
    fn endangers_rear(&self, observation: &Observation) -> bool {
        let Some(rear) = observation.behind else {
            return false;
        };
        let Some(RearVehicleParams {
            brake_mps2,
            reaction_s,
        }) = self.behind
        else {
            return false;
        };
        let [covered_m, speed_mps] =
            distance_and_speed_after(observation.speed_mps, -self.brake_mps2, reaction_s);
        let kernel = ViabilityKernel {
            own_brake_mps2: brake_mps2,
            ahead_brake_mps2: self.brake_mps2,
        };
        let gap_m = rear.gap_m + covered_m - rear.speed_mps * reaction_s;
        gap_m <= kernel.demanded_gap_m(rear.speed_mps, speed_mps)
    }
}

#[cfg(test)]
mod tests;
