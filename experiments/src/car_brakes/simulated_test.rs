//! Tests of the track as simulations.

use crumple_sim::control::{BuiltInController, EmergencyBrakeSettings, STANDARD_GRAVITY_MPS2};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::{Purpose, derived_seed, stream};
use crumple_sim::scenario::{
    Driver, Environment, LeadProfile, RampBrake, SCENARIO_VERSION, Scenario, ScenarioSpec, Sensors,
    VehicleClass, VehicleSpec,
};
use rand::RngExt;

use super::track_test::{TestCell, TestKind};
use crate::ExperimentError;

const KMH: f64 = 1.0 / 3.6;
/// Time between decisions.
const STEP_S: f64 = 0.01;
/// Simulations of a test; each draws the speeds within their tolerance.
const RUNS: u64 = 200;
/// Headway at the start, as a time to collision (S7.2).
const APPROACH_S: f64 = 5.0;
/// Time before the leader brakes (S7.5.2).
const STEADY_S: f64 = 3.0;
/// Time before standstill until which the deceleration of the leader is held (S7.5.3).
const LEAD_RELEASE_S: f64 = 0.25;
/// Largest deceleration of the car: the peak friction coefficient of the test surface, 1.02 (S6.2.2).
const MAX_BRAKE_MPS2: f64 = 1.02 * STANDARD_GRAVITY_MPS2;
/// Time after the approach in which a car comes to rest.
const TAIL_S: f64 = 15.0;

/// Quantities that the table of trials does not determine: the same for all cars.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Assumptions {
    /// Deceleration of full braking.
    pub(super) brake_mps2: f64,
    /// Rate at which braking builds up.
    pub(super) jerk_mps3: f64,
    /// Time from the demand of the brake to its effect.
    pub(super) delay_s: f64,
    /// Partial braking: its time to collision and deceleration; `None` for full braking alone.
    pub(super) partial: Option<PartialBraking>,
    /// Time to collision of cars that avoid all collisions.
    pub(super) without_collision: WithoutCollision,
    /// Time in which the leader reaches its deceleration (S7.5.3: up to 1.5 s).
    pub(super) lead_ramp_s: f64,
    /// Tolerance of the speeds, drawn uniformly (S7.3.2 to S7.5.2: 1.6 km/h).
    pub(super) speed_tolerance_kmh: f64,
    /// Estimator of the car under test.
    pub(super) estimator: EstimatorKind,
    /// Integration step.
    pub(super) integration_step_s: f64,
    /// Seed of speeds and sensor noise.
    pub(super) seed: u64,
}

/// Partial braking before full braking.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PartialBraking {
    pub(super) ttc_s: f64,
    pub(super) brake_mps2: f64,
}

/// Choice of the time to collision of a car whose stopped trials give only a shortest one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WithoutCollision {
    /// The best time that is nearest to the mean of the other cars.
    MeanOfOthers,
    /// The mean of a normal distribution above the shortest time, which maximises the likelihood of all cars.
    CensoredNormal,
}

/// The models, in the order in which they were made. The predictions of the first were committed before any comparison;
/// the second was made after it.
pub(super) const ATTEMPTS: [Assumptions; 2] = [
    // Build-up and deceleration of UN R157, table 1: 0.774 g within 0.6 s. The ramp is the middle of its range.
    Assumptions {
        brake_mps2: 0.774 * STANDARD_GRAVITY_MPS2,
        jerk_mps3: 12.65,
        delay_s: 0.0,
        partial: None,
        without_collision: WithoutCollision::MeanOfOthers,
        lead_ramp_s: 0.75,
        speed_tolerance_kmh: 1.6,
        estimator: EstimatorKind::Kalman,
        integration_step_s: STEP_S,
        seed: 127,
    },
    // The partial braking of PRE-SAFE Brake (Mercedes-Benz): up to 0.4 g from about 1.6 s before the collision.
    Assumptions {
        brake_mps2: 0.774 * STANDARD_GRAVITY_MPS2,
        jerk_mps3: 12.65,
        delay_s: 0.0,
        partial: Some(PartialBraking {
            ttc_s: 1.6,
            brake_mps2: 0.4 * STANDARD_GRAVITY_MPS2,
        }),
        without_collision: WithoutCollision::CensoredNormal,
        lead_ramp_s: 0.75,
        speed_tolerance_kmh: 1.6,
        estimator: EstimatorKind::Kalman,
        integration_step_s: STEP_S,
        seed: 127,
    },
];

