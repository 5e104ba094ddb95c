//! Report of the checker on a certificate, for readers and for programs.

use super::binding::read_space;
use super::{BindingError, Confirmation, check_binding, count_omitted_vehicles};
use crumple_controllers::Controllers;
use crumple_core::quoting::TerminalText;
use crumple_sim::scenario::{PlantKind, built_in_scenario, file};
use crumple_spaces::{built_in_space, file as space_file};
use crumple_verify::certificate::UNVERIFIED_COUNTS_CAVEAT;
use crumple_verify::{
    Certificate, ClaimSubject, ProvedClaim, Scope, Statement, WorkLimit, check, check_with,
};
use serde::Serialize;

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
    /// Opens the drivers that texts name as files.
    pub controllers: Controllers,
}

/// Confirmation of the counts of a certificate.
#[derive(Debug)]
pub enum CountsStatus {
    /// No run was repeated.
    Unconfirmed,
    /// Some or all runs were repeated, with the stated results.
    Confirmed {
        /// Repeated runs.
        confirmation: Confirmation,
        /// Seed of the sample, if not all runs were repeated.
        seed: Option<u64>,
    },
    /// A repeated run had another result.
    Refuted {
        /// Description of the first difference.
        because: String,
    },
}

impl CountsStatus {
    fn name(&self) -> &'static str {
        match self {
            Self::Unconfirmed => "makers_word",
            Self::Confirmed { confirmation, .. } if confirmation.is_complete() => "confirmed",
            Self::Confirmed { .. } => "confirmed_by_sample",
            Self::Refuted { .. } => "refuted",
        }
    }

    fn summary(&self) -> String {
        match self {
            Self::Unconfirmed => UNVERIFIED_COUNTS_CAVEAT.to_owned(),
            Self::Refuted { because } => format!("refuted by a new count: {because}"),
            Self::Confirmed { confirmation, .. } if confirmation.is_complete() => format!(
                "confirmed: all {} runs were drawn and simulated again, and each has the stated result",
                confirmation.total_runs
            ),
            Self::Confirmed { confirmation, seed } => {
                let Confirmation {
                    blocks,
                    total_blocks: of_blocks,
                    runs,
                    total_runs: of_runs,
                    ..
                } = confirmation;
                let mut chances = detection_probabilities(confirmation).to_vec();
                // With few runs, 1 % is one run as well.
                chances.dedup();
                let chance = |(forged, chance): (u64, f64)| {
                    let runs = if forged == 1 { "run" } else { "runs" };
                    format!(
                        "{forged} forged {runs}: {:.2} %",
                        (1e4 * chance).floor() / 1e2
                    )
                };
                let chances: Vec<String> = chances.into_iter().map(chance).collect();
                format!(
                    "confirmed by a sample: {blocks} of {of_blocks} blocks, {runs} of {of_runs} runs ({:.2} %), were \
                     drawn and simulated again, and each has the stated result. If seed {} was chosen after the file \
                     was fixed, the minimum probability of detection is, for {}",
                    (1e4 * *runs as f64 / *of_runs as f64).floor() / 1e2,
                    seed.unwrap_or_default(),
                    chances.join(", ")
                )
            }
        }
    }
}

/// Returns the probabilities of detecting one forged run, 1 % and 10 % forged runs.
fn detection_probabilities(confirmation: &Confirmation) -> [(u64, f64); 3] {
    [
        1,
        confirmation.total_runs.div_ceil(100),
        confirmation.total_runs.div_ceil(10),
    ]
    .map(|forged| (forged, confirmation.detection_probability(forged)))
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
            controllers,
        }
    }
}

