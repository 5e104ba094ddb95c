//! Upper bound of an invariant set: gaps from which a simulated leader defeats the controller.

use super::{BoundarySearch, advance};
use crate::invariant::InvariantStage;
use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::{AXIS_COUNT, HeightTable};

/// Times for which a simulated leader accelerates before it brakes, in seconds.
const ACCELERATES_S: [f64; 2] = [0.0, 1.0];
/// Resolution of simulated gaps, in metres.
const SIMULATED_WIDTH_M: f64 = 0.01;
const MAX_SIMULATED_STEPS: u32 = 3000;

impl BoundarySearch<'_> {
    /// Raises each node to the largest gap, by bisection, from which a leader defeats the controller in a simulation.
    /// `observe` receives the completed nodes and all nodes. Returns false if `observe` did.
    pub(in crate::invariant) fn raise_to_simulation(
        &mut self,
        table: &mut HeightTable,
        observe: &mut dyn FnMut(InvariantStage, [usize; 2]) -> bool,
    ) -> bool {
        let axes = *table.axes();
        let nodes: Vec<_> = table.nodes().collect();
        for (index, &node) in nodes.iter().enumerate() {
            if node[1] == 0 && !observe(InvariantStage::Simulate, [index, nodes.len()]) {
                return false;
            }
            let state: [f64; AXIS_COUNT] = std::array::from_fn(|axis| axes[axis].node(node[axis]));
            let [mut low_m, mut high_m] = [table.node_height(node), self.highest_m];
            while high_m - low_m > SIMULATED_WIDTH_M {
                let gap_m = 0.5 * (low_m + high_m);
                if ACCELERATES_S
                    .iter()
                    .any(|&time_s| self.collides(gap_m, state, time_s))
                {
                    low_m = gap_m;
                } else {
                    high_m = gap_m;
                }
            }
            table.raise(node, low_m);
        }
        true
    }

    /// Simulates a leader that accelerates for a while and then brakes, as hard as it may.
    fn collides(&mut self, mut gap_m: f64, state: [f64; AXIS_COUNT], accelerates_s: f64) -> bool {
        let [mut own, mut leader] = state;
        let claim = self.claim;
        let fastest = claim.axes[1].high;
        let [brakes, accelerates] = claim.leader_mps2;
        let is_relative = claim.motion == MotionModel::Relative;
        let mut acceleration = 0.0;
        for step in 0..MAX_SIMULATED_STEPS {
            let leads = if f64::from(step) * claim.step_s < accelerates_s {
                accelerates
            } else {
                brakes
            };
            if step % claim.decision_steps == 0 {
                let [low, high] = self.commands(gap_m, &[own, leader]);
                acceleration = (0.5 * (low + high)).clamp(claim.own_mps2[0], claim.own_mps2[1]);
            }
            if is_relative {
                let of_closing = acceleration - leads;
                gap_m -= (own + 0.5 * of_closing * claim.step_s) * claim.step_s;
                own += of_closing * claim.step_s;
            } else {
                let leads = leads.min((fastest - leader) / claim.step_s);
                let [[own_m, own_end], [leader_m, leader_end]] = [
                    advance(own, acceleration, claim.step_s),
                    advance(leader, leads, claim.step_s),
                ];
                gap_m += leader_m - own_m;
                (own, leader) = (own_end, leader_end);
            }
            let is_over = if is_relative {
                own <= 0.0
            } else {
                own == 0.0 && leader == 0.0
            };
            let is_over = is_over
                || claim
                    .ends_beyond_gap_m
                    .is_some_and(|limit_m| gap_m > limit_m);
            if gap_m <= 0.0 || is_over {
                return gap_m <= 0.0;
            }
        }
        false
    }
}
