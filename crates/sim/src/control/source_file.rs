//! The file that a controller was read from, for messages.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crumple_core::text_file::line_in_toml;

/// Path of a controller's file. A controller file, the only kind with fields, also keeps its text.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceFile {
    path: PathBuf,
    text: Option<Arc<str>>,
}

impl SourceFile {
    /// Creates the location of a network or an FMU.
    #[must_use]
    pub fn binary(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            text: None,
        }
    }

    /// Creates the location of a controller file with this text.
    #[must_use]
    pub fn controller_file(path: &Path, text: &str) -> Self {
        Self {
            path: path.to_owned(),
            text: Some(text.into()),
        }
    }

    /// Returns the path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns file and line of a field as a message prefix (`acc.toml:12: `), or the file (`acc.onnx: `).
    #[must_use]
    pub fn field_location(&self, field: &str) -> String {
        let path = self.path.display();
        match &self.text {
            Some(text) => format!("{path}:{}: ", line_in_toml(text, field)),
            None => format!("{path}: "),
        }
    }

    /// Returns the message prefix of the field of a program, which only a controller file names (`acc.toml:12:
    /// command: `).
    #[must_use]
    pub fn program_location(&self, field: &str) -> String {
        let location = self.field_location(field);
        match &self.text {
            Some(_) => format!("{location}{field}: "),
            None => location,
        }
    }
}
