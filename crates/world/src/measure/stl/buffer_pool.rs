//! Arrays kept from one evaluation to the next.
//!
//! A search evaluates a formula on thousands of traces of one length. Arrays asked for anew each time go back to the
//! system at the end, which then clears their pages again: that takes as long as the monitor itself.

use std::cell::RefCell;

/// Arrays kept by each thread.
const MAX_ARRAYS: usize = 8;

/// Numbers in the longest array that is kept: 8 MiB.
const MAX_LENGTH: usize = 1 << 20;

thread_local! {
    static SPARE: RefCell<Vec<Vec<f64>>> = const { RefCell::new(Vec::new()) };
}

/// An empty array.
pub(super) fn take() -> Vec<f64> {
    let mut array = SPARE.with_borrow_mut(Vec::pop).unwrap_or_default();
    array.clear();
    array
}

/// Keeps an array that is not needed any more.
pub(super) fn give(array: Vec<f64>) {
    SPARE.with_borrow_mut(|pool| {
        if pool.len() < MAX_ARRAYS && array.capacity() <= MAX_LENGTH {
            pool.push(array);
        }
    });
}
