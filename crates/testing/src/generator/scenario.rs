//! Generation of valid scenarios as variations of the paper's.

use arbitrary::Unstructured;

use super::choices::Choices;
use super::driver::{DRIVER_BYTES, make_scripted, read_driver};
use super::shape::{MAX_VEHICLES, ScenarioShape};
use crumple_sim::scenario::{
    Driver, Environment, GhostObject, InvalidField, LeadProfile, SCENARIO_VERSION, Scenario,
    ScenarioSpec, SensorFaults, Sensors, VehicleClass, VehicleSpec, whole_multiple,
};

const ROAD_BYTES: usize = 24;
const DRIVE_BYTES: usize = 6 + DRIVER_BYTES;
const BODY_BYTES: usize = 32;

/// Bytes of a scenario, including its shape.
pub const SCENARIO_BYTES: usize =
    ScenarioShape::BYTES + ROAD_BYTES + MAX_VEHICLES * (DRIVE_BYTES + BODY_BYTES);

const DURATION_S: f64 = 15.0;
const SPEED_MPS: f64 = 25.0;
const GAP_M: f64 = 16.0;

/// Reads a valid scenario; no bytes give the paper's scenario 1. Every field has a fixed place in the bytes, so that a
/// change of a byte is a change of a field. Order: shape; duration, road and noise; gaps, speeds and drivers; bodies of
/// the vehicles.
pub fn read_scenario(from: &mut Unstructured<'_>) -> Scenario {
    let shape = ScenarioShape::read(from);
    read_scenario_of_shape(&shape, from)
}

/// Reads a valid scenario of a shape.
#[expect(
    clippy::expect_used,
    reason = "valid by construction: a failure is a defect of this module, and tests look for it"
)]
pub fn read_scenario_of_shape(shape: &ScenarioShape, from: &mut Unstructured<'_>) -> Scenario {
    let mut road = Choices::read_block(from, ROAD_BYTES);
    let mut drives = Choices::read_block(from, MAX_VEHICLES * DRIVE_BYTES);
    let mut bodies = Choices::read_block(from, MAX_VEHICLES * BODY_BYTES);
    let count = shape.drivers.len();
    let vehicles = shape.drivers.iter().enumerate().map(|(index, &kind)| {
        let mut drive = drives.read_sub_block(DRIVE_BYTES);
        let mut body = bodies.read_sub_block(BODY_BYTES);
        let motion = read_motion(&mut drive);
        let mut vehicle = read_vehicle(nominal_class(index, count), motion, &mut body);
        match read_driver(kind, &mut drive) {
            Driver::Profile(profile) => make_scripted(&mut vehicle, profile),
            driver => vehicle.driver = driver,
        }
        vehicle
    });
    let vehicles = vehicles.collect();
    Scenario::new(scenario_spec(shape.step_s, vehicles, &mut road)).expect("valid by construction")
}

/// Returns the scenario with its step reduced to the longest divisor of a decision interval.
///
/// # Errors
/// [`InvalidField`] if no scenario may have that step.
pub fn with_compatible_step(
    scenario: &Scenario,
    interval_s: f64,
) -> Result<Scenario, InvalidField> {
    let step_s = scenario.spec().step_s;
    if whole_multiple(interval_s, step_s).is_some() {
        return Ok(scenario.clone());
    }
    let step_s = interval_s / (interval_s / step_s).ceil();
    scenario.edited(|spec| {
        spec.duration_s = (spec.duration_s / step_s).round().max(1.0) * step_s;
        spec.step_s = step_s;
    })
}