impl CertificateReport<'_> {
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

    /// True if the scenario or space of the certificate is the built-in one of that name; `None` without such a name or
    /// text.
    fn is_built_in(&self) -> Option<bool> {
        let provenance = &self.certificate.provenance;
        let text = provenance
            .scenario_text
            .as_ref()
            .filter(|_| !self.certificate.is_first_version())?;
        let built_in = match self.certificate.statement.subject() {
            ClaimSubject::Runs(_) => space_file::to_toml(&built_in_space(&provenance.scenario)?),
            _ => file::to_toml(&built_in_scenario(&provenance.scenario)?),
        };
        Some(built_in.is_ok_and(|built_in| built_in == *text))
    }

    /// Returns the plants of a space; `None` for other statements, which have the plants as an assumption.
    fn plants(&self) -> Option<&'static str> {
        let ClaimSubject::Runs(_) = self.certificate.statement.subject() else {
            return None;
        };
        let space = read_space(self.certificate, self.controllers).ok()?;
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

    fn scope(&self) -> Scope {
        match count_omitted_vehicles(self.certificate) {
            Some(vehicles) => self.certificate.scope_with_uncovered_vehicles(vehicles),
            None => self.certificate.scope(),
        }
    }

    fn text(&self, scenario: Option<&str>) -> String {
        let Self {
            certificate,
            accepted,
            counts,
            covers_scenario: about,
            ..
        } = self;
        let path = TerminalText(&self.path);
        let mut text = match accepted {
            Ok(accepted) if matches!(counts, Some(CountsStatus::Refuted { .. })) => {
                format!(
                    "{path}: REFUTED: its counts are wrong, although the claim follows from them: {accepted}\n"
                )
            }
            Ok(accepted) if let (Some(scenario), Some(Err(why))) = (scenario, about) => {
                let (scenario, why) = (TerminalText(scenario), TerminalText(why));
                format!(
                    "{path}: is NOT about {scenario}: {why}; the certificate itself is accepted: {accepted}\n"
                )
            }
            Ok(accepted) => format!("{path}: accepted: {accepted}\n"),
            Err(rejection) => {
                format!(
                    "{path}: rejected: {} is not proved: {}\n",
                    certificate.statement.name(),
                    TerminalText(rejection)
                )
            }
        };
        match (scenario, about) {
            (Some(scenario), Some(Ok(()))) => {
                text += &format!("  is about {}\n", TerminalText(scenario))
            }
            (Some(scenario), Some(Err(why))) if accepted.is_err() => {
                text += &format!(
                    "  is NOT about {}: {}\n",
                    TerminalText(scenario),
                    TerminalText(why)
                );
            }
            _ => {}
        }
        if accepted.is_err() {
            return text;
        }
        if let Statement::Rate(rate) = &certificate.statement {
            text += &format!(
                "  counted: {} failures in {} runs\n",
                rate.failures, rate.registration.runs
            );
        }
        text += &counts
            .iter()
            .map(|counts| format!("  {}\n", TerminalText(&counts.summary())))
            .collect::<String>();
        text += &self
            .scope()
            .to_string()
            .lines()
            .map(|line| format!("  {line}\n"))
            .collect::<String>();
        match self.is_built_in() {
            Some(true) => text += "  it is the built-in scenario or space of that name\n",
            Some(false) => text += "  it is NOT the built-in scenario or space of that name\n",
            None => {}
        }
        for assumption in &certificate.assumptions {
            text += &format!("  assuming that {assumption}\n");
        }
        text += &self
            .plants()
            .map(|plants| format!("  {plants}\n"))
            .unwrap_or_default();
        let old = if certificate.is_first_version() {
            ", an old one: see docs/certificates.md for its limits"
        } else {
            ""
        };
        text + &format!(
            "  version {}{old}; SHA-256 of its content, without spaces and line breaks: {}\n",
            certificate.version,
            certificate.digest()
        )
    }
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
            (1.0 - open.iter().fold(0.0, |sum: f64, one| (sum + one).next_up())).max(0.0),
        )
    })
}

/// Formats reports for a reader. `scenario` is the name of the requested scenario.
#[must_use]
pub fn report_text(all: &[CertificateReport<'_>], scenario: Option<&str>) -> String {
    let mut text: String = all.iter().map(|one| one.text(scenario)).collect();
    if let Some((bounds, confidence)) = joint_confidence(all) {
        let percent = (confidence * 1e8).floor() / 1e6;
        text += &format!(
            "together: all {bounds} bounds hold at confidence {percent} % (Bonferroni: the sum of their error \
             probabilities)\n"
        );
    }
    text
}

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
}

