//! How many evaluations a method needs until it falsifies each specification.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ChasingCarsError, Inputs, PIECES, SPECIFICATIONS, replayed_robustness, robustness};
use crate::falsify::{Cube, Method};
use crumple_world::measure::stl::Formula;

/// The result of a method on the six specifications.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Benchmark {
    /// Name of the method.
    pub method: String,
    /// Most evaluations of a run.
    pub budget: usize,
    /// One row a specification.
    pub rows: Vec<Row>,
}

/// One specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Row {
    /// Name of the specification.
    pub spec: String,
    /// Runs that found a counterexample which the replay confirmed.
    pub successes: usize,
    /// Runs.
    pub seeds: usize,
    /// Mean evaluations to the first counterexample, over the successful runs; none if there is none.
    pub mean_evaluations: Option<f64>,
    /// The runs, by seed.
    pub runs: Vec<Run>,
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Run {
    /// Seed, from 0.
    pub seed: u64,
    /// Evaluations made, up to and with the first counterexample.
    pub evaluations: usize,
    /// Smallest robustness found.
    pub best_robustness: f64,
    /// What falsified the specification, if anything did.
    pub counterexample: Option<Counterexample>,
}

/// Inputs under which a specification is violated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Counterexample {
    /// Throttle of each 5 s.
    pub throttle: Vec<f64>,
    /// Brake of each 5 s.
    pub brake: Vec<f64>,
    /// Robustness by the model and monitor of the search.
    pub robustness: f64,
    /// Robustness by the independent replay.
    pub replayed_robustness: f64,
}

impl Run {
    /// Whether a counterexample was found that the replay confirmed.
    #[must_use]
    pub fn is_success(&self) -> bool {
        self.counterexample.as_ref().is_some_and(|found| found.replayed_robustness < 0.0)
    }
}

/// Runs `method` with seeds 0, 1, ... on every specification, each run until its first counterexample.
///
/// # Errors
/// [`ChasingCarsError`] if a specification does not fit the model.
pub fn benchmark(method: Method, budget: usize, seeds: usize) -> Result<Benchmark, ChasingCarsError> {
    let row = |(name, text): (&str, &str)| -> Result<Row, ChasingCarsError> {
        let formula: Formula = text.parse()?;
        let runs: Vec<Run> = (0..seeds as u64)
            .into_par_iter()
            .map(|seed| run(method, &formula, budget, seed))
            .collect::<Result<_, _>>()?;
        let successes: Vec<f64> =
            runs.iter().filter(|run| run.is_success()).map(|run| run.evaluations as f64).collect();
        let mean = successes.iter().sum::<f64>() / successes.len() as f64;
        Ok(Row {
            spec: name.to_owned(),
            successes: successes.len(),
            seeds,
            mean_evaluations: Some(mean).filter(|mean| mean.is_finite()),
            runs,
        })
    };
    let rows = SPECIFICATIONS.into_iter().map(row).collect::<Result<_, _>>()?;
    Ok(Benchmark { method: method.name().to_owned(), budget, rows })
}

/// One search. Values are told a batch at a time, but a run ends at the first counterexample in the batch's order.
fn run(method: Method, formula: &Formula, budget: usize, seed: u64) -> Result<Run, ChasingCarsError> {
    let Ok(cube) = Cube::new([PIECES, PIECES]) else {
        return Ok(Run { seed, evaluations: 0, best_robustness: f64::INFINITY, counterexample: None });
    };
    let mut search = method.start(&cube, seed);
    let mut run = Run { seed, evaluations: 0, best_robustness: f64::INFINITY, counterexample: None };
    while run.evaluations < budget {
        let mut told = Vec::new();
        for point in search.ask().into_iter().take(budget - run.evaluations) {
            let inputs = Inputs::from_unit(&point);
            let value = robustness(formula, &inputs)?;
            run.evaluations += 1;
            run.best_robustness = run.best_robustness.min(value);
            told.push(value);
            if value < 0.0 {
                run.counterexample = Some(Counterexample {
                    throttle: inputs.throttle.to_vec(),
                    brake: inputs.brake.to_vec(),
                    robustness: value,
                    replayed_robustness: replayed_robustness(formula, &inputs)?,
                });
                return Ok(run);
            }
        }
        search.tell(&told);
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_portfolio_falsifies_all_six_whatever_the_number_of_threads() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| benchmark(Method::Auto, 1500, 3).unwrap())
        };
        let result = on(2);
        for row in &result.rows {
            assert_eq!(row.successes, 3, "{}", row.spec);
            let most = match row.spec.as_str() {
                "CC4" => 1500.0,
                "CCx" => 400.0,
                _ => 15.0,
            };
            assert!(row.mean_evaluations.unwrap() <= most, "{}: {:?}", row.spec, row.mean_evaluations);
            for run in &row.runs {
                let found = run.counterexample.as_ref().unwrap();
                assert!((found.robustness - found.replayed_robustness).abs() < 1e-3, "{}: {found:?}", row.spec);
            }
        }
        assert_eq!(result, on(1));
    }
}
