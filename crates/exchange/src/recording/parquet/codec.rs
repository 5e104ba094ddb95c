//! Compression of pages.

use std::io::Read;

use flate2::read::MultiGzDecoder;

use super::ParquetError;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    None,
    Snappy,
    Gzip,
    Zstd,
}

impl Codec {
    pub(super) fn from_id(id: i64) -> Result<Self, ParquetError> {
        let method = match id {
            0 => return Ok(Self::None),
            1 => return Ok(Self::Snappy),
            2 => return Ok(Self::Gzip),
            6 => return Ok(Self::Zstd),
            3 => "LZO",
            4 => "Brotli",
            5 | 7 => "LZ4",
            _ => "an unknown method",
        };
        Err(ParquetError::Unsupported(format!(
            "compression with {method}: use zstd, gzip, Snappy or none"
        )))
    }

    /// Decompresses bytes to a known size.
    pub(super) fn decompress(self, packed: Vec<u8>, size: usize) -> Result<Vec<u8>, ParquetError> {
        const DAMAGED: ParquetError = ParquetError::Damaged("a page cannot be decompressed");
        let plain = match self {
            Self::None => packed,
            Self::Snappy => {
                if snap::raw::decompress_len(&packed).ok() != Some(size) {
                    return Err(DAMAGED);
                }
                snap::raw::Decoder::new()
                    .decompress_vec(&packed)
                    .map_err(|_| DAMAGED)?
            }
            Self::Gzip => read_at_most(MultiGzDecoder::new(&packed[..]), size).ok_or(DAMAGED)?,
            Self::Zstd => {
                let decoder =
                    ruzstd::decoding::StreamingDecoder::new(&packed[..]).map_err(|_| DAMAGED)?;
                read_at_most(decoder, size).ok_or(DAMAGED)?
            }
        };
        if plain.len() == size {
            Ok(plain)
        } else {
            Err(DAMAGED)
        }
    }
}

/// Reads all bytes, at most one more than `size`; `None` if the reader fails.
fn read_at_most(reader: impl Read, size: usize) -> Option<Vec<u8>> {
    let mut plain = Vec::with_capacity(size);
    reader.take(size as u64 + 1).read_to_end(&mut plain).ok()?;
    Some(plain)
}
