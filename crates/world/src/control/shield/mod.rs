//! A shield: any controller's actions, as long as they leave a way out; full braking otherwise.
//!
//! A state is (g, v, w): gap, own speed, speed of the vehicle ahead. K = { g > D(v, w) } is exactly the set of states from
//! which contact can still be avoided against every leader that respects its brake limit ([`Kernel`]). An action passes if,
//! against the hardest braking of the vehicle ahead,
//!
//! - the state after the step is in K, and
//! - the gap stays open at every instant inside the step.
//!
//! The second is not implied by the first: a vehicle that brakes harder than the one ahead can be closest in mid-step. With
//! a test at step ends alone the gap could fall short by up to 0.046 (b - c) h², seven micrometres for a car behind a
//! truck at 0.01 s; contact all the same. Full braking needs no test: it keeps K at every instant.
//!
//! What else stands between a decision and the road:
//!
//! - *Estimation error*: the test uses the worst gap and speeds within the bounds. If the true state was in K it stays there.
//! - *Delay*: commands under way are carried out first, the vehicle ahead braking hardest meanwhile; the test is made of
//!   the state in which the command will act.
//! - *Lag*: v in the kernel becomes v + τ' (r + b), see [`Frame::lag_s`].
//! - *Noise* on accelerations: six standard deviations are taken off the own brake and added to the one ahead. That is no
//!   certainty: each exceeds it once in 10⁹ steps.
//!
//! Nothing is promised to a vehicle that is pushed by the one behind, nor behind one that is stopped by an impact: no
//! brake limit holds there.
//!
//! What drives is what is proved: [`Frame::admits`] and all it calls are written for any [`Real`] number. With exact quotients
//! certificates are held against them, with terms they write the obligations in `verify/obligations`. What is left to
//! arithmetic in double precision is paid for by a margin, see [`Travel::margin_m`].
//!
//! Proved for all limits, in Coq, of the formulas: the kernel and lag (`docs/kernel-theorems.md`). Proved for the shipped limits,
//! of these functions as they stand: the kernel, motion, the test of an action at every instant of the
//! step, lag, and that what is predicted of a state that is seen wrongly within its bounds, with noise, is the worst that comes. Proved in
//! Coq, of these functions as double precision computes them: what rounding takes of the gap in steps of full braking, and of what is
//! computed to be spare. Derived on paper from there: the margin. Tested only: the loop in this file, which takes the bounds off what is
//! seen and predicts as many steps as there is delay. Taken on trust: that an
//! estimator keeps the bounds that are stated for it, which are six standard deviations where noise has no bound.

mod admission;
mod kernel;
mod params;
mod real;
mod rounding;

pub use admission::ShieldState;
pub use kernel::{ViabilityKernel, distance_and_speed_after, max_closing_m};
pub use params::{ErrorBounds, RearVehicleParams, ShieldParams, ShieldSettings};
pub use real::Real;
pub use rounding::MIN_MARGIN_M;
pub(crate) use rounding::{MAX_MARGIN_M, MotionBounds};

use std::collections::VecDeque;

use super::{AnyController, Controller, ControllerFailure, clamp_command};
use crate::observation::Observation;

/// Successive steps in which a shield braked instead of doing what its controller wanted, or in which the state was outside the kernel,
/// where a shield brakes fully whatever its controller wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Override {
    /// First step.
    pub first_step: usize,
    /// Last step.
    pub last_step: usize,
    /// Whether the state was outside the kernel in one of them: contact could then no longer be ruled out.
    pub outside_kernel: bool,
    /// Whether in one of them the vehicle behind could not avoid the braking vehicle: no action suited both.
    pub rear_conflict: bool,
}

/// A controller behind a shield.
pub(crate) struct ShieldedController {
    controller: Box<AnyController>,
    params: ShieldParams,
    /// Commands under way to the actuator, oldest first.
    pending_mps2: VecDeque<f64>,
    /// What the actuator makes of the commands so far, in m/s².
    response_mps2: f64,
    step: usize,
    overrides: Vec<Override>,
}

