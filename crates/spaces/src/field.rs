//! Fields that parameters set: paths are resolved once to typed access.

use super::derived::{apply_cruise, apply_load, closing_gap_m};
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
    pub(super) fn resolve(path: &str, base: &ScenarioSpec) -> Result<Self, String> {
        let scalar = |target: FieldTarget, unit: &'static str| Self {
            target,
            unit,
            length: 1,
            written_paths: vec![path.to_owned()],
        };
        if let Some((_, unit, access)) = SCENARIO_FIELDS.iter().find(|(known, ..)| *known == path) {
            return Ok(scalar(FieldTarget::Scenario(*access), unit));
        }
        if let Some(fault) = path.strip_prefix(FAULTS)
            && let Some(field) = FAULT_FIELDS.iter().find(|field| field.path == fault)
        {
            return Ok(scalar(FieldTarget::Fault(field.value_mut), field.unit));
        }
        let unknown = || format!("no field `{path}` may vary");
        let (index, rest) = path
            .strip_prefix("vehicles[")
            .and_then(|rest| rest.split_once("]."))
            .ok_or_else(|| format!("{}; {}", unknown(), known_fields_text()))?;
        if index == "*" {
            let number = VEHICLE_FIELDS
                .iter()
                .find(|(known, ..)| *known == rest && *known != "position_m");
            let (_, unit, access) = number.ok_or_else(unknown)?;
            return Ok(scalar(FieldTarget::AllVehicles(*access), unit));
        }
        let index: usize = index.parse().map_err(|_| unknown())?;
        let count = base.vehicles.len();
        let vehicle = base.vehicles.get(index).ok_or_else(|| {
            format!("there is no vehicles[{index}]: the base scenario has {count} vehicles, counted from 0")
        })?;
        let of_vehicle = |field: VehicleField, unit: &'static str| {
            Ok(scalar(FieldTarget::Vehicle(index, field), unit))
        };
        if let Some((_, unit, access)) = VEHICLE_FIELDS.iter().find(|(known, ..)| *known == rest) {
            return of_vehicle(VehicleField::Number(*access), unit);
        }
        let name = vehicle.driver.name();
        match rest {
            "driver" if !matches!(vehicle.driver, Driver::Controller(_)) => {
                return Err(format!(
                    "vehicle {index} of the base scenario is driven by `{name}`, which is not a built-in controller"
                ));
            }
            "gap_m" | "time_gap_s" | "closing_time_s" if index == 0 => {
                return Err("no vehicle is ahead of vehicle 0".to_owned());
            }
            _ => {}
        }
        if let Some((when, (_, access))) = LANE_CHANGES
            .iter()
            .find_map(|change| Some((rest.strip_prefix(change.0)?, change)))
        {
            let stated = access(&mut vehicle.clone()).copied();
            let stated = stated
                .filter(|change| change.field() == when)
                .ok_or_else(|| {
                    format!("vehicle {index} of the base scenario does not state `{rest}`")
                })?;
            let unit = if matches!(stated, LaneChange::Gap(_)) {
                "m"
            } else {
                "s"
            };
            return of_vehicle(VehicleField::LaneChange(*access), unit);
        }
        let derived = DERIVED_FIELDS.iter().find(|(known, ..)| *known == rest);
        if let Some(setting) = rest.strip_prefix("driver.") {
            let (kind, setting) = setting.split_once('.').ok_or_else(unknown)?;
            if kind != name {
                return Err(format!(
                    "vehicle {index} of the base scenario is driven by `{name}`, not by `{kind}`"
                ));
            }
            if let Some((_, unit, access)) = DRIVER_FIELDS.iter().find(|(known, ..)| *known == rest)
            {
                return of_vehicle(VehicleField::Driver(*access), unit);
            }
            if let Driver::Controller(spec) = &vehicle.driver
                && let Some(place) = spec.fields().iter().position(|known| known.name == setting)
            {
                return of_vehicle(VehicleField::Setting(place), spec.fields()[place].unit());
            }
        } else if derived.is_none() {
            return Err(format!("{}; {}", unknown(), known_fields_text()));
        }
        let (_, unit, field, writes) = derived.ok_or_else(unknown)?;
        Ok(Self {
            target: FieldTarget::Vehicle(index, *field),
            unit,
            length: field.numbers_mut(&mut vehicle.clone()).len().max(1),
            written_paths: writes
                .iter()
                .map(|field| format!("vehicles[{index}].{field}"))
                .collect(),
        })
    }
}

