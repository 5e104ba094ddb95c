//! Error responses.

use std::time::Duration;

use crumple_world::scenario::InvalidField;
use crumple_world::scenario::file::FileError;
use hyper::StatusCode;
use serde_json::{Value, json};

#[derive(Debug, thiserror::Error)]
pub(crate) enum RequestError {
    #[error("{0}")]
    Forbidden(&'static str),
    #[error("not found: {0}")]
    NotFound(&'static str),
    #[error("use the method {0}")]
    MethodNotAllowed(&'static str),
    #[error("the request took longer than {} s to arrive", .0.as_secs_f64())]
    Timeout(Duration),
    #[error("the request is larger than {0} KiB")]
    TooLarge(usize),
    #[error("the request must be JSON with the header Content-Type: application/json")]
    NotJson,
    /// The JSON is malformed, or a field is missing, unknown or of the wrong type.
    #[error("line {line}: {message}")]
    Malformed {
        line: usize,
        /// Problem, with the name of the field.
        message: String,
    },
    /// A field is out of range, contradicts another field or names an item outside the catalog.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field.
        field: String,
        problem: String,
    },
    /// Another request holds the exclusive resource.
    #[error("crumple is still computing {0}: try again later")]
    Busy(&'static str),
    #[error("{0}")]
    Internal(String),
}

impl RequestError {
    pub(crate) fn invalid(field: impl Into<String>, problem: impl ToString) -> Self {
        Self::Invalid { field: field.into(), problem: problem.to_string() }
    }

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
