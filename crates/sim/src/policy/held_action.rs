//! The action that a policy holds between decisions.

use super::ActionBounds;

/// The current action and the last answer.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HeldAction {
    action: f32,
    last_answer_mps2: f64,
}

impl HeldAction {
    /// Sets the action, between -1 and 1.
    #[inline]
    pub fn set(&mut self, action: f32) {
        self.action = action;
    }

    /// Returns the last answer, in m/s²; 0 before the first.
    #[must_use]
    #[inline]
    pub fn last_answer_mps2(&self) -> f64 {
        self.last_answer_mps2
    }

    /// Replaces the last answer by the command that was executed in its place, in m/s².
    pub fn set_last_answer_mps2(&mut self, answer_mps2: f64) {
        self.last_answer_mps2 = answer_mps2;
    }

    /// Returns the acceleration of the next step, in m/s²: linear in the action.
    #[inline]
    pub fn acceleration_mps2(&mut self, bounds: &ActionBounds) -> f64 {
        let ActionBounds {
            low_mps2,
            high_mps2,
        } = bounds;
        self.last_answer_mps2 =
            0.5 * (low_mps2 + high_mps2) + 0.5 * (high_mps2 - low_mps2) * f64::from(self.action);
        self.last_answer_mps2
    }
}