/// Returns the assumptions, and copies in which one is changed.
pub(super) fn variations(stated: &Assumptions) -> Vec<(String, Assumptions)> {
    let changed = |name: &str, change: &dyn Fn(&mut Assumptions)| {
        let mut changed = stated.clone();
        change(&mut changed);
        (name.to_owned(), changed)
    };
    vec![
        changed("as stated", &|_| {}),
        changed("deceleration 7 m/s²", &|a| a.brake_mps2 = 7.0),
        changed("deceleration 8.5 m/s²", &|a| a.brake_mps2 = 8.5),
        changed("deceleration 10 m/s²", &|a| a.brake_mps2 = 10.0),
        changed("build-up 8 m/s³", &|a| a.jerk_mps3 = 8.0),
        changed("build-up 25 m/s³", &|a| a.jerk_mps3 = 25.0),
        changed("delay 0.1 s", &|a| a.delay_s = 0.1),
        changed("delay 0.2 s", &|a| a.delay_s = 0.2),
        changed("no partial braking", &|a| a.partial = None),
        changed("partial braking from 1.4 s", &|a| {
            a.partial = partial(1.4, 0.4);
        }),
        changed("partial braking from 1.8 s", &|a| {
            a.partial = partial(1.8, 0.4);
        }),
        changed("partial braking at 0.3 g", &|a| {
            a.partial = partial(1.6, 0.3);
        }),
        changed("partial braking at 0.45 g", &|a| {
            a.partial = partial(1.6, 0.45);
        }),
        changed("TTC of iX and Corolla as in the first model", &|a| {
            a.without_collision = WithoutCollision::MeanOfOthers;
        }),
        changed("leader brakes at once", &|a| a.lead_ramp_s = 0.0),
        changed("leader brakes within 1.5 s", &|a| {
            a.lead_ramp_s = 1.5;
        }),
        changed("exact speeds", &|a| a.speed_tolerance_kmh = 0.0),
        changed("true state instead of the filter", &|a| {
            a.estimator = EstimatorKind::Truth;
        }),
        changed("integration step 2 ms", &|a| a.integration_step_s = 0.002),
        changed("another seed", &|a| a.seed = 128),
    ]
}

fn partial(ttc_s: f64, share_of_g: f64) -> Option<PartialBraking> {
    Some(PartialBraking {
        ttc_s,
        brake_mps2: share_of_g * STANDARD_GRAVITY_MPS2,
    })
}

impl Assumptions {
    /// Returns the settings of a car with this time to collision and this share of missed standing vehicles.
    pub(super) fn settings(&self, ttc_s: f64, standing_miss_share: f64) -> EmergencyBrakeSettings {
        let full = EmergencyBrakeSettings {
            ttc_s,
            standing_miss_share,
            brake_mps2: self.brake_mps2,
            jerk_mps3: self.jerk_mps3,
            delay_s: self.delay_s,
            ..EmergencyBrakeSettings::default()
        };
        match self.partial {
            None => full,
            Some(partial) => EmergencyBrakeSettings {
                partial_ttc_s: partial.ttc_s,
                partial_brake_mps2: partial.brake_mps2,
                ..full
            },
        }
    }

