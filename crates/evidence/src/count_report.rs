//! Report of a count, as text and as JSON.

use std::path::PathBuf;

use crumple_verify::{Rejection, Statement, check};
use serde::Serialize;

use super::exposure::RatePerExposure;
use super::{CountResult, RatePlan};
use crumple_core::quoting::TerminalText;
use crumple_sim::engine::FailedControllerRuns;

/// Report of a count.
#[derive(Debug, Serialize)]
pub struct CountReport {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Folder of the count; `None` if it no longer exists.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// Number of runs.
    pub runs: u64,
    /// Runs in which the controller failed; with two controllers, both, unless the second gave no answer.
    pub failures: u64,
    /// Runs in which only the first of two controllers failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// Runs without an answer, of the first controller and of the second.
    pub missing_answers: [Option<FailedControllerRuns>; 2],
    /// Path of the certificate; its name if the folder no longer exists.
    pub certificate: Option<PathBuf>,
    /// Bound that the checker accepted, for one controller.
    pub rate_at_most: Option<f64>,
    /// Confidence level.
    pub confidence: Option<f64>,
    /// Rates per hour and per 1000 km.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure: Option<RatePerExposure>,
    /// Description of the counts.
    #[serde(skip)]
    summary: String,
    /// Conclusion of the checker.
    #[serde(skip)]
    accepted: Option<String>,
}

impl CountReport {
    /// Describes the result of a count in a folder; `certificate` is the path of its certificate.
    #[must_use]
    pub fn new(
        plan: &RatePlan,
        result: &CountResult,
        folder: PathBuf,
        certificate: PathBuf,
    ) -> Self {
        let tally = &result.tally;
        let accepted = result.certificate.as_ref().ok();
        let rate_at_most = accepted.and_then(|certificate| match &certificate.statement {
            Statement::Rate(rate) => Some(rate.rate_at_most),
            _ => None,
        });
        let conclusion = accepted.and_then(|certificate| check(certificate).ok());
        Self {
            registration_sha256: tally.registration_sha256.clone(),
            folder: Some(folder),
            runs: tally.runs,
            failures: tally.failures,
            only_first_failed: tally.only_first_failed,
            only_second_failed: tally.only_second_failed,
            missing_answers: tally.missing_answers(),
            certificate: accepted.map(|_| certificate),
            rate_at_most,
            confidence: Some(plan.registration().confidence),
            exposure: None,
            summary: tally.summary(plan.record().is_comparison()),
            accepted: conclusion.map(|claim| claim.to_string()),
        }
    }

    /// Leaves out the folder, because it is deleted.
    #[must_use]
    pub fn without_folder(self) -> Self {
        let name = |path: PathBuf| path.file_name().map(PathBuf::from);
        Self {
            folder: None,
            certificate: self.certificate.and_then(name),
            ..self
        }
    }

    /// Adds rates per hour and per 1000 km.
    #[must_use]
    pub fn with_exposure(self, exposure: Option<RatePerExposure>) -> Self {
        Self { exposure, ..self }
    }

    /// Returns the conclusion of the checker; `None` if it accepted no certificate.
    #[must_use]
    pub fn conclusion(&self) -> Option<&str> {
        self.accepted.as_deref()
    }

    /// Describes why the counts prove nothing.
    #[must_use]
    pub fn describe_rejection(&self, rejection: &Rejection) -> String {
        let folder = self.folder.as_ref();
        let folder = folder.map_or_else(String::new, |path| format!(" in {}", path.display()));
        format!(
            "the counts{folder} prove nothing: {rejection} ({})",
            self.summary
        )
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("{}\n", self.summary);
        if let (Some(path), Some(accepted)) = (&self.certificate, &self.accepted) {
            let path = path.display().to_string();
            text += &format!("{}: accepted: {accepted}\n", TerminalText(&path));
        }
        if let Some(rate) = &self.exposure {
            text += &rate.to_text();
        }
        text
    }
}
