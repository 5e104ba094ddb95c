//! Files: accepted and rejected ones, and mutations.

use std::process::Command;

use crate::support;
use crate::support::mutants::mutants;
use crate::support::{
    certificate, expand_to_substeps, has_escape, pick_member, proofs, simulate_scene,
};
use crumple_verify::*;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use serde_json::{Value, json};

fn unavoidable_file() -> Value {
    // Picks a random proof whose boxes and follower use most fields.
    let mut runner = TestRunner::deterministic();
    let is_rich = |scene: &Scene, branches: &[Branch]| {
        let uses = |used: &dyn Fn(&Branch) -> bool| branches.iter().any(used);
        scene.steps <= 5
            && scene.leader.position_m.low() < scene.leader.position_m.high()
            && uses(&|branch| !branch.rear.is_empty() && !branch.front.is_empty())
            && uses(&|branch| !branch.unfired.is_empty())
            && uses(&|branch| branch.fired > 0.0)
    };
    loop {
        let (scene, branches) = proofs(1).new_tree(&mut runner).unwrap().current();
        if is_rich(&scene, &branches) {
            let certificate =
                certificate(Statement::Unavoidable(UnavoidableClaim { scene, branches }));
            if check(&certificate).is_ok() {
                return serde_json::to_value(certificate).unwrap();
            }
        }
    }
}

fn avoidable_file() -> Value {
    json!({
        "version": 1,
        "provenance": {"crumple": "0.1.0", "scenario": "a calm stop", "scenario_sha256": ""},
        "assumptions": ["exact-motion", "scripted-leader", "latched-follower", "ego-on-profile"],
        "statement": {"avoidable": {
            "scene": {
                "step_s": 0.25, "steps": 20,
                "leader": {
                    "position_m": {"low": 24.9, "high": 25.1}, "length_m": 2, "speed_mps": 10,
                    "acceleration_mps2": [[4, 0], [16, {"low": -4.1, "high": -3.9}]]
                },
                "egos": [{"position_m": 10, "length_m": 2, "speed_mps": {"low": 9.9, "high": 10.1},
                          "max_brake_mps2": 5.0, "max_accel_mps2": 3}],
                "follower": {"position_m": -20, "speed_mps": 10, "brake_mps2": 6, "ttc_s": 1.4, "reaction_steps": 1}
            },
            "witness": [[[5, 0.0], [15, -5.0]]],
            "min_gap_m_at_least": 1.0
        }}
    })
}

fn is_confirmed_by_simulation(certificate: &Certificate) -> bool {
    let corners = [0.0, 0.5, 1.0];
    match &certificate.statement {
        Statement::Avoidable(claim) => corners.iter().all(|&corner| {
            let profiles = expand_to_substeps(&claim.witness);
            let min_gap_m = simulate_scene(
                &claim.scene,
                &pick_member(&claim.scene, || corner),
                &profiles,
            )
            .min_gap_m;
            min_gap_m > 0.0 && min_gap_m >= claim.min_gap_m_at_least.unwrap_or(0.0) - 1e-9
        }),
        Statement::Unavoidable(claim) => corners
            .iter()
            .all(|&corner| !has_escape(&claim.scene, &pick_member(&claim.scene, || corner), 5)),
        _ => panic!("a statement about no scene"),
    }
}

#[test]
fn accepted_changed_certificates_are_true() {
    for (original, least_rejected) in [(avoidable_file(), 0.5), (unavoidable_file(), 0.3)] {
        let read = |value: &Value| Certificate::from_json(&value.to_string());
        check(&read(&original).unwrap()).unwrap();
        let (mut accepted, mut rejected) = (0, 0);
        for (change, mutant) in mutants(&original) {
            match read(&mutant) {
                Ok(certificate) if check(&certificate).is_ok() => {
                    accepted += 1;
                    assert!(
                        is_confirmed_by_simulation(&certificate),
                        "{change} was accepted"
                    );
                }
                _ => rejected += 1,
            }
        }
        let share = f64::from(rejected) / f64::from(rejected + accepted);
        println!("{accepted} accepted, {rejected} rejected");
        assert!(
            accepted > 10 && share > least_rejected,
            "{accepted} accepted, {rejected} rejected"
        );
    }
}

