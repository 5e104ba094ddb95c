//! Reports on pools as JSON.

use crumple_verify::pool::FIXED_RANGE_ASSUMPTION;
use serde::{Serialize, Serializer};

use super::{PoolReport, RejectedPool};
use crate::CountsStatus;
use crate::certificate_report::{RerunReport, describe_assumptions};

/// Report on a pool, accepted or rejected.
#[derive(Default, Serialize)]
struct PoolLine {
    /// Number of certificates.
    pool: usize,
    accepted: bool,
    claim: &'static str,
    sha256: Option<String>,
    scenario: Option<String>,
    is_built_in: Option<bool>,
    horizon_s: Option<f64>,
    scope: Vec<String>,
    assumptions: Vec<String>,
    seeds: Option<[u64; 2]>,
    is_expected_range: Option<bool>,
    runs: Option<u64>,
    failures: Option<u64>,
    rate_at_most: Option<f64>,
    confidence: Option<f64>,
    counts: Option<&'static str>,
    rerun: Option<RerunReport>,
    rejection: Option<String>,
}

impl Serialize for PoolReport {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.line().serialize(serializer)
    }
}

impl PoolReport {
    /// Returns the report as one line of JSON.
    ///
    /// # Errors
    /// None in practice; only the serializer can fail.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        to_line(&self.line())
    }

    /// Returns the assumptions of every certificate and that of the pool, as texts.
    pub(super) fn assumptions(&self) -> Vec<String> {
        let own = FIXED_RANGE_ASSUMPTION.to_owned();
        describe_assumptions(&self.claim.assumptions)
            .chain([own])
            .collect()
    }

    fn line(&self) -> PoolLine {
        let claim = &self.claim;
        let refuted = match &self.counts {
            CountsStatus::Refuted { reason } => Some(reason.clone()),
            _ => None,
        };
        PoolLine {
            pool: self.certificates,
            accepted: refuted.is_none(),
            claim: "rate",
            sha256: Some(claim.sha256.clone()),
            scenario: Some(self.space.clone()),
            is_built_in: self.is_built_in,
            horizon_s: claim.scope.horizon_s,
            scope: claim.scope.to_string().lines().map(str::to_owned).collect(),
            assumptions: self.assumptions(),
            seeds: Some([claim.first_seed, claim.last_seed]),
            is_expected_range: Some(claim.is_expected_range),
            runs: Some(claim.runs),
            failures: Some(claim.failures),
            rate_at_most: Some(claim.max_rate),
            confidence: Some(claim.confidence),
            counts: Some(self.counts.name()),
            rerun: RerunReport::new(&self.counts),
            rejection: refuted,
        }
    }
}

impl RejectedPool {
    /// Returns the report as one line of JSON.
    ///
    /// # Errors
    /// None in practice; only the serializer can fail.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        to_line(&PoolLine {
            pool: self.certificates,
            claim: "rate",
            rejection: Some(self.rejection.clone()),
            ..PoolLine::default()
        })
    }
}

fn to_line(line: &PoolLine) -> Result<String, serde_json::Error> {
    Ok(serde_json::to_string(line)? + "\n")
}
