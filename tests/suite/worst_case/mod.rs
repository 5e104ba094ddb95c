//! Avoidability against the paper, brute force, every controller, and the checker.

mod attacks;
#[allow(unreachable_pub, reason = "shared with the tests of the checker")]
#[path = "../../../verify/tests/suite/support/mutants.rs"]
mod mutants;
mod opponent;
mod scenes;

use crumple_search::worst_case::{
    AvoidOptions, Avoidance, AvoidanceVerdict, UndecidedReason, avoid, certify, covers_scenario,
};
use crumple_sim::control::{AebSettings, BuiltInController};
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::{
    Brake, Driver, LeadProfile, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
    built_in_scenario, file,
};
use crumple_verify::{Certificate, ProvedClaim, Rejection, Statement};
use serde_json::Value;

use scenes::{random_scenario, scenario_of_scene, small_scenario, with_pieces};

/// Decides avoidability. Checks that the checker accepts the bound of an escape, and rejects a smaller one.
fn decide_with_bound(scenario: &Scenario) -> Avoidance {
    let options = AvoidOptions {
        certify_bound: true,
        ..AvoidOptions::default()
    };
    let avoidance = avoid(scenario, options).expect("the default grid fits");
    let Some(certificate) = &avoidance.bound_certificate else {
        return avoidance;
    };
    let bound_m = avoidance.min_gap_bound_m.expect("what is certified");
    assert!(
        matches!(check_certificate(certificate), ProvedClaim::GapBound { gap_m, .. } if gap_m == bound_m)
    );
    assert!(covers_scenario(certificate, scenario));
    let mut stronger = (**certificate).clone();
    if let Statement::GapBound(claim) = &mut stronger.statement {
        claim.gap_m = claim.gap_m.next_down();
    }
    assert!(matches!(
        crumple_verify::check(&stronger),
        Err(Rejection::GapBound { .. })
    ));
    avoidance
}

fn run(
    scenario: &Scenario,
    controller: &BuiltInController,
    estimator: EstimatorKind,
    parts: f64,
) -> SimulationResult {
    let options = RunOptions::new(controller.clone()).with_estimator(estimator);
    let options = options.with_dt_s(scenario.spec().step_s / parts);
    simulate(
        &Run::new(scenario, options).expect("fits"),
        RecordingLevel::Summary,
    )
}

/// Simulates a scenario with scripts in all vehicles, at a part of its step.
fn replay(scenario: &Scenario, parts: f64) -> SimulationResult {
    run(
        scenario,
        &BuiltInController::MatchLeader(Default::default()),
        EstimatorKind::Truth,
        parts,
    )
}

fn smallest_gap_m(simulated: &SimulationResult) -> f64 {
    simulated
        .vehicles
        .iter()
        .filter_map(|vehicle| vehicle.min_gap_m)
        .fold(f64::INFINITY, f64::min)
}

fn check_certificate(certificate: &Certificate) -> ProvedClaim {
    // The file counts.
    let text = serde_json::to_string(certificate).expect("plain data");
    let read = Certificate::from_json(&text).expect("our own file");
    assert_eq!(read, *certificate);
    crumple_verify::check(&read).expect("our own proof")
}

