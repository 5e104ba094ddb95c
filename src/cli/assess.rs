//! `crumple assess`: gathers evidence and writes the report.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde_json::{Map, Value};

use super::global_options::GlobalOptions;
use super::output;
use super::output_format::OutputFormat;
use super::{CliError, args, file_kind, interrupt, progress};
use crumple_controllers::find_for_user;
use crumple_core::text_file;
use crumple_report::assessment::{
    AssessConfig, AssessConfigError, AssessmentPlan, AssessmentReport, ClaimSummary,
    EVIDENCE_FOLDER, EarlierAssessment, EvidenceCache, ReportFolder, RunInfo, assess,
};
use crumple_sim::engine::NamedController;
use crumple_store::program;

/// Commit from which a release build was made, by `build.rs`.
const PROGRAM_COMMIT: Option<&str> = option_env!("CRUMPLE_COMMIT");

/// Rest of the long help, after the sentences about the built-in report.
const CONFIGURATION: &str = "\
`crumple show assessment` prints its configuration, with a comment for each field: controllers, spaces, scenarios, \
recordings, suites and gates. Save it, change it, and pass the file.

  crumple assess --controller aeb.toml          # your own controller, compared with `idm`
  crumple show assessment > mine.toml
  crumple assess mine.toml

A folder of scenarios may contain 10 000 files and 64 MiB. A certificate may have 64 MiB, and a TOML file 3 MiB. \
Recordings have the limits of `import`.

The folder `evidence` of the report caches evidence by the hash of all its inputs. Only evidence whose inputs changed \
is computed again, and an interrupted assessment resumes. Each file contains the hash of the program crumple, that of \
the inputs of the evidence, and that of the evidence itself. crumple computes evidence again if its file was \
truncated, edited or replaced. The hashes do not protect against a person who changes numbers and hashes together. If \
others can write to the folder, use --fresh, which ignores existing evidence, or another folder. Every run checks all \
certificates, cached or not.";

/// Returns the long help.
fn long_help() -> String {
    let compared = AssessConfig::default().controllers.join(", ");
    format!(
        "Without a file, `assess` compares {compared}. It simulates the paper's scenarios, 1000 random scenarios of \
         the paper's distribution, 200 each of `traffic` and `high-risk`, and 1400 each of `followers` and `everyday`, \
         and searches for failures. For each of the paper's scenarios it searches for the best escape (see `crumple \
         avoid`). It checks all certificates. {CONFIGURATION}"
    )
}

/// Compare controllers and write the report: HTML, Markdown, JSON, JUnit and GSN
#[derive(Args)]
#[command(after_long_help = long_help())]
pub(super) struct Assess {
    /// Configuration of the assessment; built-in defaults without it
    #[arg(value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Assess this controller with the built-in configuration, compared with `idm`
    #[arg(long, value_name = "C", conflicts_with = "config", value_parser = args::parse_controller)]
    controller: Option<NamedController>,
    /// Folder for the report, created if missing; `report.sha256` lists its files. crumple replaces or removes only
    /// files that it wrote there and that have not changed
    #[arg(long, value_name = "DIR", default_value = "crumple-report")]
    out: PathBuf,
    /// Folder of recorded drives (see `crumple import --whole`): each controller drives each of them once
    #[arg(long, value_name = "FOLDER")]
    drives: Option<PathBuf>,
    /// List changes since an earlier assessment: better, worse, new and removed
    #[arg(long, value_name = "OLD.json")]
    against: Option<PathBuf>,
    /// Gather all evidence again
    #[arg(long)]
    fresh: bool,
    /// Output format: result, changes and gates as text, or the field `summary` of assessment.json
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl Assess {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let quiet = global.quiet;
        let plan = self.load_plan(global)?;
        let against = self.load_earlier(&plan)?;
        let evidence_folder = self.out.join(EVIDENCE_FOLDER);
        self.announce_resumption(&evidence_folder, quiet);
        let identity = program::identity()?;
        let begun = Instant::now();
        let folder = ReportFolder::open(&self.out)?;
        folder.check(&plan)?;
        let cache = EvidenceCache::open(&evidence_folder, identity, self.fresh)?;
        if let Some(unknown) = plan.first_without_identity() {
            let name = &unknown.name;
            output::note(
                &format!(
                    "note: `{name}` states no identity, so the next assessment cannot reuse this evidence"
                ),
                quiet,
            );
        }
        let bar = progress::run_bar("assessing", plan.runs(), quiet);
        let assessment = progress::show(&bar, |observer| {
            assess(&plan, &cache, against.as_ref(), observer)
        })?;
        let source = self
            .config
            .as_deref()
            .and_then(Path::parent)
            .unwrap_or(Path::new(""));
        let run_info = RunInfo::collect(source, identity, PROGRAM_COMMIT, begun.elapsed());
        let assessment = assessment.with_run_info(run_info);
        folder.write(&assessment.files().map_err(CliError::input)?)?;
        self.note_files(&cache, quiet);
        let printed = self.print(&assessment);
        CliError::verdict_first(check_gates(&assessment.summary), printed)
    }

