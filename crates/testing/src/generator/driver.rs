//! Generation of drivers.

use std::sync::LazyLock;

use super::choices::Choices;
use super::shape::DriverKind;
use crumple_sim::control::{BuiltInController, Role};
use crumple_sim::scenario::{
    Brake, BrakeToSpeed, Driver, LeadProfile, PiecewiseAcceleration, RampBrake, RecordedSpeeds,
    VehicleSpec,
};

/// Bytes of a driver.
pub const DRIVER_BYTES: usize = 26;
const MAX_ENTRIES: u8 = 5;

pub(super) fn read_driver(kind: DriverKind, choices: &mut Choices<'_>) -> Driver {
    match kind {
        DriverKind::UnderTest => Driver::UnderTest,
        DriverKind::Profile(index) => Driver::Profile(read_profile(index, choices)),
        DriverKind::Controller(index) => Driver::Controller(read_controller(index, choices)),
    }
}

/// Reads a lead profile of the `index`-th kind, with an onset in the first 3 s and at most 9 m/s² of braking.
#[must_use]
pub fn profile_from_bytes(index: u8, bytes: &[u8]) -> LeadProfile {
    read_profile(index, &mut Choices::new(bytes))
}

/// Reads the `index`-th built-in controller with valid settings; no bytes give its defaults.
#[must_use]
pub fn controller_from_bytes(index: u8, bytes: &[u8]) -> BuiltInController {
    read_controller(index, &mut Choices::new(bytes))
}

fn read_profile(index: u8, choices: &mut Choices<'_>) -> LeadProfile {
    match index {
        0 => LeadProfile::ConstantSpeed,
        1 => LeadProfile::Brake(Brake {
            onset_s: read_onset_s(choices),
            rate_mps2: read_rate_mps2(choices),
        }),
        2 => LeadProfile::RampBrake(RampBrake {
            onset_s: read_onset_s(choices),
            rate_mps2: read_rate_mps2(choices),
            ramp_s: choices.around(1.5, [0.0, 2.0]),
            release_s: choices
                .optional(128, |choices| choices.up_to(1.0))
                .unwrap_or_default(),
        }),
        3 => LeadProfile::BrakeToSpeed(BrakeToSpeed {
            onset_s: read_onset_s(choices),
            rate_mps2: read_rate_mps2(choices),
            final_speed_mps: choices.up_to(30.0),
        }),
        4 => {
            let series = read_series(choices, 0.0, [-9.0, 4.0]);
            LeadProfile::Pieces(PiecewiseAcceleration {
                from_s: series.times_s,
                accel_mps2: series.values,
            })
        }
        _ => {
            let series = read_series(choices, 25.0, [0.0, 40.0]);
            LeadProfile::Recorded(RecordedSpeeds {
                time_s: series.times_s,
                speed_mps: series.values,
            })
        }
    }
}

/// Reads the time at which a leader begins to brake; that of the paper brakes from 1 s.
fn read_onset_s(choices: &mut Choices<'_>) -> f64 {
    choices.around(1.0, [0.0, 3.0])
}

/// Reads the deceleration of a leader; that of the paper brakes at 3 m/s².
fn read_rate_mps2(choices: &mut Choices<'_>) -> f64 {
    choices.around(3.0, [0.0, 9.0])
}

/// Values at increasing times.
#[derive(Default)]
struct TimeSeries {
    times_s: Vec<f64>,
    values: Vec<f64>,
}

fn read_series(choices: &mut Choices<'_>, nominal: f64, range: [f64; 2]) -> TimeSeries {
    let entries = 1 + choices.byte() % MAX_ENTRIES;
    let mut series = TimeSeries::default();
    let mut time_s = 0.0;
    for _ in 0..entries {
        time_s += choices.around(0.5, [0.001, 1.0]);
        series.times_s.push(time_s);
        series.values.push(choices.around(nominal, range));
    }
    series
}

/// Controllers to generate: all with a role up to [`Role::Reference`], and the built-in policy.
pub static CONTROLLERS: LazyLock<Vec<BuiltInController>> = LazyLock::new(|| {
    let rules = BuiltInController::all()
        .into_iter()
        .filter(|spec| spec.role() <= Role::Reference);
    rules
        .chain([BuiltInController::Policy(Default::default())])
        .collect()
});

fn read_controller(index: u8, choices: &mut Choices<'_>) -> BuiltInController {
    let mut spec = CONTROLLERS[usize::from(index) % CONTROLLERS.len()].clone();
    for (index, field) in spec.fields().iter().enumerate() {
        if let Some(value) = spec.get_mut(index) {
            *value = choices.around(*value, field.typical_range);
        }
    }
    spec
}

/// Gives a vehicle a script, with sufficient braking and no actuator delay to follow it.
pub fn make_scripted(vehicle: &mut VehicleSpec, profile: LeadProfile) {
    let [lowest_mps2, highest_mps2] = profile.acceleration_range_mps2();
    if -lowest_mps2 > vehicle.max_brake_mps2() {
        vehicle.max_brake_mps2 = Some(-lowest_mps2);
    }
    if highest_mps2 > vehicle.max_accel_mps2() {
        vehicle.max_accel_mps2 = Some(highest_mps2);
    }
    (
        vehicle.reaction_delay_s,
        vehicle.actuator_delay_s,
        vehicle.actuator_lag_s,
    ) = (0.0, 0.0, 0.0);
    vehicle.jerk_limit_mps3 = None;
    vehicle.driver = Driver::Profile(profile);
}
