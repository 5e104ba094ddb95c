//! Zip archive of an FMU.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use zip::ZipArchive;
use zip::result::ZipError;

use crate::description::{FmiVersion, InvalidDescription, ModelDescription};

const MAX_DESCRIPTION_BYTES: u64 = 16 << 20;
/// Maximum number of members of an archive, and of bytes of all of them unpacked.
const MAX_MEMBERS: usize = 20_000;
const MAX_UNPACKED_BYTES: u64 = 1 << 30;

const DESCRIPTION: &str = "modelDescription.xml";

/// Reason why an FMU cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FmuError {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Read(#[from] io::Error),
    /// The file is no zip archive, or is damaged.
    #[error("is not an FMU: {}", describe_zip_error(.0))]
    Archive(#[from] ZipError),
    /// A member is too large or has a name that leads out of the archive, or there are too many.
    #[error("is not an FMU: {0}")]
    Member(String),
    /// The description cannot be used.
    #[error(transparent)]
    Description(#[from] InvalidDescription),
    /// The FMU has no library for this platform.
    #[error("has no library for this platform, `{wanted}`: it has {}", if found.is_empty() { "none" } else { found })]
    Platform {
        /// Member that is missing.
        wanted: String,
        /// Libraries that are present.
        found: String,
    },
}

fn describe_zip_error(error: &ZipError) -> String {
    match error {
        ZipError::InvalidArchive(_) => "it is not a zip archive, or it was cut off".to_owned(),
        other => other.to_string(),
    }
}

/// Archive of an FMU and its description. Runs no code of the FMU.
#[derive(Debug)]
pub struct Fmu<R> {
    archive: ZipArchive<R>,
    description: ModelDescription,
}

impl Fmu<BufReader<File>> {
    /// Opens an FMU.
    ///
    /// # Errors
    /// [`FmuError`] if it cannot be read, is no FMU, or cannot be a controller on this platform.
    pub fn open(path: &Path) -> Result<Self, FmuError> {
        Self::read(BufReader::new(crumple_core::regular_file::open(path)?))
    }
}

/// Reads the text of the description.
fn read_description(archive: &mut ZipArchive<impl Read + Seek>) -> Result<String, FmuError> {
    let member = archive.by_name(DESCRIPTION).map_err(|error| match error {
        ZipError::FileNotFound => FmuError::Member(format!("it has no {DESCRIPTION}")),
        other => other.into(),
    })?;
    let mut text = String::new();
    member
        .take(MAX_DESCRIPTION_BYTES + 1)
        .read_to_string(&mut text)
        .map_err(|error| FmuError::Member(format!("{DESCRIPTION}: {error}")))?;
    if text.len() as u64 > MAX_DESCRIPTION_BYTES {
        return Err(FmuError::Member(format!(
            "{DESCRIPTION} has more than {MAX_DESCRIPTION_BYTES} bytes"
        )));
    }
    Ok(text)
}

impl<R: Read + Seek> Fmu<R> {
    /// Reads an FMU from its bytes.
    ///
    /// # Errors
    /// As for [`Fmu::open`].
    pub fn read(bytes: R) -> Result<Self, FmuError> {
        let mut archive = ZipArchive::new(bytes)?;
        if archive.len() > MAX_MEMBERS {
            return Err(FmuError::Member(format!(
                "it has more than {MAX_MEMBERS} members"
            )));
        }
        let description = ModelDescription::from_xml(&read_description(&mut archive)?)?;
        let fmu = Self {
            description,
            archive,
        };
        let wanted = fmu.library_member();
        if fmu.archive.index_for_name(&wanted).is_none() {
            let members = fmu.member_names();
            let mut libraries: Vec<String> = members
                .filter(|name| name.starts_with("binaries/") && !name.ends_with('/'))
                .collect();
            libraries.sort_unstable();
            libraries.truncate(8);
            return Err(FmuError::Platform {
                wanted,
                found: libraries.join(", "),
            });
        }
        Ok(fmu)
    }

    /// Returns the description.
    #[must_use]
    pub fn description(&self) -> &ModelDescription {
        &self.description
    }

    /// Returns the member that is the library for this platform.
    #[must_use]
    pub fn library_member(&self) -> String {
        let system = match std::env::consts::OS {
            "macos" => "darwin",
            other => other,
        };
        let extension = match system {
            "darwin" => "dylib",
            "windows" => "dll",
            _ => "so",
        };
        let folder = match self.description.version {
            FmiVersion::Three => format!("{}-{system}", std::env::consts::ARCH),
            FmiVersion::Two => {
                let system = if system == "windows" { "win" } else { system };
                format!("{system}{}", usize::BITS)
            }
        };
        format!(
            "binaries/{folder}/{}.{extension}",
            self.description.model_identifier
        )
    }

    /// True if the FMU has resource files, which its library may read.
    #[must_use]
    pub fn has_resources(&self) -> bool {
        self.member_names()
            .any(|name| name.starts_with("resources/") && !name.ends_with('/'))
    }

    fn member_names(&self) -> impl Iterator<Item = String> {
        self.archive
            .file_names()
            .filter_map(|name| name.ok().map(std::borrow::Cow::into_owned))
    }

    /// Unpacks the library's folder and the resources into an empty folder. Returns the path of the library.
    ///
    /// # Errors
    /// [`FmuError`] if the archive is damaged or too large, or the folder cannot be written.
    pub fn unpack(&mut self, folder: &Path) -> Result<PathBuf, FmuError> {
        let library = self.library_member();
        let library_folder = library
            .rsplit_once('/')
            .map_or("", |(folder, _)| folder)
            .to_owned();
        let mut left = MAX_UNPACKED_BYTES;
        for index in 0..self.archive.len() {
            let mut member = self.archive.by_index(index)?;
            let name = member.name()?.into_owned();
            if member.is_dir()
                || !(name.starts_with(&format!("{library_folder}/"))
                    || name.starts_with("resources/"))
            {
                continue;
            }
            let inside = member.enclosed_name().filter(|_| !member.is_symlink());
            let inside = inside
                .ok_or_else(|| FmuError::Member(format!("{name:?} leads out of the archive")))?;
            let path = folder.join(inside);
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent)?;
            }
            let copied = io::copy(&mut (&mut member).take(left + 1), &mut File::create(path)?);
            let copied = copied.map_err(|error| FmuError::Member(format!("{name}: {error}")))?;
            left = left.checked_sub(copied).ok_or_else(|| {
                FmuError::Member(format!(
                    "its members have more than {} MiB in all",
                    MAX_UNPACKED_BYTES >> 20
                ))
            })?;
        }
        std::fs::create_dir_all(folder.join("resources"))?;
        Ok(folder.join(library))
    }
}
