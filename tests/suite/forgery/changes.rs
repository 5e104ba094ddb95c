//! Forged certificates: genuine ones with a change that a forger would make; in half of the cases all hashes, digests,
//! sums and the canonical form are repaired.

use crumple_core::digest::sha256;
use crumple_verify::Certificate;
use crumple_verify::certificate::FIRST_VERSION;
use rand::RngExt;
use rand::rngs::Xoshiro256PlusPlus;
use rand::seq::IndexedRandom;
use serde_json::{Value, json};

use super::{ForgedCertificate, GenuineCertificate};

impl GenuineCertificate {
    /// Forges the certificate at random, in any place of its file; `others` supplies parts.
    pub(super) fn forge(
        &self,
        others: &[GenuineCertificate],
        random: &mut Xoshiro256PlusPlus,
    ) -> ForgedCertificate {
        let mut value = serde_json::to_value(&self.certificate).unwrap_or_default();
        let mut policy = self.policy.clone();
        let places = json_pointers(&value);
        let pointer = places.choose(random).cloned().unwrap_or_default();
        let (mut text, mut keeps_order) = (None, true);
        let mut change = match random.random_range(0..12_u32) {
            0..4 => change_number(&mut value, &places, random),
            4 => change_list(&mut value, &places, random),
            5 => {
                let (parent, name) = pointer.rsplit_once('/').unwrap_or(("", ""));
                if let Some(fields) = value.pointer_mut(parent).and_then(Value::as_object_mut) {
                    fields.remove(name);
                }
                format!("without {pointer}")
            }
            6 => {
                // The genuine value stays the last, or the first, of two.
                let canonical = self.certificate.to_canonical_json();
                let names: Vec<usize> = canonical.match_indices("\":").map(|(at, _)| at).collect();
                let at = names.choose(random).copied().unwrap_or_default();
                let name = canonical
                    .get(..at)
                    .and_then(|before| before.rsplit('"').next())
                    .unwrap_or_default()
                    .to_owned();
                let forged_value = ["0", "1e-9", "\"policy\"", "null", "[]"]
                    .choose(random)
                    .copied()
                    .unwrap_or("0");
                let start = at.saturating_sub(name.len() + 1);
                let (before, after) = canonical.split_at(start);
                text = Some(format!("{before}\"{name}\":{forged_value},{after}"));
                format!("a second `{name}`")
            }
            7 => {
                let other = others
                    .choose(random)
                    .and_then(|other| serde_json::to_value(&other.certificate).ok());
                let lent = other.and_then(|other| other.pointer(&pointer).cloned());
                match (value.pointer_mut(&pointer), lent) {
                    (Some(here), Some(lent)) => *here = lent,
                    _ => value["provenance"] = Value::Null,
                }
                format!("{pointer} of another certificate")
            }
            8 => change_text(&mut value, &places, random),
            9 => {
                value["version"] = json!(FIRST_VERSION);
                if let Some(provenance) = value["provenance"].as_object_mut() {
                    provenance.retain(|name, _| !name.ends_with("_text"));
                }
                keeps_order = random.random();
                format!(
                    "version 1, and {}",
                    change_number(&mut value, &places, random)
                )
            }
            10 => change_policy(&mut value, &mut policy, others, random),
            _ => {
                let added = [
                    "noise-of-seed",
                    "registered-draws",
                    "ego-can-brake",
                    "scripted-leader",
                    "leader-within-limit",
                ]
                .choose(random)
                .copied()
                .unwrap_or_default();
                if let Some(list) = value["assumptions"].as_array_mut() {
                    match random.random_range(0..4_u32) {
                        0 => drop(list.pop()),
                        3 if !list.is_empty() => {
                            let at = random.random_range(0..list.len());
                            list[at] = json!(added);
                        }
                        1 => list.reverse(),
                        _ => list.push(json!(added)),
                    }
                }
                "other assumptions".to_owned()
            }
        };
        if text.is_none() && random.random() {
            repair_hashes(&mut value);
            change += ", mended";
        }
        // Keep the order of the types, or the checker rejects the order alone.
        let ordered = serde_json::from_value::<Certificate>(value.clone())
            .ok()
            .filter(|_| keeps_order);
        let text = text.unwrap_or_else(|| {
            ordered.map_or_else(
                || value.to_string(),
                |certificate| certificate.to_canonical_json(),
            )
        });
        ForgedCertificate {
            change,
            text,
            policy,
        }
    }
}

fn change_number(value: &mut Value, places: &[String], random: &mut Xoshiro256PlusPlus) -> String {
    let numbers: Vec<&String> = places
        .iter()
        .filter(|pointer| value.pointer(pointer).is_some_and(Value::is_number))
        .collect();
    let Some(place) = numbers.choose(random) else {
        return "nothing".to_owned();
    };
    let Some(number) = value.pointer_mut(place) else {
        return "nothing".to_owned();
    };
    let x = number.as_f64().unwrap_or_default();
    let share = random.random::<f64>() * 0.2;
    let changed = match random.random_range(0..9_u32) {
        0 => -x,
        1 => x * (1.0 + share),
        2 => x * (1.0 - share),
        3 => x + 1.0,
        4 => x - 1.0,
        5 => 0.0,
        6 => x.next_up(),
        7 => x.next_down(),
        _ => {
            x * [0.5, 2.0, 10.0, 1e300]
                .choose(random)
                .copied()
                .unwrap_or(2.0)
        }
    };
    *number = if number.is_u64() {
        json!(changed.clamp(0.0, 1e15).round() as u64)
    } else {
        json!(changed)
    };
    format!("{place} is {number}")
}

