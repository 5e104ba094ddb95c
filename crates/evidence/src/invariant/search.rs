//! Search for the boundary of an invariant set, in plain floating point and with the simulator's controller.
//!
//! The search starts with the lowest allowed height everywhere. It bounds the motion of each simplex from the commands
//! at its nodes, at some heights above the boundary. A simplex from which a state leaves the set loses its lowest
//! states: the search raises the node from which the motion leads away. Heights never fall, so the search ends with a
//! set, or at the height limit. If the checker rejects a cell, its reserve grows, and the search goes on.

mod shortfall;
mod simulated;

use super::InvariantStage;
use crumple_sim::control::Controller;
use crumple_sim::observation::{Neighbour, Observation};
use crumple_verify::InvariantClaim;
use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::{AXIS_COUNT, HEIGHT_UNIT_M, HeightTable};

/// Maximum number of passes over the table.
const MAX_PASSES: u32 = 4000;
/// Largest rise of a node at once, in metres, and number of attempts for a cell in a pass.
const MAX_RISE_M: f64 = 0.02;
const MAX_ATTEMPTS: u32 = 40;
/// Layers above the boundary in which commands are bounded.
const LAYERS: usize = 4;
/// Height that each condition keeps in reserve, in metres, and its growth if the checker rejects a cell.
const RESERVE_M: f64 = 1e-6;
const RESERVE_GROWTH: f64 = 8.0;

type Node = [usize; AXIS_COUNT];
/// A state and the height of the boundary there.
type Point = ([f64; AXIS_COUNT], f64);

/// A simplex of which a state leaves the set.
struct Shortfall {
    missing_m: f64,
    /// Simplex through which the state moves, and the change of the state.
    cell: Node,
    order: usize,
    change: [f64; AXIS_COUNT],
}

pub(super) struct BoundarySearch<'a> {
    pub(super) claim: &'a InvariantClaim,
    /// Decides at each call.
    pub(super) controller: Box<dyn Controller>,
    pub(super) policy: Option<&'a [u8]>,
    pub(super) highest_m: f64,
}

impl BoundarySearch<'_> {
    /// Raises a table until the checker accepts it. `observe` receives the cells that need no change, and all cells.
    /// Returns the number of passes; `None` if a height would exceed the limit, if `observe` returns false, or after
    /// too many passes.
    pub(super) fn raise_boundary(
        &mut self,
        table: &mut HeightTable,
        observe: &mut dyn FnMut(InvariantStage, [usize; 2]) -> bool,
    ) -> Option<u32> {
        let cells: Vec<Node> = table.cells().collect();
        let counts = table.axes().map(|axis| (axis.cells as usize).max(1));
        let index = |[i, j]: Node| i * counts[1] + j;
        let mut is_due = vec![true; cells.len()];
        let mut reserves_m = vec![RESERVE_M; cells.len()];
        for pass in 0..MAX_PASSES {
            let mut failed = 0;
            for &cell in &cells {
                let stage = InvariantStage::Raise { pass: pass + 1 };
                if cell[1] == 0
                    && !observe(
                        stage,
                        [
                            is_due.iter().filter(|is_due| !**is_due).count(),
                            cells.len(),
                        ],
                    )
                {
                    return None;
                }
                if !std::mem::take(&mut is_due[index(cell)]) {
                    continue;
                }
                for attempt in 0.. {
                    let Some(shortfall) = self.shortfall(table, cell, reserves_m[index(cell)])
                    else {
                        break;
                    };
                    failed += usize::from(attempt == 0);
                    if attempt == MAX_ATTEMPTS {
                        is_due[index(cell)] = true;
                        break;
                    }
                    let limit_m = self.claim.ends_beyond_gap_m;
                    for node in raise(table, &shortfall, self.highest_m, limit_m)? {
                        mark_near(node, &shortfall, cell, counts, |near| {
                            is_due[index(near)] = true
                        });
                    }
                }
            }
            if failed == 0 && !is_due.contains(&true) {
                let rejected = self.claim.failing_cells(self.policy, table).ok()?;
                if rejected.is_empty() {
                    return Some(pass + 1);
                }
                for cell in rejected {
                    reserves_m[cell] *= RESERVE_GROWTH;
                    is_due[cell] = true;
                }
            }
        }
        None
    }

    /// Returns a shortfall of a cell, if a state of it may leave the set.
    fn shortfall(&mut self, table: &HeightTable, cell: Node, reserve_m: f64) -> Option<Shortfall> {
        let own_mps2 = self.claim.own_mps2;
        for order in table.orders() {
            let state =
                |node: Node| std::array::from_fn(|axis| table.axes()[axis].node(node[axis]));
            let points: Vec<Point> = table
                .simplex(cell, order)
                .into_iter()
                .map(|node| (state(node), table.node_height(node)))
                .collect();
            let layer_m = self.worst(table, &points, own_mps2, -reserve_m).missing_m;
            for layer in 0..LAYERS {
                let above_m =
                    [layer, layer + 1].map(|layer| layer_m * layer as f64 / LAYERS as f64);
                let depth = self.claim.splits as usize * order.len();
                if layer_m > 0.0
                    && let Some(shortfall) =
                        self.shortfall_of(table, &points, above_m, reserve_m, depth)
                {
                    return Some(shortfall);
                }
            }
        }
        None
    }

    /// Returns a shortfall of a part of a simplex and a layer above it. Bisects a part that fails.
    fn shortfall_of(
        &mut self,
        table: &HeightTable,
        points: &[Point],
        above_m: [f64; 2],
        reserve_m: f64,
        depth: usize,
    ) -> Option<Shortfall> {
        let own_mps2 = self.claim.own_mps2;
        let limit_m = self.claim.ends_beyond_gap_m.unwrap_or(f64::INFINITY);
        if points
            .iter()
            .all(|(_, height_m)| height_m + above_m[0] > limit_m)
        {
            return None;
        }
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for (state, height_m) in points {
            for above_m in above_m {
                range = hull(range, self.commands(height_m + above_m, state));
            }
        }
        let range = range.map(|command| command.clamp(own_mps2[0], own_mps2[1]));
        let worst = self.worst(table, points, range, above_m[0] - reserve_m);
        if worst.missing_m <= 0.0 {
            return None;
        }
        if depth == 0 {
            return Some(worst);
        }
        let length = |&(a, b): &(usize, usize)| {
            let (a, b) = (points[a].0, points[b].0);
            a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>()
        };
        let edges = (0..points.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        let (a, b) = edges.max_by(|one, other| length(one).total_cmp(&length(other)))?;
        let mean = |a: f64, b: f64| 0.5 * (a + b);
        let middle = (
            std::array::from_fn(|axis| mean(points[a].0[axis], points[b].0[axis])),
            mean(points[a].1, points[b].1),
        );
        [a, b].into_iter().find_map(|replaced| {
            let mut half = points.to_vec();
            half[replaced] = middle;
            self.shortfall_of(table, &half, above_m, reserve_m, depth - 1)
        })
    }

    /// Returns the commands at a state, for the extreme accelerations that a network may observe.
    fn commands(&mut self, gap_m: f64, &[own_mps, leader_mps]: &[f64; AXIS_COUNT]) -> [f64; 2] {
        // In the relative model only the difference counts.
        let slowest = if self.claim.motion == MotionModel::Relative {
            self.claim.axes[0].low
        } else {
            0.0
        };
        let [speed_mps, leader_mps] = [own_mps - slowest, leader_mps - slowest];
        let is_law = self.policy.is_none();
        let of = |limits: [f64; 2]| if is_law { vec![0.0] } else { limits.to_vec() };
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for acceleration_mps2 in of(self.claim.own_mps2) {
            for leader_mps2 in of(self.claim.leader_mps2) {
                let ahead = Neighbour {
                    gap_m,
                    speed_mps: leader_mps,
                    acceleration_mps2: leader_mps2,
                };
                let seen = Observation {
                    speed_mps,
                    acceleration_mps2,
                    ahead: Some(ahead),
                    behind: None,
                };
                let command = self.controller.decide(&seen).unwrap_or(f64::NAN);
                range = if command.is_nan() {
                    self.claim.own_mps2
                } else {
                    hull(range, [command; 2])
                };
            }
        }
        range
    }
}

