//! Presets: settings of built-in controllers under a name.
//!
//! `idm-damped` is the Intelligent Driver Model with twice the acceleration, so that no oscillation of 0.3 m/s grows in
//! a line of such vehicles.
//!
//! The others are emergency brakes of production cars. Source: trials behind a stopped leader without braking by
//! a driver (NHTSA, final rule of FMVSS 127, 89 FR 39686, table 16). The experiment `car_brakes` fits one number to
//! each car, its time to collision, and the share of standing vehicles that it misses. The other settings are
//! assumptions, the same for all cars. `reports/credibility.md` compares the models with the tests that were not used.
//! A model says nothing about other years, software or conditions.

use super::{BuiltInController, EmergencyBrakeSettings, STANDARD_GRAVITY_MPS2};
use crate::idm::IdmSettings;

/// Settings of a built-in controller under a name.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerPreset {
    /// Name in files and on the command line.
    pub name: &'static str,
    /// One line; for a car its model year and source.
    pub summary: &'static str,
    /// The controller with its settings.
    pub controller: BuiltInController,
    /// Conditions under which it was compared with reality, if they are narrower than those of the controller.
    pub domain: Option<&'static str>,
}

/// Conditions of the tests with which the models of cars were compared.
const CAR_DOMAIN: Option<&str> = Some(
    "the model was compared with track tests of the car at 50 to 80 km/h, closing in by at most 60 km/h, on a dry \
     road, without braking by the driver and without a vehicle behind; other results are extrapolations",
);

const fn emergency_brake(ttc_s: f64, standing_miss_share: f64) -> BuiltInController {
    BuiltInController::EmergencyBrake(EmergencyBrakeSettings {
        ttc_s,
        brake_mps2: 0.774 * STANDARD_GRAVITY_MPS2,
        closing_slope_s2_per_m: 0.0,
        delay_s: 0.0,
        jerk_mps3: 12.65,
        partial_ttc_s: 1.6,
        partial_brake_mps2: 0.4 * STANDARD_GRAVITY_MPS2,
        standing_miss_share,
    })
}

/// The defaults of `idm`, except the acceleration.
const IDM_DAMPED: IdmSettings = IdmSettings {
    desired_speed_mps: 120.0 / 3.6,
    time_headway_s: 1.6,
    standstill_gap_m: 2.0,
    accel_mps2: 1.5,
    comfortable_brake_mps2: 1.67,
};

/// Presets, except those of cruise controls ([`CRUISE_PRESETS`](super::CRUISE_PRESETS)); those of cars are as in
/// `corpora/vehicle-tests/attempt-2/settings.csv`.
pub static CONTROLLER_PRESETS: [ControllerPreset; 7] = [
    ControllerPreset {
        name: "idm-damped",
        summary: "idm with accel_mps2=1.5: no oscillation of 0.3 m/s grows in a line of such vehicles (largest gain \
                  0.999, with the true state, at 4 to 30 m/s)",
        controller: BuiltInController::Idm(IDM_DAMPED),
        domain: None,
    },
    ControllerPreset {
        name: "car:ix-2023",
        summary: "BMW iX xDrive50 2023: emergency brake fitted to NHTSA's tests (89 FR 39686), misses 27 % of \
                  standing vehicles; valid at 50 to 80 km/h on dry roads",
        controller: emergency_brake(1.31, 0.2667),
        domain: CAR_DOMAIN,
    },
    ControllerPreset {
        name: "car:f-150-2023",
        summary: "Ford F-150 Lightning 2023: emergency brake fitted to NHTSA's tests (89 FR 39686); valid at 50 \
                  to 80 km/h on dry roads",
        controller: emergency_brake(0.96, 0.0),
        domain: CAR_DOMAIN,
    },
    ControllerPreset {
        name: "car:ioniq-5-2023",
        summary: "Hyundai Ioniq 5 2023: emergency brake fitted to NHTSA's tests (89 FR 39686); valid at 50 \
                  to 80 km/h on dry roads",
        controller: emergency_brake(1.02, 0.0),
        domain: CAR_DOMAIN,
    },
    ControllerPreset {
        name: "car:cx-90-2024",
        summary: "Mazda CX-90 2024: emergency brake fitted to NHTSA's tests (89 FR 39686); valid at 50 \
                  to 80 km/h on dry roads",
        controller: emergency_brake(1.09, 0.0),
        domain: CAR_DOMAIN,
    },
    ControllerPreset {
        name: "car:pathfinder-2023",
        summary: "Nissan Pathfinder 2023: emergency brake fitted to NHTSA's tests (89 FR 39686); valid at 50 \
                  to 80 km/h on dry roads",
        controller: emergency_brake(0.7, 0.0),
        domain: CAR_DOMAIN,
    },
    ControllerPreset {
        name: "car:corolla-2023",
        summary: "Toyota Corolla Hybrid 2023: emergency brake fitted to NHTSA's tests (89 FR 39686); valid at 50 \
                  to 80 km/h on dry roads",
        controller: emergency_brake(2.0, 0.0),
        domain: CAR_DOMAIN,
    },
];

#[cfg(test)]
mod tests {
    use super::super::{BuiltInController, ControllerSource};
    use super::*;
    use crate::scenario::Driver;

    #[test]
    fn a_preset_has_one_name_in_arguments() {
        for preset in BuiltInController::presets() {
            let spec = BuiltInController::parse(preset.name).unwrap().unwrap();
            assert_eq!(spec.to_arg(), preset.name);
            assert_eq!(spec, preset.controller);
        }
        let damped = IdmSettings {
            accel_mps2: 1.5,
            ..IdmSettings::default()
        };
        assert_eq!(IDM_DAMPED, damped);
        let changed = BuiltInController::parse("car:cx-90-2024,ttc_s=1.7")
            .unwrap()
            .unwrap();
        assert_eq!(
            changed.to_arg(),
            "emergency-brake,ttc_s=1.7,brake_mps2=7.5903471,jerk_mps3=12.65,partial_ttc_s=1.6,\
             partial_brake_mps2=3.92266"
        );
        assert_eq!(
            BuiltInController::parse(&changed.to_arg()),
            Some(Ok(changed))
        );
    }

    #[test]
    fn a_description_states_changed_settings() {
        let describe = |arg| {
            BuiltInController::parse(arg)
                .unwrap()
                .unwrap()
                .description()
        };
        let default = BuiltInController::from_name("acc-aeb").unwrap();
        assert_eq!(describe("acc-aeb,ttc_s=1.4"), default.summary());
        let changed = format!("{}, but with ttc_s = 2 instead of 1.4", default.summary());
        assert_eq!(describe("acc-aeb,ttc_s=2.0"), changed);
        assert_eq!(describe("idm,accel_mps2=1.5"), describe("idm-damped"));
    }

    /// A scenario file may have the name; files that crumple writes state the settings.
    #[test]
    fn a_car_is_a_driver_in_scenario_files() {
        let driver: Driver = serde_json::from_str("\"car:cx-90-2024\"").unwrap();
        let spec = BuiltInController::from_preset("car:cx-90-2024").unwrap();
        assert_eq!(driver, Driver::Controller(spec));
        let written = serde_json::to_string(&driver).unwrap();
        assert!(written.contains("\"ttc_s\":1.09"), "{written}");
        assert_eq!(serde_json::from_str::<Driver>(&written).unwrap(), driver);
    }
}
