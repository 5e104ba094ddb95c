//! Tests of vehicles after an impact, and of drivers who perceive the true state.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use proptest::prelude::*;

use super::{
    AfterCollision, HELD_BRAKE_MPS2, RecordingLevel, Run, RunOptions, SimulationResult, Track,
    simulate, simulate_batch,
};
use crate::control::{
    BuiltInController, Controller, ControllerFailure, ControllerSource, Ego, IntoSource,
    ShieldKind, ShieldSettings, ShieldedSource, TestDriverSettings, TestDriverSource,
    TwoSidedSettings, stateless,
};
use crate::observation::{EstimatorKind, Observation};
use crate::scenario::{
    Driver, GhostObject, LeadProfile, Scenario, SensorFaults, built_in_scenario,
};

const ESTIMATORS: [EstimatorKind; 2] = EstimatorKind::ALL;
/// Largest braking of the vehicle under test on a dry road, in m/s².
const MAX_BRAKE_MPS2: f64 = 7.5;

/// Returns a leader at constant speed, a car under test at `speed_mps`, and a lorry that never brakes.
fn scenario(leader_mps: f64, speed_mps: f64, gaps_m: [f64; 2], friction: f64) -> Scenario {
    let never = BuiltInController::parse("emergency-brake,ttc_s=0").unwrap();
    built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| {
            spec.environment.friction = friction;
            let [leader, ego, follower] = &mut spec.vehicles[..] else {
                panic!("three vehicles")
            };
            leader.driver = Driver::Profile(LeadProfile::ConstantSpeed);
            follower.driver = Driver::Controller(never.unwrap());
            leader.speed_mps = leader_mps;
            (ego.speed_mps, follower.speed_mps) = (speed_mps, speed_mps);
            ego.position_m = leader.position_m - leader.length_m() - gaps_m[0];
            follower.position_m = ego.position_m - ego.length_m() - gaps_m[1];
        })
        .unwrap()
}

/// Simulates with both engines, which agree.
fn traced(scenario: &Scenario, options: &RunOptions) -> SimulationResult {
    let runs = [Run::new(scenario, options.clone()).unwrap()];
    let result = simulate(&runs[0], RecordingLevel::Trace);
    let batch = simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| simulated);
    // Not `assert_eq`, which would print whole traces.
    for (vehicle, (own, other)) in tracks(&result).zip(tracks(&batch[0])).enumerate() {
        let differs = own.acceleration_mps2.iter().zip(&other.acceleration_mps2);
        let first = differs.clone().position(|(own, other)| own != other);
        assert_eq!(
            first,
            None,
            "vehicle {vehicle}: {:?}",
            first.and_then(|step| differs.clone().nth(step))
        );
    }
    assert!(batch[0] == result);
    result
}

fn tracks(result: &SimulationResult) -> impl Iterator<Item = &Track> {
    result.trace.iter().flat_map(|trace| &trace.vehicles)
}

/// Returns the first step after the impact of vehicle `rear` with its leader, and the number of steps until the next
/// impact.
fn steps_after_impact(result: &SimulationResult, rear: usize) -> std::ops::Range<usize> {
    let time_s = |index: usize| result.trace.as_ref().unwrap().time_s[index];
    let count = result.trace.as_ref().unwrap().time_s.len() - 1;
    let impact = (0..)
        .zip(&result.impacts)
        .find(|(_, impact)| impact.collision.rear_vehicle == rear)
        .unwrap();
    let first_s = impact.1.collision.time_s;
    let next_s = result
        .impacts
        .get(impact.0 + 1)
        .map_or(f64::INFINITY, |next| next.collision.time_s);
    let first = (0..count)
        .find(|&step| time_s(step) >= first_s)
        .unwrap_or(count);
    let last = (first..count)
        .find(|&step| time_s(step + 1) > next_s)
        .unwrap_or(count);
    first..last
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// After it has hit its leader, every built-in controller holds its brake to standstill, or coasts, and never
    /// changes between the two; the leader is a script without braking, so that both have half the force.
    #[test]
    fn a_vehicle_that_has_hit_its_leader_does_what_the_setting_says(
        controller in prop::sample::select(BuiltInController::all()),
        estimator in prop::sample::select(ESTIMATORS.to_vec()),
        leader_mps in 1.0..10.0,
        closing_mps in 12.0..20.0,
        gap_m in 0.5..3.0,
        gap_behind_m in 20.0..60.0,
        friction in 0.3..1.0,
        holds in any::<bool>(),
    ) {
        let line = scenario(leader_mps, leader_mps + closing_mps, [gap_m, gap_behind_m], friction);
        let after = if holds { AfterCollision::Hold } else { AfterCollision::Coast };
        let options = RunOptions::new(controller).with_estimator(estimator).with_after_collision(after);
        let result = traced(&line, &options);
        prop_assert!(result.impacts[0].involves(0));
        let track = &result.trace.as_ref().unwrap().vehicles[1];
        let held_mps2 = HELD_BRAKE_MPS2.min(MAX_BRAKE_MPS2 * friction);
        for step in steps_after_impact(&result, 1) {
            let expected_mps2 = if holds && track.speed_mps[step] > 0.0 { -0.5 * held_mps2 } else { 0.0 };
            prop_assert!((track.acceleration_mps2[step] - expected_mps2).abs() < 1e-9, "step {step}");
        }
    }
}

