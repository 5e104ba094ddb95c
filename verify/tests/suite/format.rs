//! Version 2 of the file, specified in `docs/certificates.md`: canonical text and binding of a statement.

use std::collections::BTreeMap;

use crumple_verify::*;
use serde_json::{Value, json};

use crate::support::{one_ego_scene, sha256};

fn certificate(scenario: &str, text: &str, statement: Statement) -> Certificate {
    let provenance = CertificateProvenance {
        crumple: "0.1.0".to_owned(),
        scenario: scenario.to_owned(),
        scenario_sha256: sha256(text),
        scenario_text: Some(text.to_owned()),
        box_text: None,
    };
    Certificate {
        version: 2,
        provenance,
        assumptions: statement.assumptions(),
        statement,
    }
}

fn unavoidable() -> Certificate {
    let text = "name = \"by hand\"\n";
    let scene = one_ego_scene((0.1, 10), 1.0, [0.0, 20.0], [8.0, 3.0]);
    let branches = vec![Branch {
        last: 10,
        front: vec![(1, 1.0)],
        ..Branch::default()
    }];
    certificate(
        "by hand",
        text,
        Statement::Unavoidable(UnavoidableClaim { scene, branches }),
    )
}

fn rate() -> Certificate {
    let text = "name = \"paper\"\n";
    let entries = [
        ("controller", "idm"),
        ("controller_sha256", &sha256("idm")),
        ("crumple", "0.1.0"),
        ("estimator", "truth"),
        ("failure", "vehicles touch"),
        ("horizon_s", "15"),
        ("seed", "3"),
        ("space", "paper"),
        ("space_sha256", &sha256(text)),
    ];
    let configuration: BTreeMap<_, _> = entries
        .map(|(key, value)| (key.to_owned(), value.to_owned()))
        .into();
    let registration = Registration {
        configuration,
        runs: 250,
        confidence: 0.99,
        block_runs: Some(100),
    };
    let statement = Statement::Rate(RateClaim {
        registration_sha256: registration.digest(),
        registration,
        failures: 3,
        rate_at_most: 0.05,
        blocks: vec![(1, sha256("0")), (0, sha256("1")), (2, sha256("2"))],
    });
    certificate("paper", text, statement)
}

fn check_replaced(certificate: &Certificate, from: &str, to: &str) -> Result<ProvedClaim, String> {
    let text = certificate.to_canonical_json();
    assert!(text.contains(from), "{from} in {text}");
    let read =
        Certificate::from_json(&text.replacen(from, to, 1)).map_err(|error| error.to_string())?;
    check(&read).map_err(|rejection| rejection.to_string())
}

#[test]
fn files_are_canonical_with_any_whitespace() {
    for certificate in [unavoidable(), rate()] {
        check(&certificate).unwrap();
        let pretty = serde_json::to_string_pretty(&certificate).unwrap();
        for text in [certificate.to_canonical_json(), pretty] {
            let read = Certificate::from_json(&text).unwrap();
            assert_eq!(
                (&read, read.digest()),
                (&certificate, sha256(certificate.to_canonical_json()))
            );
        }
    }
}

#[test]
fn a_key_of_a_configuration_may_not_occur_twice() {
    let doubled = "\"controller\":\"idm\",\"controller\":\"policy\"";
    for version in [1, 2] {
        let mut certificate = rate();
        certificate.version = version;
        let error = check_replaced(&certificate, "\"controller\":\"idm\"", doubled).unwrap_err();
        assert!(
            error.contains("duplicate key \"controller\" at line 1"),
            "{error}"
        );
    }
}

