//! Evidence: a claim, how strongly something speaks for it, and what that rests on.

use serde::{Deserialize, Serialize};

use super::{AssuranceClaim, Strength};

/// What speaks for a claim, or against it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evidence {
    /// The claim.
    pub claim: AssuranceClaim,
    /// How strongly.
    #[serde(flatten)]
    pub strength: Strength,
    /// What it rests on.
    pub source: EvidenceSource,
}

/// Where evidence stands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EvidenceSource {
    /// The part of the report, by its anchor in the page.
    pub part: String,
    /// What it is, in a few words.
    pub what: String,
    /// The file it rests on, from the folder of the report; none if it is the report itself.
    pub file: Option<String>,
    /// SHA-256 of that file, in hexadecimal.
    pub sha256: Option<String>,
}

impl EvidenceSource {
    /// A part of the report.
    pub fn from_part(part: &str, what: impl Into<String>) -> Self {
        Self { part: part.to_owned(), what: what.into(), file: None, sha256: None }
    }
}
