//! Episodes of the training task in batches, for the Gymnasium environments.

use std::sync::{Arc, Mutex, PoisonError};

use crumple_core::text_file;
use crumple_learn::rl::{
    EpisodeConstants, EpisodeEnding, ScenarioSource, TrainingConfig, TrainingEpisode,
    action_bounds, unsuitability,
};
use crumple_sim::control::{BuiltInController, NoSettings};
use crumple_sim::engine::{Run, RunOptions};
use crumple_sim::scenario::Scenario;
use numpy::{PyReadonlyArray1, PyReadwriteArray1, PyReadwriteArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::controller::controllers;
use crate::errors::{self, ExceptionClass};
use crate::scenario::PySpace;
use crate::simulation::ESTIMATORS;
use crate::threads;
use crate::values::parse_choice;

/// Minimum number of episodes per thread when they begin; below it, distribution costs more than it saves.
const MIN_EPISODES_PER_THREAD: usize = 16;

const MUST_BE_RESET: &str =
    "an episode that is over, or has not begun, must be reset before it is stepped";

const MAX_EPISODES: usize = 1 << 20;

/// Handling of an episode that is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Autoreset {
    /// The next step begins another episode instead of stepping.
    NextStep,
    /// Another episode begins in the same step.
    SameStep,
    /// The caller resets it.
    Disabled,
}

/// Source and configuration of the episodes.
struct EpisodeTask {
    source: Arc<dyn ScenarioSource>,
    config: Arc<EpisodeConstants>,
    autoreset: Autoreset,
}

impl EpisodeTask {
    fn new_episode(&self, seed: u64, index: u64) -> Result<(Scenario, TrainingEpisode), String> {
        let scenario = self
            .source
            .draw(seed, index)
            .map_err(|error| error.to_string())?;
        if let Some(why) = unsuitability(&scenario) {
            return Err(format!("{}: {why}", scenario.spec().name));
        }
        // Actions replace the controller of the vehicle under test.
        let idle = BuiltInController::MatchLeader(NoSettings::default());
        let options = RunOptions::new(idle).with_estimator(self.config.environment().estimator);
        let run = Run::new(&scenario, options).map_err(|error| error.to_string())?;
        let constants = self.config.for_episode(self.source.as_ref(), seed, index);
        Ok((scenario, TrainingEpisode::new(&run, &constants)))
    }
}

/// Sequence of episodes of one seed.
struct SubEnvironment {
    seed: u64,
    next_index: u64,
    episode: Option<(Scenario, TrainingEpisode)>,
    is_over: bool,
}

/// Destination of the results of one sub-environment's step: state and last state; reward, and whether the episode was
/// terminated or truncated, with the code of its ending.
type StepBuffers<'a> = (
    (&'a mut [f32], &'a mut [f32]),
    (&'a mut f32, ((&'a mut bool, &'a mut bool), &'a mut u8)),
);

impl SubEnvironment {
    fn reset(&mut self, task: &EpisodeTask, state: &mut [f32]) -> Result<(), String> {
        let (scenario, mut episode) = task.new_episode(self.seed, self.next_index)?;
        self.next_index += 1;
        episode.write_state(state);
        (self.episode, self.is_over) = (Some((scenario, episode)), false);
        Ok(())
    }

    /// Returns the reason why the next step is impossible, if any.
    fn step_error(&self, task: &EpisodeTask, action: f32) -> Option<&'static str> {
        if self.is_over && task.autoreset == Autoreset::NextStep {
            return None;
        }
        match &self.episode {
            Some(_) if !self.is_over => action.is_nan().then_some("its action is not a number"),
            _ => Some(MUST_BE_RESET),
        }
    }

    fn step(
        &mut self,
        task: &EpisodeTask,
        action: f32,
        results: StepBuffers<'_>,
    ) -> Result<(), String> {
        let ((state, last_state), (reward, ((terminated, truncated), ending))) = results;
        (*reward, *terminated, *truncated, *ending) = (0.0, false, false, 0);
        if self.is_over && task.autoreset == Autoreset::NextStep {
            return self.reset(task, state);
        }
        let Some((_, episode)) = self.episode.as_mut().filter(|_| !self.is_over) else {
            return Err(MUST_BE_RESET.to_owned());
        };
        let led_to = episode.step(action.clamp(-1.0, 1.0));
        self.is_over = led_to.ending != EpisodeEnding::None;
        *reward = led_to.reward;
        *terminated = self.is_over && !led_to.continues;
        *truncated = self.is_over && led_to.continues;
        *ending = ending_code(led_to.ending);
        episode.write_state(state);
        if self.is_over && task.autoreset == Autoreset::SameStep {
            last_state.copy_from_slice(state);
            self.reset(task, state)?;
        }
        Ok(())
    }
}

/// Returns the index of an ending in `crumple.env.ENDINGS`.
fn ending_code(ending: EpisodeEnding) -> u8 {
    match ending {
        EpisodeEnding::Contact => 1,
        EpisodeEnding::AtRest => 2,
        EpisodeEnding::TimeLimit => 3,
        _ => 0,
    }
}

