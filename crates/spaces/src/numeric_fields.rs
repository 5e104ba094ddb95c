//! Numeric fields of a scenario that may vary, by path.

use super::field::VehicleField;
use crumple_sim::scenario::{
    Driver, FAULT_FIELDS, LaneChange, LeadProfile, PiecewiseAcceleration, ScenarioSpec, VehicleSpec,
};

/// Path after `vehicles[i].`, unit, and accessor.
pub(super) type VehicleNumericField =
    (&'static str, &'static str, fn(&mut VehicleSpec) -> &mut f64);

pub(super) const VEHICLE_FIELDS: [VehicleNumericField; 11] = [
    ("position_m", "m", |v| &mut v.position_m),
    ("speed_mps", "m/s", |v| &mut v.speed_mps),
    ("length_m", "m", |v| {
        v.length_m.get_or_insert(v.class.length_m())
    }),
    ("mass_kg", "kg", |v| {
        v.mass_kg.get_or_insert(v.class.mass_kg())
    }),
    ("max_brake_mps2", "m/s²", |v| {
        v.max_brake_mps2.get_or_insert(v.class.max_brake_mps2())
    }),
    ("max_accel_mps2", "m/s²", |v| {
        v.max_accel_mps2.get_or_insert(v.class.max_accel_mps2())
    }),
    ("acceleration_noise_mps2", "m/s²", |v| {
        &mut v.acceleration_noise_mps2
    }),
    ("reaction_delay_s", "s", |v| &mut v.reaction_delay_s),
    ("actuator_lag_s", "s", |v| &mut v.actuator_lag_s),
    ("actuator_delay_s", "s", |v| &mut v.actuator_delay_s),
    ("jerk_limit_mps3", "m/s³", |v| {
        v.jerk_limit_mps3.get_or_insert(1e4)
    }),
];

pub(super) type ScenarioNumericField = (
    &'static str,
    &'static str,
    fn(&mut ScenarioSpec) -> &mut f64,
);

/// Without the faults of sensors ([`FAULT_FIELDS`]).
pub(super) const SCENARIO_FIELDS: [ScenarioNumericField; 4] = [
    ("environment.friction", "1", |s| &mut s.environment.friction),
    ("sensors.position_noise_m", "m", |s| {
        &mut s.sensors.position_noise_m
    }),
    ("sensors.gap_noise_m", "m", |s| &mut s.sensors.gap_noise_m),
    ("sensors.dropout", "1", |s| &mut s.sensors.dropout),
];

/// Path of the faults of sensors.
pub(super) const FAULTS: &str = "sensors.faults.";

pub(super) type DriverNumericField = (
    &'static str,
    &'static str,
    fn(&mut Driver) -> Option<&mut f64>,
);

/// Declares `driver.NAME.SETTING` of a script.
macro_rules! setting {
    ($path:literal, $unit:literal, $kind:ident, $field:ident) => {
        ($path, $unit, |driver| match driver {
            Driver::Profile(LeadProfile::$kind(settings)) => Some(&mut settings.$field),
            _ => None,
        })
    };
}

pub(super) const DRIVER_FIELDS: [DriverNumericField; 9] = [
    setting!("driver.brake.onset_s", "s", Brake, onset_s),
    setting!("driver.brake.rate_mps2", "m/s²", Brake, rate_mps2),
    setting!("driver.ramp-brake.onset_s", "s", RampBrake, onset_s),
    setting!("driver.ramp-brake.rate_mps2", "m/s²", RampBrake, rate_mps2),
    setting!("driver.ramp-brake.ramp_s", "s", RampBrake, ramp_s),
    setting!("driver.ramp-brake.release_s", "s", RampBrake, release_s),
    setting!("driver.brake-to-speed.onset_s", "s", BrakeToSpeed, onset_s),
    setting!(
        "driver.brake-to-speed.rate_mps2",
        "m/s²",
        BrakeToSpeed,
        rate_mps2
    ),
    (
        "driver.brake-to-speed.final_speed_mps",
        "m/s",
        final_speed_mut,
    ),
];

pub(super) type LaneChangeAccessor = fn(&mut VehicleSpec) -> Option<&mut LaneChange>;

pub(super) const LANE_CHANGES: [(&str, LaneChangeAccessor); 2] = [
    ("enters.", |vehicle| vehicle.enters.as_mut()),
    ("leaves.", |vehicle| vehicle.leaves.as_mut()),
];

pub(super) fn setting_mut(driver: &mut Driver, index: usize) -> Option<&mut f64> {
    if let Driver::Controller(spec) = driver {
        spec.get_mut(index)
    } else {
        None
    }
}

pub(super) fn pieces_mut(driver: &mut Driver) -> Option<&mut PiecewiseAcceleration> {
    if let Driver::Profile(LeadProfile::Pieces(pieces)) = driver {
        Some(pieces)
    } else {
        None
    }
}

pub(super) fn accelerations_mut(driver: &mut Driver) -> Option<&mut [f64]> {
    pieces_mut(driver).map(|pieces| pieces.accel_mps2.as_mut_slice())
}

