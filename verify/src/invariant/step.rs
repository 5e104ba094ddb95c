//! The condition on one part of one cell, and its proof: see [`invariant`](super).

use super::MotionModel;
use super::command::CommandModel;
use super::table::{AXIS_COUNT, HeightTable, TableAxis};
use crate::interval::Interval;
use crate::motion::distance_and_speed_after;
use crate::reach::form::AffineForm;
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};

const INTERVAL_OPS_PER_PART: u64 = 60;
const INTERVAL_OPS_PER_SIMPLEX: u64 = 12;
/// Maximum number of cells that one decision interval may touch.
const MAX_TOUCHED_CELLS: usize = 4096;

/// A vehicle under test behind a leader, with the boundary of a set.
#[derive(Debug)]
pub(super) struct ClosedLoop<'a> {
    pub(super) motion: MotionModel,
    pub(super) command: CommandModel<'a>,
    pub(super) interval_s: Interval,
    pub(super) own_mps2: Interval,
    pub(super) leader_mps2: Interval,
    /// Largest errors of the observed gap, own and leader's speed.
    pub(super) error: [f64; 3],
    pub(super) splits: u32,
    pub(super) ends_beyond_gap_m: f64,
    pub(super) budget: &'a OpBudget,
}

/// Bounds of the motion over a decision interval.
struct Change {
    /// Lower bounds of the leader's distance, and of the growth of the gap.
    leader_m: f64,
    growth_m: f64,
    /// Largest acceleration, if it is a braking that may stop the vehicle.
    stops_at_mps2: Option<f64>,
    of_state: [Interval; AXIS_COUNT],
}

/// A part of a simplex, and how far above the boundary its states are.
#[derive(Clone)]
struct Part {
    cell: [usize; AXIS_COUNT],
    order: usize,
    /// Barycentric coordinates of the nodes after the first.
    shares: [Interval; AXIS_COUNT],
    above_m: Interval,
}

/// Speeds of the states of a part, and their closing speeds.
#[derive(Clone, Copy)]
struct PartRanges {
    of_axis: [Interval; AXIS_COUNT],
    closing: Interval,
}

