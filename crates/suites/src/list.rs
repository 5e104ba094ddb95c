//! List of the shipped suites, as text and as JSON.

use std::path::Path;

use serde::Serialize;

use super::{DISCLAIMER, SHIPPED_SUITES, SuiteError, TestSuite, UNSHIPPED_DOCUMENTS};

/// List of the shipped suites, and of documents without one. The fields are in alphabetical order.
#[derive(Debug, Serialize)]
pub struct SuiteList {
    /// Documents without a shipped suite.
    pub unshipped: Vec<UnshippedDocument>,
    /// Scope of all suites: [`DISCLAIMER`].
    pub statement: &'static str,
    /// Shipped suites.
    pub suites: Vec<ShippedSuite>,
}

/// A shipped suite.
#[derive(Debug, Serialize)]
pub struct ShippedSuite {
    /// Purpose of the suite.
    pub about: String,
    /// Document that the suite is modelled on, and its edition.
    pub document: String,
    /// Name of the suite.
    pub name: &'static str,
}

/// A document without a shipped suite.
#[derive(Debug, Serialize)]
pub struct UnshippedDocument {
    /// Name of the document.
    pub document: &'static str,
    /// Reason why no suite is modelled on it.
    pub why: &'static str,
}

impl SuiteList {
    /// Reads the shipped suites.
    ///
    /// # Errors
    /// [`SuiteError`] if a shipped suite is invalid, which the tests exclude.
    pub fn load() -> Result<Self, SuiteError> {
        let mut suites = Vec::new();
        for (name, text) in SHIPPED_SUITES {
            let suite = TestSuite::from_toml(text, Path::new(name))?;
            suites.push(ShippedSuite::new(name, &suite));
        }
        Ok(Self {
            unshipped: UNSHIPPED_DOCUMENTS
                .map(|(document, why)| UnshippedDocument { document, why })
                .into(),
            statement: DISCLAIMER,
            suites,
        })
    }

    /// Returns the list for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for suite in &self.suites {
            text += &format!("  {:<20}{} {}\n", suite.name, suite.about, suite.document);
        }
        for missing in &self.unshipped {
            text += &format!("Not shipped: {}; {}.\n", missing.document, missing.why);
        }
        text + self.statement + "\n"
    }
}

impl ShippedSuite {
    fn new(name: &'static str, suite: &TestSuite) -> Self {
        let spec = suite.spec();
        Self {
            about: spec.about.clone(),
            document: format!("{}, {}", spec.document, spec.edition),
            name,
        }
    }
}