/// Builds the specification; each vehicle's position is relative to its leader until here.
fn scenario_spec(
    step_s: f64,
    mut vehicles: Vec<VehicleSpec>,
    choices: &mut Choices<'_>,
) -> ScenarioSpec {
    // Most scenarios are much shorter than the paper's: they cost less, and events happen early.
    let steps = (DURATION_S / step_s * (1.0 - choices.up_to(1.0)).powi(3))
        .round()
        .max(1.0);
    let friction = choices
        .optional(85, |choices| choices.around(1.0, [0.05, 1.0]))
        .unwrap_or(1.0);
    let mut sensors = read_sensor_noise(choices);
    let seed = choices.seed();
    let to_rear_m: f64 = vehicles
        .iter()
        .skip(1)
        .map(|vehicle| vehicle.position_m)
        .sum();
    let lengths_m: f64 = vehicles
        .iter()
        .rev()
        .skip(1)
        .map(VehicleSpec::length_m)
        .sum();
    let rear_m = choices.around(0.0, [-1e4, 1e4]);
    sensors.faults = read_faults(choices, steps * step_s);
    place_vehicles(&mut vehicles, rear_m + to_rear_m + lengths_m);
    ScenarioSpec {
        version: SCENARIO_VERSION,
        name: "test_case".to_owned(),
        about: String::new(),
        duration_s: steps * step_s,
        step_s,
        seed,
        environment: Environment { friction },
        sensors,
        vehicles,
    }
}

/// Reads noise and dropouts of sensors without faults.
fn read_sensor_noise(choices: &mut Choices<'_>) -> Sensors {
    let nominal = Sensors::default();
    Sensors {
        position_noise_m: choices.around(nominal.position_noise_m, [0.0, 0.2]),
        gap_noise_m: choices.around(nominal.gap_noise_m, [0.0, 0.2]),
        dropout: match choices.byte() {
            0..160 => 0.0,
            160..176 => 1.0,
            176.. => choices.up_to(0.5),
        },
        faults: SensorFaults::default(),
    }
}

/// Reads the faults of the gap sensors from two bytes: their size, and a bit for each fault.
fn read_faults(choices: &mut Choices<'_>, duration_s: f64) -> SensorFaults {
    let size = f64::from(choices.byte().saturating_sub(160)) / 95.0;
    let kinds = if size > 0.0 { choices.byte() } else { 0 };
    let faults = FaultChoice { kinds, size };
    SensorFaults {
        latency_s: faults.size_of(0, 0.5),
        gap_bias_m: faults.size_of(1, 3.0) - faults.size_of(7, 6.0),
        gap_resolution_m: faults.size_of(2, 2.0),
        outage_rate_per_s: faults.size_of(3, 5.0),
        outage_length_s: faults.size_of(3, 1.0),
        range_m: faults.has(4).then_some(1.0 + GAP_M * (1.0 - size)),
        detection_delay_s: faults.size_of(5, 1.0),
        ghost: faults.has(6).then_some(GhostObject {
            onset_s: 0.2 * duration_s,
            duration_s: faults.size_of(6, 0.5 * duration_s),
            gap_m: 0.1 + faults.size_of(6, GAP_M),
            speed_mps: SPEED_MPS * (1.0 - size),
        }),
    }
}

/// Faults of the gap sensors: a bit for each, and their size as a share of the largest.
struct FaultChoice {
    kinds: u8,
    size: f64,
}

impl FaultChoice {
    fn has(&self, bit: u8) -> bool {
        self.kinds >> bit & 1 == 1
    }

    fn size_of(&self, bit: u8, most: f64) -> f64 {
        if self.has(bit) { most * self.size } else { 0.0 }
    }
}

/// Converts each position but the first from a gap into a position on the road, behind a leader at `leader_m`.
pub(crate) fn place_vehicles(vehicles: &mut [VehicleSpec], leader_m: f64) {
    let mut rear_bumper_m = None;
    for vehicle in vehicles {
        vehicle.position_m =
            rear_bumper_m.map_or(leader_m, |rear_bumper_m| rear_bumper_m - vehicle.position_m);
        rear_bumper_m = Some(vehicle.position_m - vehicle.length_m());
    }
}

/// Gap of a vehicle to its leader, and its speed.
struct InitialMotion {
    gap_m: f64,
    speed_mps: f64,
}

fn read_motion(choices: &mut Choices<'_>) -> InitialMotion {
    let gap_m = choices.around(GAP_M, [0.01, 40.0]);
    let speed_mps = choices.around(SPEED_MPS, [0.0, 45.0]);
    let close_m = choices.byte();
    let gap_m = if close_m > 212 { 0.05 * gap_m } else { gap_m };
    let stands = choices.chance(42);
    InitialMotion {
        gap_m: gap_m.max(0.01),
        speed_mps: if stands { 0.0 } else { speed_mps },
    }
}

