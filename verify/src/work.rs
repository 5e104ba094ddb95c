//! Limit of the operations of a check.
//!
//! A few hundred bytes can declare a million boxes of a hundred thousand steps each, or a hundred million runs. A check
//! therefore counts *operations*, roughly multiplications and additions. It stops with [`Rejection::BudgetExceeded`]
//! above the limit. Neither the count nor the verdict depends on the number of threads.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::rejection::Rejection;

const BILLION: u64 = 1_000_000_000;

/// Approximate cost of one outward-rounded interval operation.
pub(crate) const OPS_PER_INTERVAL_OP: u64 = 20;

/// Maximum number of operations for checking one certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct WorkLimit(u64);

impl WorkLimit {
    /// No limit.
    pub const UNLIMITED: Self = Self(u64::MAX);

    /// Creates a limit from a number of operations.
    #[must_use]
    pub const fn from_operations(operations: u64) -> Self {
        Self(operations)
    }

    /// Creates a limit from billions of operations, each a fraction of a second on one core.
    #[must_use]
    pub const fn from_billions(billions: u64) -> Self {
        Self(billions.saturating_mul(BILLION))
    }

    /// Returns the limit in whole billions.
    #[must_use]
    pub const fn to_billions(self) -> u64 {
        self.0 / BILLION
    }
}

/// 4000 billion operations: about ten minutes of one core for a reach statement.
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

/// The rest of a limit, shared by threads.
#[derive(Debug)]
pub(crate) struct OpBudget {
    limit: WorkLimit,
    spent: AtomicU64,
}

impl OpBudget {
    pub(crate) fn new(limit: WorkLimit) -> Self {
        Self {
            limit,
            spent: AtomicU64::new(0),
        }
    }

    /// Counts operations, ideally before they run. Returns true while the limit holds.
    pub(crate) fn charge(&self, operations: u64) -> bool {
        let before = self
            .spent
            .update(Ordering::Relaxed, Ordering::Relaxed, |done| {
                done.saturating_add(operations)
            });
        before.saturating_add(operations) <= self.limit.0
    }

    /// Counts operations.
    ///
    /// # Errors
    /// [`Rejection::BudgetExceeded`] if the total exceeds the limit.
    pub(crate) fn charge_or_reject(&self, operations: u64) -> Result<(), Rejection> {
        if self.charge(operations) {
            Ok(())
        } else {
            Err(Rejection::BudgetExceeded { limit: self.limit })
        }
    }
}
