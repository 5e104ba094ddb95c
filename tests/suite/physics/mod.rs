//! Invariants of every scenario, with any drivers.

mod closed_forms;
mod impacts;
mod symmetry;

use crumple_fuzzing::oracle::{
    metrics_agree, monitor_agrees, motion_is_physical, step_size_changes_nothing,
};
use crumple_sim::engine::{SimulationResult, Trace};
use proptest::prelude::*;

use crate::generate::{any_test_case, check_oracle, with_cases};

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