#[test]
fn files_that_are_not_canonical_are_refused() {
    for (from, to) in [
        ("\"version\":2,", "\"version\":2 ,\"provenance\":null,"),
        ("\"scenario\":\"by hand\"", "\"scenario\":\"by\\u0020hand\""),
        ("\"step_s\":0.1", "\"step_s\":0.10"),
        ("\"step_s\":0.1", "\"step_s\":1e-1"),
        (
            "\"position_m\":3.0",
            "\"position_m\":{\"low\":3.0,\"high\":3.0}",
        ),
        ("\"position_m\":3.0", "\"position_m\":3"),
        (",\"follower\":null", ""),
        ("\"step_s\":0.1,\"steps\":10", "\"steps\":10,\"step_s\":0.1"),
        (
            "\"max_brake_mps2\":8.0",
            "\"max_brake_mps2\":8.0,\"max_brake_mps2\":8.0",
        ),
    ] {
        assert!(check_replaced(&unavoidable(), from, to).is_err(), "{to}");
    }
    let spelled_out = check_replaced(
        &unavoidable(),
        "\"max_accel_mps2\":3.0",
        "\"max_accel_mps2\":3.00",
    )
    .unwrap_err();
    assert!(
        spelled_out.starts_with("is not in canonical form from line 1 column "),
        "{spelled_out}"
    );
}

#[test]
fn a_statement_is_bound_to_the_text_it_names() {
    let digest = unavoidable().provenance.scenario_sha256;
    for (from, to, message) in [
        (
            digest.as_str(),
            "",
            "`provenance.scenario_sha256` is not the digest",
        ),
        (
            digest.as_str(),
            sha256("another").as_str(),
            "`provenance.scenario_sha256` is not the digest",
        ),
        (
            "by hand\\\"\\n",
            "by foot\\\"\\n",
            "`provenance.scenario_sha256` is not the digest",
        ),
        (
            "\"scenario\":\"by hand\",",
            "",
            "`provenance.scenario` is missing",
        ),
        (
            "\"assumptions\":[\"exact-motion\",\"scripted-leader\"",
            "\"assumptions\":[\"scripted-leader\",\"exact-motion\"",
            "order",
        ),
    ] {
        let error = check_replaced(&unavoidable(), from, to).unwrap_err();
        assert!(
            error.contains(message) || to.is_empty() && error.contains("canonical"),
            "{to}: {error}"
        );
    }
    let mut without = unavoidable();
    without.provenance.scenario_text = None;
    assert!(
        check(&without)
            .unwrap_err()
            .to_string()
            .contains("`provenance.scenario_text` is missing")
    );
}

#[test]
fn a_registration_must_agree_with_its_provenance() {
    let entry = |key: &'static str, value: &'static str| {
        move |certificate: &mut Certificate| {
            let Statement::Rate(rate) = &mut certificate.statement else {
                panic!("a rate")
            };
            rate.registration
                .configuration
                .insert(key.to_owned(), value.to_owned());
        }
    };
    assert!(check(&rate()).is_ok());
    for (key, value) in [
        ("space", "high-risk"),
        (
            "space_sha256",
            "94021f6edd21660c49b92725543d2f26752c018da38738a837bb3667d954af09",
        ),
        ("space_sha256", ""),
        ("controller_sha256", ""),
        (
            "controller_sha256",
            "94021F6EDD21660C49B92725543D2F26752C018DA38738A837BB3667D954AF09",
        ),
        ("crumple", "9.9.9"),
        ("seed", "3.5"),
        ("seed", "03"),
        ("horizon_s", "-15"),
        ("horizon_s", "0"),
        ("horizon_s", "inf"),
        ("against", "policy"),
        ("note", "at most 0.0001"),
    ] {
        let error = check_mutated(rate(), entry(key, value));
        assert!(
            error.contains("registration.configuration."),
            "{key}: {error}"
        );
    }
    let named = check_mutated(rate(), |certificate| {
        certificate.provenance.scenario = "high-risk".to_owned()
    });
    assert!(named.contains("differs from `provenance.scenario`"));
}

#[test]
fn blocks_cover_the_runs_and_add_up() {
    for (from, to, message) in [
        ("\"failures\":3", "\"failures\":2", "do not add up"),
        ("[[1,", "[[101,", "counts more runs than it has"),
        ("[2,\"", "[51,\"", "counts more runs than it has"),
        ("\"blocks\":[[1,", "\"blocks\":[[0,", "do not add up"),
        (&sha256("1"), &sha256("1")[1..], "must have a SHA-256"),
    ] {
        let error = check_replaced(&rate(), from, to).unwrap_err();
        assert!(error.contains(message), "{to}: {error}");
    }
    let mut short = rate();
    let Statement::Rate(claim) = &mut short.statement else {
        panic!("a rate")
    };
    claim.blocks.truncate(2);
    claim.failures = 1;
    assert_eq!(
        check(&short).unwrap_err().to_string(),
        "`blocks` must cover all runs"
    );
    claim_without_blocks(&mut short);
    assert!(check(&short).is_err());
}

