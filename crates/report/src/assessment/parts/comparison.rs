//! The comparison with an earlier assessment: better, worse, new and missing results.

mod fact;
mod order;
mod runs;

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use self::fact::{Fact, FactKey, Facts, read, read_facts};
use self::runs::RandomRuns;
use crate::assessment::EVIDENCE_VERSION;
use crate::assessment::document::ReportDocument;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crumple_core::digest::sha256;
use crumple_core::quoting::TerminalText;
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
    /// Changed results of which neither is better: failures that became unavoidable, unlike quantities, and results of
    /// other random runs whose difference may be that of the runs.
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
    pub description: String,
    /// Earlier result.
    pub before: Option<String>,
    /// Present result.
    pub now: Option<String>,
    /// True for a failure that a search found, or a refuted claim.
    pub is_failure: bool,
    /// True if the controller collides now, and did not before.
    pub is_new_collision: bool,
    /// Difference of the random runs behind the results, such as "more runs"; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other_runs: Option<&'static str>,
}

/// The compared content of an earlier assessment.
#[derive(Debug, Clone)]
pub struct EarlierAssessment {
    /// Text of its `assessment.json`.
    text: String,
    sha256: String,
    config_sha256: String,
    facts: Facts,
    /// Random runs behind its evidence.
    runs: Vec<RandomRuns>,
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
        let mut evidence: Value = serde_json::from_str(text)
            .map_err(|error| syntax_error(path, error.line(), not_evidence(error)))?;
        use_current_names(&mut evidence);
        let version: u32 = read(&evidence, "version")
            .map_err(|problem| syntax_error(path, 1, not_evidence(problem)))?;
        if version != EVIDENCE_VERSION {
            let supported = format!("this release compares with version {EVIDENCE_VERSION}");
            let message = format!("version: {version} is not supported; {supported}");
            return Err(syntax_error(path, 1, message));
        }
        Self::from_evidence(&evidence, text.to_owned())
            .map_err(|problem| syntax_error(path, 1, not_evidence(problem)))
    }

    /// Reads the compared content; the error names a field.
    fn from_evidence(evidence: &Value, text: String) -> Result<Self, String> {
        Ok(Self {
            sha256: sha256(&text),
            text,
            config_sha256: read(evidence, "provenance/config_sha256")?,
            facts: read_facts(evidence)?,
            runs: RandomRuns::all(evidence),
        })
    }

    pub(in crate::assessment) fn text(&self) -> &str {
        &self.text
    }

    /// Returns the earlier result to compare with: of the same name and domain, or else one that differs in its random
    /// runs only and is not in `present`.
    fn find(&self, key: &FactKey, fact: &Fact, present: &Facts) -> Option<(&FactKey, &Fact)> {
        let related = |(key, before): &(&FactKey, &Fact)| {
            fact.family.is_some() && before.family == fact.family && !present.contains_key(*key)
        };
        let exact = self.facts.get_key_value(key);
        exact.or_else(|| self.facts.iter().find(related))
    }

    /// Compares a result with the earlier one, if there is one.
    fn compare_fact(
        &self,
        (what, _): &FactKey,
        before: Option<&Fact>,
        now: &Fact,
    ) -> (ChangeKind, AssessmentChange) {
        let other_runs = now.runs.as_ref().and_then(|runs| match before {
            Some(before) => runs.difference(before.runs.as_ref()?),
            None => runs.difference_from_all(&self.runs),
        });
        let kind = match before {
            // More runs find more failures, also of an equal controller.
            None if now.is_failure && other_runs.is_some() => ChangeKind::Changed,
            None => ChangeKind::New,
            Some(before) => match now.compare(before) {
                Some(Ordering::Greater) => ChangeKind::Better,
                Some(Ordering::Less) => ChangeKind::Worse,
                None if before.description != now.description => ChangeKind::Changed,
                Some(Ordering::Equal) | None => ChangeKind::Unchanged,
            },
        };
        let mut change = AssessmentChange::new(what, before, Some(now));
        change.is_new_collision &= kind == ChangeKind::Worse || other_runs.is_none();
        change.other_runs = other_runs;
        (kind, change)
    }
}

