//! Channels: the value of a record, as a number in the channel's unit.

use super::blocks::{Block, Blocks};
use super::conversion::ChannelConversion;
use super::{MdfError, SignalUse};

/// A channel of fixed place in its records.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) name: String,
    pub(super) unit: String,
    bits: BitField,
    kind: RawValueKind,
    conversion: ChannelConversion,
    /// Bit of the record that is set if the value is invalid.
    invalid_bit: Option<usize>,
}

/// Place of a number in a record or frame.
#[derive(Debug, Clone, Copy)]
struct BitField {
    byte: usize,
    bytes: usize,
    shift: u32,
    count: u32,
    is_big_endian: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum RawValueKind {
    Unsigned,
    Signed,
    Float,
    /// A master channel without bytes: the number of the record.
    Index,
}

impl Channel {
    /// Reads a channel; `None` for one without numbers, such as a text. Ids keep their numbers where a conversion has
    /// texts.
    pub(super) fn read(
        blocks: &mut Blocks,
        block: &Block,
        record_bytes: u64,
        use_of: SignalUse,
    ) -> Result<Option<Self>, MdfError> {
        let kind = block.number(0, 1)?;
        let data_type = block.number(2, 1)?;
        let (bit_offset, byte_offset, bit_count) = (
            block.number(3, 1)?,
            block.number(4, 4)?,
            block.number(8, 4)?,
        );
        let flags = block.number(12, 4)?;
        let value = match (kind, data_type) {
            (3 | 6, _) => RawValueKind::Index,
            (1, _) => return Ok(None),
            (_, 0 | 1) => RawValueKind::Unsigned,
            (_, 2 | 3) => RawValueKind::Signed,
            (_, 4 | 5) => RawValueKind::Float,
            _ => return Ok(None),
        };
        let is_number = match value {
            RawValueKind::Index => true,
            RawValueKind::Float => matches!(bit_count, 32 | 64) && bit_offset == 0,
            _ => (1..=64).contains(&bit_count) && bit_offset < 8,
        };
        if !is_number {
            return Ok(None);
        }
        let bytes = (bit_offset + bit_count).div_ceil(8);
        let has_place = value == RawValueKind::Index || byte_offset + bytes <= record_bytes;
        if !has_place {
            return Err(block.damaged("the channel is outside its record"));
        }
        let is_big_endian = matches!(data_type, 1 | 3 | 5);
        let (byte, bytes) = (byte_offset as usize, bytes as usize);
        let bits = BitField {
            byte,
            bytes,
            shift: bit_offset as u32,
            count: bit_count as u32,
            is_big_endian,
        };
        let invalid_bit = match flags & 3 {
            0 => None,
            2 => Some(8 * record_bytes as usize + block.number(16, 4)? as usize),
            // All values are invalid.
            _ => return Ok(None),
        };
        let (name, mut unit) = (blocks.text(block.link(2))?, blocks.text(block.link(6))?);
        let conversion = match blocks.find(block.link(4), b"CC")? {
            Some(conversion) => {
                if unit.is_empty() {
                    unit = blocks.text(conversion.link(1))?;
                }
                ChannelConversion::read(blocks, &conversion, value == RawValueKind::Float, use_of)?
            }
            None => ChannelConversion::Identity,
        };
        Ok(Some(Self {
            name,
            unit,
            bits,
            kind: value,
            conversion,
            invalid_bit,
        }))
    }

    /// Returns the value in a record, the `index`-th of its group; NaN for an invalid one.
    pub(super) fn value(&self, record: &[u8], index: usize) -> f64 {
        let is_invalid = self.invalid_bit.is_some_and(|bit| {
            record
                .get(bit / 8)
                .is_none_or(|byte| byte >> (bit % 8) & 1 == 1)
        });
        if is_invalid {
            return f64::NAN;
        }
        let raw = match self.kind {
            RawValueKind::Index => index as f64,
            RawValueKind::Unsigned => self.bits.get(record) as f64,
            RawValueKind::Signed => self.bits.get_signed(record) as f64,
            RawValueKind::Float if self.bits.count == 32 => {
                f64::from(f32::from_bits(self.bits.get(record) as u32))
            }
            RawValueKind::Float => f64::from_bits(self.bits.get(record)),
        };
        self.conversion.apply(raw)
    }

    /// Returns the bits of the value, without conversion.
    pub(super) fn raw(&self, record: &[u8]) -> u64 {
        self.bits.get(record)
    }
}

impl BitField {
    #[inline]
    fn get(&self, record: &[u8]) -> u64 {
        let Some(bytes) = record.get(self.byte..self.byte + self.bytes) else {
            return 0;
        };
        if let (&[a, b, c, d, e, f, g, h], 64, false) = (bytes, self.count, self.is_big_endian) {
            return u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        }
        let join = |all: u128, byte: &u8| all << 8 | u128::from(*byte);
        let joined = if self.is_big_endian {
            bytes.iter().fold(0, join)
        } else {
            bytes.iter().rev().fold(0, join)
        } >> self.shift;
        (joined & (u128::MAX >> (128 - self.count))) as u64
    }

    fn get_signed(&self, record: &[u8]) -> i64 {
        sign_extend(self.get(record), self.count)
    }
}

/// Reads the lowest `count` bits, from 1 to 64, as a two's complement.
pub(super) fn sign_extend(raw: u64, count: u32) -> i64 {
    let unused = 64 - count;
    (raw << unused) as i64 >> unused
}
