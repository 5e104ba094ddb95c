//! Episodes of the training task in batches, for the Gymnasium environments.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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
use rayon::ThreadPool;
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

const AUTORESETS: [(&str, Autoreset); 3] = [
    ("next-step", Autoreset::NextStep),
    ("same-step", Autoreset::SameStep),
    ("disabled", Autoreset::Disabled),
];

/// Source and configuration of the episodes.
struct EpisodeTask {
    source: Arc<dyn ScenarioSource>,
    config: Arc<EpisodeConstants>,
    autoreset: Autoreset,
}

impl EpisodeTask {
    fn new_episode(&self, seed: u64, index: u64) -> Result<ScenarioEpisode, String> {
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
        Ok(ScenarioEpisode {
            episode: TrainingEpisode::new(&run, &constants),
            scenario,
        })
    }
}

/// An episode with its scenario.
struct ScenarioEpisode {
    scenario: Scenario,
    episode: TrainingEpisode,
}

/// Sequence of episodes of one seed.
struct SubEnvironment {
    seed: u64,
    next_index: u64,
    current: Option<ScenarioEpisode>,
    is_over: bool,
}

/// Destination of the results of one sub-environment's step: state and last state; reward, and whether the episode was
/// terminated or truncated, with the code of its ending.
type StepBuffers<'a> = (
    (&'a mut [f32], &'a mut [f32]),
    (&'a mut f32, ((&'a mut bool, &'a mut bool), &'a mut u8)),
);

/// Arrays for the results of a step of all sub-environments.
struct StepArrays<'a> {
    states: &'a mut [f32],
    last_states: &'a mut [f32],
    rewards: &'a mut [f32],
    terminated: &'a mut [bool],
    truncated: &'a mut [bool],
    endings: &'a mut [u8],
}

impl StepArrays<'_> {
    /// Returns the number of sub-environments of each array, with `width` numbers in a state.
    fn lengths(&self, width: usize) -> [usize; 6] {
        [
            self.states.len() / width,
            self.last_states.len() / width,
            self.rewards.len(),
            self.terminated.len(),
            self.truncated.len(),
            self.endings.len(),
        ]
    }
}

impl SubEnvironment {
    fn new(seed: u64) -> Self {
        Self {
            seed,
            next_index: 0,
            current: None,
            is_over: false,
        }
    }

    /// Begins an episode, from then on with another seed if there is one.
    fn begin(
        &mut self,
        task: &EpisodeTask,
        seed: Option<u64>,
        state: &mut [f32],
    ) -> Result<(), String> {
        if let Some(seed) = seed {
            self.seed = seed;
            self.next_index = 0;
        }
        self.reset(task, state)
    }

    fn reset(&mut self, task: &EpisodeTask, state: &mut [f32]) -> Result<(), String> {
        let mut next = task.new_episode(self.seed, self.next_index)?;
        self.next_index += 1;
        next.episode.write_state(state);
        self.current = Some(next);
        self.is_over = false;
        Ok(())
    }