/// Names of 0.3.0 and the current ones, of the fields that a comparison reads.
const RENAMED_FIELDS: [(&str, &str); 3] = [
    ("standings", "statuses"),
    ("known", "content_id"),
    ("traffic", "file_scenarios"),
];

/// Gives the fields of an earlier assessment their current names, at any depth.
fn use_current_names(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for (before, now) in RENAMED_FIELDS {
                if let Some(field) = fields.remove(before) {
                    fields.entry(now).or_insert(field);
                }
            }
            fields.values_mut().for_each(use_current_names);
        }
        Value::Array(items) => items.iter_mut().for_each(use_current_names),
        // Claims of 0.3.0 about the same rate.
        Value::String(text) => *text = text.replace("collision rate", "failure rate"),
        _ => {}
    }
}

fn syntax_error(path: &Path, line: usize, message: String) -> FileError {
    FileError::Syntax {
        path: path.to_owned(),
        line,
        message,
    }
}

fn not_evidence(problem: impl Display) -> String {
    format!("not an assessment.json: {problem}")
}

/// The kind of change of a result of this assessment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ChangeKind {
    Better,
    Worse,
    /// Another result that is neither better nor worse.
    Changed,
    New,
    Unchanged,
}

impl AssessmentChange {
    fn new(what: &str, before: Option<&Fact>, now: Option<&Fact>) -> Self {
        Self {
            description: what.to_owned(),
            before: before.map(|fact| fact.description.clone()),
            now: now.map(|fact| fact.description.clone()),
            is_failure: now.or(before).is_some_and(|fact| fact.is_failure),
            is_new_collision: before.and_then(|fact| fact.collides) == Some(false)
                && now.and_then(|fact| fact.collides) == Some(true),
            other_runs: None,
        }
    }

    /// Returns the cells of the change: its label, which is good or bad or neither, the result, and both states.
    fn table_row(&self, label: &str, verdict: Option<bool>) -> Vec<ReportCell> {
        let label = match (self.is_new_collision, self.other_runs) {
            (true, _) => NEW_COLLISION.to_owned(),
            (false, Some(difference)) => format!("{label}: {difference}"),
            (false, None) => label.to_owned(),
        };
        let label = verdict.map_or_else(
            || ReportCell::text(&label),
            |good| ReportCell::with_verdict(&label, good),
        );
        let [before, now] = [&self.before, &self.now]
            .map(|state| ReportCell::text(state.as_deref().unwrap_or("–")));
        vec![label, ReportCell::text(&self.description), before, now]
    }

    /// Returns the change as a line for a terminal.
    fn to_plain_text(&self) -> String {
        let label = if self.is_new_collision {
            NEW_COLLISION
        } else {
            WORSE
        };
        let [before, now] = [&self.before, &self.now].map(|state| state.as_deref().unwrap_or("–"));
        let text = format!("{}: {before} -> {now}", self.description);
        format!("  {label}  {}\n", TerminalText(&text))
    }
}

/// Label of a result that is worse.
const WORSE: &str = "worse";

/// Label of a collision where there was none before.
const NEW_COLLISION: &str = "NEW COLLISION";

/// Label of a failure that is not in the earlier assessment.
const NEW_FAILURE: &str = "new failure";

/// Rule for results of other random runs.
const OTHER_RUNS_NOTE: &str = "Results of another number of runs are better or worse if the runs that both assessments \
    have show it. Otherwise, and with another seed, they are better or worse only if the 99.9 % intervals of the two \
    failure rates are disjoint. Bounds of failure rates show a change only if they exclude each other, at their own \
    confidence. A failure that only a larger search found, or a search with another seed, is not worse.";

/// Maximum number of worse results on a terminal.
const MAX_WORSE_LINES: usize = 20;

fn is_own_result(fact: &Fact) -> bool {
    !fact.is_restated
}

fn changes_of_kind(
    changes: &[(ChangeKind, AssessmentChange)],
    wanted: ChangeKind,
) -> Vec<AssessmentChange> {
    changes
        .iter()
        .filter(|(kind, _)| *kind == wanted)
        .map(|(_, change)| change.clone())
        .collect()
}