impl ShieldedController {
    /// Puts a controller behind a shield.
    #[must_use]
    pub(crate) fn new(controller: AnyController, frame: ShieldParams) -> Self {
        Self {
            controller: Box::new(controller),
            pending_mps2: VecDeque::from(vec![0.0; frame.delay_steps]),
            params: frame,
            response_mps2: 0.0,
            step: 0,
            overrides: Vec::new(),
        }
    }

    /// When the shield braked instead, in order.
    #[must_use]
    pub(crate) fn overrides(&self) -> &[Override] {
        &self.overrides
    }

    /// The worst state within the error bounds in which a command given now will act; none on an open road.
    fn worst_state(&self, seen: &Observation) -> Option<ShieldState> {
        let ahead = seen.ahead?;
        let ErrorBounds { gap_m, speed_mps, ahead_speed_mps } = self.params.errors;
        let mut state = ShieldState {
            gap_m: ahead.gap_m - gap_m,
            speed_mps: seen.speed_mps + speed_mps,
            ahead_mps: (ahead.speed_mps - ahead_speed_mps).max(0.0),
            response_mps2: self.response_mps2,
        };
        for &command_mps2 in &self.pending_mps2 {
            state = self.params.after(state, command_mps2);
        }
        Some(state)
    }

    fn record_override(&mut self, outside_kernel: bool, rear_conflict: bool) {
        let step = self.step;
        match self.overrides.last_mut().filter(|last| last.last_step + 1 == step) {
            Some(last) => {
                last.last_step = step;
                last.outside_kernel |= outside_kernel;
                last.rear_conflict |= rear_conflict;
            }
            None => {
                self.overrides.push(Override { first_step: step, last_step: step, outside_kernel, rear_conflict });
            }
        }
    }
}

impl Controller for ShieldedController {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        let wanted_mps2 = clamp_command(self.controller.decide(seen)?, self.params.brake_mps2, self.params.accel_mps2);
        let mut command_mps2 = wanted_mps2;
        if let Some(state) = self.worst_state(seen)
            && !self.params.admits(state, wanted_mps2)
        {
            command_mps2 = -self.params.brake_mps2;
            let outside_kernel = self.params.spare_m(state) < 0.5 * self.params.margin_m;
            // A controller that brakes fully by itself is not overruled; that nothing is promised any more is told all the same.
            if wanted_mps2 > command_mps2 || outside_kernel {
                self.record_override(outside_kernel, self.params.endangers_rear(seen));
            }
        }
        self.pending_mps2.push_back(command_mps2);
        let due_mps2 = self.pending_mps2.pop_front().unwrap_or(command_mps2);
        self.response_mps2 = self.params.response_mps2(self.response_mps2, due_mps2);
        self.step += 1;
        Ok(command_mps2)
    }
}

impl ShieldParams {
    /// Whether full braking from now on cannot be avoided by the vehicle behind, which holds its speed until it reacts.
    ///
    /// The gap behind is concave while it holds its speed and the own vehicle brakes, so it is smallest at an end of that.
    fn endangers_rear(&self, seen: &Observation) -> bool {
        let (Some(rear), Some(RearVehicleParams { brake_mps2, reaction_s })) = (seen.behind, self.behind) else {
            return false;
        };
        let [covered_m, speed_mps] = distance_and_speed_after(seen.speed_mps, -self.brake_mps2, reaction_s);
        let kernel = ViabilityKernel { own_brake_mps2: brake_mps2, ahead_brake_mps2: self.brake_mps2 };
        let gap_m = rear.gap_m + covered_m - rear.speed_mps * reaction_s;
        gap_m <= kernel.demanded_gap_m(rear.speed_mps, speed_mps)
    }
}

#[cfg(test)]
mod tests;
