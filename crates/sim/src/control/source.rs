//! Sources of controllers: each starts a controller for a vehicle of a run.

use std::any::Any;
use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::zero_order_hold::ZeroOrderHold;
use super::{
    BuiltInController, Controller, Ego, ProcessFailure, ShieldParams, ShieldRefusal,
    ShieldSettings, ShieldedSource, SourceFile, TwoSidedParams, TwoSidedSettings,
};
use crate::observation::Observation;
use crate::policy::Policy;

/// Reason why a controller gave no usable answer. The run ends there: a vehicle without a controller does not coast.
///
/// ```
/// use crumple_sim::control::ControllerFailure;
///
/// let late = ControllerFailure::Late { limit_s: 0.1 };
/// assert_eq!(late.to_string(), "it gave no answer within 0.1 s");
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum ControllerFailure {
    /// The answer is NaN or infinite.
    #[error("it answered with a number that is not finite")]
    NotFinite,
    /// The answer is outside the range that the controller declares.
    #[error(
        "it answered {answer_mps2} m/s², which is outside its range of {low_mps2} to {high_mps2} m/s²"
    )]
    OutOfRange {
        /// The answer, in m/s².
        answer_mps2: f64,
        /// Minimum declared answer, in m/s².
        low_mps2: f64,
        /// Maximum declared answer, in m/s².
        high_mps2: f64,
    },
    /// The answer was late.
    #[error("it gave no answer within {limit_s} s")]
    Late {
        /// Time limit, in seconds.
        limit_s: f64,
    },
    /// A process failed.
    #[error(transparent)]
    Process(Box<ProcessFailure>),
    /// The controller cannot drive, or ended.
    #[error("{message}")]
    Died {
        /// Description of the failure.
        message: String,
    },
}

/// Neighbours without which a controller cannot drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum RequiredNeighbours {
    /// No neighbour; the controller can drive on an empty road.
    #[default]
    Nothing,
    /// The leader.
    Ahead,
    /// Leader and follower.
    AheadAndBehind,
}

/// Source of controllers of one kind: a built-in rule, a policy, a network, a process, an FMU, a shield around another
/// source, or a user's own.
///
/// Two methods are required. Only [`start`](Self::start) starts a controller.
///
/// ```
/// use crumple_sim::control::{Controller, ControllerFailure, ControllerSource, Ego};
/// use crumple_core::digest::sha256;
/// use crumple_sim::observation::Observation;
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
///     fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
///         Ok(observation.ahead.map_or(0.0, |ahead| self.0 * (ahead.speed_mps - observation.speed_mps)))
///     }
/// }
/// assert_eq!(Gain(1.0).interval_s(), None);
/// ```
pub trait ControllerSource: Any + Send + Sync {
    /// Returns the SHA-256, in hexadecimal, of everything that determines the commands: the key of resuming, caching
    /// and claims. `None` if it is unknown; results are then neither stored nor certified.
    fn identity(&self) -> Option<String>;

    /// Creates a controller for a vehicle, without memory of earlier runs. `seed` is the scenario's.
    ///
    /// # Errors
    /// [`ControllerFailure`] if it cannot drive; the run then ends before its first step.
    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure>;

    /// Returns the source that this one changes, for example behind a shield. The other methods then have its answers
    /// as defaults, except [`start`](Self::start), [`start_in_run`](Self::start_in_run),
    /// [`check_vehicle`](Self::check_vehicle), [`holds_answers`](Self::holds_answers),
    /// [`batch_controller`](Self::batch_controller), [`description`](Self::description) and
    /// [`as_shield`](Self::as_shield).
    fn inner(&self) -> Option<&dyn ControllerSource> {
        None
    }

    /// Returns the time between decisions in seconds, a multiple of the scenario's step. `None` for every step, or if
    /// only a started process knows it.
    fn interval_s(&self) -> Option<f64> {
        self.inner().and_then(|inner| inner.interval_s())
    }

    /// Returns true if its controllers decide at their interval, hold their answers in between, and check them.
    fn holds_answers(&self) -> bool {
        false
    }

