//! Gathering evidence: where it is kept, and who hears how far it is.

use std::sync::atomic::{AtomicU64, Ordering};

use super::store::Store;

/// Evidence being gathered.
pub(super) struct Work<'a> {
    pub(super) store: &'a Store,
    done: AtomicU64,
    told: &'a (dyn Fn(u64) + Sync),
}

impl<'a> Work<'a> {
    pub(super) fn new(store: &'a Store, told: &'a (dyn Fn(u64) + Sync)) -> Self {
        Self { store, done: AtomicU64::new(0), told }
    }

    /// So many runs more are done.
    pub(super) fn did(&self, runs: u64) {
        (self.told)(self.done.fetch_add(runs, Ordering::Relaxed) + runs);
    }
}
