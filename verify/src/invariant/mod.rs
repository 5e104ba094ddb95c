//! Invariant sets: states from which a controller never collides with the leader, for any duration.
//!
//! # Model
//! A vehicle under test at own speed v follows a leader at speed w with a gap g. Every T seconds the controller
//! commands an acceleration from observations within stated errors of (g, v, w), which the actuator applies at once.
//! The leader accelerates arbitrarily within [-b, a], also between decisions. No vehicle reverses. The *relative* model
//! has only the gap and the closing speed v - w, which may be negative, and no standstill.
//!
//! # Set
//! S = {g ≥ h(x)}, with x the state without the gap. The [`table`] of heights is linear on each simplex. All gaps above
//! the boundary belong to S, without a limit.
//!
//! # Condition
//! For every state in S and every motion of the leader over T seconds, g' ≥ h(x'). Let λ = g - h(x) ≥ 0. The segment
//! from x to x' stays in the table, and h changes along it by the integral of its slope, so
//!
//! ```text
//! g' - h(x') ≥ λ + Δg - maximum of slope · (x' - x) on the simplices that the segment meets
//! ```
//!
//! The check bounds the right side for each cell, with intervals for x, Δg and x' - x, and over all simplices of the
//! cells that x and x' bound. Only a layer above the boundary matters: for λ above the right side's shortfall with
//! *any* command within the vehicle's limits, the state stays in S. Within the layer the command is bounded over the
//! observations. If a part of a cell fails, the check divides its ranges and λ, at most `splits` times.
//!
//! The leader is bounded by its hardest braking over the interval: distance and speed both grow with its acceleration
//! at each instant. See [`motion`](crate::motion) for stops.
//!
//! # Between decisions
//! g'' is at most m = a + (hardest braking of the vehicle), also at stops. So over the interval g is at least the
//! smaller one of g and g', less m T²/8. Every height must exceed m T²/8 (see [`avoidable`](crate::avoidable)). Hence
//! no state of S collides before the next decision, and the next state is in S: by induction, never.
//!
//! # Where the claim ends
//! At a gap beyond `ends_beyond_gap_m`, if that is stated, and at a speed beyond the table. For the leader this is a
//! limit, as its acceleration is. The check also proves for some controllers that the own speed never exceeds the
//! table (`own_speed_is_kept`). In the relative model, a closing speed below the table counts as that of the first
//! node: the heights of all nodes that one decision can reach from there must be equal, and the gap then grows.
//!
//! # Rounding
//! All operations are those of [`interval`](crate::interval); nodes are double-precision numbers and heights exact. The
//! bounds of networks include those of single precision: see [`controller`](crate::reach::controller). Motion is that
//! of real numbers; the rounding of a simulator belongs to the observation errors.

mod claim;
mod command;
mod share;
mod step;
pub mod table;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::claim::ConstantPiece;
use crate::interval::Interval;
use crate::reach::{FollowerLaw, NetworkFileSource, load_controller};
use crate::rejection::Rejection;
use crate::work::{OpBudget, WorkLimit};
use command::CommandModel;
use step::ClosedLoop;
use table::{AXIS_COUNT, HeightTable, MAX_NODES, TableAxis};

const MAX_SPLITS: u32 = 4;
const MAX_DECISION_STEPS: u32 = 10_000;
/// Gap up to which the check bounds commands to prove that the own speed stays in the table, in metres.
const FARTHEST_GAP_M: f64 = 1e9;

/// A claim that a controller keeps a set of states, in which no gap is zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InvariantClaim {
    /// Model of motion.
    pub motion: MotionModel,
    /// Controller of the vehicle under test.
    pub controller: InvariantController,
    /// h, the step of the actuator, in seconds.
    pub step_s: f64,
    /// Steps between decisions.
    pub decision_steps: u32,
    /// Hardest braking, negative, and largest acceleration of the vehicle under test, in m/s².
    pub own_mps2: [f64; 2],
    /// Hardest braking, negative, and largest acceleration of the leader, in m/s².
    pub leader_mps2: [f64; 2],
    /// Largest errors of the observed gap in metres, and of the observed own and leader's speed in m/s.
    pub observation_error: [f64; 3],
    /// Region of which the set covers a share: the gap is from 0 to this, in metres.
    pub region_gap_m: f64,
    /// Gap beyond which the claim ends, in metres; at least `region_gap_m`. Absent: the claim covers all gaps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ends_beyond_gap_m: Option<f64>,
    /// Own speed in the region, in m/s; in the relative model the closing speed.
    pub region_own_mps: [f64; 2],
    /// Leader's speed in the region, in m/s; a single number in the relative model.
    pub region_leader_mps: [f64; 2],
    /// Largest initial own speed of the claim, in m/s.
    pub initial_own_mps_at_most: f64,
    /// Own and leader's speed of the nodes.
    pub axes: [TableAxis; AXIS_COUNT],
    /// Number of times that the check may divide a cell.
    pub splits: u32,
    /// Boundary: see [`HeightTable::to_runs`].
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_NODES, _, _>")]
    pub heights: Vec<ConstantPiece<i64>>,
    /// Share of the region's volume in the set.
    pub share_at_least: f64,
    /// Lower bound of all gaps, in metres.
    pub min_gap_m_at_least: f64,
}

