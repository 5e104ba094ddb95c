//! Canonical text of a certificate, without duplicate names in an object.
//!
//! The canonical form is compact JSON with fields in the order of the types, without absent fields, and with the
//! shortest numbers that read back unchanged. A file may only add whitespace between tokens, so that no two readers
//! interpret it differently.

use std::collections::HashSet;
use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use sha2::{Digest, Sha256};

/// Returns the first line and column, from 1, at which a JSON text differs from its canonical form, apart from
/// whitespace.
pub(crate) fn first_difference(text: &str, canonical: &str) -> Option<(usize, usize)> {
    let mut expected = canonical.bytes();
    let mut in_string = false;
    let mut escaped = false;
    for (offset, byte) in text.bytes().enumerate() {
        if !in_string && matches!(byte, b' ' | b'\t' | b'\n' | b'\r') {
            continue;
        }
        if expected.next() != Some(byte) {
            return Some(line_and_column(text, offset));
        }
        in_string = if byte == b'"' && !escaped {
            !in_string
        } else {
            in_string
        };
        escaped = in_string && byte == b'\\' && !escaped;
    }
    expected.next().map(|_| line_and_column(text, text.len()))
}

fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let line_begins = before
        .iter()
        .rposition(|&byte| byte == b'\n')
        .map_or(0, |newline| newline + 1);
    (
        before.iter().filter(|&&byte| byte == b'\n').count() + 1,
        offset - line_begins + 1,
    )
}

pub(crate) fn sha256(bytes: impl AsRef<[u8]>) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

pub(crate) fn is_sha256(text: &str) -> bool {
    text.len() == 64
        && text
            .bytes()
            .all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// JSON whose objects have no duplicate names; all else is ignored.
pub(crate) struct UniqueKeys;

impl<'de> Deserialize<'de> for UniqueKeys {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(Self)
    }
}

impl<'de> Visitor<'de> for UniqueKeys {
    type Value = Self;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("JSON")
    }

    fn visit_bool<E>(self, _: bool) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_f64<E>(self, _: f64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_str<E>(self, _: &str) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_unit<E>(self) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<Self, A::Error> {
        while entries.next_element::<Self>()?.is_some() {}
        Ok(self)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self, A::Error> {
        let mut names = HashSet::new();
        while let Some(name) = entries.next_key::<String>()? {
            if names.contains(&name) {
                return Err(A::Error::custom(format_args!("duplicate key {name:?}")));
            }
            names.insert(name);
            entries.next_value::<Self>()?;
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitespace_between_tokens_is_all_that_may_differ() {
        let canonical = r#"{"a":[1.5,"x \" y"],"b":{}}"#;
        for same in [
            canonical,
            "{\n  \"a\": [1.5, \"x \\\" y\"],\n\t\"b\": {}\r\n}\n",
        ] {
            assert_eq!(first_difference(same, canonical), None, "{same}");
        }
        for (other, at) in [
            (r#"{"a":[1.50,"x \" y"],"b":{}}"#, (1, 10)),
            ("{\n \"b\":{},\"a\":[1.5,\"x \\\" y\"]}", (2, 3)),
            (r#"{"a":[1.5,"x  \" y"],"b":{}}"#, (1, 14)),
            (r#"{"a":[1.5,"x \" y"],"b":{}"#, (1, 27)),
            (r#"{"a":[1.5,"x \" y"],"b":{}} {}"#, (1, 29)),
        ] {
            assert_eq!(first_difference(other, canonical), Some(at), "{other}");
        }
    }

    #[test]
    fn a_duplicate_name_is_found_at_any_depth() {
        let read = |text: &str| {
            serde_json::from_str::<UniqueKeys>(text)
                .map(|_| ())
                .map_err(|error| error.to_string())
        };
        assert_eq!(
            read(r#"{"a": [{"b": 1}, {"b": null}], "b": {"a": true}}"#),
            Ok(())
        );
        let error = read(r#"{"a": [{"b": 1, "c": -1, "b": 1.5}]}"#).unwrap_err();
        assert!(error.starts_with("duplicate key \"b\""), "{error}");
    }

    #[test]
    fn invalid_json_is_refused() {
        let bytes = serde::de::value::BytesDeserializer::<serde::de::value::Error>::new(b"no text");
        let error = UniqueKeys::deserialize(bytes)
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert_eq!(error, "invalid type: byte array, expected JSON");
    }
}
