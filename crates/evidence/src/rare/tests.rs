//! Problems with a known probability.

use std::f64::consts::SQRT_2;
use std::sync::LazyLock;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::splitting::{LimitState, RandomInputs};
use super::*;
use crate::fixtures::{count_all, rare_plan};
use crate::{RateConfig, RatePlan};
use crumple_core::observer::{ProgressCounter, Quiet, Stopped};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate, simulate_batch};
use crumple_sim::estimate::{Filter, Sensor, Tuning};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::{NoiseShare, Purpose, Stream};
use crumple_sim::scenario::Sensors;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;

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
    let pilot =
        SplittingLevels::run_pilots(problem, SplittingConfig::default(), seed, &counter()).unwrap();
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
    let share = |share: &NoiseShare| -> f64 {
        let normal: f64 = StandardNormal.sample(&mut Stream::seed_from_u64(share.seed));
        share.weight * normal
    };
    let noise = state.noise.iter().map(share).sum::<f64>();
    4.9 - (0.75_f64.sqrt() * coordinate(state, 0) + 0.5 * noise)
}

const FILTER_STEPS: usize = 320;

/// Returns the errors of distance and rate of a Kalman filter after some measurements of distance 0.
fn filter_errors(initial: [f64; 3], noise_m: impl FnMut() -> f64) -> [f64; 2] {
    let tuning = Tuning::new(0.02, 1.0, 5.0);
    let mut filter = Filter::new_steady(&tuning, 0.0, 0.0, initial);
    let errors = std::iter::repeat_with(noise_m)
        .take(FILTER_STEPS)
        .map(|noise| filter.update(&tuning, Some(noise)));
    errors
        .last()
        .map_or([0.0; 2], |last| [last.distance_m, last.rate_mps])
}

/// Returns the standard deviations of the errors: the filter is linear, so they are sums of responses to impulses.
fn filter_deviations() -> [f64; 2] {
    let mut variances = [0.0; 2];
    for impulse in 0..3 + FILTER_STEPS {
        let mut step = 2;
        let noise_m = || {
            step += 1;
            f64::from(step == impulse)
        };
        let initial = std::array::from_fn(|i| f64::from(i == impulse));
        variances
            .iter_mut()
            .zip(filter_errors(initial, noise_m))
            .for_each(|(sum, error)| *sum += error * error);
    }
    variances.map(f64::sqrt)
}

/// Returns the errors with noise of a sensor, in standard deviations.
fn noisy_filter_errors(state: &RandomInputs) -> [f64; 2] {
    static DEVIATIONS: LazyLock<[f64; 2]> = LazyLock::new(filter_deviations);
    let (seed, sensors) = (state.noise[0].seed, Sensors::default());
    let sensor = |purpose| Sensor::with_noise_shares(seed, &state.noise, purpose, 0, 1.0, &sensors);
    let (mut first, mut sensor) = (
        sensor(Purpose::InitialEstimate),
        sensor(Purpose::PositionSensor),
    );
    let initial = std::array::from_fn(|_| first.measure(0.0).unwrap());
    let [distance, rate] = filter_errors(initial, || sensor.measure(0.0).unwrap());
    [distance / DEVIATIONS[0], rate / DEVIATIONS[1]]
}

fn filter_distance(state: &RandomInputs) -> f64 {
    4.8 - noisy_filter_errors(state)[0]
}

fn filter_rate(state: &RandomInputs) -> f64 {
    5.0 - noisy_filter_errors(state)[1].abs()
}

