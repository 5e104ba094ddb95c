//! Minimum and maximum over a sliding window, in linear time.
//!
//! The block method of van Herk (Pattern Recognition Letters 13, 1992) and of Gil and Werman (IEEE PAMI 15, 1993) cuts
//! the values into blocks of the window's length. Any window is the end of one block and the start of the next, both
//! known from a backward and a forward scan. Like the queue of Lemire (Nordic Journal of Computing 13, 2006) it needs
//! at most three comparisons a value, but no branch that depends on the data.

pub(super) trait Extremum: Copy {
    /// Extremum of no values.
    const IDENTITY: f64;
    fn combine(a: f64, b: f64) -> f64;
}

#[derive(Clone, Copy)]
pub(super) struct Minimum;

#[derive(Clone, Copy)]
pub(super) struct Maximum;

// Plain comparison: `f64::min` and `f64::max` also handle NaN, which cannot occur here.
impl Extremum for Minimum {
    const IDENTITY: f64 = f64::INFINITY;
    #[inline(always)]
    fn combine(a: f64, b: f64) -> f64 {
        if a < b { a } else { b }
    }
}

impl Extremum for Maximum {
    const IDENTITY: f64 = f64::NEG_INFINITY;
    #[inline(always)]
    fn combine(a: f64, b: f64) -> f64 {
        if a > b { a } else { b }
    }
}

/// Replaces each of the first `outputs` values by the extremum of the `width` values that begin with it, or of all that
/// are left at the end.
pub(super) fn sliding_extremum<E: Extremum>(
    mut values: Vec<f64>,
    width: usize,
    outputs: usize,
) -> Vec<f64> {
    let windows = outputs.min(values.len());
    match (width, windows) {
        (0, _) | (_, 0) => values.clear(),
        (1, _) => values.truncate(windows),
        (_, 1) => {
            let first = extremum::<E>(values.get(..width).unwrap_or(&values));
            values.clear();
            values.push(first);
        }
        _ => {
            scan_blocks::<E>(&mut values, width);
            values.truncate(windows);
        }
    }
    values.resize(outputs, E::IDENTITY);
    values
}

fn scan_blocks<E: Extremum>(values: &mut [f64], width: usize) {
    let mut rest = values;
    while !rest.is_empty() {
        let (block, later) = rest.split_at_mut(width.min(rest.len()));
        let mut end = E::IDENTITY;
        for slot in block.iter_mut().rev() {
            end = E::combine(end, *slot);
            *slot = end;
        }
        // A window at offset o contains the first o values of the next block, which are not overwritten yet.
        let mut start = E::IDENTITY;
        let mut slots = block.iter_mut().skip(1);
        for (&value, slot) in later.iter().zip(slots.by_ref()) {
            start = E::combine(start, value);
            *slot = E::combine(*slot, start);
        }
        // Windows that exceed a shorter next block are clipped.
        slots.for_each(|slot| *slot = E::combine(*slot, start));
        rest = later;
    }
}

/// Returns the extremum of all values, in independent SIMD lanes.
fn extremum<E: Extremum>(values: &[f64]) -> f64 {
    let (groups, rest) = values.as_chunks::<16>();
    let mut lanes = [E::IDENTITY; 16];
    for group in groups {
        for (lane, &value) in lanes.iter_mut().zip(group) {
            *lane = E::combine(*lane, value);
        }
    }
    lanes
        .iter()
        .chain(rest)
        .fold(E::IDENTITY, |all, &value| E::combine(all, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn sliding_extrema_equal_their_definition(
            values in prop::collection::vec(-10.0..10.0f64, 0..80),
            width in 0usize..100,
            outputs in 0usize..100,
        ) {
            let window = |k: usize| values.iter().skip(k).take(width).copied();
            let least: Vec<f64> = (0..outputs).map(|k| window(k).fold(f64::INFINITY, f64::min)).collect();
            let most: Vec<f64> = (0..outputs).map(|k| window(k).fold(f64::NEG_INFINITY, f64::max)).collect();
            prop_assert_eq!(sliding_extremum::<Minimum>(values.clone(), width, outputs), least);
            prop_assert_eq!(sliding_extremum::<Maximum>(values.clone(), width, outputs), most);
        }
    }
}
