//! Decisions at an interval, held in between.

/// When a controller that decides only every so often decides.
#[derive(Debug, Clone, Copy)]
pub(super) struct Interval {
    steps: u32,
    until_decision: u32,
}

impl Interval {
    /// The first decision is due at once.
    pub(super) fn new(interval_s: f64, step_s: f64) -> Self {
        Self { steps: (interval_s / step_s).round().max(1.0) as u32, until_decision: 0 }
    }

    /// Whether a decision is due at this step; counts the step.
    #[inline]
    pub(super) fn is_due(&mut self) -> bool {
        let due = self.until_decision == 0;
        if due {
            self.until_decision = self.steps;
        }
        self.until_decision -= 1;
        due
    }
}
