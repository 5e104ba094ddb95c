//! Encodings of values.

use super::ParquetError;
use super::column::{FlatColumn, PhysicalType};

const TOO_SHORT: ParquetError = ParquetError::Damaged("a page ends before its values");
/// Maximum number of values in a block of differences.
const MAX_BLOCK_VALUES: u64 = 1 << 24;

/// A value as stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value<'b> {
    Integer(i128),
    Number(f64),
    Bytes(&'b [u8]),
}

/// Reads the values of a page, one after the other.
#[derive(Debug, Clone)]
pub(super) enum ValueReader {
    /// Values one after the other, from a byte on; truth values are bits.
    Plain { at: usize },
    /// Indices of a dictionary.
    Dictionary(Hybrid),
    /// Truth values in runs.
    Booleans(Hybrid),
    /// Differences of whole numbers.
    Delta(DeltaReader),
    /// Lengths of texts, and the texts.
    DeltaLength { lengths: DeltaReader, at: usize },
    /// The first bytes of all values, then the second ones, and so on.
    Split { from: usize, index: usize },
}

impl ValueReader {
    /// Reads values of a column from a byte on. A page has at most `most` values.
    pub(super) fn new(
        column: &FlatColumn,
        encoding: i64,
        bytes: &[u8],
        from: usize,
        most: u64,
    ) -> Result<Self, ParquetError> {
        use PhysicalType::{Boolean, Bytes, Int32, Int64};
        if from == bytes.len() {
            return Ok(Self::Plain { at: from });
        }
        let name = match (encoding, column.physical) {
            (0, Boolean) => return Ok(Self::Plain { at: 8 * from }),
            (0, _) => return Ok(Self::Plain { at: from }),
            (2 | 8, _) => {
                let width = u32::from(bytes.get(from).copied().unwrap_or(0));
                let is_possible = width <= 32;
                let indices = Self::Dictionary(Hybrid::new(from + 1, bytes.len(), width));
                return is_possible
                    .then_some(indices)
                    .ok_or(ParquetError::Damaged("an index has too many bits"));
            }
            (3, Boolean) => return Ok(Self::Booleans(Hybrid::new(from + 4, bytes.len(), 1))),
            (5, Int32 | Int64) => {
                return Ok(Self::Delta(DeltaReader::new(
                    bytes,
                    from,
                    column.physical == Int32,
                )?));
            }
            (6, Bytes) => return Self::delta_length(bytes, from, most),
            (9, physical) if physical.fixed_bytes().is_some() => {
                return Ok(Self::Split { from, index: 0 });
            }
            (7, _) => "DELTA_BYTE_ARRAY".to_owned(),
            (number, _) => format!("of number {number}"),
        };
        let column = column.shown_name();
        Err(ParquetError::Unsupported(format!(
            "the encoding {name} of the column {column}: write it as PLAIN"
        )))
    }

    fn delta_length(bytes: &[u8], from: usize, most: u64) -> Result<Self, ParquetError> {
        let lengths = DeltaReader::new(bytes, from, true)?;
        if lengths.left > most {
            return Err(ParquetError::Damaged("a page has too many texts"));
        }
        let mut end = lengths.clone();
        while end.left > 0 {
            end.next(bytes).ok_or(TOO_SHORT)?;
        }
        Ok(Self::DeltaLength {
            lengths,
            at: end.at,
        })
    }

    /// Returns the next value; an index of a dictionary as a whole number.
    pub(super) fn next<'b>(
        &mut self,
        physical: PhysicalType,
        bytes: &'b [u8],
    ) -> Result<Value<'b>, ParquetError> {
        let value = match self {
            Self::Plain { at } => next_plain(physical, bytes, at),
            Self::Dictionary(runs) | Self::Booleans(runs) => runs
                .next(bytes)
                .map(|value| Value::Integer(i128::from(value))),
            Self::Delta(numbers) => numbers
                .next(bytes)
                .map(|value| Value::Integer(i128::from(value))),
            Self::DeltaLength { lengths, at } => lengths.next(bytes).and_then(|length| {
                take(bytes, at, usize::try_from(length).ok()?).map(Value::Bytes)
            }),
            Self::Split { from, index } => {
                let value = next_split(physical, bytes.get(*from..).unwrap_or_default(), *index);
                *index += 1;
                value
            }
        };
        value.ok_or(TOO_SHORT)
    }
}

impl PhysicalType {
    /// Returns the size of values that are whole bytes of a known number.
    fn fixed_bytes(self) -> Option<usize> {
        match self {
            Self::Int32 | Self::Float => Some(4),
            Self::Int64 | Self::Double => Some(8),
            Self::Int96 => Some(12),
            Self::FixedBytes(count) => Some(count),
            Self::Boolean | Self::Bytes => None,
        }
    }
}

