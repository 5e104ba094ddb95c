//! Number of evaluations that a method needs to falsify each specification.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    ChasingCarsError, ChasingCarsInputs, MARGIN_M, PIECES, SPECIFICATIONS, finer_robustness, replayed_robustness,
    robustness,
};
use crate::falsify::{Method, UnitCube};
use crumple_world::measure::stl::Formula;

/// Results of a method on the six specifications.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Benchmark {
    /// Name of the method.
    pub method: String,
    /// Maximum number of evaluations of a run.
    pub budget: usize,
    /// Minimum violation of a counterexample at both steps, in metres.
    pub margin_m: f64,
    /// One row per specification.
    pub rows: Vec<BenchmarkRow>,
}

/// Results of one specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BenchmarkRow {
    /// Name of the specification.
    pub spec: String,
    /// Formula of the specification; published ones differ.
    pub formula: String,
    /// Number of runs with a counterexample that the replay confirmed.
    pub successes: usize,
    /// Number of runs.
    pub seeds: usize,
    /// Mean number of evaluations to the first counterexample, over the successful runs; `None` without success.
    pub mean_evaluations: Option<f64>,
    /// Runs by seed.
    pub runs: Vec<BenchmarkRun>,
}

/// Result of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BenchmarkRun {
    /// Seed of the run.
    pub seed: u64,
    /// Evaluated inputs, including the first counterexample.
    pub evaluations: usize,
    /// Number of them that violated the specification and were also simulated at the finer step.
    pub finer_simulations: usize,
    /// Smallest robustness found, as the larger value of the two steps.
    pub best_robustness: f64,
    /// Counterexample, if found.
    pub counterexample: Option<FalsifyingInputs>,
}

/// Inputs that violate a specification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FalsifyingInputs {
    /// Throttle of each 5 s.
    pub throttle: Vec<f64>,
    /// Brake of each 5 s.
    pub brake: Vec<f64>,
    /// Robustness by the model and monitor of the search.
    pub robustness: f64,
    /// Robustness by the independent replay, with its own monitor.
    pub replayed_robustness: f64,
    /// Robustness by the independent replay at a fifth of the step.
    pub finer_robustness: f64,
}

impl BenchmarkRun {
    /// Returns true if the replay confirmed a counterexample.
    #[must_use]
    pub fn is_success(&self) -> bool {
        let is_violated = |robustness: f64| robustness < -MARGIN_M;
        self.counterexample
            .as_ref()
            .is_some_and(|found| is_violated(found.replayed_robustness) && is_violated(found.finer_robustness))
    }
}

/// Runs `method` on every specification with `seeds` seeds from `first_seed` on, each until its first counterexample.
///
/// # Errors
/// [`ChasingCarsError`] if a specification does not fit the model.
pub fn run_benchmark(
    method: &Method,
    budget: usize,
    first_seed: u64,
    seeds: usize,
) -> Result<Benchmark, ChasingCarsError> {
    let row = |(name, text): (&str, &str)| -> Result<BenchmarkRow, ChasingCarsError> {
        let formula: Formula = text.parse()?;
        let runs: Vec<BenchmarkRun> = (0..seeds as u64)
            .into_par_iter()
            .map(|place| run_search(method, &formula, budget, first_seed.wrapping_add(place)))
            .collect::<Result<_, _>>()?;
        let successes: Vec<f64> =
            runs.iter().filter(|run| run.is_success()).map(|run| run.evaluations as f64).collect();
        let mean = successes.iter().sum::<f64>() / successes.len() as f64;
        Ok(BenchmarkRow {
            spec: name.to_owned(),
            formula: text.to_owned(),
            successes: successes.len(),
            seeds,
            mean_evaluations: Some(mean).filter(|mean| mean.is_finite()),
            runs,
        })
    };
    let rows = SPECIFICATIONS.into_iter().map(row).collect::<Result<_, _>>()?;
    Ok(Benchmark { method: method.name().to_owned(), budget, margin_m: MARGIN_M, rows })
}

/// Runs one search until the first counterexample. It receives the larger robustness of the two steps.
fn run_search(method: &Method, formula: &Formula, budget: usize, seed: u64) -> Result<BenchmarkRun, ChasingCarsError> {
    let mut run = BenchmarkRun {
        seed,
        evaluations: 0,
        finer_simulations: 0,
        best_robustness: f64::INFINITY,
        counterexample: None,
    };
    let Ok(cube) = UnitCube::new([PIECES, PIECES]) else { return Ok(run) };
    let mut search = method.start(&cube, seed);
    while run.evaluations < budget {
        let mut costs = Vec::new();
        for point in search.ask().into_iter().take(budget - run.evaluations) {
            let inputs = ChasingCarsInputs::from_unit(&point);
            let robustness = robustness(formula, &inputs)?;
            run.evaluations += 1;
            let mut value = robustness;
            if robustness < 0.0 {
                run.finer_simulations += 1;
                let finer_robustness = finer_robustness(formula, &inputs)?;
                value = robustness.max(finer_robustness);
                if value < -MARGIN_M {
                    run.best_robustness = run.best_robustness.min(value);
                    run.counterexample = Some(FalsifyingInputs {
                        throttle: inputs.throttle.to_vec(),
                        brake: inputs.brake.to_vec(),
                        robustness,
                        replayed_robustness: replayed_robustness(formula, &inputs)?,
                        finer_robustness,
                    });
                    return Ok(run);
                }
            }
            run.best_robustness = run.best_robustness.min(value);
            costs.push(value);
        }
        search.tell(&costs);
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_portfolio_falsifies_all_six_with_any_number_of_threads() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run_benchmark(&Method::Auto, 1500, 0, 3).unwrap())
        };
        let result = on(2);
        for row in &result.rows {
            assert_eq!(row.successes, 3, "{}", row.spec);
            let most = match row.spec.as_str() {
                "CC4" => 1500.0,
                "CC5" | "CCx" => 400.0,
                _ => 15.0,
            };
            assert!(row.mean_evaluations.unwrap() <= most, "{}: {:?}", row.spec, row.mean_evaluations);
            for run in &row.runs {
                let found = run.counterexample.as_ref().unwrap();
                assert!((found.robustness - found.replayed_robustness).abs() < 1e-3, "{}: {found:?}", row.spec);
                assert!(found.robustness.max(found.finer_robustness) < -MARGIN_M, "{}: {found:?}", row.spec);
            }
        }
        assert_eq!(result, on(1));
    }
}
