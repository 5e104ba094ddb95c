//! Errors of imported networks.

use std::io;
use std::path::{Path, PathBuf};

use super::{MAX_BYTES, MAX_PARAMETERS};

/// Reason why an imported network cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A network in a file cannot be used.
    #[error("{}: {reason}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: Box<Self>,
    },
    /// The file name does not indicate a network.
    #[error("a network's file ends in .onnx, or in .zip for a model of Stable-Baselines3")]
    Extension,
    /// The file is too large.
    #[error("the file has more than {MAX_BYTES} bytes, too many for a network")]
    TooLarge,
    /// The network has too many numbers.
    #[error("the network has more than {MAX_PARAMETERS} weights and biases")]
    TooManyParameters,
    /// The file is truncated, corrupt, or of another format.
    #[error("not a whole {format}: {problem}")]
    Damaged {
        /// Expected format.
        format: &'static str,
        /// Description of the error, with its place.
        problem: String,
    },
    /// A node of a graph is not supported.
    #[error("node {node} ({operator}): {problem}")]
    Node {
        /// Name of the node, or its index.
        node: String,
        /// Operator of the node.
        operator: String,
        /// Reason why it is not supported.
        problem: String,
    },
    /// The network as a whole is not supported.
    #[error("{0}")]
    Unsupported(String),
    /// The parts of the network do not fit each other.
    #[error("step {step}: {problem}")]
    Step {
        /// Index of the step, from 0.
        step: usize,
        /// Description of the error.
        problem: String,
    },
    /// The network can overflow.
    #[error(
        "step {step} can overflow for inputs within their limits: its parameters are too large"
    )]
    Overflow {
        /// Index of the step, from 0.
        step: usize,
    },
}

/// Makes text of a file safe for a message: one line, without control characters, at most 200 characters.
pub(super) fn sanitized(text: &str) -> String {
    text.chars()
        .take(200)
        .flat_map(char::escape_debug)
        .collect()
}

impl NetworkError {
    /// Adds the path of the file.
    pub(super) fn in_file(self, path: &Path) -> Self {
        Self::InFile {
            path: path.to_owned(),
            reason: Box::new(self),
        }
    }

    pub(super) fn damaged(format: &'static str, problem: impl Into<String>) -> Self {
        Self::Damaged {
            format,
            problem: problem.into(),
        }
    }
}
