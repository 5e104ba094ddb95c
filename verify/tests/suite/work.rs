//! Files cannot exceed the operation limit of the checker, whatever their declared size.

use crumple_verify::{Certificate, ProvedClaim, Rejection, Statement, WorkLimit, check, check_with};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::law_follower::IDM;

const POLICY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../corpora/policy/reference.safetensors");

fn certificate_from_json(name: &str, assumptions: &[&str], claim: Value) -> Certificate {
    let absent = json!({"crumple": "", "scenario": "", "scenario_sha256": ""});
    let statement = Value::Object([(name.to_owned(), claim)].into_iter().collect());
    let file = json!({"version": 1, "provenance": absent, "assumptions": assumptions, "statement": statement});
    Certificate::from_json(&file.to_string()).unwrap()
}

fn policy() -> Vec<u8> {
    std::fs::read(POLICY).unwrap()
}

fn reach_certificate(cuts: u32, steps: u32) -> Certificate {
    fn cells(cuts: u32) -> Vec<Value> {
        match cuts {
            0 => vec![json!("verified")],
            _ => [vec![json!({"cut": "gap_ahead_m"})], cells(cuts - 1), cells(cuts - 1)].concat(),
        }
    }
    let digest: String = Sha256::digest(policy()).iter().map(|byte| format!("{byte:02x}")).collect();
    let claim = json!({
        "policy_file": "reference.safetensors", "policy_sha256": digest, "step_s": 0.01, "steps": steps,
        "follower_ttc_s": 1.4, "observation_error": [1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9],
        "ranges": {
            "gap_ahead_m": {"low": 15.99, "high": 16.01}, "gap_behind_m": 16, "leader_speed_mps": 25,
            "ego_speed_mps": 25, "follower_speed_mps": 25, "leader_brake_mps2": 3, "follower_brake_mps2": 6,
            // The leader never brakes, so propagation never stops early.
            "onset_steps": 1e5
        },
        "partition": cells(cuts), "verified_share_at_least": 0, "falsified_share_at_least": 0, "min_gap_m_at_least": 0
    });
    let driven = ["exact-motion", "scripted-leader", "policy-drives", "observed-within", "tanh-within"];
    certificate_from_json("reach", &[&driven[..], &["latched-follower"]].concat(), claim)
}

fn other_certificates() -> Vec<Certificate> {
    let leader = json!({"position_m": 3, "length_m": 2, "speed_mps": 0, "acceleration_mps2": [[1000, 0]]});
    let scene = |x: f64, v: f64| {
        let ego = json!({"position_m": x, "length_m": 2, "speed_mps": v, "max_brake_mps2": 8, "max_accel_mps2": 3});
        json!({"step_s": 0.1, "steps": 1000, "leader": leader, "egos": [ego], "follower": null})
    };
    let unavoidable = json!({"scene": scene(0.0, 20.0), "branches": [{"first": 0, "last": 1000, "front": [[1, 1]]}]});
    let avoidable = json!({"scene": scene(-100.0, 20.0), "witness": [[[1000, -8]]]});
    let kernel = json!({
        "ego_brake_mps2": "6", "leader_brake_mps2": "6", "step_s": "1/100", "margin_m": "1/1000000",
        "stopping_own_squared": "1/12", "stopping_ahead_squared": "-1/12"
    });
    let registration =
        crumple_verify::Registration { configuration: [].into(), runs: 1_000_000, confidence: 0.999, block_runs: None };
    let registered = |field: &str, k: u64, other: &str, value: Value| {
        json!({
            "registration": serde_json::to_value(&registration).unwrap(), "registration_sha256": registration.digest(),
            field: k, other: value
        })
    };
    vec![
        certificate_from_json("avoidable", &["exact-motion", "scripted-leader", "ego-on-profile"], avoidable),
        certificate_from_json("unavoidable", &["exact-motion", "scripted-leader", "ego-within-limits"], unavoidable),
        certificate_from_json("kernel", &["exact-motion", "leader-within-limit", "ego-can-brake"], kernel),
        certificate_from_json("rate", &["registered-draws"], registered("failures", 0, "rate_at_most", json!(0.01))),
        certificate_from_json(
            "comparison",
            &["registered-draws"],
            registered("only_first_failed", 0, "only_second_failed", json!(1000)),
        ),
    ]
}

fn is_too_much(result: &Result<ProvedClaim, Rejection>) -> bool {
    matches!(result, Err(Rejection::BudgetExceeded { .. }))
}

