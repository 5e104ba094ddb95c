//! Scenarios: vehicles, their drivers, sensors and the road.
//!
//! [`ScenarioSpec`] is the unchecked content of a file. [`Scenario`] is a valid spec; only a successful check creates
//! one.

mod driver;
pub mod file;
mod following_line;
mod invalid;
mod lane_change;
mod paper;
mod plant;
mod profile;
mod recorded_motion;
mod response;
mod sensor_faults;
mod speed_dip;
mod validate;
mod vehicle;

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::random::NoiseShare;
use crumple_core::text_file::is_default;

pub use driver::{Driver, DriverProblem, FileDriver, NoDriverFiles, OpenDriver};
pub use following_line::{FollowingLine, SpeedOscillation};
pub use invalid::{AllowedRange, FieldProblem, InvalidField};
pub use lane_change::LaneChange;
pub use paper::{PAPER_STEP_S, PaperDistribution, built_in_scenario, built_in_scenario_names};
pub use plant::{BodyKind, PlantKind};
pub use profile::{
    Brake, BrakeToSpeed, LeadProfile, PiecewiseAcceleration, RampBrake, RecordedSpeeds,
};
pub use recorded_motion::RecordedMotion;
pub use response::VehicleResponse;
pub use sensor_faults::{FAULT_FIELDS, FaultField, GhostObject, SensorFaults};
pub use speed_dip::{SPEED_DIP_ONSET_S, speed_dip};
pub(crate) use validate::MAX_VEHICLE_STEPS;
pub use validate::{MAX_MULTIPLE, whole_multiple};
pub use vehicle::{VehicleClass, VehicleSpec};

/// Scenario file version that this release reads and writes.
pub const SCENARIO_VERSION: u32 = 1;

/// Content of a scenario file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a scenario: a table of fields")]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "Scenario", title = "crumple scenario, version 1")
)]
pub struct ScenarioSpec {
    /// Version of the file format: 1.
    pub version: u32,
    /// Short name, unique among the scenarios of a report.
    pub name: String,
    /// Purpose of this scenario, in a few sentences.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Duration, in seconds; a whole number of steps.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub duration_s: f64,
    /// Period of controllers, sensors and noise, in seconds. Default 0.01.
    #[serde(default = "paper_step_s")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1e-4, max = 1.0)))]
    pub step_s: f64,
    /// Seed of all noise, up to 2⁶³ - 1. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// Road.
    #[serde(default, skip_serializing_if = "is_default")]
    pub environment: Environment,
    /// Sensors of the vehicles under test.
    #[serde(default, skip_serializing_if = "is_default")]
    pub sensors: Sensors,
    /// Vehicles, front to rear; 2 to 1000.
    #[cfg_attr(feature = "schema", schemars(length(min = 2, max = 1000)))]
    pub vehicles: Vec<VehicleSpec>,
}

fn paper_step_s() -> f64 {
    PAPER_STEP_S
}

/// The road.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Environment {
    /// Share of dry-road braking that every vehicle, scripted ones included, can use: 1 dry, about 0.3 snow, 0.1 to 0.2
    /// ice.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 1.0)))]
    pub friction: f64,
}

impl Default for Environment {
    fn default() -> Self {
        Self { friction: 1.0 }
    }
}

/// Sensors of the vehicles under test: own position and two bumper gaps, once a step, with independent normal noise.
///
/// The defaults correspond to a series-production sensor set at highway gaps. Range noise of 0.03 m is the precision of
/// automotive lidar (0.02 to 0.03 m, one sigma); radar alone has 0.1 m or more. Position noise of 0.02 m is real-time
/// kinematic satellite positioning with inertial aiding. No measurement is lost by default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Sensors {
    /// Standard deviation of the measured own position, in metres.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub position_noise_m: f64,
    /// Standard deviation of each measured gap, in metres.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub gap_noise_m: f64,
    /// Probability that a measurement is lost, independent for each sensor and step.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1.0)))]
    pub dropout: f64,
    /// Faults of the gap sensors. Default: none.
    #[serde(skip_serializing_if = "is_default")]
    pub faults: SensorFaults,
}

impl Default for Sensors {
    fn default() -> Self {
        Self {
            position_noise_m: 0.02,
            gap_noise_m: 0.03,
            dropout: 0.0,
            faults: SensorFaults::default(),
        }
    }
}

/// A valid scenario.
///
/// [`Scenario::edited`] returns a changed, valid copy. Clones share the data.
///
/// ```
/// use crumple_sim::scenario::built_in_scenario;
///
/// let paper = built_in_scenario("paper-1").unwrap();
/// let wet = paper.edited(|spec| spec.environment.friction = 0.6).unwrap();
/// assert_eq!(wet.usable_brake_mps2(1), 4.5);
/// assert!(paper.edited(|spec| spec.environment.friction = -1.0).is_err());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    spec: Arc<ScenarioSpec>,
    steps: usize,
    noise_shares: Option<Arc<[NoiseShare]>>,
}

