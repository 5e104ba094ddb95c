//! Searches: files confirm the summary of a campaign, and frequent failures are found.

use crumple_sim::scenario::NoDriverFiles;
use std::path::Path;

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_measure::Specification;
use crumple_search::falsify::campaign::{Campaign, CampaignSummary, SearchObjective};
use crumple_search::falsify::{FailureCriterion, Method};
use crumple_sim::engine::RunOptions;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{PlantKind, file};
use crumple_spaces::{ScenarioSpace, built_in_space};
use crumple_store::study::Study;
use proptest::prelude::*;
use proptest::sample::{select, subsequence};

use crate::command_line::falsify::assert_same_folders;
use crate::generate::with_cases;

/// Evaluations that find failures in an eighth of a space: uniform random sampling misses them with a probability of
/// 10⁻¹¹.
const SUFFICIENT_BUDGET: u64 = 190;

const LATTICE_POINTS: u32 = 200;

/// Any controller, in some parameters of a built-in space, the others nominal.
fn any_campaign() -> impl Strategy<Value = Campaign> {
    let space = select(vec!["paper", "high-risk"]).prop_flat_map(|name| {
        let spec = built_in_space(name).expect("built in").spec().clone();
        let count = spec.parameters.len();
        subsequence(spec.parameters.clone(), 1..=count).prop_map(move |parameters| {
            let mut spec = spec.clone();
            spec.parameters = parameters;
            ScenarioSpace::new(spec, Path::new("."), &NoDriverFiles)
                .expect("a part of a space is one")
        })
    });
    let controller = select(vec![
        "baseline",
        "match-leader",
        "constant-brake",
        "idm",
        "acc-aeb",
    ]);
    let estimator = prop_oneof![Just(EstimatorKind::Truth), Just(EstimatorKind::Kalman)];
    let aim = select(SearchObjective::ALL.to_vec());
    let method = select(Method::ALL.to_vec());
    (
        space,
        controller,
        estimator,
        aim,
        method,
        1..SUFFICIENT_BUDGET,
        0..u64::MAX >> 1,
    )
        .prop_map(
            |(space, controller, estimator, aim, method, budget, seed)| Campaign {
                estimator,
                seed,
                ..Campaign::new(
                    Controllers::default()
                        .find(controller, Path::new("."))
                        .expect("built in"),
                    space,
                )
                .with_method(method)
                .with_objective(aim)
                .with_budget(budget)
            },
        )
}

fn options(campaign: &Campaign) -> RunOptions {
    RunOptions::new(campaign.controller.source.clone()).with_estimator(campaign.estimator)
}

fn run(campaign: &Campaign, folder: &Path, threads: usize) -> CampaignSummary {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads");
    pool.install(|| {
        campaign
            .run(folder, false, &Quiet)
            .expect("a valid campaign in an empty folder")
    })
}

