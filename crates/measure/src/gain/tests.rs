use std::f64::consts::TAU;
use std::sync::Arc;

use super::*;
use crumple_sim::control::{
    BuiltInController, Controller, ControllerFailure, ControllerSource, Ego, IdmSettings,
    IntoSource,
};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::{EstimatorKind, Observation};
use crumple_sim::scenario::{FollowingLine, SpeedOscillation};

/// A linear law for gap, speed and closing speed: a = `stiffness` (gap - `time_gap` v) + `damping` (v_leader - v).
#[derive(Clone, Copy)]
struct LinearFollower {
    stiffness_per_s2: f64,
    time_gap_s: f64,
    damping_per_s: f64,
}

impl ControllerSource for LinearFollower {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(*self))
    }
}

impl Controller for LinearFollower {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let law = |gap_m: f64, ahead_mps: f64| {
            self.stiffness_per_s2 * (gap_m - self.time_gap_s * observation.speed_mps)
                + self.damping_per_s * (ahead_mps - observation.speed_mps)
        };
        Ok(observation
            .ahead
            .map_or(0.0, |ahead| law(ahead.gap_m, ahead.speed_mps)))
    }
}

impl LinearFollower {
    /// Magnitude of the transfer function from the leader's speed to the own speed.
    fn exact_gain(&self, w: f64) -> f64 {
        let Self {
            stiffness_per_s2: k,
            time_gap_s: h,
            damping_per_s: d,
        } = *self;
        (k.hypot(d * w)) / (k - w * w).hypot((k * h + d) * w)
    }
}

fn survey(controller: impl IntoSource, speeds_mps: &[f64]) -> GainSurvey {
    GainSurvey::at_speeds(&controller.into_source(), speeds_mps).unwrap()
}

fn idm_with(change: impl FnOnce(&mut IdmSettings)) -> BuiltInController {
    let mut settings = IdmSettings::default();
    change(&mut settings);
    BuiltInController::Idm(settings)
}

#[test]
fn gains_of_a_linear_law_are_those_of_its_transfer_function() {
    let law = LinearFollower {
        stiffness_per_s2: 0.4,
        time_gap_s: 1.2,
        damping_per_s: 0.3,
    };
    let measured = survey(Arc::new(law), &[20.0]);
    for point in &measured.points {
        // A decision holds for 0.01 s: this delay changes gains by up to 0.003.
        let (gain, exact) = (
            point.gain.clone().unwrap(),
            law.exact_gain(point.at.frequency_rad_per_s),
        );
        assert!((gain - exact).abs() < 0.004, "{point:?}: {exact}");
    }
    let exact = (1..4000)
        .map(|k| law.exact_gain(0.0005 * f64::from(k)))
        .fold(0.0, f64::max);
    let (_, largest) = measured.largest().unwrap();
    assert!(
        exact > 1.05 && (largest - exact).abs() < 0.004,
        "{largest} {exact}"
    );
}

/// Values of an independent measurement, which kept three decimals.
#[test]
fn idm_amplifies_at_low_speeds_and_damps_at_high_ones() {
    for (speed_mps, reference) in [(8.0, 1.034), (15.0, 1.022), (22.0, 1.001)] {
        let measured = survey(BuiltInController::Idm(IdmSettings::default()), &[speed_mps]);
        let (at, gain) = measured.largest().unwrap();
        assert!((gain - reference).abs() < 0.003, "{at:?} {gain}");
    }
    let (at, gain) = survey(BuiltInController::Idm(IdmSettings::default()), &[30.0])
        .largest()
        .unwrap();
    assert!((gain - 0.80).abs() < 0.006, "{at:?} {gain}");
}

#[test]
fn idm_with_more_acceleration_damps_at_all_speeds() {
    let (at, gain) = survey(
        idm_with(|settings| settings.accel_mps2 = 1.5),
        &GAIN_SPEEDS_MPS,
    )
    .largest()
    .unwrap();
    assert!((0.99..0.9995).contains(&gain), "{at:?} {gain}");
}

