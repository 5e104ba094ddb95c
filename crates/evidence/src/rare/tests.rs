//! Problems with a known probability.

use std::f64::consts::SQRT_2;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::splitting::{LimitState, RandomInputs};
use super::*;
use crate::fixtures::{count_all, rare_plan};
use crate::{RateConfig, RatePlan};
use crumple_core::observer::{ProgressCounter, Quiet, Stopped};
use crumple_world::observation::EstimatorKind;
use crumple_world::random::Stream;

struct ClosedFormLimitState {
    dimension: usize,
    margin: fn(&RandomInputs) -> f64,
}

impl LimitState for ClosedFormLimitState {
    type Error = Stopped;

    fn dimension(&self) -> usize {
        self.dimension
    }

    fn margins(&self, states: &[RandomInputs]) -> Result<Vec<f64>, Stopped> {
        Ok(states.iter().map(self.margin).collect())
    }
}

fn counter() -> ProgressCounter<'static> {
    ProgressCounter::new(&Quiet, None)
}

fn estimate(problem: &ClosedFormLimitState, seed: u64) -> RareEstimate {
    estimate_by(RareMethod::Splitting, problem, seed)
}

fn estimate_by(method: RareMethod, problem: &ClosedFormLimitState, seed: u64) -> RareEstimate {
    let pilot = Pilot::run(problem, method, SplittingConfig::default(), seed, &counter()).unwrap();
    pilot.estimate(problem, &counter()).unwrap()
}

fn upper_tail(x: f64) -> f64 {
    0.5 * libm::erfc(x / SQRT_2)
}

fn coordinate(state: &RandomInputs, index: usize) -> f64 {
    state.normal.get(index).copied().unwrap_or(0.0)
}

fn linear(state: &RandomInputs) -> f64 {
    5.0 - state.normal.iter().sum::<f64>() / (state.normal.len() as f64).sqrt()
}

fn sphere(state: &RandomInputs) -> f64 {
    45.0 - state.normal.iter().map(|x| x * x).sum::<f64>()
}

fn either_side(state: &RandomInputs) -> f64 {
    5.0 - state.normal.first().map_or(0.0, |x| x.abs())
}

fn noisy(state: &RandomInputs) -> f64 {
    let noise: f64 = StandardNormal.sample(&mut Stream::seed_from_u64(state.noise_seed));
    4.9 - (0.75_f64.sqrt() * coordinate(state, 0) + 0.5 * noise)
}

fn corner(state: &RandomInputs) -> f64 {
    (3.2 - coordinate(state, 0)).max(3.5 - coordinate(state, 1))
}

fn frequent(state: &RandomInputs) -> f64 {
    2.326_347_874_040_841 - coordinate(state, 0)
}

/// Estimates with 24 seeds. Checks the ratios to the truth, their mean, the number of intervals that contain the truth,
/// and the number of runs.
fn assert_close(
    method: RareMethod,
    (name, problem, truth): &(&str, ClosedFormLimitState, f64),
    (within, bias, min_held): (f64, f64, usize),
    max_runs: u64,
) {
    const SEEDS: u64 = 24;
    let found: Vec<RareEstimate> = (0..SEEDS).map(|seed| estimate_by(method, problem, seed)).collect();
    let ratios: Vec<f64> = found.iter().map(|one| one.probability.unwrap() / truth).collect();
    let held = found.iter().filter(|one| {
        let [low, high] = one.interval_95.unwrap();
        (low..=high).contains(truth)
    });
    let (held, mean) = (held.count(), ratios.iter().sum::<f64>() / SEEDS as f64);
    let most = found.iter().map(|one| one.evaluations).max().unwrap();
    let spread = found.iter().filter_map(|one| one.coefficient_of_variation).fold(0.0, f64::max);
    println!(
        "{name} by {method:?}: truth {truth:.3e}, mean {mean:.3}, {held} of {SEEDS} held, {most} runs, spread \
         {spread:.3}, ratios {ratios:.2?}"
    );
    assert!(ratios.iter().all(|ratio| (1.0 / within..within).contains(ratio)), "{name}: {ratios:?}");
    assert!((mean - 1.0).abs() < bias, "{name}: {mean}");
    assert!(held >= min_held, "{name}: {held} of {SEEDS}");
    assert!(most < max_runs, "{name}: {most}");
}

