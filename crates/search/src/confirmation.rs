//! Confirmation of counterexamples and escapes by a replay with the multi-body plant.
//!
//! The search and the convex programs use the plants of the scenario, by default point masses. A replay in closed loop
//! with [`CONFIRMING_PLANT`] shows which results depend on them. It decides nothing about other profiles: if an escape
//! collides in the replay, another one may exist.

use std::sync::Arc;

pub use crumple_measure::ReplayShare;
use crumple_sim::control::{Controller, ControllerFailure, ControllerSource, Ego};
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::{EstimatorKind, Observation};
use crumple_sim::scenario::{PlantKind, Scenario};

/// Plant of the replays.
pub const CONFIRMING_PLANT: PlantKind = PlantKind::MultiBody;

/// Demand per speed error of a vehicle that follows an escape, in 1/s.
const SPEED_GAIN_PER_S: f64 = 2.0;

/// Replays an escape with [`CONFIRMING_PLANT`]: each vehicle under test demands the accelerations, one per step of the
/// scenario, from its actuator, and corrects errors of its speed. Returns true if no vehicle collides; `None` if the
/// scenario cannot be run.
#[must_use]
pub fn escape_survives(scenario: &Scenario, acceleration_mps2: &[Vec<f64>]) -> Option<bool> {
    let first = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index))?;
    let with_plant = scenario.with_plant(CONFIRMING_PLANT).ok()?;
    // An escape is the motion of a vehicle whose driver knows the future, so that it has no delay.
    let immediate = with_plant.edited(|spec| {
        for vehicle in spec
            .vehicles
            .iter_mut()
            .skip(first)
            .take(acceleration_mps2.len())
        {
            (vehicle.reaction_delay_s, vehicle.actuator_delay_s) = (0.0, 0.0);
        }
    });
    let playback = DemandPlayback {
        first,
        demand_mps2: acceleration_mps2.to_vec(),
    };
    let options = RunOptions::new(Arc::new(playback)).with_estimator(EstimatorKind::Truth);
    let run = Run::new(&immediate.ok()?, options).ok()?;
    Some(simulate(&run, RecordingLevel::Summary).outcome == Outcome::NoCollision)
}

/// Source of controllers that follow prescribed accelerations, one per step.
struct DemandPlayback {
    /// Index of the vehicle with the first sequence.
    first: usize,
    demand_mps2: Vec<Vec<f64>>,
}

impl ControllerSource for DemandPlayback {
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        let own = ego
            .vehicle
            .checked_sub(self.first)
            .and_then(|index| self.demand_mps2.get(index));
        let demand_mps2 = own.cloned().unwrap_or_default().into_iter();
        Ok(Box::new(DemandSequence {
            demand_mps2,
            speed_mps: None,
            step_s: ego.step_s,
        }))
    }
}

struct DemandSequence {
    demand_mps2: std::vec::IntoIter<f64>,
    /// Speed of the escape; `None` before the first step.
    speed_mps: Option<f64>,
    step_s: f64,
}

impl Controller for DemandSequence {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let demand_mps2 = self.demand_mps2.next().unwrap_or(0.0);
        let speed_mps = self.speed_mps.unwrap_or(observation.speed_mps);
        self.speed_mps = Some((speed_mps + demand_mps2 * self.step_s).max(0.0));
        Ok(demand_mps2 + SPEED_GAIN_PER_S * (speed_mps - observation.speed_mps))
    }
}