/// Values of a prototype in another language.
#[test]
fn the_papers_collisions_were_avoidable() {
    for (name, gap_m, trigger_s) in [
        ("paper-1", 8.4, Some(3.2)),
        ("paper-2", 9.2, None),
        ("paper-3", 8.7, None),
    ] {
        let scenario = built_in_scenario(name).unwrap();
        let avoidance = decide_with_bound(&scenario);
        let escape = avoidance
            .verdict
            .escape()
            .unwrap_or_else(|| panic!("{name}: {:?}", avoidance.verdict));
        assert!(
            (escape.min_gap_m - gap_m).abs() < 0.2,
            "{name}: {} m",
            escape.min_gap_m
        );
        assert!(avoidance.bound_certificate.is_some(), "{name}");
        assert!(
            avoidance.min_gap_bound_m.unwrap() >= escape.min_gap_m,
            "{name}"
        );
        assert!(
            avoidance.min_gap_bound_m.unwrap() < gap_m + 0.6,
            "{name}: {avoidance:?}"
        );
        let fired_s = escape
            .trigger_time_s()
            .expect("the gap is worth braking for");
        assert!(
            trigger_s.is_none_or(|expected: f64| (fired_s - expected).abs() < 0.2),
            "{name}: {fired_s} s"
        );
        let text = file::to_toml(&escape.scenario).unwrap();
        let escape_file = file::from_toml(&text, "escape.toml".as_ref(), &NoDriverFiles).unwrap();
        for parts in [1.0, 10.0] {
            let replayed = replay(&escape_file, parts);
            assert_eq!(replayed.outcome, Outcome::NoCollision, "{name}");
        }
        let certificate = certify(&scenario, escape).expect("accepted");
        let proved = check_certificate(&certificate);
        assert!(
            matches!(proved, ProvedClaim::Avoidable { min_gap_m, .. } if min_gap_m > gap_m - 0.3)
        );
        assert!(covers_scenario(&certificate, &scenario));
        assert!(!covers_scenario(
            &certificate,
            &scenario
                .edited(|s| s.vehicles[1].position_m += 0.001)
                .unwrap()
        ));
    }
}

#[test]
fn a_finer_grid_closes_the_bracket() {
    let scenario = built_in_scenario("paper-1").unwrap();
    let avoidance = avoid(
        &scenario,
        AvoidOptions {
            grid_s: Some(0.01),
            ..AvoidOptions::default()
        },
    )
    .unwrap();
    let gap_m = avoidance.verdict.escape().unwrap().min_gap_m;
    assert!(
        (avoidance.min_gap_bound_m.unwrap() - gap_m).abs() < 0.02,
        "{avoidance:?}"
    );
    assert!(
        avoid(
            &scenario,
            AvoidOptions {
                grid_s: Some(0.015),
                ..AvoidOptions::default()
            }
        )
        .is_err()
    );
}

/// Behind a standing vehicle, a gap decides exactly if it is the stopping distance of 25²/15 m.
#[test]
fn the_stopping_distance_decides_behind_a_standing_vehicle() {
    let with_gap = |gap_m: f64| {
        let standing = VehicleSpec::new(
            VehicleClass::Light,
            gap_m + VehicleClass::Light.length_m(),
            0.0,
            Driver::Profile(LeadProfile::Brake(Brake {
                onset_s: 1.0,
                rate_mps2: 3.0,
            })),
        );
        let mut ego = VehicleSpec::new(VehicleClass::Light, 0.0, 25.0, Driver::UnderTest);
        ego.max_brake_mps2 = Some(7.5);
        let spec = ScenarioSpec::new("standing".to_owned(), 30.0, vec![standing, ego]);
        decide_with_bound(&Scenario::new(spec).expect("valid"))
    };
    let stopping_m = 25.0 * 25.0 / 15.0;
    let avoidable = with_gap(stopping_m + 0.3);
    let gap_m = avoidable.verdict.escape().expect("an escape").min_gap_m;
    let bound_m = avoidable.min_gap_bound_m.expect("a bound");
    assert!((gap_m - 0.3).abs() < 0.015, "{gap_m}");
    assert!((0.3..0.33).contains(&bound_m), "{bound_m}");
    let unavoidable = with_gap(stopping_m - 0.06);
    assert!(
        matches!(unavoidable.verdict, AvoidanceVerdict::Unavoidable(_)),
        "{unavoidable:?}"
    );
}

