//! JUnit reports, the XML that build servers read, in the form of <https://github.com/testmoapp/junitxml>.

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
    pub(crate) name: String,
    pub(crate) status: JunitStatus,
    /// Reason of a result other than a pass.
    pub(crate) message: Option<String>,
    pub(crate) output: String,
}

/// A test suite: cases, and properties as names with values.
#[derive(Debug, Default)]
pub(crate) struct JunitSuite {
    pub(crate) name: String,
    pub(crate) properties: Vec<(String, String)>,
    pub(crate) cases: Vec<JunitCase>,
}

/// Renders suites as XML. Control characters are shown as escapes.
pub(crate) fn render_xml(name: &str, suites: &[JunitSuite]) -> String {
    let [skipped, failures, errors] = count_statuses(suites.iter().flat_map(|suite| &suite.cases));
    let name = escape(name);
    let tests: usize = suites.iter().map(|suite| suite.cases.len()).sum();
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites name=\"{name}\" tests=\"{tests}\" \
         skipped=\"{skipped}\" failures=\"{failures}\" errors=\"{errors}\">\n"
    );
    // Writing to a string cannot fail.
    let _ = suites.iter().try_for_each(|suite| suite.write(&mut text));
    TerminalLines(&(text + "</testsuites>\n")).to_string()
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

impl JunitSuite {
    fn write(&self, out: &mut String) -> fmt::Result {
        let [skipped, failures, errors] = count_statuses(self.cases.iter());
        let name = escape(&self.name);
        let tests = self.cases.len();
        let close = if self.cases.is_empty() && self.properties.is_empty() {
            "/"
        } else {
            ""
        };
        write!(
            out,
            r#"    <testsuite name="{name}" tests="{tests}" skipped="{skipped}" "#
        )?;
        writeln!(out, r#"errors="{errors}" failures="{failures}"{close}>"#)?;
        if !close.is_empty() {
            return Ok(());
        }
        if !self.properties.is_empty() {
            writeln!(out, "        <properties>")?;
            for (name, value) in &self.properties {
                writeln!(
                    out,
                    r#"            <property name="{}" value="{}"/>"#,
                    escape(name),
                    escape(value)
                )?;
            }
            writeln!(out, "        </properties>")?;
        }
        self.cases.iter().try_for_each(|case| case.write(out))?;
        writeln!(out, "    </testsuite>")
    }
}

impl JunitCase {
    fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(out, r#"        <testcase name="{}">"#, escape(&self.name))?;
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
