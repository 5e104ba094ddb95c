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

/// The gap, and the states without it, as forms in the shares of a part and the height above.
struct PartForms {
    gap: AffineForm,
    of_axis: [AffineForm; AXIS_COUNT],
}

/// Speeds of the states of a part, and their closing speeds.
#[derive(Clone, Copy)]
struct PartRanges {
    of_axis: [Interval; AXIS_COUNT],
    closing: Interval,
}

/// Change of a state along one axis until it leaves the table, and the first and last cell that it reaches.
struct AxisMotion {
    change: Interval,
    cells: [usize; 2],
}

/// States that touch a cell on their way, and their changes until then.
struct TouchingStates {
    ranges: PartRanges,
    changes: [Interval; AXIS_COUNT],
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
        let PartForms { gap, of_axis } = part.forms(table);
        if gap.range().low() > self.ends_beyond_gap_m {
            return Ok(());
        }
        let [own, leader] = of_axis;
        let command = self.command_range([gap, own, leader]);
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
        let changes = self.change(ranges, command).of_state;
        let motions: [AxisMotion; AXIS_COUNT] = std::array::from_fn(|axis| {
            AxisMotion::new(&table.axes()[axis], ranges.of_axis[axis], changes[axis])
        });
        let count: usize = motions
            .iter()
            .map(|AxisMotion { cells, .. }| cells[1] - cells[0] + 1)
            .product();
        let operations =
            (count * table.orders().len()) as u64 * INTERVAL_OPS_PER_SIMPLEX * OPS_PER_INTERVAL_OP;
        if count > MAX_TOUCHED_CELLS || !self.budget.charge(operations) {
            return f64::INFINITY;
        }
        let changes = motions.each_ref().map(|motion| motion.change);
        let [own, leader] = motions.map(
            |AxisMotion {
                 cells: [first, last],
                 ..
             }| first..=last,
        );
        let mut worst_m = f64::NEG_INFINITY;
        for cell in own.flat_map(|i| leader.clone().map(move |j| [i, j])) {
            let Some(states) = TouchingStates::new(*ranges, changes, table, cell) else {
                continue;
            };
            let change = self.change(&states.ranges, command);
            for axes in table.orders() {
                let slopes = table.slopes(cell, axes);
                let missing_m = self.missing_in_simplex_m(&states, &change, axes, &slopes, above_m);
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

    /// Returns an upper bound of the missing height of states in a simplex, over which the boundary has these slopes.
    fn missing_in_simplex_m(
        &self,
        states: &TouchingStates,
        change: &Change,
        axes: &[usize],
        slopes: &[Interval; AXIS_COUNT],
        above_m: f64,
    ) -> f64 {
        let braking = change.stops_at_mps2.filter(|_| slopes[0].low() >= 0.0);
        let spare_m = if braking.is_some() {
            change.leader_m
        } else {
            change.growth_m
        };
        let own_rise = braking.map_or_else(
            || slopes[0] * states.changes[0],
            |braking| self.stopping_rise(states.ranges.of_axis[0], braking, slopes[0]),
        );
        let spare_m = sum_below(sum_below(above_m, spare_m), -own_rise.high());
        -axes
            .iter()
            .filter(|&&axis| axis > 0 && slopes[axis] != Interval::ZERO)
            .fold(spare_m, |sum, &axis| {
                sum_below(sum, -(slopes[axis] * states.changes[axis]).high())
            })
    }

    fn change(&self, ranges: &PartRanges, command: Interval) -> Change {
        let point = Interval::point;
        let time = self.interval_s;
        let half = time.sqr() * point(0.5);
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
            of_state: [(command * time).max(-own), (leads * time).max(-leader)],
        }
    }

    /// Returns d(v, a, T) + slope · max(a T, -v) for speeds v of a vehicle that may stop: for a slope of at least 0
    /// this is convex up to v = -a T and grows from there, so that it is largest at an end or at -a T.
    fn stopping_rise(&self, speed: Interval, acceleration: f64, slope: Interval) -> Interval {
        let acceleration = Interval::point(acceleration);
        let largest = -(acceleration * self.interval_s);

        let inner = largest
            .max(Interval::point(speed.low()))
            .min(Interval::point(speed.high()));
        // A vehicle at rest stays at rest, without rounding.
        let at_low = if speed.low() == 0.0 {
            Interval::ZERO
        } else {
            self.rise(Interval::point(speed.low()), acceleration, slope)
        };
        at_low
            .max(self.rise(Interval::point(speed.high()), acceleration, slope))
            .max(self.rise(inner, acceleration, slope))
    }

    /// Returns d(v, a, T) + slope · (v(T) - v).
    fn rise(&self, speed: Interval, acceleration: Interval, slope: Interval) -> Interval {
        let (covered, end) = distance_and_speed_after(speed, acceleration, self.interval_s);
        covered + slope * (end - speed)
    }

    /// True if no state of the table reaches a larger own speed than the table has, whatever the gap.
    pub(super) fn keeps_own_speed(&self, table: &HeightTable, farthest_m: f64) -> bool {
        self.motion == MotionModel::Absolute
            && (0..table.axes()[0].cells as usize)
                .all(|index| self.keeps_own_speed_in_cell(table, index, farthest_m))
    }

    fn keeps_own_speed_in_cell(&self, table: &HeightTable, index: usize, farthest_m: f64) -> bool {
        let axis = table.axes()[0];
        let fastest = Interval::point(self.own_mps2.high().max(0.0)) * self.interval_s;
        let speeds = axis.cell(index);
        if (speeds + fastest).high() <= axis.high {
            return true;
        }
        let gap = Interval::new(table.extremes()[0], farthest_m).unwrap_or(Interval::ENTIRE);
        let observed = [gap, speeds, table.axes()[1].range()].map(AffineForm::constant);
        self.command_range(observed).high() <= 0.0
    }

    /// Bounds the command for a gap, own and leader's speed that are observed with errors.
    fn command_range(&self, mut observed: [AffineForm; 3]) -> Interval {
        observed
            .iter_mut()
            .zip(self.error)
            .for_each(|(form, error)| form.widen(error));
        self.command.range(&observed, self.own_mps2, self.budget)
    }
}

impl AxisMotion {
    fn new(axis: &TableAxis, part: Interval, change: Interval) -> Self {
        let whole = axis.range();
        // The claim ends where a state leaves the table.
        let leaving = [whole.low() - part.high(), whole.high() - part.low()];
        let to_edge =
            Interval::new(leaving[0].next_down(), leaving[1].next_up()).unwrap_or(Interval::ENTIRE);
        let change = clip(change, to_edge);
        let moved = part + change;
        // No rounding where no state moves: a simplex that contains only the start adds nothing.
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
        Self {
            change,
            cells: axis.cells_of(clip(reached, whole)),
        }
    }
}

impl TouchingStates {
    /// Returns the states that touch `cell` on their way, or `None` if none does.
    fn new(
        ranges: PartRanges,
        changes: [Interval; AXIS_COUNT],
        table: &HeightTable,
        cell: [usize; AXIS_COUNT],
    ) -> Option<Self> {
        let mut states = Self { ranges, changes };
        // All states are in the only cell of an axis without extent.
        for (index, axis) in table
            .axes()
            .iter()
            .enumerate()
            .filter(|(_, axis)| axis.cells > 0)
        {
            let [start, along] = touch(
                ranges.of_axis[index],
                changes[index],
                axis.cell(cell[index]),
            )?;
            states.ranges.of_axis[index] = start;
            states.changes[index] = along;
        }
        Some(states)
    }
}

impl Part {
    fn forms(&self, table: &HeightTable) -> PartForms {
        let nodes = table.simplex(self.cell, &table.orders()[self.order]);
        let height = self.interpolate(&nodes, |node| table.node_height(node));
        PartForms {
            gap: height.plus(&AffineForm::symbol(AXIS_COUNT, self.above_m)),
            of_axis: std::array::from_fn(|axis| {
                self.interpolate(&nodes, |node| table.axes()[axis].node(node[axis]))
            }),
        }
    }

