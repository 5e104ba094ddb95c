//! Tests of sensor faults against exact solutions. Without noise, filters forget their initial errors.

use std::sync::Arc;

use super::super::{EgoEstimator, EgoTuning};
use super::*;
use crate::control::BuiltInController;
use crate::engine::{RecordingLevel, Run, RunOptions, simulate};
use crate::observation::Observation;
use crate::scenario::built_in_scenario;

const STEP_S: f64 = 0.01;
const OWN_MPS: f64 = 20.0;
/// The tuning assumes noise of at least 0.1 mm, which initial errors have.
const INITIAL_ERROR: f64 = 0.02;

fn sensors(change: impl FnOnce(&mut SensorFaults)) -> Sensors {
    let mut sensors = Sensors {
        position_noise_m: 0.0,
        gap_noise_m: 0.0,
        ..Sensors::default()
    };
    change(&mut sensors.faults);
    sensors
}

/// Returns the true state at a time: the ego vehicle drives at 20 m/s behind a leader with an initial gap and speed,
/// which accelerates constantly.
fn truth(time_s: f64, [gap_m, speed_mps, acceleration_mps2]: [f64; 3]) -> TrueState {
    let closing_mps = OWN_MPS - speed_mps;
    let gap_m = gap_m - closing_mps * time_s + 0.5 * acceleration_mps2 * time_s * time_s;
    let ahead = Neighbour {
        gap_m,
        speed_mps: speed_mps + acceleration_mps2 * time_s,
        acceleration_mps2,
    };
    let observation = Observation {
        speed_mps: OWN_MPS,
        acceleration_mps2: 0.0,
        ahead: Some(ahead),
        behind: None,
    };
    TrueState {
        position_m: OWN_MPS * time_s,
        observation,
    }
}

/// Returns time, observation and true state of the leader, at each step.
fn observe(
    sensors: &Sensors,
    steps: u32,
    leader: [f64; 3],
) -> Vec<(f64, Option<Neighbour>, Neighbour)> {
    let tuning = Arc::new(EgoTuning::new(STEP_S, sensors));
    let mut estimator = EgoEstimator::new(3, 1, sensors, &tuning, &truth(0.0, leader));
    let times_s = (0..steps).map(|step| f64::from(step) * STEP_S);
    let each = times_s.filter_map(|time_s| {
        let now = truth(time_s, leader);
        Some((
            time_s,
            estimator.observe(&now).ahead,
            now.observation.ahead?,
        ))
    });
    each.collect()
}

/// Checks gap and speed of every observation, from the start within the initial error, and after 8 s exactly.
fn assert_observed(
    sensors: &Sensors,
    leader: [f64; 3],
    expected: impl Fn(f64, &Neighbour) -> [f64; 2],
) {
    for (time_s, sensed, truth) in observe(sensors, 1000, leader) {
        let (sensed, [gap_m, speed_mps]) = (sensed.expect("tracked"), expected(time_s, &truth));
        let tolerance = if time_s < 8.0 { INITIAL_ERROR } else { 1e-9 };
        assert!(
            (sensed.gap_m - gap_m).abs() < tolerance,
            "{time_s} s: {} m, not {gap_m} m",
            sensed.gap_m
        );
        assert!(
            (sensed.speed_mps - speed_mps).abs() < tolerance,
            "{time_s} s: {} m/s",
            sensed.speed_mps
        );
    }
}

#[test]
fn latency_adds_the_closing_distance_of_its_duration() {
    let late = sensors(|faults| faults.latency_s = 0.2);
    assert_observed(&late, [150.0, 12.0, 0.0], |_, truth| {
        [truth.gap_m + 8.0 * 0.2, 12.0]
    });
}

#[test]
fn bias_shifts_gaps_and_keeps_speeds() {
    let biased = sensors(|faults| faults.gap_bias_m = -1.5);
    assert_observed(&biased, [150.0, 12.0, 0.0], |_, truth| {
        [truth.gap_m - 1.5, 12.0]
    });
}

#[test]
fn resolution_rounds_a_constant_gap() {
    let coarse = sensors(|faults| faults.gap_resolution_m = 0.4);
    let (_, sensed, _) = observe(&coarse, 1000, [16.3, OWN_MPS, 0.0])[999];
    assert!((sensed.expect("tracked").gap_m - 16.4).abs() < 1e-9);
}

/// With latency L, the filter follows the gap of L ago, and the constant acceleration of the leader.
#[test]
fn latency_delays_the_onset_of_a_constant_acceleration() {
    let late = sensors(|faults| faults.latency_s = 0.2);
    let [gap_m, speed_mps, acceleration_mps2] = [20.0, 25.0, 1.0];
    let (time_s, sensed, _) = observe(&late, 1000, [gap_m, speed_mps, acceleration_mps2])[999];
    let past = truth(time_s - 0.2, [gap_m, speed_mps, acceleration_mps2])
        .observation
        .ahead
        .expect("a leader");
    let sensed = sensed.expect("tracked");
    assert!(
        (sensed.gap_m - past.gap_m).abs() < 1e-9
            && (sensed.speed_mps - past.speed_mps).abs() < 1e-9
    );
}

/// During an outage the filter extrapolates: the error of the gap to a leader that brakes is a t²/2.
#[test]
fn an_outage_hides_the_braking_of_the_leader() {
    let blind =
        sensors(|faults| (faults.outage_rate_per_s, faults.outage_length_s) = (100.0, 100.0));
    let (time_s, sensed, truth) = observe(&blind, 101, [80.0, OWN_MPS, -4.0])[100];
    let error_m = sensed.expect("tracked").gap_m - truth.gap_m;
    assert!(
        (error_m - 0.5 * 4.0 * time_s * time_s).abs() < INITIAL_ERROR,
        "{error_m} m"
    );
}

