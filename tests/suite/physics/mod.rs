//! Invariants of every scenario, with any drivers.

mod closed_forms;
mod impacts;
mod symmetry;

use crumple_fuzzing::oracle::{
    check_same_impacts, metrics_agree, monitor_agrees, motion_is_physical, step_size_changes_nothing,
};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use crumple_world::sim::{SimulationResult, Trace};
use proptest::prelude::*;

use crate::generate::{any_test_case, check_oracle, simulate_traced, with_cases};

fn trace_of(result: &SimulationResult) -> &Trace {
    result.trace.as_ref().expect("kept")
}

proptest! {
    #![proptest_config(with_cases(512))]

    /// No vehicle reverses or is where its speed cannot have taken it; braking never adds energy.
    #[test]
    fn vehicles_move_forward_continuously_and_braking_takes_energy_away(test_case in any_test_case()) {
        check_oracle(&test_case, motion_is_physical)?;
    }

    /// The trace, the verdict and the report agree, and no vehicle exceeds the limits of road and vehicle.
    #[test]
    fn verdict_summary_and_trace_agree(test_case in any_test_case()) {
        check_oracle(&test_case, metrics_agree)?;
    }

    /// "Always a gap" holds on the trace if and only if there is no collision.
    #[test]
    fn monitor_and_verdict_agree(test_case in any_test_case()) {
        check_oracle(&test_case, monitor_agrees)?;
    }

    /// A tenth of the step, with controllers, sensors and noise at the same instants, gives the same motion.
    #[test]
    fn the_integration_step_changes_nothing(test_case in any_test_case()) {
        check_oracle(&test_case, step_size_changes_nothing)?;
    }
}

/// The paper's scenarios, the basis of all comparisons, do not depend on the step.
#[test]
fn the_verdicts_of_the_papers_distribution_do_not_depend_on_the_step() {
    let baseline = crumple_world::control::ControllerSpec::from_name("baseline").unwrap();
    for index in 0..40 {
        let scenario: Scenario = crumple_world::scenario::PaperDistribution { seed: 11 }.draw(index).unwrap();
        for estimator in [EstimatorKind::Kalman, EstimatorKind::Truth] {
            let options = crumple_world::sim::RunOptions::new(baseline.clone()).with_estimator(estimator);
            let [coarse, fine] = [0.01, 0.001].map(|dt_s| simulate_traced(&scenario, &options.clone().with_dt_s(dt_s)));
            check_same_impacts(&coarse, &fine, 0, 0.0).expect("the same verdict");
        }
    }
}
