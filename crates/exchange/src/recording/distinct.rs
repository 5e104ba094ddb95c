//! Recordings that are given twice.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use super::error::RecordingError;
use crumple_core::regular_file;

/// Refuses recordings with the content of another one, which would count episodes and hours twice and understate the
/// uncertainty. Ignores files that cannot be read.
///
/// # Errors
/// [`RecordingError::Repeated`] names the first such recording.
pub fn ensure_distinct(recordings: &[PathBuf]) -> Result<(), RecordingError> {
    let mut by_length: BTreeMap<u64, Vec<&PathBuf>> = BTreeMap::new();
    for path in recordings {
        let metadata = path.metadata().ok().filter(Metadata::is_file);
        let Some(length) = metadata.map(|file| file.len()) else {
            continue;
        };
        let same_length = by_length.entry(length).or_default();
        let mut others = same_length.iter();
        if let Some(other) = others.find(|other| have_same_content(path, other).unwrap_or(false)) {
            return Err(RecordingError::Repeated {
                path: path.clone(),
                other: (*other).clone(),
            });
        }
        same_length.push(path);
    }
    Ok(())
}

fn have_same_content(a: &Path, b: &Path) -> io::Result<bool> {
    Ok(read_bytes(a)?.eq(read_bytes(b)?))
}

/// Yields the bytes of a file, up to the first that cannot be read.
fn read_bytes(path: &Path) -> io::Result<impl Iterator<Item = u8>> {
    Ok(BufReader::new(regular_file::open(path)?)
        .bytes()
        .map_while(Result::ok))
}
