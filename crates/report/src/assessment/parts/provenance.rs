//! The provenance of the evidence.

use maud::html;
use serde::Serialize;

use crate::assessment::document::ReportDocument;
use crate::assessment::markdown::Inline;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessConfig, AssessmentPlan, EvidenceCache, EvidenceHash, ReportPart};
use crumple_core::digest::sha256;

/// The time, program and machine of an assessment. No evidence depends on them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BuildInfo {
    /// Date and time in UTC, in the format of RFC 3339.
    pub at: String,
    /// Commit of the repository with the assessed configuration, if there is one.
    pub commit: Option<String>,
    /// SHA-256 of the program.
    pub program_sha256: String,
    /// System and processor.
    pub machine: String,
    /// Duration in whole seconds.
    pub duration_s: u64,
}

/// The inputs that reproduce the evidence.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentProvenance {
    /// Version of crumple.
    pub crumple: &'static str,
    /// Configuration with all defaults.
    pub config: AssessConfig,
    /// SHA-256 of the configuration and of every scenario and space that it names.
    pub config_sha256: String,
    /// Hashes of all cached evidence.
    pub evidence: Vec<EvidenceHash>,
    /// Time, program and machine of the assessment, if known.
    #[serde(rename = "made")]
    pub build_info: Option<BuildInfo>,
}

impl AssessmentProvenance {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, store: &EvidenceCache) -> Self {
        // `Debug` writes every field of both, and unlike a serializer cannot fail.
        let scenarios = plan.file_scenarios.iter().map(|(_, scenario)| format!("{:?}", scenario.spec()));
        let spaces = plan.distributions.iter().chain(&plan.spaces).map(|named| named.text.clone());
        let config = std::iter::once(format!("{:?}", plan.config));
        let all = config.chain(scenarios).chain(spaces).collect::<Vec<_>>().join("\n");
        Self {
            crumple: env!("CARGO_PKG_VERSION"),
            config: plan.config.clone(),
            config_sha256: sha256(&all),
            evidence: store.hashes(),
            build_info: None,
        }
    }

    fn hash_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.evidence,
            &[
                ("evidence", &|hash| ReportCell::text(&hash.name)),
                ("from inputs, SHA-256", &|hash| ReportCell::digest(&hash.inputs_sha256)),
                ("says, SHA-256", &|hash| ReportCell::digest(&hash.evidence_sha256)),
            ],
        )
    }

    fn lines(&self) -> Vec<(&'static str, String)> {
        let lines = vec![
            ("crumple", self.crumple.to_owned()),
            ("estimator of the vehicles under test", self.config.estimator.name().to_owned()),
            ("controllers", self.config.controllers.join(", ")),
            ("draws", self.config.draws.to_string()),
            ("seed", self.config.seed.to_string()),
            (
                "searches",
                format!(
                    "{}, {} evaluations a method",
                    self.config.search_spaces().join(", "),
                    self.config.search.budget
                ),
            ),
            (
                "counted runs",
                format!(
                    "{} at confidence {}, with the seed that each certificate states",
                    self.config.rates.runs, self.config.rates.confidence
                ),
            ),
            ("drives in everyday traffic", self.config.everyday_draws.to_string()),
            ("gates", format!("{}, stated by the configuration", self.config.gates.len())),
            (
                "made again by",
                "crumple assess, with this configuration, which is in assessment.json, as a file".to_owned(),
            ),
            (
                "scenarios from files",
                self.config.scenarios.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", "),
            ),
            ("configuration, SHA-256", self.config_sha256.clone()),
        ];
        lines.into_iter().filter(|(_, value)| !value.is_empty()).collect()
    }
}

impl BuildInfo {
    fn describe(&self) -> String {
        let commit = self.commit.as_ref().map_or(String::new(), |commit| format!(", commit {commit}"));
        let program = self.program_sha256.get(..16).unwrap_or_default();
        format!("{}{commit}, program {program}…, on {}, in {} s", self.at, self.machine, self.duration_s)
    }
}

const CACHE_NOTE: &str = "Evidence may have been kept in the folder `evidence` by an earlier run of this very program on these very \
    inputs. Its hashes tell what was cut, edited or swapped since; they are no protection against somebody who wrote numbers and \
    hashes anew. What the checker says of the certificates listed here was said in this run. With `--fresh` everything is gathered again.";

impl ReportPart for AssessmentProvenance {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("provenance", "Provenance".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.push_html(html! {
            @if let Some(made) = &self.build_info { p #made { "Made " (made.describe()) "." } }
            dl { @for (name, value) in self.lines() { dt { (name) } dd { (value) } } }
        });
        out.paragraph(CACHE_NOTE);
        out.push_html(html! { details { summary { "hashes of the evidence" } (self.hash_table().to_html()) } });
        let lines = self.build_info.iter().map(|made| ("made", made.describe())).chain(self.lines());
        out.markdown_mut().list(lines.map(|(name, value)| Inline::prose(&format!("{name}: ")).and_code(value)));
    }
}
