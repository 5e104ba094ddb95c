//! Inputs of a controller at its last decisions.

use super::{HistoryPadding, Mapping};

/// Inputs at the last `history` decisions; empty before the first decision, or without a history.
#[derive(Default)]
pub struct InputHistory<T>(Vec<T>);

impl<T: Copy + Default> InputHistory<T> {
    /// Appends the inputs of a decision to `into`, in the order of the mapping.
    pub fn push(&mut self, mapping: &Mapping, now: impl Iterator<Item = T>, into: &mut Vec<T>) {
        if mapping.history == 1 {
            return into.extend(now);
        }
        let width = mapping.inputs.len();
        if self.0.is_empty() {
            self.0.extend(now);
            match mapping.history_padding {
                HistoryPadding::First => self.0 = self.0.repeat(mapping.history),
                HistoryPadding::Zeros => {
                    let before = width * (mapping.history - 1);
                    self.0
                        .splice(..0, std::iter::repeat_n(T::default(), before));
                }
            }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_decisions_before_the_first_are_the_first_or_zeros() {
        for (padding, newest_first, wanted) in [
            (
                HistoryPadding::First,
                false,
                [[1, 2, 1, 2, 1, 2], [1, 2, 1, 2, 3, 4]],
            ),
            (
                HistoryPadding::Zeros,
                false,
                [[0, 0, 0, 0, 1, 2], [0, 0, 1, 2, 3, 4]],
            ),
            (
                HistoryPadding::Zeros,
                true,
                [[1, 2, 0, 0, 0, 0], [3, 4, 1, 2, 0, 0]],
            ),
        ] {
            let own = Mapping::native();
            let inputs = own.inputs.iter().take(2).cloned().collect();
            let mapping = Mapping {
                history: 3,
                history_padding: padding,
                newest_first,
                inputs,
                ..own
            };
            let mut history = InputHistory::default();
            let rows = [[1, 2], [3, 4]].map(|now| {
                let mut row = Vec::new();
                history.push(&mapping, now.into_iter(), &mut row);
                row
            });
            assert_eq!(rows, wanted);
        }
    }
}
