//! Height that the states of a simplex miss after one decision.

use super::{BoundarySearch, Node, Point, Shortfall, advance, hull};
use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::{AXIS_COUNT, HeightTable, TableAxis};

/// Bounds of the motion of a state until the next decision.
struct StateMotion {
    state: [f64; AXIS_COUNT],
    /// Smallest growth of the gap, in metres.
    growth_m: f64,
    /// Range of the change along each axis, within the table.
    changes: [[f64; 2]; AXIS_COUNT],
    /// Range of the state during the motion, also outside of the table.
    reached: [[f64; 2]; AXIS_COUNT],
}

impl StateMotion {
    fn new(
        axes: &[TableAxis; AXIS_COUNT],
        state: [f64; AXIS_COUNT],
        growth_m: f64,
        changes: [[f64; 2]; AXIS_COUNT],
    ) -> Self {
        Self {
            state,
            growth_m,
            changes: std::array::from_fn(|axis| {
                let [low, high] = [axes[axis].low, axes[axis].high].map(|end| end - state[axis]);
                changes[axis].map(|change| change.clamp(low, high))
            }),
            reached: std::array::from_fn(|axis| {
                let [low, high] = changes[axis];
                [state[axis] + low.min(0.0), state[axis] + high.max(0.0)]
            }),
        }
    }
}

/// Position of a cell relative to the states along each axis. A motion away from a cell does not reach it.
struct CellSides {
    is_above: [bool; AXIS_COUNT],
    is_below: [bool; AXIS_COUNT],
}

impl CellSides {
    fn new(axes: &[TableAxis; AXIS_COUNT], cell: Node, extent: &[[f64; 2]; AXIS_COUNT]) -> Self {
        Self {
            is_above: std::array::from_fn(|axis| axes[axis].node(cell[axis]) >= extent[axis][1]),
            is_below: std::array::from_fn(|axis| {
                axes[axis].cells > 0 && axes[axis].node(cell[axis] + 1) <= extent[axis][0]
            }),
        }
    }
}

/// States that move until the next decision.
struct MovingStates {
    motions: Vec<StateMotion>,
    /// Range of the states along each axis, before they move.
    extent: [[f64; 2]; AXIS_COUNT],
    /// Smallest height of the states above the boundary, in metres.
    above_m: f64,
}

impl MovingStates {
    /// Replaces `worst` by the simplex of a cell and the motion that miss more height, if there are any.
    fn find_worse_in_cell(&self, table: &HeightTable, cell: Node, worst: &mut Shortfall) {
        let sides = CellSides::new(table.axes(), cell, &self.extent);
        for (order, axes_in_order) in table.orders().iter().enumerate() {
            let slopes = simplex_slopes(table, cell, axes_in_order);
            for motion in &self.motions {
                let change = worst_change(slopes, motion, &sides);
                let missing_m = missing_height_m(slopes, change, motion.growth_m, self.above_m);
                if missing_m > worst.missing_m {
                    *worst = Shortfall {
                        missing_m,
                        cell,
                        order,
                        change,
                    };
                }
            }
        }
    }
}

/// Cells of an axis, with both ends.
#[derive(Clone, Copy)]
struct CellRange {
    first: usize,
    last: usize,
}

impl BoundarySearch<'_> {
    /// Returns the simplex and the motion for which states at least `above_m` above the boundary miss most height.
    pub(super) fn worst(
        &self,
        table: &HeightTable,
        points: &[Point],
        command: [f64; 2],
        above_m: f64,
    ) -> Shortfall {
        let motions = self.state_motions(table.axes(), points, command);
        let [first_axis, second_axis] = touched_cells(table.axes(), &motions);
        let states = MovingStates {
            extent: extent(&motions),
            motions,
            above_m,
        };
        let mut worst = Shortfall::NONE;
        for i in first_axis.first..=first_axis.last {
            for j in second_axis.first..=second_axis.last {
                states.find_worse_in_cell(table, [i, j], &mut worst);
            }
        }
        worst
    }

    fn state_motions(
        &self,
        axes: &[TableAxis; AXIS_COUNT],
        points: &[Point],
        command: [f64; 2],
    ) -> Vec<StateMotion> {
        points
            .iter()
            .map(|&(state, _)| {
                let (growth_m, changes) = match self.claim.motion {
                    MotionModel::Relative => self.relative_motion(state, command),
                    MotionModel::Absolute => self.absolute_motion(state, command),
                };
                StateMotion::new(axes, state, growth_m, changes)
            })
            .collect()
    }

    fn decision_time_s(&self) -> f64 {
        self.claim.step_s * f64::from(self.claim.decision_steps)
    }

    /// Returns the smallest growth of the gap, and the changes of a closing speed, which is the first coordinate.
    fn relative_motion(
        &self,
        [closing_mps, _]: [f64; AXIS_COUNT],
        command: [f64; 2],
    ) -> (f64, [[f64; 2]; AXIS_COUNT]) {
        let time_s = self.decision_time_s();
        let [low_mps2, high_mps2] = command;
        let [leader_brakes_mps2, leader_accelerates_mps2] = self.claim.leader_mps2;
        let closing_mps2 = [
            low_mps2 - leader_accelerates_mps2,
            high_mps2 - leader_brakes_mps2,
        ];
        let growth_m = -closing_mps * time_s - 0.5 * closing_mps2[1] * time_s * time_s;
        (
            growth_m,
            [closing_mps2.map(|change| change * time_s), [0.0; 2]],
        )
    }

    /// Returns the smallest growth of the gap, and the changes of the speeds of two vehicles.
    fn absolute_motion(
        &self,
        [own, leader]: [f64; AXIS_COUNT],
        command: [f64; 2],
    ) -> (f64, [[f64; 2]; AXIS_COUNT]) {
        let time_s = self.decision_time_s();
        let [slow, fast] = command.map(|mps2| advance(own, mps2, time_s));
        let leader_ends = self
            .claim
            .leader_mps2
            .map(|mps2| advance(leader, mps2, time_s));
        let own_changes = [slow, fast].map(|end| end[1] - own);
        let leader_changes = leader_ends.map(|end| end[1] - leader);
        (leader_ends[0][0] - fast[0], [own_changes, leader_changes])
    }
}