impl ClosedLoop<'_> {
    /// Checks that no state of a cell at or above the boundary leaves the set within one decision interval.
    ///
    /// # Errors
    /// The missing height in metres, of the first part that fails.
    pub(super) fn check_cell(
        &self,
        table: &HeightTable,
        cell: [usize; AXIS_COUNT],
    ) -> Result<(), f64> {
        let share = Interval::ZERO.hull(Interval::ONE);
        (0..table.orders().len()).try_for_each(|order| {
            let mut part = Part {
                cell,
                order,
                shares: [share; AXIS_COUNT],
                above_m: Interval::ZERO,
            };
            // Further above the boundary than this no command leads out of the set.
            let layer_m = self
                .missing_m(table, &part.ranges(table), self.own_mps2, 0.0)
                .max(0.0);
            part.above_m = Interval::new(0.0, layer_m).ok_or(f64::INFINITY)?;
            self.check_part(table, &part, self.splits)
        })
    }

    fn check_part(&self, table: &HeightTable, part: &Part, splits: u32) -> Result<(), f64> {
        // Above the budget every part fails at once, and is not divided.
        if !self
            .budget
            .charge(INTERVAL_OPS_PER_PART * OPS_PER_INTERVAL_OP)
        {
            return Err(f64::INFINITY);
        }
        let (gap, [own, leader]) = part.forms(table);
        if gap.range().low() > self.ends_beyond_gap_m {
            return Ok(());
        }
        let mut observed = [gap, own, leader];
        observed
            .iter_mut()
            .zip(self.error)
            .for_each(|(form, error)| form.widen(error));
        let command = self.command.range(&observed, self.own_mps2, self.budget);
        let missing_m = self.missing_m(table, &part.ranges(table), command, part.above_m.low());
        if missing_m <= 0.0 {
            return Ok(());
        }
        if splits == 0 {
            return Err(missing_m);
        }
        let mut parts = vec![part.clone()];
        for share in (0..table.orders()[part.order].len())
            .map(Some)
            .chain([None])
        {
            parts = parts.iter().flat_map(|part| part.halves(share)).collect();
        }
        // A part with a sum of 1 at its lowest corner has one state at most, which is also in another part.
        let is_inside =
            |part: &&Part| part.shares.iter().map(|share| share.low()).sum::<f64>() < 1.0;
        parts
            .iter()
            .filter(is_inside)
            .try_for_each(|part| self.check_part(table, part, splits - 1))
    }

    /// Returns an upper bound of the height that states at least `above_m` above the boundary miss under a command.
    fn missing_m(
        &self,
        table: &HeightTable,
        ranges: &PartRanges,
        command: Interval,
        above_m: f64,
    ) -> f64 {
        let mut of_state = self.change(ranges, command).of_state;
        let mut touched = [[0; 2]; AXIS_COUNT];
        for (axis, touched) in touched.iter_mut().enumerate() {
            let (whole, part) = (table.axes()[axis].range(), ranges.of_axis[axis]);
            // The claim ends where a state leaves the table.
            let leaving = [whole.low() - part.high(), whole.high() - part.low()];
            let to_edge = Interval::new(leaving[0].next_down(), leaving[1].next_up())
                .unwrap_or(Interval::ENTIRE);
            of_state[axis] = clip(of_state[axis], to_edge);
            // No rounding where no state moves: a simplex that contains only the start adds nothing.
            let (change, moved) = (of_state[axis], part + of_state[axis]);
            let low = if change.low() < 0.0 {
                moved.low()
            } else {
                part.low()
            };
            let high = if change.high() > 0.0 {
                moved.high()
            } else {
                part.high()
            };
            let reached = Interval::new(low, high).unwrap_or(Interval::ENTIRE);
            *touched = table.axes()[axis].cells_of(clip(reached, whole));
        }
        let count: usize = touched
            .iter()
            .map(|[first, last]| last - first + 1)
            .product();
        let operations =
            (count * table.orders().len()) as u64 * INTERVAL_OPS_PER_SIMPLEX * OPS_PER_INTERVAL_OP;
        if count > MAX_TOUCHED_CELLS || !self.budget.charge(operations) {
            return f64::INFINITY;
        }
        let [own, leader] = touched.map(|[first, last]| first..=last);
        let mut worst_m = f64::NEG_INFINITY;
        for cell in own.flat_map(|i| leader.clone().map(move |j| [i, j])) {
            let mut from = *ranges;
            let mut of_state = of_state;
            let is_touched = |(axis, &TableAxis { cells, .. }): (usize, &TableAxis)| {
                let whole = [from.of_axis[axis], of_state[axis]];
                let reach = touch(whole[0], whole[1], table.axes()[axis].cell(cell[axis]));
                let reach = if cells == 0 { Some(whole) } else { reach };
                reach
                    .map(|[start, along]| (from.of_axis[axis], of_state[axis]) = (start, along))
                    .is_some()
            };
            if !table.axes().iter().enumerate().all(is_touched) {
                continue;
            }
            let change = self.change(&from, command);
            for axes in table.orders() {
                let slopes = table.slopes(cell, axes);
                let (spare_m, own) = match change.stops_at_mps2.filter(|_| slopes[0].low() >= 0.0) {
                    Some(braking) => (
                        change.leader_m,
                        self.stopping_rise(from.of_axis[0], braking, slopes[0]),
                    ),
                    None => (change.growth_m, slopes[0] * of_state[0]),
                };
                let others = axes
                    .iter()
                    .filter(|&&axis| axis > 0 && slopes[axis] != Interval::ZERO);
                let less = |sum: f64, &axis: &usize| {
                    sum_below(sum, -(slopes[axis] * of_state[axis]).high())
                };
                let missing_m =
                    -others.fold(sum_below(sum_below(above_m, spare_m), -own.high()), less);
                worst_m = if missing_m.is_nan() {
                    f64::INFINITY
                } else {
                    worst_m.max(missing_m)
                };
            }
        }
        // The own cell is always touched.
        if worst_m == f64::NEG_INFINITY {
            f64::INFINITY
        } else {
            worst_m
        }
    }

    fn change(&self, ranges: &PartRanges, command: Interval) -> Change {
        let point = Interval::point;
        let (time, half) = (self.interval_s, self.interval_s.sqr() * point(0.5));
        let [own, leader] = ranges.of_axis;
        if self.motion == MotionModel::Relative {
            let relative = command - self.leader_mps2;
            return Change {
                leader_m: 0.0,
                growth_m: -(own * time + point(relative.high()) * half).high(),
                stops_at_mps2: None,
                of_state: [relative * time, Interval::ZERO],
            };
        }
        let leads = self.leader_mps2;
        let changes = |speed: Interval, acceleration: Interval| (acceleration * time).max(-speed);
        let hardest = point(command.high());
        let leader_m = distance_and_speed_after(point(leader.low()), point(leads.low()), time)
            .0
            .low()
            .max(0.0);
        let own_m = distance_and_speed_after(point(own.high()), hardest, time)
            .0
            .high();
        let may_stop = (point(own.low()) + hardest * time).low() < 0.0;
        // A vehicle that may stop covers at least w T - b T²/2; one that does not stop covers v T + a T²/2.
        let of_closing =
            (point(leads.low()) - hardest) * half - point(ranges.closing.high()) * time;
        let apart_m = sum_below(leader_m, -own_m);
        Change {
            leader_m,
            growth_m: if may_stop {
                apart_m
            } else {
                apart_m.max(of_closing.low())
            },
            stops_at_mps2: may_stop.then_some(command.high()),
            of_state: [changes(own, command), changes(leader, leads)],
        }
    }

    /// Returns d(v, a, T) + slope · max(a T, -v) for speeds v of a vehicle that may stop: for a slope of at least 0
    /// this is convex up to v = -a T and grows from there, so that it is largest at an end or at -a T.
    fn stopping_rise(&self, speed: Interval, acceleration: f64, slope: Interval) -> Interval {
        let acceleration = Interval::point(acceleration);
        let largest = -(acceleration * self.interval_s);
        let at = |speed: Interval| {
            let (covered, end) = distance_and_speed_after(speed, acceleration, self.interval_s);
            covered + slope * (end - speed)
        };
        let inner = largest
            .max(Interval::point(speed.low()))
            .min(Interval::point(speed.high()));
        // A vehicle at rest stays at rest, without rounding.
        let at_low = if speed.low() == 0.0 {
            Interval::ZERO
        } else {
            at(Interval::point(speed.low()))
        };
        at_low.max(at(Interval::point(speed.high()))).max(at(inner))
    }

    /// True if no state of the table reaches a larger own speed than the table has, whatever the gap.
    pub(super) fn keeps_own_speed(&self, table: &HeightTable, farthest_m: f64) -> bool {
        let axis = table.axes()[0];
        let fastest = Interval::point(self.own_mps2.high().max(0.0)) * self.interval_s;
        let keeps = |index: usize| {
            let speeds = axis.cell(index);
            if (speeds + fastest).high() <= axis.high {
                return true;
            }
            let gap = Interval::new(table.extremes()[0], farthest_m).unwrap_or(Interval::ENTIRE);
            let mut observed = [gap, speeds, table.axes()[1].range()].map(AffineForm::constant);
            observed
                .iter_mut()
                .zip(self.error)
                .for_each(|(form, error)| form.widen(error));
            self.command
                .range(&observed, self.own_mps2, self.budget)
                .high()
                <= 0.0
        };
        self.motion == MotionModel::Absolute && (0..axis.cells as usize).all(keeps)
    }
}