/// Escapes of a finer grid stay below the certified bounds, and no escape is reported as optimal.
#[test]
fn no_escape_of_a_finer_grid_is_beyond_the_bound_that_is_certified() {
    let kept_m = |scenario: &Scenario, grid_s: Option<f64>| {
        let avoidance = avoid(
            scenario,
            AvoidOptions {
                grid_s,
                certify_bound: true,
                ..AvoidOptions::default()
            },
        )
        .unwrap();
        let (kept_m, certificate) = (
            avoidance.best_min_gap_m?,
            avoidance.bound_certificate.expect("a bound"),
        );
        let ProvedClaim::GapBound { gap_m: bound_m, .. } = check_certificate(&certificate) else {
            panic!("a bound")
        };
        assert!(avoidance.min_gap_bound_m == Some(bound_m) && kept_m <= bound_m);
        Some((kept_m, bound_m))
    };
    for (name, said_m, found_m) in [("paper-2", 9.16, 9.1768), ("paper-3", 8.66, 8.6814)] {
        let scenario = built_in_scenario(name).unwrap();
        let (coarse_m, bound_m) = kept_m(&scenario, None).unwrap();
        let (fine_m, _) = kept_m(&scenario, Some(0.02)).unwrap();
        println!("{name}: {coarse_m} {fine_m} {bound_m}");
        assert!((coarse_m - said_m).abs() < 0.01, "{name}: {coarse_m}");
        assert!(
            fine_m >= found_m - 5e-5 && fine_m <= bound_m,
            "{name}: {fine_m} {bound_m}"
        );
    }
    // A finer grid found 5.90 m where 5.77 m was reported as optimal; other scenarios gain as much.
    let mut most_m: f64 = 0.0;
    for scenario in (0..40).map(small_scenario) {
        let Some((coarse_m, bound_m)) = kept_m(&scenario, Some(0.3)) else {
            continue;
        };
        let Some((fine_m, _)) = kept_m(&scenario, Some(0.1)) else {
            continue;
        };
        assert!(
            fine_m <= bound_m,
            "{}: {fine_m} {bound_m}",
            scenario.spec().name
        );
        most_m = most_m.max(fine_m - coarse_m);
    }
    println!("{most_m}");
    assert!(most_m > 0.1, "{most_m}");
}

/// Every sequence of full braking, coasting and full acceleration, with a change every 0.5 s.
#[test]
fn brute_force_never_does_better() {
    let mut escaped = 0;
    for seed in 0..60 {
        let scenario = small_scenario(seed);
        let avoidance = decide_with_bound(&scenario);
        let brute_m = brute_force_m(&scenario);
        match &avoidance.verdict {
            AvoidanceVerdict::Unavoidable(_) => {
                assert!(brute_m <= 0.0, "{seed}: brute force keeps {brute_m} m")
            }
            _ if brute_m > 0.0 => {
                escaped += 1;
                let bound_m = avoidance.min_gap_bound_m.expect("an escape needs a bound");
                assert!(
                    brute_m <= bound_m + 1e-6,
                    "{seed}: brute force keeps {brute_m} m, and {bound_m} m is the bound"
                );
            }
            _ => {}
        }
    }
    assert!(
        (10..55).contains(&escaped),
        "{escaped}: the scenarios are too easy or too hard to tell anything"
    );
}

fn brute_force_m(scenario: &Scenario) -> f64 {
    let choices = [
        -scenario.usable_brake_mps2(1),
        0.0,
        scenario.vehicles()[1].max_accel_mps2(),
    ];
    let spans = scenario.steps() / 5;
    let gap_m = |code: usize| {
        let pieces = (0..spans)
            .map(|span| choices[code / 3_usize.pow(span as u32) % 3])
            .collect();
        let from_s = (0..spans).map(|span| span as f64 * 0.5).collect();
        let scripted = with_pieces(scenario, 1, from_s, pieces);
        smallest_gap_m(&replay(&scripted, 1.0))
    };
    (0..3_usize.pow(spans as u32))
        .map(gap_m)
        .fold(f64::NEG_INFINITY, f64::max)
}

