//! The filter is consistent: its innovations have the variance it expects.
//!
//! The normalised innovation squared (NIS) of one measurement is residual² / expected variance. If filter and world
//! agree, innovations are independent and normal, and the sum of N of them has the chi-square distribution with N
//! degrees of freedom (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2).

mod world;

use std::sync::Arc;

use crumple_fuzzing::oracle::estimates_within_bounds;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, Stepper};
use crumple_sim::estimate::{Accelerometer, EgoEstimator, EgoTuning, Filter, Sensor, TrueState};
use crumple_sim::observation::{EstimatorKind, Neighbour, Observation};
use crumple_sim::random::Purpose;
use crumple_sim::scenario::{PaperDistribution, Scenario, Sensors, built_in_scenario};
use proptest::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};

use self::world::WhiteJerk;
use crate::generate::{any_test_case, check_oracle, simulate_traced, with_cases};

/// Returns true if a sum of `count` squared standard normal numbers is in the central band that contains a `share` of
/// such sums.
fn is_in_band(sum: f64, count: usize, share: f64) -> bool {
    let chi_square = ChiSquared::new(count as f64).expect("positive");
    let tail = 0.5 * (1.0 - share);
    (chi_square.inverse_cdf(tail)..=chi_square.inverse_cdf(1.0 - tail)).contains(&sum)
}

/// White jerk, 200 runs of 1500 steps, with and without lost measurements: the sum of all NIS is in its 99.9 % band,
/// and successive innovations are uncorrelated.
#[test]
fn innovations_are_chi_square_in_the_world_the_filter_believes_in() {
    for dropout in [0.0, 0.2, 0.9] {
        let sensors = Sensors {
            dropout,
            ..Sensors::default()
        };
        let mut normalised: Vec<Vec<f64>> = Vec::new();
        for run in 0..200 {
            let (tuning, mut world, mut filter) = WhiteJerk::with_filter(&sensors, run);
            let mut sensor = Sensor::new(
                run,
                Purpose::GapAheadSensor,
                1,
                sensors.gap_noise_m,
                &sensors,
            );
            let mut innovations = Vec::new();
            for _ in 0..1500 {
                let measured_m = sensor.measure(world.distance_m());
                if let Some(measured_m) = measured_m {
                    let innovation = filter.innovation(&tuning, measured_m);
                    innovations.push(innovation.residual_m / innovation.variance_m2.sqrt());
                }
                filter.update(&tuning, measured_m);
                world.step();
            }
            normalised.push(innovations);
        }
        let count: usize = normalised.iter().map(Vec::len).sum();
        let nis: f64 = normalised
            .iter()
            .flatten()
            .map(|innovation| innovation * innovation)
            .sum();
        assert!(
            is_in_band(nis, count, 0.999),
            "dropout {dropout}: mean NIS {} of {count}",
            nis / count as f64
        );
        let neighbours: f64 = normalised
            .iter()
            .flat_map(|run| run.windows(2))
            .map(|pair| pair[0] * pair[1])
            .sum();
        let deviations = neighbours / (count as f64).sqrt();
        assert!(
            deviations.abs() < 3.3,
            "dropout {dropout}: neighbours correlate, {deviations} deviations from 0"
        );
    }
}

/// White jerk: errors of distance, rate and acceleration have the filter's standard deviations, in 99.9 % bands, and no
/// bias. One error per run, since errors within a run are correlated.
#[test]
fn errors_have_the_deviations_of_the_filter() {
    const RUNS: u64 = 2000;
    let sensors = Sensors::default();
    let errors: Vec<[f64; 3]> = (0..RUNS)
        .map(|run| {
            let (tuning, mut world, mut filter) = WhiteJerk::with_filter(&sensors, run);
            let mut sensor = Sensor::new(
                run,
                Purpose::GapAheadSensor,
                1,
                sensors.gap_noise_m,
                &sensors,
            );
            for _ in 0..400 {
                filter.update(&tuning, sensor.measure(world.distance_m()));
                world.step();
            }
            world.prediction_error(&tuning, &filter)
        })
        .collect();
    let deviations = EgoTuning::new(WhiteJerk::STEP_S, &sensors)
        .gap()
        .steady_deviations();
    for (component, deviation) in deviations.into_iter().enumerate() {
        let normalised = |error: &[f64; 3]| error[component] / deviation;
        let squares: f64 = errors.iter().map(|error| normalised(error).powi(2)).sum();
        assert!(
            is_in_band(squares, errors.len(), 0.999),
            "component {component}: {}",
            squares / errors.len() as f64
        );
        let mean = errors.iter().map(normalised).sum::<f64>() / (RUNS as f64).sqrt();
        assert!(
            mean.abs() < 3.3,
            "component {component}: bias of {mean} deviations of the mean"
        );
    }
}

