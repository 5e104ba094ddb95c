//! Compares `auto` with the methods it consists of, in eight built-in scenario spaces, over several seeds, with a test
//! of chance.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- search_comparison 1000 5        # evaluations of each method, seeds
//! ```
//! Each space is searched with a controller that seldom fails in it. Measures are the evaluations to the first failure,
//! the smallest robustness, and the number of kinds of failures. `p` is the p-value of the exact one-sided permutation
//! test that `auto` is worse than the best other method; it is omitted if the mean of `auto` is not worse.

use crumple_controllers::Controllers;
use std::path::Path;

use crate::ExperimentError;
use crumple::search::falsify::Method;
use crumple::search::falsify::campaign::CampaignSummary;
use crumple::spaces::built_in_space;
use crumple::{Campaign, Quiet, Study};

/// Built-in scenario spaces, each with a controller that seldom fails in it.
const PROBLEMS: [(&str, &str); 8] = [
    ("paper", "match-leader"),
    ("high-risk", "retrained"),
    ("traffic", "baseline"),
    ("standing", "idm"),
    ("slower", "idm"),
    ("alone", "policy"),
    ("assisted", "retrained"),
    ("steady", "policy"),
];

const METHODS: [Method; 4] = [Method::Auto, Method::CmaEs, Method::Uniform, Method::Halton];

const MEASURES: [(&str, bool); 3] = [
    ("evaluations to the first failure", false),
    ("smallest robustness", false),
    ("kinds of failures", true),
];

/// Returns the results of a method with one seed, in the order of [`MEASURES`].
fn method_measures(summary: &CampaignSummary, method: &Method, budget: u64) -> Option<[f64; 3]> {
    let name = method.name();
    let of_method = summary
        .methods
        .iter()
        .find(|summary| summary.method == name)?;
    let kinds = summary
        .failures
        .iter()
        .filter(|kind| kind.by_method.iter().any(|by| by.method == name))
        .count();
    // No failure within the budget counts as one evaluation more.
    let first = of_method.first_falsification.unwrap_or(budget + 1);
    Some([first as f64, of_method.best_robustness?, kinds as f64])
}

/// Returns the share of permutations in which the first mean exceeds the second by at least as much.
fn permutation_p_value(above: &[f64], below: &[f64]) -> f64 {
    let all = [above, below].concat();
    let total: f64 = all.iter().sum();
    let observed: f64 = above.iter().sum();
    let mut permutations = 0_u32;
    let mut as_extreme = 0_u32;
    for chosen in
        (0..1_u32 << all.len()).filter(|chosen| chosen.count_ones() as usize == above.len())
    {
        let sum: f64 = (0..all.len())
            .filter(|i| chosen >> i & 1 == 1)
            .map(|i| all[i])
            .sum();
        permutations += 1;
        as_extreme += u32::from(sum >= observed - 1e-12 * total.abs());
    }
    f64::from(as_extreme) / f64::from(permutations)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut arguments = arguments.iter();
    let budget: u64 = arguments.next().ok_or("how many evaluations?")?.parse()?;
    let seeds: u64 = arguments.next().ok_or("how many seeds?")?.parse()?;
    if !(1..=10).contains(&seeds) {
        return Err("1 to 10 seeds: the test of chance deals them out in all ways".into());
    }
    let names = METHODS.each_ref().map(Method::name).join(" | ");
    println!("| space | controller | measure (mean of {seeds} seeds) | {names} | p |");
    println!("|---|---|---|{}---|", "---|".repeat(METHODS.len()));
    for (space, controller) in PROBLEMS {
        let results = compare_methods(space, controller, budget, seeds)?;
        for (measure, (name, more_is_better)) in MEASURES.into_iter().enumerate() {
            let of_methods = results.each_ref().map(|of_method| &of_method[measure]);
            let means = of_methods.map(|values| format!("{:.1}", mean(values)));
            println!(
                "| {space} | {controller} | {name} | {} | {} |",
                means.join(" | "),
                describe_p_value(of_methods, more_is_better)?
            );
        }
    }
    Ok(())
}

/// For each method and measure, the results with each seed.
type MethodResults = [[Vec<f64>; 3]; METHODS.len()];

fn compare_methods(
    space: &str,
    controller: &str,
    budget: u64,
    seeds: u64,
) -> Result<MethodResults, ExperimentError> {
    let mut results = MethodResults::default();
    for seed in 0..seeds {
        // Both campaigns also run `uniform` and `halton`, as reference searches.
        let with_auto = run_campaign(space, controller, Method::Auto, budget, seed)?;
        let with_cma_es = run_campaign(space, controller, Method::CmaEs, budget, seed)?;
        for (method, of_method) in METHODS.iter().zip(&mut results) {
            let summary = if *method == Method::CmaEs {
                &with_cma_es
            } else {
                &with_auto
            };
            let measures =
                method_measures(summary, method, budget).ok_or("a method that was not run")?;
            for (values, value) in of_method.iter_mut().zip(measures) {
                values.push(value);
            }
        }
    }
    Ok(results)
}

/// Returns the p value if the first method is worse than the best of the others, otherwise nothing.
fn describe_p_value(
    of_methods: [&Vec<f64>; METHODS.len()],
    more_is_better: bool,
) -> Result<String, ExperimentError> {
    // Change signs so that smaller is better.
    let sign = if more_is_better { -1.0 } else { 1.0 };
    let signed: [Vec<f64>; METHODS.len()] =
        of_methods.map(|values| values.iter().map(|value| sign * value).collect());
    let best = signed[1..]
        .iter()
        .min_by(|a, b| mean(a).total_cmp(&mean(b)))
        .ok_or("no other method")?;
    Ok(if mean(&signed[0]) > mean(best) {
        format!("{:.3}", permutation_p_value(&signed[0], best))
    } else {
        String::new()
    })
}

fn run_campaign(
    space: &str,
    controller: &str,
    method: Method,
    budget: u64,
    seed: u64,
) -> Result<CampaignSummary, ExperimentError> {
    let campaign = Campaign {
        seed,
        ..Campaign::new(
            Controllers::default().find(controller, Path::new("."))?,
            built_in_space(space).ok_or("not built in")?,
        )
        .with_method(method)
        .with_budget(budget)
    };
    let folder = tempfile::tempdir()?;
    Ok(campaign.run(folder.path(), false, &Quiet)?)
}