#[derive(Serialize)]
struct RerunReport {
    runs: u64,
    #[serde(rename = "of_runs")]
    total_runs: u64,
    blocks: u64,
    #[serde(rename = "of_blocks")]
    total_blocks: u64,
    seed: Option<u64>,
    /// Numbers of forged runs, each with the minimum probability of detection.
    #[serde(rename = "catches")]
    detection_probabilities: [(u64, f64); 3],
}

/// Formats reports as one JSON object per line.
///
/// # Errors
/// None in practice; only the serializer can fail.
pub fn report_json(all: &[CertificateReport<'_>]) -> Result<String, serde_json::Error> {
    let joint_confidence = joint_confidence(all).map(|(_, confidence)| confidence);
    let lines = all
        .iter()
        .map(|one| Ok(serde_json::to_string(&report_line(one, joint_confidence))? + "\n"));
    lines.collect()
}

fn report_line<'a>(
    one: &'a CertificateReport<'a>,
    joint_confidence: Option<f64>,
) -> ReportLine<'a> {
    let CertificateReport {
        path,
        certificate,
        accepted,
        counts,
        covers_scenario: about,
        controllers: _,
    } = one;
    // JSON has no infinity; `None` is an overlap of unknown size.
    let finite = |value: f64| Some(value).filter(|value| value.is_finite());
    let scope = one.scope();
    let refuted = match counts {
        Some(CountsStatus::Refuted { because }) => Some(because.clone()),
        _ => None,
    };
    let mut line = ReportLine {
        certificate: path,
        accepted: accepted.is_ok() && refuted.is_none(),
        claim: certificate.statement.name(),
        version: certificate.version,
        sha256: certificate.digest(),
        scenario: &certificate.provenance.scenario,
        is_built_in: one.is_built_in(),
        horizon_s: scope.horizon_s.and_then(finite),
        scope: scope.to_string().lines().map(str::to_owned).collect(),
        confidence: one.confidence(),
        joint_confidence: joint_confidence.filter(|_| one.confidence().is_some()),
        counts: counts.as_ref().map(CountsStatus::name),
        rejection: accepted.as_ref().err().cloned().or(refuted),
        about_scenario: about.as_ref().map(Result::is_ok),
        not_about_scenario: about
            .as_ref()
            .and_then(|about| about.as_ref().err())
            .map(String::as_str),
        ..ReportLine::default()
    };
    if let Some(CountsStatus::Confirmed { confirmation, seed }) = counts {
        line.rerun = Some(RerunReport {
            runs: confirmation.runs,
            total_runs: confirmation.total_runs,
            blocks: confirmation.blocks,
            total_blocks: confirmation.total_blocks,
            seed: *seed,
            detection_probabilities: detection_probabilities(confirmation),
        });
    }
    match *accepted {
        Ok(ProvedClaim::Avoidable {
            min_gap_m,
            after_horizon,
            ..
        }) => {
            (line.smallest_gap_m, line.afterwards) = (Some(min_gap_m), Some(after_horizon.name()));
        }
        Ok(ProvedClaim::Unavoidable { overlap_m, .. }) => line.overlap_m = finite(overlap_m),
        Ok(ProvedClaim::GapBound { gap_m, .. }) => line.gap_bound_m = Some(gap_m),
        Ok(ProvedClaim::Rate { max_rate, .. }) => line.rate_at_most = Some(max_rate),
        Ok(ProvedClaim::Reach {
            min_gap_m,
            verified_share,
            ..
        }) => {
            (line.smallest_gap_m, line.verified_share) = (finite(min_gap_m), Some(verified_share));
        }
        Ok(ProvedClaim::Invariant {
            share, min_gap_m, ..
        }) => {
            (line.smallest_gap_m, line.verified_share) = (finite(min_gap_m), Some(share));
        }
        _ => {}
    }
    line
}
