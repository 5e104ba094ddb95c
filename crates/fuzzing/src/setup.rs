//! Setup of a simulation: controller under test, estimator and integration step.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use arbitrary::Unstructured;

use crumple_controllers::{UnknownController, find_and_try};
use crumple_core::digest::sha256;
use crumple_sim::control::{
    AebSettings, BuiltInController, Controller, ControllerFailure, ControllerSource, Ego,
    IntoSource,
};
use crumple_sim::engine::{AfterCollision, NamedController, RefusedController, RunOptions};
use crumple_sim::observation::{EstimatorKind, Observation};
use crumple_testing::generator::{Choices, DRIVER_BYTES, controller_from_bytes};

/// Bytes of a setup.
pub const SETUP_BYTES: usize = 5 + DRIVER_BYTES;

/// Simulation settings that a reproducer can state.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSetup {
    /// Controller under test.
    pub controller: TestedController,
    /// Estimator of its observations.
    pub estimator: EstimatorKind,
    /// Integration steps per step of the scenario.
    pub substeps: u32,
    /// Behaviour after a collision.
    pub after_collision: AfterCollision,
}

/// Controller under test.
#[derive(Debug, Clone, PartialEq)]
pub enum TestedController {
    /// A built-in controller.
    BuiltIn(BuiltInController),
    /// Another controller by its name on the command line: a policy file, or a shielded controller.
    Named(ControllerByName),
    /// An external controller that uses all its observations and decides every so many steps; at every step if 0.
    FullObservation(u32),
}

/// A controller that was found by name; the name decides equality.
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
    /// Returns a setup with the baseline, true states and the scenario's step that stops at the first collision.
    #[must_use]
    pub fn with_true_state() -> Self {
        Self {
            controller: TestedController::BuiltIn(BuiltInController::Baseline(
                AebSettings::default(),
            )),
            estimator: EstimatorKind::Truth,
            substeps: 1,
            after_collision: AfterCollision::Stop,
        }
    }

    /// Reads a setup; no bytes give the defaults: the baseline with the Kalman filter, until the first collision.
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
            estimator: choices
                .choose(&[EstimatorKind::Kalman, EstimatorKind::Truth])
                .unwrap_or_default(),
            substeps: match choices.byte() {
                0..192 => 1,
                more @ 192.. => 2 + u32::from(more) % 6,
            },
            after_collision: choices
                .choose(&[
                    AfterCollision::Stop,
                    AfterCollision::Continue,
                    AfterCollision::Hold,
                    AfterCollision::Coast,
                ])
                .unwrap_or_default(),
        }
    }

    /// Returns the other estimator.
    #[must_use]
    pub fn other_estimator(&self) -> EstimatorKind {
        match self.estimator {
            EstimatorKind::Kalman => EstimatorKind::Truth,
            EstimatorKind::Truth => EstimatorKind::Kalman,
        }
    }

    /// True if the controller is a network, which rounds observations to single precision.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        match &self.controller {
            TestedController::BuiltIn(spec) => spec.policy().is_some(),
            TestedController::Named(ControllerByName(named)) => named.source.is_learned(),
            TestedController::FullObservation(_) => false,
        }
    }

    /// True if the controller ignores its follower.
    #[must_use]
    pub fn looks_ahead_only(&self) -> bool {
        matches!(&self.controller, TestedController::BuiltIn(spec) if !spec.observes_follower())
    }

    /// Returns the options for a scenario with this step.
    #[must_use]
    pub fn options(&self, step_s: f64) -> RunOptions {
        let controller = match &self.controller {
            TestedController::BuiltIn(spec) => spec.clone().into_source(),
            TestedController::Named(ControllerByName(named)) => named.source.clone(),
            TestedController::FullObservation(steps) => {
                let interval_s = (*steps > 0).then(|| f64::from(*steps) * step_s);
                Arc::new(FullObservationController {
                    interval_s,
                    last_mps2: 0.0,
                })
            }
        };
        let options = RunOptions::new(controller)
            .with_estimator(self.estimator)
            .with_after_collision(self.after_collision);
        if self.substeps == 1 {
            options
        } else {
            options.with_dt_s(step_s / f64::from(self.substeps))
        }
    }
}

impl TestedController {
    /// Finds a controller by its name on the command line, and starts the program of a process or an FMU as a trial.
    ///
    /// # Errors
    /// [`UnknownController`] if there is none, or it does not start.
    pub fn from_name(name: &str) -> Result<Self, UnknownController> {
        let named = find_and_try(name, Path::new(""))?;
        let built_in = named.source.downcast_ref::<BuiltInController>().cloned();
        Ok(match built_in {
            Some(spec) => Self::BuiltIn(spec),
            None => Self::Named(ControllerByName(named)),
        })
    }

    /// Returns the decision interval of a named controller, in seconds; `None` to decide at every step.
    #[must_use]
    pub fn interval_s(&self) -> Option<f64> {
        match self {
            Self::BuiltIn(spec) => spec.interval_s(),
            Self::Named(ControllerByName(named)) => named.source.interval_s(),
            Self::FullObservation(_) => None,
        }
    }

    /// Fails if a process contradicted itself or can no longer be started.
    pub(crate) fn ensure_trusted(&self) -> Result<(), RefusedController> {
        if let Self::Named(ControllerByName(named)) = self {
            named.ensure_trusted()
        } else {
            Ok(())
        }
    }

    /// True if the controller runs in a separate process, also behind a shield.
    #[must_use]
    pub(crate) fn is_process(&self) -> bool {
        let Self::Named(ControllerByName(named)) = self else {
            return false;
        };
        named.source.program_field().is_some()
    }

    /// Returns the name on the command line; for the external controller only a label.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::BuiltIn(spec) => spec.name(),
            Self::Named(ControllerByName(named)) => &named.name,
            Self::FullObservation(_) => "opinionated",
        }
    }
}

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
        Ok(Box::new(Self {
            interval_s: self.interval_s,
            last_mps2: 0.0,
        }))
    }
}

impl Controller for FullObservationController {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let ahead = observation.ahead.map_or(0.5, |n| {
            0.1 * (n.gap_m - 12.0) + n.speed_mps - observation.speed_mps + n.acceleration_mps2
        });
        let behind = observation.behind.map_or(0.0, |n| {
            0.2 * (n.speed_mps - observation.speed_mps) - 0.01 * n.gap_m + n.acceleration_mps2
        });
        self.last_mps2 = 0.5 * self.last_mps2 + 0.4 * ahead + 0.1 * behind
            - 0.05 * observation.acceleration_mps2;
        // Sometimes NaN, which ends the run.
        Ok(if observation.speed_mps > 30.0 {
            f64::NAN
        } else {
            self.last_mps2
        })
    }
}
