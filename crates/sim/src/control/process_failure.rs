//! Errors of a process that serves as a controller.

use std::fmt;

use serde::{Deserialize, Serialize};

use crumple_core::quoting::TerminalText;

/// Version of the protocol between crumple and controller processes.
pub const PROTOCOL_VERSION: u64 = 1;

/// Maximum number of characters quoted from text of a process.
const MAX_CHARACTERS: usize = 300;

/// Describes the end of a process by its [`ProcessProblem::Ended::status`].
fn describe_end(status: &str) -> String {
    let itself = if status.starts_with("exit code") {
        "itself with "
    } else {
        ""
    };
    format!("{itself}{status}")
}

/// An error of a controller process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum ProcessProblem {
    /// No such command, or the system refused to start it.
    #[error("cannot be started: {reason}")]
    NotStarted {
        /// Error message of the system.
        reason: String,
    },
    /// The process ended while it was needed.
    #[error("ended by {}", describe_end(status))]
    Ended {
        /// Exit code, or the signal that ended the process.
        status: String,
    },
    /// The process still runs, but closed its pipes.
    #[error("closed its pipes")]
    Closed,
    /// No answer within the time limit.
    #[error("gave no answer within {limit_s} s")]
    #[serde(alias = "late")]
    Timeout {
        /// Time limit, in seconds.
        limit_s: f64,
    },
    /// The process wrote a line without end.
    #[error("wrote more than {limit_bytes} bytes without the end of a line")]
    TooLong {
        /// Limit, in bytes.
        limit_bytes: usize,
    },
    /// The process wrote before a query, or more than one line.
    #[error("answered question {found} where it was asked question {asked}")]
    #[serde(alias = "other_question")]
    WrongRequestId {
        /// Number in the answer.
        found: u64,
        /// Number of the query.
        asked: u64,
    },
    /// The process uses another version of the protocol.
    #[error("speaks version {found} of the protocol, and crumple speaks {PROTOCOL_VERSION}")]
    Version {
        /// Version of the process.
        found: String,
    },
    /// The process expects another number of inputs.
    #[error("expects {wanted} inputs, and crumple sends {shown}")]
    Inputs {
        /// Number of inputs that the process expects.
        wanted: u64,
        /// Number of inputs of the mapping.
        shown: usize,
    },
    /// Number of answers that does not match the query.
    #[error("gave {found} answers, and was asked for {asked}")]
    Answers {
        /// Number of answers found.
        found: usize,
        /// Number of answers expected.
        asked: usize,
    },
    /// A reply that violates the protocol.
    #[error("answered `{found}`, which is not a valid answer: {reason}")]
    #[serde(alias = "no_answer")]
    InvalidReply {
        /// Beginning of the reply.
        found: String,
        /// Description of the error.
        reason: String,
    },
    /// An answer that is infinite or not a number.
    #[error("answered with a number that is not finite")]
    NotFinite,
    /// An answer outside its range.
    #[error(
        "answered {answer_mps2} m/s², which is outside its range of {low_mps2} to {high_mps2} m/s²"
    )]
    OutOfRange {
        /// Answer, in m/s².
        answer_mps2: f64,
        /// Smallest allowed answer, in m/s².
        low_mps2: f64,
        /// Largest allowed answer, in m/s².
        high_mps2: f64,
    },
    /// The process declares itself deterministic, but is not.
    #[error(
        "declares that it is deterministic, but to the same observations {} answered {first_mps2} m/s² and a fresh \
        one {second_mps2} m/s²{}",
        if *reused { "the process that had driven runs before" } else { "one fresh process" },
        if *reused { ": is its state cleared at reset?" } else { "" }
    )]
    Nondeterministic {
        /// Answer of the run, in m/s².
        first_mps2: f64,
        /// Answer of a fresh process, in m/s².
        second_mps2: f64,
        /// True if the first answer came from a process that had driven earlier runs.
        #[serde(default)]
        reused: bool,
    },
    /// The process declares itself non-deterministic, but its controller file does not.
    #[error(
        "declares that it is not deterministic: set `deterministic = false` in its controller file"
    )]
    #[serde(alias = "undeclared")]
    UndeclaredNondeterminism,
    /// A decision interval that does not match the scenario.
    #[error("decides every {interval_s} s, which is not {wanted}")]
    Interval {
        /// Decision interval of the process, in seconds.
        interval_s: f64,
        /// Expected interval.
        wanted: String,
    },
    /// A handshake that differs from an earlier one of the same command.
    #[error("introduced itself differently before")]
    #[serde(alias = "changed")]
    HandshakeChanged,
    /// A file of the controller's identity that has changed.
    #[error("cannot be started again: {file} has changed since it was read")]
    FileChanged {
        /// File, as the controller file names it.
        file: String,
    },
    /// Too many failures.
    #[error("was started {starts} times, and is not started again")]
    TooManyStarts {
        /// Maximum number of starts.
        starts: u32,
    },
}

/// Failure of a process that gave no usable answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProcessFailure {
    /// Name from the handshake, or the command before a handshake.
    pub controller: String,
    /// Reason of the failure.
    pub problem: ProcessProblem,
    /// Last lines of standard error since the run began, newest last.
    #[serde(alias = "last_words")]
    pub stderr_tail: Vec<String>,
}

impl std::error::Error for ProcessFailure {}

impl fmt::Display for ProcessFailure {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "`{}` {}", self.controller, self.problem)?;
        if self.stderr_tail.is_empty() {
            return Ok(());
        }
        write!(out, "; its last output: {}", self.stderr_tail.join(" | "))
    }
}

/// Returns the beginning of an untrusted text, with escapes for characters that a terminal would interpret.
pub fn escaped_excerpt(text: &str) -> String {
    let begin: String = text.chars().take(MAX_CHARACTERS).collect();
    let rest = if begin.len() < text.len() { "…" } else { "" };
    format!("{}{rest}", TerminalText(begin.trim_end()))
}