fn nominal_class(index: usize, count: usize) -> VehicleClass {
    if count > 2 && index + 1 == count {
        VehicleClass::Heavy
    } else {
        VehicleClass::Light
    }
}

/// Reads a vehicle; its position is still the gap to its leader.
fn read_vehicle(
    nominal: VehicleClass,
    motion: InitialMotion,
    choices: &mut Choices<'_>,
) -> VehicleSpec {
    let alternative = if nominal == VehicleClass::Heavy {
        VehicleClass::Light
    } else {
        VehicleClass::Heavy
    };
    let class = choices.choose(&[nominal, alternative]).unwrap_or(nominal);
    VehicleSpec {
        length_m: choices.optional(77, |choices| choices.around(class.length_m(), [0.5, 30.0])),
        mass_kg: choices.optional(77, |choices| {
            choices.around(class.mass_kg(), [500.0, 40_000.0])
        }),
        max_brake_mps2: choices.optional(77, |choices| {
            choices.around(class.max_brake_mps2(), [2.0, 12.0])
        }),
        max_accel_mps2: choices.optional(77, |choices| {
            choices.around(class.max_accel_mps2(), [0.0, 6.0])
        }),
        acceleration_noise_mps2: choices
            .optional(85, |choices| choices.up_to(1.0))
            .unwrap_or_default(),
        reaction_delay_s: read_delay_s(choices),
        actuator_delay_s: read_delay_s(choices),
        actuator_lag_s: read_delay_s(choices),
        jerk_limit_mps3: choices.optional(77, |choices| choices.around(10.0, [1.0, 50.0])),
        ..VehicleSpec::new(
            class,
            motion.gap_m,
            motion.speed_mps,
            Driver::Profile(LeadProfile::ConstantSpeed),
        )
    }
}

fn read_delay_s(choices: &mut Choices<'_>) -> f64 {
    choices
        .optional(64, |choices| choices.up_to(0.5))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::built_in_scenario;
    use proptest::prelude::*;

    #[test]
    fn no_bytes_and_zero_bytes_are_the_papers_scenario() {
        for bytes in [vec![], vec![0; 7], vec![0; SCENARIO_BYTES]] {
            let paper_1 = built_in_scenario("paper-1").unwrap();
            let named = |spec: &mut ScenarioSpec| {
                (spec.name, spec.about) = ("test_case".to_owned(), String::new())
            };
            assert_eq!(
                read_scenario(&mut Unstructured::new(&bytes)),
                paper_1.edited(named).unwrap()
            );
        }
        let five = read_scenario(&mut Unstructured::new(&[3]));
        assert_eq!(
            five.vehicles(),
            built_in_scenario("paper-3").unwrap().vehicles()
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// A byte belongs to one vehicle or to the road; a change of it leaves the others unchanged.
        #[test]
        fn a_byte_of_a_vehicle_changes_that_vehicle_only(
            bytes in prop::collection::vec(any::<u8>(), SCENARIO_BYTES),
            place in ScenarioShape::BYTES + ROAD_BYTES..SCENARIO_BYTES,
            byte in any::<u8>(),
        ) {
            let mut changed = bytes.clone();
            changed[place] = byte;
            let [before, after] = [bytes, changed].map(|bytes| read_scenario(&mut Unstructured::new(&bytes)));
            let offset = place - ScenarioShape::BYTES - ROAD_BYTES;
            let drives = MAX_VEHICLES * DRIVE_BYTES;
            let owner = if offset < drives { offset / DRIVE_BYTES } else { (offset - drives) / BODY_BYTES };
            for (index, (before, after)) in before.vehicles().iter().zip(after.vehicles()).enumerate() {
                let placed = VehicleSpec { position_m: before.position_m, ..after.clone() };
                prop_assert!(index == owner || *before == placed, "vehicle {index}, not {owner}");
            }
        }
    }
}
