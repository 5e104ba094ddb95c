//! Observation and action spaces, from the pickle in a model.

use serde_json::Value;

use super::super::NetworkError;
use super::super::error::sanitized;
use super::super::pickle::{Object, Pickle, ValueId};
use super::unsupported;

/// A box space of observations or actions.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BoxSpace {
    /// Minimum of each number; minus infinity if unbounded.
    pub low: Vec<f32>,
    /// Maximum of each number; infinity if unbounded.
    pub high: Vec<f32>,
}

impl BoxSpace {
    /// Returns the bounds of a number.
    #[must_use]
    pub fn bounds(&self, index: usize) -> Option<(f64, f64)> {
        Some((
            f64::from(*self.low.get(index)?),
            f64::from(*self.high.get(index)?),
        ))
    }
}

/// Returns the pickle of a member of `data`.
pub(super) fn serialized_bytes(value: &Value, field: &str) -> Result<Vec<u8>, NetworkError> {
    let text = value.get(":serialized:").and_then(Value::as_str);
    let bytes = text.and_then(decode_base64);
    bytes.ok_or_else(|| {
        NetworkError::damaged(
            "member `data`",
            format!("{field} holds no serialized object"),
        )
    })
}

/// Reads the space in a member of `data`, which must be a box.
pub(super) fn read_box(value: &Value, field: &str) -> Result<BoxSpace, NetworkError> {
    let bytes = serialized_bytes(value, field)?;
    let pickle = Pickle::read(&bytes)?;
    let call = pickle.call(pickle.top);
    let class = call.and_then(|call| pickle.global(call.callee));
    let Some((call, (module, name))) = call.zip(class) else {
        return unsupported(format!("its {field} is not a space of Gymnasium"));
    };
    if !(module.ends_with("spaces.box") && name == "Box") {
        return unsupported(format!(
            "its {field} is `{}`, and crumple supports only Box with a fixed size; {}",
            sanitized(name),
            super::PROCESS_HINT
        ));
    }
    let low = read_bound(&pickle, call.state, "low", field)?;
    let high = read_bound(&pickle, call.state, "high", field)?;
    if low.len() != high.len()
        || low.is_empty()
        || !low.iter().zip(&high).all(|(low, high)| low < high)
    {
        return Err(NetworkError::damaged(
            "member `data`",
            format!("{field} has bounds that contradict each other"),
        ));
    }
    Ok(BoxSpace { low, high })
}

/// Reads the bounds `name` from the state of a box.
fn read_bound(
    pickle: &Pickle<'_>,
    state: Option<ValueId>,
    name: &str,
    field: &str,
) -> Result<Vec<f32>, NetworkError> {
    let array = state
        .and_then(|state| pickle.entry(state, name))
        .and_then(|id| array_values(pickle, id));
    match array {
        Some(array) => Ok(array.into_iter().map(|bound| bound as f32).collect()),
        None => Err(NetworkError::damaged(
            "member `data`",
            format!("{field} has no readable bound `{name}`"),
        )),
    }
}

/// Returns the numbers of a NumPy array, in either of its pickled forms.
pub(super) fn array_values(pickle: &Pickle<'_>, id: ValueId) -> Option<Vec<f64>> {
    let [bytes, kind] = array_bytes_and_type(pickle, id)?;
    let Object::Bytes(bytes) = pickle.get(bytes) else {
        return None;
    };
    let kind = pickle.call(kind)?;
    let code = pickle.text(*pickle.tuple(kind.arguments)?.first()?)?;
    if !is_little_endian(pickle, kind.state) {
        return None;
    }
    match code {
        "f4" => parse_numbers(bytes, |bytes| f32::from_le_bytes(bytes).into()),
        "f8" => parse_numbers(bytes, f64::from_le_bytes),
        _ => None,
    }
}

/// Returns the bytes and the type of a NumPy array.
fn array_bytes_and_type(pickle: &Pickle<'_>, id: ValueId) -> Option<[ValueId; 2]> {
    let call = pickle.call(id)?;
    match pickle.global(call.callee)?.1 {
        // Arguments: bytes, type, shape, order.
        "_frombuffer" => match pickle.tuple(call.arguments)? {
            [bytes, kind, ..] => Some([*bytes, *kind]),
            _ => None,
        },
        // State: version, shape, type, order, bytes.
        "_reconstruct" => match pickle.tuple(call.state?)? {
            [_, _, kind, _, bytes] => Some([*bytes, *kind]),
            _ => None,
        },
        _ => None,
    }
}

/// Parses numbers of `N` bytes; `None` if bytes are left over.
fn parse_numbers<const N: usize>(
    bytes: &[u8],
    number: impl Fn([u8; N]) -> f64,
) -> Option<Vec<f64>> {
    let (numbers, rest) = bytes.as_chunks();
    rest.is_empty()
        .then(|| numbers.iter().map(|&bytes| number(bytes)).collect())
}

fn is_little_endian(pickle: &Pickle<'_>, state: Option<ValueId>) -> bool {
    let order = state
        .and_then(|state| pickle.tuple(state))
        .and_then(|state| state.get(1).copied());
    order.and_then(|order| pickle.text(order)) == Some("<")
}

/// Decodes Base64 (RFC 4648, section 4).
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let mut bits = 0_u32;
    let mut count = 0;
    for letter in text.trim_end().trim_end_matches('=').bytes() {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            b'\n' | b'\r' => continue,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
            bits &= (1 << count) - 1;
        }
    }
    Some(bytes)
}