    /// Returns the neighbours without which its controllers cannot drive; a run that lacks one is rejected.
    fn required_neighbours(&self) -> RequiredNeighbours {
        self.inner().map_or(RequiredNeighbours::Nothing, |inner| {
            inner.required_neighbours()
        })
    }

    /// Returns the batch controller for lockstep runs; `None` if each controller is queried by itself.
    fn batch_controller(&self) -> Option<&dyn BatchController> {
        None
    }

    /// Returns warnings, one line each.
    fn warnings(&self) -> Vec<String> {
        self.inner().map_or_else(Vec::new, |inner| inner.warnings())
    }

    /// Returns a description for reports, without the name.
    fn description(&self) -> String {
        "external controller".to_owned()
    }

    /// Returns the controller file, network or FMU that defines the mapping or the command, if there is one.
    fn file(&self) -> Option<&SourceFile> {
        self.inner().and_then(|inner| inner.file())
    }

    /// Returns the policy, behind a shield or not.
    fn policy(&self) -> Option<Arc<Policy>> {
        self.inner().and_then(|inner| inner.policy())
    }

    /// Returns true for a policy or an imported network, behind a shield or not.
    fn is_learned(&self) -> bool {
        self.inner().is_some_and(|inner| inner.is_learned())
    }

    /// Returns true if its controllers may fail without a collision. Built-in rules, policies and networks cannot.
    fn can_fail(&self) -> bool {
        self.inner().is_none_or(|inner| inner.can_fail())
    }

    /// Returns true if its controllers [warn](Controller::is_warning) their drivers. May start a program to learn it.
    fn reports_warnings(&self) -> bool {
        self.inner().is_some_and(|inner| inner.reports_warnings())
    }

    /// Returns the field of a [file](Self::file) that names the program, behind a shield or not; `None` without a
    /// program.
    fn program_field(&self) -> Option<&'static str> {
        self.inner().and_then(|inner| inner.program_field())
    }

    /// Returns false for a program that its file or its handshake declares nondeterministic.
    fn is_deterministic(&self) -> bool {
        self.inner().is_none_or(|inner| inner.is_deterministic())
    }

    /// Returns true if commands depend on the seed of the scenario, so that one run shows little. By default, this
    /// holds for programs that are not deterministic.
    fn acts_at_random(&self) -> bool {
        self.inner()
            .map_or_else(|| !self.is_deterministic(), |inner| inner.acts_at_random())
    }

    /// Starts the program without a run, and ends it.
    ///
    /// # Errors
    /// [`ControllerFailure`] of a program that cannot be started or does not complete the handshake.
    fn try_start(&self) -> Result<(), ControllerFailure> {
        self.inner().map_or(Ok(()), |inner| inner.try_start())
    }

    /// Returns the reason to reject all runs of a program: it proved nondeterministic, or does not start any more.
    fn refusal(&self) -> Option<ControllerFailure> {
        self.inner().and_then(|inner| inner.refusal())
    }

    /// Returns false if each run needs its own program, so that runs in lockstep would need many at once.
    fn supports_lockstep(&self, ego: &Ego) -> bool {
        self.inner()
            .is_none_or(|inner| inner.supports_lockstep(ego))
    }

    /// Returns the shield that this source is, if it is one.
    fn as_shield(&self) -> Option<&ShieldedSource> {
        None
    }

    /// Refuses a vehicle that its controllers cannot protect, before the run begins.
    ///
    /// # Errors
    /// [`ShieldRefusal`] of a shield that gives no guarantee for this vehicle.
    fn check_vehicle(&self, _vehicle: &VehicleInRun<'_>) -> Result<(), ShieldRefusal> {
        Ok(())
    }

    /// Starts a controller for a vehicle of a run: that of [`start`](Self::start), with its
    /// [interval](Self::interval_s) and its [batches](Self::batch_controller) unless it
    /// [holds its answers](Self::holds_answers). A non-finite answer is a failure.
    ///
    /// # Errors
    /// [`ControllerFailure`], as for [`start`](Self::start).
    fn start_in_run(
        &self,
        vehicle: &VehicleInRun<'_>,
    ) -> Result<Box<dyn Controller>, ControllerFailure> {
        let controller = self.start(&vehicle.ego, vehicle.seed)?;
        if self.holds_answers() {
            return Ok(controller);
        }
        let hold = ZeroOrderHold::new(controller, self.interval_s(), vehicle.ego.step_s);
        Ok(Box::new(hold.with_batching(vehicle.source)))
    }
}

