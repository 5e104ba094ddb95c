//! Blocks of an MDF 4 file: links, data, texts, and lists of data blocks.

use std::collections::HashSet;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use flate2::read::ZlibDecoder;

use super::{MdfError, MdfSource};
use crate::recording::limits;

/// Maximum size of a block without samples.
const MAX_BLOCK_BYTES: u64 = 1 << 20;
/// Maximum size of a compressed block, before and after; writers compress at most 4 MiB at once.
const MAX_COMPRESSED_BYTES: u64 = 64 << 20;
const CHUNK_BYTES: u64 = 1 << 20;
const HEADER_BYTES: u64 = 24;
/// Bytes of blocks without samples that may be read, beside the length of the file: links may name a block repeatedly.
const EXTRA_METADATA_BYTES: u64 = 32 << 20;

pub(super) struct Blocks {
    source: Box<dyn MdfSource>,
    length: u64,
    /// Blocks that may occur only once, so that links form no circle.
    visited: HashSet<u64>,
    /// Bytes of blocks without samples that may still be read.
    metadata_left: u64,
    /// Bytes of blocks with samples that may still be read; no two blocks share bytes.
    samples_left: u64,
    /// Bytes that compressed blocks may still have after decompression.
    decompressed_left: u64,
}

pub(super) struct Block {
    pub(super) at: u64,
    links: Vec<u64>,
    data: Vec<u8>,
}

/// Type of a block: the two letters after `##`.
type BlockType = [u8; 2];

struct Header {
    kind: BlockType,
    bytes: u64,
    links: u64,
}

impl Blocks {
    pub(super) fn new(mut source: Box<dyn MdfSource>) -> Result<Self, MdfError> {
        let length = source.seek(SeekFrom::End(0))?;
        let mut blocks = Self {
            source,
            length,
            visited: HashSet::new(),
            metadata_left: length.saturating_add(EXTRA_METADATA_BYTES),
            samples_left: length,
            decompressed_left: limits::max_decompressed_bytes(length),
        };
        let identification = blocks.bytes(0, 64)?;
        let version = little_endian(&identification, 28, 2).unwrap_or(0);
        if !(400..500).contains(&version) {
            return Err(MdfError::Unsupported(
                "a version of MDF other than 4".to_owned(),
            ));
        }
        if identification.starts_with(b"UnFinMF") {
            return Err(MdfError::Unsupported(
                "an unfinished file: finalise it with the program that wrote it".to_owned(),
            ));
        }
        Ok(blocks)
    }