fn hull(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the distance and the speed of a vehicle that does not reverse.
fn advance(speed: f64, acceleration: f64, time_s: f64) -> [f64; 2] {
    let end = speed + acceleration * time_s;
    if end >= 0.0 {
        [0.5 * (speed + end) * time_s, end]
    } else {
        [speed * speed / (-2.0 * acceleration), 0.0]
    }
}

/// Raises the node of a simplex from which the motion leads away most. Returns it; `None` above the height limit.
fn raise(
    table: &mut HeightTable,
    shortfall: &Shortfall,
    highest_m: f64,
    limit_m: Option<f64>,
) -> Option<Vec<Node>> {
    let order = table.orders()[shortfall.order].clone();
    let nodes = table.simplex(shortfall.cell, &order);
    // Barycentric coordinates of the change.
    let along = |position: usize| {
        order.get(position).map_or(0.0, |&axis| {
            let (of, first) = (table.axes()[axis], shortfall.cell[axis]);
            shortfall.change[axis] / (of.node(first + 1) - of.node(first))
        })
    };
    let coordinate = |position: usize| {
        if position == 0 {
            -along(0)
        } else {
            along(position - 1) - along(position)
        }
    };
    // The leader moves either way: if the own motion alone fails, only a node from which this motion leads away helps.
    let leader_rise_m = order
        .iter()
        .position(|&axis| axis == 1)
        .map_or(0.0, |position| {
            (table.node_height(nodes[position + 1]) - table.node_height(nodes[position]))
                * along(position)
        });
    let own_fails = shortfall.missing_m > leader_rise_m;
    let is_behind =
        |position: usize| (nodes[position][0] > shortfall.cell[0]) == (shortfall.change[0] < 0.0);
    let choices = (0..nodes.len()).filter(|&position| !own_fails || is_behind(position));
    let upstream = choices
        .min_by(|&a, &b| coordinate(a).total_cmp(&coordinate(b)))
        .unwrap_or(0);
    let gain = -coordinate(upstream);
    let rise_m = (shortfall.missing_m / gain).clamp(HEIGHT_UNIT_M, MAX_RISE_M);
    let raised = if gain > 1e-9 {
        vec![nodes[upstream]]
    } else {
        nodes
    };
    for &node in &raised {
        let height_m = table.node_height(node)
            + if rise_m.is_finite() {
                rise_m
            } else {
                MAX_RISE_M
            };
        if height_m > highest_m && limit_m.is_none() {
            return None;
        }
        table.raise(node, height_m);
    }
    Some(raised)
}

/// Calls `mark` for all cells that may depend on a node: those as near as the failing simplex is to its cell.
fn mark_near(
    node: Node,
    shortfall: &Shortfall,
    cell: Node,
    counts: Node,
    mut mark: impl FnMut(Node),
) {
    let near = |axis: usize| {
        let distance = shortfall.cell[axis].abs_diff(cell[axis]) + 2;
        node[axis].saturating_sub(distance + 1)..(node[axis] + distance).min(counts[axis])
    };
    for i in near(0) {
        near(1).for_each(|j| mark([i, j]));
    }
}
