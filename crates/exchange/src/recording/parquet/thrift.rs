//! Structures in Thrift's compact protocol, with bounded depth and sizes.

use super::ParquetError;

/// Maximum depth of structures and lists that are skipped.
const MAX_DEPTH: usize = 32;
const TRUE: u8 = 1;
const FALSE: u8 = 2;
const BYTE: u8 = 3;
const DOUBLE: u8 = 7;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
const MAP: u8 = 11;
const STRUCT: u8 = 12;
const UUID: u8 = 13;

/// Reason why a structure cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ThriftProblem {
    /// The bytes end too early.
    CutShort,
    Damaged,
}

impl From<ThriftProblem> for ParquetError {
    fn from(_: ThriftProblem) -> Self {
        Self::Damaged("its metadata breaks the rules of Thrift")
    }
}

type Read<T> = Result<T, ThriftProblem>;

pub(super) struct ThriftReader<'b> {
    bytes: &'b [u8],
    /// Number of bytes that were read.
    pub(super) at: usize,
}

/// Type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ValueType(u8);

impl<'b> ThriftReader<'b> {
    pub(super) fn new(bytes: &'b [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn byte(&mut self) -> Read<u8> {
        let byte = self
            .bytes
            .get(self.at)
            .copied()
            .ok_or(ThriftProblem::CutShort)?;
        self.at += 1;
        Ok(byte)
    }

    fn take(&mut self, count: usize) -> Read<&'b [u8]> {
        let end = self.at.checked_add(count).ok_or(ThriftProblem::Damaged)?;
        let taken = self
            .bytes
            .get(self.at..end)
            .ok_or(ThriftProblem::CutShort)?;
        self.at = end;
        Ok(taken)
    }

    fn varint(&mut self) -> Read<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(ThriftProblem::Damaged)
    }

    fn zigzag(&mut self) -> Read<i64> {
        let value = self.varint()?;
        Ok((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    /// Calls `read` with id and type of each field of a structure; it must read or skip the value.
    pub(super) fn read_struct<E: From<ThriftProblem>>(
        &mut self,
        mut read: impl FnMut(&mut Self, i64, ValueType) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut id = 0;
        loop {
            let header = self.byte()?;
            let step = header >> 4;
            let kind = header & 0xf;
            if kind == 0 {
                return Ok(());
            }
            id = if step == 0 {
                self.zigzag()?
            } else {
                id + i64::from(step)
            };
            if !(0..=i64::from(i16::MAX)).contains(&id) {
                return Err(ThriftProblem::Damaged.into());
            }
            read(self, id, ValueType(kind))?;
        }
    }

    /// Reads a whole number.
    pub(super) fn number(&mut self, kind: ValueType) -> Read<i64> {
        match kind.0 {
            BYTE => Ok(i64::from(self.byte()? as i8)),
            4..=6 => self.zigzag(),
            _ => Err(ThriftProblem::Damaged),
        }
    }

    /// Reads a whole number that is not negative.
    pub(super) fn size(&mut self, kind: ValueType) -> Read<u64> {
        u64::try_from(self.number(kind)?).map_err(|_| ThriftProblem::Damaged)
    }

    pub(super) fn boolean(kind: ValueType) -> bool {
        kind.0 == TRUE
    }

    /// Reads a text or bytes.
    pub(super) fn binary(&mut self, kind: ValueType) -> Read<&'b [u8]> {
        if kind.0 != BINARY {
            return Err(ThriftProblem::Damaged);
        }
        let length = self.varint()?;
        self.take(usize::try_from(length).map_err(|_| ThriftProblem::Damaged)?)
    }

    /// Reads the number of elements of a list of structures. Each takes a byte or more.
    pub(super) fn structs(&mut self, kind: ValueType) -> Read<usize> {
        let (count, element) = self.list(kind)?;
        if count > 0 && element.0 != STRUCT {
            Err(ThriftProblem::Damaged)
        } else {
            Ok(count)
        }
    }

    fn list(&mut self, kind: ValueType) -> Read<(usize, ValueType)> {
        if !matches!(kind.0, LIST | SET) {
            return Err(ThriftProblem::Damaged);
        }
        let header = self.byte()?;
        let count = if header >> 4 == 15 {
            self.varint()?
        } else {
            u64::from(header >> 4)
        };
        Ok((self.check_count(count)?, ValueType(header & 0xf)))
    }

    fn check_count(&self, count: u64) -> Read<usize> {
        let left = self.bytes.len() - self.at;
        usize::try_from(count)
            .ok()
            .filter(|count| *count <= left)
            .ok_or(ThriftProblem::CutShort)
    }

    pub(super) fn skip(&mut self, kind: ValueType) -> Read<()> {
        self.skip_within(kind, 0)
    }

    fn skip_within(&mut self, kind: ValueType, depth: usize) -> Read<()> {
        if depth > MAX_DEPTH {
            return Err(ThriftProblem::Damaged);
        }
        match kind.0 {
            TRUE | FALSE => Ok(()),
            BYTE..=6 => self.number(kind).map(drop),
            DOUBLE => self.take(8).map(drop),
            BINARY => self.binary(kind).map(drop),
            LIST | SET => {
                let (count, element) = self.list(kind)?;
                (0..count).try_for_each(|_| self.skip_element(element, depth))
            }
            MAP => {
                let count = self.varint()?;
                let count = self.check_count(count)?;
                let types = if count > 0 { self.byte()? } else { 0 };
                (0..count).try_for_each(|_| {
                    self.skip_element(ValueType(types >> 4), depth)?;
                    self.skip_element(ValueType(types & 0xf), depth)
                })
            }
            STRUCT => self.read_struct(|reader, _, kind| reader.skip_within(kind, depth + 1)),
            UUID => self.take(16).map(drop),
            _ => Err(ThriftProblem::Damaged),
        }
    }

    /// Skips an element of a list; truth values take a byte there.
    fn skip_element(&mut self, kind: ValueType, depth: usize) -> Read<()> {
        if matches!(kind.0, TRUE | FALSE) {
            self.byte().map(drop)
        } else {
            self.skip_within(kind, depth + 1)
        }
    }
}
