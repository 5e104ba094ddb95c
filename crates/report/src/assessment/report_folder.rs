//! The folder of a report: the report is written there as a whole, and replaces only files of earlier reports.

use std::fs;
use std::path::{Path, PathBuf};

use super::AssessmentPlan;
use super::parts::HARM_RUNS_FILE;
use super::portable_config::EARLIER_FILE;
use super::report::{REPORT_FILES, REPORT_FOLDERS, REPORT_KIND};
use crumple_store::disk::DiskError;
use crumple_store::output_folder::{EarlierFiles, OutputError, OutputFolder};
use crumple_store::run_folder::{self, MANIFEST_FILE};

/// Folder in the report folder that keeps evidence for later reports.
pub const EVIDENCE_FOLDER: &str = "evidence";
/// File that lists the files of a report.
pub const LISTING_FILE: &str = "report.sha256";

/// An error of writing a report into a folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportFolderError {
    /// A file may not or cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The path is no folder, or a report may not be written there.
    #[error("{}: {problem}", path.display())]
    Refused {
        /// Path of the folder.
        path: PathBuf,
        /// Problem with it, and advice.
        problem: String,
    },
}

impl ReportFolderError {
    fn refused(path: &Path, problem: impl Into<String>) -> Self {
        Self::Refused {
            path: path.to_owned(),
            problem: problem.into(),
        }
    }
}

/// A folder into which a report may be written.
#[derive(Debug)]
pub struct ReportFolder(OutputFolder);

impl ReportFolder {
    /// Opens a folder, which may be missing, and checks that a report may be written there.
    ///
    /// # Errors
    /// [`ReportFolderError`] if the path is no folder, it contains other results or symbolic links, or a file with the
    /// name of a report's file has changed since crumple wrote it.
    pub fn open(path: &Path) -> Result<Self, ReportFolderError> {
        if path.exists() && !path.is_dir() {
            return Err(ReportFolderError::refused(path, "is not a folder"));
        }
        check_no_symlinks(path)?;
        if let Some(kind) = run_folder::read_kind(path).filter(|kind| kind != REPORT_KIND) {
            let problem = format!(
                "contains a {kind}, whose work.json the report would replace; use another folder"
            );
            return Err(ReportFolderError::refused(path, problem));
        }
        // Reports of earlier builds have a manifest instead of a listing.
        let folder = OutputFolder::with_listing(path, LISTING_FILE)?
            .with_known_files(run_folder::read_digests(path, REPORT_KIND))
            .with_manifest(MANIFEST_FILE);
        folder.check(&REPORT_FILES)?;
        folder.check(&[MANIFEST_FILE])?;
        Ok(Self(folder))
    }

    /// Checks, before long work, the names of files that only reports of some plans have.
    ///
    /// # Errors
    /// [`ReportFolderError`] if such a file has changed, or crumple did not write it.
    pub fn check(&self, plan: &AssessmentPlan) -> Result<(), ReportFolderError> {
        let harm_runs = plan.config.harm.as_ref().map(|_| HARM_RUNS_FILE);
        let earlier = plan.needs_earlier_assessment().then_some(EARLIER_FILE);
        let names: Vec<&str> = harm_runs.into_iter().chain(earlier).collect();
        Ok(self.0.check(&names)?)
    }

    /// Writes the files of a report ([`super::AssessmentReport::files`]) and their listing, and removes those of the
    /// earlier report. Creates the folder if it is missing. The same call repairs a report that was not completely
    /// written.
    ///
    /// # Errors
    /// [`ReportFolderError`] if a file may not or cannot be written. Unless it occurs while the files are moved into
    /// place, no file has changed.
    pub fn write(&self, files: &[(String, Vec<u8>)]) -> Result<(), ReportFolderError> {
        Ok(self.0.write(files, EarlierFiles::Replace)?)
    }
}

/// Refuses a report folder that contains symbolic links to folders: a report writes and removes files in its folders.
fn check_no_symlinks(out: &Path) -> Result<(), ReportFolderError> {
    REPORT_FOLDERS
        .into_iter()
        .chain([EVIDENCE_FOLDER, "figures"])
        .try_for_each(|name| ensure_no_symlinks(&out.join(name.trim_end_matches('/'))))
}

/// Checks that neither a folder nor any folder below it is a symbolic link. Ignores a path that is no folder.
fn ensure_no_symlinks(folder: &Path) -> Result<(), ReportFolderError> {
    if folder.is_symlink() && !folder.is_file() {
        let problem = "is a symbolic link, and a report writes and removes files only inside its folder: remove the \
                       link, or use another folder";
        return Err(ReportFolderError::refused(folder, problem));
    }
    let entries = if folder.is_dir() {
        fs::read_dir(folder)
            .map_err(DiskError::at(folder))
            .map_err(OutputError::from)?
    } else {
        return Ok(());
    };
    entries
        .flatten()
        .try_for_each(|entry| ensure_no_symlinks(&entry.path()))
}
