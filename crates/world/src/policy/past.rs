//! What a policy has seen: the present, and where it looks back, what it saw at its decisions before.

use super::STATE;

/// What was seen at the last decisions, oldest first; empty before the first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Past(Vec<f32>);

impl Past {
    /// Takes in what is seen at a decision, and gives what was seen at the last `history` decisions, this one included, oldest first.
    /// Before the first decision the world is taken to have been as it was then.
    pub fn look_back(&mut self, history: usize, now: &[f32; STATE]) -> &[f32] {
        let row = &mut self.0;
        match row.len().checked_sub(STATE) {
            None => *row = now.repeat(history),
            Some(before) => {
                row.copy_within(STATE.., 0);
                row[before..].copy_from_slice(now);
            }
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_is_forgotten_and_before_the_first_all_was_as_it_was_then() {
        let mut past = Past::default();
        let firsts: Vec<Vec<f32>> = (1..=4_u8)
            .map(|decision| past.look_back(3, &[f32::from(decision); STATE]).iter().step_by(STATE).copied().collect())
            .collect();
        assert_eq!(firsts, [[1.0, 1.0, 1.0], [1.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]);
    }
}