fn claim_without_blocks(certificate: &mut Certificate) {
    let Statement::Rate(claim) = &mut certificate.statement else {
        panic!("a rate")
    };
    claim.blocks.clear();
    claim.registration.block_runs = None;
    claim.registration_sha256 = claim.registration.digest();
}

#[test]
fn version_1_is_read_and_reported_as_old() {
    let mut old = unavoidable();
    old.version = 1;
    old.provenance = CertificateProvenance {
        crumple: "0.1.0".to_owned(),
        scenario: "paper-1".to_owned(),
        ..CertificateProvenance::default()
    };
    let mut file = serde_json::to_value(&old).unwrap();
    file["provenance"]["scenario_sha256"] = json!("");
    let read = Certificate::from_json(&file.to_string()).unwrap();
    assert!(check(&read).is_ok() && read.is_first_version());
    assert!(
        read.scope()
            .about
            .contains("as the file states; version 1 does not bind the statement to a text")
    );
    let bound: Value = serde_json::to_value(unavoidable()).unwrap();
    assert!(bound["provenance"]["scenario_text"].is_string());
}

#[test]
fn the_scope_of_a_claim_is_printed() {
    let message = unavoidable().scope().to_string();
    for words in [
        "for 1 s from the start and no longer",
        "scenario `by hand`, SHA-256 ",
        "leader: front bumper at 3 m, 0 m/s",
        "brakes at up to 8 and accelerates at up to 3 m/s²",
        "behind: no vehicle is part of the claim",
        "10 steps of 0.1 s",
    ] {
        assert!(message.contains(words), "{words}: {message}");
    }
    for (left_out, words) in [
        (0, "\nbehind: no vehicle\n"),
        (1, "\nbehind: 1 vehicle, not part of the claim\n"),
        (2, "\nbehind: 2 vehicles, not part of the claim\n"),
    ] {
        let message = unavoidable()
            .scope_with_uncovered_vehicles(left_out)
            .to_string();
        assert!(message.contains(words), "{words}: {message}");
    }
    let accepted = check(&unavoidable()).unwrap().to_string();
    assert!(accepted.ends_with("m or more within 1 s"), "{accepted}");
    let message = kernel().scope().to_string();
    assert!(message.contains("\nbehind: not considered\n"), "{message}");
    let message = rate().scope().to_string();
    for words in [
        "for 15 s from the start",
        "space `paper`, SHA-256 ",
        "idm, SHA-256 ",
        "with estimator truth",
        "250 random scenarios, seed 3; a failure is: collision",
    ] {
        assert!(message.contains(words), "{words}: {message}");
    }
    assert!(
        check(&rate())
            .unwrap()
            .to_string()
            .ends_with("if its counts are right")
    );
    assert!(
        rate()
            .caveat()
            .unwrap()
            .contains("the counts are not verified")
    );
}

fn comparison() -> Certificate {
    let mut certificate = rate();
    let Statement::Rate(RateClaim {
        mut registration, ..
    }) = certificate.statement
    else {
        panic!("a rate")
    };
    for (key, value) in [("against", "policy"), ("against_sha256", &sha256("policy"))] {
        registration
            .configuration
            .insert(key.to_owned(), value.to_owned());
    }
    certificate.statement = Statement::Comparison(ComparisonClaim {
        registration_sha256: registration.digest(),
        registration,
        only_first_failed: 3,
        only_second_failed: 60,
        blocks: vec![
            ([1, 40], sha256("0")),
            ([0, 20], sha256("1")),
            ([2, 0], sha256("2")),
        ],
    });
    certificate
}

