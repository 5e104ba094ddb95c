//! The report of an assessment: results, and what follows from them.

use serde::Serialize;

use super::gate_rules::{GateInputs, GateResult};
use super::parts::{
    Argument, AssessmentComparison, AssessmentLimits, AssessmentProvenance, ClaimRow, ClaimSummary,
    DistinctFailure, EarlierAssessment, FirstPage, FirstPageSection, GatheredResults, Glossary,
    RunInfo, SpaceDescriptions, Suites, ViolatingScenarios,
};
use super::report_part::{ReportPart, ReportSection};
use super::{
    AssessmentPlan, CommandFile, CrumpleCommand, Ledger, ReportIdentity, commands, junit, page,
};
use crumple_store::run_folder::{MANIFEST_FILE, manifest_text};

/// Version of the JSON evidence that this release writes.
pub const EVIDENCE_VERSION: u32 = 4;

/// All results of an assessment, and what follows from them.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "schema",
    schemars(description = "All results of an assessment.")
)]
pub struct AssessmentReport {
    /// Version of the evidence format.
    pub version: u32,
    /// Identity of the report: subject, date, configuration and program.
    pub identity: ReportIdentity,
    /// First page: the question and its answer.
    pub first_page: FirstPage,
    /// Verdict: claims, and the strength of their evidence.
    pub summary: ClaimSummary,
    /// All evidence, each piece with its claim.
    pub evidence: Ledger,
    /// Results of simulations, searches and checks.
    #[serde(flatten)]
    pub results: GatheredResults,
    /// Scenarios that violate claims; absent if there are none.
    #[serde(default, skip_serializing_if = "ViolatingScenarios::is_empty")]
    pub violations: ViolatingScenarios,
    /// Statistics of the scenario spaces.
    pub space_descriptions: SpaceDescriptions,
    /// Limits of the assessment.
    pub limits: AssessmentLimits,
    /// Safety case: the verdict as a goal structure, in `assessment.gsn.yaml`.
    #[serde(skip)]
    pub argument: Argument,
    /// Changes since an earlier assessment; absent if there is none to compare with.
    pub comparison: Option<AssessmentComparison>,
    /// Provenance of the evidence.
    pub provenance: AssessmentProvenance,
    /// Files that commands of the report need.
    pub command_files: Vec<CommandFile>,
}

/// The part of a report that a comparison with an earlier one reads, in the form of `assessment.json`.
#[derive(Serialize)]
struct ComparedEvidence<'a> {
    evidence: &'a Ledger,
    summary: ComparedClaims<'a>,
    #[serde(flatten)]
    results: &'a GatheredResults,
}

#[derive(Serialize)]
struct ComparedClaims<'a> {
    controllers: Vec<String>,
    claims: &'a [ClaimRow],
}

impl<'a> ComparedEvidence<'a> {
    fn new(
        plan: &AssessmentPlan,
        evidence: &'a Ledger,
        claims: &'a [ClaimRow],
        results: &'a GatheredResults,
    ) -> Self {
        Self {
            evidence,
            summary: ComparedClaims {
                controllers: plan.controller_names(),
                claims,
            },
            results,
        }
    }
}

impl AssessmentReport {
    /// Derives the report from the results. Gates come after the comparison, because one of them evaluates it.
    pub(super) fn derive(
        plan: &AssessmentPlan,
        results: GatheredResults,
        provenance: AssessmentProvenance,
        (identity, command_files): (ReportIdentity, Vec<CommandFile>),
        against: Option<&EarlierAssessment>,
    ) -> Self {
        let evidence = Ledger::new(results.evidence(plan));
        let claims = ClaimRow::from_drafts(results.claims(plan), &evidence);
        let compared = ComparedEvidence::new(plan, &evidence, &claims, &results);
        let comparison = against.and_then(|earlier| {
            AssessmentComparison::new(earlier, &compared, &provenance.config_sha256)
        });
        let gates = evaluate_gates(&GateInputs {
            plan,
            results: &results,
            evidence: &evidence,
            claims: &claims,
            comparison: comparison.as_ref(),
        });
        let violations = ViolatingScenarios::new(plan, &results, &evidence, &claims, &gates);
        let summary = ClaimSummary::new(plan, claims, gates);
        let limits = AssessmentLimits::new(plan);
        Self {
            version: EVIDENCE_VERSION,
            argument: Argument::new(plan, &summary, &limits).with_identity(&identity),
            identity,
            first_page: FirstPage::new(plan, &summary, &limits),
            summary,
            evidence,
            results,
            violations,
            space_descriptions: SpaceDescriptions::new(plan),
            limits,
            comparison,
            provenance,
            command_files,
        }
    }

    /// Adds the time, program and machine of the assessment.
    #[must_use]
    pub fn with_run_info(self, run_info: RunInfo) -> Self {
        let identity = self.identity.with_run_info(&run_info);
        Self {
            argument: self.argument.with_identity(&identity),
            identity,
            provenance: self.provenance.with_run_info(run_info),
            ..self
        }
    }

