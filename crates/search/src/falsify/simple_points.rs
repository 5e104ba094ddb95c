//! Inputs with few pieces, and small moves between them.
//!
//! Falsifying inputs tend to be simple: a hard brake, a pulse, a step. Uniform values for twenty pieces are hardly ever
//! like that. Signals are therefore drawn with few pieces at any times, often with extreme values (bang-bang).

use std::ops::Range;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::UnitCube;
use crumple_sim::random::Stream;

/// Numbers of pieces, drawn with equal probability up to the length of the signal.
const PIECE_COUNTS: [usize; 8] = [1, 2, 3, 4, 5, 6, 8, 10];
/// Range of the share of extreme values, which is drawn for each point.
const EXTREME_SHARE: Range<f64> = 0.5..0.9;

/// Draws a point whose signals have few pieces and whose values are often 0 or 1.
pub(super) fn sample_simple_point(cube: &UnitCube, random: &mut Stream) -> Vec<f64> {
    let extreme = random.random_range(EXTREME_SHARE);
    let mut point = Vec::with_capacity(cube.dimension());
    for block in cube.blocks() {
        let allowed = PIECE_COUNTS
            .iter()
            .take_while(|&&pieces| pieces <= block.len())
            .count();
        let pieces = PIECE_COUNTS
            .get(random.random_range(0..allowed.max(1)))
            .copied()
            .unwrap_or(1);
        let switches = rand::seq::index::sample(random, block.len() - 1, pieces - 1);
        let mut current = sample_value(extreme, random);
        point.push(current);
        for piece in 0..block.len() - 1 {
            if switches.iter().any(|switch| switch == piece) {
                current = sample_value(extreme, random);
            }
            point.push(current);
        }
    }
    point
}

fn sample_value(extreme: f64, random: &mut Stream) -> f64 {
    if random.random_bool(extreme) {
        f64::from(u8::from(random.random::<bool>()))
    } else {
        random.random()
    }
}

/// Returns the piece of a signal at `index`: the maximal run of equal values.
fn piece_at(block: &Range<usize>, point: &[f64], index: usize) -> Range<usize> {
    let before = (block.start..index)
        .rev()
        .take_while(|&i| point.get(i) == point.get(index))
        .count();
    let after = (index + 1..block.end)
        .take_while(|&i| point.get(i) == point.get(index))
        .count();
    index - before..index + 1 + after
}

/// Range of the standard deviation of a change, drawn on a logarithmic scale, so that no step size needs adaptation.
const STEP_DEVIATION: Range<f64> = 0.01..0.5;

/// Draws a neighbour: a piece, chosen by `weights`, changes its value or border, is split or merged. `None` if equal.
pub(super) fn sample_neighbour(
    cube: &UnitCube,
    point: &[f64],
    weights: &[f64],
    random: &mut Stream,
) -> Option<Vec<f64>> {
    let mut left = random.random::<f64>() * weights.iter().sum::<f64>();
    let index = weights.iter().position(|weight| {
        left -= weight;
        left <= 0.0
    })?;
    let block = cube.blocks().iter().find(|block| block.contains(&index))?;
    let change = SignalPiece::new(block, point, index)?.draw_change(random)?;
    let mut changed = point.to_vec();
    changed.get_mut(change.coordinates)?.fill(change.value);
    (changed != point).then_some(changed)
}

/// A piece of a signal, with a coordinate at which it may be split.
struct SignalPiece<'a> {
    block: &'a Range<usize>,
    range: Range<usize>,
    index: usize,
    value: f64,
    value_before: Option<f64>,
    value_after: Option<f64>,
}

/// A new value of some coordinates.
struct CoordinateChange {
    coordinates: Range<usize>,
    value: f64,
}

impl CoordinateChange {
    fn new(coordinates: Range<usize>, value: f64) -> Self {
        Self { coordinates, value }
    }
}

impl<'a> SignalPiece<'a> {
    fn new(block: &'a Range<usize>, point: &[f64], index: usize) -> Option<Self> {
        let range = piece_at(block, point, index);
        Some(Self {
            value_before: range
                .start
                .checked_sub(1)
                .filter(|i| block.contains(i))
                .and_then(|i| point.get(i))
                .copied(),
            value_after: Some(range.end)
                .filter(|i| block.contains(i))
                .and_then(|i| point.get(i))
                .copied(),
            block,
            range,
            index,
            value: *point.get(index)?,
        })
    }

    /// Draws a change; `None` if it needs a neighbouring piece that does not exist.
    fn draw_change(&self, random: &mut Stream) -> Option<CoordinateChange> {
        let start = self.range.start;
        let end = self.range.end;
        let reach = if random.random_bool(0.3) {
            random.random_range(1..=3)
        } else {
            1
        };
        Some(match random.random_range(0..20) {
            0..10 => CoordinateChange::new(start..end, self.draw_near_value(random)),
            10..13 => CoordinateChange::new(start..end, sample_value(0.5, random)),
            // Moves of a border, in either direction.
            13 => {
                let border = start.saturating_sub(reach).max(self.block.start);
                CoordinateChange::new(border..start, self.value)
            }
            14 => CoordinateChange::new(start..(start + reach).min(end), self.value_before?),
            15 => CoordinateChange::new(end..(end + reach).min(self.block.end), self.value),
            16 => {
                CoordinateChange::new(end.saturating_sub(reach).max(start)..end, self.value_after?)
            }
            17 => {
                let is_before = random.random();
                let value = if is_before {
                    self.value_before?
                } else {
                    self.value_after?
                };
                CoordinateChange::new(start..end, value)
            }
            // Splits, with a new value for the rest of the piece or of the signal.
            18 => {
                let is_first_part = random.random();
                let part = if is_first_part {
                    start..self.index + 1
                } else {
                    self.index..end
                };
                CoordinateChange::new(part, sample_value(0.5, random))
            }
            _ => CoordinateChange::new(self.index..self.block.end, sample_value(0.5, random)),
        })
    }

    fn draw_near_value(&self, random: &mut Stream) -> f64 {
        let step = STEP_DEVIATION.start
            * (STEP_DEVIATION.end / STEP_DEVIATION.start).powf(random.random());
        let change: f64 = StandardNormal.sample(random);
        (self.value + step * change).clamp(0.0, 1.0)
    }
}
