//! Time to decide whether a collision was avoidable, on one core, and to check the certificate: `cargo bench --bench
//! avoid`.
//!
//! `grid_s` is the grid of the escape's accelerations. The scenario's step distinguishes the trigger times of the
//! follower's brake in all cases. The search is sequential.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use crumple_search::worst_case::{AvoidOptions, AvoidanceVerdict, EscapeKind, ScenarioBox, avoid, certify};
use crumple_world::scenario::{Brake, Driver, LeadProfile, built_in_scenario};
use divan::Bencher;

fn main() {
    divan::main();
}

/// Targets on a current core: 50 ms for `paper-1` at 0.1 s, 1 s at 0.01 s.
#[divan::bench(
    args = [
        ("paper-1", 0.1),
        ("paper-1", 0.01),
        ("paper-2", 0.1),
        ("paper-2", 0.01),
        ("paper-3", 0.1),
        ("paper-3", 0.01),
    ],
    sample_count = 10
)]
fn decide(bencher: Bencher<'_, '_>, (name, grid_s): (&str, f64)) {
    let scenario = built_in_scenario(name).expect("built in");
    bencher.bench_local(|| {
        avoid(&scenario, AvoidOptions { grid_s: Some(grid_s), ..AvoidOptions::default() }).expect("the grid fits")
    });
}

#[divan::bench(sample_count = 10)]
fn decide_gentlest(bencher: Bencher<'_, '_>) {
    let scenario = built_in_scenario("paper-1").expect("built in");
    let options = AvoidOptions { escape: EscapeKind::Gentlest, ..AvoidOptions::default() };
    bencher.bench_local(|| avoid(&scenario, options).expect("the grid fits"));
}

/// The ego vehicle reacts late: no escape and no proof exists, so the search gives up.
#[divan::bench(sample_count = 3)]
fn give_up(bencher: Bencher<'_, '_>) {
    let late = built_in_scenario("paper-1").expect("built in").edited(|spec| {
        spec.vehicles[0].position_m = 24.0;
        spec.vehicles[0].driver = Driver::Profile(LeadProfile::Brake(Brake { onset_s: 1.0, rate_mps2: 5.5 }));
        spec.vehicles[1].reaction_delay_s = 1.5;
    });
    let late = late.expect("still valid");
    bencher.bench_local(|| avoid(&late, AvoidOptions::default()).expect("the grid fits"));
}

#[divan::bench(sample_count = 10)]
fn prove_unavoidable(bencher: Bencher<'_, '_>) {
    let hopeless = unavoidable_scenario();
    bencher.bench_local(|| avoid(&hopeless, AvoidOptions::default()).expect("the grid fits"));
}

/// Target: 50 ms, for this and the proof below.
#[divan::bench(sample_count = 20)]
fn check_escape(bencher: Bencher<'_, '_>) {
    let scenario = built_in_scenario("paper-1").expect("built in");
    let avoidance =
        avoid(&scenario, AvoidOptions { grid_s: Some(0.01), ..AvoidOptions::default() }).expect("the grid fits");
    let escape = avoidance.verdict.escape().expect("avoidable").clone();
    let certificate = certify(&ScenarioBox::point(&scenario), &escape).expect("accepted");
    bencher.bench_local(|| crumple_verify::check(&certificate).expect("accepted"));
}

#[divan::bench(sample_count = 20)]
fn check_proof(bencher: Bencher<'_, '_>) {
    let verdict = avoid(&unavoidable_scenario(), AvoidOptions::default()).expect("the grid fits").verdict;
    let AvoidanceVerdict::Unavoidable(proof) = verdict else { return };
    bencher.bench_local(|| crumple_verify::check(&proof).expect("accepted"));
}

fn unavoidable_scenario() -> crumple_world::scenario::Scenario {
    let paper_1 = built_in_scenario("paper-1").expect("built in");
    let closer = paper_1.edited(|spec| {
        spec.vehicles[2].position_m += 12.0;
        spec.vehicles[2].speed_mps = 40.0;
    });
    closer.expect("still valid")
}
