//! How much a check may do.
//!
//! A few hundred bytes can announce a million boxes of a hundred thousand steps each, or a hundred million runs. What a check does
//! is therefore counted while it goes on, in *operations*: about as many multiplications and additions. It stops with
//! [`Rejection::TooMuchWork`] once they are more than allowed. The count does not depend on the number of threads, so neither
//! does the verdict.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::Rejection;

const BILLION: u64 = 1_000_000_000;

/// Operations for one operation of outward-rounded intervals, more or less.
pub(crate) const OPS_PER_INTERVAL_OP: u64 = 20;

/// How many operations checking one certificate may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct WorkLimit(u64);

impl WorkLimit {
    /// As many as it takes.
    pub const UNLIMITED: Self = Self(u64::MAX);

    /// So many operations.
    #[must_use]
    pub const fn from_operations(operations: u64) -> Self {
        Self(operations)
    }

    /// So many billions of operations, for each of which a core takes a fraction of a second.
    #[must_use]
    pub const fn from_billions(billions: u64) -> Self {
        Self(billions.saturating_mul(BILLION))
    }

    /// The limit in whole billions.
    #[must_use]
    pub const fn to_billions(self) -> u64 {
        self.0 / BILLION
    }
}

/// 4000 billion operations: some ten minutes of one core for a statement about reach.
impl Default for WorkLimit {
    fn default() -> Self {
        Self::from_billions(4000)
    }
}

impl std::fmt::Display for WorkLimit {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(formatter)
    }
}

/// What is left of a limit, for any number of threads.
#[derive(Debug)]
pub(crate) struct OpBudget {
    limit: WorkLimit,
    spent: AtomicU64,
}

impl OpBudget {
    pub(crate) fn new(limit: WorkLimit) -> Self {
        Self { limit, spent: AtomicU64::new(0) }
    }

    /// Counts operations, best before they are done. Whether they may be.
    pub(crate) fn charge(&self, operations: u64) -> bool {
        let before = self.spent.update(Ordering::Relaxed, Ordering::Relaxed, |done| done.saturating_add(operations));
        before.saturating_add(operations) <= self.limit.0
    }

    /// Counts operations.
    ///
    /// # Errors
    /// [`Rejection::TooMuchWork`] if they, or those before, are too many.
    pub(crate) fn charge_or_reject(&self, operations: u64) -> Result<(), Rejection> {
        if self.charge(operations) { Ok(()) } else { Err(Rejection::BudgetExceeded { limit: self.limit }) }
    }
}
