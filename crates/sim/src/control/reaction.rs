//! Reaction times of drivers, and braking with limited jerk.

/// Number of whole steps since an event was first noticed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct ReactionTimer(Option<u32>);

impl ReactionTimer {
    /// Counts a step; 0 in the step of the event, `None` before. Once noticed, an event stays noticed.
    #[inline]
    pub(super) fn tick(&mut self, is_there: bool) -> Option<u32> {
        self.0 = match self.0 {
            Some(steps) => Some(steps.saturating_add(1)),
            None => is_there.then_some(0),
        };
        self.0
    }
}

pub(super) fn whole_steps(delay_s: f64, step_s: f64) -> u32 {
    (delay_s / step_s).round() as u32
}

/// Braking that builds up at a limited jerk and ends at once.
///
/// A command holds for a step, so the mean over the step is commanded: speeds at steps are those of the ramp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BrakeRamp {
    now_mps2: f64,
    jerk_mps3: f64,
    step_s: f64,
}

impl BrakeRamp {
    pub(super) fn new(from_mps2: f64, jerk_mps3: f64, step_s: f64) -> Self {
        Self {
            now_mps2: from_mps2,
            jerk_mps3,
            step_s,
        }
    }

    /// Returns the mean braking over the next step towards the demanded one, in m/s², positive.
    #[inline]
    pub(super) fn step_towards(&mut self, asked_mps2: f64) -> f64 {
        let Self {
            now_mps2,
            jerk_mps3,
            step_s,
        } = *self;
        let rise_s = (asked_mps2 - now_mps2) / jerk_mps3;
        if rise_s <= 0.0 {
            self.now_mps2 = asked_mps2;
            return asked_mps2;
        }
        let rising_s = rise_s.min(step_s);
        let risen_mps2 = jerk_mps3 * rising_s;
        self.now_mps2 = if rise_s <= step_s {
            asked_mps2
        } else {
            now_mps2 + risen_mps2
        };
        ((now_mps2 + 0.5 * risen_mps2) * rising_s + asked_mps2 * (step_s - rising_s)) / step_s
    }
}
