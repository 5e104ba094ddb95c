//! A shield for both sides: passes commands after which a plan avoids the leader and is not hit by the follower.
//!
//! A plan brakes until the follower's brake fires, or holds a speed after some braking, then accelerates, or not, as
//! long as possible, and brakes fully. A state is in S if some plan satisfies two conditions for the worst leader and
//! the worst follower of a class ([`FollowerClass`]):
//!
//! ```text
//! (A)  min over t of  U(t) - x(t) >= m      U: a leader that brakes at its limit
//! (B)  min over t of  x(t) - L(t) >= m      L: the farthest follower of the class
//! ```
//!
//! A command passes if the state after it is in S. Otherwise the filter executes a command near its last one after
//! which the state is in S, or its stored plan. The rest of a plan is a plan, so no state leaves S. Both conditions are
//! minima of piecewise quadratic functions, which are evaluated at ends and vertices ([`path`]); the rounding of all
//! terms is subtracted from the result.
//!
//! The *level* of a state is the hardest braking of the leader for which the state is in S.
//!
//! - *Firing*: a follower that slows down before its brake fires, fires later. So the plan waits until the brake has
//!   fired, and is tested for every step at which it may fire (`trial/waiting.rs`).
//! - *Delay*: pending commands are the begin of the plan.
//! - *Lag*: with the share σ of the actuator and τ' = h (1 - σ)/σ, the quantity v + τ' r of speed and response changes
//!   by exactly h times the command in each step. The response is between the commands so far, which bounds the speed
//!   from both sides.
//! - *Errors of the follower or of the own speed*: the ego vehicle cannot observe the firing. The plan then waits until
//!   the step at which every follower of the class has fired, and is tested for every earlier firing.
//! - *Noise* on the own acceleration: as in the one-sided shield.

mod commands;
mod filter;
mod level;
mod params;
mod path;
mod settings;
mod state;
mod trial;

pub use commands::{CommandsAfterFiring, PlanCommands};
pub use filter::TwoSidedFilter;
pub use level::{LevelMeter, MAX_LEVEL_MPS2};
pub use params::{
    CREEP_SPEED_MPS, FollowerClass, FollowerTrigger, NOTICED_BRAKE_MPS2, RearErrorBounds,
    TwoSidedParams,
};
pub use settings::TwoSidedSettings;
pub use state::FollowerPhase;

use super::{Controller, ControllerFailure, Override};
use crate::observation::Observation;

/// A controller behind a two-sided filter.
pub(super) struct TwoSidedController {
    controller: Box<dyn Controller>,
    filter: TwoSidedFilter,
}

impl TwoSidedController {
    pub(super) fn new(controller: Box<dyn Controller>, params: TwoSidedParams) -> Self {
        Self {
            controller,
            filter: TwoSidedFilter::new(params),
        }
    }
}

impl Controller for TwoSidedController {
    fn perceive(&mut self, truth: &Observation) {
        self.controller.perceive(truth);
    }

    fn is_warning(&self) -> bool {
        self.controller.is_warning()
    }

    fn overrides(&self) -> &[Override] {
        self.filter.overrides()
    }

    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let wanted_mps2 = self.controller.decide(observation)?;
        let command_mps2 = self.filter.decide(observation, wanted_mps2);
        if command_mps2 != wanted_mps2 {
            self.controller.record_command(command_mps2);
        }
        Ok(command_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.controller.record_command(command_mps2);
        self.filter.record_command(command_mps2);
    }
}
