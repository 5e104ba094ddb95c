//! In what the file of earlier work differs from the one expected.

use std::path::Path;

/// Names the first place in which two TOML files of a `kind` of work differ.
#[must_use]
pub fn in_toml(path: &Path, kind: &str, found: &str, expected: &str) -> String {
    let (table, path) = (|text: &str| text.parse().ok().map(toml::Value::Table), path.display());
    let (Some(old), Some(new)) = (table(found), table(expected)) else {
        return format!("{path}: not the file of a {kind}");
    };
    match first_difference("", Some(&old), Some(&new)) {
        Some((place, there, here)) => {
            format!("{path}: the {kind} there has another `{place}`: {there} instead of {here}")
        }
        None => format!("{path}: not as the {kind} left it"),
    }
}

/// The first place in which two values differ, deep inside tables and lists, and what is there.
fn first_difference(
    place: &str,
    old: Option<&toml::Value>,
    new: Option<&toml::Value>,
) -> Option<(String, String, String)> {
    use toml::Value::{Array, Table};
    match (old, new) {
        (Some(Table(old)), Some(Table(new))) => {
            let names = new.keys().chain(old.keys().filter(|name| !new.contains_key(*name)));
            let dot = if place.is_empty() { "" } else { "." };
            names
                .map(|name| (format!("{place}{dot}{name}"), old.get(name), new.get(name)))
                .find_map(|(place, old, new)| first_difference(&place, old, new))
        }
        (Some(Array(old)), Some(Array(new))) => (0..old.len().max(new.len()))
            .find_map(|index| first_difference(&format!("{place}[{index}]"), old.get(index), new.get(index))),
        _ if old == new => None,
        _ => {
            let show = |value: Option<&toml::Value>| match value {
                None => "nothing".to_owned(),
                // Whole tables and lists would fill the screen.
                Some(Table(_)) => "a table".to_owned(),
                Some(Array(_)) => "a list".to_owned(),
                Some(value) => value.to_string(),
            };
            Some((place.to_owned(), show(old), show(new)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_however_deep_they_are() {
        let at = |old: &str, new: &str| {
            let [old, new] = [old, new].map(|text| toml::Value::Table(text.parse().unwrap()));
            first_difference("", Some(&old), Some(&new)).map(|(place, there, here)| format!("{place}: {there}, {here}"))
        };
        assert_eq!(at("a = 1\nb = 2", "b = 2\na = 1"), None);
        assert_eq!(at("a = 1", "a = 2").unwrap(), "a: 1, 2");
        assert_eq!(
            at("a = [{ b = 1 }, { b = 2, c.d = 3 }]", "a = [{ b = 1 }, { b = 2, c.d = 4 }]").unwrap(),
            "a[1].c.d: 3, 4"
        );
        assert_eq!(at("a = [1, 2]", "a = [1]").unwrap(), "a[1]: 2, nothing");
        assert_eq!(at("a = 1", "a.b = 1").unwrap(), "a: 1, a table");
        assert_eq!(at("", "a = 'x'").unwrap(), "a: nothing, \"x\"");
    }
}