/// Episodes of the training task that step together.
#[pyclass(frozen, module = "crumple")]
pub(crate) struct Episodes {
    task: EpisodeTask,
    sub_environments: Mutex<Vec<SubEnvironment>>,
}

#[pymethods]
impl Episodes {
    /// Creates episodes with random scenarios of a space, or of a training preset or file.
    #[new]
    fn new(
        py: Python<'_>,
        count: usize,
        space: Option<PyRef<'_, PySpace>>,
        preset: &str,
        estimator: Option<&str>,
        autoreset: &str,
    ) -> PyResult<Self> {
        if !(1..=MAX_EPISODES).contains(&count) {
            let problem = format!("there must be 1 to {MAX_EPISODES} environments, found {count}");
            return Err(PyValueError::new_err(problem));
        }
        let wrong = |error: &dyn std::fmt::Display| {
            errors::exception(py, ExceptionClass::Training, &error.to_string())
        };
        let mut config = load_training_config(py, preset)?;
        config.controllers = controllers();
        let source: Arc<dyn ScenarioSource> = match space {
            Some(space) => Arc::new(space.0.clone()),
            None => config.scenario_source().map_err(|error| wrong(&error))?,
        };
        let mut environment = config.environment;
        if let Some(estimator) = estimator {
            environment.estimator = parse_choice("estimator", estimator, &ESTIMATORS)?;
        }
        let known = [
            ("next-step", Autoreset::NextStep),
            ("same-step", Autoreset::SameStep),
            ("disabled", Autoreset::Disabled),
        ];
        let autoreset = parse_choice("autoreset", autoreset, &known)?;
        let constants = EpisodeConstants::new(environment, config.learning.discount);
        let task = EpisodeTask {
            source,
            config: constants,
            autoreset,
        };
        task.new_episode(0, 0).map_err(|error| wrong(&error))?;
        let lane = |seed| SubEnvironment {
            seed,
            next_index: 0,
            episode: None,
            is_over: false,
        };
        Ok(Self {
            task,
            sub_environments: Mutex::new((0..count as u64).map(lane).collect()),
        })
    }

    /// Clipping limit of the numbers of a state.
    #[getter]
    fn state_limit(&self) -> f64 {
        self.task.config.environment().observation.limit
    }

    /// Numbers of a state.
    #[getter]
    fn state_width(&self) -> usize {
        self.task.config.state_width()
    }

    /// Simulated time between two decisions, in seconds.
    #[getter]
    fn decision_s(&self) -> f64 {
        f64::from(self.task.config.environment().action_repeat)
            * crumple_sim::scenario::PAPER_STEP_S
    }

    /// Accelerations of the actions -1 and 1, in m/s².
    #[getter]
    fn acceleration_range_mps2(&self) -> (f64, f64) {
        let bounds = action_bounds(self.task.config.environment());
        (bounds.low_mps2, bounds.high_mps2)
    }

    /// Begins an episode in every sub-environment of `mask`, from then on with its seed in `seeds`, if any.
    fn reset(
        &self,
        py: Python<'_>,
        seeds: Vec<Option<u64>>,
        mask: PyReadonlyArray1<'_, bool>,
        mut states: PyReadwriteArray2<'_, f32>,
    ) -> PyResult<()> {
        let (mask, states, pool) = (mask.as_slice()?, states.as_slice_mut()?, threads::pool()?);
        let width = self.state_width();
        py.detach(|| {
            let mut lanes = self
                .sub_environments
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let count = lanes.len();
            check_lengths(&[mask.len(), states.len() / width, seeds.len()], count)?;
            let begin = |(index, ((lane, state), chosen)): (
                usize,
                ((&mut SubEnvironment, &mut [f32]), &bool),
            )| {
                if !chosen {
                    return Ok(());
                }
                if let Some(Some(seed)) = seeds.get(index) {
                    (lane.seed, lane.next_index) = (*seed, 0);
                }
                lane.reset(&self.task, state)
            };
            if pool.current_num_threads() == 1 {
                let mut rows = lanes
                    .iter_mut()
                    .zip(states.chunks_exact_mut(width))
                    .zip(mask)
                    .enumerate();
                return rows.try_for_each(begin);
            }
            let rows = lanes
                .par_iter_mut()
                .zip(states.par_chunks_exact_mut(width))
                .zip(mask)
                .enumerate();
            pool.install(|| {
                rows.with_min_len(MIN_EPISODES_PER_THREAD)
                    .try_for_each(begin)
            })
        })
        .map_err(|error| errors::exception(py, ExceptionClass::Training, &error))
    }

