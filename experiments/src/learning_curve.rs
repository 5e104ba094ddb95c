//! Plots the learning curve of trainings from a table of evaluations, such as `reports/training-evaluations.csv`,
//! together with the values that the paper states.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- \
//!   learning_curve reports/training-evaluations.csv paper-net-to-the-end curve.svg
//! ```
//! The paper's figure 3 has no numbers. Its text has two: convergence at approximately the 400th episode, with a reward
//! of 22 500.

use std::collections::BTreeMap;

use crate::ExperimentError;
use crumple_report::figures::{StatedConvergence, draw_learning_curve_with_reference};
use crumple_sim::policy::{COLLISION_FREE_REWARD, LearningCurve};

/// A row of the table; other columns are ignored.
#[derive(serde::Deserialize)]
struct EvaluationRow {
    configuration: String,
    seed: u64,
    episode: u64,
    mean_reward: f64,
}

/// Stated in section "DDPG training result".
const PAPER_CONVERGENCE: StatedConvergence<'static> = StatedConvergence {
    source: "the paper",
    reward: COLLISION_FREE_REWARD,
    from_episode: 400,
};

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let [table, configuration, picture] = arguments else {
        return Err(format!("{} arguments, and there must be three", arguments.len()).into());
    };
    let unreadable = |error: csv::Error| format!("{table}: {error}");
    let mut seeds = BTreeMap::<u64, BTreeMap<u64, f64>>::new();
    for evaluation in csv::Reader::from_path(table)
        .map_err(unreadable)?
        .deserialize()
    {
        let EvaluationRow {
            configuration: of,
            seed,
            episode,
            mean_reward,
        } = evaluation.map_err(unreadable)?;
        if of == *configuration {
            seeds.entry(seed).or_default().insert(episode, mean_reward);
        }
    }
    if seeds.is_empty() {
        return Err(format!("{table} has no evaluations of `{configuration}`").into());
    }
    let curves: Vec<_> = seeds.into_values().collect();
    let figure = draw_learning_curve_with_reference(
        &LearningCurve::from_evaluations(configuration, &curves),
        Some(&PAPER_CONVERGENCE),
    );
    std::fs::write(picture, figure.document()).map_err(|error| format!("{picture}: {error}"))?;
    Ok(())
}