fn recorded_speeds_mut(driver: &mut Driver) -> Option<&mut [f64]> {
    match driver {
        Driver::Profile(LeadProfile::Recorded(recorded)) => Some(recorded.speed_mps.as_mut_slice()),
        _ => None,
    }
}

pub(super) fn brake_rate_mut(driver: &mut Driver) -> Option<&mut f64> {
    match driver {
        Driver::Profile(LeadProfile::Brake(brake)) => Some(&mut brake.rate_mps2),
        Driver::Profile(LeadProfile::RampBrake(brake)) => Some(&mut brake.rate_mps2),
        Driver::Profile(LeadProfile::BrakeToSpeed(brake)) => Some(&mut brake.rate_mps2),
        _ => None,
    }
}

pub(super) fn final_speed_mut(driver: &mut Driver) -> Option<&mut f64> {
    if let Driver::Profile(LeadProfile::BrakeToSpeed(brake)) = driver {
        Some(&mut brake.final_speed_mps)
    } else {
        None
    }
}

/// Path after `vehicles[i].`, unit, field, and the paths that it sets.
type DerivedField = (
    &'static str,
    &'static str,
    VehicleField,
    &'static [&'static str],
);

pub(super) const DERIVED_FIELDS: [DerivedField; 21] = [
    ("class", "", VehicleField::Class, &["class"]),
    ("driver", "", VehicleField::ControllerChoice, &["driver"]),
    ("follower", "", VehicleField::Follower, &["driver"]),
    ("gap_m", "m", VehicleField::Gap, &["position_m"]),
    ("time_gap_s", "s", VehicleField::TimeGap, &["position_m"]),
    (
        "closing_time_s",
        "s",
        VehicleField::ClosingTime,
        &["position_m"],
    ),
    ("speed_share", "1", VehicleField::SpeedShare, &["speed_mps"]),
    ("size_m", "m", VehicleField::Size, &["class", "length_m"]),
    (
        "load",
        "1",
        VehicleField::Load,
        &["mass_kg", "max_brake_mps2"],
    ),
    (
        "brake_offset_mps2",
        "m/s²",
        VehicleField::BrakeOffset,
        &["max_brake_mps2"],
    ),
    (
        "driver.brake.rate_share",
        "1",
        VehicleField::RateShare,
        &["driver.brake.rate_mps2"],
    ),
    (
        "driver.ramp-brake.rate_share",
        "1",
        VehicleField::RateShare,
        &["driver.ramp-brake.rate_mps2"],
    ),
    (
        "driver.brake-to-speed.rate_share",
        "1",
        VehicleField::RateShare,
        &["driver.brake-to-speed.rate_mps2"],
    ),
    (
        "driver.brake-to-speed.final_share",
        "1",
        VehicleField::FinalSpeedShare,
        &["driver.brake-to-speed.final_speed_mps"],
    ),
    (
        "driver.pieces.accel_mps2",
        "m/s²",
        VehicleField::Signal(accelerations_mut),
        &["driver.pieces.accel_mps2"],
    ),
    (
        "driver.pieces.brake_share",
        "1",
        VehicleField::PiecesShare,
        &["driver.pieces.accel_mps2"],
    ),
    (
        "driver.pieces.onset_s",
        "s",
        VehicleField::PiecesOnset,
        &["driver.pieces.onset_s"],
    ),
    (
        "driver.pieces.cruise_mps2",
        "m/s²",
        VehicleField::PiecesCruise,
        &["driver.pieces.accel_mps2"],
    ),
    (
        "driver.pieces.stop_and_go_mps2",
        "m/s²",
        VehicleField::PiecesStopAndGo,
        &["driver.pieces.accel_mps2"],
    ),
    (
        "driver.pieces.scale",
        "1",
        VehicleField::PiecesScale,
        &["driver.pieces.scale"],
    ),
    (
        "driver.recorded.speed_mps",
        "m/s",
        VehicleField::Signal(recorded_speeds_mut),
        &["driver.recorded.speed_mps"],
    ),
];

pub(super) fn known_fields_text() -> String {
    let faults = FAULT_FIELDS
        .iter()
        .map(|field| format!("{FAULTS}{}", field.path));
    let scenario = SCENARIO_FIELDS
        .iter()
        .map(|(name, ..)| (*name).to_owned())
        .chain(faults);
    let derived = DERIVED_FIELDS
        .iter()
        .map(|(name, ..)| *name)
        .filter(|name| !name.starts_with("driver."));
    let vehicle = VEHICLE_FIELDS.iter().map(|(name, ..)| *name).chain(derived);
    let scenario = scenario.collect::<Vec<_>>().join(", ");
    let vehicle = vehicle.collect::<Vec<_>>().join(", ");
    format!(
        "there are {scenario}, and in vehicles[i]: {vehicle}, enters.WHEN, leaves.WHEN, driver.NAME.SETTING"
    )
}
