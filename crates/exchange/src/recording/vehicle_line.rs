//! The vehicles of an imported scenario, and the driver of the last one.

use std::path::Path;

use super::episode::{CAR_LENGTH_M, EpisodeVehicle};
use super::series::round_to_milli;
use super::vehicle_motion::VehicleMotion;
use crumple_core::digest::sha256;
use crumple_sim::control::{AebSettings, BuiltInController};
use crumple_sim::scenario::{
    Driver, FieldProblem, OpenDriver, ScenarioSpec, VehicleClass, VehicleSpec,
};
use serde_json::json;

/// Driver of the vehicle behind those under test: of the last of three or more vehicles.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum FollowerDriver {
    /// Repeats the recorded speeds. Such a vehicle cannot react, so a collision with it does not count against the
    /// controller.
    Recorded,
    /// The Intelligent Driver Model.
    Idm,
    /// A human driver with reaction time; drivers differ from scenario to scenario.
    #[default]
    Human,
    /// Holds its speed until the time to collision is below 1.4 s: an unaware driver with an emergency brake.
    Baseline,
    /// The scenario has no such vehicle, so that no collision from behind is possible.
    None,
    /// Another controller: a built-in one with its settings, or one that was read from a file.
    Controller(Box<Driver>),
}

impl FollowerDriver {
    /// Names of the drivers without a file.
    pub const NAMES: [&'static str; 5] = ["human", "idm", "baseline", "recorded", "none"];

    /// Returns the driver of a name; `None` for an unknown one.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "recorded" => Some(Self::Recorded),
            "idm" => Some(Self::Idm),
            "human" => Some(Self::Human),
            "baseline" => Some(Self::Baseline),
            "none" => Some(Self::None),
            _ => None,
        }
    }

    /// Reads the controller in a file: a controller file, a network or a policy.
    ///
    /// # Errors
    /// [`FieldProblem`] for a file without a usable controller.
    pub fn from_file(path: &Path, opener: &dyn OpenDriver) -> Result<Self, FieldProblem> {
        let unusable = |reason: String| FieldProblem::DriverFile { reason };
        let driver: Driver = serde_json::from_value(json!({ "file": { "path": path } }))
            .map_err(|error| unusable(error.to_string()))?;
        let vehicle = VehicleSpec::new(VehicleClass::Light, 0.0, 0.0, driver);
        let mut spec = ScenarioSpec::new("follower".to_owned(), 1.0, vec![vehicle]);
        spec.read_drivers(Path::new(""), opener)
            .map_err(|invalid| invalid.problem)?;
        match spec.vehicles.pop() {
            Some(read) => Ok(Self::Controller(Box::new(read.driver))),
            None => Err(unusable("was not read".to_owned())),
        }
    }

    /// Returns the seed of a scenario of this name. Human drivers differ between seeds.
    pub(super) fn seed(&self, name: &str) -> u64 {
        match self {
            Self::Human => sha256(name)
                .get(..8)
                .and_then(|digits| u64::from_str_radix(digits, 16).ok())
                .unwrap_or(0),
            _ => 0,
        }
    }

    /// Returns the controller as a driver; `None` for a script, and without a vehicle.
    fn driver(&self) -> Option<Driver> {
        let built_in = match self {
            Self::Idm => BuiltInController::from_name("idm"),
            Self::Human => BuiltInController::from_name("human"),
            Self::Baseline => Some(BuiltInController::Baseline(AebSettings::default())),
            Self::Controller(driver) => return Some((**driver).clone()),
            Self::Recorded | Self::None => None,
        };
        built_in.map(Driver::Controller)
    }

    /// Returns the name of the controller, or of its file; empty for a script, and without a vehicle.
    fn controller_name(&self) -> String {
        match self.driver() {
            Some(Driver::File(file)) => {
                let name = Path::new(file.path()).file_name().unwrap_or_default();
                name.to_string_lossy().into_owned()
            }
            Some(Driver::Controller(controller)) => controller.to_arg(),
            Some(driver) => driver.name().to_owned(),
            None => String::new(),
        }
    }
}