impl FieldTarget {
    /// Returns the stage in which the field is set; dependent fields follow.
    pub(super) fn stage(self) -> u8 {
        use VehicleField as F;
        match self {
            Self::AllVehicles(_) => 1,
            Self::Vehicle(_, F::Class | F::ControllerChoice | F::Size) => 0,
            Self::Vehicle(_, F::RateShare | F::PiecesShare | F::PiecesCruise) => 3,
            Self::Vehicle(_, F::TimeGap | F::ClosingTime | F::FinalSpeedShare) => 3,
            Self::Vehicle(_, F::PiecesScale) => 4,
            Self::Scenario(_) | Self::Fault(_) | Self::Vehicle(..) => 2,
        }
    }

    /// Sets the field. In a scenario with gaps, `position_m` holds the gap ahead until positions are computed.
    #[inline]
    pub(super) fn set(self, spec: &mut ScenarioSpec, values: &[f64]) {
        let Some(&value) = values.first() else { return };
        let (index, field) = match self {
            Self::Scenario(access) => {
                *access(spec) = value;
                return;
            }
            Self::Fault(access) => {
                *access(&mut spec.sensors.faults) = value;
                return;
            }
            Self::AllVehicles(access) => {
                return spec
                    .vehicles
                    .iter_mut()
                    .for_each(|vehicle| *access(vehicle) = value);
            }
            Self::Vehicle(index, field) => (index, field),
        };
        let (friction, until_s) = (spec.environment.friction, spec.duration_s);
        let gap_m = if matches!(field, VehicleField::ClosingTime) {
            closing_gap_m(spec, index, value)
        } else {
            0.0
        };
        let Some(vehicle) = spec.vehicles.get_mut(index) else {
            return;
        };
        match field {
            VehicleField::Class => {
                let class = VehicleClass::ALL.get(value as usize).copied();
                vehicle.class = class.unwrap_or(vehicle.class);
            }
            VehicleField::ControllerChoice => {
                let other = DriverName::from_number(value)
                    .filter(|name| name.name() != vehicle.driver.name());
                if let Some(controller) = other.and_then(DriverName::controller) {
                    vehicle.driver = Driver::Controller(controller);
                }
            }
            VehicleField::Size => {
                vehicle.length_m = Some(value);
                vehicle.class = VehicleClass::from_length(value);
            }
            VehicleField::ClosingTime => vehicle.position_m = gap_m,
            VehicleField::SpeedShare => vehicle.speed_mps *= value,
            VehicleField::Load => apply_load(vehicle, value),
            VehicleField::BrakeOffset => {
                vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() + value)
            }
            VehicleField::PiecesOnset => {
                if let Some(pieces) = pieces_mut(&mut vehicle.driver) {
                    let later_s = value - pieces.from_s.first().copied().unwrap_or(0.0);
                    pieces
                        .from_s
                        .iter_mut()
                        .for_each(|from_s| *from_s += later_s);
                }
            }
            VehicleField::PiecesCruise => apply_cruise(vehicle, values, until_s),
            VehicleField::PiecesScale => {
                accelerations_mut(&mut vehicle.driver)
                    .unwrap_or_default()
                    .iter_mut()
                    .for_each(|piece| *piece *= value);
            }
            _ => {
                let unit = field.size_of_one(vehicle, friction);
                let numbers = field.numbers_mut(vehicle);
                numbers
                    .iter_mut()
                    .zip(values)
                    .for_each(|(number, value)| *number = value * unit);
            }
        }
    }

    /// Returns the value of the field in a scenario with gaps in place of positions.
    pub(super) fn get(self, spec: &ScenarioSpec) -> Vec<f64> {
        let (index, field) = match self {
            Self::Scenario(access) => return vec![*access(&mut spec.clone())],
            Self::Fault(access) => return vec![*access(&mut spec.sensors.faults.clone())],
            Self::AllVehicles(access) => (0, VehicleField::Number(access)),
            Self::Vehicle(index, field) => (index, field),
        };
        let Some(mut vehicle) = spec.vehicles.get(index).cloned() else {
            return Vec::new();
        };
        match field {
            VehicleField::Class => vec![f64::from(vehicle.class.number())],
            VehicleField::ControllerChoice => DriverName::find(vehicle.driver.name())
                .map(DriverName::number)
                .into_iter()
                .collect(),
            VehicleField::Size => vec![vehicle.length_m()],
            VehicleField::ClosingTime => {
                let ahead = index
                    .checked_sub(1)
                    .and_then(|front| spec.vehicles.get(front));
                let time_s = |ahead: &VehicleSpec| {
                    vehicle.position_m / (vehicle.speed_mps - ahead.speed_mps)
                };
                ahead.map(time_s).into_iter().collect()
            }
            VehicleField::SpeedShare | VehicleField::PiecesScale => vec![1.0],
            VehicleField::Load => vec![vehicle.mass_kg() / vehicle.class.mass_kg()],
            VehicleField::BrakeOffset => {
                vec![vehicle.max_brake_mps2() - vehicle.class.max_brake_mps2()]
            }
            VehicleField::PiecesOnset => pieces_mut(&mut vehicle.driver)
                .and_then(|pieces| pieces.from_s.first().copied())
                .into_iter()
                .collect(),
            _ => {
                let unit = field.size_of_one(&vehicle, spec.environment.friction);
                field
                    .numbers_mut(&mut vehicle)
                    .iter()
                    .map(|number| *number / unit)
                    .collect()
            }
        }
    }

    pub(super) fn kind(self) -> ValueKind {
        match self {
            Self::Vehicle(_, VehicleField::Class) => ValueKind::Class,
            Self::Vehicle(_, VehicleField::ControllerChoice) => ValueKind::Driver,
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

    /// Returns the vehicle whose limits or position the field changes, if that can make a scenario invalid.
    pub(super) fn affected_vehicle(self) -> Option<usize> {
        match self {
            Self::Scenario(_) | Self::Fault(_) | Self::AllVehicles(_) => None,
            Self::Vehicle(_, VehicleField::Gap | VehicleField::PiecesOnset) => None,
            Self::Vehicle(index, _) => Some(index),
        }
    }
}

impl VehicleField {
    /// Returns the numbers of the scenario that the field sets to its values times [`Self::size_of_one`]; none for a
    /// field that is set in another way.
    fn numbers_mut(self, vehicle: &mut VehicleSpec) -> &mut [f64] {
        let number = match self {
            Self::Number(access) => Some(access(vehicle)),
            Self::Driver(access) => access(&mut vehicle.driver),
            Self::Setting(place) => setting_mut(&mut vehicle.driver, place),
            Self::LaneChange(access) => access(vehicle).map(LaneChange::value_mut),
            Self::Gap | Self::TimeGap => Some(&mut vehicle.position_m),
            Self::FinalSpeedShare => final_speed_mut(&mut vehicle.driver),
            Self::RateShare => brake_rate_mut(&mut vehicle.driver),
            Self::Signal(access) => return access(&mut vehicle.driver).unwrap_or_default(),
            Self::PiecesShare | Self::PiecesCruise => {
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
