//! Tests of a shield far from the origin and with small steps, and of its assumptions.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::sync::{Arc, Mutex};

use super::*;
use crate::control::{
    BuiltInController, Controller, ControllerFailure, ControllerSource, Ego, IntoSource,
    ShieldedSource,
};
use crate::engine::{
    Outcome, RecordingLevel, RunError, RunOptions, SimulationResult, Stepper, simulate,
    simulate_batch,
};
use crate::observation::{EstimatorKind, Observation};
use crate::scenario::{
    Brake, Environment, Scenario, ScenarioSpec, VehicleClass, built_in_scenario,
};
use proptest::prelude::*;

/// Two vehicles, the second under test. The leader brakes fully from `onset_s` on, until both would stand.
#[derive(Debug, Clone)]
struct FarAway {
    position_m: f64,
    classes: [VehicleClass; 2],
    speeds_mps: [f64; 2],
    friction: f64,
    step_s: f64,
    substeps: u32,
    spare_m: f64,
    onset_s: f64,
    driver: BuiltInController,
}

impl FarAway {
    /// Recreates a reported collision inside the kernel, at 1 mm/s. The change of position per step is not a multiple
    /// of the float spacing, so that rounding has the same sign in each of 40 000 steps.
    fn from_report(friction: f64, position_m: f64, classes: [VehicleClass; 2]) -> Self {
        Self {
            position_m,
            classes,
            speeds_mps: [29.7, 29.7],
            friction,
            step_s: 2e-4,
            substeps: 1,
            spare_m: 20.0,
            onset_s: 0.0,
            driver: BuiltInController::FullThrottle(Default::default()),
        }
    }

    fn brakes_mps2(&self) -> [f64; 2] {
        self.classes
            .map(|class| class.max_brake_mps2() * self.friction)
    }

    fn scenario(&self) -> Scenario {
        let ([ahead, own], [ahead_mps2, own_mps2], [w, v]) =
            (self.classes, self.brakes_mps2(), self.speeds_mps);
        let kernel = ViabilityKernel {
            own_brake_mps2: own_mps2,
            ahead_brake_mps2: ahead_mps2,
        };
        let gap_m = kernel.demanded_gap_m(v, w) + self.spare_m;
        let brake = Brake {
            onset_s: self.onset_s,
            rate_mps2: ahead.max_brake_mps2(),
        };
        let rear_m = self.position_m - ahead.length_m() - gap_m;
        let duration_s =
            self.onset_s + (w / ahead_mps2).max((v + 2.0 * self.onset_s) / own_mps2) + 2.0;
        let vehicles = vec![
            VehicleSpec::new(
                ahead,
                self.position_m,
                w,
                Driver::Profile(LeadProfile::Brake(brake)),
            ),
            VehicleSpec::new(own, rear_m, v, Driver::UnderTest),
        ];
        let duration_s = (duration_s / self.step_s).ceil() * self.step_s;
        let spec = ScenarioSpec {
            step_s: self.step_s,
            environment: Environment {
                friction: self.friction,
            },
            ..ScenarioSpec::new("far away".to_owned(), duration_s, vehicles)
        };
        Scenario::new(spec).unwrap()
    }

    fn shielded_options(&self) -> RunOptions {
        let controller = ShieldedSource {
            controller: self.driver.clone().into_source(),
            settings: ShieldSettings::default().into(),
        };
        RunOptions::new(controller.into_source()).with_estimator(EstimatorKind::Truth)
    }

    fn simulate(&self) -> SimulationResult {
        let options = self
            .shielded_options()
            .with_dt_s(self.step_s / f64::from(self.substeps));
        simulate(
            &Run::new(&self.scenario(), options).unwrap(),
            RecordingLevel::Summary,
        )
    }
}

fn check_no_collision(far: &FarAway) -> Result<(), TestCaseError> {
    let result = far.simulate();
    prop_assert_eq!(&result.outcome, &Outcome::NoCollision);
    prop_assert!(
        result
            .interventions
            .iter()
            .all(|intervention| !intervention.outside_kernel),
        "{:?}",
        result.interventions
    );
    Ok(())
}

#[test]
fn rounding_far_from_the_origin_costs_no_collision() {
    use VehicleClass::{Heavy, Light};
    let overrides = [
        FarAway {
            spare_m: 1.0,
            onset_s: 6.78,
            ..FarAway::from_report(0.6, 8e5, [Light, Heavy])
        },
        FarAway {
            spare_m: 1.0,
            onset_s: 7.0,
            ..FarAway::from_report(0.6, 8e5, [Light, Heavy])
        },
        FarAway::from_report(0.6, 8e5, [Light, Heavy]),
        FarAway::from_report(0.5, 8e5, [Light, Heavy]),
        FarAway {
            onset_s: 1.0,
            ..FarAway::from_report(0.5, 3e5, [Heavy, Light])
        },
    ];
    for far in overrides {
        for driver in BuiltInController::all() {
            check_no_collision(&FarAway {
                driver,
                ..far.clone()
            })
            .unwrap();
        }
    }
}

