//! Fields that set several numbers of a vehicle consistently.

use crumple_sim::scenario::{
    Driver, LeadProfile, PiecewiseAcceleration, ScenarioSpec, VehicleSpec,
};

/// Speed range of leaders under `cruise_mps2`, in m/s: 18 km/h to 130 km/h, the limit on most European motorways.
pub(super) const CRUISE_SPEED_RANGE_MPS: [f64; 2] = [18.0 / 3.6, 130.0 / 3.6];

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

/// Sets the mass relative to the class at the class's brake force: above 1, deceleration falls as 1 / load; below 1,
/// the tyres limit it to that of the class.
pub(super) fn apply_load(vehicle: &mut VehicleSpec, load: f64) {
    vehicle.mass_kg = Some(load * vehicle.class.mass_kg());
    vehicle.max_brake_mps2 = Some(vehicle.class.max_brake_mps2() / load.max(1.0));
}

/// Reduces accelerations so that the speed at the end of each piece stays within [`CRUISE_SPEED_RANGE_MPS`], or does
/// not leave it further. A reduced acceleration stays within all limits that the original one satisfies.
pub(super) fn apply_cruise(vehicle: &mut VehicleSpec, wanted_mps2: &[f64], until_s: f64) {
    let mut speed_mps = vehicle.speed_mps;
    let Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration { from_s, accel_mps2 })) =
        &mut vehicle.driver
    else {
        return;
    };
    let [lowest_mps, highest_mps] = CRUISE_SPEED_RANGE_MPS;
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