/// Sums and counts of NIS of one of the ego's filters in a run: within 0.5 s after a neighbour's sudden braking, and
/// for all instants more than 1.5 s after it.
#[derive(Default)]
struct Consistency {
    after_surprise: (f64, usize),
    undisturbed: (f64, usize),
}

/// Runs the filter on the measurements of a run: same seed, purpose and vehicle.
fn measure_consistency(scenario: &Scenario, controller: &str, channel: Purpose) -> Consistency {
    let (spec, ego) = (scenario.spec(), 1);
    let options = RunOptions::new(BuiltInController::from_name(controller).expect("built in"));
    let trace = simulate_traced(scenario, &options).trace.expect("kept");
    let tuning = EgoTuning::new(spec.step_s, &spec.sensors);
    let gaps_behind_rear = |rear: usize| {
        trace
            .pairs(rear)
            .first()
            .expect("a pair")
            .gaps_m()
            .map(|(_, gap_m)| gap_m)
            .collect()
    };
    let [position_m, gap_m] = [spec.sensors.position_noise_m, spec.sensors.gap_noise_m];
    let (tuning, noise_m, rate_mps, sign, neighbour, truth_m): (_, _, _, _, _, Vec<f64>) =
        match channel {
            Purpose::PositionSensor => (
                tuning.position(),
                position_m,
                25.0,
                1.0,
                None,
                trace.vehicles[ego].position_m.clone(),
            ),
            Purpose::GapAheadSensor => (
                tuning.gap(),
                gap_m,
                0.0,
                -1.0,
                Some(ego - 1),
                gaps_behind_rear(ego),
            ),
            _ => (
                tuning.gap(),
                gap_m,
                0.0,
                1.0,
                Some(ego + 1),
                gaps_behind_rear(ego + 1),
            ),
        };
    let mut sensor = Sensor::new(spec.seed, channel, ego, noise_m, &spec.sensors);
    let mut filter = Filter::new_steady(tuning, truth_m[0], rate_mps, [0.0; 3]);
    let own = &trace.vehicles[ego];
    let mut inertia = Accelerometer::new(own.speed_mps[0]);
    let mut consistency = Consistency::default();
    let mut since_surprise = usize::MAX;
    // The last sample is the collision, between two measurements.
    for k in 0..trace.len() - 1 {
        // A trace contains the acceleration of the step that begins; the sensor measures that of the step that ended.
        let ended = |of: &[f64]| if k == 0 { 0.0 } else { of[k - 1] };
        let felt =
            inertia.measure_change(spec.step_s, own.speed_mps[k], ended(&own.acceleration_mps2));
        let measured_m = sensor.measure(truth_m[k]).expect("nothing is lost");
        filter.feed_forward(tuning, &felt, sign);
        let innovation = filter.innovation(tuning, measured_m);
        filter.update(tuning, Some(measured_m));
        let part = match since_surprise {
            0..50 => &mut consistency.after_surprise,
            50..150 => &mut Default::default(),
            _ => &mut consistency.undisturbed,
        };
        *part = (
            part.0 + innovation.residual_m.powi(2) / innovation.variance_m2,
            part.1 + 1,
        );
        let jump_mps2 = neighbour.map_or(0.0, |index| {
            let accelerations = &trace.vehicles[index].acceleration_mps2;
            accelerations[k] - ended(accelerations)
        });
        since_surprise = if jump_mps2.abs() > 1.0 {
            0
        } else {
            since_surprise.saturating_add(1)
        };
    }
    consistency
}

