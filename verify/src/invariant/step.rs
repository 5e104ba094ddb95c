//! The condition on one part of one cell, and its proof: see [`invariant`](super).

use super::command::{CommandModel, Observed};
use super::table::{AXIS_COUNT, Axis, HeightTable};
use super::{InvariantClaim, MotionModel};
use crate::interval::Interval;
use crate::motion::distance_and_speed_after;
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};

const INTERVAL_OPS_PER_PART: u64 = 60;
const INTERVAL_OPS_PER_SIMPLEX: u64 = 12;
/// Maximum number of cells that one decision interval may touch.
const MAX_TOUCHED_CELLS: usize = 4096;

/// A part of a cell for which the condition fails, with the simplex and the motion for which it fails most.
#[derive(Debug, Clone, PartialEq)]
pub struct Shortfall {
    /// Missing height, in metres; infinite if the part leaves the table.
    pub missing_m: f64,
    /// Cell of the simplex.
    pub cell: [usize; AXIS_COUNT],
    /// Index of the order of the simplex.
    pub order: usize,
    /// Change of the state over the decision interval.
    pub change: [f64; AXIS_COUNT],
}

/// A vehicle under test behind a leader, with the boundary of a set.
#[derive(Debug)]
pub struct ClosedLoop<'a> {
    pub(super) motion: MotionModel,
    pub(super) command: CommandModel<'a>,
    pub(super) interval_s: Interval,
    /// Shares of the difference to the command that the actuator covers in the first step, and in all steps.
    pub(super) response: [Interval; 2],
    pub(super) own_mps2: Interval,
    pub(super) leader_mps2: Interval,
    /// Largest errors of the observed gap, own and leader's speed.
    pub(super) error: [f64; 3],
    pub(super) splits: u32,
    pub(super) budget: &'a OpBudget,
}

/// Bounds of the motion over a decision interval.
struct Change {
    /// Distance of the leader, or in the relative model the growth of the gap: only the lower bound counts.
    leader_m: Interval,
    /// Distance of the vehicle under test: only the upper bound counts.
    own_m: Interval,
    /// Largest acceleration, if it is a braking that may stop the vehicle.
    stops_at_mps2: Option<f64>,
    of_state: [Interval; AXIS_COUNT],
}

/// A part of a cell, and how far above the boundary its states are.
#[derive(Clone)]
struct Part {
    ranges: [Interval; AXIS_COUNT],
    above_m: Interval,
}

