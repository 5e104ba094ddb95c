//! What is claimed of an ego that departs from a law is true of each member.

use crumple_verify::reach::{
    Actor, Cell, Departure, Dimension, Follower, Idm, Law, Reach, Scene, Step, reach, reach_with_tube,
};
use crumple_verify::{Accepted, Interval, WorkLimit, check_with};
use proptest::prelude::*;

use crate::law_follower::{IDM, any_law};
use crate::leader::unscripted;
use crate::reach::{
    LATCHED, any_ranges, any_unit, attacked, certificate, claim, is_bounded, member, paper, reference, scene, sha256,
};
use crate::support::closed_loop::{Numbers, scripted, simulate, simulate_told};
use crate::support::networks::departing;

/// Departures from any `idm`, at once or, some of them, slowly.
pub fn any_departure() -> impl Strategy<Value = Departure> {
    let law = any_law().prop_map(|law| match law {
        Law::Idm(idm) => idm,
        Law::AccAeb(_) => own(),
    });
    let zone = prop_oneof![1 => Just(0.0), 4 => 0.0..0.6_f64, 1 => 0.9..0.99_f64];
    let rate = prop_oneof![4 => Just(1000.0), 2 => 200.0..1000.0_f64, 1 => 0.1..200.0_f64];
    (law, zone, rate).prop_map(|(idm, dead_zone, rate_per_s)| Departure {
        dead_zone,
        rate_per_s,
        idm: Idm { max_accel_mps2: 3.0, ..idm },
    })
}

/// As crumple's own.
fn native_idm() -> Idm {
    match IDM {
        Law::Idm(idm) => idm,
        Law::AccAeb(_) => unreachable!("it is idm"),
    }
}

proptest! {
    #![proptest_config(crumple_cases::cases(300))]

    /// Whatever actions a network chooses, within the dead zone, beyond it and on both sides, whoever follows and however the leader brakes,
    /// through stops and contacts: every number that is observed is inside the bounds at every decision, and no gap is ever below its bound.
    #[test]
    fn bounds_hold_however_an_ego_departs(
        ranges in any_ranges(), departure in any_departure(), seed: u64, gain in 0.2..3.0_f64,
        follower in prop::option::of(prop_oneof![Just(LATCHED), any_law().prop_map(Follower::Driven)]),
        limit_mps2 in prop::option::of(0.0..6.0_f64), largest in prop::sample::select(vec![1e-9, 0.02]),
        places in prop::collection::vec(any_unit(), 12), every in prop::sample::select(vec![1_u32, 2, 5, 10]),
        step_s in prop::sample::select(vec![0.01, 0.01, 0.1, 0.5]),
    ) {
        let actor = departing(&[12, 9], gain, seed, Some(departure));
        let ranges = if limit_mps2.is_some() { unscripted(ranges) } else { ranges };
        let scene = Scene {
            follower, leader_brakes_at_most_mps2: limit_mps2, observation_error: [largest; 8], stop_at_doubt: false,
            steps: if step_s < 0.1 { 400 } else { 100 }, step_s, decision_steps: every, ..scene(&actor, ranges)
        };
        let bounded = reach_with_tube(&scene);
        for (run, place) in places.into_iter().enumerate() {
            let start = member(&ranges, place);
            let error = |decision| {
                let mut numbers = Numbers::at(seed + run as u64, decision);
                std::array::from_fn(|_| largest * numbers.signed().signum() * f64::from(u8::from(run > 0)))
            };
            let brakes = |k| limit_mps2.map(|limit_mps2| limit_mps2 * Numbers::at(seed, k / 20).unit().round());
            let told = simulate_told(&scene, start, |k| brakes(k).unwrap_or_else(|| scripted(&start)(k)), error);
            is_bounded(&scene, &bounded, told, &(start, departure))?;
        }
    }
}

/// An actor whose action is the same whatever it sees.
fn constant_action_controller(action: f64, departure: Departure) -> Actor {
    let mut actor = departing(&[], 0.0, 1, Some(departure));
    let Some(Step::Linear(layer)) = actor.steps.first_mut() else { panic!("a layer") };
    layer.weights.fill(0.0);
    layer.biases.fill(f64::from(action.atanh() as f32));
    actor
}

/// Boxes around scenario 1, behind a leader that brakes at 0.7 m/s²: bounds that are not idle.
#[test]
fn verified_boxes_survive_search() {
    let departure = Departure { dead_zone: 0.4, rate_per_s: 1000.0, idm: own() };
    let mut ranges = paper(0.5, 0.0);
    ranges.leader_brake_mps2 = Interval::new(0.6, 0.8).unwrap();
    // The law alone, and a third and all of the way to full braking.
    for (action, beyond_m) in [(0.39, 0.5), (-0.6, 0.5), (-0.999, 0.5)] {
        let actor = always(action, departure);
        let scene = Scene { follower: None, ..scene(&actor, ranges) };
        let reached = reach(&scene);
        let found_m = attacked(&scene, 1000, 200, 9);
        println!("{action}: proved {:.3} m, found {found_m:.3} m", reached.gaps_m[0]);
        assert_eq!(reached.doubt, None);
        assert!(found_m >= reached.gaps_m[0] && reached.gaps_m[0] > found_m - beyond_m, "{found_m} {reached:?}");
    }
}