fn kernel() -> Certificate {
    let statement = Statement::Kernel(crate::kernel::kernel("6", "6"));
    let provenance = CertificateProvenance {
        crumple: "0.1.0".to_owned(),
        ..CertificateProvenance::default()
    };
    Certificate {
        version: 2,
        provenance,
        assumptions: statement.assumptions(),
        statement,
    }
}

fn reach() -> Certificate {
    let digest = sha256("policy");
    let statement = json!({"reach": {
        "policy_file": format!("policy-{}.safetensors", &digest[..12]), "policy_sha256": digest,
        "step_s": 0.01, "steps": 500, "follower_ttc_s": 1.4, "observation_error": [1e-9, 0, 0, 0, 0, 0, 0, 0],
        "ranges": {
            "gap_ahead_m": {"low": 15, "high": 17}, "gap_behind_m": 16, "leader_speed_mps": 25,
            "ego_speed_mps": 25, "follower_speed_mps": 25, "leader_brake_mps2": 3, "follower_brake_mps2": 6,
            "onset_steps": {"low": 50, "high": 150}
        },
        "partition": ["verified"], "verified_share_at_least": 0, "falsified_share_at_least": 0, "min_gap_m_at_least": 0
    }});
    let statement: Statement = serde_json::from_value(statement).unwrap();
    let provenance = CertificateProvenance {
        box_text: Some("steps = 500".to_owned()),
        ..unavoidable().provenance
    };
    Certificate {
        version: 2,
        provenance,
        assumptions: statement.assumptions(),
        statement,
    }
}

/// A claim about a network in place of a policy.
fn network() -> Certificate {
    let mut certificate = reach();
    let Statement::Reach(claim) = &mut certificate.statement else {
        panic!("a box")
    };
    claim.policy_sha256 = sha256("network");
    claim.policy_file = format!("network-{}.safetensors", &claim.policy_sha256[..12]);
    claim.source =
        serde_json::from_value(json!({"format": "onnx", "sha256": sha256("onnx")})).unwrap();
    Certificate {
        assumptions: certificate.statement.assumptions(),
        ..certificate
    }
}

/// Checks a modified certificate, with a renewed registration digest.
fn check_mutated(mut certificate: Certificate, change: impl FnOnce(&mut Certificate)) -> String {
    change(&mut certificate);
    match &mut certificate.statement {
        Statement::Rate(claim) => claim.registration_sha256 = claim.registration.digest(),
        Statement::Comparison(claim) => claim.registration_sha256 = claim.registration.digest(),
        _ => {}
    }
    check(&certificate).map_or_else(
        |rejection| rejection.to_string(),
        |accepted| accepted.to_string(),
    )
}

#[test]
fn a_block_has_at_most_as_many_failures_as_runs() {
    let of_rate = |failures: [u64; 3]| {
        check_mutated(rate(), |certificate| {
            let Statement::Rate(claim) = &mut certificate.statement else {
                panic!("a rate")
            };
            claim
                .blocks
                .iter_mut()
                .zip(failures)
                .for_each(|(block, failures)| block.0 = failures);
            (claim.failures, claim.rate_at_most) = (failures.iter().sum(), 0.99);
        })
    };
    for failures in [[100, 0, 50], [0, 100, 50], [100, 100, 0]] {
        assert!(
            of_rate(failures).starts_with("rate: at most 0.99"),
            "{}",
            of_rate(failures)
        );
    }
    assert_eq!(
        of_rate([0, 101, 0]),
        "`blocks[1]` counts more runs than it has"
    );
    assert_eq!(
        of_rate([0, 0, 51]),
        "`blocks[2]` counts more runs than it has"
    );
    for block_runs in [None, Some(0)] {
        let message = check_mutated(rate(), |certificate| {
            let Statement::Rate(claim) = &mut certificate.statement else {
                panic!("a rate")
            };
            claim.registration.block_runs = block_runs;
        });
        assert_eq!(message, "`registration.block_runs` must be positive");
    }
    let of_two = |change: fn(&mut ComparisonClaim)| {
        check_mutated(comparison(), |certificate| {
            let Statement::Comparison(claim) = &mut certificate.statement else {
                panic!("a comparison")
            };
            change(claim);
        })
    };
    assert!(
        of_two(|_| ()).starts_with("comparison: the first controller fails less often"),
        "{}",
        of_two(|_| ())
    );
    assert!(
        of_two(|claim| (claim.blocks[1].0, claim.only_second_failed) = ([0, 100], 140))
            .starts_with("comparison")
    );
    assert_eq!(
        of_two(|claim| claim.blocks[1].0 = [1, 100]),
        "`blocks[1]` counts more runs than it has"
    );
    for change in [
        |claim: &mut ComparisonClaim| claim.blocks[0].0 = [0, 41],
        |claim: &mut ComparisonClaim| claim.only_first_failed = 2,
        |claim: &mut ComparisonClaim| claim.only_second_failed = 61,
    ] {
        assert_eq!(
            of_two(change),
            "`blocks` do not add up to the claimed counts"
        );
    }
    assert_eq!(
        of_two(|claim| drop(claim.blocks.pop())),
        "`blocks` must cover all runs"
    );
    let missing = of_two(|claim| drop(claim.registration.configuration.remove("against")));
    assert_eq!(missing, "`registration.configuration.against` is missing");
}

