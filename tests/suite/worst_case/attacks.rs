//! The mildest attacks: against samples, and replayed from files.

use crumple_sim::scenario::NoDriverFiles;
use std::path::Path;

use crumple_core::observer::Quiet;
use crumple_search::worst_case::{Attack, AttackObjective, Envelope, attack};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LeadProfile, Scenario, built_in_scenario, file};

use super::scenes::with_pieces;

fn options(controller: &str) -> RunOptions {
    RunOptions::new(BuiltInController::from_name(controller).expect("built in"))
        .with_estimator(EstimatorKind::Truth)
}

fn find_attack(
    scenario: &Scenario,
    options: &RunOptions,
    aim: AttackObjective,
    envelope: Envelope,
    budget: usize,
) -> Option<Attack> {
    attack(scenario, options, aim, envelope, budget, &Quiet)
        .expect("a valid search")
        .attack
}

fn find_mildest(
    scenario: &Scenario,
    controller: &str,
    envelope: Envelope,
    budget: usize,
) -> Option<Attack> {
    find_attack(
        scenario,
        &options(controller),
        AttackObjective::Mildest,
        envelope,
        budget,
    )
}

/// Against black-box controllers.
#[test]
fn every_controller_has_a_worst_case_that_replays_from_its_file() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let envelope = Envelope::from_scenario(&scenario);
    for controller in ["baseline", "match-leader", "idm", "policy"] {
        for aim in [AttackObjective::Mildest, AttackObjective::Severest] {
            let attack = find_attack(&scenario, &options(controller), aim, envelope, 1500);
            let attack = attack.unwrap_or_else(|| panic!("{controller}: nothing found"));
            let text = file::to_toml(&attack.scenario).unwrap();
            let read = file::from_toml(&text, Path::new("worst.toml"), &NoDriverFiles).unwrap();
            let replayed = simulate(
                &Run::new(&read, options(controller)).unwrap(),
                RecordingLevel::Summary,
            );
            assert_eq!(replayed.outcome, attack.outcome, "{controller}");
            assert!(attack.outcome.collision().is_some(), "{controller}");
            let Driver::Profile(LeadProfile::Pieces(pieces)) = &read.vehicles()[0].driver else {
                panic!()
            };
            let most = pieces
                .accel_mps2
                .iter()
                .fold(0.0_f64, |most, a| most.max(-a));
            assert!(
                most <= envelope.max_brake_mps2 && (most - attack.peak_brake_mps2).abs() < 1e-12
            );
            assert!(
                pieces.accel_mps2.iter().all(|a| *a <= 0.0),
                "the leader only brakes"
            );
        }
    }
}

/// Pulses of many depths and lengths, built up and released at the jerk limit, from the start on.
#[test]
fn no_plain_pulse_is_milder_than_the_profile_found() {
    for (name, controller) in [
        ("paper-1", "idm"),
        ("paper-1", "acc-aeb"),
        ("paper-2", "idm"),
    ] {
        let scenario = built_in_scenario(name).unwrap();
        let envelope = Envelope::from_scenario(&scenario);
        let attack = find_mildest(&scenario, controller, envelope, 3000).expect("collides");
        let cells = scenario.steps() / 10;
        let pulses = (1..=30).flat_map(|depth| {
            (2..60)
                .step_by(2)
                .map(move |length| (f64::from(depth) * 0.25, length))
        });
        let scripted = pulses.map(|(depth_mps2, length)| {
            let mut before = 0.0_f64;
            let held = |cell: usize| {
                let wanted = if cell < length { -depth_mps2 } else { 0.0 };
                before = wanted.clamp(
                    before - 0.1 * envelope.jerk_mps3,
                    before + 0.1 * envelope.jerk_mps3,
                );
                before
            };
            let accel_mps2: Vec<f64> = (0..cells).map(held).collect();
            let effort_m2ps3 = accel_mps2.iter().map(|a| 0.1 * a * a).sum::<f64>();
            let from_s = (0..cells).map(|cell| 0.1 * cell as f64).collect();
            (effort_m2ps3, with_pieces(&scenario, 0, from_s, accel_mps2))
        });
        let scripted: Vec<_> = scripted.collect();
        let runs: Vec<_> = scripted
            .iter()
            .map(|(_, s)| Run::new(s, options(controller)).unwrap())
            .collect();
        let collides = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
            !result.outcome.is_safe()
        });
        let efforts = scripted
            .iter()
            .zip(collides)
            .filter(|(_, collides)| *collides)
            .map(|((effort, _), _)| *effort);
        let least_m2ps3 = efforts.fold(f64::INFINITY, f64::min);
        assert!(
            attack.effort_m2ps3 <= least_m2ps3,
            "{name}, {controller}: {} against {least_m2ps3}",
            attack.effort_m2ps3
        );
        // An earlier version reported the local optimum 68.83.
        assert!(
            (name, controller) != ("paper-1", "idm") || attack.effort_m2ps3 <= 60.32,
            "{}",
            attack.effort_m2ps3
        );
    }
}