/// Recorded vehicles at the start of a scenario, front to rear.
pub(super) struct VehicleLine<'a> {
    pub(super) vehicles: &'a [EpisodeVehicle],
    /// Motion of the first vehicle.
    pub(super) leader_motion: &'a VehicleMotion,
    /// Motion of the last of three or more vehicles.
    pub(super) last_motion: Option<&'a VehicleMotion>,
}

impl<'a> VehicleLine<'a> {
    /// Returns the vehicles of the scenario: all, or those before the last of three or more.
    fn included(&self, follower: &FollowerDriver) -> &'a [EpisodeVehicle] {
        match self.vehicles {
            [before @ .., _] if *follower == FollowerDriver::None && before.len() > 1 => before,
            all => all,
        }
    }

    /// Returns the vehicles of the scenario, front to rear; the last one is at position 0. The first repeats its
    /// recorded speeds, `follower` drives the last of three or more, and controllers under test drive the others.
    ///
    /// Vehicles of unknown length are light with 4.5 m; vehicles from 7.5 m on are heavy.
    pub(super) fn specs(&self, follower: &FollowerDriver) -> Vec<VehicleSpec> {
        let mut specs = vehicles_under_test(self.included(follower));
        if let Some(leader) = specs.first_mut() {
            self.leader_motion.script(leader);
        }
        if self.vehicles.len() > 2
            && *follower != FollowerDriver::None
            && let Some(last) = specs.last_mut()
        {
            match (follower.driver(), self.last_motion) {
                (Some(driver), _) => last.driver = driver,
                (None, Some(motion)) => motion.script(last),
                (None, None) => {}
            }
        }
        specs
    }

    /// Describes the vehicle behind those under test.
    pub(super) fn describe_last(&self, follower: &FollowerDriver, duration_s: f64) -> String {
        const IMPOSSIBLE: &str = "collisions from behind cannot happen.";
        let last = match self.vehicles {
            [_, _, .., last] => last,
            _ => return format!("No vehicle is behind the one under test: {IMPOSSIBLE}"),
        };
        match follower {
            FollowerDriver::None => {
                format!("The last one recorded, {last}, is no part of the scenario: {IMPOSSIBLE}")
            }
            FollowerDriver::Recorded => {
                let end = self
                    .last_motion
                    .and_then(|motion| motion.describe_end("its", duration_s));
                let repeats = format!("The last one, {last}, repeats its recorded speeds.");
                [Some(repeats), end]
                    .into_iter()
                    .flatten()
                    .collect::<Vec<_>>()
                    .join(" ")
            }
            _ => format!(
                "`{}` drives the last one, {last}.",
                follower.controller_name()
            ),
        }
    }
}

/// Returns vehicles under test at their recorded gaps and speeds.
fn vehicles_under_test(vehicles: &[EpisodeVehicle]) -> Vec<VehicleSpec> {
    let mut position_m = 0.0;
    let mut specs = Vec::with_capacity(vehicles.len());
    for (index, vehicle) in vehicles.iter().enumerate().rev() {
        let length_m = vehicle.length_m.unwrap_or(CAR_LENGTH_M);
        let class = VehicleClass::from_length(length_m);
        let mut spec = VehicleSpec::new(class, position_m, vehicle.speed_mps, Driver::UnderTest);
        spec.length_m = Some(length_m);
        specs.push(spec);
        let ahead = index.checked_sub(1).and_then(|ahead| vehicles.get(ahead));
        let ahead_length_m = ahead
            .and_then(|ahead| ahead.length_m)
            .unwrap_or(CAR_LENGTH_M);
        position_m = round_to_milli(position_m + vehicle.gap_ahead_m + ahead_length_m);
    }
    specs.reverse();
    specs
}