/// A controller that survives an unavoidable scenario, or exceeds the bound, would refute the verdict.
#[test]
fn no_controller_contradicts_a_verdict() {
    let count: u64 = 100 * u64::from(crate::generate::with_cases(256).cases) / 256;
    let (mut undecided, mut avoidable, mut unavoidable, mut programs) = (Vec::new(), 0, 0, 0);
    for seed in 0..count {
        let scenario = random_scenario(seed);
        let avoidance = decide_with_bound(&scenario);
        programs += avoidance.programs;
        let kept_m = BuiltInController::all().into_iter().map(|controller| {
            let results = [EstimatorKind::Truth, EstimatorKind::Kalman]
                .map(|eyes| run(&scenario, &controller, eyes, 1.0));
            (
                controller.name(),
                results.iter().map(smallest_gap_m).fold(0.0, f64::max),
            )
        });
        match &avoidance.verdict {
            AvoidanceVerdict::Avoidable(escape) => {
                avoidable += 1;
                let bound_m = avoidance.min_gap_bound_m.expect("an escape needs a bound");
                assert!(
                    avoidance.bound_certificate.is_some(),
                    "{seed}: the bound has a certificate"
                );
                for (name, kept_m) in kept_m {
                    assert!(
                        kept_m <= bound_m + 1e-9,
                        "{seed}: {name} keeps {kept_m} m, and {bound_m} m is the bound"
                    );
                }
                check_certificate(
                    &certify(&scenario, escape).unwrap_or_else(|why| panic!("{seed}: {why}")),
                );
            }
            AvoidanceVerdict::Unavoidable(certificate) => {
                unavoidable += 1;
                assert_eq!(
                    avoidance.min_gap_bound_m, None,
                    "{seed}: there is no escape to bound"
                );
                for (name, kept_m) in kept_m {
                    assert!(
                        kept_m <= 0.0,
                        "{seed}: {name} survives what no controller can"
                    );
                }
                let proved = check_certificate(certificate);
                assert!(
                    matches!(proved, ProvedClaim::Unavoidable { overlap_m, .. } if overlap_m > 0.0)
                );
                assert!(covers_scenario(certificate, &scenario));
            }
            AvoidanceVerdict::Undecided(reason) => undecided.push((seed, reason.clone())),
        }
    }
    println!(
        "{avoidable} avoidable, {unavoidable} unavoidable, {programs} programs, undecided: {undecided:?}"
    );
    assert!(undecided.len() as u64 * 50 <= count, "{undecided:?}");
    // The multipliers of one program must spare most of the others. The mean depends on the sample: it is 23.1 programs
    // for the first 100 scenes, 26.8 for 250 and 29.8 for 1000. A third of the 1000 scenes need 64 programs or more.
    let most = if count <= 100 { 25 } else { 32 };
    assert!(
        programs as u64 <= most * count,
        "{programs} programs for {count} scenes"
    );
    assert!(
        avoidable * 5 > count && unavoidable * 20 > count,
        "{avoidable} and {unavoidable}: nothing to tell apart"
    );
}