/// A brake that stays on once it has fired hides how the margin depends on the profile. The least possible ∫ a² that
/// makes `baseline` fire in `paper-1` is about 0.28 m²/s³ (by hand: a linear release that ends when the brake fires).
#[test]
fn the_mildest_profile_is_no_rougher_than_that_of_least_peak() {
    for (scenario, controller, most) in [
        ("paper-1", "baseline", 0.31),
        ("paper-1", "autoware-aeb", 0.27),
        ("paper-2", "acc-aeb", 90.0),
    ] {
        let scenario = built_in_scenario(scenario).expect("built in");
        let envelope = Envelope::from_scenario(&scenario);
        let [mildest, least_peak] =
            [AttackObjective::Mildest, AttackObjective::LeastPeak].map(|aim| {
                find_attack(&scenario, &options(controller), aim, envelope, 3000)
                    .expect("a collision")
                    .effort_m2ps3
            });
        assert!(
            mildest <= least_peak.min(most),
            "{controller}: {mildest} {least_peak}"
        );
    }
}

/// ∫ a² ends where the leader stands or a collision happens, as in the trace.
#[test]
fn the_effort_is_that_of_the_leader_and_not_of_its_script() {
    for (name, controller) in [
        ("paper-1", "idm"),
        ("paper-1", "baseline"),
        ("paper-2", "idm"),
    ] {
        let scenario = built_in_scenario(name).expect("built in");
        let envelope = Envelope::from_scenario(&scenario);
        let attack = find_attack(
            &scenario,
            &options(controller),
            AttackObjective::Severest,
            envelope,
            300,
        )
        .expect("a profile");
        let run = Run::new(&attack.scenario, options(controller)).expect("a run");
        let result = simulate(&run, RecordingLevel::Trace);
        let end_s = result
            .outcome
            .collision()
            .map_or(f64::INFINITY, |collision| collision.time_s);
        let trace = result.trace.expect("recorded");
        let steps = trace
            .time_s
            .windows(2)
            .zip(&trace.vehicles[0].acceleration_mps2);
        let effort_m2ps3: f64 = steps
            .map(|(times_s, a)| a * a * (times_s[1].min(end_s) - times_s[0]).max(0.0))
            .sum();
        let scale = 1.0 + effort_m2ps3;
        assert!(
            (attack.effort_m2ps3 - effort_m2ps3).abs() < 0.01 * scale,
            "{name}, {controller}: {effort_m2ps3}"
        );
    }
}

#[test]
fn a_jerk_without_bounds_is_none() {
    let scenario = built_in_scenario("paper-1").unwrap();
    for controller in ["baseline", "idm"] {
        let effort = |jerk_mps3| {
            let envelope = Envelope {
                jerk_mps3,
                ..Envelope::from_scenario(&scenario)
            };
            let attack = find_mildest(&scenario, controller, envelope, 400);
            attack.expect("collides").effort_m2ps3
        };
        assert_eq!(effort(1e308), effort(1e6), "{controller}");
        assert_eq!(effort(f64::INFINITY), effort(1e6), "{controller}");
    }
}

/// Including the first instant.
#[test]
fn no_profile_is_rougher_than_the_envelope() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let envelope = Envelope {
        max_brake_mps2: 6.0,
        jerk_mps3: 8.0,
    };
    for (controller, aim) in [
        ("baseline", AttackObjective::Mildest),
        ("idm", AttackObjective::Mildest),
        ("policy", AttackObjective::Severest),
    ] {
        let attack =
            find_attack(&scenario, &options(controller), aim, envelope, 800).expect("collides");
        let Driver::Profile(LeadProfile::Pieces(pieces)) = &attack.scenario.vehicles()[0].driver
        else {
            panic!()
        };
        let mut before = (0.0, 0.0);
        for (&from_s, &accel_mps2) in pieces.from_s.iter().zip(&pieces.accel_mps2) {
            // Equal neighbours form one piece; changes to the first piece and between pieces take 0.1 s.
            let change = (accel_mps2 - before.1).abs();
            assert!(
                change <= 0.8 + 1e-6,
                "{controller}: {change} m/s² from {} to {from_s} s",
                before.0
            );
            assert!((-6.0..=0.0).contains(&accel_mps2));
            before = (from_s, accel_mps2);
        }
    }
}

#[test]
fn nonsense_is_refused() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let none = Envelope {
        max_brake_mps2: 0.0,
        jerk_mps3: 10.0,
    };
    assert!(
        attack(
            &scenario,
            &options("idm"),
            AttackObjective::Mildest,
            none,
            100,
            &Quiet
        )
        .is_err()
    );
    let reacting = scenario.edited(|spec| {
        spec.vehicles[0].driver =
            Driver::Controller(BuiltInController::from_name("idm").expect("built in"));
    });
    let envelope = Envelope::from_scenario(&scenario);
    let refused = attack(
        &reacting.unwrap(),
        &options("idm"),
        AttackObjective::Mildest,
        envelope,
        100,
        &Quiet,
    );
    assert!(refused.is_err());
    // A single pair whose follower matches its leader: no collision is possible.
    let pair = scenario.edited(|spec| spec.vehicles.truncate(2)).unwrap();
    let gentle = Envelope {
        max_brake_mps2: 1.0,
        jerk_mps3: 10.0,
    };
    assert!(find_mildest(&pair, "match-leader", gentle, 500).is_none());
}
