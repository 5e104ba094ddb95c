//! Comparison of predictions with the trials that were not used for the fit.
//!
//! A cell is a car in a test. The car collides in a cell if most of its trials do, the model if most of its runs do.
//! The speed at impact of a cell is the mean over its trials or runs; a trial or run without a collision counts as 0.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::Prediction;
use super::simulated_test::CellPrediction;
use super::track_test::{TestCell, TestKind, TrackTrial};
use crate::ExperimentError;
use crumple_core::interval::RateInterval;

#[derive(Debug, Serialize, Deserialize)]
struct PredictionRow {
    car: String,
    test: TestKind,
    own_speed_kmh: f64,
    lead_speed_kmh: f64,
    lead_deceleration_g: Option<f64>,
    headway_m: Option<f64>,
    collision_share: f64,
    mean_impact_kmh: f64,
    low_kmh: f64,
    high_kmh: f64,
}

fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (value * scale).round() / scale
}

impl From<&Prediction> for PredictionRow {
    fn from(prediction: &Prediction) -> Self {
        let Prediction {
            car,
            cell,
            of_model,
        } = prediction;
        Self {
            car: car.clone(),
            test: cell.kind,
            own_speed_kmh: cell.own_speed_kmh,
            lead_speed_kmh: cell.lead_speed_kmh,
            lead_deceleration_g: cell.lead_deceleration_g,
            headway_m: cell.headway_m,
            collision_share: rounded(of_model.collision_share, 3),
            mean_impact_kmh: rounded(of_model.mean_impact_kmh, 2),
            low_kmh: rounded(of_model.low_kmh, 2),
            high_kmh: rounded(of_model.high_kmh, 2),
        }
    }
}

impl From<PredictionRow> for Prediction {
    fn from(row: PredictionRow) -> Self {
        Self {
            car: row.car,
            cell: TestCell {
                kind: row.test,
                own_speed_kmh: row.own_speed_kmh,
                lead_speed_kmh: row.lead_speed_kmh,
                lead_deceleration_g: row.lead_deceleration_g,
                headway_m: row.headway_m,
            },
            of_model: CellPrediction {
                collision_share: row.collision_share,
                mean_impact_kmh: row.mean_impact_kmh,
                low_kmh: row.low_kmh,
                high_kmh: row.high_kmh,
            },
        }
    }
}

/// Writes the predictions, a row each.
pub(super) fn write_predictions(
    path: &Path,
    predictions: &[Prediction],
) -> Result<(), ExperimentError> {
    let mut writer = csv::Writer::from_path(path)?;
    for prediction in predictions {
        writer.serialize(PredictionRow::from(prediction))?;
    }
    Ok(writer.flush()?)
}

/// Reads the predictions that [`write_predictions`] wrote.
pub(super) fn read_predictions(path: &Path) -> Result<Vec<Prediction>, ExperimentError> {
    let in_file = |error: csv::Error| format!("{}: {error}", path.display());
    let mut reader = csv::Reader::from_path(path).map_err(in_file)?;
    reader
        .deserialize::<PredictionRow>()
        .map(|row| Ok(row.map_err(in_file)?.into()))
        .collect()
}

/// True if the predictions are the same, as far as the file states them.
pub(super) fn agree(read: &[Prediction], repeated: &[Prediction]) -> bool {
    let repeated = repeated
        .iter()
        .map(PredictionRow::from)
        .map(Prediction::from);
    read.iter().cloned().eq(repeated)
}

/// A prediction beside the trials of its cell.
struct ComparedCell {
    prediction: Prediction,
    /// Speeds at impact, in km/h; 0 without a collision.
    impacts_kmh: Vec<f64>,
}

impl ComparedCell {
    /// Returns the cell with the prediction that no run collides, as a reference.
    fn with_no_collision(&self) -> Self {
        Self {
            prediction: Prediction {
                of_model: CellPrediction {
                    collision_share: 0.0,
                    mean_impact_kmh: 0.0,
                    low_kmh: 0.0,
                    high_kmh: 0.0,
                },
                ..self.prediction.clone()
            },
            impacts_kmh: self.impacts_kmh.clone(),
        }
    }

    fn mean_kmh(&self) -> f64 {
        self.impacts_kmh.iter().sum::<f64>() / self.impacts_kmh.len() as f64
    }

    fn collisions(&self) -> usize {
        self.impacts_kmh
            .iter()
            .filter(|impact| **impact > 0.0)
            .count()
    }

    fn car_collides(&self) -> bool {
        2 * self.collisions() > self.impacts_kmh.len()
    }

    fn model_collides(&self) -> bool {
        self.prediction.of_model.collision_share > 0.5
    }

    fn is_right(&self) -> bool {
        self.car_collides() == self.model_collides()
    }

    fn error_kmh(&self) -> f64 {
        self.prediction.of_model.mean_impact_kmh - self.mean_kmh()
    }