    fn scenario(&self, cell: &TestCell, index: u64) -> Result<Scenario, ExperimentError> {
        let mut draws = stream(self.seed, Purpose::ScenarioSampling, index);
        let mut draw_mps = || self.speed_tolerance_kmh * KMH * (2.0 * draws.random::<f64>() - 1.0);
        let own_mps = cell.own_speed_kmh * KMH + draw_mps();
        let lead_mps = match cell.kind {
            TestKind::Stopped => 0.0,
            TestKind::Slower => cell.lead_speed_kmh * KMH + draw_mps(),
            TestKind::Decelerating => own_mps,
        };
        let gap_m = cell.headway_m.unwrap_or(APPROACH_S * (own_mps - lead_mps));
        let lead_driver = match cell.lead_deceleration_g {
            None => LeadProfile::ConstantSpeed,
            Some(share) => LeadProfile::RampBrake(RampBrake {
                onset_s: STEADY_S,
                rate_mps2: share * STANDARD_GRAVITY_MPS2,
                ramp_s: self.lead_ramp_s,
                release_s: LEAD_RELEASE_S,
            }),
        };
        let class = VehicleClass::Light;
        let lead = VehicleSpec::new(
            class,
            gap_m + class.length_m(),
            lead_mps,
            Driver::Profile(lead_driver),
        );
        let mut car = VehicleSpec::new(class, 0.0, own_mps, Driver::UnderTest);
        car.max_brake_mps2 = Some(MAX_BRAKE_MPS2);
        Ok(Scenario::new(ScenarioSpec {
            version: SCENARIO_VERSION,
            name: cell.name(),
            about: String::new(),
            duration_s: APPROACH_S + TAIL_S,
            step_s: STEP_S,
            seed: derived_seed(self.seed, index),
            environment: Environment::default(),
            sensors: Sensors::default(),
            vehicles: vec![lead, car],
        })?)
    }
}

/// Distribution of the result of a test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CellPrediction {
    /// Share of runs with a collision.
    pub(super) collision_share: f64,
    /// Mean speed at impact, in km/h; a run without a collision counts as 0.
    pub(super) mean_impact_kmh: f64,
    /// 5 % quantile of that speed, in km/h.
    pub(super) low_kmh: f64,
    /// 95 % quantile of that speed, in km/h.
    pub(super) high_kmh: f64,
}

/// Simulates a test 200 times.
pub(super) fn predict(
    assumptions: &Assumptions,
    settings: &EmergencyBrakeSettings,
    cell: &TestCell,
) -> Result<CellPrediction, ExperimentError> {
    let mut impacts_kmh = impacts_kmh(assumptions, settings, cell)?;
    impacts_kmh.sort_by(f64::total_cmp);
    let count = impacts_kmh.len() as f64;
    let quantile = |share: f64| {
        let index = (share * (count - 1.0)).round() as usize;
        impacts_kmh.get(index).copied().unwrap_or(f64::NAN)
    };
    let collisions = impacts_kmh.iter().filter(|impact| **impact > 0.0).count();
    Ok(CellPrediction {
        collision_share: collisions as f64 / count,
        mean_impact_kmh: impacts_kmh.iter().sum::<f64>() / count,
        low_kmh: quantile(0.05),
        high_kmh: quantile(0.95),
    })
}

/// Returns the speed at impact of each simulation, in km/h; 0 without a collision.
fn impacts_kmh(
    assumptions: &Assumptions,
    settings: &EmergencyBrakeSettings,
    cell: &TestCell,
) -> Result<Vec<f64>, ExperimentError> {
    let controller = BuiltInController::EmergencyBrake(settings.clone());
    let runs = (0..RUNS)
        .map(|index| {
            let scenario = assumptions.scenario(cell, index)?;
            let options = RunOptions::new(controller.clone())
                .with_estimator(assumptions.estimator)
                .with_dt_s(assumptions.integration_step_s);
            Ok(Run::new(&scenario, options)?)
        })
        .collect::<Result<Vec<_>, ExperimentError>>()?;
    Ok(simulate_batch(
        &runs,
        RecordingLevel::Summary,
        |_, simulated| {
            let first = simulated.impacts.first();
            first.map_or(0.0, |impact| impact.collision.impact_speed_mps / KMH)
        },
    ))
}
