//! Minimum and maximum over a sliding window, in linear time.
//!
//! The block method of van Herk (Pattern Recognition Letters 13, 1992) and of Gil and Werman (IEEE PAMI 15, 1993):
//! cut the values into blocks as long as the window; any window is then the end of one block and the start of the next,
//! and both are known from one scan backwards and one forwards. Like the queue of Lemire (Nordic Journal of Computing
//! 13, 2006) it takes at most three comparisons a value, but without a branch that depends on the data.

/// Which of the two is sought.
pub(super) trait Extremum: Copy {
    /// Of no values at all.
    const IDENTITY: f64;
    fn combine(a: f64, b: f64) -> f64;
}

#[derive(Clone, Copy)]
pub(super) struct Minimum;

#[derive(Clone, Copy)]
pub(super) struct Maximum;

// Compared by hand, since `f64::min` and `f64::max` spend time on NaN, of which there is none here.
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

/// For each of the first `outputs` positions the extremum of the `width` values from there on, fewer at the end. The result
/// takes the values' place.
pub(super) fn sliding_extremum<E: Extremum>(mut values: Vec<f64>, width: usize, outputs: usize) -> Vec<f64> {
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
        // A window that starts inside a block ends inside the next one: the window at offset o takes its first o values,
        // which are still there.
        let mut start = E::IDENTITY;
        let mut slots = block.iter_mut().skip(1);
        for (&value, slot) in later.iter().zip(slots.by_ref()) {
            start = E::combine(start, value);
            *slot = E::combine(*slot, start);
        }
        // The next block may be shorter: windows that reach past it are clipped.
        slots.for_each(|slot| *slot = E::combine(*slot, start));
        rest = later;
    }
}

/// The extremum of all, in lanes that do not wait for one another.
fn extremum<E: Extremum>(values: &[f64]) -> f64 {
    let (groups, rest) = values.as_chunks::<16>();
    let mut lanes = [E::IDENTITY; 16];
    for group in groups {
        for (lane, &value) in lanes.iter_mut().zip(group) {
            *lane = E::combine(*lane, value);
        }
    }
    lanes.iter().chain(rest).fold(E::IDENTITY, |all, &value| E::combine(all, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_its_definition(
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