fn known_problems() -> [(&'static str, ClosedFormLimitState, f64); 4] {
    [
        ("linear", ClosedFormLimitState { dimension: 10, margin: linear }, upper_tail(5.0)),
        (
            "sphere",
            ClosedFormLimitState { dimension: 6, margin: sphere },
            1.0 - ChiSquared::new(6.0).unwrap().cdf(45.0),
        ),
        ("either side", ClosedFormLimitState { dimension: 3, margin: either_side }, 2.0 * upper_tail(5.0)),
        ("noisy", ClosedFormLimitState { dimension: 2, margin: noisy }, upper_tail(4.9)),
    ]
}

/// Each estimate is within a factor of two, nearly all intervals contain the truth, and the mean over the seeds has an
/// error below a tenth.
#[test]
fn known_probabilities_below_a_millionth_are_found() {
    for problem in known_problems() {
        assert!(problem.2 < 1e-6);
        assert_close(RareMethod::Splitting, &problem, (2.0, 0.1, 20), 600_000);
    }
}

/// Tests that only `.ci/run` runs.
mod tier_2 {
    use super::*;

    /// Importance sampling needs a quarter of the runs, with a fifth of the spread; it also handles frequent failures
    /// and many dimensions. With noise it is no better than splitting: the best distribution that ignores the noise has
    /// a coefficient of variation of 27 per sample, and intervals contain the truth less often than stated.
    #[test]
    #[ignore = "tier 2: 168 estimates"]
    fn known_probabilities_are_found_by_weighted_draws() {
        let more = [
            ("corner", ClosedFormLimitState { dimension: 8, margin: corner }, upper_tail(3.2) * upper_tail(3.5)),
            ("thirty numbers", ClosedFormLimitState { dimension: 30, margin: linear }, upper_tail(5.0)),
            ("frequent", ClosedFormLimitState { dimension: 5, margin: frequent }, 0.01),
        ];
        for problem in known_problems().into_iter().chain(more) {
            let tolerances = if problem.0 == "noisy" { (3.0, 0.2, 18) } else { (1.25, 0.03, 20) };
            assert_close(RareMethod::Importance, &problem, tolerances, 120_000);
        }
    }

    /// With noise, intervals of importance sampling contain the truth far less often than stated, mostly without a
    /// large weight. The command line states these figures with every filtered estimate.
    #[test]
    #[ignore = "tier 2: 400 estimates"]
    fn where_noise_decides_weighted_draws_have_intervals_that_are_too_narrow() {
        const SEEDS: u64 = 400;
        let (problem, truth) = (ClosedFormLimitState { dimension: 2, margin: noisy }, upper_tail(4.9));
        let (mut held, mut light, mut light_held, mut sum) = (0, 0, 0, 0.0);
        for seed in 0..SEEDS {
            let found = estimate_by(RareMethod::Importance, &problem, seed);
            let [low, high] = found.interval_95.unwrap();
            let (holds, is_light) = ((low..=high).contains(&truth), found.largest_weight.unwrap() <= 0.1);
            held += u64::from(holds);
            light += u64::from(is_light);
            light_held += u64::from(is_light && holds);
            sum += found.probability.unwrap() / truth;
        }
        let mean = sum / SEEDS as f64;
        println!("{held} of {SEEDS}; of {light} in which no run weighs much {light_held}; mean {mean:.3}");
        assert!((mean - 1.0).abs() < 0.1, "unbiased all the same: {mean}");
        assert!((260..320).contains(&held) && 2 * light_held < light, "{held}, {light_held} of {light}");
    }
}

#[test]
fn the_interval_of_weighted_draws_is_never_that_of_a_count() {
    type Margin = fn(&RandomInputs) -> f64;
    let problems: [(Margin, f64); 3] = [
        (|state| 0.5 - coordinate(state, 0), 0.5),
        (|state| 1.3 - coordinate(state, 0), 1.3),
        (|state| 1.8 - coordinate(state, 0), 1.8),
    ];
    for (margin, at) in problems {
        let problem = ClosedFormLimitState { dimension: 2, margin };
        let [weighed, split] = [RareMethod::Importance, RareMethod::Splitting].map(|by| estimate_by(by, &problem, 1));
        let spread = weighed.coefficient_of_variation.unwrap();
        let of_spread =
            splitting::lognormal_interval(weighed.probability.unwrap(), spread, weighed.repetitions.len(), 0.95);
        assert_eq!((weighed.interval_95, weighed.interval(0.95)), (of_spread, of_spread), "{at}");
        for found in [weighed, split] {
            let [low, high] = found.interval_95.unwrap();
            assert!((low..=high).contains(&upper_tail(at)), "{at}: {low} to {high}, {} levels", found.levels.len());
        }
    }
}

/// Weights of a nearly certain failure may have a mean above 1; the probability is limited.
#[test]
fn no_probability_is_above_one() {
    let nearly_always = |state: &RandomInputs| -3.0 - coordinate(state, 0);
    let mut above = 0;
    for seed in 0..12 {
        let found =
            estimate_by(RareMethod::Importance, &ClosedFormLimitState { dimension: 3, margin: nearly_always }, seed);
        let raw = found.repetitions.iter().sum::<f64>() / found.repetitions.len() as f64;
        above += usize::from(raw > 1.0);
        assert_eq!(found.probability, Some(raw.min(1.0)));
        for confidence in [0.5, 0.95] {
            let [low, high] = found.interval(confidence).unwrap();
            assert!(0.0 < low && low < high && high <= 1.0, "{low} to {high}, mean {raw}");
        }
        assert!(found.levels.iter().all(|level| level.probability <= 1.0 && level.share <= 1.0));
    }
    assert!(above > 0);
}

#[test]
fn the_number_of_threads_changes_nothing_and_the_seed_does() {
    let problem = ClosedFormLimitState { dimension: 4, margin: linear };
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| estimate(&problem, 3))
    };
    assert_eq!(with(1), with(3));
    assert_ne!(with(1).probability, estimate(&problem, 4).probability);
}

