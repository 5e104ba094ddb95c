//! Fit of the time to collision of each car on its trials behind a stopped leader.

use std::path::Path;

use crumple_sim::control::{BuiltInController, EmergencyBrakeSettings};

use super::censored_normal::CensoredNormal;
use super::simulated_test::{self, Assumptions, WithoutCollision};
use super::track_test::{self, TestCell, TrackTrial};
use crate::ExperimentError;

/// Searched times to collision: 0.4 to 2.5 s in steps of 0.01 s.
const TTC_CENTISECONDS: std::ops::RangeInclusive<u32> = 40..=250;
/// A car that hits a standing vehicle with at least this share of its speed has not braked.
const MISSED_FROM_SHARE: f64 = 0.95;

/// A car with its fitted settings.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FittedBrake {
    pub(super) car: String,
    pub(super) settings: EmergencyBrakeSettings,
    /// Trials in which it did not brake.
    missed: usize,
    trials: usize,
    /// Smallest and largest time to collision with the smallest error, in seconds; no largest one if every longer time
    /// fits as well.
    best_ttc_s: [Option<f64>; 2],
    /// Root of the mean squared difference of the means of trials and simulations, in km/h.
    rms_kmh: f64,
}

/// Mean impact of a car in a test, and that of the simulations for each searched time to collision.
struct CellFit {
    trials: usize,
    mean_kmh: f64,
    simulated_kmh: Vec<f64>,
}

/// Sum of squared errors over the trials for each searched time to collision.
struct ErrorCurve {
    car: String,
    missed: usize,
    trials: usize,
    squared_errors: Vec<f64>,
}

/// Fits all cars of these trials.
///
/// The error of a time to collision is the sum over the tests of a car: number of trials times the squared difference
/// between the means of trials and simulations. Trials in which the car did not brake give the share of missed
/// vehicles instead. A car that avoids all other collisions has no longest time to collision
/// ([`Assumptions::without_collision`]).
pub(super) fn fit_cars(
    assumptions: &Assumptions,
    stopped: &[TrackTrial],
) -> Result<Vec<FittedBrake>, ExperimentError> {
    let mut cells: Vec<TestCell> = Vec::new();
    let mut cars: Vec<String> = Vec::new();
    for (car, cell) in track_test::conditions(stopped) {
        if !cells.contains(&cell) {
            cells.push(cell);
        }
        if !cars.contains(&car) {
            cars.push(car);
        }
    }
    let simulated = cells
        .into_iter()
        .map(|cell| Ok((cell, mean_impacts_kmh(assumptions, &cell)?)))
        .collect::<Result<Vec<_>, ExperimentError>>()?;
    let curves: Vec<_> = cars
        .into_iter()
        .map(|car| ErrorCurve::new(car, stopped, &simulated))
        .collect();
    let population = Population::new(assumptions.without_collision, &curves);
    Ok(curves
        .into_iter()
        .map(|curve| curve.into_car(assumptions, &population))
        .collect())
}

fn searched_ttc_s() -> impl Iterator<Item = f64> {
    TTC_CENTISECONDS.map(|centiseconds| f64::from(centiseconds) / 100.0)
}

/// Returns the mean impact in a test for each searched time to collision, in km/h. A time that is longer than one that
/// avoids all collisions avoids them, too.
fn mean_impacts_kmh(
    assumptions: &Assumptions,
    cell: &TestCell,
) -> Result<Vec<f64>, ExperimentError> {
    let mut mean_kmh = f64::INFINITY;
    let mut means_kmh = Vec::new();
    for ttc_s in searched_ttc_s() {
        if mean_kmh > 0.0 {
            let settings = assumptions.settings(ttc_s, 0.0);
            mean_kmh = simulated_test::predict(assumptions, &settings, cell)?.mean_impact_kmh;
        }
        means_kmh.push(mean_kmh);
    }
    Ok(means_kmh)
}

impl ErrorCurve {
    fn new(car: String, stopped: &[TrackTrial], simulated: &[(TestCell, Vec<f64>)]) -> Self {
        let own = || stopped.iter().filter(|trial| trial.car == car);
        let missed = own().filter(|trial| is_missed(trial)).count();
        let cells: Vec<CellFit> = simulated
            .iter()
            .filter_map(|(cell, simulated_kmh)| {
                let impacts: Vec<f64> = own()
                    .filter(|trial| trial.cell == *cell && !is_missed(trial))
                    .map(|trial| trial.impact_kmh.unwrap_or(0.0))
                    .collect();
                (!impacts.is_empty()).then(|| CellFit {
                    trials: impacts.len(),
                    mean_kmh: impacts.iter().sum::<f64>() / impacts.len() as f64,
                    simulated_kmh: simulated_kmh.clone(),
                })
            })
            .collect();
        let error = |index: usize| {
            let errors = cells.iter().map(|cell| {
                let difference = cell.simulated_kmh[index] - cell.mean_kmh;
                cell.trials as f64 * difference * difference
            });
            errors.sum()
        };
        let trials = own().count();
        Self {
            missed,
            trials,
            squared_errors: (0..searched_ttc_s().count()).map(error).collect(),
            car,
        }
    }

