//! The checker accepts what the planner plans.

use super::*;
use closed_loop::TwoSidedLoop;
use proptest::prelude::*;

/// Closed loops that the tests of the simulator simulate, too.
#[allow(dead_code, reason = "only the initial states are used")]
#[path = "../../../sim/tests/two_sided/closed_loop.rs"]
mod closed_loop;

fn observation(state: &TwoSidedLoop) -> Observation {
    let neighbour = |gap_m: f64, speed_mps: f64| Neighbour {
        gap_m,
        speed_mps,
        acceleration_mps2: 0.0,
    };
    Observation {
        speed_mps: state.speed_mps,
        acceleration_mps2: 0.0,
        ahead: Some(neighbour(state.gap_m, state.ahead_mps)),
        behind: state
            .params
            .follower
            .map(|_| neighbour(state.rear_gap_m, state.rear_mps)),
    }
}

/// Checks the plan of a random state, if there is one; its kind.
fn check_plan(seed: u64, is_exact: bool) -> Result<Option<&'static str>, NoTwoSidedCertificate> {
    let mut state = TwoSidedLoop::random(seed, is_exact);
    state.params.response_fraction = 1.0;
    let observation = observation(&state);
    let mut meter = LevelMeter::new(state.params);
    meter.observe(&observation);
    let Some(plan) = meter.plan_commands(state.params.level_mps2) else {
        return Ok(None);
    };
    if let Err(reason) = plan_certificate(&state.params, &observation, &plan) {
        println!("{reason}: {:?} {observation:?} {plan:?}", state.params);
        return Err(reason);
    }
    Ok(Some(match (plan.phase, plan.after_firing) {
        (_, Some(_)) => "observed",
        (FollowerPhase::Waiting, None) => "fixed",
        (FollowerPhase::Unknown, None) => "unknown",
        (FollowerPhase::Braking(_), None) => "braking",
    }))
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1000))]

    #[test]
    fn the_checker_accepts_each_plan(seed in any::<u64>(), is_exact in any::<bool>()) {
        let kind = check_plan(seed, is_exact);
        prop_assert!(kind.is_ok(), "{kind:?}");
    }
}

#[test]
fn plans_of_each_kind_are_accepted() {
    let kinds: std::collections::BTreeSet<_> = (0..300)
        .filter_map(|seed| check_plan(seed, seed % 2 == 0).unwrap())
        .collect();
    assert_eq!(
        kinds.into_iter().collect::<Vec<_>>(),
        ["braking", "fixed", "observed", "unknown"]
    );
}

/// Bounds of the own course lie far apart here, so the checker needs the tightest states at the firing.
#[test]
fn a_plan_with_large_errors_is_accepted() {
    assert_eq!(
        check_plan(586_397_248_244_280_285, false),
        Ok(Some("unknown"))
    );
}

#[test]
fn lag_is_refused() {
    let mut params = TwoSidedLoop::random(1, true).params;
    params.response_fraction = 0.5;
    assert_eq!(filter_certificate(&params), Err(NoTwoSidedCertificate::Lag));
}

/// A level of 1.15 m/s² on a road with friction 0.5 is 2.3 m/s² on a dry one.
#[test]
fn the_suggested_setting_is_for_a_dry_road_and_rounded_down() {
    assert_eq!(super::setting_mps2(1.15, 0.0, 0.5), Some(2.3));
    assert_eq!(super::setting_mps2(1.15, 0.0, 1.0), Some(1.15));
    assert_eq!(super::setting_mps2(1.2, 0.2, 0.3), Some(3.33));
    assert_eq!(super::setting_mps2(0.0, 0.0, 1.0), None);
}
