//! Emergency brakes of six cars: fit, prediction and validation behind `reports/credibility.md`.
//!
//! - `car_brakes predict ATTEMPT TESTS.csv FOLDER` fits each car on the trials behind a stopped leader. It writes
//!   the settings (`settings.csv`) and the predictions for all other tests of the cars (`predictions.csv`) to FOLDER.
//! - `car_brakes validate ATTEMPT TESTS.csv FOLDER` compares the predictions in FOLDER with the other trials.
//! - `car_brakes sensitivity ATTEMPT TESTS.csv` fits and compares again with one assumption changed at a time.
//!
//! ATTEMPT is the number of a model ([`simulated_test::ATTEMPTS`]). TESTS.csv is
//! `corpora/vehicle-tests/nhtsa-2023-aeb.csv`.

mod censored_normal;
mod comparison;
mod fit;
mod simulated_test;
mod track_test;

use std::path::Path;

use crate::ExperimentError;
use comparison::ValidationResult;
use fit::FittedBrake;
use simulated_test::{ATTEMPTS, Assumptions, CellPrediction};
use track_test::{TestCell, TestKind, TrackTrial};

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["predict", attempt, tests, folder] => {
            predict(find_attempt(attempt)?, Path::new(tests), Path::new(folder))
        }
        ["validate", attempt, tests, folder] => {
            validate(find_attempt(attempt)?, Path::new(tests), Path::new(folder))
        }
        ["sensitivity", attempt, tests] => {
            print_sensitivity(find_attempt(attempt)?, Path::new(tests))
        }
        _ => Err("name a task and its arguments".into()),
    }
}

fn find_attempt(number: &str) -> Result<&'static Assumptions, ExperimentError> {
    let index = number.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
    index.and_then(|index| ATTEMPTS.get(index)).ok_or_else(|| {
        format!(
            "`{number}` is no attempt: there are 1 to {}",
            ATTEMPTS.len()
        )
        .into()
    })
}

/// Prediction for a car in a test that was not used for its fit.
#[derive(Debug, Clone, PartialEq)]
struct Prediction {
    car: String,
    cell: TestCell,
    of_model: CellPrediction,
}

/// Fits on the stopped trials. Of the other trials, the result depends on cars and conditions, not on their results.
fn fit_and_predict(
    assumptions: &Assumptions,
    trials: &[TrackTrial],
) -> Result<(Vec<FittedBrake>, Vec<Prediction>), ExperimentError> {
    let (stopped, others): (Vec<_>, Vec<_>) = trials
        .iter()
        .cloned()
        .partition(|trial| trial.cell.kind == TestKind::Stopped);
    let conditions = track_test::conditions(&others);
    let cars = fit::fit_cars(assumptions, &stopped)?;
    let predictions = conditions
        .into_iter()
        .map(|(car, cell)| {
            let fitted = cars
                .iter()
                .find(|fitted| fitted.car == car)
                .ok_or_else(|| format!("{car} has no stopped trials"))?;
            let of_model = simulated_test::predict(assumptions, &fitted.settings, &cell)?;
            Ok(Prediction {
                car,
                cell,
                of_model,
            })
        })
        .collect::<Result<_, ExperimentError>>()?;
    Ok((cars, predictions))
}

fn predict(assumptions: &Assumptions, tests: &Path, folder: &Path) -> Result<(), ExperimentError> {
    let trials = track_test::read(tests)?;
    let (cars, predictions) = fit_and_predict(assumptions, &trials)?;
    std::fs::create_dir_all(folder)?;
    fit::write(&folder.join("settings.csv"), &cars)?;
    comparison::write_predictions(&folder.join("predictions.csv"), &predictions)
}

fn validate(assumptions: &Assumptions, tests: &Path, folder: &Path) -> Result<(), ExperimentError> {
    let trials = track_test::read(tests)?;
    let predictions = comparison::read_predictions(&folder.join("predictions.csv"))?;
    let (_, repeated) = fit_and_predict(assumptions, &trials)?;
    if !comparison::agree(&predictions, &repeated) {
        return Err("this build predicts other values than predictions.csv".into());
    }
    ValidationResult::new(&predictions, &trials)?.print();
    Ok(())
}

fn print_sensitivity(assumptions: &Assumptions, tests: &Path) -> Result<(), ExperimentError> {
    let trials = track_test::read(tests)?;
    println!("| assumption | cells right | rms, km/h | mean error, km/h |\n|---|---|---|---|");
    for (name, changed) in simulated_test::variations(assumptions) {
        let (_, predictions) = fit_and_predict(&changed, &trials)?;
        ValidationResult::new(&predictions, &trials)?.print_summary(&name);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::control::{BuiltInController, CONTROLLER_PRESETS};

    /// The models with names are those of the last attempt, in the order of the file.
    #[test]
    fn car_models_have_the_fitted_settings() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let path = root.join("corpora/vehicle-tests/attempt-2/settings.csv");
        let mut reader = csv::Reader::from_path(path).unwrap();
        let fitted: Vec<_> = reader
            .records()
            .map(|row| BuiltInController::parse(&row.unwrap()[1]).unwrap().unwrap())
            .collect();
        let cars = CONTROLLER_PRESETS
            .iter()
            .filter(|preset| preset.name.starts_with("car:"));
        let named: Vec<_> = cars.map(|preset| preset.controller.clone()).collect();
        assert_eq!(fitted, named);
    }
}
