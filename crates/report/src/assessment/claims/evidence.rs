//! Evidence: a claim, its strength, and its source.

use serde::{Deserialize, Serialize};

use super::{AssuranceClaim, Strength};

/// Evidence for or against a claim.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evidence {
    /// The claim.
    pub claim: AssuranceClaim,
    /// Strength of the evidence.
    #[serde(flatten)]
    pub strength: Strength,
    /// Source of the evidence.
    pub source: EvidenceSource,
    /// First random scenario that violates the claim; absent without one, and for evidence of another kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_violation: Option<RandomScenario>,
}

/// A random scenario of the space of a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RandomScenario {
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Index of the scenario, from 0.
    pub index: u64,
}

/// The place of evidence in a report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EvidenceSource {
    /// Part of the report, by its anchor in the page.
    pub part: String,
    /// Short description.
    pub what: String,
    /// Path of the file behind the evidence, relative to the report folder; absent if the report itself is the source.
    pub file: Option<String>,
    /// SHA-256 of the certificate in that file, in hexadecimal, as `crumple check` prints it.
    pub sha256: Option<String>,
    /// Seed of the random runs behind a bound of a rate or a comparison; absent for other evidence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
}

impl RandomScenario {
    pub(in crate::assessment) fn new(seed: u64, index: Option<u64>) -> Option<Self> {
        index.map(|index| Self { seed, index })
    }
}

impl EvidenceSource {
    /// Creates a source that is a part of the report.
    pub fn from_part(part: &str, what: impl Into<String>) -> Self {
        Self {
            part: part.to_owned(),
            what: what.into(),
            file: None,
            sha256: None,
            seed: None,
        }
    }

    /// Sets the seed of the random runs.
    #[must_use]
    pub fn with_seed(self, seed: Option<u64>) -> Self {
        Self { seed, ..self }
    }
}