/// At low speeds, lines settle only if waking ends with the braking that caused it.
#[test]
fn predictive_settles_and_amplifies_no_oscillation() {
    let predictive = BuiltInController::from_name("predictive").unwrap();
    for point in survey(predictive, &[4.0, 8.0]).points {
        assert!(
            point.gain.as_ref().is_ok_and(|gain| *gain < 1.0005),
            "{point:?}"
        );
    }
}

/// The ranges of the speeds of leader and first vehicle, without a projection, give nearly the same gain.
#[test]
fn idm_close_behind_amplifies_more() {
    let at = OperatingPoint {
        mean_speed_mps: 8.0,
        frequency_rad_per_s: 0.3,
    };
    let close = "idm,time_headway_s=0.4";
    let gain = |name: &str| {
        let controller = BuiltInController::parse(name)
            .unwrap()
            .unwrap()
            .into_source();
        LineRuns::new(&controller).measure(&[at]).unwrap()[0]
            .gain
            .clone()
            .unwrap()
    };
    let line = FollowingLine {
        mean_speed_mps: 8.0,
        closing_mps: 0.0,
        gaps_m: vec![5.2; 3],
    };
    let oscillation = SpeedOscillation {
        amplitude_mps: 0.3,
        frequency_rad_per_s: 0.3,
        build_up_s: 100.0,
    };
    let scenario = line.scenario(Some(oscillation), 40_000).unwrap();
    let options = RunOptions::new(BuiltInController::parse(close).unwrap().unwrap())
        .with_estimator(EstimatorKind::Truth);
    let trace = simulate(
        &Run::new(&scenario, options).unwrap(),
        RecordingLevel::Trace,
    )
    .trace
    .unwrap();
    let range_mps = |vehicle: usize| {
        let speeds_mps = trace.vehicles[vehicle].speed_mps[30_000..].iter().copied();
        speeds_mps.clone().fold(0.0, f64::max) - speeds_mps.fold(f64::INFINITY, f64::min)
    };
    let largest = [1, 2, 3]
        .map(|vehicle| range_mps(vehicle) / range_mps(vehicle - 1))
        .into_iter()
        .fold(0.0, f64::max);
    assert!(
        (gain(close) - largest).abs() < 0.02,
        "{} {largest}",
        gain(close)
    );
    assert!(gain(close) > gain("idm") + 0.05);
}

/// A line of five vehicles: the growth of a single oscillation from the leader to the last one, with sensors.
#[test]
fn an_oscillation_of_1_mps_at_8_mps_grows_along_a_line_of_idm() {
    let line = FollowingLine {
        mean_speed_mps: 8.0,
        closing_mps: 0.0,
        gaps_m: vec![14.8; 4],
    };
    let oscillation = SpeedOscillation {
        amplitude_mps: 1.0,
        frequency_rad_per_s: 0.2,
        build_up_s: 100.0,
    };
    let periods = 3;
    let window = (100.0 * f64::from(periods) * TAU / 0.2).round() as usize;
    let scenario = line.scenario(Some(oscillation), 30_000 + window).unwrap();
    let options = RunOptions::new(BuiltInController::Idm(IdmSettings::default()));
    let trace = simulate(
        &Run::new(&scenario, options).unwrap(),
        RecordingLevel::Trace,
    )
    .trace
    .unwrap();
    let wave = amplitude::Wave::new(periods as usize, window);
    let amplitude_mps = |vehicle: usize| {
        wave.project(&trace.vehicles[vehicle].speed_mps[30_000..30_000 + window])[1]
    };
    let growth = amplitude_mps(4) / amplitude_mps(0);
    assert!((growth - 1.11).abs() < 0.01, "{growth}");
}

#[test]
fn a_controller_that_follows_no_leader_has_no_gain() {
    let measured = survey(BuiltInController::from_name("baseline").unwrap(), &[8.0]);
    assert!(
        measured.largest().is_none()
            && measured
                .points
                .iter()
                .all(|point| point.gain == Err(NoGain::NotSettled))
    );
    let keeps_speed = LinearFollower {
        stiffness_per_s2: 0.0,
        time_gap_s: 0.0,
        damping_per_s: 0.0,
    };
    let measured = survey(Arc::new(keeps_speed), &[8.0]);
    assert!(
        measured
            .points
            .iter()
            .all(|point| point.gain == Err(NoGain::NotSettled)),
        "{:?}",
        measured.points[0]
    );
}
