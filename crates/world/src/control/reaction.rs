//! How long ago something was first noticed: drivers react late.

/// Whole steps since something was first noticed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Noticed(Option<u32>);

impl Noticed {
    /// Counts a step, the one in which it is first noticed as 0; none before that. What was noticed once stays so.
    #[inline]
    pub(super) fn steps(&mut self, is_there: bool) -> Option<u32> {
        self.0 = match self.0 {
            Some(steps) => Some(steps.saturating_add(1)),
            None => is_there.then_some(0),
        };
        self.0
    }
}

/// The steps that a delay takes, to the nearest whole one.
pub(super) fn whole_steps(delay_s: f64, step_s: f64) -> u32 {
    (delay_s / step_s).round() as u32
}