    /// Compares the report with an earlier one; `None` if its evidence cannot be read back, a defect of its format.
    #[must_use]
    pub fn compare_with(&self, earlier: &EarlierAssessment) -> Option<AssessmentComparison> {
        AssessmentComparison::new(earlier, self, &self.provenance.config_sha256)
    }

    pub(super) fn first_page_section(&self) -> FirstPageSection<'_> {
        FirstPageSection {
            identity: &self.identity,
            page: &self.first_page,
            summary: &self.summary,
            searches: &self.results.searches,
            usefulness: self.results.usefulness.as_ref(),
            followers: self.results.followers.as_ref(),
            recorded_drives: self.results.recorded_drives.as_ref(),
        }
    }

    /// Returns the sections in the order of the page, with those of the appendix at the end.
    #[must_use]
    pub fn sections(&self) -> Vec<ReportSection> {
        let first_page = self.first_page_section();
        let mut parts: Vec<&dyn ReportPart> = vec![&first_page, &self.summary];
        parts.extend(self.comparison.iter().map(|part| part as &dyn ReportPart));
        parts.extend(self.results.parts());
        parts.push(&self.violations);
        let derived: [&dyn ReportPart; 4] = [
            &self.limits,
            &self.space_descriptions,
            &Glossary,
            &self.provenance,
        ];
        parts.extend(derived);
        ReportSection::from_parts(parts)
    }

    /// Returns the result for a reader, as lines: the first page, changes since an earlier assessment, and gates.
    #[must_use]
    pub fn to_text(&self) -> String {
        let comparison = self.comparison.as_ref();
        let changes = comparison.map(|comparison| comparison.to_plain_text());
        self.first_page.to_plain_text()
            + &changes.unwrap_or_default()
            + &self.summary.gates_to_plain_text()
    }

    /// Returns the report as one self-contained HTML page.
    #[must_use]
    pub fn to_html(&self) -> String {
        page::render_html(self)
    }

    /// Returns the first page as a self-contained HTML page: question, answer and reasons.
    #[must_use]
    pub fn first_page_to_html(&self) -> String {
        page::render_first_page(self)
    }

    /// Returns the report as Markdown, without figures.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        page::render_markdown(self)
    }

    /// Returns the evidence as JSON.
    ///
    /// # Errors
    /// None in practice; an error of the serializer is passed on.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self).map(|json| json + "\n")
    }

    /// Returns every file of the report, with its path relative to the report folder.
    ///
    /// # Errors
    /// None in practice; an error of the serializer is passed on.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, serde_json::Error> {
        let texts = REPORT_FILES.into_iter().zip(self.texts()?);
        let command_files = self.command_files.iter();
        let mut files: Vec<(String, Vec<u8>)> = texts
            .map(|(name, text)| (name.to_owned(), text.into_bytes()))
            .chain(self.results.parts().iter().flat_map(|part| part.files()))
            .chain(self.violations.files())
            .chain(command_files.map(|file| (file.file.clone(), file.contents.clone())))
            .collect();
        let contents = files
            .iter()
            .map(|(name, contents)| (name.as_str(), contents.as_slice()));
        let manifest = manifest_text(REPORT_KIND, &self.provenance.config_sha256, contents)?;
        files.push((MANIFEST_FILE.to_owned(), manifest.into_bytes()));
        Ok(files)
    }

    /// Returns the report in each of its formats ([`REPORT_FILES`]), and the script that repeats its results.
    fn texts(&self) -> Result<[String; 6], serde_json::Error> {
        let recount = self.results.proofs.recount_command();
        let replay = commands::replay_script(recount.as_ref(), self.commands());
        Ok([
            self.to_html(),
            self.to_markdown(),
            self.to_json()?,
            junit::render_junit(self),
            self.argument.to_yaml(),
            replay,
        ])
    }

    /// Returns every command that reproduces a result of the report, in its order.
    pub fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        let failures = self.results.searches.failures();
        let suite_commands = self.results.suites.iter().flat_map(Suites::commands);
        failures
            .flat_map(DistinctFailure::commands)
            .chain(suite_commands)
            .chain(self.violations.commands())
    }
}

fn evaluate_gates(inputs: &GateInputs<'_>) -> Vec<GateResult> {
    let gates = inputs.plan.config.gates.iter();
    gates.map(|gate| gate.evaluate(inputs)).collect()
}

/// Content of a report folder, as its `work.json` states it.
pub const REPORT_KIND: &str = "report of an assessment";

/// Files that every report has, beside its `work.json`.
pub(super) const REPORT_FILES: [&str; 6] = [
    "assessment.html",
    "assessment.md",
    "assessment.json",
    "assessment.junit.xml",
    "assessment.gsn.yaml",
    "replay.sh",
];

/// Subfolders of a report whose files may differ between reports.
pub const REPORT_FOLDERS: [&str; 7] = [
    "counterexamples/",
    "violations/",
    "certificates/",
    "controllers/",
    "spaces/",
    "scenarios/",
    "suites/",
];
