//! The learned policy at the wheel.

use std::sync::Arc;

use super::{Controller, Ego};
use crate::estimate::Observation;
use crate::policy::{Policy, Workspace};

/// Asks a policy once every decision interval and holds its answer in between.
pub struct PolicyDriver {
    policy: Arc<Policy>,
    interval_steps: u32,
    steps_to_decision: u32,
    held_mps2: f64,
    space: Workspace,
}

impl PolicyDriver {
    /// A policy that drives a vehicle.
    #[must_use]
    pub fn new(policy: Arc<Policy>, ego: &Ego) -> Self {
        let interval_steps = (policy.header().decision_interval_s / ego.step_s).round().max(1.0) as u32;
        Self { policy, interval_steps, steps_to_decision: 0, held_mps2: 0.0, space: Workspace::default() }
    }

    /// Many drivers at once: those whose decision is due, in one matrix product for each run of equal policies.
    ///
    /// `see` is called once for each driver, in order. Every driver does what it would have done by itself.
    pub(crate) fn act_together(all: &mut [Self], mut see: impl FnMut(usize) -> Observation, commands_mps2: &mut [f64]) {
        let (mut due, mut seen) = (Vec::new(), Vec::new());
        for (index, driver) in all.iter_mut().enumerate() {
            let observation = see(index);
            if driver.is_due() {
                due.push((index, Arc::clone(&driver.policy)));
                seen.push(observation);
            }
        }
        let mut seen = seen.as_slice();
        let mut space = Workspace::default();
        for alike in due.chunk_by(|(_, a), (_, b)| Arc::ptr_eq(a, b)) {
            let (now, later) = seen.split_at(alike.len());
            seen = later;
            let mut answers_mps2 = vec![0.0; now.len()];
            alike[0].1.act_all(now, &mut space, &mut answers_mps2);
            for ((index, _), answer_mps2) in alike.iter().zip(answers_mps2) {
                all[*index].held_mps2 = answer_mps2;
            }
        }
        for (command_mps2, driver) in commands_mps2.iter_mut().zip(all) {
            *command_mps2 = driver.held_mps2;
        }
    }

    /// Whether a decision is due at this step; counts the step.
    fn is_due(&mut self) -> bool {
        let due = self.steps_to_decision == 0;
        if due {
            self.steps_to_decision = self.interval_steps;
        }
        self.steps_to_decision -= 1;
        due
    }
}

impl Controller for PolicyDriver {
    fn act(&mut self, seen: &Observation) -> f64 {
        if self.is_due() {
            self.held_mps2 = self.policy.act(seen, &mut self.space);
        }
        self.held_mps2
    }

    fn interval_s(&self) -> Option<f64> {
        Some(self.policy.header().decision_interval_s)
    }
}
