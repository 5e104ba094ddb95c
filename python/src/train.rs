//! Training of policies.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use crumple_learn::rl::{
    EvaluationSet, SeedTraining, TrainingConfig, TrainingError, TrainingEvent, TrainingSpace,
    format_table, seed_folder,
};
use crumple_store::study::Study;
use pyo3::prelude::*;

use crate::controller::controllers;
use crate::episodes::load_training_config;
use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};
use crate::threads::parse_threads;
use crate::values::serialize_to_python;

/// Trains the policy of one seed in the folder `seed-N` of `out`, as `crumple train` does. Returns the content of
/// `result.json`, and the table of the command. `progress` receives completed episodes, all episodes, and evaluations
/// that found a better policy.
///
/// `spaces` are names or files with their weights; none are those of the preset. The preset is a name, a file, or a
/// text of TOML of two lines at least.
#[pyfunction]
#[expect(
    clippy::too_many_arguments,
    reason = "the Python half names every argument"
)]
pub(crate) fn train<'py>(
    py: Python<'py>,
    preset: &str,
    seed: u64,
    out: PathBuf,
    spaces: Vec<(String, f64)>,
    episodes: Option<u64>,
    resume: bool,
    #[pyo3(from_py_with = parse_threads)] threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String)> {
    let config = read_config(py, preset, &spaces, episodes)?;
    let stop = StopFlag::default();
    let folder = seed_folder(&out, seed);
    if folder.is_symlink() {
        let problem = format!("{}: is a symbolic link", folder.display());
        return Err(training_error(py, &problem));
    }
    let trained = run_interruptible(py, &stop, progress.as_ref(), threads, |say| {
        let held_out = EvaluationSet::from_config(&config)?;
        let training = SeedTraining {
            config: &config,
            seed,
            held_out: &held_out,
        };
        let improvements = AtomicU64::new(0);
        training.run(&folder, resume, &|event: &TrainingEvent| {
            let [done, better] = match event {
                TrainingEvent::Episode(record) => [record.episode, 0],
                TrainingEvent::Evaluation { episode, best, .. } => [*episode, u64::from(*best)],
                _ => [0, 0],
            };
            let earlier = improvements.fetch_add(better, Ordering::Relaxed);
            say((done, config.episodes, earlier + better))
        })
    })?;
    let result = trained.map_err(|error: TrainingError| match error {
        TrainingError::RunFolder(error) => {
            errors::run_folder_exception(py, ExceptionClass::Training, &error, "out")
        }
        other => training_error(py, &other),
    })?;
    let table = format_table(
        std::slice::from_ref(&result),
        config.evaluation.ranking_draws,
    );
    Ok((serialize_to_python(py, &result)?, table))
}

fn read_config(
    py: Python<'_>,
    preset: &str,
    spaces: &[(String, f64)],
    episodes: Option<u64>,
) -> PyResult<TrainingConfig> {
    let mut config = load_training_config(py, preset)?;
    config.controllers = controllers();
    config.episodes = episodes.unwrap_or(config.episodes);
    if !spaces.is_empty() {
        config.spaces = spaces.iter().map(training_space).collect();
    }
    // Check the scenario spaces before a folder is created.
    match config.scenario_source() {
        Ok(_) => Ok(config),
        Err(error) => Err(training_error(py, &error)),
    }
}

fn training_space((space, weight): &(String, f64)) -> TrainingSpace {
    TrainingSpace {
        space: space.clone(),
        weight: *weight,
        cost_multiplier: 1.0,
        uniform_share: 0.0,
    }
}

fn training_error(py: Python<'_>, error: &dyn std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Training, &error.to_string())
}
