//! Description of the first difference between an existing file and the expected one.

use std::path::Path;

use serde_json::Value;

/// Describes the first difference between two TOML files of a `kind` of run.
#[must_use]
pub fn describe_toml(path: &Path, kind: &str, found: &str, expected: &str) -> String {
    let table = |text: &str| text.parse::<toml::Table>().ok().and_then(|table| serde_json::to_value(table).ok());
    describe(path, kind, table(found), table(expected))
}

/// Describes the first difference between two JSON files of a `kind` of run.
#[must_use]
pub fn describe_json(path: &Path, kind: &str, found: &str, expected: &str) -> String {
    let value = |text: &str| serde_json::from_str(text).ok();
    describe(path, kind, value(found), value(expected))
}

fn describe(path: &Path, kind: &str, found: Option<Value>, expected: Option<Value>) -> String {
    let path = path.display();
    let (Some(old), Some(new)) = (found, expected) else {
        return format!("{path}: this is not the file of a {kind}");
    };
    match first_difference("", Some(&old), Some(&new)) {
        Some((place, there, here)) => {
            format!("{path}: the {kind} there has a different `{place}`: {there} instead of {here}")
        }
        None => format!("{path}: the file has changed since the {kind} wrote it"),
    }
}

/// Returns the path of the first difference between two values, and both values there.
fn first_difference(place: &str, old: Option<&Value>, new: Option<&Value>) -> Option<(String, String, String)> {
    use Value::{Array, Object};
    match (old, new) {
        (Some(Object(old)), Some(Object(new))) => {
            let names = new.keys().chain(old.keys().filter(|name| !new.contains_key(*name)));
            let dot = if place.is_empty() { "" } else { "." };
            names
                .map(|name| (format!("{place}{dot}{name}"), old.get(name), new.get(name)))
                .find_map(|(place, old, new)| first_difference(&place, old, new))
        }
        (Some(Array(old)), Some(Array(new))) => (0..old.len().max(new.len()))
            .find_map(|index| first_difference(&format!("{place}[{index}]"), old.get(index), new.get(index))),
        _ if old == new => None,
        _ => Some((place.to_owned(), format_value(old), format_value(new))),
    }
}

/// Formats a value in one line. Tables, lists and long text are abbreviated.
fn format_value(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => "nothing".to_owned(),
        Some(Value::Object(_)) => "a table".to_owned(),
        Some(Value::Array(_)) => "a list".to_owned(),
        Some(Value::String(text)) if text.chars().count() > MAX_SHOWN_CHARS => {
            format!("a text of {} bytes", text.len())
        }
        Some(value) => value.to_string(),
    }
}

/// Maximum characters of a text that is shown.
const MAX_SHOWN_CHARS: usize = 200;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_however_deep_they_are() {
        let at = |old: &str, new: &str| {
            let [old, new] = [old, new].map(|text| serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap());
            first_difference("", Some(&old), Some(&new)).map(|(place, there, here)| format!("{place}: {there}, {here}"))
        };
        assert_eq!(at("a = 1\nb = 2", "b = 2\na = 1"), None);
        assert_eq!(at("a = 1", "a = 2").unwrap(), "a: 1, 2");
        let nested = at("a = [{ b = 1 }, { b = 2, c.d = 3 }]", "a = [{ b = 1 }, { b = 2, c.d = 4 }]");
        assert_eq!(nested.unwrap(), "a[1].c.d: 3, 4");
        assert_eq!(at("a = [1, 2]", "a = [1]").unwrap(), "a[1]: 2, nothing");
        assert_eq!(at("a = 1", "a.b = 1").unwrap(), "a: 1, a table");
        assert_eq!(at("", "a = 'x'").unwrap(), "a: nothing, \"x\"");
    }

    #[test]
    fn of_a_json_file_the_place_and_both_values_are_named() {
        let at = |old: &str, new: &str| describe_json(Path::new("a.json"), "count", old, new);
        let message = at(r#"{"runs": 3, "seed": "1"}"#, r#"{"runs": 3, "seed": "2"}"#);
        assert_eq!(message, "a.json: the count there has a different `seed`: \"1\" instead of \"2\"");
        let long = at(&format!(r#"{{"a": "{}"}}"#, "x".repeat(201)), "{}");
        assert!(long.ends_with("`a`: a text of 201 bytes instead of nothing"), "{long}");
        assert_eq!(at("{", "{}"), "a.json: this is not the file of a count");
    }
}
