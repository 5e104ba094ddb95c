//! Vehicles that enter and leave the lane, in any scenario: the invariants that hold for them.

use std::path::Path;

use crumple_controllers::Controllers;
use crumple_fuzzing::oracle::{
    entering_at_start_changes_nothing, estimates_within_bounds, lane_times_are_consistent,
    leaving_last_vehicle_changes_nothing_ahead, metrics_agree, monitor_agrees,
    step_size_changes_nothing,
};
use crumple_fuzzing::{
    Crumple, Invariant, LANE_ORACLES, OracleFn, OracleOutcome, System, TestCase,
};
use crumple_search::worst_case::{
    AvoidOptions, AvoidanceVerdict, SearchEffort, UndecidedReason, avoid,
};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, SimulationResult, Track, simulate};
use crumple_sim::scenario::{Driver, LaneChange};
use proptest::prelude::*;

use crate::generate::{any_lane_case, check_oracle, first_values, with_cases};

proptest! {
    #![proptest_config(with_cases(256))]

    /// All invariants except that of the step size, which rounding sometimes leaves undecided.
    #[test]
    fn lane_changes_satisfy_their_invariants(test_case in any_lane_case()) {
        let step_size = step_size_changes_nothing as OracleFn as usize;
        for oracle in LANE_ORACLES.into_iter().filter(|&oracle| oracle as usize != step_size) {
            check_oracle(&test_case, oracle)?;
        }
    }

    #[test]
    fn steps_decide_nothing_where_lanes_change(test_case in any_lane_case()) {
        check_oracle(&test_case, step_size_changes_nothing)?;
    }
}

fn first_lane_cases(count: usize) -> Vec<TestCase> {
    first_values(count, &any_lane_case()).collect()
}

/// Generated scenarios change lanes by every trigger, and the oracles for lanes are decided.
#[test]
fn generated_scenarios_change_lanes() {
    let all = first_lane_cases(200);
    let entered = |test_case: &&TestCase| {
        let options = test_case.setup.options(test_case.scenario.spec().step_s);
        let result = simulate(
            &Run::new(&test_case.scenario, options).unwrap(),
            RecordingLevel::Trace,
        );
        result
            .trace
            .unwrap()
            .vehicles
            .iter()
            .any(|track| track.in_lane_s != Track::THROUGHOUT_S)
    };
    let changing: Vec<_> = all
        .iter()
        .filter(|test_case| !test_case.scenario.keeps_lanes())
        .collect();
    assert!(changing.len() >= 60, "{}", changing.len());
    assert!(all.iter().filter(entered).count() >= 60);
    let changes = || {
        changing
            .iter()
            .flat_map(|case| case.scenario.vehicles())
            .flat_map(|vehicle| [vehicle.enters, vehicle.leaves])
    };
    for field in ["at_s", "gap_m", "ttc_s"] {
        assert!(
            changes().flatten().any(|change| change.field() == field),
            "{field}"
        );
    }
    for oracle in [
        entering_at_start_changes_nothing,
        leaving_last_vehicle_changes_nothing_ahead,
    ] {
        let holds = all
            .iter()
            .filter(|case| case.check(oracle, &Crumple) == Ok(OracleOutcome::Holds))
            .count();
        assert!(holds >= 1, "{holds}");
    }
}

/// A fault about lanes in the program.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LaneFault {
    /// A vehicle that enters appears to have been there before.
    EntryForgotten,
    /// Entering at the start takes a moment.
    EntryLate,
    /// A vehicle that leaves affects the first vehicle.
    LeaderMoved,
}

