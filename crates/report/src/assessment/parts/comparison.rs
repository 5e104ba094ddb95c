//! The comparison with an earlier assessment: better, worse, new and missing results.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::assessment::claims::{AssuranceClaim, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentReport, CertificateStatus, EVIDENCE_VERSION, ReportPart};
use crumple_core::digest::sha256;
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_world::scenario::file::{self, FileError};

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

/// The results by name and domain hash. The hash separates results of spaces that have the same name.
type Facts = BTreeMap<(String, String), Fact>;

#[derive(Debug, Clone)]
struct Fact {
    score: f64,
    description: String,
    /// True for a counterexample or a refuted claim: its presence is a failure.
    is_failure: bool,
}

/// Reads a field, whose path has slashes. The error names the field.
fn read<T: DeserializeOwned>(value: &Value, field: &str) -> Result<T, String> {
    let found = value.pointer(&format!("/{field}")).unwrap_or(&Value::Null);
    T::deserialize(found).map_err(|error| format!("{field}: {error}"))
}

fn read_facts(evidence: &Value) -> Result<Facts, String> {
    let mut facts = Facts::new();
    let mut add = |what: String, domain: String, score: f64, description: String, is_failure: bool| {
        facts.insert((what, domain), Fact { score, description, is_failure });
    };
    let controllers: Vec<String> = read(evidence, "summary/controllers")?;
    for row in read::<Vec<Value>>(evidence, "summary/claims")? {
        let words: String = read(&row, "claim")?;
        let claims: Vec<Option<AssuranceClaim>> = read(&row, "claims")?;
        let strengths: Vec<Strength> = read(&row, "standings")?;
        if [claims.len(), strengths.len()] != [controllers.len(); 2] {
            return Err(format!("summary/claims: `{words}` needs one entry per controller"));
        }
        for ((controller, claim), strength) in controllers.iter().zip(claims).zip(&strengths) {
            // An untried claim is absent: neither better nor worse.
            if *strength != Strength::Untried {
                let domain = claim.map_or_else(String::new, |claim| sha256(format!("{:?}", claim.domain)));
                let what = format!("{controller}: {words}");
                add(what, domain, score(strength), strength.describe(), strength.is_refutation());
            }
        }
    }
    for part in ["paper_scenarios/scenarios", "traffic/scenarios"] {
        for scenario in read::<Option<Vec<Value>>>(evidence, part)?.unwrap_or_default() {
            let name: String = read(&scenario, "scenario")?;
            for case in read::<Vec<Value>>(&scenario, "cases")? {
                let controller: String = read(&case, "controller")?;
                if let Some(gap_m) = read::<Option<f64>>(&case, "min_gap_m")? {
                    let what = format!("{controller}: smallest gap in {name}");
                    add(what, String::new(), gap_m, format!("{gap_m:.2} m"), false);
                }
            }
        }
    }
    for space in read::<Vec<Value>>(evidence, "searches/spaces")? {
        let name: String = read(&space, "name")?;
        for search in read::<Vec<Value>>(&space, "controllers")? {
            let controller: String = read(&search, "controller")?;
            for failure in read::<Vec<Value>>(&search, "failures")? {
                let class = match read(&failure, "class")? {
                    AvoidabilityClass::Avoidable => "avoidable",
                    AvoidabilityClass::Unavoidable => "unavoidable",
                    AvoidabilityClass::Undecided | AvoidabilityClass::NotAsked => "not classified",
                };
                let kind: String = read(&failure, "kind")?;
                let what = format!("{controller}: failure in `{name}`: {kind}, {class}");
                add(what, String::new(), 0.0, "found".to_owned(), true);
            }
        }
    }
    for proof in read::<Vec<Value>>(evidence, "proofs/certificates")? {
        let status: CertificateStatus = read(&proof, "status")?;
        let score = f64::from(matches!(status, CertificateStatus::Accepted { .. }));
        let text = |field: &str| read::<String>(&proof, field);
        // A changed certificate of the same name is another result.
        let what = format!("certificate {}: {}, {}", text("name")?, text("statement")?, text("about")?);
        add(what, String::new(), score, status.describe(), false);
    }
    Ok(facts)
}

/// Returns the score of a strength, larger is better: by rank, then by the strength's number.
fn score(strength: &Strength) -> f64 {
    let within = match strength {
        Strength::Proved { .. } | Strength::Untried => 0.0,
        Strength::Tested { runs } => (*runs as f64).ln_1p(),
        Strength::PartlyProved { share_percent } => share_percent.value(),
        Strength::Bounded { upper_percent, .. } | Strength::Undecided { upper_percent, .. } => -upper_percent.value(),
        Strength::Exceeded { lower_percent, .. } => -lower_percent.value(),
        Strength::Refuted { failures, runs } => -100.0 * *failures as f64 / (*runs).max(1) as f64,
        Strength::Unanswered { unanswered, failures, runs, .. } => {
            -100.0 * (unanswered + failures) as f64 / (*runs).max(1) as f64
        }
        Strength::OtherUnanswered { .. } => 0.0,
        Strength::Falsified { failures, avoidable, .. } => -(0.001 * *failures as f64) - *avoidable as f64,
        Strength::Between { upper_percent, .. } => -upper_percent.value(),
        Strength::Counted { confidence_percent, .. } => confidence_percent.value(),
        Strength::NotShownByCounting { .. } => 0.0,
        Strength::Compared { own, other, runs } => (*other as f64 - *own as f64) / (*runs).max(1) as f64,
        Strength::Gain { largest, .. } => -largest.value(),
        Strength::Contradicted => 0.0,
    };
    1000.0 * f64::from(strength.rank()) + within
}

