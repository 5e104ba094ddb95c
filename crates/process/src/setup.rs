//! Command of a controller process, its mapping and its limits.

use std::path::{Path, PathBuf};

use crumple_networks::{InvalidMapping, Mapping};
use crumple_sim::control::SourceFile;

const MAX_COMMAND_WORDS: usize = 1000;
const MAX_FILES: usize = 1000;
const MAX_TIMEOUT_S: f64 = 3600.0;

/// Command of a controller process, its mapping and its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessSetup {
    /// The program and its arguments, without a shell. A relative path of a program starts at `folder`.
    pub command: Vec<String>,
    /// Location of the program, if it differs from the command. The identity uses the command only.
    pub program: Option<PathBuf>,
    /// Working folder of the process.
    pub folder: PathBuf,
    /// Controller file or FMU that contains the command, for messages; `None` for a command without a file.
    pub file: Option<SourceFile>,
    /// Files, relative to `folder`, that determine the commands; empty if they are unknown.
    pub files: Vec<String>,
    /// True unless the controller file declares the process nondeterministic.
    pub deterministic: bool,
    /// Mapping of observations and answers.
    pub mapping: Mapping,
    /// Time limit of the first answer, in seconds.
    pub start_within_s: f64,
    /// Time limit of each other answer, in seconds.
    pub answer_within_s: f64,
}

impl ProcessSetup {
    /// Creates a setup from a command with [`Mapping::unscaled`] and default limits.
    #[must_use]
    pub fn new(command: Vec<String>, folder: &Path) -> Self {
        Self {
            command,
            program: None,
            folder: folder.to_owned(),
            file: None,
            files: Vec::new(),
            deterministic: true,
            mapping: Mapping::unscaled(),
            start_within_s: 30.0,
            answer_within_s: 1.0,
        }
    }

    pub(super) fn check(&self) -> Result<(), InvalidMapping> {
        check_command(&self.command)?;
        if self.files.len() > MAX_FILES {
            return Err(InvalidMapping::new(
                "files",
                format!("must be at most {MAX_FILES}, found {}", self.files.len()),
            ));
        }
        check_timeout("start_within_s", self.start_within_s)?;
        check_timeout("answer_within_s", self.answer_within_s)?;
        self.mapping.check()?;
        match self.mapping.output.answer {
            None | Some(0) => Ok(()),
            _ => Err(InvalidMapping::new(
                "output.answer",
                "must be 0: a process gives one answer",
            )),
        }
    }
}

fn check_command(words: &[String]) -> Result<(), InvalidMapping> {
    if !(1..=MAX_COMMAND_WORDS).contains(&words.len()) || words.first().is_none_or(String::is_empty)
    {
        return Err(InvalidMapping::new(
            "command",
            format!("must be a program and at most {MAX_COMMAND_WORDS} words in all"),
        ));
    }
    if words.iter().any(|word| word.contains('\0')) {
        return Err(InvalidMapping::new(
            "command",
            "a word of a command must not contain a NUL character",
        ));
    }
    Ok(())
}

fn check_timeout(field: &str, timeout_s: f64) -> Result<(), InvalidMapping> {
    if timeout_s > 0.0 && timeout_s <= MAX_TIMEOUT_S {
        return Ok(());
    }
    Err(InvalidMapping::new(
        field,
        format!("must be above 0 and at most {MAX_TIMEOUT_S}, found {timeout_s}"),
    ))
}
