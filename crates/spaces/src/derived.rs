//! Fields that set several numbers of a vehicle consistently.

use super::spec::{DriverName, FollowerVariant};
use crumple_sim::scenario::{
    Driver, LeadProfile, PiecewiseAcceleration, ScenarioSpec, VehicleSpec,
};

/// Speed range of leaders under `cruise_mps2`, in m/s: 18 km/h to 130 km/h, the limit on most European motorways.
pub(super) const CRUISE_SPEED_RANGE_MPS: [f64; 2] = [18.0 / 3.6, 130.0 / 3.6];

/// Speed range of leaders under `stop_and_go_mps2`, in m/s.
pub(super) const STOP_AND_GO_SPEED_RANGE_MPS: [f64; 2] = [0.0, 130.0 / 3.6];

/// Smallest gap of a vehicle with a closing time, in metres.
const MIN_CLOSING_GAP_M: f64 = 2.0;

/// Returns the gap that vehicle `index` closes in `time_s` at its closing speed, in metres; at least 2 m.
pub(super) fn closing_gap_m(spec: &ScenarioSpec, index: usize, time_s: f64) -> f64 {
    let [own_mps, ahead_mps] = [Some(index), index.checked_sub(1)].map(|index| {
        let vehicle = index.and_then(|index| spec.vehicles.get(index));
        vehicle.map_or(0.0, |vehicle| vehicle.speed_mps)
    });
    (time_s * (own_mps - ahead_mps)).max(MIN_CLOSING_GAP_M)
}

/// Makes a built-in controller with default settings, or a preset, the driver, unless it is the driver already.
pub(super) fn apply_controller(vehicle: &mut VehicleSpec, name: Option<DriverName>) {
    let replacement = name.filter(|name| DriverName::of_driver(&vehicle.driver) != Some(*name));
    if let Some(controller) = replacement.and_then(DriverName::controller) {
        vehicle.driver = Driver::Controller(controller);
    }
}

/// Largest reaction delay and smallest largest deceleration of a scenario.
const MAX_DELAY_S: f64 = 10.0;
const MIN_BRAKE_MPS2: f64 = 0.1;
/// Additional reaction delay of a `late` follower, in seconds.
const LATE_S: f64 = 0.5;
/// Share of its largest deceleration with which a `weak` follower brakes.
const WEAK_SHARE: f64 = 0.7;

/// Makes vehicle `index`, the last one, the kind of follower with this number. The other fields have been set before.
pub(super) fn apply_follower(spec: &mut ScenarioSpec, index: usize, number: f64) {
    let variant = FollowerVariant::from_number(number);
    if variant == Some(FollowerVariant::None) {
        spec.vehicles.truncate(index);
    }
    let Some(vehicle) = spec.vehicles.get_mut(index) else {
        return;
    };
    let controller = match variant {
        Some(_) => DriverName::find("baseline"),
        None => DriverName::from_number(number),
    };
    apply_controller(vehicle, controller);
    match variant {
        Some(FollowerVariant::Late) => {
            vehicle.reaction_delay_s = (vehicle.reaction_delay_s + LATE_S).min(MAX_DELAY_S);
        }
        Some(FollowerVariant::Weak) => {
            let brake_mps2 = WEAK_SHARE * vehicle.max_brake_mps2();
            vehicle.max_brake_mps2 = Some(brake_mps2.max(MIN_BRAKE_MPS2));
        }
        Some(FollowerVariant::None) | None => {}
    }
}

/// Sets the mass relative to the class at the class's brake force: above 1, deceleration falls as 1 / load; below 1,
/// the tyres limit it to that of the class.
pub(super) fn apply_load(vehicle: &mut VehicleSpec, load: f64) {
    vehicle.mass_kg = Some(load * vehicle.class.mass_kg());
    vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() / load.max(1.0));
}

/// Reduces accelerations so that the speed at the end of each piece stays within a range, or does not leave it further.
/// A reduced acceleration stays within all limits that the original one satisfies.
pub(super) fn apply_cruise(
    vehicle: &mut VehicleSpec,
    wanted_mps2: &[f64],
    until_s: f64,
    speed_range_mps: [f64; 2],
) {
    let mut speed_mps = vehicle.speed_mps;
    let Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration { from_s, accel_mps2 })) =
        &mut vehicle.driver
    else {
        return;
    };
    let [lowest_mps, highest_mps] = speed_range_mps;
    let ends_s = from_s.iter().skip(1).copied().chain([until_s]);
    for (((accel_mps2, &from_s), to_s), &wanted_mps2) in accel_mps2
        .iter_mut()
        .zip(&*from_s)
        .zip(ends_s)
        .zip(wanted_mps2)
    {
        let duration_s = (to_s - from_s).max(0.0);
        let down_mps = lowest_mps.min(speed_mps) - speed_mps;
        let up_mps = highest_mps.max(speed_mps) - speed_mps;
        *accel_mps2 = match wanted_mps2 * duration_s {
            gained_mps if gained_mps < down_mps => down_mps / duration_s,
            gained_mps if gained_mps > up_mps => up_mps / duration_s,
            _ => wanted_mps2,
        };
        speed_mps += *accel_mps2 * duration_s;
    }
}