    /// Returns the size of the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.length
    }

    pub(super) fn bytes(&mut self, at: u64, count: u64) -> Result<Vec<u8>, MdfError> {
        if at.checked_add(count).is_none_or(|end| end > self.length) {
            return Err(damaged(at, "the file ends before the block"));
        }
        let mut bytes = vec![0; count as usize];
        self.source.seek(SeekFrom::Start(at))?;
        self.source.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn header(&mut self, at: u64) -> Result<Header, MdfError> {
        self.use_metadata(at, HEADER_BYTES)?;
        let header = self.bytes(at, HEADER_BYTES)?;
        let [b'#', b'#', first, second, ..] = header[..] else {
            return Err(damaged(at, "no block begins here"));
        };
        let bytes = little_endian(&header, 8, 8).unwrap_or(0);
        let links = little_endian(&header, 16, 8).unwrap_or(0);
        if bytes < HEADER_BYTES || links > (bytes - HEADER_BYTES) / 8 {
            return Err(damaged(at, "the length of the block is wrong"));
        }
        Ok(Header {
            kind: [first, second],
            bytes,
            links,
        })
    }

    /// Returns a block of a known type; `None` for an empty link.
    pub(super) fn find(&mut self, at: u64, kind: &BlockType) -> Result<Option<Block>, MdfError> {
        if at == 0 {
            Ok(None)
        } else {
            self.read(at, kind).map(Some)
        }
    }

    /// Returns a block that only one link may name.
    pub(super) fn find_once(
        &mut self,
        at: u64,
        kind: &BlockType,
    ) -> Result<Option<Block>, MdfError> {
        if at != 0 {
            self.visit(at)?;
        }
        self.find(at, kind)
    }

    fn use_metadata(&mut self, at: u64, bytes: u64) -> Result<(), MdfError> {
        let problem = "the links name the same blocks too often";
        self.metadata_left = self
            .metadata_left
            .checked_sub(bytes)
            .ok_or(damaged(at, problem))?;
        Ok(())
    }

    /// Returns whether a link names a block of a type.
    pub(super) fn is_of_type(&mut self, at: u64, kind: &BlockType) -> bool {
        at != 0 && self.header(at).is_ok_and(|header| header.kind == *kind)
    }

    pub(super) fn read(&mut self, at: u64, kind: &BlockType) -> Result<Block, MdfError> {
        let header = self.header(at)?;
        if header.kind != *kind || header.bytes > MAX_BLOCK_BYTES {
            return Err(damaged(at, "the block is of another type or too long"));
        }
        self.use_metadata(at, header.bytes)?;
        let content = self.bytes(at + HEADER_BYTES, header.bytes - HEADER_BYTES)?;
        let (links, data) = content.split_at(8 * header.links as usize);
        let links = links
            .chunks_exact(8)
            .map(|link| little_endian(link, 0, 8).unwrap_or(0))
            .collect();
        Ok(Block {
            at,
            links,
            data: data.to_vec(),
        })
    }

    /// Returns the text of a text block, or of the first `TX` element of a metadata block; empty for an empty link.
    pub(super) fn text(&mut self, at: u64) -> Result<String, MdfError> {
        if at == 0 {
            return Ok(String::new());
        }
        let kind = self.header(at)?.kind;
        if !matches!(&kind, b"TX" | b"MD") {
            return Err(damaged(at, "the block is no text"));
        }
        let block = self.read(at, &kind)?;
        let text = String::from_utf8_lossy(&block.data);
        let text = text.split('\0').next().unwrap_or_default();
        let element = text
            .split_once("<TX>")
            .and_then(|(_, rest)| rest.split_once("</TX>"));
        Ok(element.map_or(text, |(inner, _)| inner).trim().to_owned())
    }

    /// Marks a block that only one link may name.
    fn visit(&mut self, at: u64) -> Result<(), MdfError> {
        if self.visited.insert(at) {
            Ok(())
        } else {
            Err(damaged(at, "two links name the block"))
        }
    }

    /// Returns the offsets of the data blocks behind a link, in order.
    pub(super) fn data_blocks(&mut self, mut at: u64) -> Result<Vec<u64>, MdfError> {
        let mut offsets = Vec::new();
        while at != 0 {
            self.visit(at)?;
            match &self.header(at)?.kind {
                b"DT" | b"DZ" => {
                    offsets.push(at);
                    break;
                }
                b"HL" => at = self.read(at, b"HL")?.link(0),
                b"DL" => {
                    let list = self.read(at, b"DL")?;
                    for &block in list.links.iter().skip(1).filter(|link| **link != 0) {
                        self.visit(block)?;
                        offsets.push(block);
                    }
                    at = list.link(0);
                }
                b"LD" | b"DV" => {
                    return Err(MdfError::Unsupported("samples stored by column".to_owned()));
                }
                _ => return Err(damaged(at, "the block holds no samples")),
            }
        }
        Ok(offsets)
    }

    fn decompress(&mut self, at: u64) -> Result<Vec<u8>, MdfError> {
        let CompressedHeader {
            kind,
            columns,
            original,
            compressed,
        } = CompressedHeader::parse(&self.bytes(at + HEADER_BYTES, 24)?);
        if kind > 1 {
            return Err(MdfError::Unsupported(
                "a compression other than deflate".to_owned(),
            ));
        }
        if original.max(compressed) > MAX_COMPRESSED_BYTES {
            return Err(damaged(at, "the compressed block is too long"));
        }
        let limit = limits::max_decompressed_bytes(self.length);
        let what = "bytes after decompression";
        self.decompressed_left = self
            .decompressed_left
            .checked_sub(original)
            .ok_or(MdfError::TooLarge { limit, what })?;
        let packed = self.bytes(at + HEADER_BYTES + 24, compressed)?;
        let mut plain = Vec::with_capacity(original as usize);
        let unpacked = ZlibDecoder::new(&packed[..])
            .take(original)
            .read_to_end(&mut plain);
        if unpacked.is_err() || plain.len() as u64 != original {
            return Err(damaged(at, "the compressed block cannot be decompressed"));
        }
        let rows = plain.len().checked_div(columns).unwrap_or(0);
        if kind == 1 && columns > 1 && rows > 1 {
            return Ok(transpose(plain, columns, rows));
        }
        Ok(plain)
    }
}