#[test]
fn levels_multiply_to_the_estimate_and_end_at_the_failure() {
    let found = estimate(&ClosedFormLimitState { dimension: 4, margin: linear }, 1);
    let last = found.levels.last().unwrap();
    assert_eq!((last.margin, Some(last.probability)), (0.0, found.probability));
    for pair in found.levels.windows(2) {
        assert!(pair[0].margin > pair[1].margin && pair[0].probability > pair[1].probability);
    }
    assert_eq!(found.repetitions.len(), SplittingConfig::default().repetitions);
}

/// Margins lead a small population away from the failures; a larger pilot finds them, without bias. The runs of all
/// pilots count, and their samples if nothing else is known.
#[test]
fn where_a_pilot_is_led_astray_a_larger_one_is_not() {
    // A wide valley ends above 0; the narrow way to the failures has larger margins at first.
    let astray = |state: &RandomInputs| {
        let at = |index: usize| coordinate(state, index);
        let (valley, way) = (0.5 + (2.0 - at(0)).max(0.0), 3.1 - at(1));
        valley.min(if way < 0.0 { way } else { way + 1.0 })
    };
    let (problem, truth) = (ClosedFormLimitState { dimension: 2, margin: astray }, upper_tail(3.1));
    let effort = SplittingConfig { samples: 100, repetitions: 10 };
    let (mut found, mut again) = (Vec::new(), 0);
    for seed in 0..200 {
        let first = SplittingLevels::run_pilot(&problem, effort, seed, 0, &counter()).unwrap();
        again += usize::from(!first.reaches_failure());
        let pilot = Pilot::run(&problem, RareMethod::Splitting, effort, seed, &counter()).unwrap();
        let estimate = pilot.estimate(&problem, &counter()).unwrap();
        assert_eq!(estimate.independent_runs, 1100);
        found.push(estimate.probability.unwrap() / truth);
    }
    let mean = found.iter().sum::<f64>() / found.len() as f64;
    println!("{again} went on, mean {mean:.3}");
    assert!(again >= 10 && (mean - 1.0).abs() < 0.15, "{again} went on, mean {mean:.3}");
    let never = Pilot::run(
        &ClosedFormLimitState { dimension: 2, margin: |_| 1.0 },
        RareMethod::Splitting,
        effort,
        0,
        &counter(),
    )
    .unwrap();
    let nothing = never.estimate(&problem, &counter()).unwrap();
    assert_eq!((nothing.probability, nothing.independent_runs, nothing.evaluations), (None, 700, 700));
}

