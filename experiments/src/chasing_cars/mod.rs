//! Evaluations that a search method needs to falsify each specification of Chasing Cars.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- chasing_cars 31000 100 [METHOD]        # first seed, seeds
//! ```
//! A counterexample violates its specification by more than a centimetre at the published step of 0.01 s and at a fifth
//! of it, where the cars evaluate their guards five times as often, and an independent replay confirms it: a second
//! implementation of the model and a naive monitor.

mod replay;

use self::replay::{finer_robustness, replayed_robustness};
use crate::ExperimentError;
use crate::falsification::{Problem, print_table};
use crate::work::chasing_cars::{ChasingCarsInputs, PIECES, SPECIFICATIONS, robustness};
use crumple::measure::stl::Formula;
use crumple::search::falsify::UnitCube;

/// Minimum violation of a counterexample, in metres.
const MARGIN_M: f64 = 0.01;

/// Returns the value that the search receives, the larger one of both steps, and whether a replay confirms a violation.
fn evaluate(formula: &Formula, point: &[f64]) -> Result<(f64, bool), ExperimentError> {
    let inputs = ChasingCarsInputs::from_unit(point);
    let mut value = robustness(formula, &inputs)?;
    if value < 0.0 {
        value = value.max(finer_robustness(formula, &inputs)?);
    }
    Ok((
        value,
        value < -MARGIN_M && replayed_robustness(formula, &inputs)? < -MARGIN_M,
    ))
}

fn problems() -> Result<Vec<Problem<'static>>, ExperimentError> {
    SPECIFICATIONS
        .into_iter()
        .map(|(name, text)| {
            let formula: Formula = text.parse()?;
            Ok(Problem {
                name: name.to_owned(),
                cube: UnitCube::new([PIECES, PIECES])?,
                evaluate: Box::new(move |point: &[f64]| evaluate(&formula, point)),
            })
        })
        .collect()
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    print_table(&problems()?, arguments)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsification::mean;
    use crumple::search::falsify::Method;

    fn piecewise_inputs(rows: &[(f64, f64, f64)]) -> ChasingCarsInputs {
        let at = |piece: usize| {
            rows.iter()
                .rfind(|row| row.0 <= 5.0 * piece as f64)
                .unwrap()
        };
        ChasingCarsInputs {
            throttle: std::array::from_fn(|p| at(p).1),
            brake: std::array::from_fn(|p| at(p).2),
        }
    }

    #[test]
    fn published_counterexamples_have_the_published_robustness() {
        let published = [
            (
                "CC1",
                "-3.14",
                piecewise_inputs(&[
                    (0., 1., 0.),
                    (5., 1., 1.),
                    (10., 1., 0.),
                    (15., 0., 0.),
                    (20., 1., 0.),
                ]),
            ),
            (
                "CC2",
                "-5.00",
                piecewise_inputs(&[(0., 0., 1.), (25., 1., 0.)]),
            ),
            (
                "CC3",
                "-25.07",
                piecewise_inputs(&[(0., 0., 1.), (10., 1., 0.)]),
            ),
        ];
        for (name, expected, inputs) in published {
            let (_, text) = SPECIFICATIONS
                .iter()
                .find(|(known, _)| *known == name)
                .unwrap();
            let actual = robustness(&text.parse().unwrap(), &inputs).unwrap();
            assert_eq!(format!("{actual:.2}"), expected, "{name}");
        }
    }

    #[test]
    fn the_portfolio_falsifies_all_six_with_any_number_of_threads() {
        for problem in problems().unwrap() {
            let on = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .unwrap();
                pool.install(|| problem.successes(&Method::Auto, 0, 3).unwrap())
            };
            let actual = on(2);
            let most = match problem.name.as_str() {
                "CC4" => 1500.0,
                "CC5" | "CCx" => 400.0,
                _ => 15.0,
            };
            assert!(
                actual.len() == 3 && mean(&actual) <= most,
                "{}: {actual:?}",
                problem.name
            );
            assert_eq!(actual, on(1));
        }
    }
}