#[test]
fn a_certificate_is_about_its_own_scenario() {
    fn brake(spec: &mut ScenarioSpec) -> &mut Brake {
        match &mut spec.vehicles[0].driver {
            Driver::Profile(LeadProfile::Brake(brake)) => brake,
            other => panic!("{other:?}"),
        }
    }
    let changes: [fn(&mut ScenarioSpec); 19] = [
        |s| s.duration_s -= s.step_s,
        |s| s.step_s *= 0.5,
        |s| s.environment.friction = 0.9,
        |s| s.vehicles[0].position_m += 1e-3,
        |s| s.vehicles[0].speed_mps += 1e-3,
        |s| s.vehicles[0].length_m = Some(5.5),
        |s| brake(s).rate_mps2 -= 1e-3,
        |s| brake(s).onset_s += s.step_s,
        |s| s.vehicles[1].position_m -= 1e-3,
        |s| s.vehicles[1].speed_mps += 1e-3,
        |s| s.vehicles[1].length_m = Some(5.5),
        |s| s.vehicles[1].max_brake_mps2 = Some(5.5),
        |s| s.vehicles[1].max_accel_mps2 = Some(1.25),
        |s| s.vehicles[2].position_m -= 1e-3,
        |s| s.vehicles[2].speed_mps += 1e-3,
        |s| s.vehicles[2].max_brake_mps2 = Some(5.5),
        |s| s.vehicles[2].reaction_delay_s += s.step_s,
        |s| {
            s.vehicles[2].driver =
                Driver::Controller(BuiltInController::Baseline(AebSettings { ttc_s: 1.3 }))
        },
        |s| s.vehicles.truncate(2),
    ];
    let certified = |scenario: &Scenario| match decide_with_bound(scenario).verdict {
        AvoidanceVerdict::Avoidable(escape) => Some(certify(scenario, &escape).expect("accepted")),
        AvoidanceVerdict::Unavoidable(certificate) => Some(*certificate),
        AvoidanceVerdict::Undecided(_) => None,
    };
    // A vehicle with a delay cannot follow a profile that begins immediately.
    let paper_1 = built_in_scenario("paper-1").unwrap();
    let late = paper_1
        .edited(|spec| spec.vehicles[1].reaction_delay_s = 0.2)
        .unwrap();
    let (early, waits) = (
        certified(&paper_1).expect("decided"),
        certified(&late).expect("decided"),
    );
    assert!(
        !covers_scenario(&early, &late)
            && covers_scenario(&waits, &late)
            && covers_scenario(&waits, &paper_1)
    );
    let mut kinds = std::collections::BTreeSet::new();
    for scenario in (0..12).map(small_scenario) {
        let pair = scenario.edited(|spec| spec.vehicles.truncate(2)).unwrap();
        if let Some(certificate) = certified(&pair) {
            assert!(
                covers_scenario(&certificate, &pair) && !covers_scenario(&certificate, &scenario),
                "{}",
                scenario.spec().name
            );
        }
        let Some(certificate) = certified(&scenario) else {
            continue;
        };
        kinds.insert(certificate.statement.name());
        assert!(
            covers_scenario(&certificate, &scenario),
            "{}",
            scenario.spec().name
        );
        for (index, change) in changes.iter().enumerate() {
            let other = scenario.edited(change).unwrap();
            assert!(
                !covers_scenario(&certificate, &other),
                "{}: change {index}",
                scenario.spec().name
            );
        }
    }
    assert_eq!(kinds.len(), 2, "{kinds:?}");
}

/// Any single change that the checker accepts is a true statement: solved or replayed again.
#[test]
fn accepted_mutants_are_true() {
    let verdicts = (0..40).map(|seed| {
        (
            small_scenario(seed),
            decide_with_bound(&small_scenario(seed)).verdict,
        )
    });
    let (mut accepted, mut rejected, mut kinds) = (0, 0, [0, 0]);
    for (scenario, verdict) in verdicts {
        let (kind, certificate) = match verdict {
            AvoidanceVerdict::Avoidable(escape) => {
                (0, certify(&scenario, &escape).expect("accepted"))
            }
            AvoidanceVerdict::Unavoidable(certificate) => (1, *certificate),
            AvoidanceVerdict::Undecided(_) => continue,
        };
        if kinds[kind] == 2 {
            continue;
        }
        kinds[kind] += 1;
        let original = serde_json::to_value(&certificate).expect("plain data");
        for (change, mutant) in mutants::mutants(&original) {
            if serde_json::from_value::<Certificate>(mutant.clone())
                .is_ok_and(|file| crumple_verify::check(&file).is_ok())
            {
                accepted += 1;
                assert!(
                    is_true_statement(&certificate, &mutant),
                    "{}: {change}",
                    scenario.spec().name
                );
            } else {
                rejected += 1;
            }
        }
    }
    println!("{accepted} mutants are accepted, {rejected} rejected");
    assert_eq!(kinds, [2, 2]);
    assert!(
        rejected > accepted && accepted > 0,
        "{accepted} accepted, {rejected} rejected"
    );
}

