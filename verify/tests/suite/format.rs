//! Version 2 of the file: one text for one statement, and what a statement is bound to. `docs/certificates.md` specifies it.

use std::collections::BTreeMap;

use crumple_verify::*;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

fn sha256(text: &str) -> String {
    Sha256::digest(text).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A car 1 m behind a standing vehicle, as in the documentation, bound to a text.
fn unavoidable() -> Certificate {
    let text = "name = \"by hand\"\n";
    let scene = json!({
        "step_s": 0.1, "steps": 10,
        "leader": {"position_m": 3, "length_m": 2, "speed_mps": 0, "acceleration_mps2": [[10, 0]]},
        "egos": [{"position_m": 0, "length_m": 2, "speed_mps": 20, "max_brake_mps2": 8, "max_accel_mps2": 3}],
        "follower": null
    });
    let statement = json!({"unavoidable": {"scene": scene, "branches": [{"first": 0, "last": 10, "front": [[1, 1]]}]}});
    let provenance = Provenance {
        crumple: "0.1.0".to_owned(),
        scenario: "by hand".to_owned(),
        scenario_sha256: sha256(text),
        scenario_text: Some(text.to_owned()),
        box_text: None,
    };
    let statement: Statement = serde_json::from_value(statement).unwrap();
    Certificate { version: 2, provenance, assumptions: statement.assumptions(), statement }
}

/// 250 runs in blocks of 100.
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
    let configuration: BTreeMap<_, _> = entries.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    let registration = Registration { configuration, runs: 250, confidence: 0.99, block_runs: Some(100) };
    let statement = Statement::Rate(Rate {
        registration_sha256: registration.digest(),
        registration,
        failures: 3,
        rate_at_most: 0.05,
        blocks: vec![(1, sha256("0")), (0, sha256("1")), (2, sha256("2"))],
    });
    let provenance = Provenance {
        crumple: "0.1.0".to_owned(),
        scenario: "paper".to_owned(),
        scenario_sha256: sha256(text),
        scenario_text: Some(text.to_owned()),
        box_text: None,
    };
    Certificate { version: 2, provenance, assumptions: statement.assumptions(), statement }
}

/// The text with one passage changed, read and checked.
fn judged(certificate: &Certificate, from: &str, to: &str) -> Result<Accepted, String> {
    let text = certificate.canonical();
    assert!(text.contains(from), "{from} in {text}");
    let read = Certificate::from_json(&text.replacen(from, to, 1)).map_err(|error| error.to_string())?;
    check(&read).map_err(|rejection| rejection.to_string())
}

#[test]
fn what_is_written_is_canonical_with_any_whitespace() {
    for certificate in [unavoidable(), rate()] {
        check(&certificate).unwrap();
        let pretty = serde_json::to_string_pretty(&certificate).unwrap();
        for text in [certificate.canonical(), pretty] {
            let read = Certificate::from_json(&text).unwrap();
            assert_eq!((&read, read.digest()), (&certificate, sha256(&certificate.canonical())));
        }
    }
}

#[test]
fn a_key_of_a_configuration_may_not_occur_twice() {
    let twice = "\"controller\":\"idm\",\"controller\":\"policy\"";
    for version in [1, 2] {
        let mut certificate = rate();
        certificate.version = version;
        let error = judged(&certificate, "\"controller\":\"idm\"", twice).unwrap_err();
        assert!(error.contains("duplicate key \"controller\" at line 1"), "{error}");
    }
}

#[test]
fn the_same_in_other_words_is_refused() {
    for (from, to) in [
        ("\"version\":2,", "\"version\":2 ,\"provenance\":null,"),
        ("\"scenario\":\"by hand\"", "\"scenario\":\"by\\u0020hand\""),
        ("\"step_s\":0.1", "\"step_s\":0.10"),
        ("\"step_s\":0.1", "\"step_s\":1e-1"),
        ("\"position_m\":3.0", "\"position_m\":{\"low\":3.0,\"high\":3.0}"),
        ("\"position_m\":3.0", "\"position_m\":3"),
        (",\"follower\":null", ""),
        ("\"step_s\":0.1,\"steps\":10", "\"steps\":10,\"step_s\":0.1"),
        ("\"max_brake_mps2\":8.0", "\"max_brake_mps2\":8.0,\"max_brake_mps2\":8.0"),
    ] {
        assert!(judged(&unavoidable(), from, to).is_err(), "{to}");
    }
    let spelled_out = judged(&unavoidable(), "\"max_accel_mps2\":3.0", "\"max_accel_mps2\":3.00").unwrap_err();
    assert!(spelled_out.starts_with("is not in canonical form from line 1 column "), "{spelled_out}");
}