#[test]
fn claims_about_no_scenario_name_none() {
    let bound = |certificate: Certificate, message: &str, why: &str| {
        assert!(
            check_mutated(certificate.clone(), |_| ()).starts_with(message),
            "{}",
            check_mutated(certificate, |_| ())
        );
        type ProvenanceMutation = fn(&mut CertificateProvenance);
        let changes: [(&str, ProvenanceMutation); 4] = [
            ("scenario", |provenance| {
                provenance.scenario = "paper-1".to_owned()
            }),
            ("scenario_sha256", |provenance| {
                provenance.scenario_sha256 = sha256("")
            }),
            ("scenario_text", |provenance| {
                provenance.scenario_text = Some(String::new())
            }),
            ("box_text", |provenance| {
                provenance.box_text = Some(String::new())
            }),
        ];
        for (field, change) in changes {
            let message = check_mutated(certificate.clone(), |certificate| {
                change(&mut certificate.provenance)
            });
            assert_eq!(
                message,
                format!("`provenance.{field}` must be absent: {why}")
            );
        }
    };
    bound(
        kernel(),
        "kernel: full braking avoids",
        "a kernel does not belong to a scenario",
    );
}

#[test]
fn a_network_is_named_after_its_digest_and_where_it_is_from() {
    fn check_named(certificate: Certificate, file: Option<&str>, digest: Option<&str>) -> String {
        check_mutated(certificate, |certificate| {
            let (policy_file, policy_sha256) = match &mut certificate.statement {
                Statement::Reach(claim) => (&mut claim.policy_file, &mut claim.policy_sha256),
                _ => panic!("a statement about no network"),
            };
            *policy_file = file.map_or_else(|| policy_file.clone(), str::to_owned);
            *policy_sha256 = digest.map_or_else(|| policy_sha256.clone(), str::to_owned);
        })
    }
    for (certificate, kind, other) in [
        (reach(), "policy", "network"),
        (network(), "network", "policy"),
    ] {
        let start = &sha256(kind)[..12];
        let named = |file: Option<&str>, digest: Option<&str>| {
            check_named(certificate.clone(), file, digest)
        };
        assert_eq!(
            named(None, None),
            "the policy file is not there",
            "all else is as it should be"
        );
        let wrong = "`policy_file` is not named after `policy_sha256`";
        for file in [
            format!("{other}-{start}.safetensors"),
            format!("{kind}.safetensors"),
            String::new(),
        ] {
            assert_eq!(named(Some(&file), None), wrong, "{file}");
        }
        assert_eq!(named(None, Some(&sha256("another"))), wrong);
        assert_eq!(
            named(Some(&format!("{kind}-.safetensors")), Some("abc")),
            wrong,
            "no SHA-256"
        );
        assert_eq!(named(None, Some(start)), wrong, "not all of it");
    }
    let without = check_mutated(reach(), |certificate| {
        certificate.provenance.box_text = None
    });
    assert_eq!(without, "`provenance.box_text` is missing");
    let nameless = check_mutated(reach(), |certificate| {
        certificate.provenance.scenario = String::new()
    });
    assert_eq!(nameless, "`provenance.scenario` is missing");
}

