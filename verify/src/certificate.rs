//! The certificate file. `docs/certificates.md` in crumple's repository specifies it.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::canonical;
use crate::{ClaimSubject, Statement};

/// The version of the format that is written.
pub const VERSION: u32 = 2;
/// The first version, which is still read. It binds a statement to nothing: see [`Certificate::is_first_version`].
pub const FIRST_VERSION: u32 = 1;

/// Caveat of an accepted rate or comparison whose runs were not repeated.
pub const UNVERIFIED_COUNTS_CAVEAT: &str =
    "the counts are not verified: `crumple check --rerun` simulates the runs again";

/// Maximum size of a file, in bytes.
pub const MAX_BYTES: usize = 64 << 20;

/// A statement with its assumptions and its proof.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of the format: 2, or 1 for old files.
    pub version: u32,
    /// Subject of the statement, and the program that wrote it.
    pub provenance: CertificateProvenance,
    /// Exactly the assumptions that the statement needs, each once.
    pub assumptions: Vec<Assumption>,
    /// Claim and proof.
    pub statement: Statement,
}

/// The subject of a statement: a scenario, a box around one, or a scenario space.
///
/// In version 2 its text is part of the certificate and its hash is checked. `crumple check` compares the text with the
/// numbers of the statement. A kernel or a two-sided claim names no scenario, so `crumple` is its only field. The
/// checker concludes nothing from these fields in a certificate of version 1.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateProvenance {
    /// Version of the program that wrote the file.
    pub crumple: String,
    /// Name of the scenario or scenario space.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario: String,
    /// SHA-256 of `scenario_text`, in hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub scenario_sha256: String,
    /// The scenario or scenario space as a file, in TOML. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario_text: Option<String>,
    /// Ranges around the scenario as a file, in TOML, if the statement is about a box. Since version 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub box_text: Option<String>,
}

/// Opens a regular file. Other files are refused, because reading a pipe or a device may never end.
///
/// # Errors
/// Those of the system; [`std::io::ErrorKind::InvalidInput`] for anything but a regular file.
pub fn open_regular_file(path: &Path) -> std::io::Result<File> {
    match path.metadata() {
        Ok(metadata) if !metadata.is_file() && !metadata.is_dir() => Err(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            "is not a regular file",
        )),
        _ => File::open(path),
    }
}

/// Reason for which a file is not a certificate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CertificateParseError {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// The file is too long.
    #[error("is longer than {MAX_BYTES} bytes")]
    TooLong,
    /// The file is not JSON of the right form; names the expected token, line and column.
    #[error("is not a certificate: {0}")]
    Json(#[from] serde_json::Error),
    /// The version is unknown.
    #[error(
        "has version {0} in field `version`, and only versions {FIRST_VERSION} and {VERSION} are known"
    )]
    UnknownVersion(u32),
    /// The text is not canonical: fields in another order, numbers with superfluous digits, explicit defaults.
    #[error(
        "is not in canonical form from line {line} column {column} on: only whitespace between tokens may differ"
    )]
    NotCanonical {
        /// First line that differs from the canonical text, from 1.
        line: usize,
        /// First column that differs, from 1.
        column: usize,
    },
}

impl Certificate {
    /// Returns the file name and SHA-256 of the policy or network of the claim, if it has one.
    #[must_use]
    pub fn policy_reference(&self) -> Option<(&str, &str)> {
        match self.statement.subject() {
            ClaimSubject::InitialStates(claim) => Some((&claim.policy_file, &claim.policy_sha256)),
            ClaimSubject::Region(claim) => claim
                .network()
                .map(|network| (network.policy_file.as_str(), network.policy_sha256.as_str())),
            ClaimSubject::AnyVehicles
            | ClaimSubject::AnyNeighbours
            | ClaimSubject::Scene { .. }
            | ClaimSubject::Runs(_) => None,
        }
    }

    /// Reads `policy`, or else the policy file that the certificate names, in the folder of `path`. Returns `None` if
    /// the claim has no policy or the file cannot be read.
    #[must_use]
    pub fn read_policy(&self, path: &Path, policy: Option<&Path>) -> Option<Vec<u8>> {
        let sibling = path.with_file_name(Path::new(self.policy_reference()?.0).file_name()?);
        let mut bytes = Vec::new();
        open_regular_file(policy.unwrap_or(&sibling))
            .ok()?
            .take(MAX_BYTES as u64)
            .read_to_end(&mut bytes)
            .ok()?;
        Some(bytes)
    }

    /// True if the listed assumptions are those that the statement needs, apart from noise of the seed.
    pub(crate) fn has_required_assumptions(&self) -> bool {
        let needed = self.statement.assumptions();
        let noise = usize::from(self.assumptions.contains(&Assumption::NoiseOfSeed));
        needed
            .iter()
            .all(|assumption| self.assumptions.contains(assumption))
            && self.assumptions.len() == needed.len() + noise
    }

    /// Reads a certificate from text.
    ///
    /// # Errors
    /// [`CertificateParseError`] if the text is not a certificate. One that is read may still be rejected.
    pub fn from_json(text: &str) -> Result<Self, CertificateParseError> {
        if text.len() > MAX_BYTES {
            return Err(CertificateParseError::TooLong);
        }
        let certificate: Self = serde_json::from_str(text)?;
        match certificate.version {
            // Readers of version 1 accepted any form, and handwritten files of it exist.
            FIRST_VERSION => Ok(certificate),
            VERSION => match canonical::first_difference(text, &certificate.to_canonical_json()) {
                None => Ok(certificate),
                Some((line, column)) => Err(CertificateParseError::NotCanonical { line, column }),
            },
            other => Err(CertificateParseError::UnknownVersion(other)),
        }
    }

    /// Returns the canonical text: unique but for whitespace between tokens.
    #[must_use]
    pub fn to_canonical_json(&self) -> String {
        // Structs of strings and finite numbers always have a JSON form.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Returns the SHA-256 of the canonical form in hexadecimal, for citation.
    #[must_use]
    pub fn digest(&self) -> String {
        canonical::sha256(self.to_canonical_json())
    }

    /// Returns the condition that acceptance by this crate alone leaves open, if any.
    #[must_use]
    pub fn caveat(&self) -> Option<&'static str> {
        match self.statement.subject() {
            ClaimSubject::Runs(_) => Some(UNVERIFIED_COUNTS_CAVEAT),
            _ => None,
        }
    }

    /// True for version 1, which binds the statement to no scenario, box, space or counted runs. Its mathematics is
    /// checked.
    #[must_use]
    pub fn is_first_version(&self) -> bool {
        self.version == FIRST_VERSION
    }

    /// Reads a certificate from a file or any other source.
    ///
    /// # Errors
    /// [`CertificateParseError`] if it cannot be read or is not a certificate.
    pub fn from_reader(source: impl std::io::Read) -> Result<Self, CertificateParseError> {
        let mut text = String::new();
        std::io::Read::read_to_string(
            &mut std::io::Read::take(source, MAX_BYTES as u64 + 1),
            &mut text,
        )?;
        Self::from_json(&text)
    }
}
