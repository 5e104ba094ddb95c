//! History of a policy's inputs.

use super::STATE_LEN;

/// Inputs of the last decisions, oldest first; empty before the first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameStack {
    frames: Vec<f32>,
    row: Vec<f32>,
}

impl FrameStack {
    /// Appends the inputs of a decision. Returns those of `history` decisions, each `every` after the previous one,
    /// oldest first. The inputs of the first decision stand for all earlier ones.
    pub fn push(&mut self, [history, every]: [usize; 2], now: &[f32; STATE_LEN]) -> &[f32] {
        let Self { frames: seen, row } = self;
        match seen.len().checked_sub(STATE_LEN) {
            None => *seen = now.repeat(history.saturating_sub(1) * every + 1),
            Some(before) => {
                seen.copy_within(STATE_LEN.., 0);
                seen[before..].copy_from_slice(now);
            }
        }
        if every == 1 {
            return seen;
        }
        row.clear();
        row.extend(seen.chunks_exact(STATE_LEN).step_by(every).flatten());
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_is_forgotten_and_before_the_first_all_was_as_it_was_then() {
        let mut past = FrameStack::default();
        let firsts: Vec<Vec<f32>> = (1..=4_u8)
            .map(|decision| {
                past.push([3, 1], &[f32::from(decision); STATE_LEN]).iter().step_by(STATE_LEN).copied().collect()
            })
            .collect();
        assert_eq!(firsts, [[1.0, 1.0, 1.0], [1.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]);
    }

    #[test]
    fn every_third_decision_up_to_the_present_one() {
        let mut past = FrameStack::default();
        for decision in 1..=20_u8 {
            let row = past.push([3, 3], &[f32::from(decision); STATE_LEN]);
            let expected = [6, 3, 0].map(|ago| f32::from(decision.saturating_sub(ago).max(1)));
            assert_eq!(row.iter().step_by(STATE_LEN).copied().collect::<Vec<_>>(), expected);
        }
    }
}
