//! A shielded controller never hits the vehicle ahead, whatever that vehicle does within its brake limit.

use crumple_sim::control::{
    BuiltInController, ControllerSource, ErrorBounds, IntoSource, ShieldSettings, ViabilityKernel,
};
use crumple_sim::engine::{
    Outcome, RecordingLevel, Run, RunError, RunOptions, ShieldRefusal, ShieldedSource,
    SimulationResult, simulate, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, LeadProfile, PiecewiseAcceleration, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use std::sync::Arc;

use crate::generate::{scenario_spec, with_cases};

/// An arbitrary leader, and a vehicle under test that can just avoid it.
#[derive(Debug, Clone)]
struct Chase {
    classes: [VehicleClass; 2],
    speeds_mps: [f64; 2],
    /// Gap in addition to the demanded one.
    spare_m: f64,
    friction: f64,
    delay_s: f64,
    lag_s: f64,
    leader: PiecewiseAcceleration,
    seed: u64,
}

/// Mostly hard braking and full acceleration, in pieces of a few steps to a second.
fn any_leader() -> impl Strategy<Value = PiecewiseAcceleration> {
    let action = prop_oneof![3 => Just(0.0_f64), 1 => Just(1.0_f64), 2 => 0.0..1.0_f64];
    let pieces = prop::collection::vec((prop_oneof![1..100_u32, 1..8_u32], action), 1..16);
    pieces.prop_map(|pieces| {
        let (mut from_s, mut accel_mps2) = (vec![0.0], vec![0.0]);
        for (steps, share) in pieces {
            from_s.push(from_s.last().unwrap() + 0.01 * f64::from(steps));
            // Every class can do this; the shield must expect the leader's limits.
            accel_mps2.push(-6.0 + 7.5 * share);
        }
        PiecewiseAcceleration { from_s, accel_mps2 }
    })
}

prop_compose! {
    fn chase(sluggish: bool)(
        classes in prop::array::uniform2(prop::sample::select(VehicleClass::ALL.to_vec())),
        speeds_mps in prop::array::uniform2(prop_oneof![4 => 0.0..35.0_f64, 1 => Just(0.0)]),
        spare_m in prop_oneof![Just(1e-4), 1e-4..0.1_f64, 0.0..30.0_f64],
        friction in prop_oneof![Just(1.0), 0.1..1.0_f64],
        (delay_s, lag_s) in (prop_oneof![Just(0.0), 0.0..0.5_f64], prop_oneof![Just(0.0), 0.01..0.6_f64]),
        leader in any_leader(),
        at_limit in any::<bool>(),
        seed in 0..1_u64 << 40,
    ) -> Chase {
        let mut leader = leader;
        if at_limit {
            for a in leader.accel_mps2.iter_mut().filter(|a| **a == -6.0) {
                *a = -classes[0].max_brake_mps2();
            }
        }
        let (delay_s, lag_s) = if sluggish { ((delay_s * 100.0_f64).round() / 100.0, lag_s) } else { (0.0, 0.0) };
        Chase { classes, speeds_mps, spare_m, friction, delay_s, lag_s, leader, seed }
    }
}

impl Chase {
    /// Returns the gap from which a collision can just be avoided: the vehicle coasts for the delay, and the lag costs
    /// speed.
    fn demanded_gap_m(&self) -> f64 {
        let [ahead, own] = self
            .classes
            .map(|class| class.max_brake_mps2() * self.friction);
        let [w, v] = self.speeds_mps;
        let kernel = ViabilityKernel {
            own_brake_mps2: own,
            ahead_brake_mps2: ahead,
        };
        let until_s = self.delay_s.min(w / ahead);
        let covered_m = w * until_s - 0.5 * ahead * until_s * until_s;
        let later_mps = w - ahead * until_s;
        self.delay_s * v - covered_m + kernel.demanded_gap_m(v + self.lag_s * own, later_mps)
    }

    fn scenario(&self) -> Scenario {
        let gap_m = self.demanded_gap_m().max(0.0) + self.spare_m;
        let [ahead, own] = self.classes;
        let profile = Driver::Profile(LeadProfile::Pieces(self.leader.clone()));
        let mut vehicles = vec![
            VehicleSpec::new(ahead, 1000.0, self.speeds_mps[0], profile),
            VehicleSpec::new(
                own,
                1000.0 - ahead.length_m() - gap_m,
                self.speeds_mps[1],
                Driver::UnderTest,
            ),
        ];
        vehicles[1].reaction_delay_s = self.delay_s;
        vehicles[1].actuator_lag_s = self.lag_s;
        let spec = ScenarioSpec {
            seed: self.seed,
            environment: crumple_sim::scenario::Environment {
                friction: self.friction,
            },
            ..scenario_spec("chase", 0.01, 15.0, vehicles)
        };
        Scenario::new(spec).unwrap()
    }
}

fn with_shield(
    controller: Arc<dyn ControllerSource>,
    settings: ShieldSettings,
) -> Arc<dyn ControllerSource> {
    ShieldedSource {
        controller,
        settings: settings.into(),
    }
    .into_source()
}

fn full_throttle() -> Arc<dyn ControllerSource> {
    BuiltInController::FullThrottle(Default::default()).into_source()
}

fn shielded_full_throttle() -> Arc<dyn ControllerSource> {
    with_shield(full_throttle(), ShieldSettings::default())
}

fn drivers() -> [Arc<dyn ControllerSource>; 3] {
    [
        full_throttle(),
        BuiltInController::RandomActions(Default::default()).into_source(),
        BuiltInController::Policy(Default::default()).into_source(),
    ]
}

fn simulate_with_truth(
    scenario: &Scenario,
    controller: Arc<dyn ControllerSource>,
) -> SimulationResult {
    let options = RunOptions::new(controller).with_estimator(EstimatorKind::Truth);
    simulate(
        &Run::new(scenario, options).unwrap(),
        RecordingLevel::Summary,
    )
}

proptest! {
    #![proptest_config(with_cases(192))]

    /// With the true state, no vehicle collides and the state never leaves the kernel, with and without delay and lag.
    #[test]
    fn no_shielded_controller_hits_its_leader(chases in [chase(false), chase(true)]) {
        for scenario in chases.iter().map(Chase::scenario) {
            for driver in drivers() {
                let result = simulate_with_truth(&scenario, with_shield(driver, ShieldSettings::default()));
                prop_assert_eq!(result.outcome, Outcome::NoCollision);
                prop_assert!(result.interventions.iter().all(|intervention| !intervention.outside_kernel));
            }
        }
    }

    /// Noise up to six standard deviations and every manoeuvre are within the shield's bounds of the filter error.
    #[test]
    fn no_shielded_controller_hits_its_leader_with_the_kalman_filter(chase in chase(false)) {
        let scenario = chase.scenario();
        for driver in drivers() {
            let options = RunOptions::new(with_shield(driver, ShieldSettings::default()));
            let result = simulate(&Run::new(&scenario, options).unwrap(), RecordingLevel::Summary);
            prop_assert_eq!(result.outcome, Outcome::NoCollision);
        }
    }

    /// Expecting harder braking of the vehicle ahead is also safe.
    #[test]
    fn a_cautious_assumption_is_safe_too(chase in chase(false), more_mps2 in 0.0..5.0_f64) {
        let settings = ShieldSettings {
            ahead_brake_mps2: Some(chase.classes[0].max_brake_mps2() + more_mps2),
            errors: Some(ErrorBounds { gap_m: 0.2, speed_mps: 0.1, ahead_speed_mps: 0.3 }),
        };
        let controller = with_shield(full_throttle(), settings);
        let result = simulate_with_truth(&chase.scenario(), controller);
        prop_assert_eq!(result.outcome, Outcome::NoCollision);
    }

    /// A controller that never brakes brakes exactly when its shield intervenes.
    #[test]
    fn interventions_are_reported_step_by_step(chase in chase(false)) {
        let scenario = chase.scenario();
        let driver = shielded_full_throttle();
        let options = RunOptions::new(driver).with_estimator(EstimatorKind::Truth);
        let result = simulate(&Run::new(&scenario, options).unwrap(), RecordingLevel::Trace);
        let trace = result.trace.unwrap();
        for (k, at_s) in trace.time_s.iter().enumerate().take(scenario.steps()) {
            let mut interventions = result.interventions.iter();
            let acts = interventions.any(|span| span.from_s < at_s + 1e-6 && *at_s < span.to_s - 1e-6);
            let accel_mps2 = trace.vehicles[1].acceleration_mps2[k];
            prop_assert_eq!(accel_mps2 <= 0.0, acts, "{} m/s² at {} s: {:?}", accel_mps2, at_s, result.interventions);
        }
    }

    #[test]
    fn engines_agree_about_shields(chases in prop::collection::vec(chase(true), 2..6)) {
        let scenarios: Vec<_> = chases.iter().map(Chase::scenario).collect();
        for driver in drivers() {
            let options = RunOptions::new(with_shield(driver, ShieldSettings::default()));
            let runs: Vec<_> = scenarios.iter().map(|s| Run::new(s, options.clone()).unwrap()).collect();
            let together = simulate_batch(&runs, RecordingLevel::Trace, |_, result| result);
            for (run, result) in runs.iter().zip(together) {
                prop_assert_eq!(&simulate(run, RecordingLevel::Trace), &result);
            }
        }
    }
}

fn draw_chases(count: usize) -> impl Iterator<Item = Chase> {
    let mut runner = TestRunner::deterministic();
    (0..count).map(move |_| chase(false).new_tree(&mut runner).unwrap().current())
}

#[test]
fn without_a_shield_drivers_hit_the_vehicle_ahead() {
    let scenarios: Vec<_> = draw_chases(200).map(|chase| chase.scenario()).collect();
    let collisions = drivers().map(|driver| {
        let hits = scenarios
            .iter()
            .filter(|s| simulate_with_truth(s, driver.clone()).outcome != Outcome::NoCollision);
        hits.count()
    });
    assert!(
        collisions[0] > 150 && collisions[1] > 50 && collisions[2] > 5,
        "{collisions:?} of 200"
    );
}

/// A million scenarios per controller: `SHIELD_RUNS=1000000 cargo test --release --test suite -- --ignored a_campaign
/// --nocapture`.
#[test]
#[ignore = "a campaign, not a test: minutes"]
fn a_campaign() {
    let runs: usize = std::env::var("SHIELD_RUNS")
        .ok()
        .and_then(|runs| runs.parse().ok())
        .unwrap_or(10_000);
    let names = ["full-throttle", "random-actions", "policy"];
    let mut draws = draw_chases(runs);
    let (mut hits, mut bare_hits, mut overridden) = ([0; 3], [0; 3], [0; 3]);
    loop {
        let scenarios: Vec<_> = draws
            .by_ref()
            .take(10_000)
            .map(|chase| chase.scenario())
            .collect();
        if scenarios.is_empty() {
            break;
        }
        for (index, driver) in drivers().into_iter().enumerate() {
            for (controller, hits) in [
                (
                    with_shield(driver.clone(), ShieldSettings::default()),
                    &mut hits[index],
                ),
                (driver, &mut bare_hits[index]),
            ] {
                let options = RunOptions::new(controller).with_estimator(EstimatorKind::Truth);
                let runs: Vec<_> = scenarios
                    .iter()
                    .map(|s| Run::new(s, options.clone()).unwrap())
                    .collect();
                let done = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
                    (
                        result.outcome != Outcome::NoCollision,
                        !result.interventions.is_empty(),
                    )
                });
                *hits += done.iter().filter(|(hit, _)| *hit).count();
                overridden[index] += done.iter().filter(|(_, overridden)| *overridden).count();
            }
        }
    }
    for (index, name) in names.into_iter().enumerate() {
        let (hits, bare, overridden) = (hits[index], bare_hits[index], overridden[index]);
        println!(
            "{name}: {hits} collisions of {runs} with the shield ({overridden} with interventions), {bare} without"
        );
    }
    assert_eq!(hits, [0; 3]);
}