fn is_true_statement(original: &Certificate, mutant: &Value) -> bool {
    let mutant: Certificate = serde_json::from_value(mutant.clone()).expect("was read before");
    match (&original.statement, &mutant.statement) {
        (Statement::Unavoidable(before), Statement::Unavoidable(after))
            if before.scene == after.scene =>
        {
            true
        }
        (_, Statement::Unavoidable(claim)) => {
            scenario_of_scene(&claim.scene, &[]).is_none_or(|scenario| {
                !matches!(
                    decide_with_bound(&scenario).verdict,
                    AvoidanceVerdict::Avoidable(_)
                )
            })
        }
        (_, Statement::Avoidable(claim)) => scenario_of_scene(&claim.scene, &claim.witness)
            .is_none_or(|scenario| {
                let replayed = replay(&scenario, 10.0);
                smallest_gap_m(&replayed) >= claim.min_gap_m_at_least.unwrap_or(0.0).max(1e-12)
            }),
        (_, other) => panic!("a mutant of another kind: {}", other.name()),
    }
}

#[test]
fn unmodelled_scenarios_are_undecided_or_still_proved() {
    let reason = |change: &dyn Fn(&mut crumple_sim::scenario::ScenarioSpec)| {
        let changed = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| change(spec))
            .unwrap();
        match decide_with_bound(&changed).verdict {
            AvoidanceVerdict::Undecided(reason) => Some(reason),
            _ => None,
        }
    };
    let idm = BuiltInController::from_name("idm").unwrap();
    let idm = crumple_sim::scenario::Driver::Controller(idm);
    // With any leader, a collision-free script is an escape; without one there is no verdict.
    assert_eq!(reason(&|s| s.vehicles[0].driver = idm.clone()), None);
    let wall = |s: &mut crumple_sim::scenario::ScenarioSpec| {
        (s.vehicles[0].speed_mps, s.vehicles[0].driver) = (0.0, idm.clone());
    };
    assert_eq!(reason(&wall), Some(UndecidedReason::Leader));
    assert_eq!(
        reason(&|s| s.vehicles[1].driver = idm.clone()),
        Some(UndecidedReason::NoEgo)
    );
    assert_eq!(
        reason(&|s| s.vehicles[1].actuator_lag_s = 0.2),
        Some(UndecidedReason::EgoResponse { vehicle: 1 })
    );
    // An escape includes the ego's delay; before a wall a collision is unavoidable, with lag or without.
    assert_eq!(reason(&|s| s.vehicles[1].reaction_delay_s = 0.2), None);
    assert_eq!(
        reason(&|s| (s.vehicles[0].speed_mps, s.vehicles[1].actuator_lag_s) = (0.0, 0.2)),
        None
    );
    assert_eq!(
        reason(&|s| s.vehicles[0].acceleration_noise_mps2 = 0.01),
        None
    );
    // Noise of the ego may exceed any bound.
    let noisy = built_in_scenario("paper-1")
        .unwrap()
        .edited(|s| s.vehicles[1].acceleration_noise_mps2 = 0.01)
        .unwrap();
    let avoidance = decide_with_bound(&noisy);
    assert!(
        avoidance.best_min_gap_m.is_some() && avoidance.min_gap_bound_m.is_none(),
        "{avoidance:?}"
    );
}

/// A certificate has room for sixteen vehicles.
#[test]
fn too_many_vehicles_are_reported() {
    let paper_3 = built_in_scenario("paper-3").unwrap();
    let crowd = paper_3.edited(|spec| {
        let ego = spec.vehicles[1].clone();
        spec.vehicles.truncate(2);
        spec.vehicles[0].speed_mps = 0.0;
        for index in 1..17 {
            let position_m = ego.position_m - 20.0 * f64::from(index);
            spec.vehicles.push(crumple_sim::scenario::VehicleSpec {
                position_m,
                ..ego.clone()
            });
        }
    });
    let avoidance = decide_with_bound(&crowd.unwrap());
    assert_eq!(
        avoidance.verdict,
        AvoidanceVerdict::Undecided(UndecidedReason::TooManyVehicles { egos: 17, most: 16 })
    );
}
