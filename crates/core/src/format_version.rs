//! Versions of file formats.

/// The error of a file whose format has another version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("version {found} is not supported: this release reads version {supported}")]
pub struct UnsupportedVersion {
    /// Version of the file.
    pub found: u64,
    /// Version that this release reads.
    pub supported: u32,
}

/// Checks the version of a file.
///
/// # Errors
/// [`UnsupportedVersion`] if it is not the supported one.
pub fn check_version(version: impl Into<u64>, supported: u32) -> Result<(), UnsupportedVersion> {
    let version = version.into();
    if version == u64::from(supported) {
        Ok(())
    } else {
        Err(UnsupportedVersion {
            found: version,
            supported,
        })
    }
}
