//! Fields that parameters set: paths are resolved once to typed access.

use super::derived::{apply_cruise, apply_load, closing_gap_m};
use super::numeric_fields::{
    DRIVER_FIELDS, LANE_CHANGES, LaneChangeAccessor, SCENARIO_FIELDS, VEHICLE_FIELDS, accelerations_mut,
    brake_rate_mut, final_speed_mut, known_fields_text, pieces_mut, recorded_speeds_mut, setting_mut,
};
use super::spec::{DriverName, ValueKind};
use crate::scenario::{Driver, LaneChange, ScenarioSpec, VehicleClass, VehicleSpec};

#[derive(Debug, Clone, Copy)]
pub(super) enum FieldTarget {
    /// A number of the whole scenario.
    Scenario(fn(&mut ScenarioSpec) -> &mut f64),
    /// A number of one vehicle, or of all of them.
    Vehicle(Option<usize>, fn(&mut VehicleSpec) -> &mut f64),
    /// A number of a scripted driver.
    Driver(usize, fn(&mut Driver) -> Option<&mut f64>),
    /// A setting of a controller, by index.
    Setting(usize, usize),
    /// The trigger of entering or leaving the lane.
    LaneChange(usize, LaneChangeAccessor),
    /// A list of a driver: a signal.
    Signal(usize, fn(&mut Driver) -> Option<&mut [f64]>),
    /// The vehicle class.
    Class(usize),
    /// The built-in controller that drives.
    ControllerChoice(usize),
    /// The length, with the class of that length.
    Size(usize),
    /// The bumper gap ahead.
    Gap(usize),
    /// The gap ahead as a time at the vehicle's own speed.
    TimeGap(usize),
    /// The gap ahead as a time at the closing speed.
    ClosingTime(usize),
    /// A factor of the vehicle's speed.
    SpeedShare(usize),
    /// The final speed of a braking script, relative to its initial speed.
    FinalSpeedShare(usize),
    /// The mass relative to that of the class, with the resulting deceleration.
    Load(usize),
    /// The difference to the class's largest deceleration.
    BrakeOffset(usize),
    /// The deceleration of a braking script, relative to what the vehicle can do on this road.
    RateShare(usize),
    /// The deceleration of every piece of a script, relative to what the vehicle can do on this road.
    PiecesShare(usize),
    /// The start of the first piece; the intervals between pieces stay.
    PiecesOnset(usize),
    /// The acceleration of every piece, reduced where the speed would leave 18 to 130 km/h.
    PiecesCruise(usize),
    /// A factor of all pieces, applied last.
    PiecesScale(usize),
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
        if let Some((_, unit, access)) = SCENARIO_FIELDS.iter().find(|(known, ..)| *known == path) {
            return Ok(Self::new_scalar(FieldTarget::Scenario(*access), unit, path));
        }
        let unknown = || format!("no field `{path}` may vary");
        let (index, rest) = path
            .strip_prefix("vehicles[")
            .and_then(|rest| rest.split_once("]."))
            .ok_or_else(|| format!("{}; {}", unknown(), known_fields_text()))?;
        if index == "*" {
            let number = VEHICLE_FIELDS.iter().find(|(known, ..)| *known == rest && *known != "position_m");
            let (_, unit, access) = number.ok_or_else(unknown)?;
            return Ok(Self::new_scalar(FieldTarget::Vehicle(None, *access), unit, path));
        }
        let index: usize = index.parse().map_err(|_| unknown())?;
        let count = base.vehicles.len();
        let vehicle = base.vehicles.get(index).ok_or_else(|| {
            format!("there is no vehicles[{index}]: the base scenario has {count} vehicles, counted from 0")
        })?;
        if let Some((_, unit, access)) = VEHICLE_FIELDS.iter().find(|(known, ..)| *known == rest) {
            return Ok(Self::new_scalar(FieldTarget::Vehicle(Some(index), *access), unit, path));
        }
        let sets = |fields: &[&str]| fields.iter().map(|field| format!("vehicles[{index}].{field}")).collect();
        let field = |target, unit, length, writes| Self { target, unit, length, written_paths: writes };
        match rest {
            "class" => return Ok(field(FieldTarget::Class(index), "", 1, sets(&["class"]))),
            "driver" if matches!(vehicle.driver, Driver::Controller(_)) => {
                return Ok(field(FieldTarget::ControllerChoice(index), "", 1, sets(&["driver"])));
            }
            "driver" => {
                let name = vehicle.driver.name();
                return Err(format!(
                    "vehicle {index} of the base scenario is driven by `{name}`, which is not a built-in controller"
                ));
            }
            "gap_m" | "time_gap_s" | "closing_time_s" if index == 0 => {
                return Err("no vehicle is ahead of vehicle 0".to_owned());
            }
            "gap_m" => return Ok(field(FieldTarget::Gap(index), "m", 1, sets(&["position_m"]))),
            "time_gap_s" => return Ok(field(FieldTarget::TimeGap(index), "s", 1, sets(&["position_m"]))),
            "closing_time_s" => return Ok(field(FieldTarget::ClosingTime(index), "s", 1, sets(&["position_m"]))),
            "speed_share" => return Ok(field(FieldTarget::SpeedShare(index), "1", 1, sets(&["speed_mps"]))),
            "size_m" => return Ok(field(FieldTarget::Size(index), "m", 1, sets(&["class", "length_m"]))),
            "load" => return Ok(field(FieldTarget::Load(index), "1", 1, sets(&["mass_kg", "max_brake_mps2"]))),
            "brake_offset_mps2" => {
                return Ok(field(FieldTarget::BrakeOffset(index), "m/s²", 1, sets(&["max_brake_mps2"])));
            }
            _ => {}
        }
        if let Some((when, (_, access))) =
            LANE_CHANGES.iter().find_map(|change| Some((rest.strip_prefix(change.0)?, change)))
        {
            let stated = access(&mut vehicle.clone()).copied();
            let stated = stated
                .filter(|change| change.field() == when)
                .ok_or_else(|| format!("vehicle {index} of the base scenario does not state `{rest}`"))?;
            let unit = if matches!(stated, LaneChange::Gap(_)) { "m" } else { "s" };
            return Ok(field(FieldTarget::LaneChange(index, *access), unit, 1, sets(&[rest])));
        }
        let mut driver = vehicle.driver.clone();
        let name = driver.name();
        let setting = rest.strip_prefix("driver.").ok_or_else(|| format!("{}; {}", unknown(), known_fields_text()))?;
        let (kind, setting) = setting.split_once('.').ok_or_else(unknown)?;
        if kind != name {
            return Err(format!("vehicle {index} of the base scenario is driven by `{name}`, not by `{kind}`"));
        }
        let own = sets(&[rest]);
        if let Some((_, unit, access)) = DRIVER_FIELDS.iter().find(|(known, ..)| *known == rest) {
            return Ok(field(FieldTarget::Driver(index, *access), unit, 1, own));
        }
        if let Driver::Controller(spec) = &vehicle.driver
            && let Some(place) = spec.fields().iter().position(|known| known.name == setting)
        {
            return Ok(field(FieldTarget::Setting(index, place), spec.fields()[place].unit(), 1, own));
        }
        let list = |signal: Option<&mut [f64]>| signal.map_or(0, |signal| signal.len());
        match (kind, setting) {
            ("pieces", "accel_mps2") => Ok(field(
                FieldTarget::Signal(index, accelerations_mut),
                "m/s²",
                list(accelerations_mut(&mut driver)),
                own,
            )),
            ("pieces", "brake_share") => {
                let length = list(accelerations_mut(&mut driver));
                Ok(field(FieldTarget::PiecesShare(index), "1", length, sets(&["driver.pieces.accel_mps2"])))
            }
            ("pieces", "onset_s") => Ok(field(FieldTarget::PiecesOnset(index), "s", 1, own)),
            ("pieces", "cruise_mps2") => {
                let length = list(accelerations_mut(&mut driver));
                Ok(field(FieldTarget::PiecesCruise(index), "m/s²", length, sets(&["driver.pieces.accel_mps2"])))
            }
            ("pieces", "scale") => Ok(field(FieldTarget::PiecesScale(index), "1", 1, own)),
            ("recorded", "speed_mps") => Ok(field(
                FieldTarget::Signal(index, recorded_speeds_mut),
                "m/s",
                list(recorded_speeds_mut(&mut driver)),
                own,
            )),
            ("brake-to-speed", "final_share") => {
                Ok(field(FieldTarget::FinalSpeedShare(index), "1", 1, sets(&["driver.brake-to-speed.final_speed_mps"])))
            }
            (_, "rate_share") if brake_rate_mut(&mut driver).is_some() => {
                Ok(field(FieldTarget::RateShare(index), "1", 1, sets(&[&format!("driver.{kind}.rate_mps2")])))
            }
            _ => Err(unknown()),
        }
    }

    fn new_scalar(target: FieldTarget, unit: &'static str, path: &str) -> Self {
        Self { target, unit, length: 1, written_paths: vec![path.to_owned()] }
    }
}

