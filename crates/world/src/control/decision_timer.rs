//! Decisions at an interval, held in between.

/// Counts steps between decisions.
#[derive(Debug, Clone, Copy)]
pub struct DecisionTimer {
    steps: u32,
    until_decision: u32,
}

impl DecisionTimer {
    /// Creates a timer whose first decision is due at once; without an interval, one is due at every step.
    #[must_use]
    pub fn new(interval_s: Option<f64>, step_s: f64) -> Self {
        let steps = interval_s.map_or(1, |interval_s| {
            (interval_s / step_s).round().max(1.0) as u32
        });
        Self {
            steps,
            until_decision: 0,
        }
    }

    /// Returns true if the interval is a whole number of steps.
    #[must_use]
    pub fn is_whole_steps(interval_s: f64, step_s: f64) -> bool {
        let steps = (interval_s / step_s).round();
        (1.0..=1e9).contains(&steps) && (steps * step_s - interval_s).abs() <= 1e-9 * interval_s
    }

    /// Counts the step. Returns true if a decision is due.
    #[inline]
    pub fn tick(&mut self) -> bool {
        let due = self.until_decision == 0;
        if due {
            self.until_decision = self.steps;
        }
        self.until_decision -= 1;
        due
    }
}
