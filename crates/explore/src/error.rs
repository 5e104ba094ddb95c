//! Everything a request can be answered with instead of what it asks for.

use std::time::Duration;

use crumple_world::scenario::InvalidField;
use crumple_world::scenario::file::FileError;
use hyper::StatusCode;
use serde_json::{Value, json};

/// Why a request is not answered.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RequestError {
    /// Whoever asks is not let in.
    #[error("{0}")]
    Forbidden(&'static str),
    /// There is nothing there.
    #[error("there is nothing here: {0}")]
    NotFound(&'static str),
    /// It is there, and asked for otherwise.
    #[error("this is asked for by {0}")]
    MethodNotAllowed(&'static str),
    /// The request did not end in time.
    #[error("the request took longer than {} s to arrive", .0.as_secs_f64())]
    Timeout(Duration),
    /// More than is read.
    #[error("a request may have {0} KiB")]
    TooLarge(usize),
    /// Not what the page sends.
    #[error("what is asked has to be JSON, and to say so: Content-Type: application/json")]
    NotJson,
    /// Not well formed, or a field is missing, unknown or of the wrong type.
    #[error("line {line}: {message}")]
    Malformed {
        /// Line, from 1.
        line: usize,
        /// What is wrong, naming the field.
        message: String,
    },
    /// A field that is out of range, contradicts another or names what was not offered.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field.
        field: String,
        /// What is wrong with it.
        problem: String,
    },
    /// Somebody else is having done what is only done once at a time.
    #[error("{0} is being decided already: ask again when that is done")]
    Busy(&'static str),
    /// The machine failed.
    #[error("{0}")]
    Internal(String),
}

impl RequestError {
    /// A field of which something is wrong.
    pub(crate) fn invalid(field: impl Into<String>, problem: impl ToString) -> Self {
        Self::Invalid { field: field.into(), problem: problem.to_string() }
    }

    /// What HTTP calls it.
    pub(crate) fn status(&self) -> StatusCode {
        match self {
            Self::Forbidden(_) => StatusCode::FORBIDDEN,
            Self::NotFound(_) => StatusCode::NOT_FOUND,
            Self::MethodNotAllowed(_) => StatusCode::METHOD_NOT_ALLOWED,
            Self::Timeout(_) => StatusCode::REQUEST_TIMEOUT,
            Self::TooLarge(_) => StatusCode::PAYLOAD_TOO_LARGE,
            Self::NotJson => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Self::Malformed { .. } => StatusCode::BAD_REQUEST,
            Self::Invalid { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Busy(_) => StatusCode::TOO_MANY_REQUESTS,
            Self::Internal(_) => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Forbidden(_) => "forbidden",
            Self::NotFound(_) => "not-found",
            Self::MethodNotAllowed(_) => "method",
            Self::Timeout(_) => "slow",
            Self::TooLarge(_) => "too-long",
            Self::NotJson => "not-json",
            Self::Malformed { .. } => "malformed",
            Self::Invalid { .. } => "invalid",
            Self::Busy(_) => "busy",
            Self::Internal(_) => "failed",
        }
    }

    /// The answer.
    pub(crate) fn to_json(&self) -> Value {
        let field = match self {
            Self::Invalid { field, .. } => Some(field),
            _ => None,
        };
        json!({ "error": { "kind": self.kind(), "message": self.to_string(), "field": field } })
    }
}

impl From<InvalidField> for RequestError {
    fn from(InvalidField { field, problem }: InvalidField) -> Self {
        Self::invalid(field, problem)
    }
}

impl From<FileError> for RequestError {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Syntax { line, message, .. } => Self::Malformed { line, message },
            FileError::Invalid { invalid, .. } => invalid.into(),
            other => Self::Internal(other.to_string()),
        }
    }
}
