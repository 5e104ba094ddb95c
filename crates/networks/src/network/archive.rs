//! Zip archives with uncompressed members, as Python's `zipfile` and PyTorch write them. The crate `zip` reads the
//! whole directory, and merges members of one name, before a program can limit the number of members.

use std::cell::Cell;

use super::NetworkError;

const FORMAT: &str = "zip archive";

const MAX_MEMBERS: usize = 4096;

#[derive(Debug)]
pub(super) struct Archive<'a> {
    bytes: &'a [u8],
    members: Vec<ArchiveMember>,
}

#[derive(Debug)]
struct ArchiveMember {
    name: String,
    method: u16,
    is_encrypted: bool,
    crc: u32,
    size: u64,
    header: u64,
    is_checked: Cell<bool>,
}

fn damaged(problem: impl Into<String>) -> NetworkError {
    NetworkError::damaged(FORMAT, problem)
}

struct ByteReader<'a>(&'a [u8]);

impl<'a> ByteReader<'a> {
    fn from_offset(bytes: &'a [u8], offset: u64) -> Result<Self, NetworkError> {
        let offset = usize::try_from(offset).unwrap_or(usize::MAX);
        bytes
            .get(offset..)
            .map(Self)
            .ok_or_else(|| damaged("it points beyond its end"))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], NetworkError> {
        let (part, rest) = self
            .0
            .split_at_checked(count)
            .ok_or_else(|| damaged("it is cut off"))?;
        self.0 = rest;
        Ok(part)
    }

    fn read_uint(&mut self, bytes: usize) -> Result<u64, NetworkError> {
        Ok(self
            .take(bytes)?
            .iter()
            .rev()
            .fold(0, |number, &byte| number << 8 | u64::from(byte)))
    }

    fn expect_signature(&mut self, wanted: &[u8; 4]) -> Result<(), NetworkError> {
        if self.take(4)? == wanted {
            Ok(())
        } else {
            Err(damaged("one of its parts is not at the stated position"))
        }
    }
}

impl<'a> Archive<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, NetworkError> {
        // The end record is searched from the end: a comment of at most 65 535 bytes may follow it.
        let earliest = bytes.len().saturating_sub(22 + 0xffff);
        let end = (earliest..bytes.len().saturating_sub(21))
            .rev()
            .find(|&at| bytes[at..].starts_with(b"PK\x05\x06"));
        let end = end.ok_or_else(|| damaged("it has no end record: the file may be cut off"))?;
        let mut record = ByteReader(&bytes[end..]);
        record.take(10)?;
        let mut count = record.read_uint(2)?;
        let _size = record.read_uint(4)?;
        let mut start = record.read_uint(4)?;
        // The zip64 end record, whose locator is right before the end record.
        if let Some(pointer) = end.checked_sub(20)
            && bytes[pointer..].starts_with(b"PK\x06\x07")
        {
            let mut locator = ByteReader(&bytes[pointer + 8..]);
            let mut record = ByteReader::from_offset(bytes, locator.read_uint(8)?)?;
            record.expect_signature(b"PK\x06\x06")?;
            record.take(28)?;
            count = record.read_uint(8)?;
            let _size = record.read_uint(8)?;
            start = record.read_uint(8)?;
        }
        let mut directory = ByteReader::from_offset(bytes, start)?;
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        if count > MAX_MEMBERS {
            return Err(damaged(format!("it has more than {MAX_MEMBERS} members")));
        }
        let members = (0..count)
            .map(|_| ArchiveMember::read(&mut directory))
            .collect::<Result<_, _>>()?;
        Ok(Self { bytes, members })
    }

    pub(super) fn has_member_with_suffix(&self, ending: &str) -> bool {
        self.members
            .iter()
            .any(|member| member.name.ends_with(ending))
    }

    pub(super) fn only_member_with_suffix(&self, ending: &str) -> Result<&str, NetworkError> {
        let mut members = self
            .members
            .iter()
            .filter(|member| member.name.ends_with(ending));
        match (members.next(), members.next()) {
            (Some(member), None) => Ok(&member.name),
            (None, _) => Err(damaged(format!("it has no member `{ending}`"))),
            (Some(_), Some(_)) => Err(damaged(format!("it has several members `{ending}`"))),
        }
    }

    pub(super) fn member(&self, name: &str) -> Result<&'a [u8], NetworkError> {
        let mut members = self.members.iter().filter(|member| member.name == name);
        let member = members
            .next()
            .ok_or_else(|| damaged(format!("it has no member `{name}`")))?;
        if members.next().is_some() {
            return Err(damaged(format!("it has several members `{name}`")));
        }
        if member.method != 0 || member.is_encrypted {
            let problem = format!(
                "member `{name}` is compressed or encrypted; save the model again, or zip it with `zip -0`"
            );
            return Err(NetworkError::Unsupported(problem));
        }
        let mut header = ByteReader::from_offset(self.bytes, member.header)?;
        header.expect_signature(b"PK\x03\x04")?;
        header.take(22)?;
        let lengths = [header.read_uint(2)?, header.read_uint(2)?];
        header.take((lengths[0] + lengths[1]) as usize)?;
        let contents = header.take(usize::try_from(member.size).unwrap_or(usize::MAX))?;
        if !member.is_checked.get() && crc32(contents) != member.crc {
            return Err(damaged(format!(
                "member `{name}` does not match its checksum"
            )));
        }
        member.is_checked.set(true);
        Ok(contents)
    }
}

