//! The program that is running, as one thing to compare.
//!
//! Another build may find other numbers, so what one build left half done is not gone on with by another: a campaign's
//! journal, the progress of a count, a training's checkpoint and the state of a retraining hold [`identity`], and evidence of an
//! assessment is kept under it. Results never hold it: they are compared byte for byte between builds.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crumple_core::digest::Sha256;

use crate::disk::DiskError;

/// What an error says of half-done work of another build, behind the name of its file.
pub const OTHER_BUILD_MESSAGE: &str = "made by another build of crumple, and work ends in the build that it began in: go on with that \
                               build, or begin anew without --resume in another --out";

/// Where the program is, if it is not the executable.
static LIBRARY: OnceLock<PathBuf> = OnceLock::new();

/// Says that crumple was loaded into another program, such as an interpreter, from this file: [`identity`] is then that of the file.
/// Only what is said first, and before an identity was asked for, counts.
pub fn set_library_path(library: PathBuf) {
    let _ = LIBRARY.set(library);
}

/// Returns the SHA-256 of the running executable, or of the library that [`set_library_path`] names, computed once per process.
///
/// # Errors
/// [`DiskError`] if the executable cannot be found or read.
pub fn identity() -> Result<&'static str, DiskError> {
    static IDENTITY: OnceLock<String> = OnceLock::new();
    if let Some(known) = IDENTITY.get() {
        return Ok(known);
    }
    let path = match LIBRARY.get() {
        Some(library) => library.clone(),
        None => std::env::current_exe().map_err(DiskError::at(Path::new("the running executable")))?,
    };
    let mut executable = File::open(&path).map_err(DiskError::at(&path))?;
    let mut hash = Sha256::default();
    io::copy(&mut executable, &mut hash).map_err(DiskError::at(&path))?;
    Ok(IDENTITY.get_or_init(|| hash.hexadecimal()))
}
