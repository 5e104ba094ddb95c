//! Commands of a shield that have not taken effect yet, and the response of the actuator.

use std::collections::VecDeque;

use crate::control::clamp_command;

/// Commands that the actuator has not received yet, and its response to the others.
#[derive(Debug, Clone)]
pub(in crate::control) struct CommandMemory {
    /// Hardest braking and maximum acceleration, in m/s², both positive.
    limits_mps2: [f64; 2],
    /// Share of the difference to the command that the actuator covers in a step.
    response_fraction: f64,
    /// Commands that the actuator has not received yet, oldest first.
    pending_mps2: VecDeque<f64>,
    /// Response of the actuator to the commands so far, and to those before this step, in m/s².
    response_mps2: f64,
    response_before_mps2: f64,
}

impl CommandMemory {
    pub(in crate::control) fn new(
        limits_mps2: [f64; 2],
        delay_steps: usize,
        response_fraction: f64,
    ) -> Self {
        Self {
            limits_mps2,
            response_fraction,
            pending_mps2: VecDeque::from(vec![0.0; delay_steps]),
            response_mps2: 0.0,
            response_before_mps2: 0.0,
        }
    }

    pub(in crate::control) fn pending_mps2(&self) -> impl Iterator<Item = f64> + Clone {
        self.pending_mps2.iter().copied()
    }

    pub(in crate::control) fn response_mps2(&self) -> f64 {
        self.response_mps2
    }

    fn clamped_mps2(&self, command_mps2: f64) -> f64 {
        let [brake_mps2, accel_mps2] = self.limits_mps2;
        clamp_command(command_mps2, brake_mps2, accel_mps2)
    }

    /// Accounts for the command of a step, in m/s².
    pub(in crate::control) fn advance(&mut self, command_mps2: f64) {
        let command_mps2 = self.clamped_mps2(command_mps2);
        self.pending_mps2.push_back(command_mps2);
        let due_mps2 = self.pending_mps2.pop_front().unwrap_or(command_mps2);
        self.response_before_mps2 = self.response_mps2;
        self.respond_to(due_mps2);
    }

    /// Replaces the command of the last step, in m/s².
    pub(in crate::control) fn replace_last(&mut self, command_mps2: f64) {
        let command_mps2 = self.clamped_mps2(command_mps2);
        match self.pending_mps2.back_mut() {
            Some(last_mps2) => *last_mps2 = command_mps2,
            // Without delay the actuator has received the command already.
            None => self.respond_to(command_mps2),
        }
    }

    fn respond_to(&mut self, due_mps2: f64) {
        let before_mps2 = self.response_before_mps2;
        self.response_mps2 = before_mps2 + self.response_fraction * (due_mps2 - before_mps2);
    }
}
