//! A shield as a source of controllers.

use std::sync::Arc;

use super::{ShieldSettings, ShieldedController};
use crate::control::{
    Controller, ControllerFailure, ControllerSource, Ego, IntoSource, RequiredNeighbours,
    SourceFile, VehicleInRun,
};
use crate::policy::Policy;
use crumple_core::digest::sha256;

/// Reason why a shield gives no guarantee for a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ShieldRefusal {
    /// The controller behind the shield is a shield.
    #[error("only one shield may stand before a controller")]
    Nested,
    /// Full braking is not available at a known rate.
    #[error("it has a jerk limit, which the kernel does not cover")]
    JerkLimit,
    /// The kernel assumes that every vehicle executes its command at once, within known limits.
    #[error("a vehicle has the plant `multi-body`, and the kernel covers only `point-mass`")]
    Plant,
    /// The kernel assumes that the leader stays the same vehicle.
    #[error("vehicles enter or leave the lane, which the kernel does not cover")]
    LaneChanges,
    /// Noise on the own acceleration may cancel the brake.
    #[error(
        "noise on its acceleration can be as large as its maximum braking, {brake_mps2} m/s² on this road"
    )]
    Noise {
        /// Maximum deceleration on this road, in m/s².
        brake_mps2: f64,
    },
    /// The error of the Kalman filter is unbounded if measurements may be lost.
    #[error(
        "its sensors lose measurements, so the error of its observations has no bound: give bounds, as in \
        `shield,gap-error=0.5,speed-error=0.5,ahead-speed-error=1:policy`"
    )]
    Dropout,
    /// Delayed, missing or false targets are no bounded errors.
    #[error("its sensors have faults, which the kernel does not cover: remove `sensors.faults`")]
    SensorFaults,
    /// Rounding may decrease the gap by more than the margin covers.
    #[error(
        "rounding may take up to {rounding_m} m of the gap in a run of this length at positions up to {} m, and twice \
         that exceeds the largest margin, {max_margin_m} m: begin nearer to the origin, or make fewer or longer steps",
        crumple_core::digits::format_rounded(*position_m, 3)
    )]
    Rounding {
        /// Maximum effect of rounding, in metres.
        rounding_m: f64,
        /// Maximum distance of the run from the origin, in metres.
        position_m: f64,
        /// Maximum margin, in metres.
        max_margin_m: f64,
    },
}

/// A controller behind a shield.
#[derive(Clone)]
pub struct ShieldedSource {
    /// Controller that drives as long as the shield admits its commands.
    pub controller: Arc<dyn ControllerSource>,
    /// Settings of the user.
    pub settings: ShieldSettings,
}

impl IntoSource for ShieldedSource {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::new(self)
    }
}

impl ControllerSource for ShieldedSource {
    fn identity(&self) -> Option<String> {
        let inner = self.controller.identity()?;
        Some(sha256(format!("shield {:?} {inner}", self.settings)))
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Err(ControllerFailure::Died {
            message: "a shield protects only vehicles of a run".to_owned(),
        })
    }

    fn interval_s(&self) -> Option<f64> {
        self.controller.interval_s()
    }

    fn required_neighbours(&self) -> RequiredNeighbours {
        self.controller.required_neighbours()
    }

    fn warnings(&self) -> Vec<String> {
        self.controller.warnings()
    }

    fn description(&self) -> String {
        format!("with a shield: {}", self.controller.description())
    }

    fn file(&self) -> Option<&SourceFile> {
        self.controller.file()
    }

    fn program_field(&self) -> Option<&'static str> {
        self.controller.program_field()
    }

    fn policy(&self) -> Option<Arc<Policy>> {
        self.controller.policy()
    }

    fn is_learned(&self) -> bool {
        self.controller.is_learned()
    }

    fn can_fail(&self) -> bool {
        self.controller.can_fail()
    }

    fn is_deterministic(&self) -> bool {
        self.controller.is_deterministic()
    }

    fn try_start(&self) -> Result<(), ControllerFailure> {
        self.controller.try_start()
    }

    fn refusal(&self) -> Option<ControllerFailure> {
        self.controller.refusal()
    }

    fn supports_lockstep(&self, ego: &Ego) -> bool {
        self.controller.supports_lockstep(ego)
    }

    fn as_shield(&self) -> Option<&Self> {
        Some(self)
    }

    fn check_vehicle(&self, vehicle: &VehicleInRun<'_>) -> Result<(), ShieldRefusal> {
        if self.controller.as_shield().is_some() {
            return Err(ShieldRefusal::Nested);
        }
        vehicle.shield_params(&self.settings).map(drop)
    }

    fn start_in_run(
        &self,
        vehicle: &VehicleInRun<'_>,
    ) -> Result<Box<dyn Controller>, ControllerFailure> {
        let params =
            vehicle
                .shield_params(&self.settings)
                .map_err(|refusal| ControllerFailure::Died {
                    message: refusal.to_string(),
                })?;
        let behind_shield = VehicleInRun {
            source: &self.controller,
            ..*vehicle
        };
        let controller = self.controller.start_in_run(&behind_shield)?;
        Ok(Box::new(ShieldedController::new(controller, params)))
    }
}
