//! Schemas of enums whose variants have a field that their serializer adds.

use schemars::Schema;
use serde_json::Value;

/// Adds a field to each variant in the schema of an enum.
pub(super) fn add_field(schema: &mut Schema, name: &str, field: &Value) {
    for variant in variants_mut(schema) {
        if let Some(Value::Object(fields)) = variant.get_mut("properties") {
            fields.insert(name.to_owned(), field.clone());
        }
    }
}

/// Adds a field to each variant that has fields, and requires it.
pub(super) fn add_required_field(schema: &mut Schema, name: &str, field: &Value) {
    add_field(schema, name, field);
    for variant in variants_mut(schema) {
        if let Some(Value::Array(required)) = variant.get_mut("required") {
            required.push(name.into());
        }
    }
}

fn variants_mut(schema: &mut Schema) -> impl Iterator<Item = &mut Value> {
    let variants = schema.get_mut("oneOf").and_then(Value::as_array_mut);
    variants.into_iter().flatten()
}