/// The share of lost measurements is λL/(1 + λL), their correlation exp(-(λ + 1/L) τ), for any step.
#[test]
fn outages_are_a_markov_chain_for_any_step() {
    let faults =
        sensors(|faults| (faults.outage_rate_per_s, faults.outage_length_s) = (0.5, 0.8)).faults;
    for (step_s, lag) in [(0.1, 5), (0.01, 50)] {
        let stream = random::stream(1, Purpose::GapAheadOutage, 0);
        let mut outages = Outages::new(stream, &faults, step_s).expect("has outages");
        let lost: Vec<f64> = (0..2_000_000)
            .map(|_| {
                outages.advance();
                f64::from(outages.is_lost)
            })
            .collect();
        let share = lost.iter().sum::<f64>() / lost.len() as f64;
        let pairs = lost.iter().zip(&lost[lag..]);
        let covariance =
            pairs.map(|(a, b)| (a - share) * (b - share)).sum::<f64>() / (lost.len() - lag) as f64;
        let expected_share = 0.4 / 1.4;
        let expected_correlation = (-(0.5 + 1.25) * 0.5_f64).exp();
        assert!((share - expected_share).abs() < 0.02, "{share}");
        assert!(
            (covariance / (share * (1.0 - share)) - expected_correlation).abs() < 0.02,
            "{covariance}"
        );
    }
}

#[test]
fn a_vehicle_is_detected_late_after_it_comes_into_range() {
    let short = sensors(|faults| (faults.range_m, faults.detection_delay_s) = (Some(50.0), 0.5));
    let observations = observe(&short, 300, [60.05, 10.0, 0.0]);
    let first = observations
        .iter()
        .find(|(_, sensed, _)| sensed.is_some())
        .expect("comes into range");
    // The gap is 50 m after 1.005 s, so the sensor notices at 1.01 s.
    assert!((first.0 - 1.51).abs() < 1e-9, "{} s", first.0);
    assert!(
        observe(&short, 1, [49.0, 10.0, 0.0])[0].1.is_some(),
        "a vehicle in range at the start is detected"
    );
}

#[test]
fn a_vehicle_that_cuts_in_is_detected_late() {
    let late = sensors(|faults| faults.detection_delay_s = 0.3);
    let now = truth(0.0, [30.0, OWN_MPS, 0.0]);
    let mut estimator =
        EgoEstimator::new(3, 1, &late, &Arc::new(EgoTuning::new(STEP_S, &late)), &now);
    assert!(estimator.observe(&now).ahead.is_some());
    estimator.switch_neighbours(&now, [true, false]);
    let missed = (0..100)
        .take_while(|_| estimator.observe(&now).ahead.is_none())
        .count();
    assert_eq!(missed, 30);
}

#[test]
fn a_ghost_hides_the_leader_until_it_is_passed() {
    let ghost = GhostObject {
        onset_s: 1.0,
        duration_s: 2.0,
        gap_m: 10.05,
        speed_mps: 0.0,
    };
    let haunted = sensors(|faults| faults.ghost = Some(ghost));
    for (time_s, sensed, truth) in observe(&haunted, 300, [40.0, OWN_MPS, 0.0]) {
        let sensed = sensed.expect("tracked");
        let is_ghost = (0.995..1.505).contains(&time_s);
        let expected_m = if is_ghost {
            10.05 - OWN_MPS * (time_s - 1.0)
        } else {
            truth.gap_m
        };
        let expected_mps = if is_ghost { 0.0 } else { truth.speed_mps };
        assert!(
            (sensed.gap_m - expected_m).abs() < INITIAL_ERROR,
            "{time_s} s: {} m",
            sensed.gap_m
        );
        assert!(
            (sensed.speed_mps - expected_mps).abs() < INITIAL_ERROR,
            "{time_s} s: {} m/s",
            sensed.speed_mps
        );
    }
}

/// Sensors measure once per step of the scenario, so the integration step changes results by rounding only.
#[test]
fn the_integration_step_changes_nothing() {
    let faulty = built_in_scenario("paper-1").unwrap().edited(|spec| {
        spec.duration_s = 8.0;
        spec.sensors.faults = SensorFaults {
            latency_s: 0.1,
            gap_bias_m: 0.5,
            gap_resolution_m: 0.2,
            outage_rate_per_s: 1.0,
            outage_length_s: 0.3,
            range_m: Some(14.0),
            detection_delay_s: 0.1,
            ghost: Some(GhostObject {
                onset_s: 0.5,
                duration_s: 0.5,
                gap_m: 12.0,
                speed_mps: 20.0,
            }),
        };
    });
    let faulty = faulty.unwrap();
    let min_gaps_m = |dt_s: f64, seed: u64| {
        let scenario = faulty.edited(|spec| spec.seed = seed).unwrap();
        let options = RunOptions::new(BuiltInController::from_name("idm").unwrap()).with_dt_s(dt_s);
        let result = simulate(
            &Run::new(&scenario, options).unwrap(),
            RecordingLevel::Summary,
        );
        result
            .vehicles
            .iter()
            .map(|vehicle| vehicle.min_gap_m.unwrap_or_default())
            .collect::<Vec<_>>()
    };
    for seed in 0..10 {
        let [coarse, fine] = [0.01, 0.001].map(|dt_s| min_gaps_m(dt_s, seed));
        assert_eq!(coarse, min_gaps_m(0.01, seed));
        assert!(
            coarse
                .iter()
                .zip(&fine)
                .all(|(a, b)| a == b || (a - b).abs() < 1e-6),
            "{coarse:?} {fine:?}"
        );
    }
    assert_ne!(min_gaps_m(0.01, 0), min_gaps_m(0.01, 1));
}
