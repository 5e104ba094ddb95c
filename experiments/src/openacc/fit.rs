//! Closed-loop simulation of car models behind recorded leaders, and the search for their settings.

use std::ops::ControlFlow;

use crumple::search::falsify::{Method, UnitCube};
use crumple::sim::control::{BuiltInController, ControllerSource, Ego};
use crumple::sim::engine::{AfterCollision, Run, RunOptions, Stepper};
use crumple::sim::observation::{EstimatorKind, Observation};
use crumple::sim::scenario::{
    Driver, LeadProfile, RecordedSpeeds, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
};

use super::drives::{DistanceSetting, Drive, SAMPLE_S};
use crate::ExperimentError;

const SEED: u64 = 76;
/// Evaluations of each search.
const BUDGET: usize = 1000;
/// Steps of the simulations that a search compares, and of the errors that are reported, in seconds.
pub(super) const FIT_STEP_S: f64 = 0.1;
pub(super) const REPORT_STEP_S: f64 = 0.01;
/// Limit of the acceleration of a recorded leader in both directions, in m/s².
const LEADER_LIMIT_MPS2: f64 = 30.0;

/// Numbers of a car that are fitted besides the shared settings of its controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Variant {
    /// A time gap for each distance setting.
    Plain,
    /// Also the delays of the car.
    Delays,
    /// One time gap for both distance settings.
    OneTimeGap,
}

/// A controller with the ranges in which its settings are fitted; all others keep their defaults.
pub(super) struct ModelFamily {
    pub(super) controller: &'static str,
    /// Settings that are the same for both distance settings.
    shared: &'static [(&'static str, [f64; 2])],
    pub(super) variant: Variant,
}

const fn idm(variant: Variant) -> ModelFamily {
    ModelFamily {
        controller: "idm",
        shared: &[
            ("desired_speed_mps", [10.0, 45.0]),
            ("standstill_gap_m", [0.0, 10.0]),
            ("accel_mps2", [0.1, 4.0]),
            ("comfortable_brake_mps2", [0.1, 4.0]),
        ],
        variant,
    }
}

const fn acc_aeb(variant: Variant) -> ModelFamily {
    ModelFamily {
        controller: "acc-aeb",
        shared: &[
            ("standstill_gap_m", [0.0, 10.0]),
            ("gap_gain_per_s2", [0.0, 1.0]),
            ("speed_gain_per_s", [0.0, 2.0]),
            ("comfort_brake_mps2", [0.5, 5.0]),
            ("comfort_accel_mps2", [0.2, 3.0]),
            ("set_speed_mps", [10.0, 45.0]),
        ],
        variant,
    }
}

pub(super) const FAMILIES: [ModelFamily; 5] = [
    idm(Variant::Plain),
    acc_aeb(Variant::Plain),
    idm(Variant::Delays),
    acc_aeb(Variant::Delays),
    idm(Variant::OneTimeGap),
];
/// The setting that each distance setting has for itself.
const TIME_GAP: (&str, [f64; 2]) = ("time_headway_s", [0.0, 4.0]);
/// Range of the reaction delay, and of the lag of the actuator, in seconds.
const DELAY_S: [f64; 2] = [0.0, 1.5];

/// A car: its controller with each distance setting, and the delays of the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FollowingModel {
    /// Controllers in the order of [`DistanceSetting::ALL`].
    controllers: [BuiltInController; 2],
    reaction_delay_s: f64,
    actuator_lag_s: f64,
}

/// Spacing error of simulated drives.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct SpacingError {
    sum_m2: f64,
    samples: usize,
    pub(super) collisions: usize,
}

impl SpacingError {
    /// Returns the root mean square, in metres.
    pub(super) fn rms_m(&self) -> f64 {
        (self.sum_m2 / self.samples as f64).sqrt()
    }

    /// Returns the duration of the drives, in minutes.
    pub(super) fn minutes(&self) -> f64 {
        self.samples as f64 * SAMPLE_S / 60.0
    }

    fn add(&mut self, gap_m: f64, recorded_m: Option<&f64>) {
        if let Some(recorded_m) = recorded_m {
            self.sum_m2 += (gap_m - recorded_m).powi(2);
            self.samples += 1;
        }
    }

    fn merge(self, other: Self) -> Self {
        Self {
            sum_m2: self.sum_m2 + other.sum_m2,
            samples: self.samples + other.samples,
            collisions: self.collisions + other.collisions,
        }
    }
}

impl ModelFamily {
    fn dimension(&self) -> usize {
        let delays = match self.variant {
            Variant::Delays => 2,
            Variant::Plain | Variant::OneTimeGap => 0,
        };
        self.shared.len() + self.time_gaps() + delays
    }

    fn time_gaps(&self) -> usize {
        match self.variant {
            Variant::OneTimeGap => 1,
            Variant::Plain | Variant::Delays => DistanceSetting::ALL.len(),
        }
    }

    /// Returns the model at a point of the unit cube: shared settings, time gaps, and delays. Values are rounded to
    /// three decimals, and the reaction delay to steps.
    fn model(&self, point: &[f64]) -> Result<FollowingModel, ExperimentError> {
        let value = |index: usize, [low, high]: [f64; 2]| {
            let share = point.get(index).copied().unwrap_or(0.0);
            (1000.0 * (low + share * (high - low))).round() / 1000.0
        };
        let mut shared = self.controller.to_owned();
        for (index, (name, range)) in self.shared.iter().enumerate() {
            shared += &format!(",{name}={}", value(index, *range));
        }
        let controller = |index: usize| {
            let (name, range) = TIME_GAP;
            let index = index.min(self.time_gaps() - 1);
            let time_gap_s = value(self.shared.len() + index, range);
            parse(&format!("{shared},{name}={time_gap_s}"))
        };
        let delays = self.shared.len() + self.time_gaps();
        let delay_s = |index: usize| match self.variant {
            Variant::Delays => value(delays + index, DELAY_S),
            Variant::Plain | Variant::OneTimeGap => 0.0,
        };
        Ok(FollowingModel {
            controllers: [controller(0)?, controller(1)?],
            reaction_delay_s: (delay_s(0) / FIT_STEP_S).round() * FIT_STEP_S,
            actuator_lag_s: delay_s(1),
        })
    }

