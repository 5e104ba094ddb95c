//! Scenario space files: the schema matches the types.

use crumple_spaces::{BUILT_IN_SPACES, built_in_space, json_schema};

use crate::schema::{assert_committed, validate};

/// `UPDATE_SCHEMA=1 cargo test --test suite schema` updates the committed schema.
#[test]
fn the_committed_space_schema_accepts_the_built_in_spaces_and_refuses_nonsense() {
    let schema = json_schema();
    assert_committed("crates/spaces/src/space.schema.json", &schema);
    for (name, ..) in BUILT_IN_SPACES {
        let space = serde_json::to_value(built_in_space(name).unwrap().spec()).unwrap();
        validate(&schema, &schema, &space, "space").unwrap();
        for (place, value) in [
            ("/version", serde_json::json!("one")),
            ("/base", serde_json::json!(3)),
            ("/base/vehicles/0/speed_mps", serde_json::json!(-1)),
            ("/parameters", serde_json::json!([])),
            (
                "/parameters/0/distribution",
                serde_json::json!({ "even": { "low": 0, "high": 1 } }),
            ),
            (
                "/parameters/0/distribution",
                serde_json::json!({ "uniform": { "low": 0 } }),
            ),
        ] {
            let mut changed = space.clone();
            *changed.pointer_mut(place).expect("there") = value;
            assert!(
                validate(&schema, &schema, &changed, "space").is_err(),
                "{name}{place}"
            );
        }
    }
}
