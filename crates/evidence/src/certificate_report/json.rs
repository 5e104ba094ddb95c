//! Reports on certificates as JSON.

use crumple_verify::{Assumption, ProvedClaim};
use serde::Serialize;

use super::counts::detection_probabilities;
use super::{CertificateReport, CountsStatus, is_built_in, joint_confidence};
use crate::two_sided::ScenarioFollower;

#[derive(Default, Serialize)]
struct ReportLine<'a> {
    certificate: &'a str,
    accepted: bool,
    claim: &'static str,
    version: u32,
    sha256: String,
    scenario: &'a str,
    is_built_in: Option<bool>,
    horizon_s: Option<f64>,
    scope: Vec<String>,
    assumptions: Vec<String>,
    smallest_gap_m: Option<f64>,
    overlap_m: Option<f64>,
    gap_bound_m: Option<f64>,
    afterwards: Option<&'static str>,
    verified_share: Option<f64>,
    rate_at_most: Option<f64>,
    confidence: Option<f64>,
    joint_confidence: Option<f64>,
    counts: Option<&'static str>,
    rerun: Option<RerunReport>,
    rejection: Option<String>,
    about_scenario: Option<bool>,
    not_about_scenario: Option<&'a str>,
    #[serde(flatten)]
    follower: Option<&'a ScenarioFollower>,
}

#[derive(Serialize)]
pub(crate) struct RerunReport {
    runs: u64,
    total_runs: u64,
    blocks: u64,
    total_blocks: u64,
    seed: Option<u64>,
    /// Numbers of forged runs, each with the minimum probability of detection.
    detection_probabilities: [(u64, f64); 3],
}

/// Report of a file that is no certificate, or that could not be checked.
#[derive(Debug, Serialize)]
pub struct UncheckedCertificate {
    certificate: String,
    /// Always false.
    accepted: bool,
    error: String,
}

impl UncheckedCertificate {
    /// Describes why the checker has not seen the file.
    #[must_use]
    pub fn new(path: String, error: String) -> Self {
        Self {
            certificate: path,
            accepted: false,
            error,
        }
    }
}

/// Formats reports as one JSON object per line.
///
/// # Errors
/// None in practice; only the serializer can fail.
pub fn report_json(all: &[CertificateReport<'_>]) -> Result<String, serde_json::Error> {
    let joint_confidence = joint_confidence(all).map(|(_, confidence)| confidence);
    let lines: Vec<_> = all
        .iter()
        .map(|report| ReportLine::new(report, joint_confidence))
        .collect();
    to_lines(&lines)
}

/// Formats reports of unchecked files as one JSON object per line.
///
/// # Errors
/// None in practice; only the serializer can fail.
pub fn unchecked_json(files: &[UncheckedCertificate]) -> Result<String, serde_json::Error> {
    to_lines(files)
}

fn to_lines(objects: &[impl Serialize]) -> Result<String, serde_json::Error> {
    objects
        .iter()
        .map(|object| Ok(serde_json::to_string(object)? + "\n"))
        .collect()
}

impl<'a> ReportLine<'a> {
    fn new(report: &'a CertificateReport<'a>, joint_confidence: Option<f64>) -> Self {
        let certificate = report.certificate;
        let scope = report.scope();
        let refuted = match &report.counts {
            Some(CountsStatus::Refuted { reason }) => Some(reason.clone()),
            _ => None,
        };
        let coverage = report.covers_scenario.as_ref();
        let mut line = Self {
            certificate: &report.path,
            accepted: report.accepted.is_ok() && refuted.is_none(),
            claim: certificate.statement.name(),
            version: certificate.version,
            sha256: certificate.digest(),
            scenario: &certificate.provenance.scenario,
            is_built_in: is_built_in(certificate),
            horizon_s: scope.horizon_s.and_then(finite),
            scope: scope.to_string().lines().map(str::to_owned).collect(),
            assumptions: describe_assumptions(&certificate.assumptions).collect(),
            confidence: report.confidence(),
            joint_confidence: joint_confidence.filter(|_| report.confidence().is_some()),
            counts: report.counts.as_ref().map(CountsStatus::name),
            rerun: report.counts.as_ref().and_then(RerunReport::new),
            rejection: report.accepted.as_ref().err().cloned().or(refuted),
            about_scenario: coverage.map(Result::is_ok),
            not_about_scenario: coverage
                .and_then(|covers| covers.as_ref().err())
                .map(String::as_str),
            follower: report.follower.as_ref(),
            ..Self::default()
        };
        if let Ok(claim) = &report.accepted {
            line.add_claim(claim);
        }
        line
    }

    /// Adds the values that the checker proved.
    fn add_claim(&mut self, claim: &ProvedClaim) {
        match *claim {
            ProvedClaim::Avoidable {
                min_gap_m,
                after_horizon,
                ..
            } => {
                self.smallest_gap_m = Some(min_gap_m);
                self.afterwards = Some(after_horizon.name());
            }
            ProvedClaim::Unavoidable { overlap_m, .. } => self.overlap_m = finite(overlap_m),
            ProvedClaim::GapBound { gap_m, .. } => self.gap_bound_m = Some(gap_m),
            ProvedClaim::Rate { max_rate, .. } => self.rate_at_most = Some(max_rate),
            ProvedClaim::Reach {
                min_gap_m,
                verified_share,
                ..
            } => {
                self.smallest_gap_m = finite(min_gap_m);
                self.verified_share = Some(verified_share);
            }
            ProvedClaim::Invariant {
                share, min_gap_m, ..
            } => {
                self.smallest_gap_m = finite(min_gap_m);
                self.verified_share = Some(share);
            }
            _ => {}
        }
    }
}

impl RerunReport {
    pub(crate) fn new(counts: &CountsStatus) -> Option<Self> {
        let CountsStatus::Confirmed { confirmation, seed } = counts else {
            return None;
        };
        Some(Self {
            runs: confirmation.runs,
            total_runs: confirmation.total_runs,
            blocks: confirmation.blocks,
            total_blocks: confirmation.total_blocks,
            seed: *seed,
            detection_probabilities: detection_probabilities(confirmation),
        })
    }
}

/// Returns assumptions as texts.
pub(crate) fn describe_assumptions(assumptions: &[Assumption]) -> impl Iterator<Item = String> {
    assumptions.iter().map(Assumption::to_string)
}

/// Returns a finite number. JSON has no infinity; `None` is an overlap of unknown size.
fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|value| value.is_finite())
}