    /// Makes one decision in every sub-environment, from `actions` into the arrays.
    #[expect(
        clippy::too_many_arguments,
        reason = "one array for each thing that a step tells"
    )]
    fn step(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArray1<'_, f32>,
        mut states: PyReadwriteArray2<'_, f32>,
        mut last_states: PyReadwriteArray2<'_, f32>,
        mut rewards: PyReadwriteArray1<'_, f32>,
        mut terminated: PyReadwriteArray1<'_, bool>,
        mut truncated: PyReadwriteArray1<'_, bool>,
        mut endings: PyReadwriteArray1<'_, u8>,
    ) -> PyResult<()> {
        let (actions, states, last_states) = (
            actions.as_slice()?,
            states.as_slice_mut()?,
            last_states.as_slice_mut()?,
        );
        let (rewards, terminated, pool) = (
            rewards.as_slice_mut()?,
            terminated.as_slice_mut()?,
            threads::pool()?,
        );
        let (truncated, endings) = (truncated.as_slice_mut()?, endings.as_slice_mut()?);
        let width = self.state_width();
        py.detach(|| {
            let mut lanes = self
                .sub_environments
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            let widths = [
                actions.len(),
                states.len() / width,
                last_states.len() / width,
            ];
            check_lengths(&widths, lanes.len())?;
            check_lengths(
                &[
                    rewards.len(),
                    terminated.len(),
                    truncated.len(),
                    endings.len(),
                ],
                lanes.len(),
            )?;
            // Check all actions first: an error halfway would leave some sub-environments a step ahead.
            let refused = lanes.iter().zip(actions).enumerate();
            let mut refused = refused.filter_map(|(index, (lane, action))| {
                Some((index, lane.step_error(&self.task, *action)?))
            });
            if let Some((index, why)) = refused.next() {
                return Err(format!("environment {index}: {why}"));
            }
            let step =
                |((lane, action), results): ((&mut SubEnvironment, &f32), StepBuffers<'_>)| {
                    lane.step(&self.task, *action, results)
                };
            // Passing all work to a single other thread would take a tenth of the step's time.
            if pool.current_num_threads() == 1 {
                let states = states
                    .chunks_exact_mut(width)
                    .zip(last_states.chunks_exact_mut(width));
                let ends = terminated.iter_mut().zip(truncated).zip(endings);
                let results = states.zip(rewards.iter_mut().zip(ends));
                return lanes
                    .iter_mut()
                    .zip(actions)
                    .zip(results)
                    .try_for_each(step);
            }
            let states = states
                .par_chunks_exact_mut(width)
                .zip(last_states.par_chunks_exact_mut(width));
            let ends = terminated.par_iter_mut().zip(truncated).zip(endings);
            let rows = lanes
                .par_iter_mut()
                .zip(actions)
                .zip(states.zip(rewards.par_iter_mut().zip(ends)));
            pool.install(|| {
                rows.with_min_len(MIN_EPISODES_PER_THREAD)
                    .try_for_each(step)
            })
        })
        .map_err(|error| errors::exception(py, ExceptionClass::Training, &error))
    }

    /// Returns the positions of a sub-environment's vehicles, front to rear: front bumpers and lengths in metres. None
    /// before its first reset.
    fn positions(&self, lane: usize) -> Option<(Vec<f64>, Vec<f64>)> {
        let lanes = self
            .sub_environments
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let (scenario, episode) = lanes.get(lane)?.episode.as_ref()?;
        let position_m = episode.motion().iter().map(|at| at.position_m).collect();
        Some((
            position_m,
            scenario
                .vehicles()
                .iter()
                .map(|vehicle| vehicle.length_m())
                .collect(),
        ))
    }

    fn __len__(&self) -> usize {
        self.sub_environments
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .len()
    }
}

fn check_lengths(lengths: &[usize], lanes: usize) -> Result<(), String> {
    match lengths.iter().find(|length| **length != lanes) {
        Some(length) => Err(format!(
            "there are {lanes} environments, and an array for {length}"
        )),
        None => Ok(()),
    }
}

/// Returns the text of a preset of `crumple train`.
#[pyfunction]
pub(crate) fn training_preset(py: Python<'_>, name: &str) -> PyResult<&'static str> {
    TrainingConfig::preset_text(name)
        .map_err(|error| errors::exception(py, ExceptionClass::Training, &error))
}

/// Loads a preset of `crumple train` by name, from a file, or from a text of at least two lines.
fn load_training_config(py: Python<'_>, preset: &str) -> PyResult<TrainingConfig> {
    let wrong = |error: &dyn std::fmt::Display| {
        errors::exception(py, ExceptionClass::Training, &error.to_string())
    };
    if preset.contains('\n') {
        return TrainingConfig::parse(preset, std::path::Path::new("<toml>"))
            .map_err(|error| wrong(&error));
    }
    let path = std::path::Path::new(preset);
    if path.extension().is_none() {
        return TrainingConfig::preset(preset).map_err(|error| wrong(&error));
    }
    let text = text_file::read(path)
        .map_err(|error| errors::file_exception(py, ExceptionClass::Training, &error))?;
    TrainingConfig::parse(&text, path).map_err(|error| wrong(&error))
}