impl<'b> Value<'b> {
    /// Reads a value of a known size.
    pub(super) fn from_fixed(physical: PhysicalType, bytes: &'b [u8]) -> Option<Self> {
        Some(match physical {
            PhysicalType::Int32 => {
                Self::Integer(i128::from(i32::from_le_bytes(bytes.try_into().ok()?)))
            }
            PhysicalType::Int64 => {
                Self::Integer(i128::from(i64::from_le_bytes(bytes.try_into().ok()?)))
            }
            PhysicalType::Float => {
                Self::Number(f64::from(f32::from_le_bytes(bytes.try_into().ok()?)))
            }
            PhysicalType::Double => Self::Number(f64::from_le_bytes(bytes.try_into().ok()?)),
            PhysicalType::Int96 => Self::Integer(milliseconds(bytes)?),
            PhysicalType::FixedBytes(_) => Self::Bytes(bytes),
            PhysicalType::Boolean | PhysicalType::Bytes => return None,
        })
    }

    /// Returns the value of a dictionary with an index; `None` for a text, and behind the end.
    pub(super) fn from_dictionary(
        physical: PhysicalType,
        bytes: &'b [u8],
        index: usize,
    ) -> Option<Self> {
        let size = physical.fixed_bytes()?;
        let from = index.checked_mul(size)?;
        Self::from_fixed(physical, bytes.get(from..from.checked_add(size)?)?)
    }
}

/// Returns the milliseconds since 1970 of nanoseconds of a day and its Julian number.
fn milliseconds(bytes: &[u8]) -> Option<i128> {
    const JULIAN_DAY_OF_1970: i128 = 2_440_588;
    const MILLISECONDS_OF_A_DAY: i128 = 86_400_000;
    let nanoseconds = bytes.get(..8)?.try_into().ok()?;
    let nanoseconds = i128::from(i64::from_le_bytes(nanoseconds));
    let day = i128::from(i32::from_le_bytes(bytes.get(8..)?.try_into().ok()?));
    Some((day - JULIAN_DAY_OF_1970) * MILLISECONDS_OF_A_DAY + nanoseconds / 1_000_000)
}

fn take<'b>(bytes: &'b [u8], at: &mut usize, count: usize) -> Option<&'b [u8]> {
    let taken = bytes.get(*at..at.checked_add(count)?)?;
    *at += count;
    Some(taken)
}

fn next_plain<'b>(physical: PhysicalType, bytes: &'b [u8], at: &mut usize) -> Option<Value<'b>> {
    match (physical, physical.fixed_bytes()) {
        (_, Some(size)) => Value::from_fixed(physical, take(bytes, at, size)?),
        (PhysicalType::Boolean, None) => {
            let bit = read_bits(bytes, *at, 1)?;
            *at += 1;
            Some(Value::Integer(i128::from(bit)))
        }
        (_, None) => {
            let length = u32::from_le_bytes(take(bytes, at, 4)?.try_into().ok()?);
            take(bytes, at, length as usize).map(Value::Bytes)
        }
    }
}

fn next_split<'b>(physical: PhysicalType, bytes: &'b [u8], index: usize) -> Option<Value<'b>> {
    const MAX_SPLIT_BYTES: usize = 12;
    let size = physical
        .fixed_bytes()
        .filter(|size| *size <= MAX_SPLIT_BYTES)?;
    let count = bytes.len() / size;
    if index >= count {
        return None;
    }
    let mut joined = [0; MAX_SPLIT_BYTES];
    for (stream, byte) in joined.iter_mut().take(size).enumerate() {
        *byte = *bytes.get(stream * count + index)?;
    }
    match Value::from_fixed(physical, joined.get(..size)?)? {
        Value::Integer(number) => Some(Value::Integer(number)),
        Value::Number(number) => Some(Value::Number(number)),
        Value::Bytes(_) => None,
    }
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.get(*at)?;
        *at += 1;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

fn zigzag(bytes: &[u8], at: &mut usize) -> Option<i64> {
    let value = varint(bytes, at)?;
    Some((value >> 1) as i64 ^ -((value & 1) as i64))
}

/// Returns up to 64 bits, the first one in the lowest place.
fn read_bits(bytes: &[u8], bit: usize, count: u32) -> Option<u64> {
    let from = bit / 8;
    let shift = (bit % 8) as u32;
    let needed = (shift + count).div_ceil(8) as usize;
    let mut joined = [0; 16];
    joined
        .get_mut(..needed)?
        .copy_from_slice(bytes.get(from..from.checked_add(needed)?)?);
    let mask = if count == 64 {
        u64::MAX
    } else {
        (1 << count) - 1
    };
    Some((u128::from_le_bytes(joined) >> shift) as u64 & mask)
}

