//! `crumple merge`: put the shards of work together that was divided over machines.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::output::rounded_up;
use super::simulate::Format;
use super::{Failure, assess, falsify, output, rare, suite, train, verify};
use crumple_report::assessment::{MergedEvidence, SHARD_OF_AN_ASSESSMENT};
use crumple_search::evidence::rare::{MergedEstimate, SHARD_OF_AN_ESTIMATE};
use crumple_search::evidence::{MergedCount, SHARD_OF_A_COUNT, SoFar};
use crumple_search::falsify::campaign::{MergedCampaign, SHARD_OF_A_CAMPAIGN};
use crumple_search::shard::{MergeError, as_array};
use crumple_search::suite::{MergedSuite, SHARD_OF_A_SUITE};
use crumple_search::work::{Finished, Found, find};

/// Put shards together that were made on several machines (see --shard)
#[derive(Args)]
#[command(after_long_help = "\
Folders are those of `verify rate` (with --rare or without), `falsify`, `suite run`, `assess` and `train --seeds`, each with --shard I/N, of one kind, in \
any order, at most 100 000. A shard may be given twice; shards of several N may be mixed as long as nothing is done twice. Refused with exit \
code 2: shards of other work, shards that overlap, shards whose files are not as they were written, and two that state different results for \
the same shard. Merging again into the same --out changes nothing.

If all are there:
  verify rate   the folder of --out is that of the same work on one machine, to the byte, certificate included
  falsify       the folder is that of one campaign: distinct failures of all shards, one front, coverage of the union. With --method uniform \
or halton it is that of `falsify --log summary` on one machine, to the byte; other methods are as many searches as there are shards
  suite run     what is printed, and the scenarios in --out, are those of one machine, to the byte
  assess        the evidence is put into --out: `crumple assess` with the same file and --out writes the report without gathering it again
  train         the folders `seed-N`, training.json and the learning curve are those of one machine, to the byte

If some are missing, or half done, it is said which, and the exit code is 1: make them with the same command and --resume, and merge again. Of a count, \
an estimate and a suite nothing is written then, of a campaign with --partial only; it is its own campaign and wants another --out than the whole. \
Evidence and trainings that are there are written.

Of a count what is missing cannot be left out: runs that are missing may be missing because of how they ended. The bound that is printed then \
takes all of them as failures, which makes it hold whatever they come to.

