//! Replacement without process groups or without the feature `process`.

use std::path::Path;
use std::time::Duration;

use crumple_sim::control::ProcessProblem;

/// Uninhabited type: no program runs.
pub(crate) enum ChildProcess {}

impl ChildProcess {
    pub(crate) fn start(
        _words: &[String],
        _program: Option<&Path>,
        _folder: &Path,
    ) -> Result<Self, ProcessProblem> {
        Err(ProcessProblem::NotStarted {
            reason: "controllers that are processes need Unix, and the feature `process` of crumple-controllers \
                     or crumple-testing"
                .to_owned(),
        })
    }

    pub(crate) fn query(
        &mut self,
        _request: &[u8],
        _timeout: Duration,
    ) -> Result<&[u8], ProcessProblem> {
        match *self {}
    }

    pub(crate) fn clear_stderr(&mut self) {
        match *self {}
    }

    pub(crate) fn close_stdin(&mut self) {
        match *self {}
    }

    pub(crate) fn shut_down(self) -> Vec<String> {
        match self {}
    }

    pub(crate) fn terminate(self) -> Vec<String> {
        match self {}
    }
}
