//! The identity of a report: what was assessed, with which configuration and program, and when.

use serde::Serialize;

use super::parts::RunInfo;
use super::{AssessmentPlan, CommandFile};
use crumple_core::digest::sha256;

/// Number of digits of a hash in a title.
const SHORT_HASH_DIGITS: usize = 12;

/// The identity of a report, in all of its forms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ReportIdentity {
    /// Name of the assessed controller.
    pub subject: String,
    /// Description of the assessed controller.
    pub subject_description: String,
    /// SHA-256 of everything that affects the driving of the controller; absent if it states no identity.
    pub subject_sha256: Option<String>,
    /// Date and time in UTC, in the format of RFC 3339; absent if unknown. JSON has it in `provenance`.
    #[serde(skip)]
    pub date: Option<String>,
    /// File of the configuration in the report folder.
    pub configuration_file: &'static str,
    /// SHA-256 of that file.
    pub configuration_sha256: String,
    /// Commit of the repository with the assessed configuration, if there is one. JSON has it in `provenance`.
    #[serde(skip)]
    pub configuration_commit: Option<String>,
    /// Version of crumple.
    pub crumple: &'static str,
    /// Commit from which crumple was built, with a mark if its sources had changes; absent if the build states none.
    pub crumple_commit: Option<String>,
    /// SHA-256 of the program, if known. JSON has it in `provenance`.
    #[serde(skip)]
    pub program_sha256: Option<String>,
}

impl ReportIdentity {
    pub(super) fn new(plan: &AssessmentPlan, configuration: &CommandFile) -> Self {
        let subject = plan.subject();
        Self {
            subject: plan.subject_name().to_owned(),
            subject_description: subject
                .map_or_else(String::new, |subject| subject.source.description()),
            subject_sha256: subject.and_then(|subject| subject.source.identity()),
            date: None,
            configuration_file: CONFIGURATION_FILE,
            configuration_sha256: sha256(&configuration.contents),
            configuration_commit: None,
            crumple: env!("CARGO_PKG_VERSION"),
            crumple_commit: None,
            program_sha256: None,
        }
    }

    /// Adds the time and the program of the assessment.
    pub(super) fn with_run_info(self, run_info: &RunInfo) -> Self {
        Self {
            date: Some(run_info.at.clone()),
            configuration_commit: run_info.commit.clone(),
            crumple_commit: run_info.program_commit.clone(),
            program_sha256: Some(run_info.program_sha256.clone()),
            ..self
        }
    }

    /// Returns the title of the report.
    #[must_use]
    pub fn title(&self) -> String {
        format!("Assessment of `{}`", self.subject)
    }

    /// Returns the identity in one line, for the title of a window and the foot of a printed page. Hashes are short.
    #[must_use]
    pub fn one_line(&self) -> String {
        let hash = self.subject_sha256.as_deref().map(shorten_hash);
        let hash = hash.map_or_else(String::new, |hash| format!(" (SHA-256 {hash})"));
        let day = self.date.as_deref().and_then(|date| date.get(..10));
        let day = day.map_or_else(String::new, |day| format!(", {day}"));
        let commit = self.crumple_commit.as_deref().map(shorten_commit);
        let commit = commit.map_or_else(String::new, |commit| format!(", commit {commit}"));
        format!(
            "Assessment of {}{hash}{day}, crumple {}{commit}",
            self.subject, self.crumple
        )
    }

    /// Returns the parts of the identity, each with its name.
    pub(super) fn rows(&self) -> Vec<(&'static str, String)> {
        let mut rows = vec![(
            "subject",
            format!("{}: {}", self.subject, self.subject_description),
        )];
        let sha256 = self.subject_sha256.as_deref();
        let unknown = "none: the controller states no identity";
        rows.push(("subject, SHA-256", sha256.unwrap_or(unknown).to_owned()));
        rows.extend(self.date.clone().map(|date| ("date", date)));
        rows.push((
            "configuration",
            format!(
                "{}, SHA-256 {}",
                self.configuration_file, self.configuration_sha256
            ),
        ));
        let commit = self.configuration_commit.clone();
        rows.extend(commit.map(|commit| ("commit of the configuration", commit)));
        rows.push(("crumple", self.describe_program()));
        rows
    }

    fn describe_program(&self) -> String {
        let commit = self
            .crumple_commit
            .as_ref()
            .map(|commit| format!(", commit {commit}"));
        let program = self
            .program_sha256
            .as_ref()
            .map(|program| format!(", program SHA-256 {program}"));
        format!(
            "{}{}{}",
            self.crumple,
            commit.unwrap_or_default(),
            program.unwrap_or_default()
        )
    }
}

fn shorten_hash(hash: &str) -> &str {
    hash.get(..SHORT_HASH_DIGITS).unwrap_or(hash)
}

/// Shortens the hash of a commit, and keeps the mark behind it.
fn shorten_commit(commit: &str) -> String {
    let (hash, mark) = commit.split_once(' ').unwrap_or((commit, ""));
    format!("{} {mark}", shorten_hash(hash))
        .trim_end()
        .to_owned()
}

/// File of the configuration in the report folder.
pub(super) const CONFIGURATION_FILE: &str = "assessment.toml";
