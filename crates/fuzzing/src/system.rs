//! Interface between the oracles and the program.

use std::path::Path;
use std::sync::Arc;

use crumple_measure::CollisionRole;
use crumple_measure::stl::{Formula, MonitorError, SampledSignals};
use crumple_search::worst_case::{AvoidOptions, Avoidance, SearchEffort, avoid};
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource, ShieldSettings};
use crumple_sim::engine::{
    self, Collision, Motion, RecordingLevel, Run, ShieldedSource, SimulationResult, Stepper,
};
use crumple_sim::observation::Observation;
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::{ScenarioFileError, from_json, from_toml, to_toml};

/// The parts of the program that oracles check. Every method defaults to crumple's implementation. A test of an oracle
/// overrides one with a faulty implementation, which the oracle must detect.
pub trait System {
    /// Simulates one run, step by step.
    fn simulate(&self, run: &Run, keep: RecordingLevel) -> SimulationResult {
        engine::simulate(run, keep)
    }

    /// Simulates runs as a batch.
    fn simulate_batch(&self, runs: &[Run], keep: RecordingLevel) -> Vec<SimulationResult> {
        engine::simulate_batch(runs, keep, |_, simulated| simulated)
    }

    /// Passes the observation of every vehicle at every step to `each`, until it returns false.
    fn for_each_observation(
        &self,
        run: &Run,
        each: &mut dyn FnMut(&ObservationSample<'_>) -> bool,
    ) {
        let mut stepper = Stepper::new(run, RecordingLevel::Summary);
        while !stepper.has_ended() {
            for vehicle in 0..run.scenario().vehicles().len() {
                let Some(observation) = stepper.observe(vehicle) else {
                    continue;
                };
                let time_s = stepper.step_count() as f64 * run.scenario().spec().step_s;
                if !each(&ObservationSample {
                    vehicle,
                    time_s,
                    observation,
                    motion: stepper.motion(),
                }) {
                    return;
                }
            }
            stepper.step();
        }
    }

    /// Returns full throttle behind a shield.
    fn shielded_full_throttle(&self) -> Arc<dyn ControllerSource> {
        ShieldedSource {
            controller: BuiltInController::FullThrottle(Default::default()).into_source(),
            settings: ShieldSettings::default().into(),
        }
        .into_source()
    }

    /// Computes the best avoidance in a scenario; `None` if the scenario is not supported.
    fn avoid(&self, scenario: &Scenario) -> Option<Avoidance> {
        avoid(
            scenario,
            AvoidOptions {
                effort: SearchEffort::Decide,
                ..AvoidOptions::default()
            },
        )
        .ok()
    }

    /// Writes a scenario to a file format and reads it again.
    ///
    /// # Errors
    /// [`ScenarioFileError`] if the written text cannot be read.
    fn file_round_trip(
        &self,
        scenario: &Scenario,
        format: ScenarioFormat,
    ) -> Result<Scenario, ScenarioFileError> {
        format.read(&format.to_text(scenario))
    }

    /// Returns the robustness of a formula over time.
    ///
    /// # Errors
    /// [`MonitorError`], see [`Formula::robustness`].
    fn robustness_over_time(
        &self,
        formula: &Formula,
        signals: &SampledSignals<'_>,
    ) -> Result<Vec<f64>, MonitorError> {
        formula.robustness_over_time(signals)
    }

    /// True if a formula holds.
    ///
    /// # Errors
    /// [`MonitorError`], see [`Formula::is_satisfied`].
    fn is_satisfied(
        &self,
        formula: &Formula,
        signals: &SampledSignals<'_>,
    ) -> Result<bool, MonitorError> {
        formula.is_satisfied(signals)
    }

    /// Returns the role of the vehicles in a collision.
    fn collision_role(&self, collision: &Collision, scenario: &Scenario) -> CollisionRole {
        CollisionRole::new(collision, scenario)
    }
}

/// The program itself.
#[derive(Debug, Clone, Copy, Default)]
pub struct Crumple;

impl System for Crumple {}

/// Observation of one vehicle at one step, with the true state.
#[derive(Debug)]
pub struct ObservationSample<'m> {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Time, in seconds.
    pub time_s: f64,
    /// Observation of the vehicle.
    pub observation: Observation,
    /// True motion of all vehicles, front to rear.
    pub motion: &'m [Motion],
}

/// Format of a scenario file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScenarioFormat {
    /// TOML.
    Toml,
    /// JSON.
    Json,
}

impl ScenarioFormat {
    /// All formats.
    pub const ALL: [Self; 2] = [Self::Toml, Self::Json];

    /// Writes a scenario; empty text, which no reader accepts, if that fails.
    #[must_use]
    pub fn to_text(self, scenario: &Scenario) -> String {
        match self {
            Self::Toml => to_toml(scenario).unwrap_or_default(),
            Self::Json => serde_json::to_string_pretty(scenario.spec()).unwrap_or_default(),
        }
    }

    /// Reads a scenario; errors name the file `f.toml` or `f.json`.
    ///
    /// # Errors
    /// [`ScenarioFileError`] if the text is no scenario file.
    pub fn read(self, text: &str) -> Result<Scenario, ScenarioFileError> {
        match self {
            Self::Toml => from_toml(text, Path::new("f.toml"), &NoDriverFiles),
            Self::Json => from_json(text, Path::new("f.json"), &NoDriverFiles),
        }
    }
}
