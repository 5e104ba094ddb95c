//! Fields that parameters set: paths are resolved once to typed access.

use super::derived::{
    CRUISE_SPEED_RANGE_MPS, STOP_AND_GO_SPEED_RANGE_MPS, apply_controller, apply_cruise,
    apply_follower, apply_load, closing_gap_m,
};
use super::numeric_fields::{
    DERIVED_FIELDS, DRIVER_FIELDS, FAULTS, LANE_CHANGES, LaneChangeAccessor, SCENARIO_FIELDS,
    VEHICLE_FIELDS, accelerations_mut, brake_rate_mut, final_speed_mut, known_fields_text,
    pieces_mut, setting_mut,
};
use super::spec::{DriverName, ValueKind};
use crumple_sim::scenario::{
    Driver, FAULT_FIELDS, LaneChange, ScenarioSpec, SensorFaults, VehicleClass, VehicleSpec,
};

#[derive(Debug, Clone, Copy)]
pub(super) enum FieldTarget {
    /// A number of the whole scenario.
    Scenario(fn(&mut ScenarioSpec) -> &mut f64),
    /// A number of the faults of sensors.
    Fault(fn(&mut SensorFaults) -> &mut f64),
    /// A number of all vehicles.
    AllVehicles(fn(&mut VehicleSpec) -> &mut f64),
    /// A field of one vehicle.
    Vehicle(usize, VehicleField),
}

#[derive(Debug, Clone, Copy)]
pub(super) enum VehicleField {
    Number(fn(&mut VehicleSpec) -> &mut f64),
    /// A number of a scripted driver.
    Driver(fn(&mut Driver) -> Option<&mut f64>),
    /// A setting of a controller, by index.
    Setting(usize),
    /// The trigger of entering or leaving the lane.
    LaneChange(LaneChangeAccessor),
    /// A list of a driver: a signal.
    Signal(fn(&mut Driver) -> Option<&mut [f64]>),
    /// The vehicle class.
    Class,
    /// The built-in controller that drives.
    ControllerChoice,
    /// The kind of follower: a built-in controller, a variant of `baseline`, or no vehicle. Applied last.
    Follower,
    /// The length, with the class of that length.
    Size,
    /// The bumper gap ahead.
    Gap,
    /// The gap ahead as a time at the vehicle's own speed.
    TimeGap,
    /// The gap ahead as a time at the closing speed.
    ClosingTime,
    /// A factor of the vehicle's speed.
    SpeedShare,
    /// The final speed of a braking script, relative to its initial speed.
    FinalSpeedShare,
    /// The mass relative to that of the class, with the resulting deceleration.
    Load,
    /// The difference to the class's largest deceleration.
    BrakeOffset,
    /// The deceleration of a braking script, relative to what the vehicle can do on this road.
    RateShare,
    /// The deceleration of every piece of a script, relative to what the vehicle can do on this road.
    PiecesShare,
    /// The start of the first piece; the intervals between pieces stay.
    PiecesOnset,
    /// The acceleration of every piece, reduced where the speed would leave 18 to 130 km/h.
    PiecesCruise,
    /// The acceleration of every piece, reduced where the speed would leave 0 to 130 km/h.
    PiecesStopAndGo,
    /// A factor of all pieces, applied last.
    PiecesScale,
}

#[derive(Debug, Clone)]
pub(super) struct ParameterField {
    pub(super) target: FieldTarget,
    pub(super) unit: &'static str,
    /// Number of coordinates: one, or one for each piece of a signal.
    pub(super) length: usize,
    /// Paths that it sets; two parameters may not set the same path.
    pub(super) written_paths: Vec<String>,
}

