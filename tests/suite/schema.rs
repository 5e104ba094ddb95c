//! The part of JSON Schema that schemas of scenario files use, so that no second schema library is needed.

use serde_json::Value;

/// Checks `value` against `schema`, whose references lead into `root`. Panics at an unknown keyword, since ignoring it
/// would pass invalid values.
///
/// # Errors
/// The position of the value, and the violated keyword.
pub(crate) fn validate(
    root: &Value,
    schema: &Value,
    value: &Value,
    place: &str,
) -> Result<(), String> {
    let rules = match schema {
        Value::Object(rules) => rules,
        Value::Bool(true) => return Ok(()),
        other => return Err(format!("{place}: {other} allows nothing")),
    };
    let number = |rule: &Value| rule.as_f64().expect("a number");
    let all = |rule: &Value| rule.as_array().expect("a list").clone();
    for (keyword, rule) in rules {
        let holds = match keyword.as_str() {
            "$schema" | "$defs" | "title" | "description" | "default" | "format" => true,
            "$ref" => {
                let target = rule
                    .as_str()
                    .and_then(|path| root.pointer(path.strip_prefix('#')?))
                    .expect("a definition");
                validate(root, target, value, place)?;
                true
            }
            "type" => match rule {
                Value::Array(types) => types.iter().any(|name| is_of_type(value, name)),
                name => is_of_type(value, name),
            },
            "enum" => all(rule).contains(value),
            "const" => rule == value,
            "minimum" => value
                .as_f64()
                .is_none_or(|number_found| number_found >= number(rule)),
            "maximum" => value
                .as_f64()
                .is_none_or(|number_found| number_found <= number(rule)),
            // Evaluated with "if".
            "then" => true,
            "if" => {
                if let (true, Some(then)) = (
                    validate(root, rule, value, place).is_ok(),
                    rules.get("then"),
                ) {
                    validate(root, then, value, place)?;
                }
                true
            }
            "minLength" => value
                .as_str()
                .is_none_or(|text| text.chars().count() as f64 >= number(rule)),
            "minItems" => value
                .as_array()
                .is_none_or(|items| items.len() as f64 >= number(rule)),
            "maxItems" => value
                .as_array()
                .is_none_or(|items| items.len() as f64 <= number(rule)),
            "prefixItems" => {
                for (index, (item, rule)) in value
                    .as_array()
                    .into_iter()
                    .flatten()
                    .zip(all(rule))
                    .enumerate()
                {
                    validate(root, &rule, item, &format!("{place}[{index}]"))?;
                }
                true
            }
            "items" => {
                for (index, item) in value.as_array().into_iter().flatten().enumerate() {
                    validate(root, rule, item, &format!("{place}[{index}]"))?;
                }
                true
            }
            "anyOf" => all(rule)
                .iter()
                .any(|alternative| validate(root, alternative, value, place).is_ok()),
            "oneOf" => {
                all(rule)
                    .iter()
                    .filter(|alternative| validate(root, alternative, value, place).is_ok())
                    .count()
                    == 1
            }
            "required" => all(rule)
                .iter()
                .all(|name| value.get(name.as_str().expect("a name")).is_some()),
            "properties" => {
                for (name, rule) in rule.as_object().expect("an object") {
                    if let Some(member) = value.get(name) {
                        validate(root, rule, member, &format!("{place}.{name}"))?;
                    }
                }
                true
            }
            "additionalProperties" => {
                let properties = rules.get("properties").and_then(Value::as_object);
                let is_known =
                    |name: &str| properties.is_some_and(|properties| properties.contains_key(name));
                for (name, member) in value
                    .as_object()
                    .into_iter()
                    .flatten()
                    .filter(|(name, _)| !is_known(name))
                {
                    if *rule == Value::Bool(false) {
                        return Err(format!("{place}: `{name}` is not known"));
                    }
                    validate(root, rule, member, &format!("{place}.{name}"))?;
                }
                true
            }
            other => panic!("{place}: the keyword {other} is not known here"),
        };
        if !holds {
            return Err(format!("{place}: breaks {keyword} {rule}: {value}"));
        }
    }
    Ok(())
}

fn is_of_type(value: &Value, name: &Value) -> bool {
    match name.as_str().expect("a type is a name") {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        other => panic!("unknown type {other}"),
    }
}

/// Asserts that a committed schema matches the types; with `UPDATE_SCHEMA` in the environment, writes it.
pub(crate) fn assert_committed(path: &str, schema: &serde_json::Value) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    let generated = format!("{}\n", serde_json::to_string_pretty(schema).unwrap());
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &generated).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap();
    assert!(
        committed == generated,
        "outdated: run UPDATE_SCHEMA=1 cargo test --test suite schema"
    );
}
