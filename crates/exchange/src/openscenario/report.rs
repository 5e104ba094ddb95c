//! Report of an import, as text and as JSON.

use std::path::{Path, PathBuf};

use crumple_core::quoting::TerminalText;
use serde::Serialize;

/// Report of an import.
#[derive(Debug, Serialize)]
pub struct OpenScenarioReport {
    /// Paths of the scenario files, or of the space.
    pub files: Vec<String>,
    /// Combinations of values that violate constraints of the file.
    pub violating: usize,
    /// Errors of combinations of values that cannot be imported, each with the values.
    pub refused: Vec<String>,
    /// Notes about content that has no effect on the scenario.
    pub notes: Vec<String>,
    #[serde(skip)]
    folder: PathBuf,
}

impl OpenScenarioReport {
    /// Describes an import that wrote files of these names into a folder.
    #[must_use]
    pub fn new<'n>(
        folder: &Path,
        names: impl Iterator<Item = &'n str>,
        violating: usize,
        refused: Vec<String>,
        notes: Vec<String>,
    ) -> Self {
        Self {
            files: names
                .map(|name| folder.join(name).display().to_string())
                .collect(),
            violating,
            refused,
            notes,
            folder: folder.to_owned(),
        }
    }

    /// Returns the report for a reader, as a line.
    #[must_use]
    pub fn to_text(&self) -> String {
        match self.files.as_slice() {
            [file] => format!("{}\n", TerminalText(file)),
            several => format!(
                "{}: {} scenarios\n",
                TerminalText(&self.folder.display().to_string()),
                several.len()
            ),
        }
    }
}
