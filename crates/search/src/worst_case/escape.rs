//! Escapes as scenarios, and their replay in the simulator.

use serde::{Deserialize, Serialize};

use super::avoidance_problem::AvoidanceProblem;
use super::emergency_brake::EmergencyBrake;
use super::firing_search::ModelEscape;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, InvalidField, LeadProfile, PiecewiseAcceleration, Scenario, VehicleSpec,
};

/// Search that found an escape. A replay confirms it in any case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FoundBy {
    /// Convex programs, which model every driver behind.
    Programs,
    /// Simulations in closed loop, because the programs do not model all drivers.
    ClosedLoop {
        /// Number of simulations.
        simulations: usize,
    },
}

/// Method of the search that found an escape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EscapeMethod {
    /// [`FoundBy::Programs`].
    Programs,
    /// [`FoundBy::ClosedLoop`].
    ClosedLoop,
}

impl FoundBy {
    /// Returns the method of the search.
    #[must_use]
    pub fn method(self) -> EscapeMethod {
        match self {
            Self::Programs => EscapeMethod::Programs,
            Self::ClosedLoop { .. } => EscapeMethod::ClosedLoop,
        }
    }

    fn description(self) -> &'static str {
        match self {
            Self::Programs => "by convex programming",
            Self::ClosedLoop { .. } => "by simulation with the other drivers in the loop",
        }
    }
}

/// An escape that was replayed.
#[derive(Debug, Clone, PartialEq)]
pub struct Escape {
    /// Scenario with a script in place of every vehicle under test, without collision.
    pub scenario: Scenario,
    /// Smallest gap between any two vehicles at any instant, in metres, at a tenth of the scenario's step.
    pub min_gap_m: f64,
    /// Search that found it.
    pub found_by: FoundBy,
    /// Emergency brakes behind the vehicles under test, in the replay at the scenario's step.
    pub emergency_brake: EmergencyBrake,
    /// Acceleration of each vehicle under test over each step, in m/s².
    pub acceleration_mps2: Vec<Vec<f64>>,
}

impl Escape {
    /// Replays an escape of the model at the full step and at a tenth of it; `None` after a collision.
    pub(super) fn replay(
        scenario: &Scenario,
        problem: &AvoidanceProblem,
        escape: &ModelEscape,
    ) -> Option<Self> {
        Self::from_accelerations(
            scenario,
            1,
            step_accelerations_mps2(problem, escape),
            FoundBy::Programs,
        )
    }

    /// Replays accelerations of the vehicles from index `first` at both steps; `None` after a collision.
    pub(super) fn from_accelerations(
        scenario: &Scenario,
        first: usize,
        acceleration_mps2: Vec<Vec<f64>>,
        found_by: FoundBy,
    ) -> Option<Self> {
        let behind = first + acceleration_mps2.len();
        let acceleration_mps2: Vec<Vec<f64>> = (first..)
            .zip(acceleration_mps2)
            .map(|(index, steps_mps2)| round_accelerations(scenario, index, steps_mps2))
            .collect();
        let scripted = with_scripts(scenario, first, &acceleration_mps2, found_by).ok()?;
        let run = Run::new(&scripted, scripted_run_options()).ok()?;
        let coarse = simulate(&run, RecordingLevel::Trace);
        let run = Run::new(
            &scripted,
            scripted_run_options().with_dt_s(0.1 * scripted.spec().step_s),
        )
        .ok()?;
        let fine = simulate(&run, RecordingLevel::Summary);
        if coarse.outcome != Outcome::NoCollision || fine.outcome != Outcome::NoCollision {
            return None;
        }
        let gaps = fine.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m);
        let min_gap_m = gaps.fold(f64::INFINITY, f64::min);
        let emergency_brake = EmergencyBrake::from_trace(&scripted, behind, coarse.trace.as_ref()?);
        Some(Self {
            scenario: scripted,
            min_gap_m,
            found_by,
            emergency_brake,
            acceleration_mps2,
        })
    }

    /// Returns the time at which the first emergency brake behind fires, in seconds; `None` if no brake fires.
    #[must_use]
    pub fn trigger_time_s(&self) -> Option<f64> {
        match self.emergency_brake {
            EmergencyBrake::Fires { time_s, .. } => Some(time_s),
            EmergencyBrake::NeverFires | EmergencyBrake::Unknown => None,
        }
    }

    /// Returns Σ ∫ a² of the vehicles under test, in m²/s³, a measure of roughness.
    #[must_use]
    pub fn effort_m2ps3(&self) -> f64 {
        let step_s = self.scenario.spec().step_s;
        self.acceleration_mps2
            .iter()
            .flatten()
            .map(|a| a * a * step_s)
            .sum()
    }
}

