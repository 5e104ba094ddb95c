//! Where there are no process groups, or nobody wants any.

use std::path::Path;
use std::time::Duration;

use super::ProcessProblem;

/// No program.
pub(crate) enum Program {}

impl Program {
    pub(crate) fn start(_words: &[String], _found: Option<&Path>, _folder: &Path) -> Result<Self, ProcessProblem> {
        Err(ProcessProblem::NotStarted {
            reason: "processes as controllers need Unix, and a build with the feature `process`".to_owned(),
        })
    }

    pub(crate) fn ask(&mut self, _request: &[u8], _within: Duration) -> Result<&[u8], ProcessProblem> {
        match *self {}
    }

    pub(crate) fn forget_words(&mut self) {
        match *self {}
    }

    pub(crate) fn close_input(&mut self) {
        match *self {}
    }

    pub(crate) fn part(self) -> Vec<String> {
        match self {}
    }

    pub(crate) fn end(self) -> Vec<String> {
        match self {}
    }
}
