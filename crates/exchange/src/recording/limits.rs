//! Limits of the work that a file can cause: memory and time stay bounded, however small the file is.

/// Size up to which every file has the same limits, in bytes.
const SMALL_FILE_BYTES: u64 = 16 << 20;

/// Returns the largest number of bytes after decompression.
pub(super) fn max_decompressed_bytes(file_bytes: u64) -> u64 {
    allowance(512 << 20, 64, file_bytes)
}

/// Returns the largest number of rows, or of samples of the spacings or positions.
pub(super) fn max_rows(file_bytes: u64) -> u64 {
    allowance(6_000_000, 1, file_bytes)
}

/// Returns the largest number of samples of all signals, with their times.
#[cfg(feature = "mdf")]
pub(super) fn max_values(file_bytes: u64) -> u64 {
    allowance(200_000_000, 50, file_bytes)
}

fn allowance(small_file: u64, per_further_byte: u64, file_bytes: u64) -> u64 {
    let further_bytes = file_bytes.saturating_sub(SMALL_FILE_BYTES);
    small_file.saturating_add(per_further_byte.saturating_mul(further_bytes))
}
