//! What a controller saw at its last decisions.

use super::Mapping;

/// What was seen at the last decisions, as many as the mapping looks back on; empty before the first, or if it does not look back.
#[derive(Default)]
pub(super) struct History<T>(Vec<T>);

impl<T: Copy> History<T> {
    /// Appends to `into` what a controller sees at a decision, in the order that the mapping says.
    pub(super) fn look_back(&mut self, mapping: &Mapping, now: impl Iterator<Item = T>, into: &mut Vec<T>) {
        if mapping.history == 1 {
            return into.extend(now);
        }
        let width = mapping.inputs.len();
        if self.0.is_empty() {
            self.0.extend(now);
            self.0 = self.0.repeat(mapping.history);
        } else {
            self.0.drain(..width);
            self.0.extend(now);
        }
        if mapping.newest_first {
            into.extend(self.0.rchunks_exact(width).flatten());
        } else {
            into.extend_from_slice(&self.0);
        }
    }
}
