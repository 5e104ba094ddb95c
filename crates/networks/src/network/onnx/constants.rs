//! Constants of a graph, in the forms that its operators use.

use std::borrow::Cow;

use super::super::MAX_PARAMETERS;
use super::model::{OnnxNode, OnnxTensor, TensorData};

pub(super) fn constant_of_node(node: OnnxNode) -> Result<OnnxTensor, String> {
    let mut attributes = node.attributes;
    if let Some(tensor) = attributes.remove("value").and_then(|value| value.tensor) {
        return Ok(tensor);
    }
    if let Some(number) = attributes.get("value_float").and_then(|value| value.float) {
        return Ok(OnnxTensor {
            shape: vec![],
            data: TensorData::Float(vec![number]),
        });
    }
    if let Some(number) = attributes.get("value_int").and_then(|value| value.integer) {
        return Ok(OnnxTensor {
            shape: vec![],
            data: TensorData::Integer(vec![number]),
        });
    }
    if let Some(value) = attributes.remove("value_floats") {
        return Ok(OnnxTensor {
            shape: vec![value.floats.len()],
            data: TensorData::Float(value.floats),
        });
    }
    if let Some(value) = attributes.remove("value_ints") {
        return Ok(OnnxTensor {
            shape: vec![value.integers.len()],
            data: TensorData::Integer(value.integers),
        });
    }
    Err("a constant that is not written as numbers".to_owned())
}

pub(super) fn float_attribute(node: &OnnxNode, name: &str, otherwise: f32) -> f32 {
    node.attributes
        .get(name)
        .and_then(|value| value.float)
        .unwrap_or(otherwise)
}

pub(super) fn integer_attribute(node: &OnnxNode, name: &str) -> Option<i64> {
    node.attributes.get(name).and_then(|value| value.integer)
}

/// True if an attribute is given and not 0.
pub(super) fn is_set(node: &OnnxNode, name: &str) -> bool {
    integer_attribute(node, name).is_some_and(|value| value != 0)
}

/// True if an attribute is missing, or all its integers are `expected`.
pub(super) fn has_only(node: &OnnxNode, name: &str, expected: i64) -> bool {
    node.attributes
        .get(name)
        .is_none_or(|value| value.integers.iter().all(|&number| number == expected))
}

/// Returns the two dimensions of a matrix; multiplies all dimensions after the first.
pub(super) fn matrix_shape(shape: &[usize]) -> Result<[usize; 2], String> {
    match shape {
        [rows, columns @ ..] if !columns.is_empty() => {
            let [first, rest @ ..] = columns else {
                return Err("a constant that is no matrix".to_owned());
            };
            let columns = rest
                .iter()
                .try_fold(*first, |product, &size| product.checked_mul(size));
            columns
                .map(|columns| [*rows, columns])
                .ok_or_else(|| "a constant that is too large".to_owned())
        }
        _ => Err(format!("a constant of shape {shape:?}, which is no matrix")),
    }
}

/// Returns a matrix with one row per input.
pub(super) fn to_input_rows(
    numbers: &[f32],
    [rows, columns]: [usize; 2],
    transposed: bool,
) -> Cow<'_, [f32]> {
    if !transposed {
        return Cow::Borrowed(numbers);
    }
    Cow::Owned(
        (0..columns)
            .flat_map(|column| {
                numbers
                    .iter()
                    .skip(column)
                    .step_by(columns)
                    .take(rows)
                    .copied()
            })
            .collect(),
    )
}

/// Broadcasts numbers to another shape, as NumPy does.
pub(super) fn broadcast(numbers: &[f32], from: &[usize], to: &[usize]) -> Result<Vec<f32>, String> {
    let excess = from.len().saturating_sub(to.len());
    let count: usize = to.iter().product();
    let from_aligned: Vec<usize> = std::iter::repeat_n(1, to.len().saturating_sub(from.len()))
        .chain(from.iter().skip(excess).copied())
        .collect();
    let is_refused = from.iter().take(excess).any(|&size| size != 1)
        || count > MAX_PARAMETERS
        || from_aligned
            .iter()
            .zip(to)
            .any(|(&from, &to)| from != 1 && from != to);
    if is_refused {
        return Err(format!(
            "a constant of shape {from:?} against numbers of shape {to:?}"
        ));
    }
    (0..count)
        .map(|index| {
            numbers
                .get(source_index(index, &from_aligned, to))
                .copied()
                .ok_or_else(|| "too few numbers".to_owned())
        })
        .collect()
}

/// Returns the index of the number that is broadcast to element `index`; both shapes have equal length.
fn source_index(mut index: usize, from: &[usize], to: &[usize]) -> usize {
    let mut source = 0;
    let mut stride = 1;
    for (&from, &to) in from.iter().zip(to).rev() {
        source += if from == 1 { 0 } else { index % to * stride };
        index /= to;
        stride *= from;
    }
    source
}
