//! Fields that set numbers of a vehicle by a rule, so that they fit together.

use crate::scenario::{Driver, LeadProfile, PiecewiseAcceleration, ScenarioSpec, VehicleSpec};

/// Speeds between which `cruise_mps2` keeps a leader, in m/s: 18 km/h, and 130 km/h, the limit on most motorways of Europe.
pub(super) const CRUISE_SPEED_RANGE_MPS: [f64; 2] = [18.0 / 3.6, 130.0 / 3.6];

/// Least gap of a vehicle whose distance is stated by the time in which it closes in, in metres.
const MIN_CLOSING_GAP_M: f64 = 2.0;

/// The gap ahead of vehicle `index` that it closes in `time_s` at the speeds that both have, in metres; 2 m where that is less,
/// and where it does not close in.
pub(super) fn closing_gap_m(spec: &ScenarioSpec, index: usize, time_s: f64) -> f64 {
    let speed_mps = |index: usize| spec.vehicles.get(index).map_or(0.0, |vehicle| vehicle.speed_mps);
    let closing_mps = speed_mps(index) - index.checked_sub(1).map_or(0.0, speed_mps);
    (time_s * closing_mps).max(MIN_CLOSING_GAP_M)
}

/// Mass relative to that of the class. The brake force is that of the class: above its mass deceleration falls in
/// proportion, below it the tyres limit deceleration to that of the class.
pub(super) fn apply_load(vehicle: &mut VehicleSpec, load: f64) {
    vehicle.mass_kg = Some(load * vehicle.class.mass_kg());
    vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() / load.max(1.0));
}

/// Accelerations as they are wanted, each as far as the speed at the end of its piece stays within [`CRUISE_SPEED_RANGE_MPS`]; a speed
/// that is beyond already does not get further away. A cut only takes away, so that limits that hold for all values hold.
pub(super) fn apply_cruise(vehicle: &mut VehicleSpec, wanted_mps2: &[f64], until_s: f64) {
    let mut speed_mps = vehicle.speed_mps;
    let Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration { from_s, accel_mps2 })) = &mut vehicle.driver else {
        return;
    };
    let [lowest_mps, highest_mps] = CRUISE_SPEED_RANGE_MPS;
    let ends_s = from_s.iter().skip(1).copied().chain([until_s]);
    for (((accel_mps2, &from_s), to_s), &wanted_mps2) in
        accel_mps2.iter_mut().zip(&*from_s).zip(ends_s).zip(wanted_mps2)
    {
        let held_s = (to_s - from_s).max(0.0);
        let (down_mps, up_mps) = (lowest_mps.min(speed_mps) - speed_mps, highest_mps.max(speed_mps) - speed_mps);
        *accel_mps2 = match wanted_mps2 * held_s {
            gained_mps if gained_mps < down_mps => down_mps / held_s,
            gained_mps if gained_mps > up_mps => up_mps / held_s,
            _ => wanted_mps2,
        };
        speed_mps += *accel_mps2 * held_s;
    }
}
