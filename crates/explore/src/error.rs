//! Error responses.

use std::time::Duration;

use crumple_core::field_error::FieldError;
use crumple_core::text_file::FileError;
use crumple_sim::scenario::InvalidField;
use crumple_sim::scenario::file::ScenarioFileError;
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
    #[error(transparent)]
    Invalid(#[from] FieldError),
    /// Another request holds the exclusive resource.
    #[error("crumple is still computing {0}: try again later")]
    Busy(&'static str),
    #[error("{0}")]
    Internal(String),
}

impl RequestError {
    pub(crate) fn invalid(field: impl Into<String>, problem: impl ToString) -> Self {
        Self::Invalid(FieldError::new(field, problem.to_string()))
    }

    /// Returns the status of the response, and the kind of the error in its body.
    pub(crate) fn status_and_kind(&self) -> (StatusCode, &'static str) {
        match self {
            Self::Forbidden(_) => (StatusCode::FORBIDDEN, "forbidden"),
            Self::NotFound(_) => (StatusCode::NOT_FOUND, "not-found"),
            Self::MethodNotAllowed(_) => (StatusCode::METHOD_NOT_ALLOWED, "method"),
            Self::Timeout(_) => (StatusCode::REQUEST_TIMEOUT, "slow"),
            Self::TooLarge(_) => (StatusCode::PAYLOAD_TOO_LARGE, "too-long"),
            Self::NotJson => (StatusCode::UNSUPPORTED_MEDIA_TYPE, "not-json"),
            Self::Malformed { .. } => (StatusCode::BAD_REQUEST, "malformed"),
            Self::Invalid(_) => (StatusCode::UNPROCESSABLE_ENTITY, "invalid"),
            Self::Busy(_) => (StatusCode::TOO_MANY_REQUESTS, "busy"),
            Self::Internal(_) => (StatusCode::INTERNAL_SERVER_ERROR, "failed"),
        }
    }

    pub(crate) fn to_json(&self) -> Value {
        let field = match self {
            Self::Invalid(invalid) => Some(&invalid.field),
            _ => None,
        };
        json!({ "error": { "kind": self.status_and_kind().1, "message": self.to_string(), "field": field } })
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
            unreadable => Self::Internal(unreadable.to_string()),
        }
    }
}

impl From<ScenarioFileError> for RequestError {
    fn from(error: ScenarioFileError) -> Self {
        match error {
            ScenarioFileError::File(error) => error.into(),
            ScenarioFileError::Invalid { invalid, .. } => invalid.into(),
            unreadable => Self::Internal(unreadable.to_string()),
        }
    }
}