impl ScenarioSpec {
    /// Creates a spec of this version without a description, with all other fields at their defaults.
    #[must_use]
    pub fn new(name: String, duration_s: f64, vehicles: Vec<VehicleSpec>) -> Self {
        Self {
            version: SCENARIO_VERSION,
            name,
            about: String::new(),
            duration_s,
            step_s: PAPER_STEP_S,
            seed: 0,
            environment: Environment::default(),
            sensors: Sensors::default(),
            vehicles,
        }
    }

    /// Reads the controllers of drivers from files; paths are relative to `folder`. A scenario with unread drivers is
    /// invalid.
    ///
    /// # Errors
    /// [`InvalidField`] names the first driver that cannot be read, or that is a program that the opener refuses.
    pub fn read_drivers(
        &mut self,
        folder: &Path,
        opener: &dyn OpenDriver,
    ) -> Result<(), InvalidField> {
        for (index, vehicle) in self.vehicles.iter_mut().enumerate() {
            if let Driver::File(file) = &mut vehicle.driver {
                file.read(folder, opener).map_err(|problem| InvalidField {
                    field: format!("vehicles[{index}].driver.file.path"),
                    problem,
                })?;
            }
        }
        Ok(())
    }
}

impl Scenario {
    /// Accepts a spec if it is valid.
    ///
    /// # Errors
    /// [`InvalidField`] names the first field that is out of range or contradicts another.
    pub fn new(spec: ScenarioSpec) -> Result<Self, InvalidField> {
        let steps = validate::check(&spec)?;
        Ok(Self {
            spec: Arc::new(spec),
            steps,
            noise_shares: None,
        })
    }

    /// Returns the data of the scenario.
    #[must_use]
    pub fn spec(&self) -> &ScenarioSpec {
        &self.spec
    }

    /// Returns a changed copy if it is valid.
    ///
    /// # Errors
    /// [`InvalidField`] if the change makes the scenario invalid.
    pub fn edited(&self, change: impl FnOnce(&mut ScenarioSpec)) -> Result<Self, InvalidField> {
        let mut spec = self.spec().clone();
        change(&mut spec);
        Self::new(spec)
    }

    /// Replaces the normal noise of accelerations, measurements and initial estimates by the sum of `shares`. The first
    /// seed must be that of the spec, which determines all other random numbers. A file cannot state shares.
    #[must_use]
    pub fn with_noise_shares(self, shares: &[NoiseShare]) -> Self {
        Self {
            noise_shares: Some(shares.into()),
            ..self
        }
    }

    pub(crate) fn noise_shares(&self) -> &[NoiseShare] {
        self.noise_shares.as_deref().unwrap_or_default()
    }

    /// Returns the vehicles, front to rear.
    #[must_use]
    pub fn vehicles(&self) -> &[VehicleSpec] {
        &self.spec.vehicles
    }

    /// Returns true if every vehicle is a point mass: proofs and convex programs model no other plant.
    #[must_use]
    pub fn has_only_point_masses(&self) -> bool {
        self.spec
            .vehicles
            .iter()
            .all(|vehicle| vehicle.multi_body().is_none())
    }

    /// Returns true if no vehicle changes lanes, so that all neighbours stay the same.
    #[must_use]
    pub fn keeps_lanes(&self) -> bool {
        self.spec.vehicles.iter().all(VehicleSpec::keeps_lane)
    }

    /// Returns true if a vehicle is driven by the controller under test.
    #[must_use]
    pub fn has_vehicle_under_test(&self) -> bool {
        (0..self.spec.vehicles.len()).any(|index| self.is_under_test(index))
    }

    /// Returns true if the controller under test drives vehicle `index`; false for a vehicle that does not exist.
    #[must_use]
    pub fn is_under_test(&self, index: usize) -> bool {
        self.spec
            .vehicles
            .get(index)
            .is_some_and(|vehicle| vehicle.driver == Driver::UnderTest)
    }

    /// Returns true if the last vehicle is under test: no collision from behind can happen to it.
    #[must_use]
    pub fn ends_under_test(&self) -> bool {
        let last = self.spec.vehicles.len().saturating_sub(1);
        self.is_under_test(last)
    }

    /// Returns the number of steps of `step_s` in `duration_s`.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Returns the hardest braking of vehicle `index` on this road, in m/s², positive; 0 for a vehicle that does not
    /// exist.
    #[must_use]
    pub fn usable_brake_mps2(&self, index: usize) -> f64 {
        self.spec
            .vehicles
            .get(index)
            .map_or(0.0, |v| v.max_brake_mps2() * self.spec.environment.friction)
    }

    /// Returns the initial bumper gap of vehicle `index` to the vehicle listed before it, in metres; `None` for the
    /// first. The gap may be negative if one of them is in the adjacent lane.
    #[must_use]
    pub fn initial_gap_m(&self, index: usize) -> Option<f64> {
        let ahead = self.spec.vehicles.get(index.checked_sub(1)?)?;
        let behind = self.spec.vehicles.get(index)?;
        Some(ahead.position_m - ahead.length_m() - behind.position_m)
    }
}

/// Returns the JSON Schema of scenario files.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(ScenarioSpec).to_value()
}
