//! How a scenario is run: what is under test, through which eyes, how finely.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use arbitrary::Unstructured;

use super::choices::Choices;
use super::driver::{DRIVER_BYTES, controller_from_bytes};
use crumple_core::digest::sha256;
use crumple_world::control::{AebSettings, Controller, ControllerFailure, ControllerSource, ControllerSpec, Ego};
use crumple_world::observation::{EstimatorKind, Observation};
use crumple_world::sim::{AfterContact, ControllerKind, NamedController, RunOptions, UnknownController};

/// Bytes that a setup is read from.
pub const SETUP_BYTES: usize = 5 + DRIVER_BYTES;

/// How to run scenarios, in words that a failure can print.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSetup {
    /// What is put under test.
    pub controller: TestedController,
    /// What it looks through.
    pub estimator: EstimatorKind,
    /// Integration steps in a step of the scenario.
    pub substeps: u32,
    /// What happens at a contact.
    pub after_contact: AfterContact,
}

/// What is put under test.
#[derive(Debug, Clone, PartialEq)]
pub enum TestedController {
    /// A built-in controller.
    BuiltIn(ControllerSpec),
    /// Anything else the command line knows by name: a policy file, a controller behind a shield.
    Named(ControllerByName),
    /// A controller from outside that uses all it may see, deciding every so many steps; at every step if 0.
    FullObservation(u32),
}

/// A controller that was found by its name, which stands for it.
#[derive(Clone)]
pub struct ControllerByName(NamedController);

impl PartialEq for ControllerByName {
    fn eq(&self, other: &Self) -> bool {
        self.0.name == other.0.name
    }
}

impl fmt::Debug for ControllerByName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0.name)
    }
}

impl RunSetup {
    /// The baseline, with true states, at the scenario's own step, up to the first contact.
    #[must_use]
    pub fn with_true_state() -> Self {
        Self {
            controller: TestedController::BuiltIn(ControllerSpec::Baseline(AebSettings::default())),
            estimator: EstimatorKind::Truth,
            substeps: 1,
            after_contact: AfterContact::Stop,
        }
    }

    /// Reads a setup; no bytes are the product's defaults: the baseline, through the filter, up to the first contact.
    pub fn read(from: &mut Unstructured<'_>) -> Self {
        let mut choices = Choices::read_block(from, SETUP_BYTES - DRIVER_BYTES);
        let kind = choices.byte();
        let interval_steps = u32::from(choices.byte() % 8);
        let settings = from.bytes(DRIVER_BYTES.min(from.len())).unwrap_or_default();
        Self {
            controller: match kind {
                0..192 => TestedController::BuiltIn(controller_from_bytes(kind, settings)),
                192.. => TestedController::FullObservation(interval_steps),
            },
            estimator: choices.choose(&[EstimatorKind::Kalman, EstimatorKind::Truth]).unwrap_or_default(),
            substeps: match choices.byte() {
                0..192 => 1,
                more @ 192.. => 2 + u32::from(more) % 6,
            },
            after_contact: choices.choose(&[AfterContact::Stop, AfterContact::Continue]).unwrap_or_default(),
        }
    }

    /// The estimator this is not.
    #[must_use]
    pub fn other_estimator(&self) -> EstimatorKind {
        match self.estimator {
            EstimatorKind::Kalman => EstimatorKind::Truth,
            EstimatorKind::Truth => EstimatorKind::Kalman,
        }
    }

    /// Whether the controller is a network, which rounds what it sees to single precision.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        match &self.controller {
            TestedController::BuiltIn(spec) => spec.policy().is_some(),
            TestedController::Named(ControllerByName(found)) => found.kind.is_learned(),
            TestedController::FullObservation(_) => false,
        }
    }

    /// Whether the controller ignores the vehicle behind.
    #[must_use]
    pub fn looks_ahead_only(&self) -> bool {
        matches!(&self.controller, TestedController::BuiltIn(_)) && !self.is_learned()
    }

    /// The options for a scenario of a step.
    #[must_use]
    pub fn options(&self, step_s: f64) -> RunOptions {
        let controller = match &self.controller {
            TestedController::BuiltIn(spec) => ControllerKind::from(spec.clone()),
            TestedController::Named(ControllerByName(found)) => found.kind.clone(),
            TestedController::FullObservation(steps) => {
                let interval_s = (*steps > 0).then(|| f64::from(*steps) * step_s);
                Arc::new(FullObservationController { interval_s, last_mps2: 0.0 }).into()
            }
        };
        let options = RunOptions::new(controller).with_estimator(self.estimator).with_after_contact(self.after_contact);
        if self.substeps == 1 { options } else { options.with_dt_s(step_s / f64::from(self.substeps)) }
    }
}

impl TestedController {
    /// The controller that `crumple simulate --controller` would take by this name: built in, or a policy file.
    ///
    /// # Errors
    /// [`UnknownController`] if there is none.
    pub fn from_name(name: &str) -> Result<Self, UnknownController> {
        let found = NamedController::find_for_user(name, Path::new(""))?;
        Ok(match found.kind {
            ControllerKind::BuiltIn(spec) => Self::BuiltIn(spec),
            _ => Self::Named(ControllerByName(found)),
        })
    }

    /// Returns the time between decisions of a controller that has a name, in seconds; none to decide at every step.
    #[must_use]
    pub fn interval_s(&self) -> Option<f64> {
        match self {
            Self::BuiltIn(spec) => ControllerKind::from(spec.clone()).interval_s(),
            Self::Named(ControllerByName(found)) => found.kind.interval_s(),
            Self::FullObservation(_) => None,
        }
    }

    /// Returns whether the controller runs in a process of its own, behind any number of shields.
    #[must_use]
    pub(crate) fn is_process(&self) -> bool {
        let Self::Named(ControllerByName(found)) = self else { return false };
        matches!(found.kind.unshielded(), ControllerKind::Process(_))
    }

    /// What it is called: as on the command line, but for the controller from outside.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::BuiltIn(spec) => spec.name(),
            Self::Named(ControllerByName(found)) => &found.name,
            Self::FullObservation(_) => "opinionated",
        }
    }
}

/// Uses all eight numbers it may see, and remembers its last answer.
struct FullObservationController {
    interval_s: Option<f64>,
    last_mps2: f64,
}

impl ControllerSource for FullObservationController {
    fn identity(&self) -> Option<String> {
        Some(sha256(format!("opinionated {:?}", self.interval_s)))
    }

    fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(Self { interval_s: self.interval_s, last_mps2: 0.0 }))
    }
}

impl Controller for FullObservationController {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        let ahead =
            seen.ahead.map_or(0.5, |n| 0.1 * (n.gap_m - 12.0) + n.speed_mps - seen.speed_mps + n.acceleration_mps2);
        let behind =
            seen.behind.map_or(0.0, |n| 0.2 * (n.speed_mps - seen.speed_mps) - 0.01 * n.gap_m + n.acceleration_mps2);
        self.last_mps2 = 0.5 * self.last_mps2 + 0.4 * ahead + 0.1 * behind - 0.05 * seen.acceleration_mps2;
        // Now and then no number, which ends the run.
        Ok(if seen.speed_mps > 30.0 { f64::NAN } else { self.last_mps2 })
    }
}
