//! `crumple benchmark`: how the search compares with others, on a public problem.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::simulate::Format;
use super::{Failure, output};
use crumple_search::disk::{DiskError, Files};
use crumple_search::falsify::Method;
use crumple_search::falsify::chasing_cars::{Benchmark, CounterexampleFile, benchmark};

/// Measure a search method on a public falsification problem
#[derive(Args)]
#[command(after_long_help = "\
Chasing Cars, instance 2 of the ARCH-COMP falsification category: five cars, throttle and brake in 20 pieces of 5 s each, \
six specifications. A run counts as a success if its counterexample also violates the specification in an independent \
replay: a second implementation of the model and a naive monitor.")]
pub(super) struct Measure {
    /// The problem
    #[arg(value_enum)]
    problem: Problem,
    /// Search method (see `crumple list methods`)
    #[arg(long, value_name = "M", default_value = "auto")]
    method: Method,
    /// Most evaluations of a run: 1 to 1 000 000
    #[arg(long, value_name = "N", default_value_t = 1500, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    budget: u32,
    /// Runs of each specification, with seeds from 0: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Folder for the counterexamples, new or empty: one file each, rechecked from it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// How to print; JSON also holds every run and its counterexample
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

#[derive(Clone, Copy, ValueEnum)]
enum Problem {
    /// ARCH-COMP Chasing Cars, instance 2
    ChasingCars,
}

impl Measure {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let Problem::ChasingCars = self.problem;
        if let Some(folder) = &self.out {
            check_empty(folder)?;
        }
        let measured = benchmark(self.method, self.budget as usize, self.seeds as usize).map_err(Failure::input)?;
        if let Some(folder) = &self.out {
            keep(&measured, folder, quiet)?;
        }
        let text = match self.format {
            Format::Json => serde_json::to_string(&measured).map_err(Failure::input)? + "\n",
            Format::Text => table(&measured),
        };
        output::print(&text)
    }
}

/// Refuses a folder that holds anything: old counterexamples could not be told from new ones.
fn check_empty(folder: &Path) -> Result<(), Failure> {
    match std::fs::read_dir(folder).map(|mut entries| entries.next().is_none()) {
        Ok(false) => Err(Failure::Input(format!("--out: {} is not empty: choose another folder", folder.display()))),
        Ok(true) => Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(DiskError::at(folder)(source).into()),
    }
}

/// Writes each counterexample to a file of its own, reads it back and replays it from there.
fn keep(measured: &Benchmark, folder: &Path, quiet: bool) -> Result<(), Failure> {
    std::fs::create_dir_all(folder).map_err(DiskError::at(folder))?;
    let found: Vec<CounterexampleFile> = measured.counterexample_files();
    let mut files = Files::default();
    let mut paths = Vec::new();
    for counterexample in &found {
        let path = folder.join(counterexample.file_name());
        files.stage(&path, counterexample.to_toml().map_err(Failure::input)?.as_bytes())?;
        paths.push(path);
    }
    files.commit()?;
    let mut disagreeing = Vec::new();
    for path in &paths {
        if !CounterexampleFile::load(path)?.is_confirmed().map_err(Failure::input)? {
            disagreeing.push(path.display().to_string());
        }
    }
    if !disagreeing.is_empty() {
        return Err(Failure::Gate(format!("the independent replay does not confirm {}", disagreeing.join(", "))));
    }
    let plural = if paths.len() == 1 { "" } else { "s" };
    let note =
        format!("wrote {} counterexample{plural} to {}; the replay confirms each", paths.len(), folder.display());
    output::note(&note, quiet);
    Ok(())
}

fn table(measured: &Benchmark) -> String {
    let mut text = format!("Chasing Cars, {}, at most {} evaluations\n", measured.method, measured.budget);
    for row in &measured.rows {
        let mean = row.mean_evaluations.map_or("-".to_owned(), |mean| format!("{mean:.1}"));
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:<4} {:>5} of {:<5} {mean:>8} evaluations to the first",
            row.spec, row.successes, row.seeds
        );
    }
    text
}