impl ArchiveMember {
    fn read(directory: &mut ByteReader<'_>) -> Result<Self, NetworkError> {
        directory.expect_signature(b"PK\x01\x02")?;
        directory.take(4)?;
        let flags = directory.read_uint(2)?;
        let method = directory.read_uint(2)? as u16;
        directory.take(4)?;
        let crc = directory.read_uint(4)? as u32;
        let stored_size = directory.read_uint(4)?;
        let mut size = directory.read_uint(4)?;
        let lengths = [
            directory.read_uint(2)?,
            directory.read_uint(2)?,
            directory.read_uint(2)?,
        ]
        .map(|length| length as usize);
        directory.take(8)?;
        let mut header = directory.read_uint(4)?;
        let name = String::from_utf8_lossy(directory.take(lengths[0])?).into_owned();
        let mut extras = ByteReader(directory.take(lengths[1])?);
        directory.take(lengths[2])?;
        while extras.0.len() >= 4 {
            let kind = extras.read_uint(2)?;
            let length = extras.read_uint(2)? as usize;
            let mut extra = ByteReader(extras.take(length)?);
            // Zip64 extra field: values that do not fit into four bytes, in this order.
            if kind == 1 {
                const ZIP64_MARKER: u64 = 0xffff_ffff;
                if size == ZIP64_MARKER {
                    size = extra.read_uint(8)?;
                }
                if stored_size == ZIP64_MARKER {
                    extra.read_uint(8)?;
                }
                if header == ZIP64_MARKER {
                    header = extra.read_uint(8)?;
                }
            }
        }
        Ok(Self {
            name,
            method,
            is_encrypted: flags & 1 != 0,
            crc,
            size,
            header,
            is_checked: Cell::new(false),
        })
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0_u32; 256];
        let mut index = 0;
        while index < 256 {
            let mut value = index as u32;
            let mut bit = 0;
            while bit < 8 {
                value = if value & 1 == 1 {
                    value >> 1 ^ 0xedb8_8320
                } else {
                    value >> 1
                };
                bit += 1;
            }
            table[index] = value;
            index += 1;
        }
        table
    };
    !bytes.iter().fold(!0, |crc, &byte| {
        crc >> 8 ^ TABLE[usize::from((crc as u8) ^ byte)]
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_checksum_is_the_published_one() {
        assert_eq!(super::crc32(b"123456789"), 0xcbf4_3926);
    }
}