Examples:
  crumple verify rate --controller policy --runs 1000000 --shard 1/2 --out shards/1
  crumple verify rate --controller policy --runs 1000000 --shard 2/2 --out shards/2
  crumple merge shards/* --out rate
  crumple merge searches/* --out campaign --format json
  crumple merge tests/* --out failures --format junit")]
pub(super) struct Merge {
    /// Folders of shards
    #[arg(required = true, value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// Where the whole goes; of a suite, the scenarios that failed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Of a campaign: write the part that is there, though shards are missing; the exit code is 1 all the same
    #[arg(long)]
    partial: bool,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    format: MergeFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum MergeFormat {
    /// For a reader
    Text,
    /// One JSON object
    Json,
    /// Of a suite: for a build server
    Junit,
    /// Of a suite: a page, with the controllers that are found by their names drawn where they failed
    Html,
}

impl MergeFormat {
    fn of_suite(self) -> suite::Format {
        match self {
            Self::Text => suite::Format::Text,
            Self::Json => suite::Format::Json,
            Self::Junit => suite::Format::Junit,
            Self::Html => suite::Format::Html,
        }
    }
}

/// The most folders that are read.
const MOST_FOLDERS: usize = 100_000;
/// Missing ranges that are printed.
const MOST_RANGES: usize = 20;

/// Shards of one work.
enum Merged {
    Count(MergedCount),
    Estimate(Box<MergedEstimate>),
    Campaign(Box<MergedCampaign>),
    Suite(Box<MergedSuite>),
    Assessment(Box<MergedEvidence>),
}

impl Merged {
    fn of(folder: &Path, found: &Finished) -> Result<Self, Failure> {
        Ok(match found.kind() {
            SHARD_OF_A_COUNT => Self::Count(MergedCount::of(folder, found)?),
            SHARD_OF_AN_ESTIMATE => Self::Estimate(Box::new(MergedEstimate::of(folder, found)?)),
            SHARD_OF_A_CAMPAIGN => Self::Campaign(Box::new(MergedCampaign::of(folder, found)?)),
            SHARD_OF_A_SUITE => Self::Suite(Box::new(MergedSuite::of(folder, found)?)),
            SHARD_OF_AN_ASSESSMENT => Self::Assessment(Box::new(MergedEvidence::of(folder, found)?)),
            kind => {
                let problem = format!("{}: a {kind}, and no shard that can be merged", folder.display());
                return Err(Failure::Input(problem));
            }
        })
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Count(_) => SHARD_OF_A_COUNT,
            Self::Estimate(_) => SHARD_OF_AN_ESTIMATE,
            Self::Campaign(_) => SHARD_OF_A_CAMPAIGN,
            Self::Suite(_) => SHARD_OF_A_SUITE,
            Self::Assessment(_) => SHARD_OF_AN_ASSESSMENT,
        }
    }

    fn take(&mut self, folder: &Path, found: &Finished) -> Result<(), Failure> {
        if found.kind() != self.kind() {
            let kind = found.kind();
            return Err(Failure::Input(format!("{}: a {kind}, which those before it are not", folder.display())));
        }
        let taken = match self {
            Self::Count(merged) => merged.take(folder, found),
            Self::Estimate(merged) => merged.take(folder, found),
            Self::Campaign(merged) => merged.take(folder, found),
            Self::Suite(merged) => merged.take(folder, found),
            Self::Assessment(merged) => merged.take(folder, found),
        };
        Ok(taken?)
    }
}

impl Merge {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        if self.folders.len() > MOST_FOLDERS {
            return Err(Failure::Input(format!("{} folders: at most {MOST_FOLDERS} are read", self.folders.len())));
        }
        if self.folders.iter().any(|folder| train::is_of_trainings(folder)) {
            self.only_text_or_json("trainings")?;
            return train::merge(&self.folders, &self.out, quiet);
        }
        let (mut merged, mut open): (Option<Merged>, _) = (None, Vec::new());
        for folder in &self.folders {
            match find(folder)? {
                Found::Nothing => open.push(format!("{}: not begun", folder.display())),
                Found::HalfDone(kind) => open.push(format!("{}: a {kind}, half done", folder.display())),
                Found::Finished(found) => match &mut merged {
                    None => merged = Some(Merged::of(folder, &found)?),
                    Some(merged) => merged.take(folder, &found)?,
                },
            }
        }
        for folder in &open {
            output::note(folder, quiet);
        }
        let Some(merged) = merged else {
            return Err(Failure::Gate("none of these folders holds a finished shard".to_owned()));
        };
        if let Merged::Suite(merged) = &merged {
            return suite::merge(merged, &self.out, self.format.of_suite());
        }
        let format = self.only_text_or_json(merged.kind())?;
        match merged {
            Merged::Count(merged) => self.count(&merged, format),
            Merged::Estimate(merged) => rare::merge(&merged, &self.out, format),
            Merged::Campaign(merged) => falsify::merge(&merged, &self.out, (format, self.partial), quiet),
            Merged::Assessment(merged) => assess::merge(&merged, &self.out),
            Merged::Suite(_) => Ok(()),
        }
    }

    fn only_text_or_json(&self, kind: &str) -> Result<Format, Failure> {
        match self.format {
            MergeFormat::Text => Ok(Format::Text),
            MergeFormat::Json => Ok(Format::Json),
            MergeFormat::Junit | MergeFormat::Html => {
                Err(Failure::Input(format!("--format: JUnit and HTML are of suites, and these are: {kind}")))
            }
        }
    }

    fn count(&self, merged: &MergedCount, format: Format) -> Result<(), Failure> {
        let Some((path, certificate)) = merged.write_in(&self.out)? else {
            let so_far = merged.so_far();
            let printed = output::print(&match format {
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
        output::print(&match format {
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
            "{} failures so far; were all missing runs failures too, the bound would be a rate of {}",
            so_far.failures,
            rounded_up(bound)
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