#[test]
fn unsupported_shields_are_refused() {
    let scenario = draw_chases(1).next().unwrap().scenario();
    let refusal = |change: &dyn Fn(&mut ScenarioSpec)| {
        let changed = scenario.edited(|spec| change(spec)).unwrap();
        let options = RunOptions::new(shielded_full_throttle());
        match Run::new(&changed, options) {
            Err(RunError::Shield {
                vehicle: 1,
                refusal: why,
            }) => why,
            _ => panic!("not refused"),
        }
    };
    assert_eq!(
        refusal(&|spec| spec.vehicles[1].jerk_limit_mps3 = Some(10.0)),
        ShieldRefusal::JerkLimit
    );
    assert_eq!(
        refusal(&|spec| spec.sensors.dropout = 0.1),
        ShieldRefusal::Dropout
    );
    let noisy = refusal(&|spec| spec.vehicles[1].acceleration_noise_mps2 = 2.0);
    assert!(matches!(noisy, ShieldRefusal::Noise { .. }));
}

/// The vehicle behind needs only its reaction time and its stopping distance.
#[test]
fn a_vehicle_far_behind_is_no_conflict() {
    let conflict = |behind_m: f64, speed_mps: f64| {
        let scenario = crumple_sim::scenario::built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| {
                spec.vehicles[2].position_m = spec.vehicles[1].position_m - behind_m;
                spec.vehicles[2].speed_mps = speed_mps;
                (
                    spec.vehicles[2].reaction_delay_s,
                    spec.vehicles[2].actuator_delay_s,
                ) = (0.3, 0.1);
            });
        let result = simulate_with_truth(&scenario.unwrap(), shielded_full_throttle());
        assert!(!result.interventions.is_empty());
        result
            .interventions
            .iter()
            .any(|intervention| intervention.rear_conflict)
    };
    assert!(conflict(10.0, 25.0) && !conflict(250.0, 8.0));
}

