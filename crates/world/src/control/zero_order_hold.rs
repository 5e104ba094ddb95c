//! Controllers that decide less often than the scenario steps.

use super::Controller;
use crate::estimate::Observation;

/// Asks a controller once an interval and holds its answer in between.
pub struct ZeroOrderHold {
    controller: Box<dyn Controller>,
    interval_s: f64,
    interval_steps: u32,
    steps_to_decision: u32,
    held_mps2: f64,
}

impl ZeroOrderHold {
    /// Paces `controller` to one decision every `interval_s` in a scenario that steps every `step_s`.
    #[must_use]
    pub fn new(controller: Box<dyn Controller>, interval_s: f64, step_s: f64) -> Self {
        let interval_steps = (interval_s / step_s).round().max(1.0) as u32;
        Self { controller, interval_s, interval_steps, steps_to_decision: 0, held_mps2: 0.0 }
    }
}

impl Controller for ZeroOrderHold {
    fn act(&mut self, seen: &Observation) -> f64 {
        if self.steps_to_decision == 0 {
            self.steps_to_decision = self.interval_steps;
            self.held_mps2 = self.controller.act(seen);
        }
        self.steps_to_decision -= 1;
        self.held_mps2
    }

    fn interval_s(&self) -> Option<f64> {
        Some(self.interval_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::behind;
    use super::*;

    #[test]
    fn decides_at_the_first_step_and_then_once_an_interval() {
        struct Counter(f64);
        impl Controller for Counter {
            fn act(&mut self, _: &Observation) -> f64 {
                self.0 += 1.0;
                self.0
            }
        }
        let mut held = ZeroOrderHold::new(Box::new(Counter(0.0)), 0.03, 0.01);
        let answers = [0; 7].map(|_| held.act(&behind(20.0, 20.0, 20.0, 0.0)));
        assert_eq!(answers, [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0]);
    }
}
