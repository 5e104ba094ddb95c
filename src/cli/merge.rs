//! `crumple merge`: put the shards of work together that was divided over machines.

use std::path::{Path, PathBuf};

use clap::Args;

use super::simulate::Format;
use super::{Failure, output, rare, verify};
use crumple_search::evidence::rare::{MergedEstimate, SHARD_OF_AN_ESTIMATE};
use crumple_search::evidence::{MergedCount, SHARD_OF_A_COUNT, SoFar};
use crumple_search::shard::{MergeError, as_array};
use crumple_search::work::{Finished, Found, find};

/// Put shards together that were made on several machines (see --shard)
#[derive(Args)]
#[command(after_long_help = "\
Folders are those of `crumple verify rate --shard I/N`, with --rare or without, in any order, at most 100 000. A shard may be given twice; shards of several N may be \
mixed as long as no run is counted twice. Refused with exit code 2: shards of other work, shards that overlap, shards whose \
files are not as they were written, and two that state different results for the same shard.

If all are there, the folder of --out is that of the same work on one machine, to the byte, certificate included. If some are \
missing, or half done, it is said which, nothing is written, and the exit code is 1: make them with the same command \
and --resume, and merge again. Merging again into the same --out changes nothing.

What is missing cannot be left out: runs that are missing may be missing because of how they ended. The bound that is printed then takes all of \
them as failures, which makes it hold whatever they come to.

Examples:
  crumple verify rate --controller policy --runs 1000000 --shard 1/2 --out shards/1
  crumple verify rate --controller policy --runs 1000000 --shard 2/2 --out shards/2
  crumple merge shards/* --out rate")]
pub(super) struct Merge {
    /// Folders of shards
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Where the whole goes
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// The most folders that are read.
const MOST_FOLDERS: usize = 100_000;
/// Missing ranges that are printed.
const MOST_RANGES: usize = 20;

/// Shards of one work.
enum Merged {
    Count(MergedCount),
    Estimate(Box<MergedEstimate>),
}

/// The shards so far, and one more.
fn taken(merged: Option<Merged>, folder: &Path, found: &Finished) -> Result<Merged, Failure> {
    match (merged, found.kind()) {
        (None, SHARD_OF_A_COUNT) => Ok(Merged::Count(MergedCount::of(folder, found)?)),
        (None, SHARD_OF_AN_ESTIMATE) => Ok(Merged::Estimate(Box::new(MergedEstimate::of(folder, found)?))),
        (Some(Merged::Count(mut merged)), SHARD_OF_A_COUNT) => {
            merged.take(folder, found)?;
            Ok(Merged::Count(merged))
        }
        (Some(Merged::Estimate(mut merged)), SHARD_OF_AN_ESTIMATE) => {
            merged.take(folder, found)?;
            Ok(Merged::Estimate(merged))
        }
        (None, kind) => Err(Failure::Input(format!("{}: a {kind}, and no shard that can be merged", folder.display()))),
        (Some(_), kind) => {
            Err(Failure::Input(format!("{}: a {kind}, which those before it are not", folder.display())))
        }
    }
}

impl Merge {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        if self.folders.len() > MOST_FOLDERS {
            return Err(Failure::Input(format!("{} folders: at most {MOST_FOLDERS} are read", self.folders.len())));
        }
        let (mut merged, mut open) = (None, Vec::new());
        for folder in &self.folders {
            match find(folder)? {
                Found::Nothing => open.push(format!("{}: not begun", folder.display())),
                Found::HalfDone(kind) => open.push(format!("{}: a {kind}, half done", folder.display())),
                Found::Finished(found) => merged = Some(taken(merged, folder, &found)?),
            }
        }
        for folder in &open {
            output::note(folder, quiet);
        }
        match merged {
            None => Err(Failure::Gate("none of these folders holds a finished shard".to_owned())),
            Some(Merged::Count(merged)) => self.count(&merged),
            Some(Merged::Estimate(merged)) => rare::merge(&merged, &self.out, self.format),
        }
    }

    fn count(&self, merged: &MergedCount) -> Result<(), Failure> {
        let Some((path, certificate)) = merged.write_in(&self.out)? else {
            let so_far = merged.so_far();
            let printed = output::print(&match self.format {
                Format::Json => serde_json::to_string(&so_far).map_err(Failure::input)? + "\n",
                Format::Text => incomplete(&so_far),
            });
            let runs: u64 = so_far.missing_runs.iter().map(|[start, end]| end.saturating_sub(*start)).sum();
            return Failure::gate_first(
                Err(Failure::Gate(format!("{runs} runs are missing, and nothing is written"))),
                printed,
            );
        };
        let said = verify::judged(&path, &certificate)?;
        output::print(&match self.format {
            Format::Json => serde_json::to_string(&merged.so_far()).map_err(Failure::input)? + "\n",
            Format::Text => {
                let tally = merged.tally().unwrap_or_default();
                format!("{}{said}", verify::counted(merged.record().is_of_two(), &tally))
            }
        })
    }
}

/// What is there, and what is not.
fn incomplete(so_far: &SoFar) -> String {
    let SoFar { registered_runs, runs, shards, missing_runs, missing_shards, .. } = so_far;
    let plural = if *shards == 1 { "" } else { "s" };
    let mut text = format!("{runs} of {registered_runs} runs, in {shards} shard{plural}\n");
    let mut line = |words: String| text += &format!("  {words}\n");
    match so_far.of_shards {
        Some(of) if *runs > 0 => line(format!("missing of {of} shards: {}", as_array(missing_shards))),
        _ => {
            for [start, end] in missing_runs.iter().take(MOST_RANGES) {
                line(format!("missing: runs {start} to {}", end.saturating_sub(1)));
            }
            if let Some(more @ 1..) = missing_runs.len().checked_sub(MOST_RANGES) {
                line(format!("and {more} ranges more (--format json has them all)"));
            }
        }
    }
    match so_far.rate_at_most {
        Some(bound) => line(format!(
            "{} failures so far; were all missing runs failures too, the bound would be a rate of {bound:.3e}",
            so_far.failures
        )),
        None => line(format!(
            "so far {} runs in which only the first failed, {} only the second",
            so_far.only_first_failed, so_far.only_second_failed
        )),
    }
    text
}

impl From<MergeError> for Failure {
    fn from(error: MergeError) -> Self {
        match error {
            MergeError::Work(error) => error.into(),
            other => Self::input(other),
        }
    }
}
