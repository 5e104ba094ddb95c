//! `crumple check`: accept or reject certificates, by the checker alone.

use std::fs::File;
use std::path::{Path, PathBuf};

use clap::Args;
use crumple_verify::{Accepted, Certificate, ParseError, Rejection, Statement, WorkLimit, check_within};
use serde::Serialize;

use super::simulate::Format;
use super::{Failure, output, subject};
use crumple_search::worst_case::is_about;
use crumple_world::policy::Policy;
use crumple_world::scenario::Scenario;

/// Accept or reject certificates with the small checker alone
#[derive(Args)]
#[command(after_long_help = "\
The checker (crate crumple-verify) shares no code with the simulation, the search or the solver: it reads the file and \
recomputes everything in outward-rounded interval arithmetic. Exit code 1 if a certificate is rejected, or takes more work to \
check than --work-limit allows, or is not about the scenario named with --scenario; 2 if a file is no certificate.

Examples:
  crumple avoid paper-1 --certificate paper-1.json
  crumple check paper-1.json --scenario paper-1")]
pub(super) struct Check {
    /// Certificates
    #[arg(required = true, value_name = "CERTIFICATE")]
    certificates: Vec<PathBuf>,
    /// Also check that the certificates speak about this scenario
    #[arg(long, value_name = "S")]
    scenario: Option<String>,
    /// The policy file of certificates about a policy; the one beside the certificate without it
    #[arg(long, value_name = "F")]
    policy: Option<PathBuf>,
    /// Billions of operations that checking one certificate may take; the default is some ten minutes of one core
    #[arg(long, value_name = "N", default_value_t = WorkLimit::default().in_billions())]
    work_limit: u64,
    /// How to print: for a reader, or one JSON object a certificate
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// One line of `--format json`.
#[derive(Serialize)]
struct Report<'a> {
    certificate: String,
    accepted: bool,
    claim: &'static str,
    scenario: &'a str,
    smallest_gap_m: Option<f64>,
    overlap_m: Option<f64>,
    verified_share: Option<f64>,
    rate_at_most: Option<f64>,
    confidence: Option<f64>,
    rejection: Option<String>,
    about_scenario: Option<bool>,
}

impl Check {
    pub(super) fn run(self) -> Result<(), Failure> {
        let scenario = self.scenario.as_deref().map(subject::scenario).transpose()?;
        let read = self.certificates.iter().map(|path| Ok((path, certificate(path)?)));
        let certificates = read.collect::<Result<Vec<_>, Failure>>()?;
        let mut text = String::new();
        let mut refused = Vec::new();
        for (path, certificate) in &certificates {
            let policy = self.policy_bytes(certificate, path);
            let checked = check_within(certificate, policy.as_deref(), WorkLimit::billions(self.work_limit));
            let about = scenario.as_ref().map(|scenario| is_about(certificate, scenario));
            if checked.is_err() || about == Some(false) {
                refused.push(path.display().to_string());
            }
            text += &match self.format {
                Format::Json => {
                    let report = report(path, certificate, &checked, about);
                    serde_json::to_string(&report).map_err(Failure::input)? + "\n"
                }
                Format::Text => describe(path, certificate, &checked, scenario.as_ref(), about),
            };
        }
        output::print(&text)?;
        if refused.is_empty() { Ok(()) } else { Err(Failure::Gate(format!("rejected: {}", refused.join(", ")))) }
    }
}

impl Check {
    /// What the checker needs of a policy. The reference policy comes with the program: only its digest, which the checker
    /// computes again, says that it is the one meant.
    fn policy_bytes(&self, certificate: &Certificate, path: &Path) -> Option<Vec<u8>> {
        let found = certificate.policy_bytes(path, self.policy.as_deref());
        let Statement::Reach(_) = certificate.statement else { return found };
        found.or_else(|| self.policy.is_none().then(|| Policy::reference_bytes().to_vec()))
    }
}

fn certificate(path: &Path) -> Result<Certificate, Failure> {
    let file = File::open(path).map_err(|source| Failure::unreadable(path.to_owned(), source))?;
    Certificate::from_reader(file).map_err(|error| match error {
        ParseError::Read(source) => Failure::unreadable(path.to_owned(), source),
        other => Failure::Input(format!("{}: {other}", path.display())),
    })
}

fn report<'a>(
    path: &Path,
    certificate: &'a Certificate,
    checked: &Result<Accepted, Rejection>,
    about_scenario: Option<bool>,
) -> Report<'a> {
    let (mut smallest_gap_m, mut overlap_m, mut verified_share) = (None, None, None);
    let (mut rate_at_most, mut with_confidence) = (None, None);
    match *checked {
        Ok(Accepted::Avoidable { smallest_gap_m: gap_m }) => smallest_gap_m = Some(gap_m),
        // JSON has no infinity: an overlap of any size.
        Ok(Accepted::Unavoidable { overlap_m: metres }) => overlap_m = Some(metres).filter(|metres| metres.is_finite()),
        Ok(Accepted::Rate { at_most, confidence }) => {
            (rate_at_most, with_confidence) = (Some(at_most), Some(confidence));
        }
        Ok(Accepted::Reach { smallest_gap_m: gap_m, verified_share: share, .. }) => {
            (smallest_gap_m, verified_share) = (Some(gap_m).filter(|gap_m| gap_m.is_finite()), Some(share));
        }
        Ok(Accepted::FailsLessOften { confidence }) => with_confidence = Some(confidence),
        Ok(_) | Err(_) => {}
    }
    Report {
        certificate: path.display().to_string(),
        accepted: checked.is_ok(),
        claim: certificate.statement.name(),
        scenario: &certificate.provenance.scenario,
        smallest_gap_m,
        overlap_m,
        verified_share,
        rate_at_most,
        confidence: with_confidence,
        rejection: checked.as_ref().err().map(ToString::to_string),
        about_scenario,
    }
}

fn describe(
    path: &Path,
    certificate: &Certificate,
    checked: &Result<Accepted, Rejection>,
    scenario: Option<&Scenario>,
    about: Option<bool>,
) -> String {
    let name = path.display();
    let mut text = match checked {
        Ok(accepted) => format!("{name}: accepted: {accepted}\n"),
        Err(rejection) => format!("{name}: rejected: {} is not proved: {rejection}\n", certificate.statement.name()),
    };
    if let (Some(scenario), Some(about)) = (scenario, about) {
        let verb = if about { "is about" } else { "is NOT about" };
        text += &format!("  {verb} {}\n", scenario.spec().name);
    }
    if checked.is_ok() {
        if let Statement::Rate(rate) = &certificate.statement {
            text += &format!("  from {} failures in {} runs, as counted\n", rate.failures, rate.registration.runs);
        }
        for assumption in &certificate.assumptions {
            text += &format!("  assuming that {assumption}\n");
        }
    }
    text
}
