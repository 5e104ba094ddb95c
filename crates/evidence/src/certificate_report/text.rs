//! Reports on certificates as text.

use crumple_core::quoting::TerminalText;
use crumple_verify::{ClaimSubject, Scope, Statement};

use super::{CertificateReport, CountsStatus, describe_plants, is_built_in, joint_confidence};

/// Formats reports for a reader. `scenario` is the name of the requested scenario.
#[must_use]
pub fn report_text(all: &[CertificateReport<'_>], scenario: Option<&str>) -> String {
    let mut text: String = all.iter().map(|report| report.to_text(scenario)).collect();
    if let Some((bounds, confidence)) = joint_confidence(all) {
        let percent = (confidence * 1e8).floor() / 1e6;
        text += &format!(
            "together: all {bounds} bounds hold at confidence {percent} % (Bonferroni: the sum of their error \
             probabilities)\n"
        );
    }
    text
}

impl CertificateReport<'_> {
    fn to_text(&self, scenario: Option<&str>) -> String {
        let verdict = self.verdict_line(scenario);
        let coverage = self.coverage_line(scenario);
        if self.accepted.is_err() {
            return verdict + &coverage;
        }
        [
            verdict,
            coverage,
            self.count_lines(),
            self.scope_lines(),
            self.assumption_lines(),
            self.version_line(),
        ]
        .concat()
    }

    /// Returns the verdict for a reader, as a line. `scenario` is the name of the requested scenario.
    #[must_use]
    pub fn verdict_line(&self, scenario: Option<&str>) -> String {
        let path = TerminalText(&self.path);
        let accepted = match &self.accepted {
            Ok(accepted) => accepted,
            Err(rejection) => {
                return format!(
                    "{path}: rejected: {} is not proved: {}\n",
                    self.certificate.statement.name(),
                    TerminalText(rejection)
                );
            }
        };
        if let Some(CountsStatus::Refuted { .. }) = self.counts {
            return format!(
                "{path}: REFUTED: its counts are wrong, although the claim follows from them: {accepted}\n"
            );
        }
        if let (Some(scenario), Some(Err(why))) = (scenario, &self.covers_scenario) {
            let scenario = TerminalText(scenario);
            let why = TerminalText(why);
            return format!(
                "{path}: is NOT about {scenario}: {why}; the certificate itself is accepted: {accepted}\n"
            );
        }
        format!("{path}: accepted: {accepted}\n")
    }

    /// Returns a line about the requested scenario; empty if there is none, or if the verdict states it.
    fn coverage_line(&self, scenario: Option<&str>) -> String {
        match (scenario, &self.covers_scenario) {
            (Some(scenario), Some(Ok(()))) => format!("  is about {}\n", TerminalText(scenario)),
            (Some(scenario), Some(Err(why))) if self.accepted.is_err() => format!(
                "  is NOT about {}: {}\n",
                TerminalText(scenario),
                TerminalText(why)
            ),
            _ => String::new(),
        }
    }

    fn count_lines(&self) -> String {
        let mut text = String::new();
        if let Statement::Rate(rate) = &self.certificate.statement {
            text += &format!(
                "  counted: {} failures in {} runs\n",
                rate.failures, rate.registration.runs
            );
        }
        if let Some(counts) = &self.counts {
            text += &format!("  {}\n", TerminalText(&counts.summary()));
        }
        text
    }

    fn scope_lines(&self) -> String {
        let kind = match self.certificate.statement.subject() {
            ClaimSubject::Runs(_) => "space",
            _ => "scenario",
        };
        scope_lines(&self.scope(), kind, is_built_in(self.certificate))
    }

    fn assumption_lines(&self) -> String {
        let assumptions = self.certificate.assumptions.iter();
        let mut text: String = assumptions
            .map(|assumption| format!("  assuming that {assumption}\n"))
            .collect();
        if let Some(plants) = describe_plants(self.certificate, self.controllers) {
            text += &format!("  {plants}\n");
        }
        text
    }

    fn version_line(&self) -> String {
        let old = if self.certificate.is_first_version() {
            ", an old one: see docs/certificates.md for its limits"
        } else {
            ""
        };
        format!(
            "  version {}{old}; SHA-256 of its content, without spaces and line breaks: {}\n",
            self.certificate.version,
            self.certificate.digest()
        )
    }
}

/// Returns a scope as lines. The first one names the scenario or space; the next one states whether it is the built-in
/// one, if that is known.
pub(crate) fn scope_lines(scope: &Scope, kind: &str, is_built_in: Option<bool>) -> String {
    let scope = scope.to_string();
    let mut lines = scope.lines();
    let subject = lines.next().unwrap_or_default();
    let mut text = format!("  {subject}\n");
    match is_built_in {
        Some(true) => text += &format!("  this {kind} is the built-in one of that name\n"),
        Some(false) => text += &format!("  this {kind} is NOT the built-in one of that name\n"),
        None => {}
    }
    for line in lines {
        text += &format!("  {line}\n");
    }
    text
}
