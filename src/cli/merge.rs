//! `crumple merge`: combines the shards of divided work.

use std::path::{Path, PathBuf};

use clap::Args;

use super::simulate::OutputFormat;
use super::{CliError, output, train, verify};
use crumple_core::digits;
use crumple_evidence::RateFolderError;
use crumple_evidence::{COUNT_SHARD_KIND, MergedCount, PartialCount};
use crumple_learn::rl::{MergedTrainings, is_trainings_folder};
use crumple_store::run_folder::{CompletedRun, RunState, read_state};
use crumple_store::shard::{MergeError, format_ranges};

/// Combine shards produced on several machines (see --shard)
#[derive(Args)]
#[command(after_long_help = "\
Combines folders of `verify rate` and `train --seeds`, each with --shard I/N. They must be of one kind, in any \
order, at most 100 000. A shard may be given twice, and shards of several N may be mixed if no work is done twice. \
Exit code 2 for shards of different work, shards that overlap, shards whose files have changed, and two that state \
different results for the same shard. Merging again into the same --out changes nothing.

If no shard is missing:
  verify rate   the folder and the printed text are those of the same work on one machine, to the byte, \
with the certificate. In a space that states its exposure, the command without --shard, with --resume and this --out, \
then prints the failures per hour
  train         the folders `seed-N`, training.json and the learning curve are those of one machine, to the byte

If shards are missing or unfinished, crumple lists them, and the exit code is 1: run the same command with --resume \
for each, and merge again. For a count crumple then writes nothing; trainings are written as far as they exist. With \
--format json standard output also lists the missing shards.

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

enum ShardFolder {
    /// A shard of trainings, finished or not: each seed has a separate folder.
    Trainings,
    /// Any other shard, finished.
    Finished(CompletedRun),
}

impl ShardFolder {
    /// Opens a shard, or returns the reason why it cannot be merged yet.
    fn open(folder: &Path) -> Result<Result<Self, String>, CliError> {
        if is_trainings_folder(folder) {
            return Ok(Ok(Self::Trainings));
        }
        Ok(match read_state(folder)? {
            RunState::Missing => Err("not started".to_owned()),
            RunState::InProgress(kind) => Err(format!("a {kind}, unfinished")),
            RunState::Complete(found) => Ok(Self::Finished(found)),
        })
    }

    fn kind(&self) -> &str {
        match self {
            Self::Trainings => SHARD_OF_TRAININGS,
            Self::Finished(found) => found.kind(),
        }
    }
}

const SHARD_OF_TRAININGS: &str = "shard of trainings";

enum AnyMerged {
    Count(MergedCount),
    Trainings(Box<MergedTrainings>),
}

impl AnyMerged {
    fn from_shard(folder: &Path, shard: &ShardFolder) -> Result<Self, CliError> {
        let found = match shard {
            ShardFolder::Finished(found) => found,
            ShardFolder::Trainings => return Ok(Self::Trainings(Box::new(MergedTrainings::from_shard(folder)?))),
        };
        Ok(match found.kind() {
            COUNT_SHARD_KIND => Self::Count(MergedCount::new(folder, found)?),
            kind => {
                return Err(CliError::at(folder, format!("a {kind}, which is not a shard that can be merged")));
            }
        })
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Count(_) => COUNT_SHARD_KIND,
            Self::Trainings(_) => SHARD_OF_TRAININGS,
        }
    }

    fn add_shard(&mut self, folder: &Path, shard: &ShardFolder) -> Result<(), CliError> {
        let (kind, own) = (shard.kind(), self.kind());
        let is_same = kind == own;
        let taken = match (self, shard) {
            (Self::Trainings(merged), ShardFolder::Trainings) => return Ok(merged.add_shard(folder)?),
            (Self::Count(merged), ShardFolder::Finished(found)) if is_same => merged.add_shard(folder, found),
            _ => {
                let problem = format!("a {kind}, but the folders before it are of kind {own}");
                return Err(CliError::at(folder, problem));
            }
        };
        Ok(taken?)
    }
}

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
        let (mut merged, mut open): (Option<AnyMerged>, _) = (None, Vec::new());
        for folder in &self.folders {
            match (ShardFolder::open(folder)?, &mut merged) {
                (Err(why), _) => open.push(format!("{}: {why}", folder.display())),
                (Ok(shard), None) => merged = Some(AnyMerged::from_shard(folder, &shard)?),
                (Ok(shard), Some(merged)) => merged.add_shard(folder, &shard)?,
            }
        }
        for folder in &open {
            output::note(folder, quiet);
        }
        let Some(merged) = merged else {
            return Err(CliError::Gate("none of these folders contains a finished shard".to_owned()));
        };
        match merged {
            AnyMerged::Count(merged) => self.write_count(&merged),
            AnyMerged::Trainings(merged) => train::merge(&merged, &self.out, self.format, quiet),
        }
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