impl AssessmentComparison {
    /// Compares two assessments; `None` if `evidence`, that of this one, cannot be read back, a defect of its format.
    pub(in crate::assessment) fn new(
        earlier: &EarlierAssessment,
        evidence: &impl Serialize,
        config_sha256: &str,
    ) -> Option<Self> {
        // As text: numbers that are read from text compare equal to those of the earlier file.
        let text = serde_json::to_string(evidence).ok()?;
        let facts = read_facts(&serde_json::from_str(&text).ok()?).ok()?;
        let same_configuration = config_sha256 == earlier.config_sha256;
        Some(Self::from_facts(earlier, &facts, same_configuration))
    }

    fn from_facts(earlier: &EarlierAssessment, facts: &Facts, same_configuration: bool) -> Self {
        let mut matched = BTreeSet::new();
        let mut present = Vec::new();
        for (key, now) in facts {
            let earlier_result = earlier.find(key, now, facts);
            matched.extend(earlier_result.map(|(key, _)| key));
            let before = earlier_result.map(|(_, fact)| fact);
            if !now.is_restated || before.is_some_and(is_own_result) {
                present.push(earlier.compare_fact(key, before, now));
            }
        }
        let gone = earlier
            .facts
            .iter()
            .filter(|(key, fact)| !matched.contains(key) && is_own_result(fact))
            .map(|((what, _), fact)| AssessmentChange::new(what, Some(fact), None));
        let mut worse = changes_of_kind(&present, ChangeKind::Worse);
        worse.sort_by_key(|change| !change.is_new_collision);
        Self {
            earlier_sha256: earlier.sha256.clone(),
            same_configuration,
            better: changes_of_kind(&present, ChangeKind::Better),
            worse,
            changed: changes_of_kind(&present, ChangeKind::Changed),
            new: changes_of_kind(&present, ChangeKind::New),
            gone: gone.collect(),
            unchanged: changes_of_kind(&present, ChangeKind::Unchanged).len(),
        }
    }

    /// Describes the comparison in a sentence.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "Compared with the earlier assessment{}: {} better, {} worse, {} new, {} gone, {} changed without being \
             better or worse{}, {} unchanged.",
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
            self.describe_other_runs(),
            self.unchanged
        )
    }

    /// Returns the number of changed results that have other random runs, in brackets; empty if there are none.
    fn describe_other_runs(&self) -> String {
        let changed = self.changed.iter();
        match changed.filter(|change| change.other_runs.is_some()).count() {
            0 => String::new(),
            count => format!(" ({count} with other random runs)"),
        }
    }

    /// Returns the comparison as text for a terminal: a sentence, and the results that are worse.
    #[must_use]
    pub fn to_plain_text(&self) -> String {
        let shown = self.worse.iter().take(MAX_WORSE_LINES);
        let lines: String = shown.map(AssessmentChange::to_plain_text).collect();
        let rest = self.worse.len().saturating_sub(MAX_WORSE_LINES);
        let rest = match rest {
            0 => String::new(),
            rest => format!("  and {rest} more that are worse\n"),
        };
        format!("{}\n{lines}{rest}", self.describe())
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
        let (failures, others): (Vec<_>, Vec<_>) =
            self.new.iter().partition(|change| change.is_failure);
        let groups: [(&str, Vec<&AssessmentChange>, Option<bool>); 6] = [
            (WORSE, self.worse.iter().collect(), Some(false)),
            (NEW_FAILURE, failures, Some(false)),
            ("better", self.better.iter().collect(), Some(true)),
            ("changed", self.changed.iter().collect(), None),
            ("new", others, None),
            ("gone", self.gone.iter().collect(), None),
        ];
        for (label, changes, verdict) in groups {
            for change in changes {
                table.push_row(change.table_row(label, verdict));
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
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Verdict,
            anchor: "changes",
            title: "Changes since the earlier assessment",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(self.describe());
        if !self.describe_other_runs().is_empty() {
            out.paragraph(OTHER_RUNS_NOTE);
        }
        if !self.is_empty() {
            out.table(self.table());
        }
    }
}

#[cfg(test)]
mod tests;
