//! Certificates with one change. Needs only `serde_json`, so that other tests can include this file.

use serde_json::{Value, json};

type Mutation<'a> = Box<dyn Fn(&mut Value) + 'a>;

/// Returns a description and a certificate for every change of a number, an entry or a pair of neighbours.
pub fn mutants(original: &Value) -> impl Iterator<Item = (String, Value)> + '_ {
    json_pointers(original)
        .into_iter()
        .flat_map(move |pointer| {
            let value = original.pointer(&pointer).unwrap_or(&Value::Null);
            let mut changes: Vec<(String, Mutation<'_>)> = Vec::new();
            match value {
                Value::Number(number) => {
                    let x = number.as_f64().unwrap_or(0.0);
                    for (what, changed) in [
                        ("negated", -x),
                        ("slightly more", x * (1.0 + 1e-3)),
                        ("slightly less", x * (1.0 - 1e-3)),
                        ("plus 1", x + 1.0),
                        ("minus 1", x - 1.0),
                        ("doubled", x * 2.0),
                        ("zero", 0.0),
                        ("huge", 1e300),
                    ] {
                        let changed = if number.is_u64()
                            && changed >= 0.0
                            && changed.fract() == 0.0
                            && changed < 1e9
                        {
                            json!(changed as u64)
                        } else {
                            json!(changed)
                        };
                        if changed != *value {
                            changes.push((
                                what.to_owned(),
                                Box::new(move |value| *value = changed.clone()),
                            ));
                        }
                    }
                }
                Value::Array(list) => {
                    for i in 0..list.len() {
                        changes.push((
                            format!("without entry {i}"),
                            Box::new(move |value| drop(array(value).remove(i))),
                        ));
                        let doubled = move |value: &mut Value| {
                            let entry = array(value)[i].clone();
                            array(value).insert(i, entry);
                        };
                        changes.push((format!("with entry {i} twice"), Box::new(doubled)));
                        if i > 0 && list[i - 1] != list[i] {
                            let swap = move |value: &mut Value| array(value).swap(i - 1, i);
                            changes.push((
                                format!("with entry {i} before its predecessor"),
                                Box::new(swap),
                            ));
                        }
                    }
                }
                Value::Object(fields) => {
                    for name in fields.keys() {
                        let remove = move |value: &mut Value| {
                            drop(value.as_object_mut().map(|fields| fields.remove(name)))
                        };
                        changes.push(("without a field".to_owned(), Box::new(remove)));
                    }
                    if let (Some(low), Some(high)) =
                        (fields.get("low").cloned(), fields.get("high").cloned())
                    {
                        let swap =
                            move |value: &mut Value| *value = json!({"low": high, "high": low});
                        changes.push(("turned around".to_owned(), Box::new(swap)));
                    }
                }
                _ => {}
            }
            changes.into_iter().map(move |(what, change)| {
                let mut mutant = original.clone();
                if let Some(value) = mutant.pointer_mut(&pointer) {
                    change(value);
                }
                (format!("{pointer} {what}"), mutant)
            })
        })
}

pub fn json_pointers(value: &Value) -> Vec<String> {
    let mut places = Vec::new();
    collect_pointers(value, String::new(), &mut places);
    places
}

fn array(value: &mut Value) -> &mut Vec<Value> {
    value.as_array_mut().expect("an array")
}

fn collect_pointers(value: &Value, pointer: String, places: &mut Vec<String>) {
    match value {
        Value::Array(list) => {
            list.iter()
                .enumerate()
                .for_each(|(i, entry)| collect_pointers(entry, format!("{pointer}/{i}"), places));
        }
        Value::Object(fields) => {
            fields.iter().for_each(|(name, field)| {
                collect_pointers(field, format!("{pointer}/{name}"), places)
            });
        }
        _ => {}
    }
    places.push(pointer);
}