/// Start of a compressed block.
struct CompressedHeader {
    /// 0 for deflate, and 1 for deflate of bytes that are stored column by column.
    kind: u64,
    /// Number of columns of such bytes.
    columns: usize,
    /// Number of bytes before and after compression.
    original: u64,
    compressed: u64,
}

impl CompressedHeader {
    /// Parses the fields before the compressed bytes.
    fn parse(bytes: &[u8]) -> Self {
        Self {
            kind: little_endian(bytes, 2, 1).unwrap_or(0),
            columns: little_endian(bytes, 4, 4).unwrap_or(0) as usize,
            original: little_endian(bytes, 8, 8).unwrap_or(0),
            compressed: little_endian(bytes, 16, 8).unwrap_or(0),
        }
    }
}

/// Returns bytes that are stored column by column, row by row. Bytes behind the last row stay in their places.
fn transpose(plain: Vec<u8>, columns: usize, rows: usize) -> Vec<u8> {
    // A number of rows whose bytes stay in the cache.
    const BLOCK_ROWS: usize = 64;
    let mut rows_first = plain.clone();
    let Some(by_row) = rows_first.get_mut(..columns * rows) else {
        return plain;
    };
    let by_column = &plain[..by_row.len()];
    for (block, target) in by_row.chunks_mut(BLOCK_ROWS * columns).enumerate() {
        for (column, source) in by_column.chunks_exact(rows).enumerate() {
            let source = source.iter().skip(block * BLOCK_ROWS);
            for (row, byte) in target.chunks_exact_mut(columns).zip(source) {
                row[column] = *byte;
            }
        }
    }
    rows_first
}

/// Data blocks, read in chunks.
pub(super) struct DataCursor {
    offsets: std::vec::IntoIter<u64>,
    /// Rest of the current block.
    rest: Range<u64>,
}

impl DataCursor {
    pub(super) fn new(offsets: Vec<u64>) -> Self {
        Self {
            offsets: offsets.into_iter(),
            rest: 0..0,
        }
    }

    pub(super) fn next_chunk(&mut self, blocks: &mut Blocks) -> Result<Option<Vec<u8>>, MdfError> {
        while self.rest.is_empty() {
            let Some(at) = self.offsets.next() else {
                return Ok(None);
            };
            let header = blocks.header(at)?;
            let shared = damaged(at, "two blocks with samples share bytes");
            blocks.samples_left = blocks
                .samples_left
                .checked_sub(header.bytes)
                .ok_or(shared)?;
            match &header.kind {
                b"DT" => {
                    self.rest =
                        at + HEADER_BYTES + 8 * header.links..at.saturating_add(header.bytes)
                }
                b"DZ" => return blocks.decompress(at).map(Some),
                _ => return Err(damaged(at, "the block holds no samples")),
            }
        }
        let from = self.rest.start;
        let count = CHUNK_BYTES.min(self.rest.end - from);
        self.rest.start += count;
        blocks.bytes(from, count).map(Some)
    }
}

impl Block {
    pub(super) fn link(&self, index: usize) -> u64 {
        self.links.get(index).copied().unwrap_or(0)
    }

    /// Returns an unsigned number of the data.
    pub(super) fn number(&self, from: usize, count: usize) -> Result<u64, MdfError> {
        little_endian(&self.data, from, count)
            .ok_or_else(|| damaged(self.at, "the block is too short"))
    }

    /// Returns all 64-bit floating point numbers of the data from an offset on.
    pub(super) fn floats(&self, from: usize) -> Vec<f64> {
        let bytes = self.data.get(from..).unwrap_or_default();
        bytes
            .chunks_exact(8)
            .map(|eight| f64::from_bits(little_endian(eight, 0, 8).unwrap_or(0)))
            .collect()
    }

    pub(super) fn damaged(&self, problem: &'static str) -> MdfError {
        damaged(self.at, problem)
    }
}

fn damaged(offset: u64, problem: &'static str) -> MdfError {
    MdfError::Damaged { offset, problem }
}

/// Returns an unsigned number of up to 8 bytes.
pub(super) fn little_endian(bytes: &[u8], from: usize, count: usize) -> Option<u64> {
    let mut padded = [0; 8];
    padded
        .get_mut(..count)?
        .copy_from_slice(bytes.get(from..from.checked_add(count)?)?);
    Some(u64::from_le_bytes(padded))
}

impl From<io::Error> for MdfError {
    fn from(error: io::Error) -> Self {
        Self::Read(error.to_string())
    }
}