impl ParameterField {
    /// Resolves a path in a base scenario.
    ///
    /// # Errors
    /// The problem with the path, as text.
    pub(super) fn resolve(path: &str, base: &ScenarioSpec) -> Result<Self, String> {
        if let Some((_, unit, access)) = SCENARIO_FIELDS.iter().find(|(name, ..)| *name == path) {
            return Ok(Self::scalar(path, FieldTarget::Scenario(*access), unit));
        }
        if let Some(fault) = path.strip_prefix(FAULTS)
            && let Some(field) = FAULT_FIELDS.iter().find(|field| field.path == fault)
        {
            let target = FieldTarget::Fault(field.value_mut);
            return Ok(Self::scalar(path, target, field.unit));
        }
        let Some((index, name)) = path
            .strip_prefix("vehicles[")
            .and_then(|rest| rest.split_once("]."))
        else {
            return Err(format!("{}; {}", unknown_field(path), known_fields_text()));
        };
        if index == "*" {
            let mut fields = VEHICLE_FIELDS.iter();
            return match fields.find(|(field, ..)| *field == name && *field != "position_m") {
                Some((_, unit, access)) => {
                    Ok(Self::scalar(path, FieldTarget::AllVehicles(*access), unit))
                }
                None => Err(unknown_field(path)),
            };
        }
        let index: usize = index.parse().map_err(|_| unknown_field(path))?;
        let count = base.vehicles.len();
        let vehicle = base.vehicles.get(index).ok_or_else(|| {
            format!("there is no vehicles[{index}]: the base scenario has {count} vehicles, counted from 0")
        })?;
        let path = VehiclePath {
            path,
            index,
            name,
            vehicle,
            vehicles: count,
        };
        path.resolve()
    }

    /// Creates a field with one coordinate, which sets only its own path.
    fn scalar(path: &str, target: FieldTarget, unit: &'static str) -> Self {
        Self {
            target,
            unit,
            length: 1,
            written_paths: vec![path.to_owned()],
        }
    }
}

fn unknown_field(path: &str) -> String {
    format!("no field `{path}` may vary")
}

/// A path to a field of one vehicle of the base scenario.
#[derive(Clone, Copy)]
struct VehiclePath<'a> {
    path: &'a str,
    index: usize,
    /// Name of the field within the vehicle.
    name: &'a str,
    vehicle: &'a VehicleSpec,
    /// Number of vehicles of the scenario.
    vehicles: usize,
}

