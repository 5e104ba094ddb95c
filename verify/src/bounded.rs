//! Lists and maps of bounded length. An empty list takes two characters in a file and 24 bytes in memory, so the size
//! of the file is no sufficient bound.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};

pub(crate) fn deserialize_list<'de, const N: usize, D: Deserializer<'de>, T: Deserialize<'de>>(
    from: D,
) -> Result<Vec<T>, D::Error> {
    from.deserialize_seq(BoundedListVisitor::<N, T>(PhantomData))
}

pub(crate) fn deserialize_map<'de, const N: usize, D: Deserializer<'de>>(
    from: D,
) -> Result<BTreeMap<String, String>, D::Error> {
    from.deserialize_map(BoundedMapVisitor::<N>)
}

struct BoundedListVisitor<const N: usize, T>(PhantomData<T>);

struct BoundedMapVisitor<const N: usize>;

impl<'de, const N: usize, T: Deserialize<'de>> Visitor<'de> for BoundedListVisitor<N, T> {
    type Value = Vec<T>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "a list of at most {N} entries")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
        let mut list = Vec::new();
        while let Some(entry) = entries.next_element()? {
            if list.len() == N {
                return Err(A::Error::invalid_length(N + 1, &self));
            }
            list.push(entry);
        }
        Ok(list)
    }
}

impl<'de, const N: usize> Visitor<'de> for BoundedMapVisitor<N> {
    type Value = BTreeMap<String, String>;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "at most {N} names with a text each")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
        let mut map = BTreeMap::new();
        while let Some((name, text)) = entries.next_entry()? {
            // Otherwise the last of two entries with one name would silently win.
            if map.contains_key(&name) {
                return Err(A::Error::custom(format_args!("duplicate key {name:?}")));
            }
            map.insert(name, text);
            if map.len() > N {
                return Err(A::Error::invalid_length(N + 1, &self));
            }
        }
        Ok(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_with_one_entry_too_many_are_refused_with_its_number() {
        fn numbers(text: &str) -> Result<Vec<u8>, String> {
            deserialize_list::<2, _, _>(&mut serde_json::Deserializer::from_str(text))
                .map_err(|error| error.to_string())
        }
        fn names(text: &str) -> Result<usize, String> {
            let read = deserialize_map::<2, _>(&mut serde_json::Deserializer::from_str(text));
            read.map(|map| map.len()).map_err(|error| error.to_string())
        }
        assert_eq!(
            (numbers("[]"), numbers("[3, 4]")),
            (Ok(vec![]), Ok(vec![3, 4]))
        );
        assert_eq!(
            (names("{}"), names(r#"{"a": "", "b": ""}"#)),
            (Ok(0), Ok(2))
        );
        let starts = |error: Result<_, String>, with: &str| {
            let error = error.map(|_: usize| ()).unwrap_err();
            assert!(error.starts_with(with), "{error}");
        };
        for more in ["[3, 4, 5]", "[3, 4, 5, 6]"] {
            let refused = numbers(more).map(|list| list.len());
            starts(
                refused,
                "invalid length 3, expected a list of at most 2 entries at line 1",
            );
        }
        for more in [
            r#"{"a": "", "b": "", "c": ""}"#,
            r#"{"a": "", "b": "", "c": "", "d": ""}"#,
        ] {
            starts(
                names(more),
                "invalid length 3, expected at most 2 names with a text each at line 1",
            );
        }
        starts(
            names(r#"{"a": "", "b": "", "a": ""}"#),
            "duplicate key \"a\"",
        );
        starts(
            numbers("{}").map(|list| list.len()),
            "invalid type: map, expected a list of at most 2 entries",
        );
        starts(
            names("[]"),
            "invalid type: sequence, expected at most 2 names with a text each",
        );
    }
}