/// The filter error grows with the acceleration of the vehicle ahead, and noise may make it brake harder.
#[test]
fn a_livelier_vehicle_ahead_is_kept_farther_away() {
    let first_s = |accel_mps2: f64, noise_mps2: f64| {
        let scenario = crumple_sim::scenario::built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| {
                spec.vehicles[0].max_accel_mps2 = Some(accel_mps2);
                spec.vehicles[0].acceleration_noise_mps2 = noise_mps2;
                spec.vehicles[1].position_m -= 30.0;
                spec.vehicles.truncate(2);
            });
        let settings = ShieldSettings {
            ahead_brake_mps2: Some(6.0),
            errors: None,
        };
        let options = RunOptions::new(with_shield(full_throttle(), settings));
        let scenario = scenario.unwrap();
        let result = simulate(
            &Run::new(&scenario, options).unwrap(),
            RecordingLevel::Summary,
        );
        result
            .interventions
            .first()
            .expect("it has to brake")
            .from_s
    };
    let (calm_s, lively_s, noisy_s) = (first_s(1.0, 0.0), first_s(8.0, 0.0), first_s(1.0, 0.2));
    assert!(
        lively_s < calm_s && noisy_s < calm_s,
        "{lively_s} {noisy_s} {calm_s}"
    );
}
