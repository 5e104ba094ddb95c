//! The program that is running, as one thing to compare.
//!
//! Another build may find other numbers, so what one build left half done is not gone on with by another: a campaign's
//! journal, the progress of a count, a training's checkpoint and the state of a retraining hold [`identity`], and evidence of an
//! assessment is kept under it. Results never hold it: they are compared byte for byte between builds.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use crate::disk::DiskError;
use crumple_world::digest::sha256;

/// What an error says of half-done work of another build, behind the name of its file.
pub const OTHER_BUILD: &str = "made by another build of crumple, and work ends in the build that it began in: go on with that \
                               build, or begin anew without --resume in another --out";

/// SHA-256 of the running executable, computed once a process. Of a library that was loaded into another program, such as an
/// interpreter, it says nothing.
///
/// # Errors
/// [`DiskError`] if the executable cannot be found or read.
pub fn identity() -> Result<&'static str, DiskError> {
    static IDENTITY: OnceLock<String> = OnceLock::new();
    if let Some(known) = IDENTITY.get() {
        return Ok(known);
    }
    let path = std::env::current_exe().map_err(DiskError::at(Path::new("the running executable")))?;
    let bytes = fs::read(&path).map_err(DiskError::at(&path))?;
    Ok(IDENTITY.get_or_init(|| sha256(bytes)))
}