/// The file of the committed policy that departs from `idm`.
fn road_policy_bytes() -> Vec<u8> {
    std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../corpora/policy/road.safetensors")).unwrap()
}

/// A claim about a policy is one about its law, which the statement does not hold: the check reads it, and says it with the scope.
#[test]
fn what_is_departed_from_is_said_with_the_scope() {
    let bytes = road();
    let departure = Actor::from_bytes(&bytes).unwrap().departs_from.unwrap();
    let claim = Reach {
        policy_sha256: sha256(&bytes),
        partition: vec![Cell::Undecided],
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        ..claim()
    };
    let certificate = certificate(claim);
    let accepted = check_with(&certificate, Some(&bytes), WorkLimit::default()).unwrap();
    assert!(matches!(accepted, Accepted::Reach { departs_from: Some(found), .. } if found == departure));
    let Departure { dead_zone, rate_per_s, idm } = departure;
    let (scope, plain) = (certificate.scope_with_result(&accepted).to_string(), certificate.scope().to_string());
    for said in [
        format!(
            "; it drives idm towards {} m/s with a time headway of {} s",
            idm.desired_speed_mps, idm.time_headway_s
        ),
        format!("where the network's action is beyond {dead_zone}; departures come and go at {rate_per_s} 1/s"),
    ] {
        assert!(scope.contains(&said) && !plain.contains(&said), "{said}: {scope}");
    }
    // Of another policy with the same claim it does not: the digest decides.
    assert!(check_with(&certificate, Some(&reference()), WorkLimit::default()).is_err());
}

/// The committed policy that departs from `idm`, around scenario 1: bounds that are not idle, through the leader's onset, the follower's brake and everybody's stops.
#[test]
fn a_box_of_a_learned_policy_survives_search() {
    let actor = Actor::from_bytes(&road()).unwrap();
    let mut ranges = paper(0.007, 0.002);
    ranges.follower_brake_mps2 = Interval::new(5.998, 6.002).unwrap();
    ranges.onset_steps = Interval::new(124.75, 125.25).unwrap();
    let scene = scene(&actor, ranges);
    let reached = reach(&scene);
    let (found_m, proved_m) = (attacked(&scene, 300, 100, 3), reached.gaps_m[0].min(reached.gaps_m[1]));
    println!("proved {proved_m:.3} m, found {found_m:.3} m {reached:?}");
    assert_eq!(reached.doubt, None);
    assert!(found_m >= proved_m && proved_m > found_m - 0.1, "{found_m} {proved_m}");
}

/// An ego that stood, started within a decision interval and brakes again is not one that stands from then on.
#[test]
fn who_starts_within_an_interval_is_followed_on() {
    let departure = Departure { dead_zone: 0.0, rate_per_s: 1000.0, idm: own() };
    let actor = departing(&[12, 9], 1.760_118_541_084_301_7, 15_521_200_961_166_277_192, Some(departure));
    let start = [28.457_4, 0.0, 12.064_57, 0.0, 0.0, 4.290_4, 0.0, 72.658];
    let mut ranges = paper(0.0, 0.0);
    for (dimension, value) in Dimension::ALL.into_iter().zip(start) {
        *ranges.get_mut(dimension) = Interval::point(value);
    }
    let whole = scene(&actor, ranges);
    let scene = Scene { follower: None, stop_at_doubt: false, step_s: 0.5, steps: 100, decision_steps: 2, ..whole };
    let run = simulate(&scene, start);
    let starts_and_brakes = run.0.windows(2).any(|pair| pair[0][3] == 0.0 && pair[1][3] > 1.0 && pair[1][6] > 0.0);
    assert!(starts_and_brakes, "the case is still one");
    is_bounded(&scene, &reach_with_tube(&scene), run, &start).unwrap();
}

/// What the law sees of the own speed may be below 0 where observations are off, and then it counts as it is.
#[test]
fn a_speed_that_is_seen_below_0_counts_as_it_is() {
    let departure = Departure { dead_zone: 0.4, rate_per_s: 1000.0, idm: own() };
    let actor = always(0.0, departure);
    let mut ranges = paper(0.0, 0.0);
    for (dimension, value) in Dimension::ALL.into_iter().zip([4.0, 0.0, 25.0, 0.0, 0.0, 0.0, 0.0, 0.0]) {
        *ranges.get_mut(dimension) = Interval::point(value);
    }
    let observation_error = [0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0];
    let whole = scene(&actor, ranges);
    let scene = Scene { follower: None, observation_error, stop_at_doubt: false, steps: 10, ..whole };
    let start = member(&ranges, [0.0; 8]);
    let error = |_| std::array::from_fn(|i| if i == 3 { -0.02 } else { 0.0 });
    let run = simulate_told(&scene, start, scripted(&start), error);
    // The vehicle ahead is so much faster that the law takes a speed below 0 for a reason to keep farther away.
    assert!(run.0[1][3] < simulate(&scene, start).0[1][3] - 1e-4);
    is_bounded(&scene, &reach_with_tube(&scene), run, &start).unwrap();
}