/// Estimates with some seeds. Checks the ratios to the truth, their mean, the number of intervals that contain the
/// truth, and the number of runs.
fn assert_close(
    (name, problem, truth): &(&str, ClosedFormLimitState, f64),
    (within, bias, min_held): (f64, f64, usize),
    (seeds, max_runs): (u64, u64),
) {
    let estimates: Vec<RareEstimate> = (0..seeds).map(|seed| estimate(problem, seed)).collect();
    let ratios: Vec<f64> = estimates
        .iter()
        .map(|estimate| estimate.probability.unwrap() / truth)
        .collect();
    let covered = estimates.iter().filter(|estimate| {
        let [low, high] = estimate.interval_95.unwrap();
        (low..=high).contains(truth)
    });
    let (covered, mean) = (covered.count(), ratios.iter().sum::<f64>() / seeds as f64);
    let most = estimates
        .iter()
        .map(|estimate| estimate.evaluations)
        .max()
        .unwrap();
    // Counting with the same relative error needs (1 - p) / p / error^2 runs.
    let error = ratios
        .iter()
        .map(|ratio| (ratio - 1.0).powi(2))
        .sum::<f64>()
        / seeds as f64;
    let saved = (1.0 - truth) / truth / error / most as f64;
    println!(
        "{name}: truth {truth:.3e}, mean {mean:.3}, {covered} of {seeds} held, {most} runs, error {:.3}, {saved:.0} \
         times fewer runs than counting",
        error.sqrt()
    );
    assert!(
        ratios
            .iter()
            .all(|ratio| (1.0 / within..within).contains(ratio)),
        "{name}: {ratios:?}"
    );
    assert!((mean - 1.0).abs() < bias, "{name}: {mean}");
    assert!(covered >= min_held, "{name}: {covered} of {seeds}");
    assert!(most < max_runs, "{name}: {most}");
}

fn known_problems() -> [(&'static str, ClosedFormLimitState, f64); 6] {
    [
        (
            "linear",
            ClosedFormLimitState {
                dimension: 10,
                margin: linear,
            },
            upper_tail(5.0),
        ),
        (
            "sphere",
            ClosedFormLimitState {
                dimension: 6,
                margin: sphere,
            },
            1.0 - ChiSquared::new(6.0).unwrap().cdf(45.0),
        ),
        (
            "either side",
            ClosedFormLimitState {
                dimension: 3,
                margin: either_side,
            },
            2.0 * upper_tail(5.0),
        ),
        (
            "noisy",
            ClosedFormLimitState {
                dimension: 2,
                margin: noisy,
            },
            upper_tail(4.9),
        ),
        (
            "filter, distance",
            ClosedFormLimitState {
                dimension: 1,
                margin: filter_distance,
            },
            upper_tail(4.8),
        ),
        (
            "filter, rate",
            ClosedFormLimitState {
                dimension: 1,
                margin: filter_rate,
            },
            2.0 * upper_tail(5.0),
        ),
    ]
}

/// Each estimate is within a factor of two, nearly all intervals contain the truth, and the mean over the seeds has a
/// small error. Problems of tier 2 have a filter, which takes longer, or more seeds.
#[test]
fn estimates_of_small_probabilities_are_close() {
    known_problems()
        .iter()
        .take(2)
        .for_each(|problem| assert_close(problem, (2.0, 0.3, 6), (8, 600_000)));
}

mod tier_2 {
    use super::*;

    #[test]
    #[ignore = "tier 2: takes a minute"]
    fn estimates_of_probabilities_below_a_millionth_are_close() {
        for (index, problem) in known_problems().into_iter().enumerate() {
            assert!(problem.2 < 1e-6);
            let (limits, effort) = if index < 4 {
                ((2.0, 0.1, 20), (24, 600_000))
            } else {
                ((2.0, 0.3, 3), (4, 600_000))
            };
            assert_close(&problem, limits, effort);
        }
    }
}

/// 100 seeds for each problem, for the table in docs/comparison.md.
#[test]
#[ignore = "takes minutes"]
fn intervals_contain_known_probabilities() {
    known_problems()
        .iter()
        .for_each(|problem| assert_close(problem, (2.0, 0.1, 90), (100, 600_000)));
}

/// One share of weight 1 is the noise of its seed.
#[test]
fn both_engines_agree_on_shares_of_noise() {
    let space = built_in_space("paper").unwrap();
    let scenario = space
        .scenario_at_with_seed(&space.quantile(&vec![0.5; space.dimension()]), 1)
        .unwrap();
    let with = |weights: &[f64]| {
        let shares = (1..)
            .zip(weights)
            .map(|(seed, &weight)| NoiseShare { seed, weight });
        scenario
            .clone()
            .with_noise_shares(&shares.collect::<Vec<_>>())
    };
    let options = RunOptions::new(BuiltInController::from_name("idm").unwrap());
    let run = |scenario| Run::new(&scenario, options.clone()).unwrap();
    let runs = [scenario.clone(), with(&[1.0]), with(&[0.8, 0.6])].map(run);
    let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| result);
    assert_eq!(
        results,
        runs.each_ref()
            .map(|run| simulate(run, RecordingLevel::Trace))
    );
    assert_eq!(results[0], results[1]);
    assert_ne!(results[0], results[2]);
}

