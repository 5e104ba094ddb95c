//! Bounds of followers with a control law hold for each member.

use crumple_verify::reach::{
    AccAebLaw, FollowerLaw, FollowerModel, IdmLaw, InitialRanges, NeuralController, ReachProblem,
    reach_with_tube,
};
use proptest::prelude::*;

use crate::reach::{
    any_ranges, any_unit, box_member, is_bounded, paper_box, paper_problem, prove_and_attack,
};
use crate::support::closed_loop::simulate;
use crate::support::networks::{any_network, native_network};
use crate::support::policy_bytes;

pub const IDM_LAW: IdmLaw = IdmLaw {
    desired_speed_mps: 120.0 / 3.6,
    time_headway_s: 1.6,
    standstill_gap_m: 2.0,
    accel_mps2: 0.73,
    comfortable_brake_mps2: 1.67,
    max_accel_mps2: 3.0,
};
pub const ACC_AEB_LAW: AccAebLaw = AccAebLaw {
    ttc_s: 1.4,
    time_headway_s: 0.8,
    standstill_gap_m: 2.0,
    gap_gain_per_s2: 0.25,
    speed_gain_per_s: 0.8,
    comfort_brake_mps2: 3.5,
    comfort_accel_mps2: 2.0,
    set_speed_mps: None,
    max_accel_mps2: 3.0,
};

pub const IDM: FollowerLaw = FollowerLaw::Idm(IDM_LAW);
pub const ACC_AEB: FollowerLaw = FollowerLaw::AccAeb(ACC_AEB_LAW);

/// Generates laws, some with zero parameters.
pub fn any_law() -> impl Strategy<Value = FollowerLaw> {
    let rate = || prop_oneof![4 => 0.1..4.0_f64, 1 => 4.0..30.0_f64];
    let idm = (
        5.0..45.0_f64,
        0.0..3.0_f64,
        0.0..5.0_f64,
        rate(),
        rate(),
        0.0..3.0_f64,
    );
    let idm = idm.prop_map(
        |(
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            comfortable_brake_mps2,
            max_accel_mps2,
        )| {
            FollowerLaw::Idm(IdmLaw {
                desired_speed_mps,
                time_headway_s,
                standstill_gap_m,
                accel_mps2,
                comfortable_brake_mps2,
                max_accel_mps2,
            })
        },
    );
    let number = |most: f64| prop_oneof![1 => Just(0.0), 6 => 0.0..most, 1 => most..5.0 * most];
    let acc = [4.0, 3.0, 5.0, 1.0, 2.0, 5.0, 3.0, 3.0].map(number);
    let acc = (acc, prop::option::of(0.0..45.0_f64)).prop_map(
        |(
            [
                ttc_s,
                time_headway_s,
                standstill_gap_m,
                gap_gain_per_s2,
                speed_gain_per_s,
                comfort_brake_mps2,
                comfort_accel_mps2,
                max_accel_mps2,
            ],
            set_speed_mps,
        )| {
            FollowerLaw::AccAeb(AccAebLaw {
                ttc_s,
                time_headway_s,
                standstill_gap_m,
                gap_gain_per_s2,
                speed_gain_per_s,
                comfort_brake_mps2,
                comfort_accel_mps2,
                set_speed_mps,
                max_accel_mps2,
            })
        },
    );
    prop_oneof![Just(IDM), Just(ACC_AEB), idm, acc]
}

fn with_law_follower<'a>(
    controller: &'a NeuralController,
    ranges: InitialRanges,
    law: FollowerLaw,
) -> ReachProblem<'a> {
    ReachProblem {
        follower: Some(FollowerModel::ByLaw(law)),
        ..paper_problem(controller, ranges)
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(300))]

    /// Every observation is inside the bounds at every decision, and every gap above its bound, through stops, firing
    /// and releasing brakes, and collisions.
    #[test]
    fn bounds_hold_with_any_follower(
        ranges in any_ranges(), law in any_law(), seed: u64, gain in prop::option::of(0.2..1.2_f64),
        places in prop::collection::vec(any_unit(), 12), every in prop::sample::select(vec![1_u32, 2, 5, 10]),
        // Stops within a step, and a brake that releases, matter in long steps.
        step_s in prop::sample::select(vec![0.01, 0.01, 0.1, 0.5]),
    ) {
        let controller = gain.map_or_else(|| any_network(seed), |gain| native_network(&[12, 9], gain, seed));
        let whole = with_law_follower(&controller, ranges, law);
        let steps = if step_s < 0.1 { 400 } else { 100 };
        let scene = ReachProblem { stop_when_undecided: false, steps, step_s, decision_steps: every, ..whole };
        let bounded = reach_with_tube(&scene);
        for point in places {
            let start = box_member(&ranges, point);
            is_bounded(&scene, &bounded, simulate(&scene, start), &(start, law))?;
        }
    }
}

/// Non-vacuous bounds around scenario 1 for idm, and for acc-aeb with a longer headway and no emergency brake, whose
/// firing instant would be uncertain.
#[test]
fn verified_boxes_survive_search() {
    let controller = NeuralController::from_bytes(&policy_bytes("reference")).unwrap();
    let acc = FollowerLaw::AccAeb(AccAebLaw {
        ttc_s: 0.0,
        time_headway_s: 1.6,
        ..ACC_AEB_LAW
    });
    for (law, least_m) in [(IDM, 1.8), (acc, 0.0)] {
        let scene = with_law_follower(&controller, paper_box(0.1, 0.02), law);
        let [proved_m, found_m] = prove_and_attack(&scene, 3000, 300, 9);
        assert!(proved_m > least_m, "{found_m} {proved_m}");
    }
}
