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
    let same = |other: &usize| point.get(*other) == point.get(index);
    let before = (block.start..index).rev().take_while(same).count();
    let after = (index + 1..block.end).take_while(same).count();
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
    let piece = piece_at(block, point, index);
    let own = *point.get(index)?;
    let before = piece
        .start
        .checked_sub(1)
        .filter(|i| block.contains(i))
        .and_then(|i| point.get(i))
        .copied();
    let after = Some(piece.end)
        .filter(|i| block.contains(i))
        .and_then(|i| point.get(i))
        .copied();
    let reach = if random.random_bool(0.3) {
        random.random_range(1..=3)
    } else {
        1
    };
    let (range, new) = match random.random_range(0..20) {
        0..10 => {
            let step = STEP_DEVIATION.start
                * (STEP_DEVIATION.end / STEP_DEVIATION.start).powf(random.random());
            let change: f64 = StandardNormal.sample(random);
            (piece, (own + step * change).clamp(0.0, 1.0))
        }
        10..13 => (piece, sample_value(0.5, random)),
        // Moves of a border, in either direction.
        13 => (
            piece.start.saturating_sub(reach).max(block.start)..piece.start,
            own,
        ),
        14 => (piece.start..(piece.start + reach).min(piece.end), before?),
        15 => (piece.end..(piece.end + reach).min(block.end), own),
        16 => (
            piece.end.saturating_sub(reach).max(piece.start)..piece.end,
            after?,
        ),
        17 => (piece, if random.random() { before? } else { after? }),
        // Splits, with a new value for the rest of the piece or of the signal.
        18 => (
            if random.random() {
                piece.start..index + 1
            } else {
                index..piece.end
            },
            sample_value(0.5, random),
        ),
        _ => (index..block.end, sample_value(0.5, random)),
    };
    let mut changed = point.to_vec();
    changed.get_mut(range)?.fill(new);
    (changed != point).then_some(changed)
}