impl VehiclePath<'_> {
    fn resolve(self) -> Result<ParameterField, String> {
        let Self {
            path,
            index,
            name,
            vehicle,
            ..
        } = self;
        if let Some((_, unit, access)) = VEHICLE_FIELDS.iter().find(|(field, ..)| *field == name) {
            return Ok(self.scalar(VehicleField::Number(*access), unit));
        }
        match name {
            "driver" | "follower" if !matches!(vehicle.driver, Driver::Controller(_)) => {
                let driver = vehicle.driver.name();
                return Err(format!(
                    "vehicle {index} of the base scenario is driven by `{driver}`, which is not a built-in controller"
                ));
            }
            "follower" if index < 2 || index + 1 != self.vehicles => {
                return Err(
                    "only the last vehicle, behind two others, may be a `follower`".to_owned(),
                );
            }
            "gap_m" | "time_gap_s" | "closing_time_s" if index == 0 => {
                return Err("no vehicle is ahead of vehicle 0".to_owned());
            }
            _ => {}
        }
        if let Some(field) = self.resolve_lane_change()? {
            return Ok(field);
        }
        if let Some(setting) = name.strip_prefix("driver.")
            && let Some(field) = self.resolve_setting(setting)?
        {
            return Ok(field);
        }
        match DERIVED_FIELDS.iter().find(|(field, ..)| *field == name) {
            Some((_, unit, field, written)) => Ok(ParameterField {
                target: FieldTarget::Vehicle(index, *field),
                unit,
                length: field.numbers_mut(&mut vehicle.clone()).len().max(1),
                written_paths: written
                    .iter()
                    .map(|field| format!("vehicles[{index}].{field}"))
                    .collect(),
            }),
            None if name.starts_with("driver.") => Err(unknown_field(path)),
            None => Err(format!("{}; {}", unknown_field(path), known_fields_text())),
        }
    }

    fn scalar(self, field: VehicleField, unit: &'static str) -> ParameterField {
        ParameterField::scalar(self.path, FieldTarget::Vehicle(self.index, field), unit)
    }

    /// Resolves the trigger of a lane change; `None` for other fields.
    fn resolve_lane_change(self) -> Result<Option<ParameterField>, String> {
        let Some((trigger, (_, access))) = LANE_CHANGES
            .iter()
            .find_map(|change| Some((self.name.strip_prefix(change.0)?, change)))
        else {
            return Ok(None);
        };
        let stated = access(&mut self.vehicle.clone()).copied();
        let unit = match stated.filter(|change| change.field() == trigger) {
            Some(LaneChange::Gap(_)) => "m",
            Some(_) => "s",
            None => {
                return Err(format!(
                    "vehicle {} of the base scenario does not state `{}`",
                    self.index, self.name
                ));
            }
        };
        Ok(Some(self.scalar(VehicleField::LaneChange(*access), unit)))
    }

    /// Resolves a number of the driver; `None` if it has no such number of its own.
    fn resolve_setting(self, setting: &str) -> Result<Option<ParameterField>, String> {
        let Some((kind, setting)) = setting.split_once('.') else {
            return Err(unknown_field(self.path));
        };
        let driver = self.vehicle.driver.name();
        if kind != driver {
            return Err(format!(
                "vehicle {} of the base scenario is driven by `{driver}`, not by `{kind}`",
                self.index
            ));
        }
        let mut fields = DRIVER_FIELDS.iter();
        if let Some((_, unit, access)) = fields.find(|(field, ..)| *field == self.name) {
            return Ok(Some(self.scalar(VehicleField::Driver(*access), unit)));
        }
        if let Driver::Controller(spec) = &self.vehicle.driver
            && let Some(index) = spec.fields().iter().position(|field| field.name == setting)
        {
            let unit = spec.fields()[index].unit();
            return Ok(Some(self.scalar(VehicleField::Setting(index), unit)));
        }
        Ok(None)
    }
}

impl FieldTarget {
    /// Returns the stage in which the field is set; dependent fields follow.
    pub(super) fn stage(self) -> u8 {
        use VehicleField as F;
        match self {
            Self::AllVehicles(_) => 1,
            Self::Vehicle(_, F::Class | F::ControllerChoice | F::Size) => 0,
            Self::Vehicle(_, F::RateShare | F::PiecesShare) => 3,
            Self::Vehicle(_, F::PiecesCruise | F::PiecesStopAndGo) => 3,
            Self::Vehicle(_, F::TimeGap | F::ClosingTime | F::FinalSpeedShare) => 3,
            Self::Vehicle(_, F::PiecesScale) => 4,
            Self::Vehicle(_, F::Follower) => 5,
            Self::Scenario(_) | Self::Fault(_) | Self::Vehicle(..) => 2,
        }
    }

    /// Sets the field. In a scenario with gaps, `position_m` holds the gap ahead until positions are computed.
    #[inline]
    pub(super) fn set(self, spec: &mut ScenarioSpec, values: &[f64]) {
        let Some(&value) = values.first() else { return };
        match self {
            Self::Scenario(access) => *access(spec) = value,
            Self::Fault(access) => *access(&mut spec.sensors.faults) = value,
            Self::AllVehicles(access) => {
                for vehicle in &mut spec.vehicles {
                    *access(vehicle) = value;
                }
            }
            Self::Vehicle(index, VehicleField::ClosingTime) => {
                let gap_m = closing_gap_m(spec, index, value);
                if let Some(vehicle) = spec.vehicles.get_mut(index) {
                    vehicle.position_m = gap_m;
                }
            }
            Self::Vehicle(index, VehicleField::Follower) => apply_follower(spec, index, value),
            Self::Vehicle(index, field) => {
                let friction = spec.environment.friction;
                let until_s = spec.duration_s;
                if let Some(vehicle) = spec.vehicles.get_mut(index) {
                    field.set(vehicle, values, friction, until_s);
                }
            }
        }
    }

