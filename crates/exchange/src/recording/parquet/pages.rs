//! Pages of a column: headers, and decompressed bytes.

use super::codec::Codec;
use super::footer::ColumnChunk;
use super::thrift::{ThriftProblem, ThriftReader};
use super::{FileBytes, ParquetError};

/// Sizes that are read for a header, one after the other until it is complete; texts of statistics may be long.
const HEADER_BYTES: [u64; 3] = [256, 64 << 10, 4 << 20];
/// Maximum size of a page after decompression. Writers begin another page at about a megabyte.
const MAX_PAGE_BYTES: u64 = 64 << 20;
/// Maximum size of all pages and dictionaries in memory.
const MAX_BYTES_IN_MEMORY: u64 = 256 << 20;

/// A page with values or with a dictionary.
pub(super) struct Page {
    pub(super) bytes: Vec<u8>,
    pub(super) header: PageHeader,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PageKind {
    Dictionary,
    /// Levels have their length before them.
    DataV1,
    /// Levels are not compressed.
    DataV2 {
        definition_bytes: usize,
    },
    Other,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct PageHeader {
    pub(super) kind: PageKind,
    pub(super) values: u64,
    pub(super) encoding: i64,
    pub(super) level_encoding: i64,
    plain_bytes: u64,
    packed_bytes: u64,
    repetition_bytes: u64,
    is_compressed: bool,
}

impl PageHeader {
    fn read(reader: &mut ThriftReader<'_>) -> Result<Self, ThriftProblem> {
        let mut header = Self {
            kind: PageKind::Other,
            values: 0,
            encoding: 0,
            level_encoding: 3,
            plain_bytes: 0,
            packed_bytes: 0,
            repetition_bytes: 0,
            is_compressed: true,
        };
        let mut page_type = 0;
        let mut definition_bytes = 0;
        reader.read_struct(|reader, id, kind| {
            match id {
                1 => page_type = reader.number(kind)?,
                2 => header.plain_bytes = reader.size(kind)?,
                3 => header.packed_bytes = reader.size(kind)?,
                // Headers of the data of version 1, of a dictionary, and of the data of version 2.
                5 | 7 | 8 => reader.read_struct(|reader, field, kind| {
                    match (id, field) {
                        (_, 1) => header.values = reader.size(kind)?,
                        (5 | 7, 2) | (8, 4) => header.encoding = reader.number(kind)?,
                        (5, 3) => header.level_encoding = reader.number(kind)?,
                        (8, 5) => definition_bytes = reader.size(kind)? as usize,
                        (8, 6) => header.repetition_bytes = reader.size(kind)?,
                        (8, 7) => {
                            header.is_compressed = ThriftReader::boolean(kind);
                            reader.skip(kind)?;
                        }
                        _ => reader.skip(kind)?,
                    }
                    Ok::<_, ThriftProblem>(())
                })?,
                _ => reader.skip(kind)?,
            }
            Ok::<_, ThriftProblem>(())
        })?;
        header.kind = match page_type {
            0 => PageKind::DataV1,
            2 => PageKind::Dictionary,
            3 => PageKind::DataV2 { definition_bytes },
            _ => PageKind::Other,
        };
        Ok(header)
    }
}

/// Reads the next page of a column, and moves behind it; `None` at the end.
pub(super) fn next_page(
    file: &mut FileBytes,
    chunk: &mut ColumnChunk,
) -> Result<Option<Page>, ParquetError> {
    while chunk.at < chunk.end {
        let header = next_header(file, chunk)?;
        if header.packed_bytes > chunk.end - chunk.at {
            return Err(ParquetError::Damaged("a page is longer than its column"));
        }
        let at = chunk.at;
        chunk.at += header.packed_bytes;
        if header.kind == PageKind::Other {
            continue;
        }
        file.reserve_page(header.plain_bytes)?;
        let packed = file.read(at, header.packed_bytes)?;
        return Ok(Some(Page {
            bytes: decompress(packed, &header, chunk.codec)?,
            header,
        }));
    }
    Ok(None)
}

impl FileBytes {
    /// Counts the bytes of a page after decompression.
    fn reserve_page(&mut self, plain_bytes: u64) -> Result<(), ParquetError> {
        if plain_bytes > MAX_PAGE_BYTES {
            return Err(ParquetError::TooLarge {
                limit: MAX_PAGE_BYTES,
                what: "bytes in a page",
            });
        }
        let too_large = ParquetError::TooLarge {
            limit: super::limits::max_decompressed_bytes(self.length),
            what: "bytes after decompression",
        };
        self.decompressed_left = self
            .decompressed_left
            .checked_sub(plain_bytes)
            .ok_or(too_large)?;
        self.bytes_in_memory += plain_bytes;
        if self.bytes_in_memory > MAX_BYTES_IN_MEMORY {
            return Err(ParquetError::TooLarge {
                limit: MAX_BYTES_IN_MEMORY,
                what: "bytes of pages at one row",
            });
        }
        Ok(())
    }
}

fn next_header(file: &mut FileBytes, chunk: &mut ColumnChunk) -> Result<PageHeader, ParquetError> {
    for size in HEADER_BYTES {
        let bytes = file.read(chunk.at, size.min(chunk.end - chunk.at))?;
        let mut reader = ThriftReader::new(&bytes);
        match PageHeader::read(&mut reader) {
            Ok(header) => {
                chunk.at += reader.at as u64;
                let used = header.packed_bytes.saturating_add(reader.at as u64);
                let shared = ParquetError::Damaged("two columns share their pages");
                file.unread = file.unread.checked_sub(used).ok_or(shared)?;
                return Ok(header);
            }
            Err(ThriftProblem::CutShort) if size < chunk.end - chunk.at => {}
            Err(problem) => return Err(problem.into()),
        }
    }
    Err(ParquetError::Damaged("the header of a page is too long"))
}

fn decompress(
    mut packed: Vec<u8>,
    header: &PageHeader,
    codec: Codec,
) -> Result<Vec<u8>, ParquetError> {
    let codec = if header.is_compressed {
        codec
    } else {
        Codec::None
    };
    let size = header.plain_bytes as usize;
    let PageKind::DataV2 { definition_bytes } = header.kind else {
        return codec.decompress(packed, size);
    };
    let damaged = ParquetError::Damaged("the levels of a page are longer than the page");
    let levels = definition_bytes
        .checked_add(header.repetition_bytes as usize)
        .filter(|levels| *levels <= size);
    let Some(levels) = levels.filter(|levels| *levels <= packed.len()) else {
        return Err(damaged);
    };
    if header.repetition_bytes != 0 {
        return Err(ParquetError::Damaged(
            "a column that is not repeated has levels of repetition",
        ));
    }
    let values = packed.split_off(levels);
    // Pages without values are not compressed.
    let plain = if values.is_empty() {
        values
    } else {
        codec.decompress(values, size - levels)?
    };
    packed.extend_from_slice(&plain);
    Ok(packed)
}
