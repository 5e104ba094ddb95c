//! A shield as a source of controllers.

use std::sync::Arc;

use super::{ShieldKind, ShieldedController};
use crate::control::two_sided::TwoSidedController;
use crate::control::{
    Controller, ControllerFailure, ControllerSource, Ego, IntoSource, VehicleInRun,
};
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
    /// Between two steps, a follower whose brake fires so late could come too near.
    #[error(
        "the follower's brake fires at a time to collision of {ttc_s} s, and a two-sided shield needs at least two \
         steps of {step_s} s"
    )]
    ShortTtc {
        /// Time to collision at which the brake fires, in seconds.
        ttc_s: f64,
        /// Time between decisions, in seconds.
        step_s: f64,
    },
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
    /// Kind of the shield, with the settings of the user.
    pub settings: ShieldKind,
}

impl IntoSource for ShieldedSource {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::new(self)
    }
}

impl ControllerSource for ShieldedSource {
    fn identity(&self) -> Option<String> {
        let inner = self.controller.identity()?;
        Some(match &self.settings {
            ShieldKind::Ahead(settings) => sha256(format!("shield {settings:?} {inner}")),
            ShieldKind::BothSides(settings) => sha256(format!("shield2 {settings:?} {inner}")),
        })
    }

    fn inner(&self) -> Option<&dyn ControllerSource> {
        Some(&*self.controller)
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Err(ControllerFailure::Died {
            message: "a shield protects only vehicles of a run".to_owned(),
        })
    }

    fn description(&self) -> String {
        let kind = match self.settings {
            ShieldKind::Ahead(_) => "a shield",
            ShieldKind::BothSides(_) => "a two-sided shield",
        };
        format!("with {kind}: {}", self.controller.description())
    }

    fn as_shield(&self) -> Option<&Self> {
        Some(self)
    }

    fn check_vehicle(&self, vehicle: &VehicleInRun<'_>) -> Result<(), ShieldRefusal> {
        if self.controller.as_shield().is_some() {
            return Err(ShieldRefusal::Nested);
        }
        match &self.settings {
            ShieldKind::Ahead(settings) => vehicle.shield_params(settings).map(drop),
            ShieldKind::BothSides(settings) => vehicle.two_sided_params(settings).map(drop),
        }
    }

    fn start_in_run(
        &self,
        vehicle: &VehicleInRun<'_>,
    ) -> Result<Box<dyn Controller>, ControllerFailure> {
        let behind_shield = VehicleInRun {
            source: &self.controller,
            ..*vehicle
        };
        let failed = |refusal: ShieldRefusal| ControllerFailure::Died {
            message: refusal.to_string(),
        };
        Ok(match &self.settings {
            ShieldKind::Ahead(settings) => {
                let params = vehicle.shield_params(settings).map_err(failed)?;
                let controller = self.controller.start_in_run(&behind_shield)?;
                Box::new(ShieldedController::new(controller, params))
            }
            ShieldKind::BothSides(settings) => {
                let params = vehicle.two_sided_params(settings).map_err(failed)?;
                let controller = self.controller.start_in_run(&behind_shield)?;
                Box::new(TwoSidedController::new(controller, params))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::control::BuiltInController;

    /// A shield is named as it is written, describes itself and its controller, and has an identity of its own.
    #[test]
    fn a_shield_states_its_settings_and_its_controller() {
        let controller = BuiltInController::from_name("idm")
            .expect("built in")
            .into_source();
        let mut identities = BTreeSet::from([controller.identity()]);
        for (text, kind) in [
            ("", "a shield"),
            (",ahead=7", "a shield"),
            ("2", "a two-sided shield"),
            ("2,level=3", "a two-sided shield"),
        ] {
            let settings = ShieldKind::parse(text).expect("settings");
            assert_eq!(settings.name_prefix(), format!("shield{text}:"));
            let shielded = ShieldedSource {
                controller: Arc::clone(&controller),
                settings,
            };
            let description = format!("with {kind}: {}", controller.description());
            assert_eq!(shielded.description(), description);
            assert!(identities.insert(shielded.identity()), "{text}");
        }
        assert!(!identities.contains(&None));
        assert!(ShieldKind::parse("2level=3").is_err());
    }
}
