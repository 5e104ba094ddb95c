//! Identity of the running program.
//!
//! Another build may compute other numbers, so only the same build may resume unfinished work. Journals, checkpoints
//! and progress files contain [`identity`], and the evidence cache of an assessment is keyed by it. Results never
//! contain it, because tests compare them byte for byte between builds.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crumple_core::digest::Sha256;

use crate::disk::DiskError;

/// Error message about unfinished work of another build. The name of its file stands before it.
pub const OTHER_BUILD_MESSAGE: &str = "another build of crumple started this work: resume it with that build, \
                               or start again without --resume in another --out";

/// Path of the program, if it is not the executable.
static LIBRARY: OnceLock<PathBuf> = OnceLock::new();

/// Uses this shared library instead of the executable for [`identity`]. Must be called before [`identity`]; a second
/// call has no effect.
pub fn set_library_path(library: PathBuf) {
    let _ = LIBRARY.set(library);
}

/// Returns the SHA-256 of the running executable, or of the library of [`set_library_path`]. Computed once per process.
///
/// # Errors
/// [`DiskError`] if the executable cannot be found or read.
pub fn identity() -> Result<&'static str, DiskError> {
    static IDENTITY: OnceLock<String> = OnceLock::new();
    if let Some(identity) = IDENTITY.get() {
        return Ok(identity);
    }
    let path = match LIBRARY.get() {
        Some(library) => library.clone(),
        None => {
            std::env::current_exe().map_err(DiskError::at(Path::new("the running executable")))?
        }
    };
    let mut executable = File::open(&path).map_err(DiskError::at(&path))?;
    let mut hash = Sha256::default();
    io::copy(&mut executable, &mut hash).map_err(DiskError::at(&path))?;
    Ok(IDENTITY.get_or_init(|| hash.hexadecimal()))
}