/// Returns the range of the states along each axis.
fn extent(motions: &[StateMotion]) -> [[f64; 2]; AXIS_COUNT] {
    std::array::from_fn(|axis| {
        motions
            .iter()
            .map(|motion| [motion.state[axis]; 2])
            .fold([f64::INFINITY, f64::NEG_INFINITY], hull)
    })
}

/// Returns the cells of each axis through which the states move.
fn touched_cells(
    axes: &[TableAxis; AXIS_COUNT],
    motions: &[StateMotion],
) -> [CellRange; AXIS_COUNT] {
    std::array::from_fn(|axis| {
        let reached = motions.iter().map(|motion| motion.reached[axis]);
        CellRange::new(
            axes[axis],
            reached.fold([f64::INFINITY, f64::NEG_INFINITY], hull),
        )
    })
}

impl CellRange {
    /// Returns the cells of a part of an axis. A cell that shares only its boundary with the part adds nothing.
    fn new(axis: TableAxis, [low, high]: [f64; 2]) -> Self {
        let Some(end) = axis.cells.checked_sub(1) else {
            return Self { first: 0, last: 0 };
        };
        let end = end as usize;
        let position =
            |value: f64| (value - axis.low) / (axis.high - axis.low) * f64::from(axis.cells);
        let first = ((position(low) + 1e-9).max(0.0) as usize).min(end);
        let last = ((position(high) - 1e-9).max(0.0) as usize).clamp(first, end);
        Self { first, last }
    }
}

/// Returns the slopes of the boundary in a simplex along each axis.
fn simplex_slopes(table: &HeightTable, cell: Node, axes_in_order: &[usize]) -> [f64; AXIS_COUNT] {
    let nodes = table.simplex(cell, axes_in_order);
    let mut slopes = [0.0; AXIS_COUNT];
    for (edge, &axis) in axes_in_order.iter().enumerate() {
        let along = table.axes()[axis];
        let width = along.node(cell[axis] + 1) - along.node(cell[axis]);
        let rise = table.node_height(nodes[edge + 1]) - table.node_height(nodes[edge]);
        slopes[axis] = rise / width;
    }
    slopes
}

/// Returns the change within a simplex along which the boundary rises most.
fn worst_change(
    slopes: [f64; AXIS_COUNT],
    motion: &StateMotion,
    sides: &CellSides,
) -> [f64; AXIS_COUNT] {
    std::array::from_fn(|axis| {
        let [low, high] = motion.changes[axis];
        let low = if sides.is_above[axis] {
            low.max(0.0)
        } else {
            low
        };
        let high = if sides.is_below[axis] {
            high.min(0.0)
        } else {
            high
        };
        match slopes[axis] {
            0.0 => 0.0_f64.max(low).min(high),
            slope if slope > 0.0 => high,
            _ => low,
        }
    })
}

/// Returns the height that a state misses after a change.
fn missing_height_m(
    slopes: [f64; AXIS_COUNT],
    change: [f64; AXIS_COUNT],
    growth_m: f64,
    above_m: f64,
) -> f64 {
    let rise_m: f64 = slopes
        .iter()
        .zip(change)
        .map(|(slope, change)| slope * change)
        .sum();
    let is_still = rise_m == 0.0 && growth_m >= 0.0;
    let above_m = if is_still { above_m.max(0.0) } else { above_m };
    rise_m - growth_m - above_m
}