/// Maximum size of the evidence of an earlier assessment, in bytes; the built-in one takes less than one fiftieth.
pub const MAX_EVIDENCE_BYTES: u64 = 64 << 20;

impl EarlierAssessment {
    /// Reads the evidence of an earlier assessment, `assessment.json`.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be read, or is no such evidence.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_json(&file::read_at_most(path, MAX_EVIDENCE_BYTES)?, path)
    }

    fn from_json(text: &str, path: &Path) -> Result<Self, FileError> {
        let wrong = |line, message| FileError::Syntax { path: path.to_owned(), line, message };
        let syntax = |error: serde_json::Error| wrong(error.line(), format!("not an assessment.json: {error}"));
        let evidence: Value = serde_json::from_str(text).map_err(syntax)?;
        let field = |problem: String| wrong(1, format!("not an assessment.json: {problem}"));
        let version: u32 = read(&evidence, "version").map_err(field)?;
        if version != EVIDENCE_VERSION {
            let supported = format!("this release compares with version {EVIDENCE_VERSION}");
            return Err(wrong(1, format!("version: {version} is not supported; {supported}")));
        }
        let config_sha256 = read(&evidence, "provenance/config_sha256").map_err(field)?;
        Ok(Self { sha256: sha256(text), config_sha256, facts: read_facts(&evidence).map_err(field)? })
    }
}

impl AssessmentComparison {
    /// Compares two assessments; `None` if the evidence of `now` cannot be read back, a defect of its format.
    #[must_use]
    pub fn new(earlier: &EarlierAssessment, now: &AssessmentReport) -> Option<Self> {
        let text = now.to_json().ok()?;
        let evidence: Value = serde_json::from_str(&text).ok()?;
        let same_configuration = now.provenance.config_sha256 == earlier.config_sha256;
        Some(Self { same_configuration, ..Self::from_facts(earlier, &read_facts(&evidence).ok()?) })
    }

    fn from_facts(earlier: &EarlierAssessment, facts: &Facts) -> Self {
        let (mut better, mut worse, mut new, mut unchanged) = (Vec::new(), Vec::new(), Vec::new(), 0);
        for (key @ (what, _), fact) in facts {
            let before = earlier.facts.get(key);
            let change = AssessmentChange {
                description: what.clone(),
                before: before.map(|before| before.description.clone()),
                now: Some(fact.description.clone()),
                is_failure: fact.is_failure,
            };
            match before.map(|before| fact.score.total_cmp(&before.score)) {
                None => new.push(change),
                Some(std::cmp::Ordering::Greater) => better.push(change),
                Some(std::cmp::Ordering::Less) => worse.push(change),
                Some(std::cmp::Ordering::Equal) => unchanged += 1,
            }
        }
        let gone = earlier.facts.iter().filter(|(key, _)| !facts.contains_key(*key));
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
            new,
            gone: gone.collect(),
            unchanged,
        }
    }

    /// Describes the comparison in a sentence.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "Compared with the earlier assessment{}: {} better, {} worse, {} new, {} gone, {} unchanged.",
            if self.same_configuration { "" } else { ", which has another configuration" },
            self.better.len(),
            self.worse.len(),
            self.new.len(),
            self.gone.len(),
            self.unchanged
        )
    }

    fn table(&self) -> ReportTable {
        let mut table = ReportTable::new(&["change", "result", "before", "now"]);
        let dash = |words: &Option<String>| ReportCell::text(words.as_deref().unwrap_or("–"));
        for (kind, changes, judged) in [
            ("worse", &self.worse, Some(false)),
            ("better", &self.better, Some(true)),
            ("new", &self.new, None),
            ("gone", &self.gone, None),
        ] {
            for change in changes {
                let kind = judged.map_or_else(|| ReportCell::text(kind), |good| ReportCell::with_verdict(kind, good));
                let result = ReportCell::text(&change.description);
                table.push_row(vec![kind, result, dash(&change.before), dash(&change.now)]);
            }
        }
        table
    }

    pub(in crate::assessment) fn has_no_overlap(&self) -> bool {
        self.better.len() + self.worse.len() + self.unchanged == 0
    }

    fn is_empty(&self) -> bool {
        self.better.len() + self.worse.len() + self.new.len() + self.gone.len() == 0
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
