//! `crumple merge`: combines the shards of a count.

use std::path::{Path, PathBuf};

use clap::Args;

use super::simulate::OutputFormat;
use super::{CliError, output, verify};
use crumple_core::digits;
use crumple_evidence::RateFolderError;
use crumple_evidence::{COUNT_SHARD_KIND, MergedCount, PartialCount};
use crumple_store::run_folder::{RunState, read_state};
use crumple_store::shard::{MergeError, format_ranges};

/// Combine the shards of a count that several machines made
#[derive(Args)]
#[command(after_long_help = "\
Combines folders of `verify rate --shard I/N`, in any order, at most 100 000. A shard may be given twice, and shards \
of several N may be mixed if no run is counted twice. Exit code 2 for shards of different counts, shards that \
overlap, shards whose files have changed, and two that state different results for the same shard. Merging again \
into the same --out changes nothing.

If no shard is missing, the folder and the printed text are those of a count on one machine, to the byte, with the \
certificate. In a space that states its exposure, the command without --shard, with --resume and this --out, then \
prints the failures per hour.

If shards are missing or unfinished, crumple lists them, writes nothing, and the exit code is 1: run the same \
command with --resume for each, and merge again. With --format json standard output also lists the missing shards.

A count cannot omit missing runs: they may be missing because of their result. The printed bound therefore counts \
all missing runs as failures, so that it holds whatever their result is.

Examples:
  crumple verify rate --controller policy --runs 1000000 --shard 1/2 --out shards/1
  crumple verify rate --controller policy --runs 1000000 --shard 2/2 --out shards/2
  crumple merge shards/* --out rate --format json")]
pub(super) struct Merge {
    /// Folders of shards
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Folder for the result, not one of the shards
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

const MAX_FOLDERS: usize = 100_000;
const MAX_PRINTED_RANGES: usize = 20;

/// Resolves the symbolic links of a path whose last components may not exist.
fn resolve_path(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let real = |ancestor: &Path| Some(ancestor.canonicalize().ok()?.join(whole.strip_prefix(ancestor).ok()?));
    whole.ancestors().find_map(real).unwrap_or(whole.clone())
}

impl Merge {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        if self.folders.len() > MAX_FOLDERS {
            return Err(CliError::Input(format!(
                "found {} folders, at most {MAX_FOLDERS} can be merged",
                self.folders.len()
            )));
        }
        self.check_out_folder()?;
        let (mut merged, mut open): (Option<MergedCount>, _) = (None, Vec::new());
        for folder in &self.folders {
            let found = match read_state(folder)? {
                RunState::Missing => {
                    open.push(format!("{}: not started", folder.display()));
                    continue;
                }
                RunState::InProgress(kind) => {
                    open.push(format!("{}: a {kind}, unfinished", folder.display()));
                    continue;
                }
                RunState::Complete(found) if found.kind() == COUNT_SHARD_KIND => found,
                RunState::Complete(found) => {
                    let problem = format!("a {}, not a {COUNT_SHARD_KIND}", found.kind());
                    return Err(CliError::at(folder, problem));
                }
            };
            match &mut merged {
                None => merged = Some(MergedCount::new(folder, &found)?),
                Some(merged) => merged.add_shard(folder, &found)?,
            }
        }
        for folder in &open {
            output::note(folder, quiet);
        }
        let Some(merged) = merged else {
            return Err(CliError::Gate("none of these folders contains a finished shard".to_owned()));
        };
        self.write_count(&merged)
    }

    /// Checks that the output folder is in none of the shards, where it would be taken for a part of one.
    fn check_out_folder(&self) -> Result<(), CliError> {
        let out = resolve_path(&self.out);
        match self.folders.iter().find(|folder| folder.canonicalize().is_ok_and(|folder| out.starts_with(folder))) {
            None => Ok(()),
            Some(shard) => {
                let (out, shard) = (self.out.display(), shard.display());
                Err(CliError::Input(format!("--out: {out} is in the shard {shard}; use a folder outside the shards")))
            }
        }
    }

    fn write_count(&self, merged: &MergedCount) -> Result<(), CliError> {
        let written = match merged.write_in(&self.out) {
            // Print the counts even if the claim was rejected.
            Err(rejected @ RateFolderError::Rejected { .. }) => {
                let printed = match self.format {
                    OutputFormat::Json => output::print_json(&merged.partial_count()),
                    OutputFormat::Text => {
                        let tally = merged.tally().unwrap_or_default();
                        output::print(&verify::tally_line(merged.record().is_comparison(), &tally))
                    }
                };
                return CliError::gate_first(Err(rejected.into()), printed);
            }
            written => written?,
        };
        let Some((path, certificate)) = written else {
            let so_far = merged.partial_count();
            let printed = match self.format {
                OutputFormat::Json => output::print_json(&so_far),
                OutputFormat::Text => output::print(&format_incomplete(&so_far)),
            };
            let runs: u64 = so_far.missing_runs.iter().map(|[start, end]| end.saturating_sub(*start)).sum();
            return CliError::gate_first(
                Err(CliError::Gate(format!("{runs} runs are missing, and nothing is written"))),
                printed,
            );
        };
        let message = verify::certificate_verdict(&path, &certificate)?;
        match self.format {
            OutputFormat::Json => output::print_json(&merged.partial_count()),
            OutputFormat::Text => {
                let tally = merged.tally().unwrap_or_default();
                let counted = verify::tally_line(merged.record().is_comparison(), &tally);
                output::print_coloured(OutputFormat::Text, &format!("{counted}{message}"))
            }
        }
    }
}

fn format_incomplete(so_far: &PartialCount) -> String {
    let PartialCount { registered_runs, runs, shards, missing_runs, missing_shards, .. } = so_far;
    let plural = if *shards == 1 { "" } else { "s" };
    let mut text = format!("{runs} of {registered_runs} runs, in {shards} shard{plural}\n");
    let mut line = |words: String| text += &format!("  {words}\n");
    match so_far.shard_count {
        Some(of) if *runs > 0 => line(format!("missing of {of} shards: {}", format_ranges(missing_shards))),
        _ => {
            for [start, end] in missing_runs.iter().take(MAX_PRINTED_RANGES) {
                line(format!("missing: runs {start} to {}", end.saturating_sub(1)));
            }
            if let Some(more @ 1..) = missing_runs.len().checked_sub(MAX_PRINTED_RANGES) {
                line(format!("and {more} further ranges (--format json lists all)"));
            }
        }
    }
    match so_far.rate_at_most {
        Some(bound) => line(format!(
            "{} failures so far; if all missing runs were failures, the bound would be a rate of {}",
            so_far.failures,
            digits::format_rounded_up(bound, 4)
        )),
        None => line(format!(
            "so far {} runs in which only the first failed, {} only the second",
            so_far.only_first_failed, so_far.only_second_failed
        )),
    }
    text
}

impl From<MergeError> for CliError {
    fn from(error: MergeError) -> Self {
        match error {
            MergeError::RunFolder(error) => error.into(),
            other => Self::input(other),
        }
    }
}