#[test]
fn without_a_failure_there_is_no_probability() {
    let never = [
        |state: &RandomInputs| 1.0 + state.normal.iter().sum::<f64>().exp(),
        |_: &RandomInputs| 1.0,
        |_: &RandomInputs| f64::NAN,
    ];
    for margin in never {
        let found = estimate(&ClosedFormLimitState { dimension: 2, margin }, 0);
        assert_eq!((found.probability, found.interval_95), (None, None));
        assert!(found.levels.iter().all(|level| level.margin > 0.0));
    }
    let always = estimate(&ClosedFormLimitState { dimension: 2, margin: |_| -1.0 }, 0);
    assert_eq!((always.probability, always.coefficient_of_variation), (Some(1.0), Some(0.0)));
}

#[test]
fn splitting_agrees_with_counting_on_the_road() {
    const COUNTED: u64 = 6000;
    let estimator = EstimatorKind::Kalman;
    let effort = SplittingConfig { samples: 200, repetitions: 10 };
    let plan = RarePlan { estimator, effort, ..rare_plan(RareMethod::Splitting, 5, 10) };
    let count = RateConfig { seed: 1, ..RateConfig::new(plan.controller.clone(), plan.space.clone(), COUNTED) };
    let counted = count_all(&RatePlan::new(count).unwrap()).failures as f64 / COUNTED as f64;
    let root = tempfile::tempdir().unwrap();
    let mut folder = plan.open_folder(root.path(), false).unwrap();
    let pilot = folder.run_pilot(&plan, &Quiet).unwrap();
    let report = folder.estimate(&plan, &pilot, 0, &Quiet).unwrap();
    let (climbed, variation) =
        (report.estimate.probability.unwrap(), report.estimate.coefficient_of_variation.unwrap());
    assert!((0.004..0.02).contains(&counted), "{counted}");
    assert!(report.estimate.levels.len() > 1 && variation < 0.2, "{report:?}");
    let deviation = (counted / COUNTED as f64 + (climbed * variation).powi(2)).sqrt();
    assert!((climbed - counted).abs() < 4.0 * deviation, "{climbed} and {counted}, deviation {deviation}");
}

#[test]
fn levels_are_read_as_they_are_and_were_written() {
    let level = |named: &str| format!("{{{named}\"probability\":0.5,\"share\":0.5,\"step\":null,\"acceptance\":null}}");
    let read = |named: &str| serde_json::from_str::<Level>(&level(named));
    assert_eq!(read("\"smallest_gap_m\":1.5,").unwrap().margin, 1.5);
    let rule = read("\"robustness\":1.5,").unwrap();
    assert_eq!((rule.margin, rule.smallest_gap_m), (1.5, None));
    assert_eq!(serde_json::to_string(&rule).unwrap(), level("\"robustness\":1.5,"));
    assert!(read("").unwrap_err().to_string().contains("no `robustness`"));
}