    fn least_error(&self) -> f64 {
        self.squared_errors
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min)
    }

    fn best_ttcs_s(&self) -> Vec<f64> {
        let least = self.least_error();
        searched_ttc_s()
            .zip(&self.squared_errors)
            .filter(|(_, error)| **error <= least)
            .map(|(ttc_s, _)| ttc_s)
            .collect()
    }

    /// Returns the best time to collision if a longer one is worse.
    fn bounded_ttc_s(&self) -> Option<f64> {
        let is_bounded = self.squared_errors.last() > Some(&self.least_error());
        self.best_ttcs_s().first().copied().filter(|_| is_bounded)
    }

    /// Returns the shortest of the best times to collision, in seconds.
    fn shortest_ttc_s(&self) -> f64 {
        self.best_ttcs_s().first().copied().unwrap_or(f64::NAN)
    }

    fn into_car(self, assumptions: &Assumptions, population: &Population) -> FittedBrake {
        let best = self.best_ttcs_s();
        let bounded = self.bounded_ttc_s();
        let ttc_s = bounded.unwrap_or_else(|| {
            let expected_s = population.expected_ttc_s(self.shortest_ttc_s());
            (100.0 * expected_s).round() / 100.0
        });
        let miss_share = self.missed as f64 / self.trials as f64;
        let braked = (self.trials - self.missed) as f64;
        FittedBrake {
            settings: assumptions.settings(ttc_s, (1e4 * miss_share).round() / 1e4),
            missed: self.missed,
            trials: self.trials,
            best_ttc_s: [best.first().copied(), bounded.and(best.last().copied())],
            rms_kmh: (self.least_error() / braked).sqrt(),
            car: self.car,
        }
    }
}

/// Times to collision of the cars of a table.
enum Population {
    Mean(f64),
    Normal(CensoredNormal),
}

impl Population {
    fn new(without_collision: WithoutCollision, curves: &[ErrorCurve]) -> Self {
        let bounded: Vec<f64> = curves
            .iter()
            .filter_map(ErrorCurve::bounded_ttc_s)
            .collect();
        match without_collision {
            WithoutCollision::MeanOfOthers => {
                Self::Mean(bounded.iter().sum::<f64>() / bounded.len() as f64)
            }
            WithoutCollision::CensoredNormal => {
                let unbounded = curves
                    .iter()
                    .filter(|curve| curve.bounded_ttc_s().is_none());
                let limits: Vec<f64> = unbounded.map(ErrorCurve::shortest_ttc_s).collect();
                Self::Normal(CensoredNormal::fit(&bounded, &limits))
            }
        }
    }

    /// Returns the time to collision of a car of which only the shortest possible one is known, in seconds.
    fn expected_ttc_s(&self, shortest_s: f64) -> f64 {
        match self {
            Self::Mean(mean_s) => mean_s.max(shortest_s),
            Self::Normal(normal) => normal.above(shortest_s).mean,
        }
    }
}

fn is_missed(trial: &TrackTrial) -> bool {
    let closing_kmh = trial.cell.own_speed_kmh - trial.cell.lead_speed_kmh;
    trial
        .impact_kmh
        .is_some_and(|impact_kmh| impact_kmh >= MISSED_FROM_SHARE * closing_kmh)
}

/// Returns the name with all settings that differ from the default, also for a model that has a name of its own.
fn controller_name(settings: &EmergencyBrakeSettings) -> String {
    let controller = BuiltInController::EmergencyBrake(settings.clone());
    let default = BuiltInController::EmergencyBrake(EmergencyBrakeSettings::default());
    let changed = controller
        .values()
        .zip(default.values())
        .filter(|(own, default)| own.1 != default.1);
    changed.fold(controller.name().to_owned(), |name, ((field, value), _)| {
        format!("{name},{}={value}", field.name)
    })
}

/// Writes the settings of the cars, a row each.
pub(super) fn write(path: &Path, cars: &[FittedBrake]) -> Result<(), ExperimentError> {
    let mut writer = csv::Writer::from_path(path)?;
    writer.write_record([
        "car",
        "controller",
        "shortest_best_ttc_s",
        "longest_best_ttc_s",
        "missed_trials",
        "trials",
        "rms_kmh",
    ])?;
    for fitted in cars {
        let optional = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        writer.write_record([
            fitted.car.clone(),
            controller_name(&fitted.settings),
            optional(fitted.best_ttc_s[0]),
            optional(fitted.best_ttc_s[1]),
            fitted.missed.to_string(),
            fitted.trials.to_string(),
            format!("{:.2}", fitted.rms_kmh),
        ])?;
    }
    Ok(writer.flush()?)
}
