//! Reader of protocol buffers: numbered fields, without copies.
//!
//! Only a few messages of one format are needed, so fields are matched by number instead of by generated code.

use super::NetworkError;

const FORMAT: &str = "ONNX file";

/// Maximum number of integers of a repeated field, which hold shapes, not weights.
const MAX_INTEGERS: usize = 4096;

const MAX_NAME_BYTES: usize = 300;

#[derive(Debug, Clone, Copy)]
pub(super) enum WireValue<'a> {
    /// Integer of variable length.
    Varint(u64),
    Fixed64(u64),
    Fixed32(u32),
    /// Text, bytes, a message, or packed numbers.
    Bytes(&'a [u8]),
}

impl<'a> WireValue<'a> {
    pub(super) fn bytes(self) -> Result<&'a [u8], NetworkError> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            _ => Err(damaged("a number where bytes are wanted")),
        }
    }

    pub(super) fn text(self) -> Result<String, NetworkError> {
        let text =
            std::str::from_utf8(self.bytes()?).map_err(|_| damaged("text that is not UTF-8"))?;
        // Messages contain names, so control characters are rejected.
        if text.len() > MAX_NAME_BYTES || text.chars().any(char::is_control) {
            return Err(damaged(&format!(
                "a name of more than {MAX_NAME_BYTES} bytes or with control characters"
            )));
        }
        Ok(text.to_owned())
    }

    pub(super) fn varint(self) -> Result<u64, NetworkError> {
        match self {
            Self::Varint(number) => Ok(number),
            _ => Err(damaged("bytes where a number is wanted")),
        }
    }

    pub(super) fn integer(self) -> Result<i64, NetworkError> {
        Ok(self.varint()?.cast_signed())
    }

    pub(super) fn float(self) -> Result<f32, NetworkError> {
        match self {
            Self::Fixed32(bits) => Ok(f32::from_bits(bits)),
            _ => Err(damaged(
                "something else where a number of single precision is wanted",
            )),
        }
    }

    /// Appends integers of a repeated field, packed or not.
    pub(super) fn integers(self, into: &mut Vec<i64>) -> Result<(), NetworkError> {
        match self {
            Self::Bytes(packed) => {
                let mut rest = Message(packed);
                while !rest.0.is_empty() && into.len() <= MAX_INTEGERS {
                    into.push(rest.varint()?.cast_signed());
                }
            }
            value => into.push(value.integer()?),
        }
        let fits = into.len() <= MAX_INTEGERS;
        if fits {
            Ok(())
        } else {
            Err(damaged(&format!(
                "more than {MAX_INTEGERS} whole numbers in one field"
            )))
        }
    }

    /// Appends single-precision numbers of a repeated field, packed or not.
    pub(super) fn floats(self, into: &mut Vec<f32>) -> Result<(), NetworkError> {
        match self {
            Self::Bytes(packed) => unpack(packed, into, f32::from_le_bytes),
            value => value.float().map(|number| into.push(number)),
        }
    }

    /// Appends double-precision numbers of a repeated field, rounded to single.
    pub(super) fn doubles(self, into: &mut Vec<f32>) -> Result<(), NetworkError> {
        match self {
            Self::Bytes(packed) => unpack(packed, into, |bytes| f64::from_le_bytes(bytes) as f32),
            Self::Fixed64(bits) => {
                into.push(f64::from_bits(bits) as f32);
                Ok(())
            }
            _ => Err(damaged(
                "something else where a number of double precision is wanted",
            )),
        }
    }
}

fn unpack<const N: usize>(
    packed: &[u8],
    into: &mut Vec<f32>,
    number: impl Fn([u8; N]) -> f32,
) -> Result<(), NetworkError> {
    let (values, rest) = packed.as_chunks();
    into.extend(values.iter().map(|&bytes| number(bytes)));
    if rest.is_empty() {
        Ok(())
    } else {
        Err(damaged("packed numbers that end within one"))
    }
}

pub(super) struct Message<'a>(pub(super) &'a [u8]);

impl<'a> Message<'a> {
    pub(super) fn next_field(&mut self) -> Result<Option<(u64, WireValue<'a>)>, NetworkError> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let key = self.varint()?;
        let value = match key & 7 {
            0 => WireValue::Varint(self.varint()?),
            1 => WireValue::Fixed64(u64::from_le_bytes(self.take()?)),
            2 => {
                let length = usize::try_from(self.varint()?).unwrap_or(usize::MAX);
                let (value, rest) = self
                    .0
                    .split_at_checked(length)
                    .ok_or_else(|| damaged("a field longer than what it is in"))?;
                self.0 = rest;
                WireValue::Bytes(value)
            }
            5 => WireValue::Fixed32(u32::from_le_bytes(self.take()?)),
            other => {
                return Err(damaged(&format!(
                    "a field of kind {other}, which there is not"
                )));
            }
        };
        match key >> 3 {
            0 => Err(damaged("a field without a number")),
            number => Ok(Some((number, value))),
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], NetworkError> {
        let (bytes, rest) = self
            .0
            .split_first_chunk()
            .ok_or_else(|| damaged("a number that is cut off"))?;
        self.0 = rest;
        Ok(*bytes)
    }

    fn varint(&mut self) -> Result<u64, NetworkError> {
        let mut number = 0_u64;
        for index in 0..10 {
            let [byte] = self.take()?;
            number |= u64::from(byte & 0x7f).unbounded_shl(7 * index);
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        Err(damaged("a number of more than ten bytes"))
    }
}

fn damaged(problem: &str) -> NetworkError {
    NetworkError::damaged(FORMAT, problem)
}
