//! Controllers from outside: what a run must know of one before it drives, and how one fails.

use serde::{Deserialize, Serialize};

use super::{Controller, Ego};
use crate::observation::Observation;
use crate::process::ProcessFailure;

/// Why a controller gave no usable answer. The run ends there: a vehicle without a driver does not coast.
///
/// ```
/// use crumple_world::control::ControllerFailure;
///
/// let late = ControllerFailure::Late { limit_s: 0.1 };
/// assert_eq!(late.to_string(), "it gave no answer within 0.1 s");
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum ControllerFailure {
    /// The answer was not a number, or infinite.
    #[error("it answered with a number that is not finite")]
    NotFinite,
    /// The answer left the range that the controller itself declares.
    #[error("it answered {answer_mps2} m/s², which is outside its range of {low_mps2} to {high_mps2} m/s²")]
    OutOfRange {
        /// The answer, in m/s².
        answer_mps2: f64,
        /// The least answer declared, in m/s².
        low_mps2: f64,
        /// The largest answer declared, in m/s².
        high_mps2: f64,
    },
    /// No answer came in time.
    #[error("it gave no answer within {limit_s} s")]
    Late {
        /// The time it had, in seconds.
        limit_s: f64,
    },
    /// A process failed.
    #[error(transparent)]
    Process(Box<ProcessFailure>),
    /// The controller cannot drive, or ended.
    #[error("{message}")]
    Died {
        /// What is known of it.
        message: String,
    },
}

/// A neighbour that a controller cannot drive without.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Needs {
    /// The controller can drive on an empty road.
    #[default]
    Nothing,
    /// There must be a vehicle ahead.
    Ahead,
    /// There must be a vehicle ahead and one behind.
    AheadAndBehind,
}

/// Where controllers of one kind come from.
///
/// Asking for anything but [`start`](Self::start) starts nothing.
///
/// ```
/// use crumple_world::control::{Controller, ControllerFailure, ControllerSource, Ego};
/// use crumple_world::digest::sha256;
/// use crumple_world::observation::Observation;
///
/// /// Brakes in proportion to the closing speed.
/// struct Gain(f64);
///
/// impl ControllerSource for Gain {
///     fn identity(&self) -> Option<String> {
///         Some(sha256(format!("gain {}", self.0)))
///     }
///
///     fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
///         Ok(Box::new(Self(self.0)))
///     }
/// }
///
/// impl Controller for Gain {
///     fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
///         Ok(seen.ahead.map_or(0.0, |ahead| self.0 * (ahead.speed_mps - seen.speed_mps)))
///     }
/// }
/// assert_eq!(Gain(1.0).interval_s(), None);
/// ```
pub trait ControllerSource: Send + Sync {
    /// SHA-256, in hexadecimal, of everything that decides how its controllers drive: resuming, caching and claims go by
    /// it. None if that cannot be known; such a controller can be simulated, but nothing of it is kept or certified.
    fn identity(&self) -> Option<String>;

    /// Time between decisions in seconds, a multiple of the scenario's step; none to decide at every step.
    fn interval_s(&self) -> Option<f64> {
        None
    }

    /// Neighbours that its controllers cannot drive without: a run that lacks one is refused.
    fn needs(&self) -> Needs {
        Needs::Nothing
    }

    /// A controller for a vehicle, with no memory of any run before. `seed` is the scenario's.
    ///
    /// # Errors
    /// [`ControllerFailure`] if it cannot drive: the run then ends before its first step.
    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure>;
}

/// A controller from outside, held between its decisions. Answers that are no numbers are failures.
pub struct ZeroOrderHold {
    controller: Box<dyn Controller>,
    interval_steps: u32,
    steps_to_decision: u32,
    held_mps2: f64,
}

impl ZeroOrderHold {
    /// Holds the answers of `controller`, which is asked every `interval_s` in a scenario that steps every `step_s`; at every
    /// step if there is no interval.
    #[must_use]
    pub fn new(controller: Box<dyn Controller>, interval_s: Option<f64>, step_s: f64) -> Self {
        let interval_steps = interval_s.map_or(1, |interval_s| (interval_s / step_s).round().max(1.0) as u32);
        Self { controller, interval_steps, steps_to_decision: 0, held_mps2: 0.0 }
    }
}

impl Controller for ZeroOrderHold {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        if self.steps_to_decision == 0 {
            self.steps_to_decision = self.interval_steps;
            self.held_mps2 = self.controller.decide(seen)?;
            if !self.held_mps2.is_finite() {
                return Err(ControllerFailure::NotFinite);
            }
        }
        self.steps_to_decision -= 1;
        Ok(self.held_mps2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::behind;
    use super::*;

    struct Counter(f64);
    impl Controller for Counter {
        fn decide(&mut self, _: &Observation) -> Result<f64, ControllerFailure> {
            self.0 += 1.0;
            Ok(if self.0 > 2.5 { f64::NAN } else { self.0 })
        }
    }

    #[test]
    fn decides_once_an_interval_and_fails_at_an_answer_that_is_no_number() {
        let mut held = ZeroOrderHold::new(Box::new(Counter(0.0)), Some(0.03), 0.01);
        let answers = [0; 7].map(|_| held.decide(&behind(20.0, 20.0, 20.0, 0.0)));
        let failed = Err(ControllerFailure::NotFinite);
        assert_eq!(answers, [Ok(1.0), Ok(1.0), Ok(1.0), Ok(2.0), Ok(2.0), Ok(2.0), failed]);
        let mut at_every_step = ZeroOrderHold::new(Box::new(Counter(0.0)), None, 0.01);
        let answers = [0; 2].map(|_| at_every_step.decide(&behind(20.0, 20.0, 20.0, 0.0)));
        assert_eq!(answers, [Ok(1.0), Ok(2.0)]);
    }
}
