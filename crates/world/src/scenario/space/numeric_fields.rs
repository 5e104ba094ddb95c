//! Numeric fields of a scenario that may vary, by path.

use crate::scenario::{Driver, LaneChange, LeadProfile, PiecewiseAcceleration, ScenarioSpec, VehicleSpec};

/// Path after `vehicles[i].`, unit, and accessor.
pub(super) type VehicleNumericField = (&'static str, &'static str, fn(&mut VehicleSpec) -> &mut f64);

pub(super) const VEHICLE_FIELDS: [VehicleNumericField; 11] = [
    ("position_m", "m", |v| &mut v.position_m),
    ("speed_mps", "m/s", |v| &mut v.speed_mps),
    ("length_m", "m", |v| v.length_m.get_or_insert(v.class.length_m())),
    ("mass_kg", "kg", |v| v.mass_kg.get_or_insert(v.class.mass_kg())),
    ("max_brake_mps2", "m/s²", |v| v.max_brake_mps2.get_or_insert(v.class.max_brake_mps2())),
    ("max_accel_mps2", "m/s²", |v| v.max_accel_mps2.get_or_insert(v.class.max_accel_mps2())),
    ("acceleration_noise_mps2", "m/s²", |v| &mut v.acceleration_noise_mps2),
    ("reaction_delay_s", "s", |v| &mut v.reaction_delay_s),
    ("actuator_lag_s", "s", |v| &mut v.actuator_lag_s),
    ("actuator_delay_s", "s", |v| &mut v.actuator_delay_s),
    ("jerk_limit_mps3", "m/s³", |v| v.jerk_limit_mps3.get_or_insert(1e4)),
];

pub(super) type ScenarioNumericField = (&'static str, &'static str, fn(&mut ScenarioSpec) -> &mut f64);

pub(super) const SCENARIO_FIELDS: [ScenarioNumericField; 4] = [
    ("environment.friction", "1", |s| &mut s.environment.friction),
    ("sensors.position_noise_m", "m", |s| &mut s.sensors.position_noise_m),
    ("sensors.gap_noise_m", "m", |s| &mut s.sensors.gap_noise_m),
    ("sensors.dropout", "1", |s| &mut s.sensors.dropout),
];

pub(super) type DriverNumericField = (&'static str, &'static str, fn(&mut Driver) -> Option<&mut f64>);

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
    setting!("driver.brake-to-speed.rate_mps2", "m/s²", BrakeToSpeed, rate_mps2),
    setting!("driver.brake-to-speed.final_speed_mps", "m/s", BrakeToSpeed, final_speed_mps),
];

pub(super) type LaneChangeAccessor = fn(&mut VehicleSpec) -> Option<&mut LaneChange>;

pub(super) const LANE_CHANGES: [(&str, LaneChangeAccessor); 2] =
    [("enters.", |vehicle| vehicle.enters.as_mut()), ("leaves.", |vehicle| vehicle.leaves.as_mut())];

pub(super) fn setting_mut(driver: &mut Driver, place: usize) -> Option<&mut f64> {
    match driver {
        Driver::Controller(spec) => spec.get_mut(place),
        _ => None,
    }
}

pub(super) fn pieces_mut(driver: &mut Driver) -> Option<&mut PiecewiseAcceleration> {
    match driver {
        Driver::Profile(LeadProfile::Pieces(pieces)) => Some(pieces),
        _ => None,
    }
}

pub(super) fn accelerations_mut(driver: &mut Driver) -> Option<&mut [f64]> {
    pieces_mut(driver).map(|pieces| pieces.accel_mps2.as_mut_slice())
}

pub(super) fn recorded_speeds_mut(driver: &mut Driver) -> Option<&mut [f64]> {
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
    match driver {
        Driver::Profile(LeadProfile::BrakeToSpeed(brake)) => Some(&mut brake.final_speed_mps),
        _ => None,
    }
}

const DERIVED_VEHICLE_FIELDS: [&str; 9] =
    ["class", "driver", "gap_m", "time_gap_s", "closing_time_s", "speed_share", "size_m", "load", "brake_offset_mps2"];

pub(super) fn known_fields_text() -> String {
    let scenario = SCENARIO_FIELDS.iter().map(|(name, ..)| *name);
    let vehicle = VEHICLE_FIELDS.iter().map(|(name, ..)| *name).chain(DERIVED_VEHICLE_FIELDS);
    let (scenario, vehicle) = (scenario.collect::<Vec<_>>().join(", "), vehicle.collect::<Vec<_>>().join(", "));
    format!("there are {scenario}, and in vehicles[i]: {vehicle}, enters.WHEN, leaves.WHEN, driver.NAME.SETTING")
}
