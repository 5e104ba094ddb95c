//! Searches up to the first violation, for benchmarks outside the program.

use rayon::prelude::*;

use crate::ExperimentError;
use crumple::search::falsify::{Method, UnitCube};

/// Maximum number of evaluations of a search.
const BUDGET: usize = 1500;

/// Returns the value that the search receives, and whether the point counts as counterexample.
type Evaluate<'a> = dyn Fn(&[f64]) -> Result<(f64, bool), ExperimentError> + Sync + 'a;

/// A problem of a benchmark.
pub(crate) struct Problem<'a> {
    pub(crate) name: String,
    pub(crate) cube: UnitCube,
    pub(crate) evaluate: Box<Evaluate<'a>>,
}

impl Problem<'_> {
    /// Returns the evaluations to the first counterexample; `None` within the budget.
    fn first_violation(
        &self,
        method: &Method,
        seed: u64,
    ) -> Result<Option<usize>, ExperimentError> {
        let mut search = method.start(&self.cube, seed);
        let mut evaluations = 0;
        while evaluations < BUDGET {
            let mut values = Vec::new();
            for point in search.ask().into_iter().take(BUDGET - evaluations) {
                let (value, is_counterexample) = (self.evaluate)(&point)?;
                evaluations += 1;
                if is_counterexample {
                    return Ok(Some(evaluations));
                }
                values.push(value);
            }
            search.tell(&values);
        }
        Ok(None)
    }

    /// Returns the evaluations of the successful searches with successive seeds.
    pub(crate) fn successes(
        &self,
        method: &Method,
        first: u64,
        seeds: u64,
    ) -> Result<Vec<usize>, ExperimentError> {
        (first..first + seeds)
            .into_par_iter()
            .filter_map(|seed| self.first_violation(method, seed).transpose())
            .collect()
    }
}

pub(crate) fn mean(evaluations: &[usize]) -> f64 {
    evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64
}

/// Prints a table of the problems: successful searches, and mean and standard error of their evaluations. Arguments are
/// the first seed, the number of seeds and perhaps a method.
pub(crate) fn print_table(
    problems: &[Problem<'_>],
    arguments: &[String],
) -> Result<(), ExperimentError> {
    let mut arguments = arguments.iter();
    let first: u64 = arguments.next().ok_or("which first seed?")?.parse()?;
    let seeds: u64 = arguments.next().ok_or("how many seeds?")?.parse()?;
    let method: Method = arguments.next().map_or("auto", String::as_str).parse()?;
    println!("| problem | falsified by `{method}` | mean evaluations | standard error |");
    println!("|---|---|---|---|");
    for problem in problems {
        let successes = problem.successes(&method, first, seeds)?;
        let mean = mean(&successes);
        let squares = successes
            .iter()
            .map(|&evaluations| (evaluations as f64 - mean).powi(2))
            .sum::<f64>();
        let count = successes.len() as f64;
        let error = (squares / (count - 1.0) / count).sqrt();
        println!(
            "| {} | {} of {seeds} | {mean:.1} | {error:.1} |",
            problem.name,
            successes.len()
        );
    }
    Ok(())
}
