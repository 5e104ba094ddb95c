//! Simulation of a leader's braking profiles, with counts of simulations and programs.

use super::attack::{Attack, AttackError, AttackObjective, Envelope};
use super::escape::script_pieces;
use crumple_core::observer::{Observer, RunProgress};
use crumple_sim::engine::{
    Outcome, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate_batch,
};
use crumple_sim::scenario::{Driver, InvalidField, LeadProfile, Scenario};

pub(super) struct ProfileSimulator<'a> {
    pub(super) scenario: &'a Scenario,
    pub(super) options: &'a RunOptions,
    pub(super) envelope: Envelope,
    /// Steps per cell, over which the leader's acceleration is held.
    pub(super) cell: usize,
    pub(super) evaluations: usize,
    pub(super) programs: usize,
    budget: usize,
    observer: &'a dyn Observer<RunProgress>,
}

#[derive(Debug, Clone)]
pub(super) struct ProfileOutcome {
    pub(super) outcome: Outcome,
    pub(super) margin_m: f64,
}

/// Maximum impact speed, in m/s: the maximum speed in scenarios.
const MAX_IMPACT_SPEED_MPS: f64 = 100.0;
/// Deceleration that converts an impact speed to a depth, v² / (2 a), in m/s².
const IMPACT_DECELERATION_MPS2: f64 = 5.0;

impl<'a> ProfileSimulator<'a> {
    pub(super) fn new(
        scenario: &'a Scenario,
        options: &'a RunOptions,
        envelope: Envelope,
        budget: usize,
        observer: &'a dyn Observer<RunProgress>,
    ) -> Self {
        let cell = (0.1 / scenario.spec().step_s).round().max(1.0) as usize;
        Self {
            scenario,
            options,
            envelope,
            cell,
            evaluations: 0,
            programs: 0,
            budget,
            observer,
        }
    }

    pub(super) fn cell_count(&self) -> usize {
        self.scenario.steps().div_ceil(self.cell)
    }

    pub(super) fn cell_s(&self) -> f64 {
        self.cell as f64 * self.scenario.spec().step_s
    }

    /// Returns the scenario with a profile, one acceleration per cell, as the leader's script.
    pub(super) fn with_leader_script(&self, cells_mps2: &[f64]) -> Result<Scenario, InvalidField> {
        let profile = LeadProfile::Pieces(script_pieces(cells_mps2, self.cell_s()));
        self.scenario.edited(|spec| {
            if let Some(leader) = spec.vehicles.first_mut() {
                leader.driver = Driver::Profile(profile);
            }
        })
    }

    pub(super) fn simulate(
        &mut self,
        profiles: &[Vec<f64>],
    ) -> Result<Vec<ProfileOutcome>, AttackError> {
        let scripted = profiles
            .iter()
            .map(|cells| self.with_leader_script(cells))
            .collect::<Result<Vec<_>, _>>()?;
        let runs = scripted
            .iter()
            .map(|scenario| Run::new(scenario, self.options.clone()))
            .collect::<Result<Vec<_>, RunError>>()?;
        self.evaluations += profiles.len();
        let trials = simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| {
            ProfileOutcome::from_simulated(&simulated)
        });
        self.observer.notify(&RunProgress {
            done: self.evaluations as u64,
            total: Some(self.budget as u64),
        })?;
        Ok(trials)
    }

    /// Returns ∫ a² of a leader with a profile of one acceleration per cell, until it stands or the run ends.
    fn effort_m2ps3(&self, cells_mps2: &[f64], outcome: &Outcome) -> f64 {
        let cell_s = self.cell_s();
        let end_s = match outcome {
            Outcome::Collision(collision) => collision.time_s,
            Outcome::ControllerFailed(failed) => failed.time_s,
            Outcome::NoCollision => f64::INFINITY,
        };
        let mut speed_mps = self
            .scenario
            .vehicles()
            .first()
            .map_or(0.0, |leader| leader.speed_mps);
        let mut effort_m2ps3 = 0.0;
        for (cell, &acceleration_mps2) in cells_mps2.iter().enumerate() {
            let left_s = (end_s - cell as f64 * cell_s).clamp(0.0, cell_s);
            let moving_s = if acceleration_mps2 < 0.0 {
                left_s.min(speed_mps / -acceleration_mps2)
            } else {
                left_s
            };
            effort_m2ps3 += acceleration_mps2.powi(2) * moving_s;
            speed_mps = (speed_mps + acceleration_mps2 * cell_s).max(0.0);
        }
        effort_m2ps3
    }

    pub(super) fn report(
        &mut self,
        cells_mps2: &[f64],
        predicted_margin_m: f64,
    ) -> Result<Attack, AttackError> {
        let scenario = self.with_leader_script(cells_mps2)?.edited(|spec| {
            spec.name = format!("{}-worst", spec.name.chars().take(190).collect::<String>());
            spec.about = format!(
                "Braking of the leader, found by convex programming from {}.",
                self.scenario.spec().name
            );
        })?;
        let run = Run::new(&scenario, self.options.clone())?;
        self.evaluations += 1;
        let trial = ProfileOutcome::from_simulated(&crumple_sim::engine::simulate(
            &run,
            RecordingLevel::Summary,
        ));
        Ok(Attack {
            outcome: trial.outcome.clone(),
            effort_m2ps3: self.effort_m2ps3(cells_mps2, &trial.outcome),
            peak_brake_mps2: AttackObjective::LeastPeak.cost(cells_mps2, self.cell_s()),
            predicted_margin_m,
            margin_m: trial.margin_m,
            evaluations: self.evaluations,
            programs: self.programs,
            scenario,
        })
    }
}

/// Returns the distance in which a vehicle would stop after an impact.
fn impact_depth_m(impact_mps: f64) -> f64 {
    impact_mps.powi(2) / (2.0 * IMPACT_DECELERATION_MPS2)
}

impl ProfileOutcome {
    /// Creates an outcome with the smallest gap, or minus v²/10 of an impact, so that the margin is smooth at a
    /// collision. A controller failure counts as an impact at the maximum speed.
    pub(super) fn from_simulated(simulated: &SimulationResult) -> Self {
        let margin_m = match &simulated.outcome {
            Outcome::ControllerFailed(_) => -impact_depth_m(MAX_IMPACT_SPEED_MPS),
            Outcome::Collision(collision) => -impact_depth_m(collision.impact_speed_mps),
            Outcome::NoCollision => simulated
                .vehicles
                .iter()
                .filter_map(|vehicle| vehicle.min_gap_m)
                .fold(f64::INFINITY, f64::min),
        };
        Self {
            outcome: simulated.outcome.clone(),
            margin_m,
        }
    }

    pub(super) fn collides(&self) -> bool {
        !self.outcome.is_safe()
    }

    pub(super) fn end_time_s(&self) -> Option<f64> {
        match &self.outcome {
            Outcome::NoCollision => None,
            Outcome::Collision(collision) => Some(collision.time_s),
            Outcome::ControllerFailed(failed) => Some(failed.time_s),
        }
    }
}
