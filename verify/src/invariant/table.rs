//! The boundary of an invariant set: a height over a grid of speeds, linear on each simplex.
//!
//! The nodes of a [`TableAxis`] divide its range into cells. Each cell of the grid is divided into simplices, one for
//! each order of the axes (Kuhn): from its lowest corner a simplex steps along the first axis of the order, then along
//! the second, and so on. The slope of a simplex along an axis is therefore that of one edge of the cell. Heights are
//! whole multiples of 2⁻¹⁰ m, so that they and their differences are exact in double precision.

use serde::{Deserialize, Serialize};

use crate::Rejection;
use crate::claim::ConstantPiece;
use crate::interval::Interval;

/// Number of axes: own speed, leader's speed.
pub const AXIS_COUNT: usize = 2;
/// Unit of heights, in metres.
pub const HEIGHT_UNIT_M: f64 = 1.0 / 1024.0;
/// Maximum number of nodes of a table, and of cells of an axis.
pub const MAX_NODES: usize = 2_000_000;
const MAX_AXIS_CELLS: u32 = 4096;
/// Largest height, in units: 16 km.
const MAX_HEIGHT: i64 = 1 << 24;

/// A range that nodes divide into cells; without cells it is a single number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableAxis {
    /// First node.
    pub low: f64,
    /// Last node.
    pub high: f64,
    /// Number of cells.
    pub cells: u32,
}

impl TableAxis {
    /// Creates an axis of a single number.
    #[must_use]
    pub fn point(value: f64) -> Self {
        Self {
            low: value,
            high: value,
            cells: 0,
        }
    }

    /// Returns the number of nodes.
    #[must_use]
    pub fn node_count(self) -> usize {
        self.cells as usize + 1
    }

    /// Returns a node: the result of this formula in double precision.
    #[must_use]
    pub fn node(self, index: usize) -> f64 {
        if index >= self.cells as usize {
            self.high
        } else {
            self.low + (self.high - self.low) * (index as f64 / f64::from(self.cells))
        }
    }

    /// Returns the range of a cell, or the single number.
    #[must_use]
    pub fn cell(self, index: usize) -> Interval {
        Interval::new(self.node(index), self.node(index + 1)).unwrap_or(Interval::ENTIRE)
    }

    /// Returns the range of the axis.
    #[must_use]
    pub fn range(self) -> Interval {
        Interval::new(self.low, self.high).unwrap_or(Interval::ENTIRE)
    }

    /// Returns the first and the last cell of a part of the range.
    pub(super) fn cells_of(self, part: Interval) -> [usize; 2] {
        let Some(last) = (self.cells as usize).checked_sub(1) else {
            return [0, 0];
        };
        let [mut first, mut end] = [part.low(), part.high()].map(|value| {
            let share = (value - self.low) / (self.high - self.low);
            ((share * f64::from(self.cells)).max(0.0) as usize).min(last)
        });
        while first > 0 && self.node(first) > part.low() {
            first -= 1;
        }
        while first < last && self.node(first + 1) <= part.low() {
            first += 1;
        }
        while end < last && self.node(end + 1) < part.high() {
            end += 1;
        }
        while end > first && self.node(end) >= part.high() {
            end -= 1;
        }
        [first, end.max(first)]
    }

    fn inverse_widths(self) -> Vec<Interval> {
        (0..self.cells as usize)
            .map(|index| {
                let width =
                    Interval::point(self.node(index + 1)) - Interval::point(self.node(index));
                Interval::ONE.over(width)
            })
            .collect()
    }

    fn is_valid(self) -> bool {
        let is_one = self.cells == 0 && self.low == self.high;
        let increases =
            || (1..self.node_count()).all(|index| self.node(index - 1) < self.node(index));
        self.low.is_finite()
            && self.high.is_finite()
            && self.cells <= MAX_AXIS_CELLS
            && (is_one || increases())
    }
}

fn invalid_heights(problem: &'static str) -> Rejection {
    Rejection::invalid("table.heights", problem)
}

/// The heights of all nodes; the last axis varies fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightTable {
    axes: [TableAxis; AXIS_COUNT],
    /// In metres.
    heights: Vec<f64>,
    /// 1 / width of each cell of each axis.
    inverse_widths: [Vec<Interval>; AXIS_COUNT],
    /// Orders of the axes that have cells, one for each simplex of a cell.
    orders: Vec<Vec<usize>>,
}