    /// Searches the settings with the smallest spacing error.
    pub(super) fn fit(&self, drives: &[&Drive]) -> Result<FollowingModel, ExperimentError> {
        let cube = UnitCube::new([self.dimension()])?;
        let mut search = Method::CmaEs.start(&cube, SEED);
        let mut best = (f64::INFINITY, Vec::new());
        let mut evaluations = 0;
        while evaluations < BUDGET {
            let mut errors_m = Vec::new();
            for point in search.ask() {
                let error_m = self.model(&point)?.error(drives, FIT_STEP_S)?.rms_m();
                if error_m < best.0 {
                    best = (error_m, point);
                }
                errors_m.push(error_m);
            }
            evaluations += errors_m.len();
            search.tell(&errors_m);
        }
        self.model(&best.1)
    }
}

/// Returns what the controller of the car knows of it.
fn ego(scenario: &Scenario) -> Result<Ego, ExperimentError> {
    let car = scenario.vehicles().last().ok_or("the scenario has a car")?;
    Ok(Ego {
        vehicle: 1,
        max_brake_mps2: car.max_brake_mps2(),
        max_accel_mps2: car.max_accel_mps2(),
        length_m: car.length_m(),
        step_s: scenario.spec().step_s,
    })
}

fn parse(text: &str) -> Result<BuiltInController, ExperimentError> {
    Ok(BuiltInController::parse(text).ok_or_else(|| format!("`{text}` is not built in"))??)
}

impl FollowingModel {
    /// Returns a controller with the same settings for both distances, in a car that responds at once.
    pub(super) fn from_arg(controller: &str) -> Result<Self, ExperimentError> {
        let controller = parse(controller)?;
        Ok(Self {
            controllers: [controller.clone(), controller],
            reaction_delay_s: 0.0,
            actuator_lag_s: 0.0,
        })
    }

    /// Returns the controller with a distance setting.
    pub(super) fn controller(&self, setting: DistanceSetting) -> &BuiltInController {
        let [short, long] = &self.controllers;
        match setting {
            DistanceSetting::Short => short,
            DistanceSetting::Long => long,
        }
    }

    /// Returns the spacing error of all drives.
    pub(super) fn error(
        &self,
        drives: &[&Drive],
        step_s: f64,
    ) -> Result<SpacingError, ExperimentError> {
        let mut total = SpacingError::default();
        for drive in drives {
            total = total.merge(self.error_in(drive, step_s)?);
        }
        Ok(total)
    }

    fn error_in(&self, drive: &Drive, step_s: f64) -> Result<SpacingError, ExperimentError> {
        let controller = self.controller(drive.source.setting);
        let options = RunOptions::new(controller.clone())
            .with_estimator(EstimatorKind::Truth)
            .with_after_collision(AfterCollision::Continue);
        let scenario = self.scenario(drive, step_s)?;
        let mut controller = controller.start(&ego(&scenario)?, 0)?;
        let mut stepper = Stepper::without_summaries(&Run::new(&scenario, options)?);
        let steps_per_sample = (SAMPLE_S / step_s).round() as usize;
        let mut error = SpacingError::default();
        let mut step = 0;
        let command = |seen: &Observation| controller.decide(seen).unwrap_or(0.0);
        stepper.drive(1, usize::MAX, command, |view| {
            step += 1;
            let recorded_m = drive.gap_m.get(step / steps_per_sample);
            if let (0, Some(gap_m)) = (step % steps_per_sample, view.gap_m) {
                error.add(gap_m, recorded_m);
            }
            ControlFlow::Continue(())
        });
        error.collisions = usize::from(stepper.has_collided());
        Ok(error)
    }

    /// Returns the car behind the recorded leader.
    fn scenario(&self, drive: &Drive, step_s: f64) -> Result<Scenario, ExperimentError> {
        let speeds = RecordedSpeeds {
            time_s: drive.time_s.clone(),
            speed_mps: drive.leader_mps.clone(),
        };
        let script = Driver::Profile(LeadProfile::Recorded(speeds));
        let mut leader = VehicleSpec::new(VehicleClass::Light, 0.0, drive.leader_mps[0], script);
        leader.max_brake_mps2 = Some(LEADER_LIMIT_MPS2);
        leader.max_accel_mps2 = Some(LEADER_LIMIT_MPS2);
        let front_m = -leader.length_m() - drive.gap_m[0];
        let mut car = VehicleSpec::new(
            VehicleClass::Light,
            front_m,
            drive.speed_mps,
            Driver::UnderTest,
        );
        car.reaction_delay_s = self.reaction_delay_s;
        car.actuator_lag_s = self.actuator_lag_s;
        let duration_s = (drive.gap_m.len() - 1) as f64 * SAMPLE_S;
        let mut spec = ScenarioSpec::new("drive".to_owned(), duration_s, vec![leader, car]);
        spec.step_s = step_s;
        Ok(Scenario::new(spec)?)
    }
}
