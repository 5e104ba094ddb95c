//! The comparison with an earlier assessment: better, worse, new and missing results.

mod fact;
mod order;

use std::cmp::Ordering;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use self::fact::{Facts, read, read_facts};
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentReport, EVIDENCE_VERSION, ReportPart};
use crumple_core::digest::sha256;
use crumple_core::text_file::{self, FileError};

/// The changes since an earlier assessment.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentComparison {
    /// SHA-256 of the evidence of the earlier assessment.
    pub earlier_sha256: String,
    /// True if both have the same configuration.
    pub same_configuration: bool,
    /// Improved results.
    pub better: Vec<AssessmentChange>,
    /// Worse results.
    pub worse: Vec<AssessmentChange>,
    /// Changed results of which neither is better: failures that became unavoidable, and unlike quantities.
    pub changed: Vec<AssessmentChange>,
    /// Results that the earlier assessment lacks.
    pub new: Vec<AssessmentChange>,
    /// Results that this assessment lacks.
    pub gone: Vec<AssessmentChange>,
    /// Number of unchanged results.
    pub unchanged: usize,
}

/// A changed result.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentChange {
    /// Description of the subject.
    #[serde(rename = "what")]
    pub description: String,
    /// Earlier result.
    pub before: Option<String>,
    /// Present result.
    pub now: Option<String>,
    /// True for a failure that a search found, or a refuted claim.
    pub is_failure: bool,
}

/// The compared content of an earlier assessment.
#[derive(Debug, Clone)]
pub struct EarlierAssessment {
    sha256: String,
    config_sha256: String,
    facts: Facts,
}

/// Maximum size of the evidence of an earlier assessment, in bytes; the built-in one takes less than one fiftieth.
pub const MAX_EVIDENCE_BYTES: u64 = 64 << 20;

impl EarlierAssessment {
    /// Reads the evidence of an earlier assessment, `assessment.json`.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be read, or is no such evidence.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_json(&text_file::read_at_most(path, MAX_EVIDENCE_BYTES)?, path)
    }

    fn from_json(text: &str, path: &Path) -> Result<Self, FileError> {
        let wrong = |line, message| FileError::Syntax {
            path: path.to_owned(),
            line,
            message,
        };
        let syntax = |error: serde_json::Error| {
            wrong(error.line(), format!("not an assessment.json: {error}"))
        };
        let evidence: Value = serde_json::from_str(text).map_err(syntax)?;
        let field = |problem: String| wrong(1, format!("not an assessment.json: {problem}"));
        let version: u32 = read(&evidence, "version").map_err(field)?;
        if version != EVIDENCE_VERSION {
            let supported = format!("this release compares with version {EVIDENCE_VERSION}");
            return Err(wrong(
                1,
                format!("version: {version} is not supported; {supported}"),
            ));
        }
        let config_sha256 = read(&evidence, "provenance/config_sha256").map_err(field)?;
        Ok(Self {
            sha256: sha256(text),
            config_sha256,
            facts: read_facts(&evidence).map_err(field)?,
        })
    }
}

impl AssessmentComparison {
    /// Compares two assessments; `None` if the evidence of `now` cannot be read back, a defect of its format.
    #[must_use]
    pub fn new(earlier: &EarlierAssessment, now: &AssessmentReport) -> Option<Self> {
        let text = now.to_json().ok()?;
        let evidence: Value = serde_json::from_str(&text).ok()?;
        let same_configuration = now.provenance.config_sha256 == earlier.config_sha256;
        Some(Self {
            same_configuration,
            ..Self::from_facts(earlier, &read_facts(&evidence).ok()?)
        })
    }

    fn from_facts(earlier: &EarlierAssessment, facts: &Facts) -> Self {
        let (mut better, mut worse, mut changed, mut new) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut unchanged = 0;
        for (key @ (what, _), fact) in facts {
            let before = earlier.facts.get(key);
            let change = AssessmentChange {
                description: what.clone(),
                before: before.map(|before| before.description.clone()),
                now: Some(fact.description.clone()),
                is_failure: fact.is_failure,
            };
            let Some(before) = before else {
                new.push(change);
                continue;
            };
            match fact.measure.compare(&before.measure) {
                Some(Ordering::Greater) => better.push(change),
                Some(Ordering::Less) => worse.push(change),
                None if before.description != fact.description => changed.push(change),
                Some(Ordering::Equal) | None => unchanged += 1,
            }
        }
        let gone = earlier
            .facts
            .iter()
            .filter(|(key, _)| !facts.contains_key(*key));
        let gone = gone.map(|((what, _), fact)| AssessmentChange {
            description: what.clone(),
            before: Some(fact.description.clone()),
            now: None,
            is_failure: fact.is_failure,
        });
        Self {
            earlier_sha256: earlier.sha256.clone(),
            same_configuration: true,
            better,
            worse,
            changed,
            new,
            gone: gone.collect(),
            unchanged,
        }
    }

    /// Describes the comparison in a sentence.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "Compared with the earlier assessment{}: {} better, {} worse, {} new, {} gone, {} changed without being \
             better or worse, {} unchanged.",
            if self.same_configuration {
                ""
            } else {
                ", which has another configuration"
            },
            self.better.len(),
            self.worse.len(),
            self.new.len(),
            self.gone.len(),
            self.changed.len(),
            self.unchanged
        )
    }

    /// Returns the number of results of which neither is better, as an addition to a sentence; empty if there are none.
    pub(in crate::assessment) fn describe_changed(&self) -> String {
        match self.changed.len() {
            0 => String::new(),
            count => format!("; {count} changed, and neither result is better"),
        }
    }

    fn table(&self) -> ReportTable {
        let mut table = ReportTable::new(&["change", "result", "before", "now"]);
        let dash = |words: &Option<String>| ReportCell::text(words.as_deref().unwrap_or("–"));
        for (kind, changes, judged) in [
            ("worse", &self.worse, Some(false)),
            ("better", &self.better, Some(true)),
            ("changed", &self.changed, None),
            ("new", &self.new, None),
            ("gone", &self.gone, None),
        ] {
            for change in changes {
                let kind = judged.map_or_else(
                    || ReportCell::text(kind),
                    |good| ReportCell::with_verdict(kind, good),
                );
                let result = ReportCell::text(&change.description);
                table.push_row(vec![kind, result, dash(&change.before), dash(&change.now)]);
            }
        }
        table
    }

    pub(in crate::assessment) fn has_no_overlap(&self) -> bool {
        self.better.len() + self.worse.len() + self.changed.len() + self.unchanged == 0
    }

    fn is_empty(&self) -> bool {
        self.better.len() + self.worse.len() + self.changed.len() + self.new.len() + self.gone.len()
            == 0
    }
}

impl ReportPart for AssessmentComparison {
    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&self.describe());
        if !self.is_empty() {
            out.table(&self.table());
        }
    }
}

#[cfg(test)]
mod tests;
