//! Evaluations that a search method needs to falsify each specification of Chasing Cars.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- chasing_cars 31000 100 [METHOD]        # first seed, seeds
//! ```
//! A counterexample violates its specification by more than a centimetre at the published step of 0.01 s and at a fifth
//! of it, where the cars evaluate their guards five times as often, and an independent replay confirms it: a second
//! implementation of the model and a naive monitor.

mod replay;

use rayon::prelude::*;

use self::replay::{finer_robustness, replayed_robustness};
use crate::ExperimentError;
use crate::work::chasing_cars::{ChasingCarsInputs, PIECES, SPECIFICATIONS, robustness};
use crumple::Method;
use crumple::search::falsify::UnitCube;
use crumple::world::measure::stl::Formula;

/// Maximum number of evaluations of a search.
const BUDGET: usize = 1500;
/// Minimum violation of a counterexample, in metres.
const MARGIN_M: f64 = 0.01;

/// Returns the evaluations to the first counterexample; `None` within the budget, or if the replay does not confirm it.
fn evaluations_to_counterexample(
    method: &Method,
    formula: &Formula,
    seed: u64,
) -> Result<Option<usize>, ExperimentError> {
    let mut search = method.start(&UnitCube::new([PIECES, PIECES])?, seed);
    let mut evaluations = 0;
    while evaluations < BUDGET {
        let mut costs = Vec::new();
        for point in search.ask().into_iter().take(BUDGET - evaluations) {
            let inputs = ChasingCarsInputs::from_unit(&point);
            let mut value = robustness(formula, &inputs)?;
            evaluations += 1;
            if value < 0.0 {
                // The search receives the larger value of the two steps.
                value = value.max(finer_robustness(formula, &inputs)?);
                if value < -MARGIN_M {
                    return Ok((replayed_robustness(formula, &inputs)? < -MARGIN_M).then_some(evaluations));
                }
            }
            costs.push(value);
        }
        search.tell(&costs);
    }
    Ok(None)
}

/// Returns the evaluations of the successful searches with successive seeds.
fn successful_evaluations(
    method: &Method,
    specification: &str,
    first_seed: u64,
    seeds: u64,
) -> Result<Vec<usize>, ExperimentError> {
    let formula: Formula = specification.parse()?;
    let run = |seed| evaluations_to_counterexample(method, &formula, seed).transpose();
    (first_seed..first_seed + seeds).into_par_iter().filter_map(run).collect()
}

fn mean(evaluations: &[usize]) -> f64 {
    evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut arguments = arguments.iter();
    let first_seed: u64 = arguments.next().ok_or("which first seed?")?.parse()?;
    let seeds: u64 = arguments.next().ok_or("how many seeds?")?.parse()?;
    let method: Method = arguments.next().map_or("auto", String::as_str).parse()?;
    for (name, specification) in SPECIFICATIONS {
        let found = successful_evaluations(&method, specification, first_seed, seeds)?;
        let (successes, mean) = (found.len(), mean(&found));
        println!("{name} {successes} of {seeds}: {mean:.1} evaluations to the first that holds at both steps");
        println!("  {specification}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piecewise_inputs(rows: &[(f64, f64, f64)]) -> ChasingCarsInputs {
        let at = |piece: usize| rows.iter().rfind(|row| row.0 <= 5.0 * piece as f64).unwrap();
        ChasingCarsInputs { throttle: std::array::from_fn(|p| at(p).1), brake: std::array::from_fn(|p| at(p).2) }
    }

    #[test]
    fn published_counterexamples_have_the_published_robustness() {
        let published = [
            (
                "CC1",
                "-3.14",
                piecewise_inputs(&[(0., 1., 0.), (5., 1., 1.), (10., 1., 0.), (15., 0., 0.), (20., 1., 0.)]),
            ),
            ("CC2", "-5.00", piecewise_inputs(&[(0., 0., 1.), (25., 1., 0.)])),
            ("CC3", "-25.07", piecewise_inputs(&[(0., 0., 1.), (10., 1., 0.)])),
        ];
        for (name, expected, inputs) in published {
            let (_, text) = SPECIFICATIONS.iter().find(|(known, _)| *known == name).unwrap();
            let found = robustness(&text.parse().unwrap(), &inputs).unwrap();
            assert_eq!(format!("{found:.2}"), expected, "{name}");
        }
    }

    #[test]
    fn the_portfolio_falsifies_all_six_with_any_number_of_threads() {
        for (name, specification) in SPECIFICATIONS {
            let on = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| successful_evaluations(&Method::Auto, specification, 0, 3).unwrap())
            };
            let found = on(2);
            let most = match name {
                "CC4" => 1500.0,
                "CC5" | "CCx" => 400.0,
                _ => 15.0,
            };
            assert!(found.len() == 3 && mean(&found) <= most, "{name}: {found:?}");
            assert_eq!(found, on(1));
        }
    }
}