    fn right_trials(&self) -> usize {
        match self.model_collides() {
            true => self.collisions(),
            false => self.impacts_kmh.len() - self.collisions(),
        }
    }
}

/// All predictions beside the trials.
pub(super) struct ValidationResult {
    cells: Vec<ComparedCell>,
}

impl ValidationResult {
    pub(super) fn new(
        predictions: &[Prediction],
        trials: &[TrackTrial],
    ) -> Result<Self, ExperimentError> {
        let cells = predictions
            .iter()
            .map(|prediction| {
                let own = trials
                    .iter()
                    .filter(|trial| trial.car == prediction.car && trial.cell == prediction.cell);
                let impacts_kmh: Vec<f64> =
                    own.map(|trial| trial.impact_kmh.unwrap_or(0.0)).collect();
                if impacts_kmh.is_empty() {
                    return Err(
                        format!("no trial of {} in a predicted test", prediction.car).into(),
                    );
                }
                Ok(ComparedCell {
                    prediction: prediction.clone(),
                    impacts_kmh,
                })
            })
            .collect::<Result<_, ExperimentError>>()?;
        Ok(Self { cells })
    }

    /// Prints the tables of the report.
    pub(super) fn print(&self) {
        println!(
            "| car | test | trials, km/h | mean | model: mean (5 to 95 %) | collides | right |\n\
             |---|---|---|---|---|---|---|"
        );
        for cell in &self.cells {
            print_cell(cell);
        }
        println!(
            "\n| tests | cells right (exact 95 % interval) | trials right | rms, km/h | rms where one collides, km/h \
             | mean error, km/h |\n|---|---|---|---|---|---|"
        );
        for kind in [TestKind::Slower, TestKind::Decelerating] {
            let of_kind = self
                .cells
                .iter()
                .filter(|cell| cell.prediction.cell.kind == kind);
            let name = serde_json::to_string(&kind).unwrap_or_default();
            print_scores(name.trim_matches('"'), &of_kind.collect::<Vec<_>>());
        }
        print_scores("all", &self.cells.iter().collect::<Vec<_>>());
        let without_collisions: Vec<_> = self
            .cells
            .iter()
            .map(ComparedCell::with_no_collision)
            .collect();
        print_scores(
            "all, if none were predicted",
            &without_collisions.iter().collect::<Vec<_>>(),
        );
    }

    /// Prints a row: share of right cells, rms and mean error.
    pub(super) fn print_summary(&self, name: &str) {
        let cells: Vec<_> = self.cells.iter().collect();
        let right = cells.iter().filter(|cell| cell.is_right()).count();
        println!(
            "| {name} | {right} of {} | {:.1} | {:+.1} |",
            cells.len(),
            rms_kmh(&cells),
            mean_error_kmh(&cells),
        );
    }
}

fn print_cell(cell: &ComparedCell) {
    let impacts: Vec<String> = cell.impacts_kmh.iter().map(f64::to_string).collect();
    let model = &cell.prediction.of_model;
    println!(
        "| {} | {} | {} | {:.1} | {:.1} ({:.1} to {:.1}) | {:.0} % | {} |",
        cell.prediction.car,
        cell.prediction.cell.name(),
        impacts.join(", "),
        cell.mean_kmh(),
        model.mean_impact_kmh,
        model.low_kmh,
        model.high_kmh,
        100.0 * model.collision_share,
        if cell.is_right() { "yes" } else { "**no**" },
    );
}

fn rms_kmh(cells: &[&ComparedCell]) -> f64 {
    let squares = cells
        .iter()
        .map(|cell| cell.error_kmh().powi(2))
        .sum::<f64>();
    (squares / cells.len() as f64).sqrt()
}

fn mean_error_kmh(cells: &[&ComparedCell]) -> f64 {
    cells.iter().map(|cell| cell.error_kmh()).sum::<f64>() / cells.len() as f64
}

fn print_scores(name: &str, cells: &[&ComparedCell]) {
    let right = cells.iter().filter(|cell| cell.is_right()).count();
    let interval = RateInterval::clopper_pearson(right as u64, cells.len() as u64, 0.95);
    let trials: usize = cells.iter().map(|cell| cell.impacts_kmh.len()).sum();
    let right_trials: usize = cells.iter().map(|cell| cell.right_trials()).sum();
    let colliding: Vec<_> = cells
        .iter()
        .copied()
        .filter(|cell| cell.car_collides() || cell.model_collides())
        .collect();
    println!(
        "| {name} | {right} of {} ({:.0} %, {:.0} to {:.0} %) | {right_trials} of {trials} ({:.0} %) | {:.1} \
         | {:.1} ({} cells) | {:+.1} |",
        cells.len(),
        100.0 * right as f64 / cells.len() as f64,
        100.0 * interval.lower,
        100.0 * interval.upper,
        100.0 * right_trials as f64 / trials as f64,
        rms_kmh(cells),
        rms_kmh(&colliding),
        colliding.len(),
        mean_error_kmh(cells),
    );
}
