//! Buffers that evaluations reuse.
//!
//! A search evaluates a formula on thousands of traces of equal length. Freed buffers would return to the system, which
//! clears their pages again; that costs as much as the monitor.

use std::cell::RefCell;

const MAX_ARRAYS: usize = 8;

/// Maximum capacity of a pooled buffer: 8 MiB.
const MAX_LENGTH: usize = 1 << 20;

thread_local! {
    static SPARE: RefCell<Vec<Vec<f64>>> = const { RefCell::new(Vec::new()) };
}

/// Returns an empty buffer.
pub(super) fn acquire() -> Vec<f64> {
    let mut array = SPARE.with_borrow_mut(Vec::pop).unwrap_or_default();
    array.clear();
    array
}

/// Returns a buffer to the pool.
pub(super) fn release(array: Vec<f64>) {
    SPARE.with_borrow_mut(|pool| {
        if pool.len() < MAX_ARRAYS && array.capacity() <= MAX_LENGTH {
            pool.push(array);
        }
    });
}
