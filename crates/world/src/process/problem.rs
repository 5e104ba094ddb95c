//! How a process fails as a controller.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::protocol::VERSION;
use crumple_core::quoting::TerminalText;

/// Most characters that are told of a text of somebody else.
pub(super) const MAX_CHARACTERS: usize = 300;

/// What is wrong with a process that should drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum ProcessProblem {
    /// There is no such command, or the system will not start it.
    #[error("cannot be started: {reason}")]
    NotStarted {
        /// What the system says.
        reason: String,
    },
    /// It ended while it was needed.
    #[error("ended by {status}")]
    Ended {
        /// Its exit code, or the signal that ended it.
        status: String,
    },
    /// It is still there, and no longer reads or writes.
    #[error("closed its pipes")]
    Closed,
    /// No answer came in time.
    #[error("gave no answer within {limit_s} s")]
    #[serde(rename = "late")]
    Timeout {
        /// The time it had, in seconds.
        limit_s: f64,
    },
    /// It wrote on without an end of the line.
    #[error("wrote more than {limit_bytes} bytes without the end of a line")]
    TooLong {
        /// The limit, in bytes.
        limit_bytes: usize,
    },
    /// It wrote before it was asked, or more than one line.
    #[error("answered question {found} where it was asked question {asked}")]
    #[serde(rename = "other_question")]
    WrongRequestId {
        /// The question's number in its answer.
        found: u64,
        /// The number it was asked.
        asked: u64,
    },
    /// It speaks another version of the protocol.
    #[error("speaks version {found} of the protocol, and crumple speaks {VERSION}")]
    Version {
        /// What it said.
        found: String,
    },
    /// It wants another number of inputs than it is shown.
    #[error("wants {wanted} inputs, and is shown {shown}")]
    Inputs {
        /// How many it wants.
        wanted: u64,
        /// How many there are.
        shown: usize,
    },
    /// It gave more or fewer answers than it was asked for.
    #[error("gave {found} answers, and was asked for {asked}")]
    Answers {
        /// How many it gave.
        found: usize,
        /// How many were due.
        asked: usize,
    },
    /// It did not answer as the protocol says.
    #[error("answered `{found}`, which is no answer: {reason}")]
    #[serde(rename = "no_answer")]
    InvalidReply {
        /// The beginning of what it said.
        found: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The answer was not a number, or infinite.
    #[error("answered with a number that is not finite")]
    NotFinite,
    /// The answer left the range that it has.
    #[error("answered {answer_mps2} m/s², which is outside its range of {low_mps2} to {high_mps2} m/s²")]
    OutOfRange {
        /// The answer, in m/s².
        answer_mps2: f64,
        /// The least there may be, in m/s².
        low_mps2: f64,
        /// The largest there may be, in m/s².
        high_mps2: f64,
    },
    /// It said that it is deterministic, and is not.
    #[error(
        "says that it is deterministic, and when it was asked the same twice, {} answered {first_mps2} m/s² and a fresh one \
         {second_mps2} m/s²{}",
        if *reused { "the process that had driven runs before" } else { "one fresh process" },
        if *reused { ": is its state cleared at reset?" } else { "" }
    )]
    Nondeterministic {
        /// The answer that counted, in m/s².
        first_mps2: f64,
        /// That of a process that had driven no run before, in m/s².
        second_mps2: f64,
        /// Whether the first answer came from a process that had driven runs before.
        #[serde(default)]
        reused: bool,
    },
    /// It says that it is not deterministic, and its controller file does not.
    #[error("says that it is not deterministic: its controller file has to say `deterministic = false`, too")]
    #[serde(rename = "undeclared")]
    UndeclaredNondeterminism,
    /// It decides at instants that are not the scenario's.
    #[error("decides every {interval_s} s, which is not {wanted}")]
    Interval {
        /// Its interval, in seconds.
        interval_s: f64,
        /// What it should be.
        wanted: String,
    },
    /// One process of a command says something else than another did.
    #[error("introduced itself otherwise before")]
    #[serde(rename = "changed")]
    HandshakeChanged,
    /// A file that its identity stands for is another one now.
    #[error("cannot be started again: {file} has changed since it was read")]
    FileChanged {
        /// The file, as the controller file names it.
        file: String,
    },
    /// It failed too often.
    #[error("was started {starts} times, and is not started again")]
    TooManyStarts {
        /// The limit.
        starts: u32,
    },
}

/// A process that gave no usable answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProcessFailure {
    /// What it calls itself, or its command if it has not said so.
    pub controller: String,
    /// What is wrong.
    pub problem: ProcessProblem,
    /// The last lines of its standard error since the run began, the latest last.
    #[serde(rename = "last_words")]
    pub stderr_tail: Vec<String>,
}

impl std::error::Error for ProcessFailure {}

impl fmt::Display for ProcessFailure {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "`{}` {}", self.controller, self.problem)?;
        if self.stderr_tail.is_empty() {
            return Ok(());
        }
        write!(out, "; it said last: {}", self.stderr_tail.join(" | "))
    }
}

/// The beginning of a text of somebody else, in which every character shows as itself.
pub(crate) fn escaped_excerpt(text: &str) -> String {
    let begin: String = text.chars().take(MAX_CHARACTERS).collect();
    let rest = if begin.len() < text.len() { "…" } else { "" };
    format!("{}{rest}", TerminalText(begin.trim_end()))
}