/// The leader may accelerate for hours, far from the origin.
#[test]
fn a_shield_is_refused_if_rounding_exceeds_the_largest_margin() {
    let far = FarAway::from_report(1.0, 0.0, [VehicleClass::Light; 2]);
    let refusal = |duration_s: f64| {
        let long = far.scenario().edited(|spec| {
            (spec.duration_s, spec.step_s) = (duration_s, 0.01);
            spec.vehicles[0].driver =
                Driver::Controller(BuiltInController::Idm(Default::default()));
        });
        Run::new(&long.unwrap(), far.shielded_options()).err()
    };
    assert!(refusal(3600.0).is_none());
    let Some(RunError::Shield {
        vehicle: 1,
        refusal: why,
    }) = refusal(20_000.0)
    else {
        panic!("not refused")
    };
    let ShieldRefusal::Rounding {
        rounding_m: half_m,
        position_m,
        max_margin_m: most_m,
    } = why
    else {
        panic!("{why}")
    };
    assert!(
        2.0 * half_m > most_m && most_m == MAX_MARGIN_M && position_m > 1e8,
        "{why}"
    );
}

#[test]
fn motion_bounds_contain_the_motion() {
    for (onset_s, bound_by_kernel) in [(2.0, false), (40.0, true)] {
        let classes = [VehicleClass::Heavy, VehicleClass::Light];
        let far = FarAway {
            onset_s,
            spare_m: 50.0,
            ..FarAway::from_report(0.6, 1e4, classes)
        };
        let scenario = far.scenario();
        let travel = |dt_s: f64| {
            let run = Run::new(&scenario, far.shielded_options().with_dt_s(dt_s)).unwrap();
            run.motion_bounds(
                0,
                &run.shield_params(1, &ShieldSettings::default()).unwrap(),
            )
        };
        let (whole, halves) = (travel(2e-4), travel(1e-4));
        assert_eq!((whole.steps, whole.substeps), (scenario.steps(), 1));
        assert_eq!((halves.steps, halves.substeps), (2 * scenario.steps(), 2));
        let duration_s = scenario.spec().duration_s;
        let farthest_m = 1e4 + 29.7 * duration_s + 15.0 + (100.0 + 60.0 * 2e-4) * 2e-4;
        assert!(
            (whole.position_m - farthest_m).abs() < 1e-9,
            "{}",
            whole.position_m
        );
        let road_m = whole.position_m - scenario.vehicles()[1].position_m;
        let (in_kernel_mps, at_all_mps) = (
            (9.0 * road_m + 1.25 * 29.7 * 29.7).sqrt(),
            29.7 + 3.0 * duration_s,
        );
        assert_eq!(in_kernel_mps < at_all_mps, bound_by_kernel);
        assert!(
            (whole.speed_mps - in_kernel_mps.min(at_all_mps)).abs() < 1e-9,
            "{}",
            whole.speed_mps
        );
    }
}

#[test]
fn motion_bounds_include_noise_and_both_ends_of_the_road() {
    let far = FarAway {
        onset_s: 2.0,
        ..FarAway::from_report(1.0, -1e4, [VehicleClass::Light; 2])
    };
    let scenario = far
        .scenario()
        .edited(|spec| spec.vehicles[0].acceleration_noise_mps2 = 0.05)
        .unwrap();
    let options = RunOptions::new(far.driver.clone()).with_estimator(EstimatorKind::Truth);
    let run = Run::new(&scenario, options).unwrap();
    let travel = run.motion_bounds(
        0,
        &run.shield_params(1, &ShieldSettings::default()).unwrap(),
    );
    let [ahead, own] = [&scenario.vehicles()[0], &scenario.vehicles()[1]];
    let spare_m = ahead.length_m() + (100.0 + 60.0 * 2e-4) * 2e-4;
    assert!(
        (travel.position_m - (spare_m - own.position_m)).abs() < 1e-9,
        "{}",
        travel.position_m
    );
    assert_eq!(travel.ahead_accel_mps2, ahead.max_accel_mps2() + 0.3);
    let near = scenario
        .edited(|spec| {
            spec.vehicles
                .iter_mut()
                .for_each(|vehicle| vehicle.position_m += 2e4)
        })
        .unwrap();
    let run = Run::new(
        &near,
        RunOptions::new(far.driver).with_estimator(EstimatorKind::Truth),
    )
    .unwrap();
    let travel = run.motion_bounds(
        0,
        &run.shield_params(1, &ShieldSettings::default()).unwrap(),
    );
    let duration_s = near.spec().duration_s;
    let farthest_m = 1e4 + (29.7 + 0.3 * duration_s) * duration_s + spare_m;
    assert!(
        (travel.position_m - farthest_m).abs() < 1e-9,
        "{} {farthest_m}",
        travel.position_m
    );
}