impl dyn ControllerSource {
    /// Returns the source as its own type, if it is a `T`.
    #[must_use]
    pub fn downcast_ref<T: ControllerSource>(&self) -> Option<&T> {
        (self as &dyn Any).downcast_ref()
    }

    /// Returns the source behind a shield, or this source.
    #[must_use]
    pub fn unshielded(&self) -> &dyn ControllerSource {
        self.as_shield()
            .map_or(self, |shield| shield.controller.unshielded())
    }
}

impl fmt::Debug for dyn ControllerSource {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("ControllerSource")
            .field(&self.identity())
            .finish()
    }
}

/// A vehicle of a run, for which a source starts a controller.
pub struct VehicleInRun<'r> {
    /// The vehicle.
    pub ego: Ego,
    /// Seed of the scenario.
    pub seed: u64,
    /// The source itself.
    pub(crate) source: &'r Arc<dyn ControllerSource>,
    pub(crate) assumptions: &'r dyn ShieldAssumptions,
}

impl VehicleInRun<'_> {
    /// Returns the parameters of a shield of this vehicle with these settings.
    pub(crate) fn shield_params(
        &self,
        settings: &ShieldSettings,
    ) -> Result<ShieldParams, ShieldRefusal> {
        self.assumptions.shield_params(self.ego.vehicle, settings)
    }

    /// Returns the parameters of a two-sided shield of this vehicle with these settings.
    pub(crate) fn two_sided_params(
        &self,
        settings: &TwoSidedSettings,
    ) -> Result<TwoSidedParams, ShieldRefusal> {
        self.assumptions
            .two_sided_params(self.ego.vehicle, settings)
    }
}

/// Facts of a run about its vehicles, from which a shield computes its parameters.
pub(crate) trait ShieldAssumptions {
    /// Returns the parameters of a shield of vehicle `vehicle` with these settings.
    fn shield_params(
        &self,
        vehicle: usize,
        settings: &ShieldSettings,
    ) -> Result<ShieldParams, ShieldRefusal>;

    /// Returns the parameters of a two-sided shield of vehicle `vehicle` with these settings.
    fn two_sided_params(
        &self,
        vehicle: usize,
        settings: &TwoSidedSettings,
    ) -> Result<TwoSidedParams, ShieldRefusal>;
}

/// A value that is, or stands for, a source of controllers: a built-in controller, a policy, or a shared source.
pub trait IntoSource {
    /// Returns the source.
    fn into_source(self) -> Arc<dyn ControllerSource>;
}

impl IntoSource for Arc<dyn ControllerSource> {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        self
    }
}

impl IntoSource for &Arc<dyn ControllerSource> {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::clone(self)
    }
}

impl<S: ControllerSource> IntoSource for Arc<S> {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        self
    }
}

impl IntoSource for BuiltInController {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::new(self)
    }
}

/// Controllers whose answers depend only on the observation, so that many can be queried at once.
///
/// Answers equal those of the source's controllers. The engine chooses which runs share a query.
pub trait BatchController: Send + Sync {
    /// Computes the accelerations, in m/s², one per observation, into `answers_mps2` of the same length.
    ///
    /// # Errors
    /// [`ControllerFailure`] if there are no answers; each controller is then queried by itself.
    fn decide_batch(
        &self,
        observations: &[Observation],
        answers_mps2: &mut [f64],
    ) -> Result<(), ControllerFailure>;
}

/// Returns a controller that fails at its first decision, in place of one that did not start.
pub(crate) fn not_started(failure: ControllerFailure) -> Box<dyn Controller> {
    Box::new(UnstartedController(failure))
}

struct UnstartedController(ControllerFailure);

impl Controller for UnstartedController {
    fn decide(&mut self, _seen: &Observation) -> Result<f64, ControllerFailure> {
        Err(self.0.clone())
    }
}