/// Rounds the accelerations of a vehicle. Rounding up must not exceed full braking.
fn round_accelerations(scenario: &Scenario, vehicle: usize, steps_mps2: Vec<f64>) -> Vec<f64> {
    let brake_mps2 = scenario.usable_brake_mps2(vehicle);
    let accel_mps2 = scenario
        .vehicles()
        .get(vehicle)
        .map_or(0.0, |vehicle| vehicle.max_accel_mps2());
    steps_mps2
        .into_iter()
        .map(|step_mps2| {
            round_acceleration(step_mps2)
                .max(-brake_mps2)
                .min(accel_mps2)
        })
        .collect()
}

/// Rounds to 1e-6 m/s², as a solver's last digits differ between machines; the replay uses the rounded values.
fn round_acceleration(acceleration_mps2: f64) -> f64 {
    const UNIT: f64 = 1e6;
    (acceleration_mps2 * UNIT).round() / UNIT + 0.0
}

pub(super) fn scripted_run_options() -> RunOptions {
    RunOptions::new(BuiltInController::MatchLeader(Default::default()))
        .with_estimator(EstimatorKind::Truth)
}

pub(super) fn step_accelerations_mps2(
    problem: &AvoidanceProblem,
    escape: &ModelEscape,
) -> Vec<Vec<f64>> {
    escape
        .acceleration_mps2
        .iter()
        .map(|cells| expand_cells(escape, problem.steps, cells))
        .collect()
}

fn expand_cells(escape: &ModelEscape, steps: usize, cells: &[f64]) -> Vec<f64> {
    let mut steps_mps2 = Vec::with_capacity(steps);
    for (pair, &cell_mps2) in escape.grid.steps.windows(2).zip(cells) {
        let length = pair
            .last()
            .zip(pair.first())
            .map_or(0, |(to, from)| to - from);
        steps_mps2.extend(std::iter::repeat_n(cell_mps2, length));
    }
    steps_mps2
}

fn with_scripts(
    scenario: &Scenario,
    first: usize,
    acceleration_mps2: &[Vec<f64>],
    found_by: FoundBy,
) -> Result<Scenario, InvalidField> {
    let step_s = scenario.spec().step_s;
    scenario.edited(|spec| {
        spec.name = format!("{}-escape", spec.name.chars().take(190).collect::<String>());
        spec.about = format!(
            "An escape from {}, found {}.",
            scenario.spec().name,
            found_by.description()
        );
        for (vehicle, steps_mps2) in spec.vehicles.iter_mut().skip(first).zip(acceleration_mps2) {
            set_script(vehicle, script_pieces(steps_mps2, step_s));
        }
    })
}

pub(super) fn set_script(vehicle: &mut VehicleSpec, pieces: PiecewiseAcceleration) {
    vehicle.driver = Driver::Profile(LeadProfile::Pieces(pieces));
    // The profile is the motion itself, so a script has no delay.
    (vehicle.reaction_delay_s, vehicle.actuator_delay_s) = (0.0, 0.0);
}

pub(super) fn script_pieces(steps_mps2: &[f64], step_s: f64) -> PiecewiseAcceleration {
    let mut pieces = PiecewiseAcceleration {
        from_s: Vec::new(),
        accel_mps2: Vec::new(),
    };
    for (step, &step_mps2) in steps_mps2.iter().enumerate() {
        if pieces.accel_mps2.last() != Some(&step_mps2) {
            pieces.from_s.push(step as f64 * step_s);
            pieces.accel_mps2.push(step_mps2);
        }
    }
    pieces
}