/// The mutants reach every field, so the tests above would notice an unchecked one.
#[test]
fn mutants_change_every_number_once_or_more() {
    let original = avoidable_file();
    for pointer in [
        "/statement/avoidable/scene/follower/brake_mps2",
        "/statement/avoidable/witness/0/1/1",
        "/version",
    ] {
        assert!(
            mutants(&original).any(|(change, _)| change.starts_with(pointer)),
            "{pointer}"
        );
    }
    assert!(mutants(&original).all(|(_, mutant)| mutant != original));
}

#[test]
fn assumptions_are_those_of_the_statement() {
    let with = |assumptions: Value| {
        let mut file = avoidable_file();
        file["assumptions"] = assumptions;
        check(&Certificate::from_json(&file.to_string()).unwrap()).is_ok()
    };
    assert!(with(json!([
        "ego-on-profile",
        "latched-follower",
        "scripted-leader",
        "exact-motion",
        "noise-of-seed"
    ])));
    assert!(!with(json!([
        "ego-on-profile",
        "scripted-leader",
        "exact-motion"
    ])));
    assert!(!with(json!([
        "ego-on-profile",
        "scripted-leader",
        "exact-motion",
        "noise-of-seed"
    ])));
    assert!(!with(json!([
        "ego-on-profile",
        "scripted-leader",
        "exact-motion",
        "exact-motion"
    ])));
    assert!(!with(json!([
        "ego-within-limits",
        "latched-follower",
        "scripted-leader",
        "exact-motion"
    ])));
}