#[test]
fn the_subject_of_a_claim_follows_from_kind_and_texts() {
    let about = |certificate: &Certificate| certificate.scope().about;
    let digest = unavoidable().provenance.scenario_sha256;
    assert_eq!(
        about(&unavoidable()),
        format!("scenario `by hand`, SHA-256 {digest}")
    );
    assert_eq!(
        about(&reach()),
        format!("a box around scenario `by hand`, SHA-256 {digest}")
    );
    assert_eq!(about(&kernel()), "any two vehicles with these limits");
    let space = sha256("name = \"paper\"\n");
    assert!(
        [rate(), comparison()]
            .iter()
            .all(|subject| about(subject) == format!("space `paper`, SHA-256 {space}"))
    );
    let old = about(&Certificate {
        version: 1,
        ..kernel()
    });
    assert_eq!(
        old,
        "``, as the file states; version 1 does not bind the statement to a text"
    );
}

#[test]
fn the_duration_of_a_claim_is_printed_in_seconds() {
    let message = |certificate: &Certificate| {
        (
            certificate.scope().horizon_s,
            certificate.scope().to_string(),
        )
    };
    let (horizon_s, text) = message(&reach());
    assert!(
        horizon_s == Some(5.0) && text.contains("for 5 s from the start and no longer"),
        "{text}"
    );
    assert!(
        text.contains("leader: 15 to 17 m ahead, 25 m/s, brakes at 3 m/s² from 0.5 to 1.5 s on"),
        "{text}"
    );
    let (horizon_s, text) = message(&kernel());
    assert!(
        horizon_s == Some(f64::INFINITY) && text.contains("for ever"),
        "{text}"
    );
    // A witness may establish safety after it.
    let Statement::Unavoidable(UnavoidableClaim { mut scene, .. }) = unavoidable().statement else {
        panic!()
    };
    scene.steps = 25;
    let avoidable = AvoidableClaim {
        scene,
        witness: Vec::new(),
        min_gap_m_at_least: None,
    };
    let (horizon_s, text) = message(&Certificate {
        statement: Statement::Avoidable(avoidable),
        ..unavoidable()
    });
    assert_eq!(horizon_s, Some(2.5));
    assert!(text.contains("for 2.5 s from the start\n"), "{text}");
}

/// A claim with a large error of one quantity covers no such error of another quantity.
#[test]
fn the_scope_states_the_error_of_each_observed_quantity() {
    let with = |change: &dyn Fn(&mut ReachClaim)| {
        let mut certificate = reach();
        let Statement::Reach(claim) = &mut certificate.statement else {
            panic!("a box")
        };
        claim.observation_error = [0.2, 0.3, 0.5, 0.4, 0.6, 1e-9, 0.0, 0.7];
        change(claim);
        certificate.scope().to_string()
    };
    let without_follower = "\nlargest observation errors: gap ahead 0.2 m, leader's speed 0.5 m/s, own speed 0.4 m/s, \
                            leader's acceleration 1e-9 m/s², own acceleration 0 m/s²";
    let follower = ", gap behind 0.3 m, follower's speed 0.6 m/s, follower's acceleration 0.7 m/s²";
    assert!(
        with(&|_| ()).ends_with(&format!("{without_follower}{follower}")),
        "{}",
        with(&|_| ())
    );
    let message = with(&|claim| claim.follower_ttc_s = None);
    assert!(message.ends_with(without_follower), "{message}");

    let claim_about = |controller: Value| {
        let claim = json!({
            "motion": "absolute", "controller": controller, "step_s": 0.01, "decision_steps": 1, "own_mps2": [-7.5, 3],
            "leader_mps2": [-7.5, 3], "observation_error": [0, 0.5, 0.25], "region_gap_m": 100,
            "region_own_mps": [0, 6], "region_leader_mps": [0, 6], "initial_own_mps_at_most": 6,
            "axes": [{"low": 0, "high": 6, "cells": 4}, {"low": 0, "high": 6, "cells": 4}], "splits": 1,
            "heights": [[25, 1]], "share_at_least": 0, "min_gap_m_at_least": 0
        });
        let statement: Statement = serde_json::from_value(json!({ "invariant": claim })).unwrap();
        Certificate {
            statement,
            ..reach()
        }
        .scope()
        .to_string()
    };
    let idm = json!({"law": {"idm": {
        "desired_speed_mps": 30, "time_headway_s": 1.5, "standstill_gap_m": 2, "accel_mps2": 0.7,
        "comfortable_brake_mps2": 1.7, "max_accel_mps2": 3
    }}});
    let errors =
        "\nlargest observation errors: gap 0 m, own speed 0.5 m/s, leader's speed 0.25 m/s";
    assert!(
        claim_about(idm.clone()).ends_with(errors),
        "{}",
        claim_about(idm)
    );
    let network = json!({"network": {"policy_file": "p.safetensors", "policy_sha256": "00"}});
    let accelerations = "; observed accelerations are any within the limits of the vehicles";
    assert!(
        claim_about(network.clone()).ends_with(&format!("{errors}{accelerations}")),
        "{}",
        claim_about(network)
    );
}