/// In simulated runs of the paper's distribution, the filters are consistent under all of the ego's manoeuvres,
/// including emergency braking to standstill: the NIS is in its 95 % band in at least 9 of 10 runs. (A perfect filter
/// has 95 of 100 ± 1; these allow for jerk that does not occur, and have an NIS of about 0.98.)
///
/// When a *neighbour* brakes suddenly, its acceleration jumps by 3 m/s² or more, which white jerk of this density does
/// not cover: for about a second the filter lags and underestimates its error. A larger density would make speeds
/// several times noisier at all other times. The second half of the test bounds this lag, the first half excludes 1.5 s
/// after such a jump.
#[test]
fn nis_of_simulated_runs_is_in_band_unless_a_neighbour_has_just_slammed_on_its_brakes() {
    for controller in ["baseline", "constant-brake"] {
        for channel in [
            Purpose::PositionSensor,
            Purpose::GapAheadSensor,
            Purpose::GapBehindSensor,
        ] {
            let draw = |index| PaperDistribution { seed: 21 }.draw(index).expect("valid");
            let runs: Vec<_> = (0..300)
                .map(|index| measure_consistency(&draw(index), controller, channel))
                .collect();
            let inside = runs
                .iter()
                .filter(|run| is_in_band(run.undisturbed.0, run.undisturbed.1, 0.95))
                .count();
            assert!(
                inside >= 265,
                "{controller} {channel:?}: {inside} of 300 runs inside"
            );
            let mean = |of: fn(&Consistency) -> (f64, usize)| {
                let (sum, count) = runs
                    .iter()
                    .map(of)
                    .fold((0.0, 0), |all, one| (all.0 + one.0, all.1 + one.1));
                sum / count as f64
            };
            let all = mean(|run| run.undisturbed);
            assert!(
                (0.97..1.0).contains(&all),
                "{controller} {channel:?}: mean NIS {all}"
            );
            let surprised = mean(|run| run.after_surprise);
            let expected = match channel {
                Purpose::GapAheadSensor => 2.0..3.0,
                Purpose::GapBehindSensor => 7.0..10.0,
                // No neighbour influences the ego's position.
                _ => continue,
            };
            assert!(
                expected.contains(&surprised),
                "{controller} {channel:?}: mean NIS {surprised} after a surprise"
            );
        }
    }
}

/// Without noise, the ego's own state is exact at every step: through sudden braking, its change, and a stop within a
/// step.
#[test]
fn without_noise_the_own_motion_is_exact_through_every_jump() {
    let sensors = Sensors {
        position_noise_m: 0.0,
        gap_noise_m: 0.0,
        ..Sensors::default()
    };
    let scenario = built_in_scenario("paper-2")
        .expect("built in")
        .edited(|spec| spec.sensors = sensors)
        .expect("valid");
    let options = RunOptions::new(BuiltInController::from_name("baseline").expect("built in"));
    let run = Run::new(&scenario, options).expect("valid");
    let mut stepper = Stepper::new(&run, RecordingLevel::Summary);
    let mut last_mps2 = 0.0;
    while !stepper.has_ended() {
        let seen = stepper.observe(1).expect("it is there");
        let own = stepper.motion()[1];
        // The filters assume 0.1 mm of noise for an ideal sensor, and start with such an error.
        assert!(
            (seen.speed_mps - own.speed_mps).abs() < 1e-3,
            "{seen:?} {own:?}"
        );
        assert!(
            (seen.acceleration_mps2 - own.acceleration_mps2).abs() < 5e-3,
            "{seen:?} {own:?}"
        );
        last_mps2 = match own.speed_mps {
            20.0.. => -2.9,
            3.0.. => -2.4,
            _ => -7.0,
        };
        stepper.command(1, last_mps2);
        stepper.step();
    }
    assert!(!stepper.has_collided() && last_mps2 == -7.0 && stepper.motion()[1].speed_mps == 0.0);
}

