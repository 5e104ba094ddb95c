//! The comparison with an earlier assessment: better, worse, new and missing results.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::assessment::claims::{AssuranceClaim, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentReport, EVIDENCE_VERSION, ReportPart};
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

/// An error of loading an earlier assessment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ComparisonError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The file is not an `assessment.json`.
    #[error("{}:{line}: {problem}", path.display())]
    Syntax {
        /// Path of the file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Description of the problem.
        problem: String,
    },
    /// The file has another format version.
    #[error(
        "{}: version: {found} is not supported; this release compares with version {EVIDENCE_VERSION}",
        path.display()
    )]
    Version {
        /// Path of the file.
        path: PathBuf,
        /// Version of the file.
        found: u32,
    },
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

#[derive(Deserialize)]
struct EvidenceView {
    version: u32,
    summary: SummaryView,
    paper_scenarios: Option<ScenariosView>,
    traffic: Option<ScenariosView>,
    searches: SearchesView,
    proofs: ProofsView,
    provenance: ProvenanceView,
}

#[derive(Deserialize)]
struct ProvenanceView {
    config_sha256: String,
}

#[derive(Deserialize)]
struct SummaryView {
    controllers: Vec<String>,
    claims: Vec<ClaimView>,
}

#[derive(Deserialize)]
struct ClaimView {
    claim: String,
    claims: Vec<Option<AssuranceClaim>>,
    #[serde(rename = "standings")]
    statuses: Vec<ClaimStatusView>,
}

#[derive(Deserialize)]
struct ClaimStatusView {
    #[serde(flatten)]
    strength: Strength,
}

#[derive(Deserialize)]
struct ScenariosView {
    scenarios: Vec<ScenarioView>,
}

#[derive(Deserialize)]
struct ScenarioView {
    scenario: String,
    cases: Vec<CaseView>,
}

#[derive(Deserialize)]
struct CaseView {
    controller: String,
    min_gap_m: Option<f64>,
}

#[derive(Deserialize)]
struct SearchesView {
    spaces: Vec<SpaceView>,
}

#[derive(Deserialize)]
struct SpaceView {
    name: String,
    controllers: Vec<SearchView>,
}

#[derive(Deserialize)]
struct SearchView {
    controller: String,
    failures: Vec<FailureView>,
}

#[derive(Deserialize)]
struct FailureView {
    kind: String,
    class: AvoidabilityClass,
}

#[derive(Deserialize)]
struct ProofsView {
    certificates: Vec<CertificateView>,
}

#[derive(Deserialize)]
struct CertificateView {
    name: String,
    statement: String,
    about: String,
    status: super::CertificateStatus,
}

impl EvidenceView {
    fn into_facts(self) -> Facts {
        let mut facts = Facts::new();
        for claim in self.summary.claims {
            let statuses = self.summary.controllers.iter().zip(claim.claims).zip(claim.statuses);
            for ((controller, made), ClaimStatusView { strength }) in statuses {
                let what = format!("{controller}: {}", claim.claim);
                let domain = made.map_or_else(String::new, |made| sha256(format!("{:?}", made.domain)));
                // An untried claim is absent: neither better nor worse.
                if strength != Strength::Untried {
                    let is_failure = strength.is_refutation();
                    let (score, description) = (score(&strength), strength.describe());
                    facts.insert((what, domain), Fact { score, description, is_failure });
                }
            }
        }
        let scenarios = self.paper_scenarios.into_iter().chain(self.traffic).flat_map(|part| part.scenarios);
        for scenario in scenarios {
            for case in scenario.cases {
                if let Some(gap_m) = case.min_gap_m {
                    let what = format!("{}: smallest gap in {}", case.controller, scenario.scenario);
                    let fact = Fact { score: gap_m, description: format!("{gap_m:.2} m"), is_failure: false };
                    facts.insert((what, String::new()), fact);
                }
            }
        }
        for space in self.searches.spaces {
            for search in space.controllers {
                for failure in search.failures {
                    let class = match failure.class {
                        AvoidabilityClass::Avoidable => "avoidable",
                        AvoidabilityClass::Unavoidable => "unavoidable",
                        AvoidabilityClass::Undecided | AvoidabilityClass::NotAsked => "not classified",
                    };
                    let what = format!("{}: failure in `{}`: {}", search.controller, space.name, failure.kind);
                    let fact = Fact { score: 0.0, description: "found".to_owned(), is_failure: true };
                    facts.insert((format!("{what}, {class}"), String::new()), fact);
                }
            }
        }
        for proof in self.proofs.certificates {
            let score = f64::from(matches!(proof.status, super::CertificateStatus::Accepted { .. }));
            let fact = Fact { score, description: proof.status.describe(), is_failure: false };
            // A changed certificate of the same name is another result.
            let what = format!("certificate {}: {}, {}", proof.name, proof.statement, proof.about);
            facts.insert((what, String::new()), fact);
        }
        facts
    }
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
    /// [`ComparisonError`] if it cannot be read, or is no such evidence.
    pub fn load(path: &Path) -> Result<Self, ComparisonError> {
        let text = file::read_at_most(path, MAX_EVIDENCE_BYTES).map_err(|error| match error {
            FileError::Read { path, source } => ComparisonError::Read { path, source },
            other => ComparisonError::Read { path: path.to_owned(), source: io::Error::other(other.to_string()) },
        })?;
        Self::from_json(&text, path)
    }