#[test]
fn estimates_depend_on_the_seed_and_not_on_threads() {
    let problem = ClosedFormLimitState {
        dimension: 4,
        margin: linear,
    };
    let with = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| estimate(&problem, 3))
    };
    assert_eq!(with(1), with(3));
    assert_ne!(with(1).probability, estimate(&problem, 4).probability);
}

#[test]
fn levels_multiply_to_the_estimate_and_end_at_the_failure() {
    let estimated = estimate(
        &ClosedFormLimitState {
            dimension: 4,
            margin: linear,
        },
        1,
    );
    let last = estimated.levels.last().unwrap();
    assert_eq!(
        (last.margin, Some(last.probability)),
        (0.0, estimated.probability)
    );
    for pair in estimated.levels.windows(2) {
        assert!(pair[0].margin > pair[1].margin && pair[0].probability > pair[1].probability);
    }
    assert_eq!(
        estimated.repetitions.len(),
        SplittingConfig::default().repetition_count
    );
}

/// Margins lead a small population away from the failures; a larger pilot finds them, without bias. The runs of all
/// pilots count, and their samples if nothing else is known.
#[test]
fn a_larger_pilot_reaches_a_failure_that_the_first_one_misses() {
    // A wide valley ends above 0; the narrow way to the failures has larger margins at first.
    let astray = |state: &RandomInputs| {
        let at = |index: usize| coordinate(state, index);
        let (valley, way) = (0.5 + (2.0 - at(0)).max(0.0), 3.1 - at(1));
        valley.min(if way < 0.0 { way } else { way + 1.0 })
    };
    let (problem, truth) = (
        ClosedFormLimitState {
            dimension: 2,
            margin: astray,
        },
        upper_tail(3.1),
    );
    let effort = SplittingConfig {
        samples: 100,
        repetition_count: 10,
    };
    let (mut ratios, mut retries) = (Vec::new(), 0);
    for seed in 0..200 {
        let first = SplittingLevels::run_pilot(&problem, effort, seed, 0, &counter()).unwrap();
        retries += usize::from(!first.reaches_failure());
        let pilot = SplittingLevels::run_pilots(&problem, effort, seed, &counter()).unwrap();
        let estimate = pilot.estimate(&problem, &counter()).unwrap();
        // If no pilot reaches a failure, the runs of the three pilots are all.
        assert_eq!(
            estimate.independent_runs,
            if estimate.probability.is_some() {
                1100
            } else {
                700
            }
        );
        ratios.push(estimate.probability.unwrap_or(0.0) / truth);
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    println!("{retries} went on, mean {mean:.3}");
    assert!(
        retries >= 10 && (mean - 1.0).abs() < 0.15,
        "{retries} went on, mean {mean:.3}"
    );
    let never = SplittingLevels::run_pilots(
        &ClosedFormLimitState {
            dimension: 2,
            margin: |_| 1.0,
        },
        effort,
        0,
        &counter(),
    )
    .unwrap();
    let nothing = never.estimate(&problem, &counter()).unwrap();
    assert_eq!(
        (
            nothing.probability,
            nothing.independent_runs,
            nothing.evaluations
        ),
        (None, 700, 700)
    );
}

#[test]
fn without_a_failure_there_is_no_probability() {
    let never = [
        |state: &RandomInputs| 1.0 + state.normal.iter().sum::<f64>().exp(),
        |_: &RandomInputs| 1.0,
        |_: &RandomInputs| f64::NAN,
    ];
    for margin in never {
        let estimated = estimate(
            &ClosedFormLimitState {
                dimension: 2,
                margin,
            },
            0,
        );
        assert_eq!((estimated.probability, estimated.interval_95), (None, None));
        assert!(estimated.levels.iter().all(|level| level.margin > 0.0));
    }
    let always = estimate(
        &ClosedFormLimitState {
            dimension: 2,
            margin: |_| -1.0,
        },
        0,
    );
    assert_eq!(
        (always.probability, always.coefficient_of_variation),
        (Some(1.0), Some(0.0))
    );
}

#[test]
fn splitting_agrees_with_counting_in_a_space() {
    const COUNTED: u64 = 6000;
    let estimator = EstimatorKind::Kalman;
    let effort = SplittingConfig {
        samples: 200,
        repetition_count: 10,
    };
    let plan = RarePlan {
        estimator,
        effort,
        ..rare_plan(5, 10)
    };
    let count = RateConfig {
        seed: 1,
        ..RateConfig::new(plan.controller.clone(), plan.space.clone(), COUNTED)
    };
    let counted = count_all(&RatePlan::new(count).unwrap()).failures as f64 / COUNTED as f64;
    let root = tempfile::tempdir().unwrap();
    let report = plan.run(root.path(), false, &Quiet).unwrap();
    let (climbed, variation) = (
        report.estimate.probability.unwrap(),
        report.estimate.coefficient_of_variation.unwrap(),
    );
    assert!((0.004..0.02).contains(&counted), "{counted}");
    assert!(
        report.estimate.levels.len() > 1 && variation < 0.2,
        "{report:?}"
    );
    let deviation = (counted / COUNTED as f64 + (climbed * variation).powi(2)).sqrt();
    assert!(
        (climbed - counted).abs() < 4.0 * deviation,
        "{climbed} and {counted}, deviation {deviation}"
    );
}

#[test]
fn levels_are_read_with_either_name_of_their_margin() {
    let level = |named: &str| {
        format!("{{{named}\"probability\":0.5,\"share\":0.5,\"step\":null,\"acceptance\":null}}")
    };
    let read = |named: &str| serde_json::from_str::<Level>(&level(named));
    assert_eq!(read("\"smallest_gap_m\":1.5,").unwrap().margin, 1.5);
    let rule = read("\"margin\":1.5,").unwrap();
    assert_eq!(read("\"robustness\":1.5,").unwrap(), rule);
    assert_eq!((rule.margin, rule.smallest_gap_m), (1.5, None));
    assert_eq!(
        serde_json::to_string(&rule).unwrap(),
        level("\"margin\":1.5,")
    );
    assert!(read("").unwrap_err().to_string().contains("no `margin`"));
}

/// Compares the weighted mean of the kept failures with the closed form: the sum z of normal numbers has mean
/// φ(5)/Φ(-5) above 5.
#[test]
fn kept_failures_are_a_sample_of_the_failure_distribution() {
    let problem = ClosedFormLimitState {
        dimension: 4,
        margin: linear,
    };
    let expected = (-12.5_f64).exp() / (2.0 * std::f64::consts::PI).sqrt() / upper_tail(5.0);
    let mut means = Vec::new();
    for seed in 0..8 {
        let effort = SplittingConfig::default();
        let pilot = SplittingLevels::run_pilots(&problem, effort, seed, &counter()).unwrap();
        let repetitions = pilot
            .run_repetitions(&problem, 0..u64::MAX, &counter())
            .unwrap();
        let weighted = failures::weigh(&repetitions);
        assert!((100..=MAX_KEPT_FAILURES).contains(&weighted.len()));
        let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
        let estimate = pilot.summary(repetitions.clone());
        assert!((total / estimate.probability.unwrap() - 1.0).abs() < 1e-12);
        let sums = weighted
            .iter()
            .map(|(run, weight)| weight * (5.0 - run.margin()));
        means.push(sums.sum::<f64>() / total);
    }
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    assert!(
        (mean - expected).abs() < 0.03,
        "{mean} {expected} {means:?}"
    );
}
