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

impl Shortfall {
    /// Less than every shortfall of a state.
    const NONE: Self = Self {
        missing_m: f64::NEG_INFINITY,
        cell: [0; AXIS_COUNT],
        order: 0,
        change: [0.0; AXIS_COUNT],
    };
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
        let mut agenda = Agenda::new(table, cells.len());
        for pass in 1..=MAX_PASSES {
            let mut is_changed = false;
            for &cell in &cells {
                let stage = InvariantStage::Raise { pass };
                if cell[1] == 0 && !observe(stage, [agenda.count_done(), cells.len()]) {
                    return None;
                }
                if agenda.take_due(cell) {
                    is_changed |= self.raise_cell(table, cell, &mut agenda)?;
                }
            }
            if is_changed || agenda.is_due.contains(&true) {
                continue;
            }
            let rejected = self.claim.failing_cells(self.policy, table).ok()?;
            if rejected.is_empty() {
                return Some(pass);
            }
            for cell in rejected {
                agenda.reserves_m[cell] *= RESERVE_GROWTH;
                agenda.is_due[cell] = true;
            }
        }
        None
    }

    /// Raises nodes until no state of a cell leaves the set, or the cell is due again after too many attempts. Returns
    /// false if the cell needs no change; `None` above the height limit.
    fn raise_cell(
        &mut self,
        table: &mut HeightTable,
        cell: Node,
        agenda: &mut Agenda,
    ) -> Option<bool> {
        let reserve_m = agenda.reserves_m[agenda.index(cell)];
        for attempt in 0..MAX_ATTEMPTS {
            let Some(shortfall) = self.shortfall(table, cell, reserve_m) else {
                return Some(attempt > 0);
            };
            let limit_m = self.claim.ends_beyond_gap_m;
            for node in raise(table, &shortfall, self.highest_m, limit_m)? {
                agenda.mark_near(node, &shortfall, cell);
            }
        }
        if self.shortfall(table, cell, reserve_m).is_some() {
            agenda.mark(cell);
        }
        Some(true)
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
        bisect_longest_edge(points)?
            .iter()
            .find_map(|half| self.shortfall_of(table, half, above_m, reserve_m, depth - 1))
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
        let [own_limits_mps2, leader_limits_mps2] = [self.claim.own_mps2, self.claim.leader_mps2]
            .map(|limits| match self.policy {
                None => vec![0.0],
                Some(_) => limits.to_vec(),
            });
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for acceleration_mps2 in own_limits_mps2 {
            for &leader_mps2 in &leader_limits_mps2 {
                let ahead = Neighbour {
                    gap_m,
                    speed_mps: leader_mps,
                    acceleration_mps2: leader_mps2,
                };
                let observation = Observation {
                    speed_mps,
                    acceleration_mps2,
                    ahead: Some(ahead),
                    behind: None,
                };
                let command = self.controller.decide(&observation).unwrap_or(f64::NAN);
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
    let edges = changes_along_edges(table, shortfall, &order);
    let coordinates = barycentric_coordinates(&edges);
    // The leader moves either way: if the own motion alone fails, only a node from which this motion leads away helps.
    let leader_rise_m = order
        .iter()
        .position(|&axis| axis == 1)
        .map_or(0.0, |position| {
            (table.node_height(nodes[position + 1]) - table.node_height(nodes[position]))
                * edges[position]
        });
    let own_fails = shortfall.missing_m > leader_rise_m;
    let choices = (0..nodes.len()).filter(|&position| {
        let is_faster = nodes[position][0] > shortfall.cell[0];
        !own_fails || is_faster == (shortfall.change[0] < 0.0)
    });
    let upstream = choices
        .min_by(|&a, &b| coordinates[a].total_cmp(&coordinates[b]))
        .unwrap_or(0);
    let gain = -coordinates[upstream];
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

/// Returns the change of a state along each edge of a path through its simplex, in lengths of the edge.
fn changes_along_edges(table: &HeightTable, shortfall: &Shortfall, order: &[usize]) -> Vec<f64> {
    let changes = order.iter().map(|&axis| {
        let table_axis = table.axes()[axis];
        let first = shortfall.cell[axis];
        shortfall.change[axis] / (table_axis.node(first + 1) - table_axis.node(first))
    });
    changes.collect()
}

/// Returns the barycentric coordinates of a change, one for each node of the path.
fn barycentric_coordinates(edges: &[f64]) -> Vec<f64> {
    let mut edges = edges.to_vec();
    edges.push(0.0);
    let later = edges.windows(2).map(|pair| pair[0] - pair[1]);
    std::iter::once(-edges[0]).chain(later).collect()
}

/// Returns both halves of a simplex; `None` if it has no edge.
fn bisect_longest_edge(points: &[Point]) -> Option<[Vec<Point>; 2]> {
    let edges = (0..points.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
    let [a, b] = edges.max_by(|first, second| {
        edge_length(points, *first).total_cmp(&edge_length(points, *second))
    })?;
    let middle = (
        std::array::from_fn(|axis| 0.5 * (points[a].0[axis] + points[b].0[axis])),
        0.5 * (points[a].1 + points[b].1),
    );
    Some([a, b].map(|replaced| {
        let mut half = points.to_vec();
        half[replaced] = middle;
        half
    }))
}

fn edge_length(points: &[Point], edge: [usize; 2]) -> f64 {
    let [a, b] = edge.map(|end| points[end].0);
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>()
}

/// Cells that a search must still look at, and their reserves.
struct Agenda {
    counts: Node,
    is_due: Vec<bool>,
    reserves_m: Vec<f64>,
}

impl Agenda {
    fn new(table: &HeightTable, cells: usize) -> Self {
        Self {
            counts: table.axes().map(|axis| (axis.cells as usize).max(1)),
            is_due: vec![true; cells],
            reserves_m: vec![RESERVE_M; cells],
        }
    }

    fn index(&self, [i, j]: Node) -> usize {
        i * self.counts[1] + j
    }

    fn count_done(&self) -> usize {
        self.is_due.iter().filter(|is_due| !**is_due).count()
    }

    fn take_due(&mut self, cell: Node) -> bool {
        let index = self.index(cell);
        std::mem::take(&mut self.is_due[index])
    }

    fn mark(&mut self, cell: Node) {
        let index = self.index(cell);
        self.is_due[index] = true;
    }

    /// Marks all cells that may depend on a node: those as near as the failing simplex is to its cell.
    fn mark_near(&mut self, node: Node, shortfall: &Shortfall, cell: Node) {
        let [rows, columns] = std::array::from_fn(|axis| {
            let distance = shortfall.cell[axis].abs_diff(cell[axis]) + 2;
            let end = (node[axis] + distance).min(self.counts[axis]);
            node[axis].saturating_sub(distance + 1)..end
        });
        for i in rows {
            for j in columns.clone() {
                self.mark([i, j]);
            }
        }
    }
}
