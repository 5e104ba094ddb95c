//! `crumple fsck`: checks the integrity of run folders.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::assess::{EVIDENCE_FOLDER, LISTING_FILE};
use super::output_format::OutputFormat;
use super::{CliError, output};
use crumple_core::quoting::TerminalText;
use crumple_report::assessment::REPORT_KIND;
use crumple_search::falsify::campaign::verify_journal;
use crumple_store::run_folder::{FolderExamination, examine, is_run_folder};

/// Check result folders for missing or modified files
#[derive(Args)]
#[command(after_long_help = "\
A result folder of `crumple falsify`, `verify rate`, `train`, `retrain` or `tune` contains `work.json`, which states \
the length and the SHA-256 of every file. `fsck` changes no file and names all damaged files; --resume stops at the \
first.

Damaged work cannot be resumed; start again with a new --out. The same seed gives the same results.

`fsck` names files that do not belong to the results and leaves them unchanged, as it does `training.json` and the \
learning curves of a folder of trainings, which every `train` writes again. A report of `crumple assess` has a \
`work.json`, too; `assess` checks the evidence in the folder `evidence` when it reuses it.
The exit code is 1 if a file is damaged.

`fsck` detects files that were truncated, edited, moved or lost. It does not detect changes by a person who also \
rewrote `work.json`.

Examples:
  crumple fsck runs/baseline runs/seed-3")]
pub(super) struct Fsck {
    /// Folders of campaigns, counts, trainings, retrainings, tunings and reports
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Default, Serialize)]
struct FolderReport {
    folder: String,
    error: Option<String>,
    kind: Option<String>,
    complete: bool,
    is_of_this_build: bool,
    is_whole: bool,
    files: usize,
    damaged: Vec<DamagedFile>,
    /// Files that do not belong to the run, inside its folders and next to them.
    #[serde(rename = "strangers")]
    unlisted_files: Vec<String>,
    #[serde(rename = "beside")]
    other_files: Vec<String>,
}

#[derive(Serialize)]
struct DamagedFile {
    name: String,
    problem: String,
}

impl FolderReport {
    fn unreadable(folder: &Path, failure: &CliError) -> Self {
        Self {
            folder: folder.display().to_string(),
            error: Some(failure.to_string()),
            ..Self::default()
        }
    }

    fn new(folder: &Path, found: &FolderExamination) -> Self {
        let damaged = found.files.iter().filter_map(|(name, state)| {
            let problem = state.as_ref().err()?.clone();
            Some(DamagedFile {
                name: name.clone(),
                problem,
            })
        });
        Self {
            folder: folder.display().to_string(),
            error: None,
            kind: Some(found.kind.clone()),
            complete: found.is_complete,
            is_of_this_build: found.is_of_this_build,
            is_whole: found.is_intact(),
            files: found.files.len(),
            damaged: damaged.collect(),
            unlisted_files: found.unlisted_files.clone(),
            other_files: found.unrelated_files.clone(),
        }
    }
}

impl Fsck {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (mut text, mut all, mut unreadable) = (String::new(), Vec::new(), Vec::new());
        for folder in self
            .folders
            .iter()
            .flat_map(|folder| run_folders_in(folder))
        {
            let found = Self::examine_folder(&folder, &mut text).unwrap_or_else(|failure| {
                let found = FolderReport::unreadable(&folder, &failure);
                unreadable.push(failure);
                found
            });
            all.push(found);
        }
        let is_damaged = all
            .iter()
            .any(|found| found.error.is_none() && !found.is_whole);
        // Standard error has one line: the first failure, unless a folder is damaged.
        for failure in unreadable.iter().skip(usize::from(!is_damaged)) {
            text += &format!("{}\n", TerminalText(&failure.to_string()));
        }
        let printed = match self.format {
            OutputFormat::Json => output::print_json(&all),
            OutputFormat::Text => output::print_coloured(OutputFormat::Text, &text),
        };
        let folders = |is_wanted: &dyn Fn(&FolderReport) -> bool| -> String {
            let folders: Vec<&str> = all
                .iter()
                .filter(|found| is_wanted(found))
                .map(|found| found.folder.as_str())
                .collect();
            folders.join(", ")
        };
        let damaged = folders(&|found| found.error.is_none() && !found.is_whole);
        let unlooked = folders(&|found| found.error.is_some());
        let gate = match (damaged.is_empty(), unlooked.is_empty()) {
            (true, _) => unreadable.into_iter().next().map_or(Ok(()), Err),
            (false, true) => Err(CliError::Gate(format!("damaged: {damaged}"))),
            (false, false) => Err(CliError::Gate(format!(
                "damaged: {damaged}; unreadable: {unlooked}"
            ))),
        };
        CliError::gate_first(gate, printed)
    }

    /// Checks a folder, and appends a description to `text`.
    fn examine_folder(folder: &Path, text: &mut String) -> Result<FolderReport, CliError> {
        if !is_run_folder(folder) {
            let is_there = fs::symlink_metadata(folder).is_ok();
            let problem = if is_there {
                "not a result folder: it contains no work.json"
            } else {
                "there is no such folder"
            };
            return Err(CliError::at(folder, problem));
        }
        let mut found = verify_journal(folder, examine(folder)?)?;
        if found.kind == REPORT_KIND {
            // Evidence and listing serve the next report and have separate hashes.
            found
                .unrelated_files
                .retain(|name| name != EVIDENCE_FOLDER && name != LISTING_FILE);
        }
        *text += &format_report(folder, &found);
        Ok(FolderReport::new(folder, &found))
    }
}

/// Returns the run folders in a folder of trainings, one per seed; otherwise the folder itself.
fn run_folders_in(folder: &Path) -> Vec<PathBuf> {
    let is_seed = |path: &PathBuf| {
        path.is_dir()
            && path
                .file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with("seed-"))
    };
    let inner = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path());
    let mut seeds: Vec<PathBuf> = inner.filter(is_seed).collect();
    seeds.sort_unstable();
    if seeds.is_empty() || is_run_folder(folder) {
        vec![folder.to_owned()]
    } else {
        seeds
    }
}

fn format_report(folder: &Path, found: &FolderExamination) -> String {
    let is_damaged = found.files.iter().any(|(_, state)| state.is_err());
    let state = match (found.is_complete, found.is_of_this_build) {
        (true, _) => "complete",
        (false, true) if !found.is_intact() => "unfinished",
        (false, true) => "unfinished, --resume continues it",
        (false, false) => "unfinished, only the build of crumple that started it can resume it",
    };
    let whole = found
        .files
        .iter()
        .filter(|(_, state)| state.is_ok())
        .count();
    let mut text = format!(
        "{}: a {}, {state}; {whole} of {} files are intact\n",
        TerminalText(&folder.display().to_string()),
        TerminalText(&found.kind),
        found.files.len()
    );
    for (name, state) in &found.files {
        if let Err(problem) = state {
            text += &format!("  {}: {problem}\n", TerminalText(name));
        }
    }
    if is_damaged {
        text += "  damaged work cannot be resumed: start again with a new --out\n";
    }
    for name in &found.unlisted_files {
        text += &format!(
            "  {}: not part of these results, in a folder that may contain only their files: move it\n",
            TerminalText(name)
        );
    }
    for name in &found.unrelated_files {
        text += &format!("  {}: not part of these results\n", TerminalText(name));
    }
    text
}