impl System for LaneFault {
    fn simulate(&self, run: &Run, keep: RecordingLevel) -> SimulationResult {
        let scenario = run.scenario();
        let late = scenario.edited(|spec| {
            for vehicle in spec
                .vehicles
                .iter_mut()
                .filter(|vehicle| vehicle.enters == Some(LaneChange::At(0.0)))
            {
                vehicle.enters = Some(LaneChange::At(0.3));
            }
        });
        let mut result = match (self, late) {
            (Self::EntryLate, Ok(late)) => {
                simulate(&Run::new(&late, run.options().clone()).unwrap(), keep)
            }
            _ => simulate(run, keep),
        };
        let tracks = result
            .trace
            .iter_mut()
            .flat_map(|trace| &mut trace.vehicles);
        match self {
            Self::EntryForgotten => tracks.for_each(|track| track.in_lane_s = Track::THROUGHOUT_S),
            Self::LeaderMoved if !scenario.keeps_lanes() => {
                tracks.take(1).for_each(|track| {
                    track
                        .position_m
                        .iter_mut()
                        .for_each(|position_m| *position_m += 1e-6)
                });
            }
            _ => {}
        }
        result
    }
}

#[test]
fn lane_invariants_detect_injected_faults() {
    let wrong: [(LaneFault, OracleFn, Invariant); 6] = [
        (
            LaneFault::EntryForgotten,
            lane_times_are_consistent,
            Invariant::Lanes,
        ),
        (
            LaneFault::EntryForgotten,
            metrics_agree,
            Invariant::MetricsAgree,
        ),
        (
            LaneFault::EntryForgotten,
            monitor_agrees,
            Invariant::Monitor,
        ),
        (
            LaneFault::EntryForgotten,
            estimates_within_bounds,
            Invariant::Estimates,
        ),
        (
            LaneFault::EntryLate,
            entering_at_start_changes_nothing,
            Invariant::Lanes,
        ),
        (
            LaneFault::LeaderMoved,
            leaving_last_vehicle_changes_nothing_ahead,
            Invariant::Lanes,
        ),
    ];
    let all = first_lane_cases(400);
    for (fault, oracle, law) in wrong {
        let notices = |one: &TestCase| matches!(one.check(oracle, &fault), Err(found) if found.invariant == law);
        assert!(all.iter().any(notices), "{fault:?} is missed by {law}");
    }
}

/// Proofs about all drivers refuse lane changes in any scenario. An escape found by search is shown by its run, with
/// the vehicles entering and leaving as recorded.
#[test]
fn shields_and_proofs_about_all_drivers_refuse_changes_of_lanes() {
    let shield = Controllers::default()
        .find("shield:policy", Path::new(""))
        .unwrap();
    let options = AvoidOptions {
        effort: SearchEffort::Decide,
        ..AvoidOptions::default()
    };
    let mut asked = [0; 2];
    for TestCase { scenario, .. } in first_lane_cases(300)
        .into_iter()
        .filter(|case| !case.scenario.keeps_lanes())
    {
        let verdict = avoid(&scenario, options).map(|avoidance| avoidance.verdict);
        match verdict {
            Ok(AvoidanceVerdict::Undecided(UndecidedReason::LaneChanges)) => asked[0] += 1,
            Ok(AvoidanceVerdict::Avoidable(escape)) => {
                assert!(!escape.scenario.keeps_lanes());
                let run = Run::new(
                    &escape.scenario,
                    RunOptions::new(BuiltInController::from_name("idm").unwrap()),
                )
                .unwrap();
                assert!(simulate(&run, RecordingLevel::Summary).outcome.is_safe());
            }
            Ok(other) => panic!("{other:?}"),
            Err(_) => {}
        }
        let is_tested = scenario
            .vehicles()
            .iter()
            .any(|vehicle| vehicle.driver == Driver::UnderTest);
        // The decision instants of a policy need not be those of this scenario.
        let Err(error) = Run::new(&scenario, RunOptions::new(shield.source.clone())) else {
            assert!(!is_tested, "behind a shield");
            continue;
        };
        asked[1] += usize::from(error.to_string().contains("enter or leave the lane"));
    }
    assert!(asked.iter().all(|&asked| asked >= 20), "{asked:?}");
}
