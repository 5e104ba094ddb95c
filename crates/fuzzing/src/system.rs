//! What the oracles question.

use std::path::Path;

use crumple_search::worst_case::{AvoidOptions, Avoidance, SearchEffort, avoid};
use crumple_world::control::{ControllerSpec, ShieldSettings};
use crumple_world::measure::ContactRole;
use crumple_world::measure::stl::{Formula, MonitorError, SampledSignals};
use crumple_world::observation::Observation;
use crumple_world::scenario::Scenario;
use crumple_world::scenario::file::{FileError, from_json, from_toml, to_toml};
use crumple_world::sim::{
    self, Contact, ControllerKind, Motion, RecordingLevel, Run, ShieldedSource, SimulationResult, Stepper,
};

/// The parts of the program that oracles question.
///
/// Every method is the program's own by default. An oracle's test overrides one of them by something wrong, and the
/// oracle must notice.
pub trait System {
    /// One run, step by step.
    fn simulate(&self, run: &Run, keep: RecordingLevel) -> SimulationResult {
        sim::simulate(run, keep)
    }

    /// Many runs in lockstep.
    fn simulate_batch(&self, runs: &[Run], keep: RecordingLevel) -> Vec<SimulationResult> {
        sim::simulate_batch(runs, keep, |_, simulated| simulated)
    }

    /// Shows what every vehicle sees at every step, until `each` has seen enough and says false.
    fn for_each_observation(&self, run: &Run, each: &mut dyn FnMut(&ObservationSample<'_>) -> bool) {
        let mut stepper = Stepper::new(run, RecordingLevel::Summary);
        while !stepper.has_ended() {
            for vehicle in 0..run.scenario().vehicles().len() {
                let Some(seen) = stepper.observe(vehicle) else { continue };
                let time_s = stepper.step_count() as f64 * run.scenario().spec().step_s;
                if !each(&ObservationSample { vehicle, time_s, observation: seen, motion: stepper.motion() }) {
                    return;
                }
            }
            stepper.step();
        }
    }

    /// Full throttle behind a shield.
    fn shielded_full_throttle(&self) -> ControllerKind {
        ShieldedSource {
            controller: ControllerSpec::FullThrottle(Default::default()).into(),
            settings: ShieldSettings::default(),
        }
        .into()
    }

    /// What the best driver could have done in a scenario; none if that cannot be asked of it.
    fn avoid(&self, scenario: &Scenario) -> Option<Avoidance> {
        avoid(scenario, AvoidOptions { effort: SearchEffort::Decide, ..AvoidOptions::default() }).ok()
    }

    /// A scenario written to a file and read again.
    ///
    /// # Errors
    /// [`FileError`] if what was written cannot be read.
    fn file_round_trip(&self, scenario: &Scenario, format: ScenarioFormat) -> Result<Scenario, FileError> {
        let text = format.to_text(scenario);
        match format {
            ScenarioFormat::Toml => from_toml(&text, Path::new("test_case.toml")),
            ScenarioFormat::Json => from_json(&text, Path::new("test_case.json")),
        }
    }

    /// The robustness of a formula over time.
    ///
    /// # Errors
    /// [`MonitorError`] as [`Formula::robustness`].
    fn robustness_over_time(&self, formula: &Formula, signals: &SampledSignals<'_>) -> Result<Vec<f64>, MonitorError> {
        formula.robustness_over_time(signals)
    }

    /// Whether a formula holds.
    ///
    /// # Errors
    /// [`MonitorError`] as [`Formula::is_satisfied`].
    fn is_satisfied(&self, formula: &Formula, signals: &SampledSignals<'_>) -> Result<bool, MonitorError> {
        formula.is_satisfied(signals)
    }

    /// Whose contact it is.
    fn contact_role(&self, contact: &Contact, scenario: &Scenario) -> ContactRole {
        ContactRole::new(contact, scenario)
    }
}

/// The program as it is.
#[derive(Debug, Clone, Copy, Default)]
pub struct Crumple;

impl System for Crumple {}

/// What one vehicle sees at one step, and what is true.
#[derive(Debug)]
pub struct ObservationSample<'m> {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// When, in seconds.
    pub time_s: f64,
    /// What it sees.
    pub observation: Observation,
    /// Where every vehicle is, front to rear.
    pub motion: &'m [Motion],
}

/// The formats of scenario files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScenarioFormat {
    /// TOML.
    Toml,
    /// JSON.
    Json,
}

impl ScenarioFormat {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Toml, Self::Json];

    /// A scenario in this format; empty if it cannot be written, which no reader accepts.
    #[must_use]
    pub fn to_text(self, scenario: &Scenario) -> String {
        match self {
            Self::Toml => to_toml(scenario).unwrap_or_default(),
            Self::Json => serde_json::to_string_pretty(scenario.spec()).unwrap_or_default(),
        }
    }
}
