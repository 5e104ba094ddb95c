//! Report of an examination, as text and as JSON.

use std::path::Path;

use crumple_core::quoting::TerminalText;
use serde::Serialize;

use super::FolderExamination;

/// Report of the examination of a run folder.
#[derive(Debug, Serialize)]
pub struct FolderReport {
    /// Path of the folder.
    pub folder: String,
    /// Reason why the folder could not be examined. The other fields are then empty.
    pub error: Option<String>,
    /// Kind of the run.
    pub kind: Option<String>,
    /// True if the run is complete.
    pub is_complete: bool,
    /// True if this build may resume or read the run.
    pub is_of_this_build: bool,
    /// True if every file is as it was written, and no unlisted file exists.
    pub is_intact: bool,
    /// Number of files of the run.
    pub files: usize,
    /// Damaged files.
    pub damaged: Vec<DamagedFile>,
    /// Files that do not belong to the run, inside its folders and next to them.
    pub unlisted_files: Vec<String>,
    /// Files and folders beside the run.
    pub unrelated_files: Vec<String>,
    /// Advice that the text gives about damaged files.
    #[serde(skip)]
    pub advice: &'static str,
}

/// Advice about a damaged run.
const RUN_ADVICE: &str = "damaged work cannot be resumed: start again with a new --out";

/// A damaged file of a run folder.
#[derive(Debug, Serialize)]
pub struct DamagedFile {
    /// Path in the folder.
    pub name: String,
    /// Description of the damage.
    pub problem: String,
}

impl FolderReport {
    /// Describes a folder.
    #[must_use]
    pub fn new(folder: &Path, examination: &FolderExamination) -> Self {
        Self {
            folder: folder.display().to_string(),
            error: None,
            kind: Some(examination.kind.clone()),
            is_complete: examination.is_complete,
            is_of_this_build: examination.is_of_this_build,
            is_intact: examination.is_intact(),
            files: examination.files.len(),
            damaged: examination
                .files
                .iter()
                .filter_map(DamagedFile::new)
                .collect(),
            unlisted_files: examination.unlisted_files.clone(),
            unrelated_files: examination.unrelated_files.clone(),
            advice: RUN_ADVICE,
        }
    }

    /// Describes a folder that could not be examined.
    #[must_use]
    pub fn unreadable(folder: &Path, error: String) -> Self {
        Self {
            folder: folder.display().to_string(),
            error: Some(error),
            kind: None,
            is_complete: false,
            is_of_this_build: false,
            is_intact: false,
            files: 0,
            damaged: Vec::new(),
            unlisted_files: Vec::new(),
            unrelated_files: Vec::new(),
            advice: RUN_ADVICE,
        }
    }

    /// True if the folder was examined and is not as it was written.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        self.error.is_none() && !self.is_intact
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        if let Some(error) = &self.error {
            return format!("{}\n", TerminalText(error));
        }
        let mut text = self.summary_line();
        for DamagedFile { name, problem } in &self.damaged {
            text += &format!("  {}: {problem}\n", TerminalText(name));
        }
        if !self.damaged.is_empty() {
            text += &format!("  {}\n", self.advice);
        }
        for name in &self.unlisted_files {
            text += &format!(
                "  {}: not part of these results, in a folder that may contain only their files: move it\n",
                TerminalText(name)
            );
        }
        for name in &self.unrelated_files {
            text += &format!("  {}: not part of these results\n", TerminalText(name));
        }
        text
    }

    fn summary_line(&self) -> String {
        let state = match (self.is_complete, self.is_of_this_build) {
            (true, _) => "complete",
            (false, true) if !self.is_intact => "unfinished",
            (false, true) => "unfinished, --resume continues it",
            (false, false) => "unfinished, only the build of crumple that started it can resume it",
        };
        format!(
            "{}: a {}, {state}; {} of {} files are intact\n",
            TerminalText(&self.folder),
            TerminalText(self.kind.as_deref().unwrap_or_default()),
            self.files - self.damaged.len(),
            self.files
        )
    }
}

impl DamagedFile {
    fn new((name, state): &(String, Result<(), String>)) -> Option<Self> {
        let problem = state.as_ref().err()?;
        Some(Self {
            name: name.clone(),
            problem: problem.clone(),
        })
    }
}
