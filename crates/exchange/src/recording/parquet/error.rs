//! Errors of Parquet files.

/// Reason why a Parquet file cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ParquetError {
    /// The system cannot read the file.
    #[error("{0}")]
    Read(String),
    /// A part that breaks the rules of the format.
    #[error("it is damaged: {0}")]
    Damaged(&'static str),
    /// A part of the format that this release does not read.
    #[error("crumple does not read {0}")]
    Unsupported(String),
    /// A file that needs more memory or time than files of its size should.
    #[error("it has more than {limit} {what}: split it, or compress it less")]
    TooLarge {
        /// Limit.
        limit: u64,
        /// Unit of the limit.
        what: &'static str,
    },
}

impl From<std::io::Error> for ParquetError {
    fn from(error: std::io::Error) -> Self {
        Self::Read(error.to_string())
    }
}
