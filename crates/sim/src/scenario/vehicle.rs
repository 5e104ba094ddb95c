//! Vehicles: class presets, overrides in files, and the resulting numbers.

use serde::{Deserialize, Serialize};

use super::driver::Driver;
use super::lane_change::LaneChange;
use super::plant::{BodyKind, PlantKind};
use super::recorded_motion::RecordedMotion;
use crumple_core::text_file::is_default;

struct ClassPreset {
    name: &'static str,
    length_m: f64,
    mass_kg: f64,
    max_brake_mps2: f64,
    max_accel_mps2: f64,
}

/// Declares the classes, a row each. Files, schema, spaces, logs, figures and fuzzing strategies use this list.
macro_rules! classes {
    ($(#[$about:meta])* $name:ident { $($(#[$doc:meta])* $class:ident: $preset:expr;)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(rename_all = "kebab-case")]
        pub enum $name {
            $($(#[$doc])* $class,)*
        }

        impl $name {
            /// All classes, in order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$class),*];

            const fn preset(self) -> ClassPreset {
                match self {
                    $(Self::$class => $preset,)*
                }
            }
        }
    };
}

classes! {
    /// The two vehicle classes of the paper (section "Design of scenarios").
    ///
    /// The paper states length and largest deceleration. Largest acceleration and mass are typical of a passenger car
    /// and of a loaded rigid truck.
    VehicleClass {
        /// Passenger car: 2 m, brakes at up to 7.5 m/s², accelerates at up to 3 m/s², 1500 kg.
        Light: ClassPreset { name: "light", length_m: 2.0, mass_kg: 1_500.0, max_brake_mps2: 7.5, max_accel_mps2: 3.0 };
        /// Truck: 15 m, brakes at up to 6 m/s², accelerates at up to 1.5 m/s², 15 000 kg.
        Heavy:
            ClassPreset { name: "heavy", length_m: 15.0, mass_kg: 15_000.0, max_brake_mps2: 6.0, max_accel_mps2: 1.5 };
    }
}

impl VehicleClass {
    /// Returns the class of a recorded vehicle: heavy from 7.5 m on, which exceeds any car.
    #[must_use]
    pub fn from_length(length_m: f64) -> Self {
        if length_m >= 7.5 {
            Self::Heavy
        } else {
            Self::Light
        }
    }

    /// Returns the number of the class in spaces and logs.
    #[must_use]
    pub fn number(self) -> u8 {
        self as u8
    }

    /// Returns the name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.preset().name
    }

    /// Returns the length from bumper to bumper, in metres.
    #[must_use]
    pub fn length_m(self) -> f64 {
        self.preset().length_m
    }

    /// Returns the mass in kilograms.
    #[must_use]
    pub fn mass_kg(self) -> f64 {
        self.preset().mass_kg
    }

    /// Returns the largest deceleration on a dry road, in m/s², positive.
    #[must_use]
    pub fn max_brake_mps2(self) -> f64 {
        self.preset().max_brake_mps2
    }

    /// Returns the largest acceleration in m/s².
    #[must_use]
    pub fn max_accel_mps2(self) -> f64 {
        self.preset().max_accel_mps2
    }
}

/// Vehicle of a scenario file: class, initial state, driver, and overrides of the class.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct VehicleSpec {
    /// Preset for every limit that is not overridden.
    pub class: VehicleClass,
    /// Initial position of the front bumper along the road, in metres. Vehicles are listed front to rear.
    #[cfg_attr(feature = "schema", schemars(range(min = -1e6, max = 1e6)))]
    pub position_m: f64,
    /// Initial speed, in m/s.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub speed_mps: f64,
    /// Driver: the profile of a leader, a controller, or the controller under test.
    pub driver: Driver,
    /// Length from bumper to bumper, in metres. Default: the class's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub length_m: Option<f64>,
    /// Mass in kilograms, load included. Default: the class's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1.0, max = 1e6)))]
    pub mass_kg: Option<f64>,
    /// Largest deceleration on a dry road, in m/s², positive. Default: the class's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 30.0)))]
    pub max_brake_mps2: Option<f64>,
    /// Largest acceleration, in m/s². Default: the class's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub max_accel_mps2: Option<f64>,
    /// Standard deviation of the normal noise added to the acceleration each step, in m/s². Default 0.
    #[serde(default, skip_serializing_if = "is_default")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub acceleration_noise_mps2: f64,
    /// Time from an observation to the driver's command, in seconds. Default 0.
    #[serde(default, skip_serializing_if = "is_default")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub reaction_delay_s: f64,
    /// Time constant of the first-order response of acceleration to the command, in seconds. Default 0: immediate.
    #[serde(default, skip_serializing_if = "is_default")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub actuator_lag_s: f64,
    /// Dead time between the command and the first response of the actuator, in seconds. Default 0.
    #[serde(default, skip_serializing_if = "is_default")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub actuator_delay_s: f64,
    /// Fastest change of acceleration, in m/s³. Default: unlimited.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 1e4)))]
    pub jerk_limit_mps3: Option<f64>,
    /// Model of the dynamics between demand and motion. Only for vehicles that a controller drives. Default:
    /// point-mass.
    #[serde(default, skip_serializing_if = "is_default")]
    pub plant: PlantKind,
    /// Parameters of the plant `multi-body`. Default: `bmw-320i` for `light`, `lorry-laden` for `heavy`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<BodyKind>,
    /// Trigger for entering the lane. Until then the vehicle is in the adjacent lane, where it neither influences other
    /// vehicles nor collides. It enters only if it then overlaps neither neighbour in the list. Only for scripted
    /// vehicles. Default: in the lane from the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub enters: Option<LaneChange>,
    /// Trigger for leaving the lane once it is in it. Only for scripted vehicles. Default: never.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leaves: Option<LaneChange>,
    /// Recorded motion in whose place the controller drives, for comparison. No simulation uses it. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Box<RecordedMotion>>,
}

impl VehicleSpec {
    /// Creates a vehicle without overrides.
    #[must_use]
    pub fn new(class: VehicleClass, position_m: f64, speed_mps: f64, driver: Driver) -> Self {
        Self {
            class,
            position_m,
            speed_mps,
            driver,
            length_m: None,
            mass_kg: None,
            max_brake_mps2: None,
            max_accel_mps2: None,
            acceleration_noise_mps2: 0.0,
            reaction_delay_s: 0.0,
            actuator_lag_s: 0.0,
            actuator_delay_s: 0.0,
            jerk_limit_mps3: None,
            plant: PlantKind::default(),
            body: None,
            enters: None,
            leaves: None,
            recorded: None,
        }
    }

    /// Returns true if the vehicle stays in the lane throughout.
    #[must_use]
    pub fn keeps_lane(&self) -> bool {
        self.enters.is_none() && self.leaves.is_none()
    }

    /// Returns the parameter set of a multi-body vehicle; `None` for a point mass.
    #[must_use]
    pub fn multi_body(&self) -> Option<BodyKind> {
        (self.plant == PlantKind::MultiBody)
            .then(|| self.body.unwrap_or(BodyKind::from_class(self.class)))
    }

    /// Returns the length from bumper to bumper, in metres: the override, or the class's.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.length_m.unwrap_or(self.class.length_m())
    }

    /// Returns the mass in kilograms: the override, or the class's.
    #[must_use]
    pub fn mass_kg(&self) -> f64 {
        self.mass_kg.unwrap_or(self.class.mass_kg())
    }

    /// Returns the largest deceleration on a dry road in m/s²: the override, or the class's.
    #[must_use]
    pub fn max_brake_mps2(&self) -> f64 {
        self.max_brake_mps2.unwrap_or(self.class.max_brake_mps2())
    }

    /// Returns the largest acceleration in m/s²: the override, or the class's.
    #[must_use]
    pub fn max_accel_mps2(&self) -> f64 {
        self.max_accel_mps2.unwrap_or(self.class.max_accel_mps2())
    }
}