/// A model of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionModel {
    /// Both speeds; no vehicle reverses.
    Absolute,
    /// Gap and closing speed alone, without standstill.
    Relative,
}

/// A memoryless controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InvariantController {
    /// A control law.
    Law(FollowerLaw),
    /// A policy or network.
    Network(NetworkReference),
}

/// The file of a policy or network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkReference {
    /// File name, in the certificate's folder.
    pub policy_file: String,
    /// SHA-256 of the file, in hexadecimal.
    pub policy_sha256: String,
    /// Source file of an imported network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<NetworkFileSource>,
}

impl InvariantClaim {
    /// Returns the network, if a network is the controller.
    #[must_use]
    pub fn network(&self) -> Option<&NetworkReference> {
        match &self.controller {
            InvariantController::Law(_) => None,
            InvariantController::Network(network) => Some(network),
        }
    }

    /// Returns the smallest height that the proof between decisions allows, in metres: larger than m T²/8.
    #[must_use]
    pub fn floor_m(&self) -> f64 {
        let most = Interval::point(self.leader_mps2[1].max(0.0))
            - Interval::point(self.own_mps2[0].min(0.0));
        (most * self.interval_s().sqr() * Interval::point(0.125)).high()
    }

    fn interval_s(&self) -> Interval {
        Interval::point(self.step_s) * Interval::point(f64::from(self.decision_steps))
    }

    /// Checks limits and controller, without the set.
    ///
    /// # Errors
    /// [`Rejection`] if the claim is invalid or the policy file does not fit.
    pub fn check_model(&self, policy: Option<&[u8]>) -> Result<(), Rejection> {
        self.closed_loop(policy, &OpBudget::new(WorkLimit::UNLIMITED))
            .map(drop)
    }

    /// Returns the cells of a boundary for which the check fails.
    ///
    /// # Errors
    /// [`Rejection`] if the claim is invalid or the policy file does not fit.
    pub fn failing_cells(
        &self,
        policy: Option<&[u8]>,
        table: &HeightTable,
    ) -> Result<Vec<usize>, Rejection> {
        let unlimited = OpBudget::new(WorkLimit::UNLIMITED);
        let failing = failing_cells(&self.closed_loop(policy, &unlimited)?, table, usize::MAX);
        Ok(failing.into_iter().map(|(index, _)| index).collect())
    }