prop_compose! {
    fn far_away()(
        position_m in prop_oneof![-1e6..1e6_f64, 5e5..1e6_f64],
        classes in prop::array::uniform2(prop::sample::select(VehicleClass::ALL.to_vec())),
        speeds_mps in prop_oneof![
            (20.0..40.0_f64).prop_map(|both| [both, both]),
            prop::array::uniform2(prop_oneof![4 => 0.0..40.0_f64, 1 => Just(0.0)]),
        ],
        friction in prop_oneof![Just(1.0), 0.2..1.0_f64, 0.2..0.5_f64],
        step_s in prop_oneof![2 => Just(100), 1 => 10..100_u32, 1 => 1..10_u32].prop_map(|n| 0.01 / f64::from(n)),
        substeps in prop_oneof![2 => Just(1), 1 => 2..4_u32],
        spare_m in prop_oneof![Just(2e-3), 2e-3..5.0_f64],
        onset_s in 0.0..4.0_f64,
        driver in prop_oneof![
            Just(BuiltInController::FullThrottle(Default::default())),
            prop::sample::select(BuiltInController::all()),
        ],
    ) -> FarAway {
        let speeds_mps = speeds_mps.map(|speed| speed * friction.sqrt());
        FarAway { position_m, classes, speeds_mps, friction, step_s, substeps, spare_m, onset_s, driver }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 50, ..crumple_cases::with_cases(128) })]

    /// No collision occurs at any position, step size, road or controller.
    #[test]
    fn no_collision_from_inside_the_kernel_at_any_position_and_step(far in far_away()) {
        check_no_collision(&far)?;
    }
}

#[test]
fn a_shield_adds_reaction_and_actuator_delay() {
    let frame = |reaction_delay_s: f64, actuator_delay_s: f64| {
        let late = built_in_scenario("paper-1").unwrap().edited(|spec| {
            for vehicle in &mut spec.vehicles[1..] {
                (vehicle.reaction_delay_s, vehicle.actuator_delay_s) =
                    (reaction_delay_s, actuator_delay_s);
            }
        });
        let late = late.unwrap();
        let run = Run::new(
            &late,
            RunOptions::new(BuiltInController::MatchLeader(Default::default())),
        )
        .unwrap();
        run.shield_params(1, &ShieldSettings::default()).unwrap()
    };
    let frames = [(0.3, 0.1), (0.1, 0.3), (0.4, 0.0), (0.0, 0.4)]
        .map(|(seeing, acting)| frame(seeing, acting));
    assert!(frames.iter().all(|frame| *frame == frames[0]), "{frames:?}");
    assert_eq!(
        (
            frames[0].delay_steps,
            frames[0].behind.map(|behind| behind.reaction_s)
        ),
        (40, Some(0.4))
    );
}