    /// Returns the value of the field in a scenario with gaps in place of positions.
    pub(super) fn get(self, spec: &ScenarioSpec) -> Vec<f64> {
        match self {
            Self::Scenario(access) => vec![*access(&mut spec.clone())],
            Self::Fault(access) => vec![*access(&mut spec.sensors.faults.clone())],
            Self::AllVehicles(access) => {
                let first = spec.vehicles.first().cloned();
                first
                    .map(|mut vehicle| *access(&mut vehicle))
                    .into_iter()
                    .collect()
            }
            Self::Vehicle(index, VehicleField::ClosingTime) => {
                let Some(vehicle) = spec.vehicles.get(index) else {
                    return Vec::new();
                };
                let ahead = index
                    .checked_sub(1)
                    .and_then(|front| spec.vehicles.get(front));
                ahead
                    .map(|ahead| vehicle.position_m / (vehicle.speed_mps - ahead.speed_mps))
                    .into_iter()
                    .collect()
            }
            Self::Vehicle(index, field) => match spec.vehicles.get(index).cloned() {
                Some(vehicle) => field.get(vehicle, spec.environment.friction),
                None => Vec::new(),
            },
        }
    }

    pub(super) fn kind(self) -> ValueKind {
        match self {
            Self::Vehicle(_, VehicleField::Class) => ValueKind::Class,
            Self::Vehicle(_, VehicleField::ControllerChoice) => ValueKind::Driver,
            Self::Vehicle(_, VehicleField::Follower) => ValueKind::Follower,
            _ => ValueKind::Number,
        }
    }

    /// Returns the vehicle whose driver the field changes.
    pub(super) fn driver_vehicle(self) -> Option<usize> {
        use VehicleField as F;
        match self {
            Self::Scenario(_) | Self::Fault(_) | Self::AllVehicles(_) => None,
            Self::Vehicle(
                _,
                F::Number(_) | F::LaneChange(_) | F::Class | F::Size | F::Gap | F::TimeGap,
            ) => None,
            Self::Vehicle(_, F::ClosingTime | F::SpeedShare | F::Load | F::BrakeOffset) => None,
            Self::Vehicle(index, _) => Some(index),
        }
    }

    /// True if the field may change the position or limits of a vehicle, or of the one ahead of it.
    pub(super) fn affects_gap_ahead(self, vehicle: usize) -> bool {
        matches!(self, Self::AllVehicles(_))
            || self
                .affected_vehicle()
                .is_some_and(|affected| affected == vehicle || affected + 1 == vehicle)
    }

    /// Returns the vehicle whose limits or position the field changes, if that can make a scenario invalid.
    fn affected_vehicle(self) -> Option<usize> {
        match self {
            Self::Scenario(_) | Self::Fault(_) | Self::AllVehicles(_) => None,
            Self::Vehicle(_, VehicleField::Gap | VehicleField::PiecesOnset) => None,
            Self::Vehicle(index, _) => Some(index),
        }
    }
}