    fn closed_loop<'a>(
        &'a self,
        policy: Option<&[u8]>,
        budget: &'a OpBudget,
    ) -> Result<ClosedLoop<'a>, Rejection> {
        let own_mps2 = acceleration_range(self.own_mps2, "own_mps2")?;
        let leader_mps2 = acceleration_range(self.leader_mps2, "leader_mps2")?;
        self.check_numbers()?;
        let command = self.command_model(policy, [own_mps2, leader_mps2])?;
        command.check_inputs(self.motion)?;
        Ok(ClosedLoop {
            motion: self.motion,
            command,
            interval_s: self.interval_s(),
            own_mps2,
            leader_mps2,
            error: self.observation_error,
            splits: self.splits,
            ends_beyond_gap_m: self.ends_beyond_gap_m.unwrap_or(f64::INFINITY),
            budget,
        })
    }

    /// Checks times, observation errors, the largest gap and the number of splits.
    fn check_numbers(&self) -> Result<(), Rejection> {
        if !(self.step_s > 0.0
            && self.step_s.is_finite()
            && (1..=MAX_DECISION_STEPS).contains(&self.decision_steps))
        {
            return Err(Rejection::invalid(
                "step_s",
                "and `decision_steps` must be positive",
            ));
        }
        if !self
            .observation_error
            .iter()
            .all(|error| *error >= 0.0 && error.is_finite())
        {
            return Err(Rejection::invalid(
                "observation_error",
                "is negative or infinite",
            ));
        }
        if !self
            .ends_beyond_gap_m
            .is_none_or(|gap_m| gap_m >= self.region_gap_m && gap_m.is_finite())
        {
            return Err(Rejection::invalid(
                "ends_beyond_gap_m",
                "is below the gap of the region, or infinite",
            ));
        }
        if self.splits > MAX_SPLITS {
            return Err(Rejection::invalid("splits", "is too large"));
        }
        Ok(())
    }

    fn command_model(
        &self,
        policy: Option<&[u8]>,
        accelerations_mps2: [Interval; 2],
    ) -> Result<CommandModel<'_>, Rejection> {
        match &self.controller {
            InvariantController::Law(law) => {
                law.validate()?;
                Ok(CommandModel::Law(law))
            }
            InvariantController::Network(network) => {
                let loaded =
                    load_controller(policy, &network.policy_sha256, network.source.as_ref())?;
                let steps = loaded.decision_interval_s / self.step_s;
                if (steps - f64::from(self.decision_steps)).abs() > 1e-9 * steps {
                    return Err(Rejection::invalid(
                        "decision_steps",
                        "is not the decision interval of the network",
                    ));
                }
                Ok(CommandModel::Network(Box::new(loaded), accelerations_mps2))
            }
        }
    }

    /// Checks that states leave the table only where the claim ends.
    ///
    /// # Errors
    /// [`Rejection`] names the field.
    pub fn check_axes(&self, table: &HeightTable) -> Result<(), Rejection> {
        let [own, leader] = self.axes;
        let problem = if self.initial_own_mps_at_most > own.high {
            "must contain the largest own speed at the start"
        } else {
            match self.motion {
                MotionModel::Absolute if own.low != 0.0 || leader.low != 0.0 => {
                    "must begin at speed 0"
                }
                MotionModel::Relative if leader != TableAxis::point(0.0) => {
                    "must have the leader's speed 0 in the relative model"
                }
                MotionModel::Relative if !self.begins_level(table) => {
                    "must begin with equal heights at opening speeds that one decision cannot reverse"
                }
                _ => return Ok(()),
            }
        };
        Err(Rejection::invalid("axes", problem))
    }

    /// True if the table has equal heights at opening speeds that one decision cannot reverse.
    fn begins_level(&self, table: &HeightTable) -> bool {
        let own = self.axes[0];
        let relative = Interval::point(self.own_mps2[1]) - Interval::point(self.leader_mps2[0]);
        let fastest = (relative * self.interval_s()).high();
        let reached = (Interval::point(own.low) + Interval::point(fastest)).high();
        let is_level = (0..own.node_count())
            .take_while(|&i| i == 0 || own.node(i - 1) < reached)
            .all(|i| table.node_height([i, 0]) == table.node_height([0; 2]));
        is_level && own.low <= -fastest
    }
}

fn acceleration_range([low, high]: [f64; 2], field: &str) -> Result<Interval, Rejection> {
    (low <= 0.0 && high >= 0.0)
        .then(|| Interval::new(low, high))
        .flatten()
        .ok_or_else(|| Rejection::invalid(field, "must contain 0 and be finite"))
}

/// Returns failing cells in order, as index and missing height in metres, at most `limit` per thread.
/// Runs on all cores.
fn failing_cells(
    closed_loop: &ClosedLoop<'_>,
    table: &HeightTable,
    limit: usize,
) -> Vec<(usize, f64)> {
    let cells: Vec<_> = table.cells().enumerate().collect();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let chunks = cells.chunks(cells.len().div_ceil(threads).max(1));
        let parts: Vec<_> = chunks
            .map(|cells| {
                scope.spawn(move || {
                    cells
                        .iter()
                        .filter_map(|&(index, cell)| {
                            Some((index, closed_loop.check_cell(table, cell).err()?))
                        })
                        .take(limit)
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        parts
            .into_iter()
            .flat_map(|part| part.join().unwrap_or_else(|_| vec![(0, f64::INFINITY)]))
            .collect()
    })
}
