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
        signal_use: SignalUse,
    ) -> Result<Option<Self>, MdfError> {
        let flags = block.number(12, 4)?;
        let Some(kind) = RawValueKind::read(block)? else {
            return Ok(None);
        };
        let Some(bits) = BitField::read(block, kind)? else {
            return Ok(None);
        };
        let is_outside = bits.byte as u64 + bits.bytes as u64 > record_bytes;
        if is_outside && kind != RawValueKind::Index {
            return Err(block.damaged("the channel is outside its record"));
        }
        let invalid_bit = match flags & 3 {
            0 => None,
            2 => Some(8 * record_bytes as usize + block.number(16, 4)? as usize),
            // All values are invalid.
            _ => return Ok(None),
        };
        let name = blocks.text(block.link(2))?;
        let mut unit = blocks.text(block.link(6))?;
        let conversion = match blocks.find(block.link(4), b"CC")? {
            Some(conversion) => {
                if unit.is_empty() {
                    unit = blocks.text(conversion.link(1))?;
                }
                let is_float = kind == RawValueKind::Float;
                ChannelConversion::read(blocks, &conversion, is_float, signal_use)?
            }
            None => ChannelConversion::Identity,
        };
        Ok(Some(Self {
            name,
            unit,
            bits,
            kind,
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

    /// Returns the bits of the value of a channel that is not virtual, without conversion.
    pub(super) fn raw(&self, record: &[u8]) -> u64 {
        self.bits.get(record)
    }

    /// True if the records have no bytes of the channel.
    pub(super) fn is_virtual(&self) -> bool {
        self.kind == RawValueKind::Index
    }
}

impl RawValueKind {
    /// Reads the kind of the values of a channel; `None` for values that are no numbers.
    fn read(channel: &Block) -> Result<Option<Self>, MdfError> {
        let channel_type = channel.number(0, 1)?;
        let data_type = channel.number(2, 1)?;
        Ok(match (channel_type, data_type) {
            (3 | 6, _) => Some(Self::Index),
            (1, _) => None,
            (_, 0 | 1) => Some(Self::Unsigned),
            (_, 2 | 3) => Some(Self::Signed),
            (_, 4 | 5) => Some(Self::Float),
            _ => None,
        })
    }
}

impl BitField {
    /// Reads the bits of the values of a channel; `None` for a number of bits that no number has.
    fn read(channel: &Block, kind: RawValueKind) -> Result<Option<Self>, MdfError> {
        let shift = channel.number(3, 1)?;
        let byte = channel.number(4, 4)?;
        let count = channel.number(8, 4)?;
        let is_number = match kind {
            RawValueKind::Index => true,
            RawValueKind::Float => matches!(count, 32 | 64) && shift == 0,
            RawValueKind::Unsigned | RawValueKind::Signed => (1..=64).contains(&count) && shift < 8,
        };
        let is_big_endian = matches!(channel.number(2, 1)?, 1 | 3 | 5);
        Ok(is_number.then_some(Self {
            byte: byte as usize,
            bytes: (shift + count).div_ceil(8) as usize,
            shift: shift as u32,
            count: count as u32,
            is_big_endian,
        }))
    }

    #[inline]
    fn get(&self, record: &[u8]) -> u64 {
        let Some(bytes) = record.get(self.byte..self.byte + self.bytes) else {
            return 0;
        };
        if let (&[a, b, c, d, e, f, g, h], 64, false) = (bytes, self.count, self.is_big_endian) {
            return u64::from_le_bytes([a, b, c, d, e, f, g, h]);
        }
        let joined = if self.is_big_endian {
            bytes.iter().fold(0, append_byte)
        } else {
            bytes.iter().rev().fold(0, append_byte)
        } >> self.shift;
        (joined & (u128::MAX >> (128 - self.count))) as u64
    }

    fn get_signed(&self, record: &[u8]) -> i64 {
        sign_extend(self.get(record), self.count)
    }
}

fn append_byte(number: u128, byte: &u8) -> u128 {
    number << 8 | u128::from(*byte)
}

/// Reads the lowest `count` bits, from 1 to 64, as a two's complement.
pub(super) fn sign_extend(raw: u64, count: u32) -> i64 {
    let unused = 64 - count;
    (raw << unused) as i64 >> unused
}
