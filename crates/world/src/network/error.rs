//! Why a network from outside cannot be used.

use std::io;
use std::path::PathBuf;

use super::{MAX_BYTES, MAX_PARAMETERS};

/// Why a network from outside cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A network in a file cannot be used.
    #[error("{}: {reason}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: Box<Self>,
    },
    /// The name says nothing of a network.
    #[error("a network's file ends in .onnx, or in .zip for a model of Stable-Baselines3")]
    Extension,
    /// It is too large.
    #[error("the file has more than {MAX_BYTES} bytes, too many for a network")]
    TooLarge,
    /// It has too many numbers.
    #[error("the network has more than {MAX_PARAMETERS} weights and biases")]
    TooManyParameters,
    /// The file is truncated or corrupt, or is something else.
    #[error("not a whole {format}: {problem}")]
    Damaged {
        /// What it should be.
        format: &'static str,
        /// What is wrong, and where.
        problem: String,
    },
    /// A node of a graph that is not followed.
    #[error("node {node} ({operator}): {problem}")]
    Node {
        /// The node's name, or its place where it has none.
        node: String,
        /// Its operator.
        operator: String,
        /// Why it is not followed.
        problem: String,
    },
    /// The whole of it is not followed.
    #[error("{0}")]
    Unsupported(String),
    /// Its parts do not fit each other.
    #[error("step {step}: {problem}")]
    Step {
        /// Index of the step, from 0.
        step: usize,
        /// What is wrong.
        problem: String,
    },
    /// The network's numbers are finite, but too large to be calculated with.
    #[error("step {step} can overflow on inputs within their limits: its numbers are too large to drive with")]
    Overflow {
        /// Index of the step, from 0.
        step: usize,
    },
}

/// What a file says, as it may stand in a message: on one line, without control characters, and not too long.
pub(super) fn sanitized(said: &str) -> String {
    said.chars().take(200).flat_map(char::escape_debug).collect()
}

impl NetworkError {
    pub(super) fn damaged(form: &'static str, problem: impl Into<String>) -> Self {
        Self::Damaged { format: form, problem: problem.into() }
    }
}
