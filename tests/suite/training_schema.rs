//! Training configurations: the schema matches the types.

use std::path::Path;

use crumple_learn::retrain::training_preset;
use crumple_learn::rl::{PRESETS, TrainingConfig, json_schema};

use crate::schema::{assert_committed, validate};

#[test]
fn the_page_about_trainings_names_every_field() {
    fn names_in<'v>(value: &'v serde_json::Value, names: &mut Vec<&'v str>) {
        match value {
            serde_json::Value::Object(all) => {
                let fields = all.get("properties").and_then(|fields| fields.as_object());
                fields
                    .into_iter()
                    .for_each(|fields| names.extend(fields.keys().map(String::as_str)));
                all.values().for_each(|value| names_in(value, names));
            }
            serde_json::Value::Array(all) => all.iter().for_each(|value| names_in(value, names)),
            _ => {}
        }
    }
    let (schema, page) = (json_schema(), include_str!("../../docs/training.md"));
    let mut names = Vec::new();
    names_in(&schema, &mut names);
    assert!(names.len() > 60, "{names:?}");
    let is_named = |name: &str| {
        page.contains(&format!("`{name}`"))
            || page.contains(&format!("{name} = "))
            || page.contains(&format!("{name}]"))
    };
    let missing: Vec<_> = names.into_iter().filter(|name| !is_named(name)).collect();
    assert_eq!(missing, [""; 0]);
}

/// `UPDATE_SCHEMA=1 cargo test --test suite schema` updates the committed schema.
#[test]
fn the_committed_training_schema_accepts_the_presets_and_refuses_nonsense() {
    let schema = json_schema();
    assert_committed("crates/learn/src/rl/training.schema.json", &schema);
    let presets = PRESETS
        .iter()
        .map(|(name, _)| TrainingConfig::preset(name).unwrap())
        .chain([training_preset().unwrap()]);
    for preset in presets {
        let value = serde_json::to_value(&preset).unwrap();
        validate(&schema, &schema, &value, "training").unwrap();
        let parsed = |text: &toml::Table| {
            TrainingConfig::parse(&toml::to_string(text).unwrap(), Path::new("preset"))
        };
        let table: toml::Table = toml::to_string(&preset).unwrap().parse().unwrap();
        assert_eq!(
            parsed(&table).unwrap(),
            preset,
            "a preset survives being written"
        );
        let mut without_history = serde_json::to_value(&preset.environment.observation).unwrap();
        without_history["history"] = serde_json::json!(1);
        without_history["history_every"] = serde_json::json!(5);
        for (place, nonsense) in [
            ("/version", serde_json::json!("one")),
            ("/name", serde_json::json!("")),
            ("/learning/smoothness_penalty", serde_json::json!(1e-9)),
            ("/learning/saturation_penalty", serde_json::json!(1e-50)),
            ("/environment/observation", without_history),
            ("/environment/estimator", serde_json::json!("eyes")),
            (
                "/environment/costs",
                serde_json::json!({ "smoothness": 1.0 }),
            ),
            (
                "/environment/observation",
                serde_json::json!({ "limit": 4.0 }),
            ),
            ("/spaces", serde_json::json!([{ "space": "traffic" }])),
        ] {
            let mut changed = value.clone();
            let (parent, name) = place.rsplit_once('/').unwrap();
            changed
                .pointer_mut(parent)
                .unwrap()
                .as_object_mut()
                .unwrap()
                .insert(name.to_owned(), nonsense);
            assert!(
                validate(&schema, &schema, &changed, "training").is_err(),
                "{}{place}",
                preset.name
            );
            let text = toml::to_string(&changed).unwrap();
            assert!(
                TrainingConfig::parse(&text, Path::new("preset")).is_err(),
                "{}{place}",
                preset.name
            );
        }
    }
}