    fn from_json(text: &str, path: &Path) -> Result<Self, ComparisonError> {
        #[derive(Deserialize)]
        struct Versioned {
            version: u32,
        }
        let syntax = |error: serde_json::Error| ComparisonError::Syntax {
            path: path.to_owned(),
            line: error.line(),
            problem: format!("not an assessment.json: {error}"),
        };
        let Versioned { version } = serde_json::from_str(text).map_err(syntax)?;
        if version != EVIDENCE_VERSION {
            return Err(ComparisonError::Version { path: path.to_owned(), found: version });
        }
        let view: EvidenceView = serde_json::from_str(text).map_err(syntax)?;
        let controllers = view.summary.controllers.len();
        let is_wrong = |claim: &&ClaimView| claim.statuses.len() != controllers || claim.claims.len() != controllers;
        if let Some(claim) = view.summary.claims.iter().find(is_wrong) {
            let problem = format!("summary.claims: `{}` needs one entry per controller", claim.claim);
            return Err(ComparisonError::Syntax { path: path.to_owned(), line: 1, problem });
        }
        let config_sha256 = view.provenance.config_sha256.clone();
        Ok(Self { sha256: sha256(text), config_sha256, facts: view.into_facts() })
    }
}

impl AssessmentComparison {
    /// Compares two assessments; `None` if the evidence of `now` cannot be read back, a defect of its format.
    #[must_use]
    pub fn new(earlier: &EarlierAssessment, now: &AssessmentReport) -> Option<Self> {
        let text = now.to_json().ok()?;
        let view: EvidenceView = serde_json::from_str(&text).ok()?;
        debug_assert_eq!(view.version, EVIDENCE_VERSION);
        let same_configuration = view.provenance.config_sha256 == earlier.config_sha256;
        Some(Self { same_configuration, ..Self::from_facts(earlier, &view.into_facts()) })
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
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("changes", "Changes since the earlier assessment".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&self.describe());
        if !self.is_empty() {
            out.table(&self.table());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn earlier(facts: &[(&str, f64)]) -> EarlierAssessment {
        EarlierAssessment { sha256: String::new(), config_sha256: String::new(), facts: facts_of(facts) }
    }

    fn facts_of(facts: &[(&str, f64)]) -> Facts {
        let fact = |score: f64| Fact { score, description: score.to_string(), is_failure: false };
        facts.iter().map(|(what, score)| (((*what).to_owned(), String::new()), fact(*score))).collect()
    }

    #[test]
    fn everything_falls_into_one_place() {
        let before = earlier(&[("a", 1.0), ("b", 1.0), ("c", 1.0), ("d", 1.0)]);
        let found =
            AssessmentComparison::from_facts(&before, &facts_of(&[("a", 2.0), ("b", 0.0), ("c", 1.0), ("e", 1.0)]));
        let names =
            |changes: &[AssessmentChange]| changes.iter().map(|change| change.description.clone()).collect::<String>();
        let all = [&found.better, &found.worse, &found.new, &found.gone].map(|changes| names(changes));
        assert_eq!((all, found.unchanged), (["a", "b", "e", "d"].map(str::to_owned), 1));
    }

    #[test]
    fn stronger_support_scores_higher() {
        let in_order = [
            Strength::Refuted { failures: 9, runs: 10 },
            Strength::Refuted { failures: 1, runs: 10 },
            Strength::Tested { runs: 3 },
            Strength::Tested { runs: 30 },
            Strength::Proved { certificates: 1 },
        ];
        assert!(in_order.windows(2).all(|pair| score(&pair[0]) < score(&pair[1])));
    }

    #[test]
    fn what_is_no_evidence_is_refused_with_its_line() {
        let refused = |text: &str| EarlierAssessment::from_json(text, Path::new("old.json")).unwrap_err().to_string();
        assert!(refused("{}").starts_with("old.json:1: "), "{}", refused("{}"));
        assert!(refused("{\"version\": 0}").contains("version: 0"));
    }
}