impl VehicleField {
    /// Sets a field of a vehicle. The closing time depends on the vehicle ahead, and is set by [`FieldTarget::set`].
    #[inline]
    fn set(self, vehicle: &mut VehicleSpec, values: &[f64], friction: f64, until_s: f64) {
        let Some(&value) = values.first() else { return };
        match self {
            Self::Class => {
                let class = VehicleClass::ALL.get(value as usize).copied();
                vehicle.class = class.unwrap_or(vehicle.class);
            }
            Self::ControllerChoice => apply_controller(vehicle, DriverName::from_number(value)),
            Self::Size => {
                vehicle.length_m = Some(value);
                vehicle.class = VehicleClass::from_length(value);
            }
            Self::SpeedShare => vehicle.speed_mps *= value,
            Self::Load => apply_load(vehicle, value),
            Self::BrakeOffset => {
                vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() + value)
            }
            Self::PiecesOnset => {
                if let Some(pieces) = pieces_mut(&mut vehicle.driver) {
                    let later_s = value - pieces.from_s.first().copied().unwrap_or(0.0);
                    pieces
                        .from_s
                        .iter_mut()
                        .for_each(|from_s| *from_s += later_s);
                }
            }
            Self::PiecesCruise => apply_cruise(vehicle, values, until_s, CRUISE_SPEED_RANGE_MPS),
            Self::PiecesStopAndGo => {
                apply_cruise(vehicle, values, until_s, STOP_AND_GO_SPEED_RANGE_MPS);
            }
            Self::PiecesScale => {
                accelerations_mut(&mut vehicle.driver)
                    .unwrap_or_default()
                    .iter_mut()
                    .for_each(|piece| *piece *= value);
            }
            _ => {
                let unit = self.size_of_one(vehicle, friction);
                for (number, value) in self.numbers_mut(vehicle).iter_mut().zip(values) {
                    *number = value * unit;
                }
            }
        }
    }

    /// Returns the values of a field of a vehicle, except the closing time.
    fn get(self, mut vehicle: VehicleSpec, friction: f64) -> Vec<f64> {
        match self {
            Self::Class => vec![f64::from(vehicle.class.number())],
            Self::ControllerChoice | Self::Follower => DriverName::of_driver(&vehicle.driver)
                .map(DriverName::number)
                .into_iter()
                .collect(),
            Self::Size => vec![vehicle.length_m()],
            Self::SpeedShare | Self::PiecesScale => vec![1.0],
            Self::Load => vec![vehicle.mass_kg() / vehicle.class.mass_kg()],
            Self::BrakeOffset => {
                vec![vehicle.max_brake_mps2() - vehicle.class.max_brake_mps2()]
            }
            Self::PiecesOnset => pieces_mut(&mut vehicle.driver)
                .and_then(|pieces| pieces.from_s.first().copied())
                .into_iter()
                .collect(),
            _ => {
                let unit = self.size_of_one(&vehicle, friction);
                self.numbers_mut(&mut vehicle)
                    .iter()
                    .map(|number| *number / unit)
                    .collect()
            }
        }
    }

    /// Returns the numbers of the scenario that the field sets to its values times [`Self::size_of_one`]; none for a
    /// field that is set in another way.
    fn numbers_mut(self, vehicle: &mut VehicleSpec) -> &mut [f64] {
        let number = match self {
            Self::Number(access) => Some(access(vehicle)),
            Self::Driver(access) => access(&mut vehicle.driver),
            Self::Setting(index) => setting_mut(&mut vehicle.driver, index),
            Self::LaneChange(access) => access(vehicle).map(LaneChange::value_mut),
            Self::Gap | Self::TimeGap => Some(&mut vehicle.position_m),
            Self::FinalSpeedShare => final_speed_mut(&mut vehicle.driver),
            Self::RateShare => brake_rate_mut(&mut vehicle.driver),
            Self::Signal(access) => return access(&mut vehicle.driver).unwrap_or_default(),
            Self::PiecesShare | Self::PiecesCruise | Self::PiecesStopAndGo => {
                return accelerations_mut(&mut vehicle.driver).unwrap_or_default();
            }
            _ => None,
        };
        number.map_or(&mut [], std::slice::from_mut)
    }

    /// Returns the number that a value of 1 stands for.
    fn size_of_one(self, vehicle: &VehicleSpec, friction: f64) -> f64 {
        match self {
            Self::TimeGap | Self::FinalSpeedShare => vehicle.speed_mps,
            Self::RateShare => vehicle.max_brake_mps2() * friction,
            Self::PiecesShare => -(vehicle.max_brake_mps2() * friction),
            _ => 1.0,
        }
    }
}
