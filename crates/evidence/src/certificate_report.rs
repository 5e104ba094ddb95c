//! Report of the checker on a certificate, for readers and for programs.

mod counts;
mod json;
mod text;

use super::binding::read_space;
use super::two_sided::ScenarioFollower;
use super::{BindingError, check_binding, count_omitted_vehicles};
pub use counts::CountsStatus;
use crumple_controllers::Controllers;
use crumple_sim::scenario::{PlantKind, built_in_scenario, file};
use crumple_spaces::{built_in_space, file as space_file};
use crumple_verify::{Certificate, ClaimSubject, ProvedClaim, Scope, WorkLimit, check, check_with};
pub(crate) use json::{RerunReport, describe_assumptions};
pub use json::{UncheckedCertificate, report_json, unchecked_json};
pub use text::report_text;
pub(crate) use text::scope_lines;

/// Report of the checker on a certificate.
#[derive(Debug)]
pub struct CertificateReport<'a> {
    /// File of the certificate.
    pub path: String,
    /// Certificate that was checked.
    pub certificate: &'a Certificate,
    /// Accepted statement, or the reason for the rejection.
    pub accepted: Result<ProvedClaim, String>,
    /// Confirmation of the counts, if the statement rests on counts.
    pub counts: Option<CountsStatus>,
    /// Reason why the certificate is not about the requested scenario, if one was requested.
    pub covers_scenario: Option<Result<(), String>>,
    /// Follower of the scenario for which the certificate was made, if that is known.
    pub follower: Option<ScenarioFollower>,
    /// Opens the drivers that texts name as files.
    pub controllers: Controllers,
}

impl<'a> CertificateReport<'a> {
    /// Checks a certificate and its binding to its texts. `policy` holds the bytes of the policy or network that it
    /// names; `limit` bounds the work.
    ///
    /// # Errors
    /// [`BindingError::StartRefused`] if a text names a program that may not start; this does not refute the
    /// certificate.
    pub fn check(
        path: String,
        certificate: &'a Certificate,
        policy: Option<&[u8]>,
        limit: WorkLimit,
        controllers: Controllers,
    ) -> Result<Self, BindingError> {
        let accepted =
            check_with(certificate, policy, limit).map_err(|rejection| rejection.to_string());
        let accepted = match (accepted, check_binding(certificate, policy, controllers)) {
            (Ok(_), Err(refused @ BindingError::StartRefused(_))) => return Err(refused),
            (Ok(_), Err(unbound)) => Err(unbound.to_string()),
            (accepted, _) => accepted,
        };
        Ok(Self {
            path,
            certificate,
            accepted,
            counts: None,
            covers_scenario: None,
            follower: None,
            controllers,
        })
    }

    /// Checks a certificate that was just made, without its binding.
    #[must_use]
    pub fn new(path: String, certificate: &'a Certificate, controllers: Controllers) -> Self {
        let accepted = check(certificate).map_err(|rejection| rejection.to_string());
        Self {
            path,
            certificate,
            accepted,
            counts: None,
            covers_scenario: None,
            follower: None,
            controllers,
        }
    }
}

impl CertificateReport<'_> {
    /// Adds the follower of the scenario for which the certificate was made.
    #[must_use]
    pub fn with_follower(self, follower: Option<ScenarioFollower>) -> Self {
        Self { follower, ..self }
    }

    /// True if the certificate is rejected, refuted, or not about the requested scenario.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        self.is_rejected() || matches!(self.covers_scenario, Some(Err(_)))
    }

    /// True if the statement is not proved, or its counts are refuted.
    #[must_use]
    pub fn is_rejected(&self) -> bool {
        self.accepted.is_err() || matches!(self.counts, Some(CountsStatus::Refuted { .. }))
    }

    fn confidence(&self) -> Option<f64> {
        match self.accepted {
            Ok(
                ProvedClaim::Rate { confidence, .. } | ProvedClaim::FailsLessOften { confidence },
            ) => Some(confidence),
            _ => None,
        }
    }

    fn scope(&self) -> Scope {
        match count_omitted_vehicles(self.certificate) {
            Some(vehicles) => self.certificate.scope_with_uncovered_vehicles(vehicles),
            None => self.certificate.scope(),
        }
    }
}

/// Returns true if the scenario or space of the certificate is the built-in one of that name; `None` without such a
/// name or text.
pub(crate) fn is_built_in(certificate: &Certificate) -> Option<bool> {
    let provenance = &certificate.provenance;
    let text = provenance
        .scenario_text
        .as_ref()
        .filter(|_| !certificate.is_first_version())?;
    let built_in = match certificate.statement.subject() {
        ClaimSubject::Runs(_) => {
            space_file::to_identity_toml(&built_in_space(&provenance.scenario)?)
        }
        _ => file::to_toml(&built_in_scenario(&provenance.scenario)?),
    };
    Some(built_in.is_ok_and(|built_in| built_in == *text))
}

/// Returns the plants of a space; `None` for other statements, which have the plants as an assumption.
pub(crate) fn describe_plants(
    certificate: &Certificate,
    controllers: Controllers,
) -> Option<&'static str> {
    let ClaimSubject::Runs(_) = certificate.statement.subject() else {
        return None;
    };
    let space = read_space(certificate, controllers).ok()?;
    let scenario = space.scenario_at(&space.nominal()).ok()?;
    let is_multi_body = scenario
        .vehicles()
        .iter()
        .any(|vehicle| vehicle.plant == PlantKind::MultiBody);
    Some(if is_multi_body {
        "some of its vehicles have the plant `multi-body`"
    } else {
        "its vehicles have the plant `point-mass`"
    })
}

/// Returns the number of accepted bounds and their joint confidence level by the Bonferroni inequality, if there are
/// several.
fn joint_confidence(all: &[CertificateReport<'_>]) -> Option<(usize, f64)> {
    let open: Vec<f64> = all
        .iter()
        .filter_map(CertificateReport::confidence)
        .map(|confidence| 1.0 - confidence)
        .collect();
    (open.len() > 1).then(|| {
        (
            open.len(),
            (1.0 - open
                .iter()
                .fold(0.0, |sum: f64, share| (sum + share).next_up()))
            .max(0.0),
        )
    })
}
