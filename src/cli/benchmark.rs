//! `crumple benchmark`: public problems for search methods and for proofs.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, value_parser};

use super::acc_benchmark::AccBenchmark;
use super::simulate::OutputFormat;
use super::{CliError, output};
use crumple_search::falsify::Method;
use crumple_search::falsify::chasing_cars::{Benchmark, CounterexampleFile, run_benchmark};
use crumple_store::disk::{DiskError, StagedFiles};

/// Run a public benchmark (falsification or neural-network verification)
#[derive(Args)]
pub(super) struct BenchmarkCommand {
    #[command(subcommand)]
    problem: BenchmarkSubcommand,
}

#[derive(Subcommand)]
enum BenchmarkSubcommand {
    ChasingCars(ChasingCars),
    Acc(AccBenchmark),
}

/// Benchmark a search method: ARCH-COMP falsification, Chasing Cars, instance 2
#[derive(Args)]
#[command(
    after_long_help = "Chasing Cars, instance 2 of the ARCH-COMP falsification category: five cars, throttle and brake \
                       in 20 pieces of 5 s each, six specifications (published formulas differ; crumple prints those \
                       that it uses below the table). A run counts as a success if its counterexample violates the \
                       specification by more than a centimetre at the published step of 0.01 s and at a fifth of it, \
                       where the cars evaluate their guards five times as often, and if an independent replay confirms \
                       it: a second implementation of the model and a naive monitor."
)]
struct ChasingCars {
    /// Search method (see `crumple list methods`)
    #[arg(long, value_name = "M", default_value = "auto")]
    method: Method,
    /// Maximum number of evaluations of a run: 1 to 1 000 000
    #[arg(long, value_name = "N", default_value_t = 1500, value_parser = value_parser!(u32).range(1..=1_000_000))]
    budget: u32,
    /// Runs of each specification, with successive seeds: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// First seed
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// Folder for the counterexamples, new or empty; crumple reads each file back and checks it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Output format; JSON also contains every run and its counterexample
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl BenchmarkCommand {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        match self.problem {
            BenchmarkSubcommand::ChasingCars(cars) => cars.run(quiet),
            BenchmarkSubcommand::Acc(cruise) => cruise.run(),
        }
    }
}

impl ChasingCars {
    fn run(self, quiet: bool) -> Result<(), CliError> {
        if let Some(folder) = &self.out {
            check_empty(folder)?;
        }
        let (budget, seeds) = (self.budget as usize, self.seeds as usize);
        let measured = run_benchmark(&self.method, budget, self.seed, seeds).map_err(CliError::input)?;
        if let Some(folder) = &self.out {
            write_counterexamples(&measured, folder, quiet)?;
        }
        output::print_result(self.format, &measured, || format_table(&measured))
    }
}

/// Refuses a folder that is not empty: earlier counterexamples could not be distinguished from new ones.
fn check_empty(folder: &Path) -> Result<(), CliError> {
    match std::fs::read_dir(folder).map(|mut entries| entries.next().is_none()) {
        Ok(false) => Err(CliError::Input(format!("--out: {} is not empty: choose another folder", folder.display()))),
        Ok(true) => Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(DiskError::at(folder)(source).into()),
    }
}

/// Writes each counterexample to a separate file, reads it back and replays it.
fn write_counterexamples(measured: &Benchmark, folder: &Path, quiet: bool) -> Result<(), CliError> {
    std::fs::create_dir_all(folder).map_err(DiskError::at(folder))?;
    let found: Vec<CounterexampleFile> = measured.counterexample_files();
    let mut files = StagedFiles::default();
    let mut paths = Vec::new();
    for counterexample in &found {
        let path = folder.join(counterexample.file_name());
        files.stage(&path, counterexample.to_toml().map_err(CliError::input)?.as_bytes())?;
        paths.push(path);
    }
    files.commit()?;
    let mut disagreeing = Vec::new();
    for path in &paths {
        if !CounterexampleFile::load(path)?.is_confirmed().map_err(CliError::input)? {
            disagreeing.push(path.display().to_string());
        }
    }
    if !disagreeing.is_empty() {
        return Err(CliError::Gate(format!("the independent replay does not confirm {}", disagreeing.join(", "))));
    }
    let plural = if paths.len() == 1 { "" } else { "s" };
    let note =
        format!("wrote {} counterexample{plural} to {}; the replay confirms each", paths.len(), folder.display());
    output::note(&note, quiet);
    Ok(())
}

fn format_table(measured: &Benchmark) -> String {
    let mut text = format!("Chasing Cars, {}, at most {} evaluations\n", measured.method, measured.budget);
    for row in &measured.rows {
        let mean = row.mean_evaluations.map_or("-".to_owned(), |mean| format!("{mean:.1}"));
        let of_those = if (1..row.seeds).contains(&row.successes) { ", of those that found one" } else { "" };
        let _ = writeln!(
            text,
            "  {:<4} {:>5} of {:<5} {mean:>8} evaluations to the first that holds at both steps{of_those}",
            row.spec, row.successes, row.seeds
        );
    }
    for row in &measured.rows {
        let _ = writeln!(text, "  {:<4} {}", row.spec, row.formula);
    }
    text
}