proptest! {
    #![proptest_config(with_cases(2))]

    /// Every counterexample is a file that fails as reported, original and shrunk, and its evaluation is within a
    /// method's budget.
    #[test]
    fn found_failures_are_reproduced(campaign in any_campaign()) {
        let folder = tempfile::tempdir().unwrap();
        let summary = run(&campaign, folder.path(), 2);
        for method in &summary.methods {
            prop_assert_eq!(method.evaluations, campaign.search.budget);
            prop_assert!(method.first_falsification.is_none_or(|first| (1..=campaign.search.budget).contains(&first)));
            prop_assert_eq!(method.failures > 0, method.first_falsification.is_some());
            prop_assert_eq!(method.failures > 0, method.best_robustness.is_some_and(|best| best < 0.0));
        }
        prop_assert_eq!(summary.falsified, summary.methods.iter().any(|method| method.failures > 0));
        prop_assert_eq!(summary.falsified, !summary.counterexamples.is_empty());
        let best = summary.methods.iter().filter_map(|method| method.best_robustness).fold(f64::INFINITY, f64::min);
        for counterexample in &summary.counterexamples {
            let evaluated = |name: &str| {
                let scenario = file::load(&folder.path().join(name), &NoDriverFiles).unwrap();
                campaign.specification.evaluate_scenario(&scenario, options(&campaign)).unwrap()
            };
            let (shrunk, original) = (evaluated(&counterexample.file), evaluated(&counterexample.original_file));
            prop_assert!(shrunk.is_violation() && original.is_violation());
            prop_assert_eq!(shrunk.robustness, counterexample.robustness);
            // Files store positions to a billionth of a metre.
            prop_assert!(original.robustness >= best - 1e-6, "{} is worse than all", counterexample.original_file);
            prop_assert!(counterexample.found_at <= campaign.search.budget);
            let original_file = folder.path().join(&counterexample.file);
            let original_scenario = file::load(&original_file, &NoDriverFiles).unwrap();
            let multi_body = original_scenario.with_plant(PlantKind::MultiBody);
            let replay = campaign.specification.evaluate_scenario(&multi_body.unwrap(), options(&campaign));
            prop_assert_eq!(counterexample.survives_multi_body, replay.ok().map(|verdict| verdict.is_violation()));
            // The file of an escape avoids the collision, without a vehicle under test.
            let is_avoidable = counterexample.avoidability.is_avoidable() == Some(true);
            prop_assert_eq!(counterexample.escape_file.is_some(), is_avoidable);
            if let Some(escape) = &counterexample.escape_file {
                let scenario = file::load(&folder.path().join(escape), &NoDriverFiles).unwrap();
                let verdict = Specification::NoCollision.evaluate_scenario(&scenario, options(&campaign)).unwrap();
                prop_assert!(verdict.collision.is_none() && !scenario.has_vehicle_under_test(), "{}", escape);
            }
        }
    }

    /// The counterexample fails alone, and another controller passes it.
    #[test]
    fn failures_relative_to_another_run_fail_alone(campaign in any_campaign()) {
        let other = Controllers::default().find("shield:idm", Path::new(".")).unwrap();
        let criterion = FailureCriterion::Differential(other.clone());
        let campaign = Campaign { failure_criterion: Some(criterion), ..campaign };
        let folder = tempfile::tempdir().unwrap();
        let summary = run(&campaign, folder.path(), 2);
        for counterexample in &summary.counterexamples {
            let scenario = file::load(&folder.path().join(&counterexample.file), &NoDriverFiles).unwrap();
            let evaluated = |options| campaign.specification.evaluate_scenario(&scenario, options).unwrap();
            let own = evaluated(options(&campaign));
            let beside = evaluated(RunOptions::new(other.source.clone()).with_estimator(campaign.estimator));
            prop_assert!(own.is_violation() && beside.robustness > 0.0, "{:?} {:?}", own, beside);
            prop_assert!((counterexample.robustness - own.robustness.max(-beside.robustness)).abs() < 1e-6);
        }
    }

    /// With any number of threads.
    #[test]
    fn one_seed_decides_everything(campaign in any_campaign()) {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        prop_assert_eq!(run(&campaign, one.path(), 1), run(&campaign, other.path(), 3));
        assert_same_folders(one.path(), other.path());
    }

    /// Every method finds a failure if an eighth of a lattice fails, and uniform points fail as often as the lattice.
    #[test]
    fn frequent_failures_are_found(campaign in any_campaign()) {
        let campaign = campaign.with_budget(SUFFICIENT_BUDGET);
        let space = campaign.space.clone().with_noise_seed(campaign.seed);
        let fails = |index: u32| {
            // Square roots of non-squares give evenly distributed points.
            let coordinate = |k| (f64::from(index) * f64::from(4 * k + 3).sqrt()).fract();
            let point: Vec<f64> = (0..space.dimension() as u32).map(coordinate).collect();
            let scenario = space.scenario_at(&point).unwrap();
            campaign.specification.evaluate_scenario(&scenario, options(&campaign)).unwrap().is_violation()
        };
        let share = (0..LATTICE_POINTS).filter(|&index| fails(index)).count() as f64 / f64::from(LATTICE_POINTS);
        let folder = tempfile::tempdir().unwrap();
        let summary = run(&campaign, folder.path(), 2);
        let asked_for = &summary.methods[0];
        prop_assert!(share < 0.125 || asked_for.failures > 0, "{} finds none where {share} fail", asked_for.method);
        let uniform = summary.methods.iter().find(|method| method.method == Method::Uniform.name()).unwrap();
        let uniform_share = uniform.failures as f64 / SUFFICIENT_BUDGET as f64;
        let difference = (uniform_share - share).abs();
        prop_assert!(difference < 0.25, "{uniform_share} of uniform points and {share} of a lattice fail");
    }
}
