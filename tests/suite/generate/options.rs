//! Random ways of running a scenario.

use std::sync::Arc;

use crumple::control::{Controller, Ego};
use crumple::estimate::{EstimatorKind, Observation};
use crumple::scenario::ControllerSpec;
use crumple::sim::{AfterContact, RunOptions, UnderTest};
use proptest::prelude::*;

use super::any_controller;

/// How to run scenarios of one shape, in words a failing test can print.
#[derive(Debug, Clone)]
pub(crate) struct Setup {
    pub(crate) controller: TestController,
    pub(crate) estimator: EstimatorKind,
    /// Integration steps in a step of the scenario.
    pub(crate) substeps: u32,
}

/// What to put under test.
#[derive(Debug, Clone)]
pub(crate) enum TestController {
    BuiltIn(ControllerSpec),
    /// The custom controller, deciding every so many steps; at every step if 0.
    Custom(u32),
}

impl Setup {
    /// The baseline, with true states, at the scenario's own step.
    pub(crate) fn truthful() -> Self {
        let baseline = ControllerSpec::named("baseline").expect("built in");
        Self { controller: TestController::BuiltIn(baseline), estimator: EstimatorKind::Truth, substeps: 1 }
    }

    /// Whether the controller cares for nobody behind.
    pub(crate) fn looks_ahead_only(&self) -> bool {
        matches!(self.controller, TestController::BuiltIn(_))
    }

    /// The options for a scenario of a step.
    pub(crate) fn options(&self, step_s: f64, after_contact: AfterContact) -> RunOptions {
        let controller = match &self.controller {
            TestController::BuiltIn(spec) => UnderTest::from(spec.clone()),
            TestController::Custom(steps) => custom(*steps),
        };
        let options = RunOptions::new(controller).with_estimator(self.estimator).with_after_contact(after_contact);
        if self.substeps == 1 { options } else { options.with_dt_s(step_s / f64::from(self.substeps)) }
    }
}

/// Any controller under test, either estimator, the scenario's step or a finer one.
pub(crate) fn any_setup() -> impl Strategy<Value = Setup> {
    let controller = prop_oneof![
        3 => (0..6_usize).prop_flat_map(any_controller).prop_map(TestController::BuiltIn),
        1 => (0..8_u32).prop_map(TestController::Custom),
    ];
    let estimator = prop_oneof![Just(EstimatorKind::Kalman), Just(EstimatorKind::Truth)];
    let substeps = prop_oneof![3 => Just(1_u32), 1 => 2..=7_u32];
    (controller, estimator, substeps).prop_map(|(controller, estimator, substeps)| Setup {
        controller,
        estimator,
        substeps,
    })
}

/// A controller from outside that uses all eight numbers it may see, and remembers its last answer.
fn custom(interval_steps: u32) -> UnderTest {
    UnderTest::Custom(Arc::new(move |ego: &Ego| {
        let interval_s = (interval_steps > 0).then(|| f64::from(interval_steps) * ego.step_s);
        Box::new(Opinionated { interval_s, last_mps2: 0.0 })
    }))
}

struct Opinionated {
    interval_s: Option<f64>,
    last_mps2: f64,
}

impl Controller for Opinionated {
    fn act(&mut self, seen: &Observation) -> f64 {
        let ahead =
            seen.ahead.map_or(0.5, |n| 0.1 * (n.gap_m - 12.0) + n.speed_mps - seen.speed_mps + n.acceleration_mps2);
        let behind =
            seen.behind.map_or(0.0, |n| 0.2 * (n.speed_mps - seen.speed_mps) - 0.01 * n.gap_m + n.acceleration_mps2);
        self.last_mps2 = 0.5 * self.last_mps2 + 0.4 * ahead + 0.1 * behind - 0.05 * seen.acceleration_mps2;
        // Now and then no answer at all, which counts as 0.
        if seen.speed_mps > 30.0 { f64::NAN } else { self.last_mps2 }
    }

    fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }
}

/// Either rule for contacts.
pub(crate) fn any_after_contact() -> impl Strategy<Value = AfterContact> {
    prop_oneof![Just(AfterContact::Stop), Just(AfterContact::Continue)]
}