#[test]
fn files_that_are_no_certificates_say_where() {
    let text = serde_json::to_string_pretty(&avoidable_file()).unwrap();
    assert!(Certificate::from_json(&text).is_ok());
    for (from, to, expected) in [
        ("\"version\": 1", "\"version\": 3", "version 3"),
        (
            "\"version\": 1",
            "\"version\": 2",
            "is not in canonical form from line 2 column 4 on",
        ),
        (
            "\"max_brake_mps2\": 5.0",
            "\"max_brake_mps2\": 1e400",
            "line",
        ),
        ("\"max_brake_mps2\": 5.0", "\"max_brake_mps2\": NaN", "line"),
        (
            "\"max_brake_mps2\": 5.0",
            "\"max_brake_mps2\": null",
            "line",
        ),
        (
            "\"max_brake_mps2\": 5.0",
            "\"max_brake_mps2\": 5.0, \"max_brake_mps2\": 6.0",
            "duplicate field `max_brake_mps2`",
        ),
        (
            "\"max_brake_mps2\"",
            "\"strongest_brake_mps2\"",
            "unknown field `strongest_brake_mps2`",
        ),
        ("\"length_m\"", "\"position_m\"", "duplicate field"),
        ("\"steps\": 20", "\"steps\": 20.5", "expected u32"),
        ("\"steps\": 20", "\"steps\": -20", "expected u32"),
        (
            "\"low\"",
            "\"lowest\"",
            "unknown field `lowest`, expected `low` or `high`",
        ),
        (
            "\"brake_mps2\": 6",
            "\"brake_mps2\": [6]",
            "{\"low\": number, \"high\": number}",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let message = Certificate::from_json(&text.replacen(from, to, 1))
            .unwrap_err()
            .to_string();
        assert!(message.contains(expected), "{to}: {message}");
    }
    assert!(
        Certificate::from_json(&format!("{text} 1")).is_err(),
        "something follows"
    );
    assert!(matches!(
        Certificate::from_reader(&b"\xff"[..]),
        Err(CertificateParseError::Read(_))
    ));
    assert!(matches!(
        Certificate::from_reader(std::io::repeat(b' ')),
        Err(CertificateParseError::TooLong)
    ));
}

#[test]
fn exit_codes() {
    let folder = std::env::temp_dir().join(format!("crumple-verify-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut false_claim = avoidable_file();
    false_claim["statement"]["avoidable"]["min_gap_m_at_least"] = json!(9.0);
    let paths = [
        ("true", avoidable_file()),
        ("false", false_claim),
        ("other", json!({})),
    ]
    .map(|(name, file)| {
        let path = folder.join(name);
        std::fs::write(&path, file.to_string()).unwrap();
        path
    });
    let run = |paths: &[&std::path::PathBuf]| {
        let output = Command::new(env!("CARGO_BIN_EXE_crumple-verify"))
            .args(paths)
            .output()
            .unwrap();
        (
            output.status.code().unwrap(),
            String::from_utf8(output.stdout).unwrap(),
        )
    };
    let (code, text) = run(&[&paths[0]]);
    assert!(
        code == 0 && text.contains("accepted: avoidable") && text.contains("assuming that"),
        "{text}"
    );
    let (code, text) = run(&[&paths[0], &paths[1]]);
    assert!(
        code == 1 && text.contains("rejected: `min_gap_m_at_least` is 9"),
        "{text}"
    );
    assert_eq!(run(&[&paths[1], &paths[2], &paths[0]]).0, 2);
    assert_eq!((run(&[]).0, run(&[&folder.join("absent")]).0), (2, 2));
    // Neither an unknown option nor one without its value is the name of a file.
    for option in ["--pol", "--rerun=5", "--", "--policy", "--work-limit"] {
        let (code, text) = run(&[&paths[0], &option.into()]);
        assert_eq!((code, text.as_str()), (2, ""), "{option}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

fn shared_file(is_unavoidable: bool) -> Value {
    thread_local!(static FILES: [Value; 2] = [avoidable_file(), unavoidable_file()]);
    FILES.with(|files| files[usize::from(is_unavoidable)].clone())
}

fn any_json() -> impl Strategy<Value = Value> {
    let number = prop_oneof![
        any::<f64>().prop_map(|x| json!(x)),
        any::<u64>().prop_map(|x| json!(x)),
        (0..9_u32).prop_map(|x| json!(x))
    ];
    let leaf =
        prop_oneof![4 => number, 1 => Just(Value::Null), 1 => any::<bool>().prop_map(Value::from)];
    leaf.prop_recursive(3, 16, 4, |inner| {
        let name = prop::sample::select(vec![
            "low", "high", "first", "last", "front", "scene", "steps", "speed",
        ]);
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            prop::collection::vec((name, inner), 0..4).prop_map(|fields| fields
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect()),
        ]
    })
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(3000))]

    #[test]
    fn no_file_makes_the_checker_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any_json()), 1..4), which in any::<bool>(),
    ) {
        let mut file = shared_file(which);
        for (index, value) in changes {
            let places = support::mutants::json_pointers(&file);
            let pointer = index.get(&places).clone();
            *file.pointer_mut(&pointer).unwrap() = value;
        }
        if let Ok(certificate) = Certificate::from_json(&file.to_string()) {
            let _ = check(&certificate);
        }
    }

    #[test]
    fn huge_and_tiny_numbers_prove_nothing_false(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<f64>()), 1..4), which in any::<bool>(),
    ) {
        let mut file = shared_file(which);
        let places: Vec<String> =
            support::mutants::json_pointers(&file).into_iter().filter(|p| file.pointer(p).unwrap().is_f64()).collect();
        for (index, value) in changes {
            *file.pointer_mut(index.get(&places).as_str()).unwrap() = json!(value);
        }
        if let Ok(certificate) = Certificate::from_json(&file.to_string()) && check(&certificate).is_ok() {
            let scene = match &certificate.statement {
                Statement::Avoidable(claim) => &claim.scene,
                Statement::Unavoidable(claim) => &claim.scene,
                _ => panic!("a statement about no scene"),
            };
            // The plain simulation overflows before the check does.
            let position_m = scene.leader.position_m;
            prop_assume!(position_m.high().abs() < 1e9 && scene.egos[0].position_m.high().abs() < 1e9);
            prop_assert!(is_confirmed_by_simulation(&certificate), "{}", file);
        }
    }

    #[test]
    fn certificates_survive_a_round_trip((scene, branches) in proofs(2)) {
        let certificate = certificate(Statement::Unavoidable(UnavoidableClaim { scene, branches }));
        let text = serde_json::to_string(&certificate).unwrap();
        prop_assert_eq!(Certificate::from_json(&text).unwrap(), certificate);
    }
}

