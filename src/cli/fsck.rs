//! `crumple fsck`: checks the integrity of run folders.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use super::output_format::OutputFormat;
use super::{CliError, output};
use crumple_report::assessment::{EVIDENCE_FOLDER, LISTING_FILE, REPORT_KIND};
use crumple_search::falsify::campaign::verify_journal;
use crumple_store::run_folder::{FolderReport, examine, is_run_folder};

/// Check result folders for missing or modified files
#[derive(Args)]
#[command(after_long_help = "\
A result folder of `crumple falsify`, `verify rate`, `retrain` or `tune`, and each folder `seed-N` of `train`, \
contains `work.json`, which states the length and the SHA-256 of every other file. `fsck` changes no file and \
names all damaged files. (Commands with --resume stop at the first one.)

Damaged work cannot be resumed; start again with a new --out. The same seed gives the same results.

`fsck` also names files that do not belong to the results. It does not check the files beside the folders `seed-N`: \
`training.json` and the learning curves, which every `train` writes again. A report of `crumple assess` has a \
`work.json`, too. Its folder `evidence` has none: `assess` checks these files when it uses them again. To write a \
damaged report again, move changed files away and run the same command again.
The exit code is 1 if a file is damaged, or if a file that does not belong to the results lies in one of their \
subfolders (not of a report) or has the name of a result still to be written. Elsewhere, such files are only named.

`fsck` detects files that were truncated, edited, moved or lost. It does not detect changes by a person who also \
rewrote `work.json`.

Examples:
  crumple fsck runs/baseline runs/seed-3")]
pub(super) struct Fsck {
    /// Folders of campaigns, of counts (`verify rate`), trainings, retrainings, tunings and reports
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl Fsck {
    pub(super) fn run(self) -> Result<(), CliError> {
        let mut reports = Vec::new();
        let mut failures = Vec::new();
        for folder in self.folders.iter().flat_map(|path| run_folders_in(path)) {
            reports.push(examine_folder(&folder).unwrap_or_else(|failure| {
                let report = FolderReport::unreadable(&folder, failure.to_string());
                failures.push(failure);
                report
            }));
        }
        let printed = match self.format {
            OutputFormat::Json => output::print_json(&reports),
            OutputFormat::Text => output::print_coloured(OutputFormat::Text, &to_text(&reports)),
        };
        let damaged = list_folders(&reports, FolderReport::is_damaged);
        let unreadable = list_folders(&reports, |report| report.error.is_some());
        let verdict = match (damaged.is_empty(), unreadable.is_empty()) {
            (true, _) => failures.into_iter().next().map_or(Ok(()), Err),
            (false, true) => Err(CliError::Unmet(format!("damaged: {damaged}"))),
            (false, false) => Err(CliError::Unmet(format!(
                "damaged: {damaged}; unreadable: {unreadable}"
            ))),
        };
        CliError::verdict_first(verdict, printed)
    }
}

/// Returns the text of the examined folders, then that of the others.
fn to_text(reports: &[FolderReport]) -> String {
    let is_damaged = reports.iter().any(FolderReport::is_damaged);
    let examined = reports.iter().filter(|report| report.error.is_none());
    let unreadable = reports.iter().filter(|report| report.error.is_some());
    // Standard error has one line: the first failure, unless a folder is damaged.
    examined
        .chain(unreadable.skip(usize::from(!is_damaged)))
        .map(FolderReport::to_text)
        .collect()
}

fn list_folders(reports: &[FolderReport], is_wanted: impl Fn(&FolderReport) -> bool) -> String {
    let folders: Vec<&str> = reports
        .iter()
        .filter(|report| is_wanted(report))
        .map(|report| report.folder.as_str())
        .collect();
    folders.join(", ")
}

const INCOMPLETE_REPORT: &str =
    "an incomplete report without work.json: run the same command again";
/// Advice about a damaged report. The command refuses to replace changed files, which may be a person's work.
const REPORT_ADVICE: &str =
    "to write the report again, move changed files away and run the same command again";

fn examine_folder(folder: &Path) -> Result<FolderReport, CliError> {
    if !is_run_folder(folder) {
        let problem = if folder.join(LISTING_FILE).exists() {
            INCOMPLETE_REPORT
        } else if fs::symlink_metadata(folder).is_ok() {
            "not a result folder: it contains no work.json"
        } else {
            "there is no such folder"
        };
        return Err(CliError::at(folder, problem));
    }
    let mut examination = verify_journal(folder, examine(folder)?)?;
    if examination.kind != REPORT_KIND {
        return Ok(FolderReport::new(folder, &examination));
    }
    // Evidence and listing serve the next report and have separate hashes.
    examination
        .unrelated_files
        .retain(|name| name != EVIDENCE_FOLDER && name != LISTING_FILE);
    Ok(FolderReport {
        advice: REPORT_ADVICE,
        ..FolderReport::new(folder, &examination)
    })
}

/// Returns the run folders in a folder of trainings, one per seed; otherwise the folder itself.
fn run_folders_in(folder: &Path) -> Vec<PathBuf> {
    let inner = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let mut seeds: Vec<PathBuf> = inner
        .filter(|path| {
            path.is_dir()
                && path
                    .file_name()
                    .is_some_and(|name| name.to_string_lossy().starts_with("seed-"))
        })
        .collect();
    seeds.sort_unstable();
    if seeds.is_empty() || is_run_folder(folder) {
        vec![folder.to_owned()]
    } else {
        seeds
    }
}