#[test]
fn a_statement_is_bound_to_the_text_it_names() {
    let digest = unavoidable().provenance.scenario_sha256;
    for (from, to, said) in [
        (digest.as_str(), "", "`provenance.scenario_sha256` is not the digest"),
        (digest.as_str(), sha256("another").as_str(), "`provenance.scenario_sha256` is not the digest"),
        ("by hand\\\"\\n", "by foot\\\"\\n", "`provenance.scenario_sha256` is not the digest"),
        ("\"scenario\":\"by hand\",", "", "`provenance.scenario` is missing"),
        (
            "\"assumptions\":[\"exact-motion\",\"scripted-leader\"",
            "\"assumptions\":[\"scripted-leader\",\"exact-motion\"",
            "order",
        ),
    ] {
        let error = judged(&unavoidable(), from, to).unwrap_err();
        assert!(error.contains(said) || to.is_empty() && error.contains("canonical"), "{to}: {error}");
    }
    let mut without = unavoidable();
    without.provenance.scenario_text = None;
    assert!(check(&without).unwrap_err().to_string().contains("`provenance.scenario_text` is missing"));
}

#[test]
fn a_registration_and_its_provenance_say_the_same() {
    let mutate = |change: &dyn Fn(&mut Certificate)| {
        let mut certificate = rate();
        change(&mut certificate);
        if let Statement::Rate(rate) = &mut certificate.statement {
            rate.registration_sha256 = rate.registration.digest();
        }
        check(&certificate).map_err(|rejection| rejection.to_string())
    };
    let entry = |key: &'static str, value: &'static str| {
        move |certificate: &mut Certificate| {
            let Statement::Rate(rate) = &mut certificate.statement else { panic!("a rate") };
            rate.registration.configuration.insert(key.to_owned(), value.to_owned());
        }
    };
    assert!(mutate(&|_| ()).is_ok());
    for (key, value) in [
        ("space", "high-risk"),
        ("space_sha256", "94021f6edd21660c49b92725543d2f26752c018da38738a837bb3667d954af09"),
        ("space_sha256", ""),
        ("controller_sha256", ""),
        ("controller_sha256", "94021F6EDD21660C49B92725543D2F26752C018DA38738A837BB3667D954AF09"),
        ("crumple", "9.9.9"),
        ("seed", "3.5"),
        ("seed", "03"),
        ("horizon_s", "-15"),
        ("against", "policy"),
        ("note", "at most 0.0001"),
    ] {
        let error = mutate(&entry(key, value)).unwrap_err();
        assert!(error.contains("registration.configuration."), "{key}: {error}");
    }
    let named = mutate(&|certificate| certificate.provenance.scenario = "high-risk".to_owned());
    assert!(named.unwrap_err().contains("is not `provenance.scenario`"));
}

#[test]
fn blocks_cover_the_runs_and_add_up() {
    for (from, to, said) in [
        ("\"failures\":3", "\"failures\":2", "do not add up"),
        ("[[1,", "[[101,", "counts more runs than it has"),
        ("[2,\"", "[51,\"", "counts more runs than it has"),
        ("\"blocks\":[[1,", "\"blocks\":[[0,", "do not add up"),
        (&sha256("1"), &sha256("1")[1..], "has no SHA-256"),
    ] {
        let error = judged(&rate(), from, to).unwrap_err();
        assert!(error.contains(said), "{to}: {error}");
    }
    let mut short = rate();
    let Statement::Rate(claim) = &mut short.statement else { panic!("a rate") };
    claim.blocks.truncate(2);
    claim.failures = 1;
    assert_eq!(check(&short).unwrap_err().to_string(), "`blocks` must cover all runs");
    claim_without_blocks(&mut short);
    assert!(check(&short).is_err());
}

fn claim_without_blocks(certificate: &mut Certificate) {
    let Statement::Rate(claim) = &mut certificate.statement else { panic!("a rate") };
    claim.blocks.clear();
    claim.registration.block_runs = None;
    claim.registration_sha256 = claim.registration.digest();
}

#[test]
fn version_1_is_read_and_said_to_be_old() {
    let mut old = unavoidable();
    old.version = 1;
    old.provenance =
        Provenance { crumple: "0.1.0".to_owned(), scenario: "paper-1".to_owned(), ..Provenance::default() };
    let mut file = serde_json::to_value(&old).unwrap();
    file["provenance"]["scenario_sha256"] = json!("");
    let read = Certificate::from_json(&file.to_string()).unwrap();
    assert!(check(&read).is_ok() && read.is_old());
    assert!(read.scope().about.contains("by its own word: version 1 binds a statement to nothing"));
    let bound: Value = serde_json::to_value(unavoidable()).unwrap();
    assert!(bound["provenance"]["scenario_text"].is_string());
}

#[test]
fn how_far_a_claim_reaches_is_said() {
    let said = unavoidable().scope().to_string();
    for words in [
        "for 1 s from the start and no longer",
        "scenario `by hand`, SHA-256 ",
        "leader: front bumper at 3 m, 0 m/s",
        "brakes at up to 8 and accelerates at up to 3 m/s²",
        "behind: nobody",
        "10 steps of 0.1 s",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let accepted = check(&unavoidable()).unwrap().to_string();
    assert!(accepted.ends_with("m or more within 1 s"), "{accepted}");
    let said = rate().scope().to_string();
    for words in [
        "for 15 s from the start",
        "space `paper`, SHA-256 ",
        "idm, SHA-256 ",
        "seeing through truth",
        "250 runs drawn with seed 3; a failure is: vehicles touch",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(check(&rate()).unwrap().to_string().ends_with("if its counts are right"));
    assert!(rate().caveat().unwrap().contains("the maker's word"));
}