#[test]
fn statements_have_the_names_used_in_files() {
    let Statement::Unavoidable(UnavoidableClaim { scene, branches }) = unavoidable().statement
    else {
        panic!()
    };
    let avoidable = AvoidableClaim {
        scene: scene.clone(),
        witness: Vec::new(),
        min_gap_m_at_least: None,
    };
    let gap_bound = GapBoundClaim {
        scene: scene.clone(),
        gap_m: 1.0,
        branches,
    };
    let of_scenes = [
        Statement::Avoidable(avoidable),
        unavoidable().statement,
        Statement::GapBound(gap_bound),
    ];
    let of_none = [kernel(), rate(), comparison(), reach(), network()]
        .map(|certificate| certificate.statement);
    for statement in of_scenes.iter().chain(&of_none) {
        let file = serde_json::to_value(statement).unwrap();
        let names: Vec<&String> = file.as_object().unwrap().keys().collect();
        assert_eq!(names, [statement.name()]);
    }
    assert!(
        of_scenes
            .iter()
            .all(|statement| statement.scene() == Some(&scene))
    );
    assert!(of_none.iter().all(|statement| statement.scene().is_none()));
}

#[test]
fn the_policy_is_read_from_the_folder_of_its_certificate() {
    let network = network();
    let digest = sha256("network");
    let name = format!("network-{}.safetensors", &digest[..12]);
    assert_eq!(
        network.policy_reference(),
        Some((name.as_str(), digest.as_str()))
    );
    let digest = sha256("policy");
    assert_eq!(
        reach().policy_reference(),
        Some((
            format!("policy-{}.safetensors", &digest[..12]).as_str(),
            digest.as_str()
        ))
    );
    assert_eq!(
        (
            kernel().policy_reference(),
            unavoidable().policy_reference(),
            rate().policy_reference()
        ),
        (None, None, None)
    );
    let folder = std::env::temp_dir().join(format!("crumple-verify-beside-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (path, other) = (folder.join("certificate.json"), folder.join("other"));
    std::fs::write(folder.join(&name), b"a network").unwrap();
    std::fs::write(&other, b"another one").unwrap();
    assert_eq!(
        network.read_policy(&path, None).as_deref(),
        Some(&b"a network"[..])
    );
    assert_eq!(
        network.read_policy(&path, Some(&other)).as_deref(),
        Some(&b"another one"[..])
    );
    assert_eq!(reach().read_policy(&path, None), None, "there is none");
    assert_eq!(
        kernel().read_policy(&path, Some(&other)),
        None,
        "it needs none"
    );
    let mut astray = network.clone();
    let Statement::Reach(claim) = &mut astray.statement else {
        panic!()
    };
    claim.policy_file = format!("/nowhere/{name}");
    assert_eq!(
        astray.read_policy(&path, None).as_deref(),
        Some(&b"a network"[..])
    );
    std::fs::remove_dir_all(folder).unwrap();
}