#[test]
fn excessive_announced_work_is_refused() {
    // 32 767 cells of a hundred thousand steps in half a megabyte: many hours.
    let endless = reach_certificate(14, 100_000);
    let limit = WorkLimit::from_billions(1);
    let result = check_with(&endless, Some(&policy()), limit);
    assert_eq!(result, Err(Rejection::BudgetExceeded { limit }));
    let message = result.unwrap_err().to_string();
    assert_eq!(message, "the check takes more than the allowed 1000000000 operations");
    for claim in other_certificates() {
        assert!(check(&claim).is_ok(), "{:?}", check(&claim));
        let name = claim.statement.name();
        assert!(is_too_much(&check_with(&claim, None, WorkLimit::from_operations(1000))), "{name}");
        assert!(check_with(&claim, None, WorkLimit::from_billions(1)).is_ok(), "{name}");
    }
}

#[test]
fn limits_are_printed_in_whole_billions() {
    for (operations, billions) in [(0, 0), (999_999_999, 0), (1_000_000_000, 1), (7_999_999_999, 7)] {
        assert_eq!(WorkLimit::from_operations(operations).to_billions(), billions);
    }
    assert_eq!((WorkLimit::from_billions(3).to_billions(), WorkLimit::default().to_billions()), (3, 4000));
}

/// A follower with a law costs operations in every step, about 300 000 here, however rare the decisions.
#[test]
fn a_modelled_follower_is_counted() {
    let (mut claim, limit) = (reach_certificate(0, 3000), WorkLimit::from_operations(600_000_000));
    assert!(check_with(&claim, Some(&policy()), limit).is_ok());
    let Statement::Reach(of) = &mut claim.statement else { panic!() };
    (of.follower_ttc_s, of.follower_law) = (None, Some(Box::new(IDM)));
    claim.assumptions = claim.statement.assumptions();
    assert!(is_too_much(&check_with(&claim, Some(&policy()), limit)));
    assert!(check_with(&claim, Some(&policy()), WorkLimit::default()).is_ok());
}

#[test]
fn the_limit_is_where_it_was() {
    let (claim, policy) = (reach_certificate(3, 500), policy());
    let checked = |operations: u64| check_with(&claim, Some(&policy), WorkLimit::from_operations(operations));
    let (mut refused, mut enough) = (0, 1 << 40);
    assert!(checked(enough).is_ok(), "{:?}", checked(enough));
    while enough - refused > 1 {
        let middle = refused + (enough - refused) / 2;
        match checked(middle) {
            Ok(_) => enough = middle,
            result => {
                assert!(is_too_much(&result), "{result:?}");
                refused = middle;
            }
        }
    }
    for _ in 0..20 {
        assert!(checked(enough).is_ok() && is_too_much(&checked(refused)));
    }
}

#[test]
fn no_list_is_longer_than_its_subject() {
    let [avoidable, unavoidable, .., rate, _] = &other_certificates()[..] else { panic!("five kinds") };
    let reach = reach_certificate(1, 100);
    let empty: Vec<()> = Vec::new();
    let many = |count: usize, entry: &Value| Value::Array(vec![entry.clone(); count]);
    let scene = "/statement/avoidable/scene";
    let ego = serde_json::to_value(avoidable).unwrap().pointer(&format!("{scene}/egos/0")).unwrap().clone();
    let names: serde_json::Map<String, Value> = (0..10_001).map(|n| (n.to_string(), json!(""))).collect();
    for (original, place, entries) in [
        (avoidable, "/statement/avoidable/witness", many(17, &json!(empty))),
        (avoidable, "/statement/avoidable/scene/egos", many(17, &ego)),
        (avoidable, "/statement/avoidable/scene/leader/acceleration_mps2", many(100_001, &json!([1, 0]))),
        (unavoidable, "/statement/unavoidable/branches", many(100_002, &json!({}))),
        (unavoidable, "/statement/unavoidable/branches", json!([{"speed": many(17, &json!(empty))}])),
        (unavoidable, "/statement/unavoidable/branches", json!([{"between": many(17, &json!(empty))}])),
        (&reach, "/statement/reach/partition", many(2_000_001, &json!("verified"))),
        (rate, "/statement/rate/registration/configuration", Value::Object(names)),
    ] {
        let mut file = serde_json::to_value(original).unwrap();
        *file.pointer_mut(place).unwrap() = entries;
        let message = Certificate::from_json(&file.to_string()).unwrap_err().to_string();
        assert!(message.contains("at most"), "{place}: {message}");
    }
}
