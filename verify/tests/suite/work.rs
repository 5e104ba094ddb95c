//! Files cannot exceed the operation limit of the checker, whatever their declared size.

use crumple_verify::reach::{BoxDimension, InitialRanges, PartitionCell, ReachClaim};
use crumple_verify::*;
use serde_json::{Value, json};

use crate::kernel::kernel;
use crate::law_follower::IDM;
use crate::rate::{comparison, rate};
use crate::reach::{claim, paper_box};
use crate::support::{self, certificate, one_ego_scene, policy_bytes};

fn reach_certificate(cuts: u32, steps: u32) -> Certificate {
    fn cells(cuts: u32) -> Vec<PartitionCell> {
        match cuts {
            0 => vec![PartitionCell::Verified],
            _ => [
                vec![PartitionCell::Cut(BoxDimension::GapAheadM)],
                cells(cuts - 1),
                cells(cuts - 1),
            ]
            .concat(),
        }
    }
    support::reach_certificate(ReachClaim {
        steps,
        ranges: InitialRanges {
            gap_ahead_m: Interval::new(15.99, 16.01).unwrap(),
            // The leader never brakes, so propagation never stops early.
            onset_steps: Interval::point(1e5),
            ..paper_box(0.0, 0.0)
        },
        partition: cells(cuts),
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
        ..claim()
    })
}

fn other_certificates() -> Vec<Certificate> {
    let scene = |gap_m: f64| one_ego_scene((0.1, 1000), gap_m, [0.0, 20.0], [8.0, 3.0]);
    let branch = Branch {
        last: 1000,
        front: vec![(1, 1.0)],
        ..Branch::default()
    };
    let witness = vec![vec![ConstantPiece(1000, -8.0)]];
    let statements = [
        Statement::Avoidable(AvoidableClaim {
            scene: scene(101.0),
            witness,
            min_gap_m_at_least: None,
        }),
        Statement::Unavoidable(UnavoidableClaim {
            scene: scene(1.0),
            branches: vec![branch],
        }),
        Statement::Kernel(kernel("6", "6")),
        Statement::Rate(rate(0, 1_000_000, 0.01, 0.999)),
        comparison((1_000_000, 0.999), 0, 1000),
    ];
    statements.map(certificate).into()
}

fn is_too_much(result: &Result<ProvedClaim, Rejection>) -> bool {
    matches!(result, Err(Rejection::BudgetExceeded { .. }))
}

#[test]
fn excessive_announced_work_is_refused() {
    // 32 767 cells of a hundred thousand steps in half a megabyte: many hours.
    let endless = reach_certificate(14, 100_000);
    let limit = WorkLimit::from_billions(1);
    let result = check_with(&endless, Some(&policy_bytes("reference")), limit);
    assert_eq!(result, Err(Rejection::BudgetExceeded { limit }));
    let message = result.unwrap_err().to_string();
    assert_eq!(
        message,
        "the check takes more than the allowed 1000000000 operations"
    );
    for claim in other_certificates() {
        assert!(check(&claim).is_ok(), "{:?}", check(&claim));
        let name = claim.statement.name();
        assert!(
            is_too_much(&check_with(&claim, None, WorkLimit::from_operations(1000))),
            "{name}"
        );
        assert!(
            check_with(&claim, None, WorkLimit::from_billions(1)).is_ok(),
            "{name}"
        );
    }
}

#[test]
fn limits_are_printed_in_whole_billions() {
    for (operations, billions) in [
        (0, 0),
        (999_999_999, 0),
        (1_000_000_000, 1),
        (7_999_999_999, 7),
    ] {
        assert_eq!(
            WorkLimit::from_operations(operations).to_billions(),
            billions
        );
    }
    assert_eq!(
        (
            WorkLimit::from_billions(3).to_billions(),
            WorkLimit::default().to_billions()
        ),
        (3, 4000)
    );
}

/// A follower with a law costs operations in every step, about 300 000 here, however rare the decisions.
#[test]
fn a_modelled_follower_is_counted() {
    let (mut claim, limit) = (
        reach_certificate(0, 3000),
        WorkLimit::from_operations(600_000_000),
    );
    assert!(check_with(&claim, Some(&policy_bytes("reference")), limit).is_ok());
    let Statement::Reach(of) = &mut claim.statement else {
        panic!()
    };
    (of.follower_ttc_s, of.follower_law) = (None, Some(Box::new(IDM)));
    claim.assumptions = claim.statement.assumptions();
    assert!(is_too_much(&check_with(
        &claim,
        Some(&policy_bytes("reference")),
        limit
    )));
    assert!(
        check_with(
            &claim,
            Some(&policy_bytes("reference")),
            WorkLimit::default()
        )
        .is_ok()
    );
}

#[test]
fn the_limit_is_where_it_was() {
    let (claim, policy) = (reach_certificate(3, 500), policy_bytes("reference"));
    let checked = |operations: u64| {
        check_with(
            &claim,
            Some(&policy),
            WorkLimit::from_operations(operations),
        )
    };
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
    let [avoidable, unavoidable, .., rate, _] = &other_certificates()[..] else {
        panic!("five kinds")
    };
    let reach = reach_certificate(1, 100);
    let empty: Vec<()> = Vec::new();
    let many = |count: usize, entry: &Value| Value::Array(vec![entry.clone(); count]);
    let scene = "/statement/avoidable/scene";
    let ego = serde_json::to_value(avoidable)
        .unwrap()
        .pointer(&format!("{scene}/egos/0"))
        .unwrap()
        .clone();
    let names: serde_json::Map<String, Value> =
        (0..10_001).map(|n| (n.to_string(), json!(""))).collect();
    for (original, place, entries) in [
        (
            avoidable,
            "/statement/avoidable/witness",
            many(17, &json!(empty)),
        ),
        (avoidable, "/statement/avoidable/scene/egos", many(17, &ego)),
        (
            avoidable,
            "/statement/avoidable/scene/leader/acceleration_mps2",
            many(100_001, &json!([1, 0])),
        ),
        (
            unavoidable,
            "/statement/unavoidable/branches",
            many(100_002, &json!({})),
        ),
        (
            unavoidable,
            "/statement/unavoidable/branches",
            json!([{"speed": many(17, &json!(empty))}]),
        ),
        (
            unavoidable,
            "/statement/unavoidable/branches",
            json!([{"between": many(17, &json!(empty))}]),
        ),
        (
            &reach,
            "/statement/reach/partition",
            many(2_000_001, &json!("verified")),
        ),
        (
            rate,
            "/statement/rate/registration/configuration",
            Value::Object(names),
        ),
    ] {
        let mut file = serde_json::to_value(original).unwrap();
        *file.pointer_mut(place).unwrap() = entries;
        let message = Certificate::from_json(&file.to_string())
            .unwrap_err()
            .to_string();
        assert!(message.contains("at most"), "{place}: {message}");
    }
}