#[test]
fn the_limit_of_the_file_size_is_exact() {
    let most = crumple_verify::certificate::MAX_BYTES;
    let (file, mut text) = (avoidable_file().to_string(), " ".repeat(most + 1));
    text.replace_range(..file.len(), &file);
    assert!(Certificate::from_json(&text[..most]).is_ok());
    assert!(matches!(
        Certificate::from_json(&text),
        Err(CertificateParseError::TooLong)
    ));
}

#[test]
fn proved_claims_are_printed_as_sentences() {
    let reach = |verified_share, has_follower, leader_brakes_at_most_mps2| {
        ProvedClaim::Reach {
            verified_share,
            falsified_share: 0.001_99,
            min_gap_m: 0.5,
            horizon_s: 4.0,
            has_follower,
            leader_brakes_at_most_mps2,
        }
        .to_string()
    };
    let nothing = "reach: nothing is proved about any part of the box; cells of the box that contain an initial \
        state with a collision make up 0.19 % of its volume";
    assert_eq!(reach(0.0, true, None), nothing);
    assert_eq!(
        reach(0.999_99, true, None),
        "reach: in 99.99 % of the box's volume no gap is ever smaller than 0.5 m for 4 s, with a vehicle behind; \
         cells of the box that contain an initial state with a collision make up 0.19 % of its volume"
    );
    assert_eq!(
        reach(1e-9, false, Some(7.5)),
        "reach: in 0.00 % of the box's volume no gap is ever smaller than 0.5 m for 4 s, however the leader brakes at \
         up to 7.5 m/s², \
         with no vehicle behind; cells of the box that contain an initial state with a collision make up 0.19 % of \
         its volume"
    );
    let avoidable = |afterwards| {
        ProvedClaim::Avoidable {
            min_gap_m: 0.25,
            horizon_s: 2.0,
            after_horizon: afterwards,
        }
        .to_string()
    };
    for (afterwards, name, said) in [
        (
            SafetyAfterHorizon::ForAnyLeader,
            "whatever-the-leader-does",
            "and a collision remains avoidable afterwards, whatever the leader does",
        ),
        (
            SafetyAfterHorizon::UnlessLeaderBrakes,
            "if-the-leader-does-not-brake",
            "and a collision remains avoidable afterwards, if the leader does not brake again",
        ),
        (
            SafetyAfterHorizon::Unproved,
            "not-shown",
            "nothing is proved about the time afterwards",
        ),
    ] {
        assert_eq!(afterwards.name(), name);
        let all = format!(
            "avoidable: on the stated profile no gap is ever smaller than 0.25 m for 2 s; {said}"
        );
        assert_eq!(avoidable(afterwards), all);
    }
    let gap_bound = ProvedClaim::GapBound {
        gap_m: 1.5,
        horizon_s: 3.0,
    }
    .to_string();
    assert_eq!(
        gap_bound,
        "gap bound: for every command, some gap is at most 1.5 m within 3 s"
    );
    let rate = ProvedClaim::Rate {
        max_rate: 0.002_305_979_158_525_014_4,
        confidence: 0.999,
    }
    .to_string();
    assert_eq!(
        rate,
        "rate: at most 0.002306 at confidence 0.999, if its counts are right"
    );
}
