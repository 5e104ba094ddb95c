//! Division of long recordings into parts, so that memory stays bounded. Neighbouring parts overlap: an episode belongs
//! to the part whose core contains its onset, and the margins contain what happens before and after it.

use std::ops::Range;

use super::{DroppedItem, Recording, RecordingError};

/// Number of rows in the core of a part; tests use few.
#[cfg(not(test))]
pub(super) const PART_ROWS: usize = 500_000;
#[cfg(test)]
pub(super) const PART_ROWS: usize = 20_000;
/// Number of speeds and gaps in the core of a part.
const PART_VALUES: usize = 4 * PART_ROWS;
/// Largest number of rows of a part. Margins of dense traffic are shorter, so that only filled rows exceed it.
pub(super) const MAX_POINTS: usize = 5 * PART_ROWS;
/// Largest number of rows at one time, as many as vehicles.
pub(super) const MAX_SIMULTANEOUS: usize = 2 * PART_ROWS;
/// Time of a margin, in milliseconds: longer than a braking episode with its reaction.
pub(super) const MARGIN_MS: i64 = 60_000;

/// Times at which braking belongs to a recording without parts.
pub(super) const ALL_TIMES: Range<i64> = i64::MIN..i64::MAX;

/// Receives the parts of a recording, in order. Returns false to end reading.
pub type PartSink<'a> = dyn FnMut(Recording) -> Result<bool, RecordingError> + 'a;

/// Bounds of the current part of a series of samples.
pub(super) struct PartBounds {
    core_ms: Range<i64>,
    values_per_row: usize,
    /// Number of rows since the start of the core.
    rows: usize,
}

impl PartBounds {
    pub(super) fn new(values_per_row: usize) -> Self {
        Self {
            core_ms: ALL_TIMES,
            values_per_row,
            rows: 0,
        }
    }

    /// Counts a sample. Returns true if the part must end before it.
    pub(super) fn ends_before(&mut self, time_ms: i64) -> bool {
        self.rows += 1;
        if self.core_ms.end == i64::MAX
            && (self.rows > PART_ROWS || self.rows * self.values_per_row > PART_VALUES)
        {
            self.core_ms.end = time_ms;
        }
        time_ms >= self.core_ms.end.saturating_add(MARGIN_MS) || self.rows > 2 * PART_ROWS
    }

    /// Returns these bounds, and restarts them for another series.
    pub(super) fn restarted(&mut self) -> Self {
        let fresh = Self::new(self.values_per_row);
        std::mem::replace(self, fresh)
    }

    /// Ends the part, and begins the next one.
    pub(super) fn next(&mut self) -> EndedPart {
        let from_ms = self.core_ms.end;
        self.rows = 0;
        EndedPart {
            core_ms: std::mem::replace(&mut self.core_ms, from_ms..i64::MAX),
            next_from_ms: from_ms.saturating_sub(MARGIN_MS),
        }
    }
}

/// Times of a part that has ended.
pub(super) struct EndedPart {
    /// Times at which braking belongs to the part.
    pub(super) core_ms: Range<i64>,
    /// Start of the next part with its margin.
    pub(super) next_from_ms: i64,
}

/// Adds the omissions of another part.
pub fn merge_dropped(all: &mut Vec<DroppedItem>, more: Vec<DroppedItem>) {
    for item in more {
        if !all
            .iter_mut()
            .any(|earlier| earlier.omission.absorb(&item.omission))
        {
            all.push(item);
        }
    }
}
