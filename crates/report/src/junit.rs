//! JUnit reports, the XML that build servers read, in the form of <https://github.com/testmoapp/junitxml>.
//!
//! Cases may verify requirements. Their properties are those that the converters of Eclipse S-CORE and useblocks read:
//! `FullyVerifies` and `PartiallyVerifies`, each a list of names with commas between them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Write};

use quick_xml::escape::escape;

use crumple_core::quoting::TerminalLines;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JunitStatus {
    Passed,
    Failed,
    Error,
    Skipped,
}

impl JunitStatus {
    fn element(self) -> Option<&'static str> {
        match self {
            Self::Passed => None,
            Self::Failed => Some("failure"),
            Self::Error => Some("error"),
            Self::Skipped => Some("skipped"),
        }
    }
}

#[derive(Debug)]
pub(crate) struct JunitCase {
    /// Group of the case, with dots between its parts.
    pub(crate) class: String,
    pub(crate) name: String,
    /// Path of the failing scenario, relative to the folder of the report.
    pub(crate) file: Option<String>,
    /// Gate or test, the same for all controllers that are tested by it.
    pub(crate) verifier: String,
    /// Requirements that the case verifies.
    pub(crate) requirements: Vec<String>,
    pub(crate) status: JunitStatus,
    /// Reason of a result other than a pass.
    pub(crate) message: Option<String>,
    pub(crate) output: String,
}

/// A test suite: cases, and properties as names with values.
#[derive(Debug, Default)]
pub(crate) struct JunitSuite {
    pub(crate) name: String,
    /// Date and time in UTC, in the format of RFC 3339.
    pub(crate) timestamp: Option<String>,
    /// Measured duration of all cases together, in seconds. They share runs, so that no case has a time of its own.
    pub(crate) time_s: Option<f64>,
    pub(crate) properties: Vec<(String, String)>,
    pub(crate) cases: Vec<JunitCase>,
}

/// Renders suites as XML. Control characters are shown as escapes.
///
/// `time_s` is the measured duration of all suites and of other work, in whole seconds.
pub(crate) fn render_xml(name: &str, time_s: Option<u64>, suites: &[JunitSuite]) -> String {
    let cases = suites.iter().flat_map(|suite| &suite.cases);
    let requirements = RequirementVerifiers::new(cases.clone());
    let [skipped, failures, errors] = count_statuses(cases);
    let name = escape(name);
    let tests: usize = suites.iter().map(|suite| suite.cases.len()).sum();
    let time = time_s.map_or_else(String::new, |time_s| format!(" time=\"{time_s}\""));
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites name=\"{name}\" tests=\"{tests}\" \
         skipped=\"{skipped}\" failures=\"{failures}\" errors=\"{errors}\"{time}>\n"
    );
    // Writing to a string cannot fail.
    let _ = suites
        .iter()
        .try_for_each(|suite| suite.write(&requirements, &mut text));
    TerminalLines(&(text + "</testsuites>\n")).to_string()
}

/// The gates and tests that verify each requirement.
struct RequirementVerifiers<'a> {
    by_requirement: BTreeMap<&'a str, BTreeSet<&'a str>>,
}

impl<'a> RequirementVerifiers<'a> {
    fn new(cases: impl Iterator<Item = &'a JunitCase>) -> Self {
        let mut by_requirement: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for case in cases {
            for requirement in &case.requirements {
                let verifiers = by_requirement.entry(requirement).or_default();
                verifiers.insert(&case.verifier);
            }
        }
        Self { by_requirement }
    }

    /// True if only one gate or test verifies the requirement.
    fn is_verified_once(&self, requirement: &str) -> bool {
        let verifiers = self.by_requirement.get(requirement);
        verifiers.is_some_and(|verifiers| verifiers.len() == 1)
    }

    /// Returns the properties of a case. A gate or test that verifies a requirement alone verifies it fully; several
    /// verify it together, each partially.
    fn properties(&self, case: &JunitCase) -> Vec<(&'static str, String)> {
        let (alone, together): (Vec<_>, Vec<_>) = case
            .requirements
            .iter()
            .map(String::as_str)
            .partition(|name| self.is_verified_once(name));
        let lists = [("FullyVerifies", alone), ("PartiallyVerifies", together)];
        lists
            .into_iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(property, names)| (property, names.join(", ")))
            .collect()
    }
}

/// Counts the skipped cases, the failures and the errors.
fn count_statuses<'a>(cases: impl Iterator<Item = &'a JunitCase> + Clone) -> [usize; 3] {
    [
        JunitStatus::Skipped,
        JunitStatus::Failed,
        JunitStatus::Error,
    ]
    .map(|status| cases.clone().filter(|case| case.status == status).count())
}

/// Writes properties as an element, unless there are none.
fn write_properties<N: AsRef<str>>(
    properties: &[(N, String)],
    indent: &str,
    out: &mut String,
) -> fmt::Result {
    if properties.is_empty() {
        return Ok(());
    }
    writeln!(out, "{indent}<properties>")?;
    for (name, value) in properties {
        let name = escape(name.as_ref());
        let value = escape(value);
        writeln!(
            out,
            r#"{indent}    <property name="{name}" value="{value}"/>"#
        )?;
    }
    writeln!(out, "{indent}</properties>")
}

/// Joins the parts of the class of a case. Build servers split a class at its dots, so those of names are replaced.
pub(crate) fn join_class(parts: &[&str]) -> String {
    let parts = parts.iter().map(|part| part.replace('.', "_"));
    parts.collect::<Vec<_>>().join(".")
}

impl JunitSuite {
    fn write(&self, requirements: &RequirementVerifiers<'_>, out: &mut String) -> fmt::Result {
        let [skipped, failures, errors] = count_statuses(self.cases.iter());
        let name = escape(&self.name);
        let tests = self.cases.len();
        write!(
            out,
            r#"    <testsuite name="{name}" tests="{tests}" skipped="{skipped}" "#
        )?;
        write!(out, r#"errors="{errors}" failures="{failures}""#)?;
        if let Some(timestamp) = &self.timestamp {
            write!(out, r#" timestamp="{}""#, escape(timestamp))?;
        }
        if let Some(time_s) = self.time_s {
            write!(out, r#" time="{time_s:.3}""#)?;
        }
        if self.cases.is_empty() && self.properties.is_empty() {
            return writeln!(out, "/>");
        }
        writeln!(out, ">")?;
        write_properties(&self.properties, "        ", out)?;
        self.cases
            .iter()
            .try_for_each(|case| case.write(requirements, out))?;
        writeln!(out, "    </testsuite>")
    }
}

impl JunitCase {
    fn write(&self, requirements: &RequirementVerifiers<'_>, out: &mut String) -> fmt::Result {
        let class = escape(&self.class);
        let name = escape(&self.name);
        write!(
            out,
            r#"        <testcase classname="{class}" name="{name}""#
        )?;
        if let Some(file) = &self.file {
            write!(out, r#" file="{}""#, escape(file))?;
        }
        writeln!(out, ">")?;
        write_properties(&requirements.properties(self), "            ", out)?;
        if let Some(element) = self.status.element() {
            let message = self
                .message
                .as_ref()
                .map(|message| format!(r#" message="{}""#, escape(message)));
            writeln!(
                out,
                "            <{element}{}/>",
                message.unwrap_or_default()
            )?;
        }
        writeln!(
            out,
            "            <system-out>{}</system-out>",
            escape(&self.output)
        )?;
        writeln!(out, "        </testcase>")
    }
}
