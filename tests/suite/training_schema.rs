//! Training configurations: the schema tells the truth.

use std::path::Path;

use crumple_learn::retrain::training_preset;
use crumple_learn::rl::{PRESETS, TrainingConfig, json_schema};

use crate::schema::{assert_committed, validate};

/// The committed schema is that of the types. `UPDATE_SCHEMA=1 cargo test --test suite schema` writes it anew.
#[test]
fn the_committed_training_schema_is_that_of_the_types() {
    assert_committed("crates/learn/src/rl/training.schema.json", &json_schema());
}

#[test]
fn the_training_schema_accepts_the_presets_and_refuses_nonsense() {
    let schema = json_schema();
    let presets =
        PRESETS.iter().map(|(name, _)| TrainingConfig::preset(name).unwrap()).chain([training_preset().unwrap()]);
    for preset in presets {
        let value = serde_json::to_value(&preset).unwrap();
        validate(&schema, &schema, &value, "training").unwrap();
        let parsed = |text: &toml::Table| TrainingConfig::parse(&toml::to_string(text).unwrap(), Path::new("preset"));
        let table: toml::Table = toml::to_string(&preset).unwrap().parse().unwrap();
        assert_eq!(parsed(&table).unwrap(), preset, "a preset survives being written");
        for (place, nonsense) in [
            ("/version", serde_json::json!("one")),
            ("/environment/estimator", serde_json::json!("eyes")),
            ("/environment/costs", serde_json::json!({ "smoothness": 1.0 })),
            ("/environment/observation", serde_json::json!({ "limit": 4.0 })),
            ("/spaces", serde_json::json!([{ "space": "traffic" }])),
        ] {
            let mut changed = value.clone();
            let (parent, name) = place.rsplit_once('/').unwrap();
            changed.pointer_mut(parent).unwrap().as_object_mut().unwrap().insert(name.to_owned(), nonsense);
            assert!(validate(&schema, &schema, &changed, "training").is_err(), "{}{place}", preset.name);
            let text = toml::to_string(&changed).unwrap();
            assert!(TrainingConfig::parse(&text, Path::new("preset")).is_err(), "{}{place}", preset.name);
        }
    }
}