impl HeightTable {
    /// Creates a table with one height.
    ///
    /// # Errors
    /// [`Rejection`] if an axis is invalid or there are too many nodes.
    pub fn new(axes: [TableAxis; AXIS_COUNT], height_m: f64) -> Result<Self, Rejection> {
        if !axes.iter().all(|axis| axis.is_valid()) {
            return Err(Rejection::invalid(
                "table",
                "has an axis whose nodes do not increase, or with too many cells",
            ));
        }
        let nodes = axes.iter().map(|axis| axis.node_count()).product::<usize>();
        if nodes > MAX_NODES {
            return Err(Rejection::invalid("table", "has too many nodes"));
        }

        let order: Vec<usize> = (0..AXIS_COUNT)
            .filter(|&axis| axes[axis].cells > 0)
            .collect();
        let mut orders = vec![order.clone(), order.into_iter().rev().collect()];
        orders.dedup();
        Ok(Self {
            axes,
            heights: vec![height_m; nodes],
            inverse_widths: axes.map(TableAxis::inverse_widths),
            orders,
        })
    }

    /// Creates a table from the runs of [`to_runs`](Self::to_runs).
    ///
    /// # Errors
    /// [`Rejection`] if the runs are not those of a table with these axes.
    pub fn from_runs(
        axes: [TableAxis; AXIS_COUNT],
        runs: &[ConstantPiece<i64>],
    ) -> Result<Self, Rejection> {
        let mut table = Self::new(axes, 0.0)?;
        let mut height = 0_i64;
        let mut filled = 0_usize;
        for (index, &ConstantPiece(count, change)) in runs.iter().enumerate() {
            if count == 0 || index > 0 && runs[index - 1].1 == change {
                return Err(invalid_heights(
                    "has an empty run, or two runs that are one",
                ));
            }
            let Some(part) = table
                .heights
                .get_mut(filled..filled.saturating_add(count as usize))
            else {
                return Err(invalid_heights("has more heights than the table has nodes"));
            };
            for to in part {
                height = height.saturating_add(change);
                if !(1..=MAX_HEIGHT).contains(&height) {
                    return Err(invalid_heights(
                        "has a height that is not positive, or too large",
                    ));
                }
                *to = height as f64 * HEIGHT_UNIT_M;
            }
            filled += count as usize;
        }
        if filled == table.heights.len() {
            Ok(table)
        } else {
            Err(invalid_heights(
                "has fewer heights than the table has nodes",
            ))
        }
    }

    /// Returns the heights as runs: a number of nodes, and the difference of each to the node before, in units.
    #[must_use]
    pub fn to_runs(&self) -> Vec<ConstantPiece<i64>> {
        let mut runs = Vec::<ConstantPiece<i64>>::new();
        let mut before = 0_i64;
        for height_m in &self.heights {
            let height = (height_m / HEIGHT_UNIT_M).round() as i64;
            match runs.last_mut() {
                Some(run) if run.1 == height - before => run.0 += 1,
                _ => runs.push(ConstantPiece(1, height - before)),
            }
            before = height;
        }
        runs
    }

    /// Returns the axes.
    #[must_use]
    pub fn axes(&self) -> &[TableAxis; AXIS_COUNT] {
        &self.axes
    }

    /// Returns the orders of the axes, one for each simplex of a cell.
    #[must_use]
    pub fn orders(&self) -> &[Vec<usize>] {
        &self.orders
    }

    /// Returns all cells, in the order of their nodes.
    pub fn cells(&self) -> impl Iterator<Item = [usize; AXIS_COUNT]> + use<> {
        indices(self.axes.map(|axis| (axis.cells as usize).max(1)))
    }

    /// Returns all nodes, in order.
    pub fn nodes(&self) -> impl Iterator<Item = [usize; AXIS_COUNT]> + use<> {
        indices(self.axes.map(TableAxis::node_count))
    }

    fn index(&self, [i, j]: [usize; AXIS_COUNT]) -> usize {
        i * self.axes[1].node_count() + j
    }

    /// Returns the height of a node, in metres.
    #[must_use]
    pub fn node_height(&self, node: [usize; AXIS_COUNT]) -> f64 {
        self.heights
            .get(self.index(node))
            .copied()
            .unwrap_or(f64::INFINITY)
    }

    /// Raises a node to a height, rounded up to the unit.
    pub fn raise(&mut self, node: [usize; AXIS_COUNT], height_m: f64) {
        let index = self.index(node);
        if let Some(height) = self.heights.get_mut(index) {
            *height = height.max((height_m / HEIGHT_UNIT_M).ceil() * HEIGHT_UNIT_M);
        }
    }

