//! History of a policy's inputs.

use super::ObservationScaling;
use crate::observation::Observation;

/// Inputs of the last decisions, oldest first; empty before the first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameStack {
    frames: Vec<f32>,
    row: Vec<f32>,
}

impl FrameStack {
    /// Appends the inputs of a decision. Returns those of the history of `scaling`, oldest first. The inputs of the
    /// first decision stand for all earlier ones. `last_answer_mps2` is the controller's last answer.
    pub fn push(
        &mut self,
        scaling: &ObservationScaling,
        observation: &Observation,
        last_answer_mps2: f64,
    ) -> &[f32] {
        let width = scaling.width();
        let every = scaling.history_every;
        let Self { frames, row } = self;
        let is_first = frames.is_empty();
        if is_first {
            frames.resize((scaling.history.saturating_sub(1) * every + 1) * width, 0.0);
        } else {
            frames.copy_within(width.., 0);
        }
        let before = frames.len() - width;
        scaling.write_state(observation, last_answer_mps2, &mut frames[before..]);
        if is_first {
            (0..before)
                .step_by(width)
                .for_each(|start| frames.copy_within(before.., start));
        }
        if every == 1 {
            return frames;
        }
        row.clear();
        row.extend(frames.chunks_exact(width).step_by(every).flatten());
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::ObservedQuantity;
    use crate::policy::{ExtraInput, STATE_LEN};

    /// Returns the last answer of each remembered decision after each of 20 decisions, whose answers are 1, 2, ...
    fn remembered(history: usize, history_every: usize) -> Vec<Vec<f32>> {
        let extra = vec![ExtraInput {
            quantity: ObservedQuantity::LastAnswerMps2,
            offset: 0.0,
            scale: 1.0,
        }];
        let scaling = ObservationScaling {
            history,
            history_every,
            limit: 100.0,
            extra,
            ..Default::default()
        };
        let observation = Observation {
            speed_mps: 20.0,
            acceleration_mps2: 0.0,
            ahead: None,
            behind: None,
        };
        let mut past = FrameStack::default();
        let decisions = (1..=20_u8).map(|answer| {
            let row = past.push(&scaling, &observation, f64::from(answer));
            assert_eq!(row.len(), history * scaling.width());
            row.chunks_exact(scaling.width())
                .map(|frame| frame[STATE_LEN])
                .collect()
        });
        decisions.collect()
    }

    #[test]
    fn the_history_drops_the_oldest_frame_and_begins_with_copies_of_the_first() {
        assert_eq!(
            remembered(3, 1)[..4],
            [
                [1.0, 1.0, 1.0],
                [1.0, 1.0, 2.0],
                [1.0, 2.0, 3.0],
                [2.0, 3.0, 4.0]
            ]
        );
    }

    #[test]
    fn the_history_contains_every_third_decision_up_to_the_current_one() {
        for (decision, row) in (1..=20_u8).zip(remembered(3, 3)) {
            assert_eq!(
                row,
                [6, 3, 0].map(|ago| f32::from(decision.saturating_sub(ago).max(1)))
            );
        }
    }
}