/// In steady driving, observations are unbiased, with errors known in closed form.
///
/// The true jerk is zero, so only measurement noise drives the error of the filter, a third-order Butterworth filter:
/// its speed has half the variance that `Tuning::steady_deviations` states, its acceleration a sixth, its distance five
/// sixths. (With gains 2ω, 2ω², ω³ these are 3/2 ω³, 1/3 ω⁵ and 5/3 ω times σ² h, against 3 ω³, 2 ω⁵ and 2 ω.)
#[test]
fn steady_estimates_are_unbiased_and_as_accurate_as_tuned() {
    const RUNS: u64 = 2000;
    let sensors = Sensors::default();
    let tuning = Arc::new(EgoTuning::new(0.01, &sensors));
    // Both gaps shrink: the vehicle ahead is slower and the one behind is faster.
    let at = |k: i32| {
        let t = 0.01 * f64::from(k);
        let neighbour = |gap_m, speed_mps| {
            Some(Neighbour {
                gap_m,
                speed_mps,
                acceleration_mps2: 0.0,
            })
        };
        let (ahead, behind) = (
            neighbour(60.0 - 7.0 * t, 18.0),
            neighbour(40.0 - 5.0 * t, 30.0),
        );
        let observation = Observation {
            speed_mps: 25.0,
            acceleration_mps2: 0.0,
            ahead,
            behind,
        };
        TrueState {
            position_m: 25.0 * t,
            observation,
        }
    };
    let numbers = |seen: &Observation| {
        let (ahead, behind) = (seen.ahead.expect("ahead"), seen.behind.expect("behind"));
        let [
            [gap, speed, acceleration],
            [gap_behind, speed_behind, acceleration_behind],
        ] = [ahead, behind].map(|n| [n.gap_m, n.speed_mps, n.acceleration_mps2]);
        let own = [seen.speed_mps, seen.acceleration_mps2];
        [
            gap,
            speed,
            acceleration,
            gap_behind,
            speed_behind,
            acceleration_behind,
            own[0],
            own[1],
        ]
    };
    let errors: Vec<[f64; 8]> = (0..RUNS)
        .map(|seed| {
            let mut ego = EgoEstimator::new(seed, 1, &sensors, &tuning, &at(0));
            let seen = (0..300).map(|k| ego.observe(&at(k))).last().expect("seen");
            let (seen, truth) = (numbers(&seen), numbers(&at(299).observation));
            std::array::from_fn(|number| seen[number] - truth[number])
        })
        .collect();
    let [_, own_speed, own_acceleration] = tuning.position().steady_deviations();
    let [gap, rate, acceleration] = tuning.gap().steady_deviations();
    let shares = [5.0 / 6.0, 0.5, 1.0 / 6.0].map(f64::sqrt);
    let neighbour = [
        gap * shares[0],
        rate.hypot(own_speed) * shares[1],
        acceleration.hypot(own_acceleration) * shares[2],
    ];
    let expected = [
        &neighbour[..],
        &neighbour,
        &[own_speed * shares[1], own_acceleration * shares[2]],
    ]
    .concat();
    for (number, expected) in expected.into_iter().enumerate() {
        let component = |error: &[f64; 8]| error[number];
        let rms = (errors
            .iter()
            .map(|error| component(error).powi(2))
            .sum::<f64>()
            / RUNS as f64)
            .sqrt();
        // The closed form is for continuous time, before the measurement.
        assert!(
            (rms / expected - 1.0).abs() < 0.1,
            "number {number}: {rms}, closed form {expected}"
        );
        let bias = errors.iter().map(component).sum::<f64>() / RUNS as f64;
        assert!(
            bias.abs() < 3.3 * rms / (RUNS as f64).sqrt(),
            "number {number}: bias {bias}"
        );
    }
}

/// With 20 % of measurements lost, verdicts equal those with the true state, and collisions differ by at most 0.1 s.
#[test]
fn losing_one_measurement_in_five_changes_no_verdict() {
    for name in ["paper-1", "paper-2", "paper-3"] {
        for controller in ["baseline", "match-leader", "constant-brake"] {
            let options =
                RunOptions::new(BuiltInController::from_name(controller).expect("built in"));
            let scenario = built_in_scenario(name).expect("built in");
            let truth = simulate_traced(
                &scenario,
                &options.clone().with_estimator(EstimatorKind::Truth),
            )
            .outcome;
            for seed in 0..10 {
                let lossy = scenario
                    .edited(|spec| (spec.seed, spec.sensors.dropout) = (seed, 0.2))
                    .expect("valid");
                match (
                    truth.collision(),
                    simulate_traced(&lossy, &options).outcome.collision(),
                ) {
                    (None, None) => {}
                    (Some(truth), Some(lossy)) => {
                        assert_eq!(
                            truth.rear_vehicle, lossy.rear_vehicle,
                            "{name} {controller} seed {seed}"
                        );
                        assert!(
                            (truth.time_s - lossy.time_s).abs() < 0.1,
                            "{name} {controller} seed {seed}"
                        );
                    }
                    (truth, lossy) => {
                        panic!("{name} {controller} seed {seed}: {truth:?} became {lossy:?}")
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(with_cases(512))]

    /// Estimates are finite, speeds not negative, and without lost measurements errors are explained by noise and lag.
    /// The estimator `truth` returns the true state.
    #[test]
    fn estimates_are_near_the_truth(test_case in any_test_case()) {
        check_oracle(&test_case, estimates_within_bounds)?;
    }
}