impl ClosedLoop<'_> {
    /// Returns the largest vertical distance from the boundary below which a state of a cell may leave the set within
    /// one decision interval, with any command.
    fn layer_m(&self, table: &HeightTable, cell: [usize; AXIS_COUNT]) -> f64 {
        let ranges = std::array::from_fn(|axis| table.axes()[axis].cell(cell[axis]));
        match self.judge(table, &ranges, self.own_mps2, 0.0) {
            Some(shortfall) => shortfall.missing_m,
            None => 0.0,
        }
    }

    /// Checks that no state of a cell at or above the boundary leaves the set within one decision interval.
    ///
    /// # Errors
    /// [`Shortfall`] of the first part that fails.
    pub fn check_cell(&self, table: &HeightTable, cell: [usize; AXIS_COUNT]) -> Result<(), Shortfall> {
        let Some(above_m) = Interval::new(0.0, self.layer_m(table, cell)) else {
            return Err(Shortfall { missing_m: f64::INFINITY, cell, order: 0, change: [0.0; AXIS_COUNT] });
        };
        let ranges = std::array::from_fn(|axis| table.axes()[axis].cell(cell[axis]));
        self.check_part(table, cell, &Part { ranges, above_m }, self.splits)
    }

    fn check_part(
        &self,
        table: &HeightTable,
        cell: [usize; AXIS_COUNT],
        part: &Part,
        splits: u32,
    ) -> Result<(), Shortfall> {
        // Above the budget every part fails at once, and is not divided.
        if !self.budget.charge(INTERVAL_OPS_PER_PART * OPS_PER_INTERVAL_OP) {
            return Err(Shortfall { missing_m: f64::INFINITY, cell, order: 0, change: [0.0; AXIS_COUNT] });
        }
        let gap = table.heights_over(cell, &part.ranges) + part.above_m;
        let command = self.command.range(&self.observe(gap, &part.ranges), self.own_mps2, self.budget);
        let Some(shortfall) = self.judge(table, &part.ranges, command, part.above_m.low()) else { return Ok(()) };
        if splits == 0 {
            return Err(shortfall);
        }
        let mut parts = vec![part.clone()];
        for axis in 0..=AXIS_COUNT {
            let range = |part: &Part| part.ranges.get(axis).copied().unwrap_or(part.above_m);
            parts = parts.iter().flat_map(|part| halves(range(part)).map(|half| part.with_range(axis, half))).collect();
        }
        parts.iter().try_for_each(|part| self.check_part(table, cell, part, splits - 1))
    }

    fn observe(&self, gap: Interval, ranges: &[Interval; AXIS_COUNT]) -> Observed {
        let [gap_error, own_error, leader_error] = self.error.map(Interval::around_zero);
        Observed { gap: gap + gap_error, own: ranges[0] + own_error, leader: ranges[1] + leader_error }
    }

    /// Returns the shortfall of states at least `above_m` above the boundary, under a command.
    fn judge(
        &self,
        table: &HeightTable,
        ranges: &[Interval; AXIS_COUNT],
        command: Interval,
        above_m: f64,
    ) -> Option<Shortfall> {
        let change = self.change(ranges, command);
        let mut touched = [[0; 2]; AXIS_COUNT];
        let mut of_state = change.of_state;
        for (axis, touched) in touched.iter_mut().enumerate() {
            let (whole, part) = (table.axes()[axis].range(), ranges[axis]);
            // The claim ends where a state leaves the table.
            let leaving = [whole.low() - part.high(), whole.high() - part.low()];
            let to_edge = Interval::new(leaving[0].next_down(), leaving[1].next_up()).unwrap_or(Interval::ENTIRE);
            of_state[axis] = of_state[axis].max(Interval::point(to_edge.low())).min(Interval::point(to_edge.high()));
            let reached = (part + of_state[axis]).hull(part);
            let reached = reached.max(Interval::point(whole.low())).min(Interval::point(whole.high()));
            *touched = table.axes()[axis].cells_of(reached);
        }
        let count: usize = touched.iter().map(|[first, last]| last - first + 1).product();
        let mut worst = Shortfall {
            missing_m: if count > MAX_TOUCHED_CELLS { f64::INFINITY } else { f64::NEG_INFINITY },
            cell: std::array::from_fn(|axis| touched[axis][0]),
            order: 0,
            change: [0.0; AXIS_COUNT],
        };
        let simplices = (count * table.orders().len()) as u64;
        if count > MAX_TOUCHED_CELLS || !self.budget.charge(simplices * INTERVAL_OPS_PER_SIMPLEX * OPS_PER_INTERVAL_OP)
        {
            return Some(Shortfall { missing_m: f64::INFINITY, ..worst });
        }
        let [own, leader, acceleration] = touched.map(|[first, last]| first..=last);
        for cell in own.flat_map(|i| {
            let acceleration = acceleration.clone();
            leader.clone().flat_map(move |j| acceleration.clone().map(move |k| [i, j, k]))
        }) {
            let mut from = *ranges;
            let mut of_state = of_state;
            let is_touched = |(axis, &Axis { cells, .. }): (usize, &Axis)| {
                let reach = touch(from[axis], of_state[axis], table.axes()[axis].cell(cell[axis]));
                let reach = if cells == 0 { Some([from[axis], of_state[axis]]) } else { reach };
                reach.map(|[start, along]| (from[axis], of_state[axis]) = (start, along)).is_some()
            };
            if !table.axes().iter().enumerate().all(is_touched) {
                continue;
            }
            let change = self.change(&from, command);
            let spare_m = sum_below(above_m, change.leader_m.low().max(0.0));
            for (order, axes) in table.orders().iter().enumerate() {
                let slopes = table.slopes(cell, axes);
                let own = match change.stops_at_mps2.filter(|_| slopes[0].low() >= 0.0) {
                    Some(braking) => self.stopping_rise(from[0], braking, slopes[0]),
                    None => change.own_m + slopes[0] * of_state[0],
                };
                let others = axes.iter().filter(|&&axis| axis > 0 && slopes[axis] != Interval::ZERO);
                let less = |sum: f64, &axis: &usize| sum_below(sum, -(slopes[axis] * of_state[axis]).high());
                let missing_m = -others.fold(sum_below(spare_m, -own.high()), less);
                if missing_m > worst.missing_m || missing_m.is_nan() {
                    let end = |axis: usize| {
                        let [low, high] = [of_state[axis].low(), of_state[axis].high()];
                        let middle = 0.5 * (slopes[axis].low() + slopes[axis].high());
                        let is_stop = axis == 0 && change.stops_at_mps2.is_some();
                        match (is_stop || middle * low > middle * high, middle == 0.0) {
                            (true, _) => low,
                            (_, true) => 0.0_f64.clamp(low, high),
                            _ => high,
                        }
                    };
                    worst = Shortfall { missing_m, cell, order, change: std::array::from_fn(end) };
                }
            }
        }
        // The own cell is always touched.
        let holds = worst.missing_m <= 0.0 && worst.missing_m > f64::NEG_INFINITY;
        (!holds).then_some(worst)
    }

    fn change(&self, ranges: &[Interval; AXIS_COUNT], command: Interval) -> Change {
        let point = Interval::point;
        let (time, half) = (self.interval_s, self.interval_s.sqr() * point(0.5));
        let [own, leader, acceleration] = *ranges;
        if self.motion == MotionModel::Relative {
            let relative = command - self.leader_mps2;
            return Change {
                leader_m: Interval::ZERO,
                own_m: own * time + point(relative.high()) * half,
                stops_at_mps2: None,
                of_state: [relative * time, Interval::ZERO, Interval::ZERO],
            };
        }
        let blend = |share: Interval| acceleration * (Interval::ONE - share) + command * share;
        let [first, all] = self.response.map(blend);
        let (held, leads) = (first.hull(all), self.leader_mps2);
        let changes = |speed: Interval, acceleration: Interval| (acceleration * time).max(-speed);
        let hardest = point(held.high());
        Change {
            leader_m: distance_and_speed_after(point(leader.low()), point(leads.low()), time).0,
            own_m: distance_and_speed_after(point(own.high()), hardest, time).0,
            stops_at_mps2: ((point(own.low()) + hardest * time).low() < 0.0).then_some(held.high()),
            of_state: [changes(own, held), changes(leader, leads), (command - acceleration) * self.response[1]],
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
        let inner = largest.max(Interval::point(speed.low())).min(Interval::point(speed.high()));
        // A vehicle at rest stays at rest, without rounding.
        let at_low = if speed.low() == 0.0 { Interval::ZERO } else { at(Interval::point(speed.low())) };
        at_low.max(at(Interval::point(speed.high()))).max(at(inner))
    }

    /// True if no state of the table reaches a larger own speed than the table has, whatever the gap.
    pub(super) fn keeps_own_speed(&self, table: &HeightTable, farthest_m: f64) -> bool {
        let axis = table.axes()[0];
        let is_immediate = self.response[0] == Interval::ONE && self.motion == MotionModel::Absolute;
        let fastest = Interval::point(self.own_mps2.high().max(0.0)) * self.interval_s;
        let keeps = |index: usize| {
            let speeds = axis.cell(index);
            if (speeds + fastest).high() <= axis.high {
                return true;
            }
            let gap = Interval::new(table.extremes()[0], farthest_m).unwrap_or(Interval::ENTIRE);
            let ranges = [speeds, table.axes()[1].range(), table.axes()[2].range()];
            self.command.range(&self.observe(gap, &ranges), self.own_mps2, self.budget).high() <= 0.0
        };
        is_immediate && (0..axis.cells as usize).all(keeps)
    }
}

impl Part {
    fn with_range(&self, axis: usize, range: Interval) -> Self {
        let mut part = self.clone();
        match part.ranges.get_mut(axis) {
            Some(of_axis) => *of_axis = range,
            None => part.above_m = range,
        }
        part
    }
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
    let low = part.low().max((cell.low() - along.high().max(0.0)).next_down());
    let high = part.high().min((cell.high() - along.low().min(0.0)).next_up());
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
    let first = if is_point { Some(range) } else { Interval::new(range.low(), middle) };
    let second = if is_point { None } else { Interval::new(middle, range.high()) };
    first.into_iter().chain(second)
}

impl InvariantClaim {
    /// Returns 1 - (1 - f)ⁿ for the response f of each of n steps of a decision interval.
    pub(super) fn total_response(&self) -> Interval {
        if self.response_per_step == 1.0 {
            return Interval::ONE;
        }
        let stays = Interval::ONE - Interval::point(self.response_per_step);
        Interval::ONE - (0..self.decision_steps).fold(Interval::ONE, |product, _| product * stays)
    }
}