    /// Returns an affine function with the stated values at the nodes, as a form in the shares.
    fn interpolate(
        &self,
        nodes: &[[usize; AXIS_COUNT]],
        value_at: impl Fn([usize; AXIS_COUNT]) -> f64,
    ) -> AffineForm {
        let first = Interval::point(value_at(nodes[0]));
        let mut form = AffineForm::constant(first);
        for (symbol, &node) in nodes[1..].iter().enumerate() {
            let share = AffineForm::symbol(symbol, self.shares[symbol]);
            form.add_scaled(&share, Interval::point(value_at(node)) - first);
        }
        form
    }

    fn ranges(&self, table: &HeightTable) -> PartRanges {
        let forms = self.forms(table).of_axis;
        PartRanges {
            of_axis: std::array::from_fn(|axis| {
                clip(
                    forms[axis].range(),
                    table.axes()[axis].cell(self.cell[axis]),
                )
            }),
            closing: forms[0].clone().minus(&forms[1]).range(),
        }
    }

    /// Returns both halves of one share, or of the height above if there is no such share.
    fn halves(&self, share: Option<usize>) -> Vec<Self> {
        halves(share.map_or(self.above_m, |share| self.shares[share]))
            .map(|half| {
                let mut part = self.clone();
                *share.map_or(&mut part.above_m, |share| &mut part.shares[share]) = half;
                part
            })
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
