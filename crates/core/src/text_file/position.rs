//! Positions of fields in the text of a file.

use std::ops::Range;

use crate::old_names::old_names_of;

/// Returns the line, from 1, of a field in TOML text; for an absent field, that of its deepest parent.
#[must_use]
pub fn line_in_toml(text: &str, field: &str) -> usize {
    line_at(text, locate_in_toml(text, field).start)
}

/// Returns the line, from 1, of a field in JSON text; for an absent field, that of its deepest parent.
#[must_use]
pub fn line_in_json(text: &str, field: &str) -> usize {
    line_at(text, locate_in_json(text, field).start)
}

/// Returns the source text of a field's value in TOML; `None` if the text lacks the field.
#[must_use]
pub fn raw_toml_value<'t>(text: &'t str, field: &str) -> Option<&'t str> {
    let (span, is_whole) = find_in_toml(text, field);
    text.get(span).filter(|_| is_whole)
}

/// Returns the line, from 1, of a byte offset.
pub(super) fn line_at(text: impl AsRef<[u8]>, offset: usize) -> usize {
    1 + text
        .as_ref()
        .iter()
        .take(offset)
        .filter(|&&byte| byte == b'\n')
        .count()
}

/// Splits a path such as `vehicles[1].driver.brake` into steps.
fn path_steps(field: &str) -> impl Iterator<Item = PathStep<'_>> {
    field.split('.').flat_map(|part| {
        let (name, indices) = part
            .split_once('[')
            .map_or((part, ""), |(name, rest)| (name, rest));
        let index = indices
            .strip_suffix(']')
            .and_then(|digits| digits.parse().ok());
        std::iter::once(PathStep::Field(name)).chain(index.map(PathStep::Index))
    })
}

enum PathStep<'a> {
    Field(&'a str),
    Index(usize),
}

/// Returns the span of a field in TOML text; for an absent field (an invalid default), that of its deepest parent.
pub(super) fn locate_in_toml(text: &str, field: &str) -> Range<usize> {
    find_in_toml(text, field).0
}

/// Returns the span as [`locate_in_toml`] does, and true if the text contains the field.
fn find_in_toml(text: &str, field: &str) -> (Range<usize>, bool) {
    let mut span = 0..0;
    let Ok(root) = toml::de::DeTable::parse(text) else {
        return (span, false);
    };
    let mut table = Some(root.get_ref());
    let mut array = None;
    for step in path_steps(field) {
        let value = match step {
            PathStep::Field(name) => table.and_then(|table| {
                let mut old_names = old_names_of(name);
                table
                    .get(name)
                    .or_else(|| old_names.find_map(|old| table.get(old)))
            }),
            PathStep::Index(index) => {
                array.and_then(|array: &toml::de::DeArray<'_>| array.get(index))
            }
        };
        let Some(value) = value else {
            return (span, false);
        };
        span = value.span();
        table = value.get_ref().as_table();
        array = value.get_ref().as_array();
    }
    (span, true)
}

/// Returns the span of a field in JSON text, as [`locate_in_toml`] does for TOML.
fn locate_in_json(text: &str, field: &str) -> Range<usize> {
    use jsonc_parser::common::Ranged;
    let parsed = jsonc_parser::parse_to_ast(text, &Default::default(), &Default::default());
    let mut value = parsed.ok().and_then(|result| result.value);
    let mut span = 0..0;
    for step in path_steps(field) {
        let next = match (step, value) {
            (PathStep::Field(name), Some(jsonc_parser::ast::Value::Object(mut object))) => {
                object.take(name).map(|property| property.value)
            }
            (PathStep::Index(index), Some(jsonc_parser::ast::Value::Array(array))) => {
                array.elements.into_iter().nth(index)
            }
            _ => None,
        };
        let Some(item) = next else { break };
        span = item.start()..item.end();
        value = Some(item);
    }
    span
}
