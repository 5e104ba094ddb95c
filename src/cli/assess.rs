//! `crumple assess`: gathers evidence and writes the report.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};
use std::{fs, process};

use clap::Args;

use super::global_options::GlobalOptions;
use super::output;
use super::output_folder::{EarlierFiles, OutputFolder};
use super::output_format::OutputFormat;
use super::{CliError, args, interrupt, progress, utc};
use crumple_report::assessment::{
    AssessConfig, AssessmentPlan, AssessmentReport, ClaimSummary, EarlierAssessment, EvidenceCache,
    REPORT_FOLDERS, REPORT_KIND, RunInfo, assess,
};
use crumple_store::disk::DiskError;
use crumple_store::program;
use crumple_store::run_folder;

/// Rest of the long help, after the sentences about the built-in report.
const CONFIGURATION: &str = "\
A file configures more:

  version = 1
  controllers = [\"baseline\", \"policy\"]   # the first is compared with all others
  subject = \"policy\"                       # the safety case is about this controller
  estimator = \"kalman\"
  # false omits the paper's scenarios and space
  paper = true
  distributions = [\"paper\"]               # spaces in which failures are counted
  draws = 1000                             # random scenarios of each of these spaces
  everyday_draws = 200                     # random scenarios of `traffic` and of `high-risk`
  seed = 0
  # scenario files and folders of scenario files, relative to this file
  scenarios = [\"episodes\"]
  # recordings whose braking episodes become scenarios (see import)
  recordings = [\"platoon.csv\"]
  search = { spaces = [\"paper\", \"high-risk\"], budget = 400 }
  # collisions ahead and behind, and harm, by kind of follower, and runs.csv
  harm = { emergencies_per_hour = 0.1, avoid_draws = 100 }
  # suites of tests, at most 20 (see suite list)
  suites = [{ suite = \"fmvss-127\", controllers = [\"policy\"] }]
  rates = { runs = 4000, confidence = 0.999 }
  certificates = [\"escape.json\"]           # certificates to check
  # a condition; the exit code is 1 if it does not hold
  [[gates]]
  require = \"rate-not-above\"
  controller = \"policy\"
  than = \"baseline\"

A folder of scenarios may contain 10 000 files and 64 MiB. The limit is 64 MiB for a certificate, that of `import` \
for a recording, and 3 MiB of TOML for any other file.

Other gates for a controller: no-collision-in-paper-scenarios, no-collision-in-scenario-files (of `scenarios` and \
`recordings`), no-collision-in-space (random scenarios of a space, one of `distributions` or `traffic` or \
`high-risk`) and no-avoidable-failure (with a space), unnecessary-braking-at-most and left-behind-at-most (with \
percent), string-stable (no speed oscillation of 0.05 to 2 rad/s around 4 to 30 m/s grows from vehicle to \
vehicle), suite-passed (with a suite), rate-at-most (with percent; both rates with a space, if there \
are several distributions), proofs-accepted, nothing-worse (than in --against).

The folder `evidence` of the report caches evidence by the hash of all its inputs. Only evidence whose inputs \
changed is computed again, and an interrupted assessment resumes. Each file contains hashes of the program, of its \
inputs and of itself; crumple computes evidence again if its file was truncated, edited or replaced. The hashes do \
not protect against a person who changes numbers and hashes together: do not reuse a folder that others can write \
to, or use --fresh, which ignores existing evidence. Every run checks all certificates, cached or not.";

/// Returns the long help.
fn long_help() -> String {
    let compared = AssessConfig::default().controllers.join(", ");
    format!(
        "Without a file, `assess` compares {compared}. It simulates the paper's scenarios, 1000 random scenarios of \
         the paper's distribution and 200 each of `traffic` and `high-risk`, and searches for failures. For each \
         scenario it finds the best escape (see avoid), and it checks all certificates. {CONFIGURATION}"
    )
}

/// Compare controllers and write the report: HTML, Markdown, JSON, JUnit and GSN
#[derive(Args)]
#[command(after_long_help = long_help())]
pub(super) struct Assess {
    /// Configuration of the assessment; built-in defaults without it
    #[arg(value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Folder for the report, created if missing; `report.sha256` lists its files. crumple replaces or removes only
    /// files that it wrote there and that have not changed
    #[arg(long, value_name = "DIR", default_value = "crumple-report")]
    out: PathBuf,
    /// List changes since an earlier assessment: better, worse, new and removed
    #[arg(long, value_name = "OLD.json")]
    against: Option<PathBuf>,
    /// Gather all evidence again
    #[arg(long)]
    fresh: bool,
    /// Output format: the first page as text, or the summary of assessment.json
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Folder in the report folder that keeps evidence for later reports.
pub(super) const EVIDENCE_FOLDER: &str = "evidence";
/// File that lists the files of a report.
pub(super) const LISTING_FILE: &str = "report.sha256";

impl Assess {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let quiet = global.quiet;
        let plan = self.load_plan(global)?;
        let against = self.load_earlier(&plan)?;
        let evidence_folder = self.out.join(EVIDENCE_FOLDER);
        self.announce_resumption(&evidence_folder, quiet);
        let identity = program::identity()?;
        let begun = Instant::now();
        let folder = self.open_folder()?;
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
        let assessment = assessment.with_run_info(run_info(source, identity, begun.elapsed()));
        folder.write(
            &assessment.files().map_err(CliError::input)?,
            EarlierFiles::Replace,
        )?;
        self.note_files(&cache, quiet);
        let printed = self.print(&assessment);
        CliError::gate_first(check_gates(&assessment.summary), printed)
    }

    fn load_plan(&self, global: GlobalOptions) -> Result<AssessmentPlan, CliError> {
        let Some(path) = &self.config else {
            return Ok(AssessmentPlan::built_in()?);
        };
        let plan = AssessmentPlan::load(path, global.controllers)?;
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

    /// Opens the report folder, and checks that the report may be written there.
    fn open_folder(&self) -> Result<OutputFolder, CliError> {
        check_no_symlinks(&self.out)?;
        if let Some(kind) = run_folder::read_kind(&self.out).filter(|kind| kind != REPORT_KIND) {
            return Err(CliError::Input(format!(
                "--out: {} contains a {kind}, whose work.json the report would replace; use another folder",
                self.out.display()
            )));
        }
        // Reports of earlier builds have a manifest instead of a listing.
        let folder = OutputFolder::with_listing(&self.out, LISTING_FILE)?
            .with_known_files(run_folder::read_digests(&self.out, REPORT_KIND));
        folder.check(&["assessment.html", "assessment.json", "assessment.md"])?;
        Ok(folder)
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
        output::print_result(self.format, &assessment.summary, || {
            let mut message = assessment.first_page.to_plain_text();
            if let Some(comparison) = &assessment.comparison {
                message += &format!("{}\n", comparison.describe());
            }
            message + &assessment.summary.gates_to_plain_text()
        })
    }
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

/// Refuses a report folder that contains symbolic links to folders: a report writes and removes files in its folders.
fn check_no_symlinks(out: &Path) -> Result<(), CliError> {
    REPORT_FOLDERS
        .into_iter()
        .chain([EVIDENCE_FOLDER, "figures"])
        .try_for_each(|name| ensure_no_symlinks(&out.join(name.trim_end_matches('/'))))
}

/// Checks that neither a folder nor any folder below it is a symbolic link. Ignores a path that is no folder.
fn ensure_no_symlinks(folder: &Path) -> Result<(), CliError> {
    if folder.is_symlink() && !folder.is_file() {
        let problem = "is a symbolic link, and `assess` writes and removes files only inside the report folder: \
                       remove the link, or use another --out";
        return Err(CliError::at(folder, problem));
    }
    let entries = if folder.is_dir() {
        fs::read_dir(folder).map_err(DiskError::at(folder))?
    } else {
        return Ok(());
    };
    entries
        .flatten()
        .try_for_each(|entry| ensure_no_symlinks(&entry.path()))
}

/// Returns the commit of the repository of the assessed files, with a mark if files differ from it; `None` without a
/// repository.
fn git_commit(folder: &Path) -> Option<String> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let commit = git_output(folder, &["rev-parse", "HEAD"])?;
    // `git status` starts the filters that the configuration of a repository names.
    let names_programs = ["--local", "--worktree"].into_iter().any(|scope| {
        let pattern = r"^(filter|include|includeif)\.";
        git_output(folder, &["config", scope, "--get-regexp", pattern]).is_some()
    });
    if names_programs {
        return Some(commit + ", not compared with the files: the repository configures filters");
    }
    let status = [
        "status",
        "--porcelain",
        "--untracked-files=no",
        "--ignore-submodules=all",
    ];
    let is_clean = git_output(folder, &status)?.is_empty();
    Some(commit + if is_clean { "" } else { " with changes" })
}

/// Returns the output of git in a folder, without starting programs that its configuration names; `None` if it fails.
fn git_output(folder: &Path, arguments: &[&str]) -> Option<String> {
    let no_programs = [
        "-c",
        "core.fsmonitor=false",
        "-c",
        "core.hooksPath=/dev/null",
    ];
    let mut command = process::Command::new("git");
    command
        .arg("-C")
        .arg(folder)
        .args(no_programs.iter().chain(arguments));
    // Keeps git from writing the index, which runs hooks, and from fetching, which starts a transport.
    command
        .env("GIT_OPTIONAL_LOCKS", "0")
        .env("GIT_NO_LAZY_FETCH", "1")
        .env("GIT_ALLOW_PROTOCOL", "none");
    let result = command.output().ok()?;
    result
        .status
        .success()
        .then(|| String::from_utf8_lossy(&result.stdout).trim().to_owned())
}

fn run_info(folder: &Path, program_sha256: &str, took: Duration) -> RunInfo {
    let model = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(format!(", {}", line.split_once(':')?.1.trim()))
    });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let system = std::env::consts::OS;
    let processor = std::env::consts::ARCH;
    RunInfo {
        at: utc::rfc_3339(SystemTime::now()),
        commit: git_commit(folder),
        program_sha256: program_sha256.to_owned(),
        machine: format!(
            "{system} {processor}, {cores} cores{}",
            model.unwrap_or_default()
        ),
        duration_s: took.as_secs(),
    }
}
