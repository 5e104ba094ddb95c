//! Search for a leader that defeats the controller from a state outside an invariant set, by simulation.

use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::HeightTable;
use serde::Serialize;

use super::{InvalidBox, InvariantPlan};
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LeadProfile, PiecewiseAcceleration, Scenario};

/// Values per speed of the states that are tried, and shares of the boundary's height.
const STATES_PER_SPEED: usize = 8;
const HEIGHT_SHARES: [f64; 3] = [0.9, 0.6, 0.3];
/// Times for which the leader accelerates before it brakes, in seconds.
const ACCELERATES_S: [f64; 3] = [0.0, 2.0, 5.0];
const DURATION_S: f64 = 30.0;

/// A state outside the set from which a leader within the limits causes a collision in a simulation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Defeat {
    /// Initial gap, in metres.
    pub gap_m: f64,
    /// Initial own speed, in m/s.
    pub own_mps: f64,
    /// Initial speed of the leader, in m/s.
    pub leader_mps: f64,
    /// Time for which the leader accelerates as hard as it may, before it brakes as hard as it may, in seconds.
    pub leader_accelerates_s: f64,
}

impl InvariantPlan {
    /// Checks that states of the region, with any leader within the limits, can be simulated, as [`Self::defeat`] does.
    ///
    /// # Errors
    /// [`InvalidBox`] names the limit, or the field of the scenario.
    pub(super) fn check_can_simulate(&self) -> Result<(), InvalidBox> {
        if self.claim.motion == MotionModel::Relative {
            return Ok(());
        }
        let [brake, accelerate] = self.claim.leader_mps2;
        if let Some(leader) = self.scenario.vehicles().first() {
            let max_brake_mps2 = leader.max_brake_mps2();
            let max_accel_mps2 = leader.max_accel_mps2();
            if -brake > max_brake_mps2 || accelerate > max_accel_mps2 {
                let name = &self.scenario.spec().name;
                let problem = format!(
                    "must be within -{max_brake_mps2} to {max_accel_mps2} m/s², the limits of the leader in scenario \
                     `{name}`, found {brake} to {accelerate}"
                );
                return Err(InvalidBox::field("leader_mps2", problem));
            }
        }
        for leader_accelerates_s in ACCELERATES_S {
            let state = Defeat {
                // The search reports a region without gaps.
                gap_m: self.claim.region_gap_m.max(1.0),
                own_mps: self.claim.region_own_mps[1],
                leader_mps: self.claim.region_leader_mps[1],
                leader_accelerates_s,
            };
            self.run(&state)?;
        }
        Ok(())
    }

    /// Returns the run of an initial state with the true state as observation.
    fn run(&self, state: &Defeat) -> Result<Run, InvalidBox> {
        let options = RunOptions::new(self.controller.clone()).with_estimator(EstimatorKind::Truth);
        Ok(Run::new(&self.scenario_of(state)?, options)?)
    }

    /// Returns the scenario of an initial state with a leader that accelerates for a while and then brakes.
    ///
    /// # Errors
    /// [`InvalidBox`] if the state is no valid scenario.
    pub fn scenario_of(&self, state: &Defeat) -> Result<Scenario, InvalidBox> {
        let [brake, accelerate] = self.claim.leader_mps2;
        // The leader may not exceed the largest speed of the claim.
        let spare = (self.claim.region_leader_mps[1] - state.leader_mps).max(0.0);
        let gains_s = if accelerate > 0.0 {
            state.leader_accelerates_s.min(spare / accelerate)
        } else {
            0.0
        };
        let mut from_s = vec![0.0];
        let mut accel_mps2 = vec![brake];
        if state.leader_accelerates_s > 0.0 {
            from_s = vec![
                0.0,
                gains_s.max(1e-3),
                state.leader_accelerates_s.max(gains_s + 2e-3),
            ];
            accel_mps2 = vec![if gains_s > 1e-3 { accelerate } else { 0.0 }, 0.0, brake];
        }
        let scenario = self.scenario.edited(|spec| {
            spec.vehicles.truncate(2);
            spec.duration_s = DURATION_S;
            if let [leader, ego] = spec.vehicles.as_mut_slice() {
                (leader.speed_mps, ego.speed_mps) = (state.leader_mps, state.own_mps);
                leader.position_m = ego.position_m + state.gap_m + leader.length_m();
                leader.driver = Driver::Profile(LeadProfile::Pieces(PiecewiseAcceleration {
                    from_s,
                    accel_mps2,
                }));
            }
        });
        Ok(scenario?)
    }

    /// True if the simulation of a state ends with a collision.
    ///
    /// # Errors
    /// [`InvalidBox`] if the state cannot be simulated.
    pub fn collides(&self, state: &Defeat) -> Result<bool, InvalidBox> {
        Ok(simulate(&self.run(state)?, RecordingLevel::Summary).outcome != Outcome::NoCollision)
    }

    /// Searches below the boundary for the state with the largest gap from which a leader defeats the controller.
    ///
    /// # Errors
    /// [`InvalidBox`] if a state cannot be simulated.
    pub fn defeat(&self, table: &HeightTable) -> Result<Option<Defeat>, InvalidBox> {
        let mut largest: Option<Defeat> = None;
        if self.claim.motion == MotionModel::Relative {
            return Ok(None);
        }
        for own_mps in spread_speeds([0.0, table.axes()[0].high.min(self.claim.region_own_mps[1])])
        {
            for leader_mps in spread_speeds(self.claim.region_leader_mps) {
                let Some(height_m) = table.height_at([own_mps, leader_mps]) else {
                    continue;
                };
                for (share, leader_accelerates_s) in HEIGHT_SHARES
                    .into_iter()
                    .flat_map(|share| ACCELERATES_S.map(|time_s| (share, time_s)))
                {
                    let state = Defeat {
                        gap_m: share * height_m,
                        own_mps,
                        leader_mps,
                        leader_accelerates_s,
                    };
                    let is_larger = largest
                        .as_ref()
                        .is_none_or(|largest| largest.gap_m < state.gap_m);
                    if state.gap_m > 0.05 && is_larger && self.collides(&state)? {
                        largest = Some(state);
                    }
                }
            }
        }
        Ok(largest)
    }
}

/// Returns equally spaced speeds of a range, with both ends.
fn spread_speeds([low, high]: [f64; 2]) -> impl Iterator<Item = f64> {
    (0..=STATES_PER_SPEED).map(move |i| low + (high - low) * i as f64 / STATES_PER_SPEED as f64)
}