    /// Returns the smallest and the largest height, in metres.
    #[must_use]
    pub fn extremes(&self) -> [f64; 2] {
        let heights = self.heights.iter().copied();
        [
            heights.clone().fold(f64::INFINITY, f64::min),
            heights.fold(0.0, f64::max),
        ]
    }

    /// Returns the nodes of a simplex, in order.
    #[must_use]
    pub fn simplex(&self, cell: [usize; AXIS_COUNT], order: &[usize]) -> Vec<[usize; AXIS_COUNT]> {
        let mut nodes = vec![cell];
        for &axis in order {
            let mut next = nodes[nodes.len() - 1];
            next[axis] += 1;
            nodes.push(next);
        }
        nodes
    }

    /// Returns the slopes of a simplex, in metres per unit of each axis.
    pub(super) fn slopes(
        &self,
        cell: [usize; AXIS_COUNT],
        order: &[usize],
    ) -> [Interval; AXIS_COUNT] {
        let mut slopes = [Interval::ZERO; AXIS_COUNT];
        let mut node = cell;
        let mut height_m = self.node_height(cell);
        for &axis in order {
            node[axis] += 1;
            let next_m = self.node_height(node);
            if next_m != height_m {
                slopes[axis] =
                    Interval::point(next_m - height_m) * self.inverse_widths[axis][cell[axis]];
            }
            height_m = next_m;
        }
        slopes
    }

    /// Returns an upper bound of the height of the plane of a simplex at a state, in metres.
    fn plane_height(
        &self,
        cell: [usize; AXIS_COUNT],
        order: &[usize],
        state: [f64; AXIS_COUNT],
    ) -> f64 {
        let slopes = self.slopes(cell, order);
        let base = Interval::point(self.node_height(cell));
        order
            .iter()
            .fold(base, |sum, &axis| {
                let node = self.axes[axis].node(cell[axis]);
                sum + slopes[axis] * (Interval::point(state[axis]) - Interval::point(node))
            })
            .high()
    }

    /// Returns an upper bound of the height at a state, in metres; `None` outside the table.
    #[must_use]
    pub fn height_at(&self, state: [f64; AXIS_COUNT]) -> Option<f64> {
        if !self
            .axes
            .iter()
            .zip(state)
            .all(|(axis, value)| axis.range().contains(value))
        {
            return None;
        }
        let cell =
            std::array::from_fn(|axis| self.axes[axis].cells_of(Interval::point(state[axis]))[0]);
        let nodes = self
            .orders
            .iter()
            .flat_map(|order| self.simplex(cell, order));
        let highest_node_m = nodes
            .map(|node| self.node_height(node))
            .fold(f64::NEG_INFINITY, f64::max);
        let highest_m = self
            .orders
            .iter()
            .map(|order| self.plane_height(cell, order, state))
            .fold(f64::NEG_INFINITY, f64::max);
        Some(highest_m.min(highest_node_m))
    }

    /// Returns the mean height over a cell.
    pub(super) fn mean_height(&self, [i, j]: [usize; AXIS_COUNT]) -> Interval {
        let has_cells = [self.axes[0].cells > 0, self.axes[1].cells > 0];
        // Mean over the simplices of the means of their nodes.
        let weighted: &[([usize; 2], f64, f64)] = match has_cells {
            [true, true] => &[
                ([0, 0], 1.0, 3.0),
                ([1, 1], 1.0, 3.0),
                ([0, 1], 1.0, 6.0),
                ([1, 0], 1.0, 6.0),
            ],
            [true, false] => &[([0, 0], 1.0, 2.0), ([1, 0], 1.0, 2.0)],
            [false, true] => &[([0, 0], 1.0, 2.0), ([0, 1], 1.0, 2.0)],
            [false, false] => &[([0, 0], 1.0, 1.0)],
        };
        weighted
            .iter()
            .fold(Interval::ZERO, |sum, &([own, leader], share, of)| {
                let height = Interval::point(self.node_height([i + own, j + leader]));
                sum + (height * Interval::point(share)).over(Interval::point(of))
            })
    }
}

fn indices([own, leader]: [usize; AXIS_COUNT]) -> impl Iterator<Item = [usize; AXIS_COUNT]> {
    (0..own).flat_map(move |i| (0..leader).map(move |j| [i, j]))
}
