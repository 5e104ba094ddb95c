//! The learning curve of trainings whose evaluations are in a table, as `reports/training-evaluations.csv` has them.
//!
//! ```sh
//! cargo run --release --example learning_curve -- reports/training-evaluations.csv paper-net-to-the-end curve.svg
//! ```

use std::collections::BTreeMap;
use std::error::Error;

use crumple_learn::rl::LearningCurve;
use crumple_report::figures::learning_curve;

/// A line of the table; what else it says is not drawn.
#[derive(serde::Deserialize)]
struct Evaluation {
    configuration: String,
    seed: u64,
    episode: u64,
    mean_reward: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [table, configuration, picture] = arguments.as_slice() else {
        return Err("usage: learning_curve TABLE CONFIGURATION PICTURE".into());
    };
    let mut seeds = BTreeMap::<u64, BTreeMap<u64, f64>>::new();
    for evaluation in csv::Reader::from_path(table)?.deserialize() {
        let Evaluation { configuration: of, seed, episode, mean_reward } = evaluation?;
        if of == *configuration {
            seeds.entry(seed).or_default().insert(episode, mean_reward);
        }
    }
    if seeds.is_empty() {
        return Err(format!("{table} has no evaluations of {configuration}").into());
    }
    let curves: Vec<_> = seeds.into_values().collect();
    std::fs::write(picture, learning_curve(&LearningCurve::from_evaluations(configuration, &curves)).document())?;
    Ok(())
}