    fn load_plan(&self, global: GlobalOptions) -> Result<AssessmentPlan, CliError> {
        let plan = match (&self.config, &self.controller) {
            (Some(path), _) => AssessmentPlan::load(path, global.controllers)
                .map_err(|error| explain_configuration(path, error))?,
            (None, Some(own)) => {
                let config = AssessConfig::for_own_controller(own);
                AssessmentPlan::new(config, [own.clone()], Path::new(""))?
            }
            (None, None) => AssessmentPlan::built_in()?,
        };
        let plan = match &self.drives {
            Some(folder) => plan
                .with_drives(folder, global.controllers)
                .map_err(|error| match error {
                    AssessConfigError::Drives(error) => CliError::about("--drives", error),
                    other => other.into(),
                })?,
            None => plan,
        };
        if self.config.is_none() {
            return Ok(plan);
        }
        for note in plan.controllers().iter().flat_map(args::controller_notes) {
            output::note(&note, global.quiet);
        }
        Ok(plan)
    }

    /// Loads the assessment of `--against`.
    fn load_earlier(&self, plan: &AssessmentPlan) -> Result<Option<EarlierAssessment>, CliError> {
        let against = self
            .against
            .as_deref()
            .map(EarlierAssessment::load)
            .transpose()?;
        if against.is_none() && plan.needs_earlier_assessment() {
            return Err(CliError::Input(
                "--against: the gate `nothing-worse` needs an earlier assessment".to_owned(),
            ));
        }
        Ok(against)
    }

    /// Sets the message at an interruption.
    fn announce_resumption(&self, evidence_folder: &Path, quiet: bool) {
        let fresh = if self.fresh { " without --fresh" } else { "" };
        let evidence = evidence_folder.display();
        interrupt::set_exit_message(
            format!(
                "the evidence computed so far is in {evidence}: the same command{fresh} resumes the assessment"
            ),
            quiet,
        );
    }

    /// Notes the written files, and what became of the evidence of earlier assessments.
    fn note_files(&self, cache: &EvidenceCache, quiet: bool) {
        let (pieces, reused) = cache.reuse_counts();
        let reuse_note = if reused == 0 {
            String::new()
        } else {
            format!("; {reused} of {pieces} pieces of evidence were reused")
        };
        for path in cache.damaged_files() {
            output::note(
                &format!(
                    "note: {} was damaged, and its evidence was computed again",
                    path.display()
                ),
                quiet,
            );
        }
        let page = self.out.join("assessment.html");
        output::note(
            &format!(
                "wrote {} (and .md, .json, .junit.xml, .gsn.yaml){reuse_note}",
                page.display()
            ),
            quiet,
        );
    }

    fn print(&self, assessment: &AssessmentReport) -> Result<(), CliError> {
        output::print_result(self.format, &assessment.summary, || assessment.to_text())
    }
}

/// Explains an error of a configuration whose file is a controller or another file of crumple.
fn explain_configuration(path: &Path, error: AssessConfigError) -> CliError {
    let name = path.display();
    if let Some(kind) = file_kind::detect(path) {
        return CliError::at(path, format!("is no configuration, but {kind}"));
    }
    if find_for_user(&path.to_string_lossy(), Path::new("")).is_ok() || has_controller_field(path) {
        return CliError::at(
            path,
            format!(
                "is a controller, not a configuration: assess it with `crumple assess --controller {name}`, or \
                 print a configuration to edit with `crumple show assessment`"
            ),
        );
    }
    error.into()
}

/// True for a TOML file with a field that only controller files have, even if the controller cannot be opened.
fn has_controller_field(path: &Path) -> bool {
    let fields = ["built_in", "command", "fmu", "network"];
    text_file::read(path)
        .ok()
        .and_then(|text| text_file::parse_toml::<Map<String, Value>>(&text, path).ok())
        .is_some_and(|table| fields.iter().any(|field| table.contains_key(*field)))
}

fn check_gates(summary: &ClaimSummary) -> Result<(), CliError> {
    let failed: Vec<String> = summary
        .gates
        .iter()
        .filter(|gate| !gate.holds)
        .map(|gate| format!("{} ({})", gate.gate, gate.reason))
        .collect();
    if failed.is_empty() {
        Ok(())
    } else {
        Err(CliError::Gate(failed.join("; ")))
    }
}
