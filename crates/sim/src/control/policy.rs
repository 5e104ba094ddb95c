//! Policies as controllers.

use std::sync::Arc;

use super::decision_timer::DecisionTimer;
use super::{
    BuiltIn, Controller, ControllerFailure, ControllerSource, Ego, IntoSource, NoSettings, Role,
};
use crate::observation::Observation;
use crate::policy::{FrameStack, HeldAction, Policy, Workspace};

/// A driver that evaluates a policy once per decision interval and holds its action in between.
pub struct PolicyDriver {
    policy: Arc<Policy>,
    decision_timer: DecisionTimer,
    frame_stack: FrameStack,
    held_action: HeldAction,
    workspace: Workspace,
}

impl PolicyDriver {
    /// Creates a driver for a vehicle.
    #[must_use]
    pub fn new(policy: Arc<Policy>, ego: &Ego) -> Self {
        let interval = DecisionTimer::new(Some(policy.header().decision_interval_s), ego.step_s);
        Self {
            policy,
            decision_timer: interval,
            frame_stack: FrameStack::default(),
            held_action: HeldAction::default(),
            workspace: Workspace::default(),
        }
    }
}

impl Controller for PolicyDriver {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        if self.decision_timer.tick() {
            let last_answer_mps2 = self.held_action.last_answer_mps2();
            let row = self
                .policy
                .observe(observation, last_answer_mps2, &mut self.frame_stack);
            self.held_action
                .set(self.policy.choose(row, &mut self.workspace));
        }
        Ok(self
            .held_action
            .acceleration_mps2(&self.policy.header().action))
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.held_action.set_last_answer_mps2(command_mps2);
    }

    /// Decides for all drivers that are due, with one matrix product per group of equal policies.
    fn decide_batch(
        all: &mut [Self],
        mut observe: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        _failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        let observations: Vec<Observation> = (0..all.len()).map(&mut observe).collect();
        let mut due = Vec::new();
        let mut rows = Vec::new();
        for (index, (driver, observation)) in all.iter_mut().zip(&observations).enumerate() {
            if driver.decision_timer.tick() {
                let last_answer_mps2 = driver.held_action.last_answer_mps2();
                let row =
                    driver
                        .policy
                        .observe(observation, last_answer_mps2, &mut driver.frame_stack);
                rows.extend_from_slice(row);
                due.push((index, row.len(), Arc::clone(&driver.policy)));
            }
        }
        let mut rows = rows.as_slice();
        let mut space = Workspace::default();
        for group in due.chunk_by(|(_, _, a), (_, _, b)| Arc::ptr_eq(a, b)) {
            let (_, width, policy) = &group[0];
            let (now, later) = rows.split_at(group.len() * width);
            rows = later;
            let mut actions = vec![0.0; group.len()];
            policy.choose_batch(now, &mut space, &mut actions);
            for ((index, ..), action) in group.iter().zip(actions) {
                all[*index].held_action.set(action);
            }
        }
        for (command_mps2, driver) in commands_mps2.iter_mut().zip(all) {
            *command_mps2 = driver
                .held_action
                .acceleration_mps2(&driver.policy.header().action);
        }
    }
}

/// A policy as a source of controllers.
#[derive(Debug)]
pub struct PolicySource(Arc<Policy>);

impl PolicySource {
    /// Creates a source of controllers that evaluate a policy.
    #[must_use]
    pub fn new(policy: Arc<Policy>) -> Self {
        Self(policy)
    }

    /// Returns the policy, which other owners share.
    #[must_use]
    pub fn shared(&self) -> Arc<Policy> {
        Arc::clone(&self.0)
    }
}

impl IntoSource for Arc<Policy> {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::new(PolicySource(self))
    }
}

impl ControllerSource for PolicySource {
    fn identity(&self) -> Option<String> {
        Some(self.0.digest())
    }

    fn start(&self, ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(PolicyDriver::new(Arc::clone(&self.0), ego)))
    }

    fn holds_answers(&self) -> bool {
        true
    }

    fn interval_s(&self) -> Option<f64> {
        Some(self.0.header().decision_interval_s)
    }

    fn description(&self) -> String {
        format!(
            "learned policy with hidden layers {:?}",
            self.0.header().hidden
        )
    }

    fn policy(&self) -> Option<Arc<Policy>> {
        Some(Arc::clone(&self.0))
    }

    fn is_learned(&self) -> bool {
        true
    }

    fn can_fail(&self) -> bool {
        false
    }
}

/// Declares a committed policy as a built-in controller.
macro_rules! committed_policy {
    ($(#[$about:meta])* $driver:ident, $name:literal, $load:path, $summary:literal) => {
        $(#[$about])*
        pub struct $driver;

        impl BuiltIn for $driver {
            const NAME: &'static str = $name;
            const SUMMARY: &'static str = $summary;
            const ROLE: Role = Role::Learned;
            type Settings = NoSettings;
            type Driver = PolicyDriver;

            fn policy() -> Option<Arc<Policy>> {
                Some($load())
            }

            fn start(_settings: &NoSettings, ego: &Ego, _seed: u64) -> PolicyDriver {
                PolicyDriver::new($load(), ego)
            }
        }
    };
}

committed_policy! {
    /// The committed policy that imitates `predictive`.
    RoadPolicy, "road", Policy::road,
    "policy that imitates predictive, trained with the preset road in ten built-in spaces"
}
committed_policy! {
    /// The committed reference policy.
    ReferencePolicy, "policy", Policy::reference,
    "policy that learned the task of the paper by DDPG (preset fast, seed 7)"
}
committed_policy! {
    /// The committed policy that was retrained.
    RetrainedPolicy, "retrained", Policy::retrained,
    "policy, after crumple retrain in the space high-risk (corpora/policy/README.md)"
}