impl FieldTarget {
    /// Returns the stage in which the field is set; dependent fields follow.
    pub(super) fn stage(self) -> u8 {
        match self {
            Self::Class(_) | Self::ControllerChoice(_) | Self::Size(_) => 0,
            Self::Vehicle(None, _) => 1,
            Self::RateShare(_) | Self::PiecesShare(_) | Self::PiecesCruise(_) => 3,
            Self::TimeGap(_) | Self::ClosingTime(_) | Self::FinalSpeedShare(_) => 3,
            Self::PiecesScale(_) => 4,
            _ => 2,
        }
    }

    /// Sets the field. In a scenario with gaps, `position_m` holds the gap ahead until positions are computed.
    #[inline]
    pub(super) fn set(self, spec: &mut ScenarioSpec, values: &[f64]) {
        let Some(&value) = values.first() else { return };
        let friction = spec.environment.friction;
        match self {
            Self::Scenario(access) => *access(spec) = value,
            Self::Vehicle(None, access) => spec.vehicles.iter_mut().for_each(|vehicle| *access(vehicle) = value),
            Self::Vehicle(Some(index), access) => update_vehicle(spec, index, |vehicle| *access(vehicle) = value),
            Self::Driver(index, access) => update_vehicle(spec, index, |vehicle| {
                if let Some(number) = access(&mut vehicle.driver) {
                    *number = value;
                }
            }),
            Self::Setting(index, place) => update_vehicle(spec, index, |vehicle| {
                if let Some(number) = setting_mut(&mut vehicle.driver, place) {
                    *number = value;
                }
            }),
            Self::LaneChange(index, access) => update_vehicle(spec, index, |vehicle| {
                if let Some(change) = access(vehicle) {
                    *change.value_mut() = value;
                }
            }),
            Self::Signal(index, access) => update_vehicle(spec, index, |vehicle| {
                if let Some(signal) = access(&mut vehicle.driver) {
                    signal.iter_mut().zip(values).for_each(|(piece, value)| *piece = *value);
                }
            }),
            Self::Class(index) => update_vehicle(spec, index, |vehicle| {
                let class = VehicleClass::ALL.get(value as usize).copied();
                vehicle.class = class.unwrap_or(vehicle.class);
            }),
            Self::ControllerChoice(index) => update_vehicle(spec, index, |vehicle| {
                let other = DriverName::from_number(value).filter(|name| name.name() != vehicle.driver.name());
                if let Some(controller) = other.and_then(DriverName::controller) {
                    vehicle.driver = Driver::Controller(controller);
                }
            }),
            Self::Size(index) => update_vehicle(spec, index, |vehicle| {
                vehicle.length_m = Some(value);
                vehicle.class = VehicleClass::from_length(value);
            }),
            Self::Gap(index) => update_vehicle(spec, index, |vehicle| vehicle.position_m = value),
            Self::TimeGap(index) => {
                update_vehicle(spec, index, |vehicle| vehicle.position_m = value * vehicle.speed_mps)
            }
            Self::ClosingTime(index) => {
                let gap_m = closing_gap_m(spec, index, value);
                update_vehicle(spec, index, |vehicle| vehicle.position_m = gap_m);
            }
            Self::SpeedShare(index) => update_vehicle(spec, index, |vehicle| vehicle.speed_mps *= value),
            Self::FinalSpeedShare(index) => update_vehicle(spec, index, |vehicle| {
                let from_mps = vehicle.speed_mps;
                if let Some(final_mps) = final_speed_mut(&mut vehicle.driver) {
                    *final_mps = value * from_mps;
                }
            }),
            Self::Load(index) => update_vehicle(spec, index, |vehicle| apply_load(vehicle, value)),
            Self::BrakeOffset(index) => update_vehicle(spec, index, |vehicle| {
                vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() + value);
            }),
            Self::RateShare(index) => update_vehicle(spec, index, |vehicle| {
                let usable_mps2 = vehicle.max_brake_mps2() * friction;
                if let Some(rate) = brake_rate_mut(&mut vehicle.driver) {
                    *rate = value * usable_mps2;
                }
            }),
            Self::PiecesShare(index) => update_vehicle(spec, index, |vehicle| {
                let usable_mps2 = vehicle.max_brake_mps2() * friction;
                if let Some(signal) = accelerations_mut(&mut vehicle.driver) {
                    signal.iter_mut().zip(values).for_each(|(piece, share)| *piece = -share * usable_mps2);
                }
            }),
            Self::PiecesOnset(index) => update_vehicle(spec, index, |vehicle| {
                if let Some(pieces) = pieces_mut(&mut vehicle.driver) {
                    let later_s = value - pieces.from_s.first().copied().unwrap_or(0.0);
                    pieces.from_s.iter_mut().for_each(|from_s| *from_s += later_s);
                }
            }),
            Self::PiecesCruise(index) => {
                let until_s = spec.duration_s;
                update_vehicle(spec, index, |vehicle| apply_cruise(vehicle, values, until_s));
            }
            Self::PiecesScale(index) => update_vehicle(spec, index, |vehicle| {
                accelerations_mut(&mut vehicle.driver).unwrap_or_default().iter_mut().for_each(|piece| *piece *= value);
            }),
        }
    }

    /// Returns the value of the field in a scenario with gaps in place of positions.
    pub(super) fn get(self, spec: &ScenarioSpec) -> Vec<f64> {
        let mut spec = spec.clone();
        let friction = spec.environment.friction;
        let of = |index: usize| spec.vehicles.get(index);
        let one = |value: Option<f64>| value.into_iter().collect();
        match self {
            Self::Scenario(access) => vec![*access(&mut spec)],
            Self::Vehicle(index, access) => one(spec.vehicles.get_mut(index.unwrap_or(0)).map(|v| *access(v))),
            Self::Driver(index, access) => {
                one(spec.vehicles.get_mut(index).and_then(|v| access(&mut v.driver).copied()))
            }
            Self::Setting(index, place) => {
                one(spec.vehicles.get_mut(index).and_then(|v| setting_mut(&mut v.driver, place).copied()))
            }
            Self::LaneChange(index, access) => one(spec.vehicles.get_mut(index).and_then(|v| Some(access(v)?.value()))),
            Self::PiecesCruise(index) => Self::Signal(index, accelerations_mut).get(&spec),
            Self::Signal(index, access) => {
                let signal = spec.vehicles.get_mut(index).and_then(|v| access(&mut v.driver));
                signal.map_or_else(Vec::new, |signal| signal.to_vec())
            }
            Self::Class(index) => one(of(index).map(|v| f64::from(v.class.number()))),
            Self::ControllerChoice(index) => {
                one(of(index).and_then(|v| DriverName::find(v.driver.name())).map(DriverName::number))
            }
            Self::Size(index) => one(of(index).map(|v| v.length_m())),
            Self::Gap(index) => one(of(index).map(|v| v.position_m)),
            Self::TimeGap(index) => one(of(index).map(|v| v.position_m / v.speed_mps)),
            Self::ClosingTime(index) => one(of(index)
                .zip(index.checked_sub(1).and_then(of))
                .map(|(vehicle, ahead)| vehicle.position_m / (vehicle.speed_mps - ahead.speed_mps))),
            Self::FinalSpeedShare(index) => one(spec
                .vehicles
                .get_mut(index)
                .and_then(|v| final_speed_mut(&mut v.driver).map(|final_mps| *final_mps / v.speed_mps))),
            Self::PiecesScale(_) | Self::SpeedShare(_) => vec![1.0],
            Self::Load(index) => one(of(index).map(|v| v.mass_kg() / v.class.mass_kg())),
            Self::BrakeOffset(index) => one(of(index).map(|v| v.max_brake_mps2() - v.class.max_brake_mps2())),
            Self::RateShare(index) => one(spec.vehicles.get_mut(index).and_then(|v| {
                let usable_mps2 = v.max_brake_mps2() * friction;
                brake_rate_mut(&mut v.driver).map(|rate| *rate / usable_mps2)
            })),
            Self::PiecesShare(index) => spec.vehicles.get_mut(index).map_or_else(Vec::new, |v| {
                let usable_mps2 = v.max_brake_mps2() * friction;
                let signal = accelerations_mut(&mut v.driver).unwrap_or_default();
                signal.iter().map(|accel_mps2| -accel_mps2 / usable_mps2).collect()
            }),
            Self::PiecesOnset(index) => one(spec
                .vehicles
                .get_mut(index)
                .and_then(|v| pieces_mut(&mut v.driver).and_then(|pieces| pieces.from_s.first().copied()))),
        }
    }

    pub(super) fn kind(self) -> ValueKind {
        match self {
            Self::Class(_) => ValueKind::Class,
            Self::ControllerChoice(_) => ValueKind::Driver,
            _ => ValueKind::Number,
        }
    }

    /// Returns the vehicle whose driver the field changes.
    pub(super) fn driver_vehicle(self) -> Option<usize> {
        match self {
            Self::Driver(i, _) | Self::Setting(i, _) | Self::Signal(i, _) => Some(i),
            Self::RateShare(i) | Self::PiecesShare(i) | Self::PiecesOnset(i) => Some(i),
            Self::PiecesCruise(i) | Self::PiecesScale(i) | Self::ControllerChoice(i) | Self::FinalSpeedShare(i) => {
                Some(i)
            }
            Self::ClosingTime(_)
            | Self::SpeedShare(_)
            | Self::Scenario(_)
            | Self::Vehicle(..)
            | Self::LaneChange(..)
            | Self::Class(_)
            | Self::Size(_)
            | Self::Gap(_)
            | Self::TimeGap(_) => None,
            Self::Load(_) | Self::BrakeOffset(_) => None,
        }
    }

    /// Returns the vehicle whose limits or position the field changes, if that can make a scenario invalid.
    pub(super) fn affected_vehicle(self) -> Option<usize> {
        match self {
            Self::Class(i) | Self::Load(i) | Self::BrakeOffset(i) | Self::RateShare(i) | Self::PiecesShare(i) => {
                Some(i)
            }
            Self::Signal(i, _) | Self::Driver(i, _) | Self::Setting(i, _) | Self::LaneChange(i, _) => Some(i),
            Self::ClosingTime(i) | Self::SpeedShare(i) | Self::FinalSpeedShare(i) => Some(i),
            Self::TimeGap(i) | Self::ControllerChoice(i) | Self::PiecesCruise(i) | Self::PiecesScale(i) => Some(i),
            Self::Size(i) => Some(i),
            Self::Vehicle(i, _) => i,
            Self::Scenario(_) | Self::Gap(_) | Self::PiecesOnset(_) => None,
        }
    }
}

fn update_vehicle(spec: &mut ScenarioSpec, index: usize, change: impl FnOnce(&mut VehicleSpec)) {
    if let Some(vehicle) = spec.vehicles.get_mut(index) {
        change(vehicle);
    }
}
