//! The provenance of the evidence.

use serde::Serialize;

use crate::assessment::document::ReportDocument;
use crate::assessment::report_block::{ParagraphStyle, ReportBlock};
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessConfig, AssessmentPlan, EvidenceCache, EvidenceHash};
use crumple_core::digest::sha256;
use crumple_core::markdown::prose_name;

/// The time, program and machine of an assessment. No evidence depends on them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunInfo {
    /// Date and time in UTC, in the format of RFC 3339.
    pub at: String,
    /// Commit of the repository with the assessed configuration, if there is one.
    pub commit: Option<String>,
    /// SHA-256 of the program.
    pub program_sha256: String,
    /// Commit from which the program was built, if its build states it. JSON has it in `identity`.
    #[serde(skip)]
    pub program_commit: Option<String>,
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
    /// Names of the controllers whose files are not in the report folder, such as compiled programs.
    #[serde(skip)]
    pub(in crate::assessment) absent_controllers: Vec<String>,
    /// Names of the controllers in the report.
    #[serde(skip)]
    controllers: Vec<String>,
    /// Hashes of all cached evidence.
    pub evidence: Vec<EvidenceHash>,
    /// Time, program and machine of the assessment, if known.
    pub run_info: Option<RunInfo>,
    /// Command that repeats the assessment in the folder of its report.
    #[serde(skip)]
    repeat_command: String,
}

impl AssessmentProvenance {
    /// `compared` is the configuration without the places of the assessed files.
    pub(in crate::assessment) fn new(
        plan: &AssessmentPlan,
        cache: &EvidenceCache,
        compared: &AssessConfig,
    ) -> Self {
        // `Debug` writes every field, and unlike a serializer cannot fail.
        let scenarios = plan
            .file_scenarios
            .iter()
            .map(|(_, scenario)| format!("{:?}", scenario.spec()));
        let spaces = plan
            .rate_spaces
            .iter()
            .chain(&plan.search_spaces)
            .map(|named| named.text.clone());
        let inputs = std::iter::once(format!("{compared:?}"))
            .chain(scenarios)
            .chain(spaces)
            .collect::<Vec<_>>()
            .join("\n");
        Self {
            crumple: env!("CARGO_PKG_VERSION"),
            config: plan.config.clone(),
            config_sha256: sha256(&inputs),
            controllers: plan.controller_names(),
            absent_controllers: plan
                .controllers_outside_report()
                .map(|controller| plan.controller_entry(controller).to_owned())
                .collect(),
            evidence: cache.hashes(),
            run_info: None,
            repeat_command: plan.repeat_command().to_string(),
        }
    }

    /// Adds the time, program and machine of the assessment.
    pub(in crate::assessment) fn with_run_info(self, run_info: RunInfo) -> Self {
        Self {
            run_info: Some(run_info),
            ..self
        }
    }

    fn hash_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.evidence,
            &[
                ("evidence", &|hash| ReportCell::text(prose_name(&hash.name))),
                ("SHA-256 of the inputs", &|hash| {
                    ReportCell::digest(&hash.inputs_sha256)
                }),
                ("SHA-256 of the evidence", &|hash| {
                    ReportCell::digest(&hash.evidence_sha256)
                }),
            ],
        )
    }

    fn inputs(&self) -> Vec<(String, String)> {
        let config = &self.config;
        let spaces = config.search_spaces().join(", ");
        let rates = &config.rates;
        let files: Vec<_> = config
            .scenarios
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        let lines = vec![
            ("crumple", self.crumple.to_owned()),
            ("estimator", config.estimator.name().to_owned()),
            ("controllers", self.controllers.join(", ")),
            ("random scenarios per space", config.draws.to_string()),
            ("seed", config.seed.to_string()),
            (
                "searches",
                format!("{spaces}, {} simulations per method", config.search.budget),
            ),
            (
                "counted runs",
                format!(
                    "{} at confidence {}, with the seed in each certificate",
                    rates.runs, rates.confidence
                ),
            ),
            (
                "drives in traffic and in high-risk",
                config.everyday_draws.to_string(),
            ),
            ("gates", config.gates.len().to_string()),
            (
                "repeat in the folder of this report",
                self.repeat_command.clone(),
            ),
            (
                "to repeat, first copy into this folder, each with its files",
                self.absent_controllers.join(", "),
            ),
            ("scenarios from files", files.join(", ")),
            (
                "configuration with all its scenarios and spaces, SHA-256",
                self.config_sha256.clone(),
            ),
        ];
        lines
            .into_iter()
            .filter(|(_, value)| !value.is_empty())
            .map(|(name, value)| (name.to_owned(), value))
            .collect()
    }
}

impl RunInfo {
    fn describe(&self) -> String {
        let commit = self
            .commit
            .as_ref()
            .map_or(String::new(), |commit| format!(", commit {commit}"));
        let program = self.program_sha256.get(..16).unwrap_or_default();
        format!(
            "{}{commit}, program {program}…, on {}, in {} s",
            self.at, self.machine, self.duration_s
        )
    }
}

const CACHE_NOTE: &str = "Evidence may come from the folder `evidence`, which the same program wrote for the same \
    inputs. Its hashes detect damaged and edited files, but not a forger who also writes new hashes. Certificates were \
    checked in this run. `--fresh` gathers all evidence again.";

impl ReportPart for AssessmentProvenance {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Appendix,
            anchor: "provenance",
            title: "Provenance",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        if let Some(run) = &self.run_info {
            let text = format!("Run of {}.", run.describe()).into();
            out.push(ReportBlock::Paragraph(text, ParagraphStyle::Id("made")));
        }
        out.push(ReportBlock::Definitions(self.inputs()));
        out.paragraph(CACHE_NOTE);
        out.collapsible("hashes of the evidence", self.hash_table());
    }
}