/// The references of the study: neither brakes before its impact. Then one stands, and the other drives on.
#[test]
fn a_vehicle_without_a_brake_holds_or_coasts_after_its_impact() {
    let line = scenario(5.0, 25.0, [20.0, 60.0], 1.0);
    let never = BuiltInController::parse("emergency-brake,ttc_s=0")
        .unwrap()
        .unwrap();
    for (after, last_mps) in [(AfterCollision::Hold, 0.0), (AfterCollision::Coast, 15.0)] {
        for estimator in ESTIMATORS {
            let options = RunOptions::new(never.clone())
                .with_estimator(estimator)
                .with_after_collision(after);
            let only_two = line
                .edited(|spec| {
                    spec.vehicles.pop();
                })
                .unwrap();
            let result = traced(&only_two, &options);
            let track = &result.trace.as_ref().unwrap().vehicles[1];
            let first = steps_after_impact(&result, 1).start;
            assert!(
                track.acceleration_mps2[..first - 1]
                    .iter()
                    .all(|&a_mps2| a_mps2 == 0.0)
            );
            assert!((track.speed_mps.last().unwrap() - last_mps).abs() < 1e-9);
        }
    }
}

/// Before it hits its leader, a vehicle that was hit from behind decides on, without the follower.
#[test]
fn a_vehicle_does_not_observe_a_follower_that_has_hit_it() {
    let line = scenario(20.0, 20.0, [60.0, 5.0], 1.0)
        .edited(|spec| spec.vehicles[2].speed_mps = 25.0)
        .unwrap();
    let controller = stateless(|observation| match observation.behind {
        Some(_) => -0.1,
        None => -0.2,
    });
    for estimator in ESTIMATORS {
        for (after, expected_mps2) in [
            (AfterCollision::Continue, [-0.1, -0.1]),
            (AfterCollision::Hold, [-0.1, -0.2]),
        ] {
            let options = RunOptions::new(controller.clone().into_source())
                .with_estimator(estimator)
                .with_after_collision(after);
            let result = traced(&line, &options);
            assert_eq!(result.impacts[0].collision.rear_vehicle, 2);
            let track = &result.trace.as_ref().unwrap().vehicles[1];
            let step = steps_after_impact(&result, 2).start + 10;
            let lorry_mps2 = match after {
                AfterCollision::Hold => -6.0,
                _ => 0.0,
            };
            let shared_mps2 = (1500.0 * expected_mps2[1] + 15_000.0 * lorry_mps2) / 16_500.0;
            assert_eq!(track.acceleration_mps2[0], expected_mps2[0]);
            assert!((track.acceleration_mps2[step] - shared_mps2).abs() < 1e-9);
        }
    }
}

/// A source that the engines do not know.
struct Unknown(BuiltInController);

impl ControllerSource for Unknown {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        self.0.start(ego, seed)
    }
}