impl Part {
    /// Returns the gap, and the states without it, as forms in the shares and the height above.
    fn forms(&self, table: &HeightTable) -> (AffineForm, [AffineForm; AXIS_COUNT]) {
        let nodes = table.simplex(self.cell, &table.orders()[self.order]);
        let affine = |at: &dyn Fn([usize; AXIS_COUNT]) -> f64| {
            let first = Interval::point(at(nodes[0]));
            let mut form = AffineForm::constant(first);
            for (symbol, &node) in nodes[1..].iter().enumerate() {
                let share = AffineForm::symbol(symbol, self.shares[symbol]);
                form.add_scaled(&share, Interval::point(at(node)) - first);
            }
            form
        };
        let height = affine(&|node| table.node_height(node));
        let of_axis =
            std::array::from_fn(|axis| affine(&|node| table.axes()[axis].node(node[axis])));
        (
            height.plus(&AffineForm::symbol(AXIS_COUNT, self.above_m)),
            of_axis,
        )
    }

    fn ranges(&self, table: &HeightTable) -> PartRanges {
        let (_, forms) = self.forms(table);
        let of_axis = |axis: usize| {
            clip(
                forms[axis].range(),
                table.axes()[axis].cell(self.cell[axis]),
            )
        };
        PartRanges {
            of_axis: std::array::from_fn(of_axis),
            closing: forms[0].clone().minus(&forms[1]).range(),
        }
    }

    /// Returns both halves of one share, or of the height above if there is no such share.
    fn halves(&self, share: Option<usize>) -> Vec<Self> {
        let with = |half: Interval| {
            let mut part = self.clone();
            *share.map_or(&mut part.above_m, |share| &mut part.shares[share]) = half;
            part
        };
        halves(share.map_or(self.above_m, |share| self.shares[share]))
            .map(with)
            .collect()
    }
}

fn clip(range: Interval, limits: Interval) -> Interval {
    range
        .max(Interval::point(limits.low()))
        .min(Interval::point(limits.high()))
}

/// Returns a lower bound of a sum, which is the sum itself if double precision can express it: at rest nothing is lost.
fn sum_below(a: f64, b: f64) -> f64 {
    let sum = a + b;
    // Exact rounding error of the sum (Knuth).
    let of_b = sum - a;
    let error = (a - (sum - of_b)) + (b - of_b);
    if error >= 0.0 { sum } else { sum.next_down() }
}

/// Returns the members of `part` that touch a cell on their way by a member of `along`, and these ways.
fn touch(part: Interval, along: Interval, cell: Interval) -> Option<[Interval; 2]> {
    let low = part
        .low()
        .max((cell.low() - along.high().max(0.0)).next_down());
    let high = part
        .high()
        .min((cell.high() - along.low().min(0.0)).next_up());
    let [mut least, mut most] = [along.low(), along.high()];
    if part.high() <= cell.low() {
        least = least.max((cell.low() - part.high()).next_down().max(0.0));
    }
    if part.low() >= cell.high() {
        most = most.min((cell.high() - part.low()).next_up().min(0.0));
    }
    Some([Interval::new(low, high)?, Interval::new(least, most)?])
}

/// Returns both halves of a range, or the range alone if it is a single number.
fn halves(range: Interval) -> impl Iterator<Item = Interval> {
    let middle = 0.5 * (range.low() + range.high());
    let is_point = !(range.low() < middle && middle < range.high());
    let first = if is_point {
        Some(range)
    } else {
        Interval::new(range.low(), middle)
    };
    let second = if is_point {
        None
    } else {
        Interval::new(middle, range.high())
    };
    first.into_iter().chain(second)
}