    /// Returns the reason why the next step is impossible, if any.
    fn step_error(&self, task: &EpisodeTask, action: f32) -> Option<&'static str> {
        if self.is_over && task.autoreset == Autoreset::NextStep {
            return None;
        }
        match &self.current {
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
        let Some(current) = self.current.as_mut().filter(|_| !self.is_over) else {
            return Err(MUST_BE_RESET.to_owned());
        };
        let outcome = current.episode.step(action.clamp(-1.0, 1.0));
        self.is_over = outcome.ending != EpisodeEnding::None;
        *reward = outcome.reward;
        *terminated = self.is_over && !outcome.continues;
        *truncated = self.is_over && outcome.continues;
        *ending = ending_code(outcome.ending);
        current.episode.write_state(state);
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
        EpisodeEnding::Collision => 1,
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
        let mut config = load_training_config(py, preset)?;
        config.controllers = controllers();
        let source: Arc<dyn ScenarioSource> = match space {
            Some(space) => Arc::new(space.0.clone()),
            None => config
                .scenario_source()
                .map_err(|error| training_error(py, &error))?,
        };
        let mut environment = config.environment;
        if let Some(estimator) = estimator {
            environment.estimator = parse_choice("estimator", estimator, &ESTIMATORS)?;
        }
        let task = EpisodeTask {
            source,
            config: EpisodeConstants::new(environment, config.learning.discount),
            autoreset: parse_choice("autoreset", autoreset, &AUTORESETS)?,
        };
        task.new_episode(0, 0)
            .map_err(|error| training_error(py, &error))?;
        Ok(Self {
            task,
            sub_environments: Mutex::new((0..count as u64).map(SubEnvironment::new).collect()),
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
        let mask = mask.as_slice()?;
        let states = states.as_slice_mut()?;
        let pool = threads::pool(None)?;
        py.detach(|| self.reset_masked(&pool, &seeds, mask, states))
            .map_err(|error| training_error(py, &error))
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
        let actions = actions.as_slice()?;
        let arrays = StepArrays {
            states: states.as_slice_mut()?,
            last_states: last_states.as_slice_mut()?,
            rewards: rewards.as_slice_mut()?,
            terminated: terminated.as_slice_mut()?,
            truncated: truncated.as_slice_mut()?,
            endings: endings.as_slice_mut()?,
        };
        let pool = threads::pool(None)?;
        py.detach(|| self.step_all(&pool, actions, arrays))
            .map_err(|error| training_error(py, &error))
    }

    /// Returns the positions of a sub-environment's vehicles, front to rear: front bumpers and lengths in metres. None
    /// before its first reset.
    fn positions(&self, lane: usize) -> Option<(Vec<f64>, Vec<f64>)> {
        let lanes = self.lock();
        let ScenarioEpisode { scenario, episode } = lanes.get(lane)?.current.as_ref()?;
        let position_m = episode
            .motion()
            .iter()
            .map(|motion| motion.position_m)
            .collect();
        let length_m = scenario
            .vehicles()
            .iter()
            .map(|vehicle| vehicle.length_m())
            .collect();
        Some((position_m, length_m))
    }

    fn __len__(&self) -> usize {
        self.lock().len()
    }
}

impl Episodes {
    fn lock(&self) -> MutexGuard<'_, Vec<SubEnvironment>> {
        self.sub_environments
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins an episode in every sub-environment of `mask`.
    fn reset_masked(
        &self,
        pool: &ThreadPool,
        seeds: &[Option<u64>],
        mask: &[bool],
        states: &mut [f32],
    ) -> Result<(), String> {
        let width = self.state_width();
        let mut lanes = self.lock();
        let lanes = lanes.as_mut_slice();
        check_lengths(
            &[mask.len(), states.len() / width, seeds.len()],
            lanes.len(),
        )?;
        if pool.current_num_threads() == 1 {
            return lanes
                .iter_mut()
                .zip(states.chunks_exact_mut(width))
                .zip(mask.iter().zip(seeds))
                .filter(|(_, (chosen, _))| **chosen)
                .try_for_each(|((lane, state), (_, seed))| lane.begin(&self.task, *seed, state));
        }
        pool.install(|| {
            lanes
                .par_iter_mut()
                .zip(states.par_chunks_exact_mut(width))
                .zip(mask.par_iter().zip(seeds))
                .with_min_len(MIN_EPISODES_PER_THREAD)
                .filter(|(_, (chosen, _))| **chosen)
                .try_for_each(|((lane, state), (_, seed))| lane.begin(&self.task, *seed, state))
        })
    }

    /// Makes one decision in every sub-environment.
    fn step_all(
        &self,
        pool: &ThreadPool,
        actions: &[f32],
        arrays: StepArrays<'_>,
    ) -> Result<(), String> {
        let width = self.state_width();
        let mut lanes = self.lock();
        check_lengths(&[actions.len()], lanes.len())?;
        check_lengths(&arrays.lengths(width), lanes.len())?;
        // Check all actions first: an error halfway would leave some sub-environments a step ahead.
        for (index, (lane, action)) in lanes.iter().zip(actions).enumerate() {
            if let Some(problem) = lane.step_error(&self.task, *action) {
                return Err(format!("environment {index}: {problem}"));
            }
        }
        // Passing all work to a single other thread would take a tenth of the step's time.
        if pool.current_num_threads() == 1 {
            let states = arrays
                .states
                .chunks_exact_mut(width)
                .zip(arrays.last_states.chunks_exact_mut(width));
            let ends = arrays
                .terminated
                .iter_mut()
                .zip(arrays.truncated)
                .zip(arrays.endings);
            let results = states.zip(arrays.rewards.iter_mut().zip(ends));
            return lanes
                .iter_mut()
                .zip(actions)
                .zip(results)
                .try_for_each(|((lane, action), results)| lane.step(&self.task, *action, results));
        }
        let states = arrays
            .states
            .par_chunks_exact_mut(width)
            .zip(arrays.last_states.par_chunks_exact_mut(width));
        let ends = arrays
            .terminated
            .par_iter_mut()
            .zip(arrays.truncated)
            .zip(arrays.endings);
        let rows = lanes
            .par_iter_mut()
            .zip(actions)
            .zip(states.zip(arrays.rewards.par_iter_mut().zip(ends)));
        pool.install(|| {
            rows.with_min_len(MIN_EPISODES_PER_THREAD)
                .try_for_each(|((lane, action), results)| lane.step(&self.task, *action, results))
        })
    }
}

fn training_error(py: Python<'_>, error: &impl std::fmt::Display) -> PyErr {
    errors::exception(py, ExceptionClass::Training, error)
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
    TrainingConfig::preset_text(name).map_err(|error| training_error(py, &error))
}

/// Loads a preset of `crumple train` by name, from a file, or from a text of at least two lines.
pub(crate) fn load_training_config(py: Python<'_>, preset: &str) -> PyResult<TrainingConfig> {
    if preset.contains('\n') {
        return TrainingConfig::parse(preset, std::path::Path::new("<toml>"))
            .map_err(|error| training_error(py, &error));
    }
    let path = std::path::Path::new(preset);
    if path.extension().is_none() {
        return TrainingConfig::preset(preset).map_err(|error| training_error(py, &error));
    }
    let text = text_file::read(path)
        .map_err(|error| errors::file_exception(py, ExceptionClass::Training, &error))?;
    TrainingConfig::parse(&text, path).map_err(|error| training_error(py, &error))
}