/// A human perceives the true state: sensors and filter change nothing, also behind other types of controllers.
#[test]
fn a_human_under_test_drives_alike_with_both_estimators() {
    for seed in 0..20_u64 {
        let lead_mps2 = 1.0 + 0.3 * seed as f64;
        let line = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| {
                spec.seed = seed;
                spec.sensors.gap_noise_m = 0.5;
                spec.vehicles[0].driver =
                    Driver::Profile(LeadProfile::Brake(crate::scenario::Brake {
                        onset_s: 1.0,
                        rate_mps2: lead_mps2,
                    }));
            })
            .unwrap();
        let human = BuiltInController::from_name("human").unwrap();
        let expected = traced(
            &line,
            &RunOptions::new(human.clone()).with_estimator(EstimatorKind::Truth),
        );
        let sources: [Arc<dyn ControllerSource>; 2] =
            [human.clone().into_source(), Arc::new(Unknown(human))];
        for source in sources {
            assert_eq!(
                traced(&line, &RunOptions::new(source)),
                expected,
                "seed {seed}"
            );
        }
    }
}

/// The emergency brake of a human's car observes through the sensors: it brakes for a ghost that the human ignores.
#[test]
fn the_brake_of_a_human_observes_through_the_sensors() {
    let ghost = GhostObject {
        onset_s: 2.0,
        duration_s: 1.0,
        gap_m: 8.0,
        speed_mps: 0.0,
    };
    let line = scenario(25.0, 25.0, [60.0, 60.0], 1.0)
        .edited(|spec| {
            spec.sensors.faults = SensorFaults {
                ghost: Some(ghost),
                ..SensorFaults::default()
            };
        })
        .unwrap();
    for (name, brakes) in [("human", false), ("human,aeb_ttc_s=1.4", true)] {
        let human = BuiltInController::parse(name).unwrap().unwrap();
        let result = traced(&line, &RunOptions::new(human));
        assert_eq!(result.vehicles[1].max_brake_mps2 > 5.0, brakes, "{name}");
    }
}

/// Counts its decisions without and with the true state.
#[derive(Clone, Default)]
struct PerceptionProbe {
    has_perceived: bool,
    decisions: Arc<[AtomicUsize; 2]>,
}

impl Controller for PerceptionProbe {
    fn decide(&mut self, _observation: &Observation) -> Result<f64, ControllerFailure> {
        let has_perceived = std::mem::take(&mut self.has_perceived);
        self.decisions[usize::from(has_perceived)].fetch_add(1, Ordering::Relaxed);
        Ok(0.0)
    }

    fn perceive(&mut self, _truth: &Observation) {
        self.has_perceived = true;
    }
}

impl ControllerSource for PerceptionProbe {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(self.clone()))
    }
}

/// Returns a probe, alone, behind each shield, and under the test driver.
fn wrapped_probes(probe: &PerceptionProbe) -> [Arc<dyn ControllerSource>; 4] {
    let probe: Arc<dyn ControllerSource> = Arc::new(probe.clone());
    let shielded = |settings| ShieldedSource {
        controller: probe.clone(),
        settings,
    };
    [
        probe.clone(),
        Arc::new(shielded(ShieldKind::Ahead(ShieldSettings::default()))),
        Arc::new(shielded(ShieldKind::BothSides(TwoSidedSettings::default()))),
        Arc::new(TestDriverSource {
            controller: probe.clone(),
            settings: TestDriverSettings::default(),
        }),
    ]
}

/// Shields and the test driver pass the true state on to their controller before each of its decisions.
#[test]
fn a_controller_around_another_one_passes_the_true_state_on() {
    let line = scenario(20.0, 20.0, [80.0, 80.0], 1.0);
    for index in 0..4 {
        for estimator in ESTIMATORS {
            let probe = PerceptionProbe::default();
            let source = wrapped_probes(&probe)[index].clone();
            traced(&line, &RunOptions::new(source).with_estimator(estimator));
            let [without, with] = [0, 1].map(|kind| probe.decisions[kind].load(Ordering::Relaxed));
            let (expected, other) = match estimator {
                EstimatorKind::Kalman => (with, without),
                EstimatorKind::Truth => (without, with),
            };
            assert!(expected > 100, "source {index}, {estimator:?}: {expected}");
            assert_eq!(other, 0, "source {index}, {estimator:?}");
        }
    }
}