/// Small numbers in runs, or packed into bits.
#[derive(Debug, Clone)]
pub(super) struct Hybrid {
    at: usize,
    end: usize,
    width: u32,
    /// Number of values left in the run.
    left: u64,
    /// Value of the run, or the bit of its next value.
    run: HybridRun,
}

#[derive(Debug, Clone, Copy)]
enum HybridRun {
    Repeated(u64),
    Packed { bit: usize },
}

impl Hybrid {
    /// Reads numbers of `width` bits, at most 32, from bytes.
    pub(super) fn new(at: usize, end: usize, width: u32) -> Self {
        Self {
            at,
            end,
            width,
            left: 0,
            run: HybridRun::Repeated(0),
        }
    }

    /// Returns the next number; `None` behind the end.
    pub(super) fn next(&mut self, bytes: &[u8]) -> Option<u64> {
        let bytes = bytes.get(..self.end)?;
        while self.left == 0 {
            let header = varint(bytes, &mut self.at)?;
            let count = header >> 1;
            if header & 1 == 1 {
                self.run = HybridRun::Packed {
                    bit: self.at.checked_mul(8)?,
                };
                self.left = count.saturating_mul(8);
                let size = usize::try_from(count)
                    .ok()?
                    .saturating_mul(self.width as usize);
                self.at = self.at.saturating_add(size).min(self.end);
            } else {
                let value = take(bytes, &mut self.at, self.width.div_ceil(8) as usize)?;
                self.run = HybridRun::Repeated(
                    value
                        .iter()
                        .rev()
                        .fold(0, |all, byte| all << 8 | u64::from(*byte)),
                );
                self.left = count;
            }
        }
        self.left -= 1;
        match &mut self.run {
            HybridRun::Repeated(value) => Some(*value),
            HybridRun::Packed { bit } => {
                let value = read_bits(bytes, *bit, self.width)?;
                *bit += self.width as usize;
                Some(value)
            }
        }
    }
}

/// Whole numbers as differences, in blocks whose parts have one number of bits each.
#[derive(Debug, Clone)]
pub(super) struct DeltaReader {
    /// End of the current part.
    at: usize,
    /// Number of parts of a block, and of values of a part.
    parts: usize,
    part_values: usize,
    /// Number of values left.
    left: u64,
    value: i64,
    is_first: bool,
    is_32_bits: bool,
    smallest: i64,
    /// Place of the numbers of bits of the block.
    widths_at: usize,
    /// Index of the current part, its number of bits, its next bit, and the number of its values left.
    part: usize,
    width: u32,
    bit: usize,
    part_left: usize,
}

impl DeltaReader {
    fn new(bytes: &[u8], from: usize, is_32_bits: bool) -> Result<Self, ParquetError> {
        Self::read_header(bytes, from, is_32_bits)
            .ok_or(ParquetError::Damaged("the header of differences is wrong"))
    }

    fn read_header(bytes: &[u8], mut at: usize, is_32_bits: bool) -> Option<Self> {
        let block = varint(bytes, &mut at)?;
        let parts = varint(bytes, &mut at)?;
        let left = varint(bytes, &mut at)?;
        let value = zigzag(bytes, &mut at)?;
        let part_values = block.checked_div(parts)?;
        if block > MAX_BLOCK_VALUES || part_values == 0 || part_values % 8 != 0 {
            return None;
        }
        Some(Self {
            at,
            parts: parts as usize,
            part_values: part_values as usize,
            left,
            value,
            is_first: true,
            is_32_bits,
            smallest: 0,
            widths_at: 0,
            part: parts as usize,
            width: 0,
            bit: 0,
            part_left: 0,
        })
    }

    fn next(&mut self, bytes: &[u8]) -> Option<i64> {
        self.left = self.left.checked_sub(1)?;
        if std::mem::take(&mut self.is_first) {
            return Some(self.value);
        }
        if self.part_left == 0 {
            self.begin_part(bytes)?;
        }
        self.part_left -= 1;
        let difference = read_bits(bytes, self.bit, self.width)?;
        self.bit += self.width as usize;
        self.value = self
            .value
            .wrapping_add(self.smallest)
            .wrapping_add(difference as i64);
        if self.is_32_bits {
            self.value = i64::from(self.value as i32);
        }
        Some(self.value)
    }

    fn begin_part(&mut self, bytes: &[u8]) -> Option<()> {
        self.part += 1;
        if self.part >= self.parts {
            self.smallest = zigzag(bytes, &mut self.at)?;
            self.widths_at = self.at;
            take(bytes, &mut self.at, self.parts)?;
            self.part = 0;
        }
        self.width = u32::from(*bytes.get(self.widths_at + self.part)?);
        if self.width > 64 {
            return None;
        }
        self.bit = self.at.checked_mul(8)?;
        self.at += self.part_values / 8 * self.width as usize;
        self.part_left = self.part_values;
        Some(())
    }
}
