//! Search for the boundary of an invariant set: heights that the checker's condition accepts.
//!
//! The search starts with the lowest allowed height everywhere. A cell that fails the checker's condition loses its
//! lowest states: the search raises those nodes of the failing simplex from which the motion leads away. A node that is
//! raised can make only cells near it fail. Heights never fall, so the search ends with a set, or at the height limit.

use crumple_verify::invariant::table::{AXIS_COUNT, HEIGHT_UNIT_M, HeightTable};
use crumple_verify::invariant::{ClosedLoop, Shortfall};

/// Maximum number of passes over the table.
const MAX_PASSES: u32 = 4000;
/// Largest rise of a node at once, in metres, and number of attempts for a cell in a pass.
const MAX_RISE_M: f64 = 0.5;
const MAX_ATTEMPTS: u32 = 40;

/// Raises a table until all of its cells fulfil the condition. Returns the number of passes; `None` if a height would
/// exceed `highest_m`, or after too many passes.
pub(super) fn raise_boundary(
    closed_loop: &ClosedLoop<'_>,
    table: &mut HeightTable,
    highest_m: f64,
    observe: &mut dyn FnMut(u32, usize) -> bool,
) -> Option<u32> {
    let cells: Vec<_> = table.cells().collect();
    let counts: [usize; AXIS_COUNT] = table.axes().map(|axis| (axis.cells as usize).max(1));
    let index = |[i, j, k]: [usize; AXIS_COUNT]| (i * counts[1] + j) * counts[2] + k;
    let mut is_due = vec![true; cells.len()];
    for pass in 0..MAX_PASSES {
        let mut failed = 0;
        for &cell in &cells {
            if !std::mem::take(&mut is_due[index(cell)]) {
                continue;
            }
            for attempt in 0.. {
                let Err(shortfall) = closed_loop.check_cell(table, cell) else { break };
                failed += usize::from(attempt == 0);
                if attempt == MAX_ATTEMPTS {
                    is_due[index(cell)] = true;
                    break;
                }
                let raised = raise(table, cell, &shortfall, highest_m)?;
                for &node in &raised {
                    mark_near(node, &shortfall, cell, counts, |near| is_due[index(near)] = true);
                }
            }
        }
        if !observe(pass, failed) {
            return None;
        }
        if failed == 0 && !is_due.contains(&true) {
            return Some(pass + 1);
        }
    }
    None
}

/// Raises the node of a simplex from which the motion leads away most. Returns it; `None` above the height limit.
fn raise(
    table: &mut HeightTable,
    cell: [usize; AXIS_COUNT],
    shortfall: &Shortfall,
    highest_m: f64,
) -> Option<Vec<[usize; AXIS_COUNT]>> {
    if !shortfall.missing_m.is_finite() {
        return None;
    }
    let order = table.orders()[shortfall.order].clone();
    let nodes = table.simplex(shortfall.cell, &order);
    // Barycentric coordinates of the change.
    let along = |position: usize| {
        order.get(position).map_or(0.0, |&axis| {
            let (of, first) = (table.axes()[axis], shortfall.cell[axis]);
            shortfall.change[axis] / (of.node(first + 1) - of.node(first))
        })
    };
    let coordinate = |position: usize| if position == 0 { -along(0) } else { along(position - 1) - along(position) };
    // The leader moves either way: if the own motion alone fails, only a node from which this motion leads away helps.
    let leader_rise_m = order.iter().position(|&axis| axis == 1).map_or(0.0, |position| {
        (table.node_height(nodes[position + 1]) - table.node_height(nodes[position])) * along(position)
    });
    let own_fails = shortfall.missing_m > leader_rise_m;
    let is_behind = |position: usize| (nodes[position][0] > shortfall.cell[0]) == (shortfall.change[0] < 0.0);
    let choices = (0..nodes.len()).filter(|&position| !own_fails || is_behind(position));
    let upstream = choices.min_by(|&a, &b| coordinate(a).total_cmp(&coordinate(b))).unwrap_or(0);
    let gain = -coordinate(upstream);
    let rise_m = (shortfall.missing_m / gain).clamp(HEIGHT_UNIT_M, MAX_RISE_M);
    let raised = if gain > 1e-9 { vec![nodes[upstream]] } else { table.simplex(cell, &order) };
    for &node in &raised {
        let height_m = table.node_height(node) + if rise_m.is_finite() { rise_m } else { MAX_RISE_M };
        if height_m > highest_m {
            return None;
        }
        table.raise(node, height_m);
    }
    Some(raised)
}

/// Calls `mark` for all cells that may depend on a node: those as near as the failing simplex is to its cell.
fn mark_near(
    node: [usize; AXIS_COUNT],
    shortfall: &Shortfall,
    cell: [usize; AXIS_COUNT],
    counts: [usize; AXIS_COUNT],
    mut mark: impl FnMut([usize; AXIS_COUNT]),
) {
    let near = |axis: usize| {
        let distance = shortfall.cell[axis].abs_diff(cell[axis]) + 2;
        node[axis].saturating_sub(distance + 1)..(node[axis] + distance).min(counts[axis])
    };
    for i in near(0) {
        for j in near(1) {
            near(2).for_each(|k| mark([i, j, k]));
        }
    }
}