/// Assumptions of a shield follow from the scenario; computed by hand.
#[test]
fn assumptions_match_the_scenario() {
    let scenario = |changed: &dyn Fn(&mut ScenarioSpec)| {
        let edited = built_in_scenario("paper-1").unwrap().edited(|spec| {
            spec.environment.friction = 0.5;
            for (vehicle, noise_mps2) in spec.vehicles.iter_mut().zip([0.02, 0.03, 0.0]) {
                vehicle.acceleration_noise_mps2 = noise_mps2;
                (vehicle.max_brake_mps2, vehicle.max_accel_mps2) = (Some(7.0), Some(2.5));
            }
            (
                spec.vehicles[1].max_brake_mps2,
                spec.vehicles[2].max_brake_mps2,
            ) = (Some(6.0), Some(6.4));
            spec.vehicles[1].actuator_lag_s = 0.2;
            (
                spec.vehicles[2].reaction_delay_s,
                spec.vehicles[2].actuator_delay_s,
            ) = (0.2, 0.1);
            changed(spec);
        });
        edited.unwrap()
    };
    let asked = |scenario: &Scenario, estimator: EstimatorKind| {
        let options = RunOptions::new(BuiltInController::MatchLeader(Default::default()))
            .with_estimator(estimator);
        let run = Run::new(scenario, options).unwrap();
        (
            run.shield_params(1, &ShieldSettings::default()),
            run.tuning()
                .worst_errors([3.0 + 2.5 + 0.36, 3.62 + 2.62], 6.0),
        )
    };
    let is_near = |found: f64, expected: f64| (found - expected).abs() < 1e-12;
    let slow = scenario(&|_| ());
    let (frame, errors) = asked(&slow, EstimatorKind::Kalman);
    let frame = frame.unwrap();
    assert!(
        is_near(frame.brake_mps2, 3.0)
            && is_near(frame.noise_mps2, 0.18)
            && is_near(frame.ahead_brake_mps2, 3.62)
    );
    let behind = frame.behind.unwrap();
    assert!(
        is_near(behind.brake_mps2, 3.2) && is_near(behind.reaction_s, 0.3),
        "{behind:?}"
    );
    let errors_in_params = [
        frame.errors.gap_m,
        frame.errors.speed_mps,
        frame.errors.ahead_speed_mps,
    ];
    assert!(
        errors_in_params
            .iter()
            .zip(errors)
            .all(|(&errors_in_params, expected)| is_near(errors_in_params, expected)),
        "{errors_in_params:?} {errors:?}"
    );
    assert!(
        is_near(frame.response_fraction, 1.0 - (-0.01_f64 / 0.2).exp()),
        "{}",
        frame.response_fraction
    );
    let prompt = scenario(&|spec| spec.vehicles[1].actuator_lag_s = 0.0);
    let (frame, _) = asked(&prompt, EstimatorKind::Truth);
    assert_eq!(
        (
            frame.unwrap().response_fraction,
            asked(&slow, EstimatorKind::Truth).0.unwrap().errors
        ),
        (1.0, ErrorBounds::default())
    );
    let blind = scenario(&|spec| spec.sensors.dropout = 0.1);
    assert_eq!(
        asked(&blind, EstimatorKind::Kalman).0,
        Err(ShieldRefusal::Dropout)
    );
    assert!(asked(&blind, EstimatorKind::Truth).0.is_ok());
    let late = scenario(&|spec| spec.sensors.faults.latency_s = 0.1);
    assert_eq!(
        asked(&late, EstimatorKind::Kalman).0,
        Err(ShieldRefusal::SensorFaults)
    );
}

/// A shield of a controller that never brakes intervenes from a step of the run on until its end.
#[test]
fn interventions_are_reported_in_seconds_of_the_run() {
    let far = FarAway {
        onset_s: 1.0,
        step_s: 0.01,
        ..FarAway::from_report(1.0, 0.0, [VehicleClass::Light; 2])
    };
    let done = far.simulate().interventions;
    let end_s = far.scenario().spec().duration_s;
    let (Some(first), Some(last)) = (done.first(), done.last()) else {
        panic!("nothing was done")
    };
    assert!(
        first.vehicle == 1 && first.from_s > 0.5 && first.from_s < end_s,
        "{first:?}"
    );
    assert!(
        (last.to_s - end_s).abs() < 1e-9,
        "{last:?}, which is to end at {end_s}"
    );
    assert!(
        done.iter()
            .all(|intervention| intervention.from_s < intervention.to_s
                && !intervention.rear_conflict),
        "{done:?}"
    );
}

/// Commands 3 m/s² at first, and less after each command in place of its own, which it stores.
#[derive(Clone)]
struct CommandLog {
    interval_s: Option<f64>,
    wanted_mps2: f64,
    replaced_mps2: Arc<Mutex<Vec<f64>>>,
}

impl CommandLog {
    fn new(interval_s: Option<f64>) -> Self {
        Self {
            interval_s,
            wanted_mps2: 3.0,
            replaced_mps2: Arc::default(),
        }
    }
}

impl Controller for CommandLog {
    fn decide(&mut self, _: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.wanted_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.wanted_mps2 -= 1e-4;
        self.replaced_mps2.lock().unwrap().push(command_mps2);
    }
}

impl ControllerSource for CommandLog {
    fn identity(&self) -> Option<String> {
        None
    }

    fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }

    fn start(&self, _: &Ego, _: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(self.clone()))
    }
}

