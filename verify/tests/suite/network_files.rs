//! The files of networks from outside: what is read back, what is refused, and what a statement about one has to say.

use crumple_verify::reach::{Actor, Cell, Format, Ranges, Reach, Source, file_name};
use crumple_verify::{Accepted, Assumption, Certificate, Interval, Provenance, Rejection, Statement, check_with};
use sha2::{Digest, Sha256};

use crate::support::networks::any_with_file;

#[test]
fn what_is_written_is_read() {
    for seed in 0..500 {
        let (actor, file) = any_with_file(seed);
        assert_eq!(Actor::from_bytes(&file), Ok(actor), "{seed}");
    }
}

/// The same file with another text.
fn with_text(file: &[u8], change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let length = u64::from_le_bytes(*file.first_chunk().unwrap()) as usize;
    let mut header: serde_json::Value = serde_json::from_slice(&file[8..8 + length]).unwrap();
    let text = header["__metadata__"]["crumple_network"].as_str().unwrap();
    let mut text: serde_json::Value = serde_json::from_str(text).unwrap();
    change(&mut text);
    header["__metadata__"]["crumple_network"] = text.to_string().into();
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &file[8 + length..]].concat()
}

#[test]
fn what_makes_no_sense_is_refused() {
    use serde_json::{Value, json};
    let (_, file) = any_with_file(1);
    assert!(Actor::from_bytes(&with_text(&file, |_| ())).is_ok());
    type Change = fn(&mut Value);
    let changes: [(&str, Change); 14] = [
        ("version 2 is not known", |text| text["version"] = json!(2)),
        ("unknown field `note`", |text| text["note"] = json!("")),
        ("missing field `empty_gap_m`", |text| drop(text.as_object_mut().unwrap().remove("empty_gap_m"))),
        ("unknown variant `matlab`", |text| text["source"]["format"] = json!("matlab")),
        ("is no SHA-256", |text| text["source"]["sha256"] = json!("abc")),
        ("unknown variant `time_gap_ahead_s`", |text| text["inputs"][0]["quantity"] = json!("time_gap_ahead_s")),
        ("inputs[0]: has numbers that make no sense", |text| text["inputs"][0]["scale"] = json!(0.0)),
        ("inputs[0]: has numbers that make no sense", |text| text["inputs"][0]["low"] = json!(1e7)),
        ("inputs[0]: must be a quantity or a constant", |text| {
            text["inputs"][0] = json!({ "offset": 0.0, "scale": 1.0, "low": 0.0, "high": 1.0 });
        }),
        ("unknown variant `cosine`", |text| text["steps"][0] = json!("cosine")),
        ("is not what it should be", |text| text["steps"][0] = json!({ "linear": 4000 })),
        ("there is no answer 4000", |text| text["output"]["answer"] = json!(4000)),
        ("not finite and in order", |text| text["output"]["low_mps2"] = json!(5.0)),
        ("must be positive", |text| text["decision_interval_s"] = json!(0.0)),
    ];
    for (said, change) in changes {
        let error = Actor::from_bytes(&with_text(&file, change)).unwrap_err();
        assert!(error.contains(said), "{said}: {error}");
    }
    // A product less: its tensors are left over.
    let fewer = with_text(&file, |text| drop(text["steps"].as_array_mut().unwrap().remove(0)));
    assert!(Actor::from_bytes(&fewer).is_err());
}

fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Nothing happens: the leader is far away and does not brake.
fn claim(file: &[u8]) -> Reach {
    let at = Interval::point;
    Reach {
        policy_file: file_name(&digest(file), true),
        policy_sha256: digest(file),
        source: Some(Source { format: Format::Onnx, sha256: "0".repeat(64) }),
        step_s: 0.01,
        steps: 100,
        follower_ttc_s: None,
        follower_law: None,
        leader_brakes_at_most_mps2: None,
        observation_error: [1e-9; 8],
        ranges: Ranges {
            gap_ahead_m: at(100.0),
            gap_behind_m: at(0.0),
            leader_speed_mps: at(20.0),
            ego_speed_mps: at(20.0),
            follower_speed_mps: at(0.0),
            leader_brake_mps2: at(0.0),
            follower_brake_mps2: at(0.0),
            onset_steps: at(0.0),
        },
        partition: vec![Cell::Verified],
        verified_share_at_least: 1.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 50.0,
    }
}

fn certificate(claim: Reach) -> Certificate {
    let statement = Statement::Reach(claim);
    Certificate { version: 1, provenance: Provenance::default(), assumptions: statement.assumptions(), statement }
}

#[test]
fn a_statement_about_a_network_names_its_source_and_says_what_it_assumes() {
    let (_, file) = any_with_file(3);
    let genuine = certificate(claim(&file));
    let accepted = check_with(&genuine, Some(&file));
    assert!(matches!(accepted, Ok(Accepted::Reach { .. })), "{accepted:?}");
    assert!(genuine.assumptions.contains(&Assumption::NetworkAsRead));
    assert!(genuine.scope().to_string().contains("read from a file in the format ONNX"));
    let mut silent = genuine.clone();
    silent.assumptions.retain(|assumption| *assumption != Assumption::NetworkAsRead);
    assert!(matches!(check_with(&silent, Some(&file)), Err(Rejection::Assumptions { .. })));
    // As one of crumple's own, or of another file.
    let mut sources = [None, Some(Source { format: Format::StableBaselines, sha256: "0".repeat(64) })].to_vec();
    sources.push(Some(Source { format: Format::Onnx, sha256: "1".repeat(64) }));
    for source in sources {
        let other = certificate(Reach { source, ..claim(&file) });
        let refused = check_with(&other, Some(&file));
        assert!(matches!(refused, Err(Rejection::Policy { .. })), "{refused:?}");
    }
    // Any byte of it.
    for place in (0..file.len()).step_by(7) {
        let mut changed = file.clone();
        changed[place] ^= 1;
        assert!(matches!(check_with(&genuine, Some(&changed)), Err(Rejection::Policy { .. })));
    }
}
