//! Classic test functions with known optima, and the published performance of methods on them.

use super::{Method, UnitCube};

/// A function of a point of the unit cube, 0 at its global optimum and positive elsewhere.
type TestFunction = fn(&[f64]) -> f64;

fn scale(point: &[f64], low: f64, high: f64) -> impl Iterator<Item = f64> + Clone {
    point.iter().map(move |x| low + x * (high - low))
}

fn sphere(point: &[f64]) -> f64 {
    // Off centre, because some searches start at the centre.
    scale(point, -5.0, 5.0).map(|x| (x - 1.3).powi(2)).sum()
}

fn rosenbrock(point: &[f64]) -> f64 {
    let x = scale(point, -2.0, 3.0);
    x.clone()
        .zip(x.skip(1))
        .map(|(a, b)| 100.0 * (b - a * a).powi(2) + (1.0 - a).powi(2))
        .sum()
}

fn rastrigin(point: &[f64]) -> f64 {
    let term = |x: f64| x * x - 10.0 * (std::f64::consts::TAU * x).cos() + 10.0;
    scale(point, -4.0, 6.0).map(term).sum()
}

fn ackley(point: &[f64]) -> f64 {
    let x = scale(point, -20.0, 44.0);
    let n = point.len() as f64;
    let squares = x.clone().map(|x| x * x).sum::<f64>() / n;
    let clusters = x.map(|x| (std::f64::consts::TAU * x).cos()).sum::<f64>() / n;
    20.0 + std::f64::consts::E - 20.0 * (-0.2 * squares.sqrt()).exp() - clusters.exp()
}

fn himmelblau(point: &[f64]) -> f64 {
    let v: Vec<f64> = scale(point, -5.0, 5.0).collect();
    (v[0] * v[0] + v[1] - 11.0).powi(2) + (v[0] + v[1] * v[1] - 7.0).powi(2)
}

fn branin(point: &[f64]) -> f64 {
    let pi = std::f64::consts::PI;
    let (x, y) = (15.0 * point[0] - 5.0, 15.0 * point[1]);
    let valley = y - 5.1 / (4.0 * pi * pi) * x * x + 5.0 / pi * x - 6.0;
    valley * valley + 10.0 * (1.0 - 1.0 / (8.0 * pi)) * x.cos() + 10.0 - 0.397_887_357_729_738
}

/// Returns the sorted evaluations until a value below `target`, for the seeds 0 to 8; the budget without success.
fn evaluations_to_target(
    method: &Method,
    function: TestFunction,
    dimension: usize,
    target: f64,
    budget: usize,
) -> Vec<usize> {
    let cube = UnitCube::new(vec![1; dimension]).unwrap();
    let run = |seed| {
        let mut search = method.start(&cube, seed);
        let mut count = 0;
        while count < budget {
            let values: Vec<f64> = search.ask().iter().map(|point| function(point)).collect();
            if let Some(first) = values.iter().position(|&value| value < target) {
                return budget.min(count + first + 1);
            }
            count += values.len();
            search.tell(&values);
        }
        budget
    };
    let mut counts: Vec<usize> = (0..9).map(run).collect();
    counts.sort_unstable();
    counts
}

fn median_evaluations(
    method: &Method,
    function: TestFunction,
    dimension: usize,
    target: f64,
    budget: usize,
) -> usize {
    evaluations_to_target(method, function, dimension, target, budget)[4]
}

#[test]
fn cma_es_needs_the_published_order_of_evaluations() {
    // Hansen and Ostermeier (2001) and the BBOB data: about 1500 for the sphere, 6000 for Rosenbrock, in 10 dimensions.
    let sphere = median_evaluations(&Method::CmaEs, sphere, 10, 1e-9, 10_000);
    assert!((1000..2500).contains(&sphere), "sphere: {sphere}");
    let rosenbrock = median_evaluations(&Method::CmaEs, rosenbrock, 10, 1e-9, 30_000);
    assert!(
        (3500..11_000).contains(&rosenbrock),
        "Rosenbrock: {rosenbrock}"
    );
    let ackley = median_evaluations(&Method::CmaEs, ackley, 10, 1e-9, 20_000);
    assert!((2000..6000).contains(&ackley), "Ackley: {ackley}");
}

#[test]
fn restarts_with_growing_populations_solve_rastrigin() {
    let counts = evaluations_to_target(&Method::CmaEs, rastrigin, 5, 1e-6, 60_000);
    assert!(counts[8] < 60_000, "{counts:?}");
}

#[test]
fn cross_entropy_reaches_its_accuracy() {
    for (name, function, dimension, target, budget) in [
        ("sphere", sphere as TestFunction, 5, 1e-3, 6000),
        ("Ackley", ackley, 5, 1e-1, 10_000),
        ("Branin", branin, 2, 1e-3, 6000),
        ("Himmelblau", himmelblau, 2, 1e-2, 6000),
        ("Rastrigin", rastrigin, 2, 1e-2, 10_000),
    ] {
        let reached =
            median_evaluations(&Method::CrossEntropy, function, dimension, target, budget);
        assert!(reached < budget, "{name}");
    }
}

#[test]
fn the_portfolio_beats_uniform_points_on_smooth_functions() {
    for (name, function, dimension, target) in [
        ("sphere", sphere as TestFunction, 5, 1e-1),
        ("Ackley", ackley, 5, 2.0),
        ("Rosenbrock", rosenbrock, 4, 1.0),
        ("Branin", branin, 2, 1e-2),
        ("Himmelblau", himmelblau, 2, 1e-1),
    ] {
        let uniform = median_evaluations(&Method::Uniform, function, dimension, target, 20_000);
        let auto = median_evaluations(&Method::Auto, function, dimension, target, 20_000);
        assert!(2 * auto < uniform, "{name}: {auto} and {uniform}");
    }
}