/// A controller behind a shield learns each command that the shield replaced, in all engines.
#[test]
fn a_controller_learns_of_the_commands_that_its_shield_replaces() {
    let shielded = |log: &CommandLog| {
        let controller = Arc::new(log.clone());
        RunOptions::new(
            ShieldedSource {
                controller,
                settings: ShieldSettings::default().into(),
            }
            .into_source(),
        )
    };
    for interval_s in [None, Some(0.05)] {
        let logs: Vec<_> = (0..3).map(|_| CommandLog::new(interval_s)).collect();
        let scenarios =
            (0..3).map(|index| built_in_scenario(&format!("paper-{}", index + 1)).unwrap());
        let scenarios =
            scenarios.map(|scenario| scenario.edited(|spec| spec.vehicles.truncate(2)).unwrap());
        let scenarios: Vec<Scenario> = scenarios.collect();
        let prepare = |(scenario, log)| Run::new(scenario, shielded(log)).unwrap();
        let runs: Vec<_> = scenarios.iter().zip(&logs).map(prepare).collect();
        let together = simulate_batch(&runs, RecordingLevel::Trace, |_, result| result);
        let of_batch: Vec<_> = logs
            .iter()
            .map(|log| std::mem::take(&mut *log.replaced_mps2.lock().unwrap()))
            .collect();
        for (((run, log), result), of_batch) in runs.iter().zip(&logs).zip(together).zip(of_batch) {
            let alone = simulate(run, RecordingLevel::Trace);
            assert_eq!(alone, result);
            let take_log = || std::mem::take(&mut *log.replaced_mps2.lock().unwrap());
            let of_scalar = take_log();
            let steps: f64 = alone
                .interventions
                .iter()
                .map(|intervention| (intervention.to_s - intervention.from_s) / 0.01)
                .sum();
            let expected = vec![-7.5; steps.round() as usize];
            assert!(expected.len() > 10);
            assert_eq!(
                (&of_scalar, &of_batch),
                (&expected, &expected),
                "{interval_s:?}"
            );
            let of_steps = [1, 10].map(|together| {
                let mut stepper = Stepper::without_summaries(run);
                while !stepper.has_ended() {
                    stepper.drive(
                        0,
                        together,
                        |_| -1.0,
                        |_| std::ops::ControlFlow::Continue(()),
                    );
                }
                take_log()
            });
            assert!(!of_steps[0].is_empty() && of_steps[0] == of_steps[1]);
        }
    }
}

/// A driver that is only consulted learns of the commands, also in several steps at once.
#[test]
fn a_consulted_controller_learns_of_the_commands_of_another() {
    let scenario = built_in_scenario("paper-1").unwrap();
    for together in [1, 10] {
        let log = CommandLog::new(None);
        let run = Run::new(&scenario, RunOptions::new(Arc::new(log.clone()))).unwrap();
        let mut stepper = Stepper::without_summaries(&run);
        stepper.consult(1, EstimatorKind::Kalman);
        stepper.drive(
            1,
            3 * together,
            |_| -0.25,
            |_| std::ops::ControlFlow::Continue(()),
        );
        assert_eq!(
            *log.replaced_mps2.lock().unwrap(),
            vec![-0.25; 3 * together]
        );
        assert!(
            stepper
                .consulted_mps2(1)
                .is_some_and(|answer_mps2| answer_mps2 < 3.0)
        );
    }
}

#[test]
fn a_shield_around_a_shield_is_refused() {
    let settings = |ahead_mps2| ShieldSettings {
        ahead_brake_mps2: Some(ahead_mps2),
        ..Default::default()
    };
    let controller = BuiltInController::FullThrottle(Default::default()).into_source();
    let inner = ShieldedSource {
        controller,
        settings: settings(9.0).into(),
    }
    .into_source();
    let nested = ShieldedSource {
        controller: inner,
        settings: settings(3.0).into(),
    }
    .into_source();
    let refused = Run::new(
        &built_in_scenario("paper-1").unwrap(),
        RunOptions::new(nested),
    );
    assert!(matches!(
        refused.err(),
        Some(RunError::Shield {
            refusal: ShieldRefusal::Nested,
            ..
        })
    ));
}

/// A `baseline` holds its speed until its brake fires, but noise of its acceleration may exceed the limit of the class.
#[test]
fn a_follower_with_noise_is_not_known_to_be_of_the_class() {
    let driver_with_noise = |noise_mps2: f64| {
        let scenario = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| spec.vehicles[2].acceleration_noise_mps2 = noise_mps2)
            .unwrap();
        let idm = BuiltInController::from_name("idm").unwrap();
        let run = Run::new(&scenario, RunOptions::new(idm)).unwrap();
        let params = run.two_sided_shield(1, &TwoSidedSettings::default());
        run.driver_outside_class(1, &params.unwrap().follower.unwrap())
    };
    assert_eq!(driver_with_noise(0.01), None);
    assert_eq!(driver_with_noise(0.2), Some("baseline"));
}