fn change_list(value: &mut Value, places: &[String], random: &mut Xoshiro256PlusPlus) -> String {
    let is_list = |place: &&String| {
        value
            .pointer(place)
            .and_then(Value::as_array)
            .is_some_and(|list| !list.is_empty())
    };
    let lists: Vec<String> = places.iter().filter(is_list).cloned().collect();
    let Some(place) = lists.choose(random) else {
        return "nothing".to_owned();
    };
    let Some(list) = value.pointer_mut(place).and_then(Value::as_array_mut) else {
        return "nothing".to_owned();
    };
    let (at, with) = (
        random.random_range(0..list.len()),
        random.random_range(0..list.len()),
    );
    match random.random_range(0..3_u32) {
        0 => drop(list.remove(at)),
        1 => list.insert(at, list[at].clone()),
        _ => list.swap(at, with),
    }
    format!("{place} without, with twice, or with another order of entry {at}")
}

fn change_text(value: &mut Value, places: &[String], random: &mut Xoshiro256PlusPlus) -> String {
    let texts: Vec<&String> = places
        .iter()
        .filter(|pointer| value.pointer(pointer).is_some_and(Value::is_string))
        .collect();
    let Some(place) = texts.choose(random) else {
        return "nothing".to_owned();
    };
    let Some(Value::String(text)) = value.pointer_mut(place) else {
        return "nothing".to_owned();
    };
    let words = [
        "",
        "paper-1",
        "paper-2",
        "paper",
        "policy",
        "baseline",
        "0.9.9",
        "truth",
        "99",
        &"0".repeat(64),
    ];
    let digits: Vec<usize> = text
        .bytes()
        .enumerate()
        .filter(|(_, byte)| byte.is_ascii_digit())
        .map(|(at, _)| at)
        .collect();
    match digits.choose(random) {
        Some(&at) if random.random() => {
            text.replace_range(at..=at, &random.random_range(0..10_u32).to_string())
        }
        _ => *text = words.choose(random).copied().unwrap_or_default().to_owned(),
    }
    format!(
        "{place} is {}",
        text.chars().take(70).collect::<String>().escape_debug()
    )
}

/// Replaces the policy, a bit of it, or its header; the certificate follows, or does not.
fn change_policy(
    value: &mut Value,
    policy: &mut Option<Vec<u8>>,
    others: &[GenuineCertificate],
    random: &mut Xoshiro256PlusPlus,
) -> String {
    let Some(bytes) = policy else {
        return change_text(value, &json_pointers(value), random);
    };
    let header = u64::from_le_bytes(bytes.first_chunk().copied().unwrap_or_default()) as usize;
    let what = match random.random_range(0..4_u32) {
        0 => {
            let lent = others
                .iter()
                .filter_map(|other| other.policy.as_ref())
                .find(|other| *other != bytes);
            *bytes = lent.cloned().unwrap_or_default();
            "another policy"
        }
        1 => {
            let at = random.random_range(0..bytes.len());
            bytes[at] ^= 1 << random.random_range(0..8_u32);
            "a bit of the policy"
        }
        2 => {
            let at = random.random_range(8..8 + header.clamp(1, bytes.len().saturating_sub(9)));
            bytes[at] = *b"0123456789,:{}[]\" -e".choose(random).unwrap_or(&b'0');
            "the header of the policy"
        }
        _ => {
            bytes.extend_from_slice(&[0; 4]);
            "a longer policy"
        }
    };
    if random.random() {
        return what.to_owned();
    }
    let digest = sha256(&*bytes);
    value["statement"]["reach"]["policy_file"] = json!(format!(
        "policy-{}.safetensors",
        digest.get(..12).unwrap_or_default()
    ));
    value["statement"]["reach"]["policy_sha256"] = json!(digest);
    format!("{what}, with its digest")
}

fn repair_hashes(value: &mut Value) {
    if let Some(text) = value
        .pointer("/provenance/scenario_text")
        .and_then(Value::as_str)
    {
        value["provenance"]["scenario_sha256"] = json!(sha256(text));
    }
    let provenance = value["provenance"].clone();
    let Some(claim) = value["statement"]
        .as_object_mut()
        .and_then(|statement| statement.values_mut().next())
    else {
        return;
    };
    if claim.pointer("/registration/configuration").is_none() {
        return;
    }
    for (entry, field) in [
        ("space", "scenario"),
        ("space_sha256", "scenario_sha256"),
        ("crumple", "crumple"),
    ] {
        claim["registration"]["configuration"][entry] = provenance[field].clone();
    }
    if let Ok(registration) =
        serde_json::from_value::<crumple_verify::Registration>(claim["registration"].clone())
    {
        claim["registration_sha256"] = json!(registration.digest());
    }
    if let (Some(failures), Some(Some(first))) = (
        claim["failures"].as_u64(),
        claim["blocks"]
            .as_array_mut()
            .map(|blocks| blocks.first_mut()),
    ) {
        first[0] = json!(failures);
    }
}

fn json_pointers(value: &Value) -> Vec<String> {
    let mut places = Vec::new();
    let mut pending = vec![(String::new(), value)];
    while let Some((place, value)) = pending.pop() {
        match value {
            Value::Array(list) => pending.extend(
                list.iter()
                    .enumerate()
                    .map(|(i, entry)| (format!("{place}/{i}"), entry)),
            ),
            Value::Object(fields) => pending.extend(
                fields
                    .iter()
                    .map(|(name, field)| (format!("{place}/{name}"), field)),
            ),
            _ => {}
        }
        places.push(place);
    }
    places
}
