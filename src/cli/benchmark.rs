//! `crumple benchmark`: how the search compares with others, on a public problem.

use std::fmt::Write;

use clap::{Args, ValueEnum};

use super::simulate::Format;
use super::{Failure, output};
use crate::falsify::Method;
use crate::falsify::chasing_cars::{Benchmark, benchmark};

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
    /// Most evaluations of a run
    #[arg(long, value_name = "N", default_value_t = 1500, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    budget: u32,
    /// Runs of each specification, with seeds from 0
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
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
    pub(super) fn run(self) -> Result<(), Failure> {
        let Problem::ChasingCars = self.problem;
        let measured = benchmark(self.method, self.budget as usize, self.seeds as usize).map_err(Failure::input)?;
        let text = match self.format {
            Format::Json => serde_json::to_string(&measured).map_err(Failure::input)? + "\n",
            Format::Text => table(&measured),
        };
        output::print(&text)
    }
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
