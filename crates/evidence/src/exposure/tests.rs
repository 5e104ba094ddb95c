use super::*;
use crate::fit::refit;
use crate::rare::Level;
use crumple_sim::random::{Purpose, Stream, stream};
use crumple_sim::scenario::NoDriverFiles;
use crumple_spaces::{DrivingExposure, ObservedData, ObservedParameter, file};
use rand::RngExt;
use rand_distr::{Distribution, Exp};
use std::path::Path;

/// Known traffic: a log-normal gap, and a deceleration that depends on it; a small gap for the deceleration is a
/// failure.
const TRAFFIC: &str = r#"
version = 1
name = "synthetic"
base = "paper-1"
[[parameters]]
name = "gap_m"
field = "vehicles[1].gap_m"
unit = "m"
distribution.log-normal = { ln_mean = 3.0, ln_deviation = 0.5, low = 1.0, high = 200.0 }
[[parameters]]
name = "rate"
field = "vehicles[0].driver.brake.rate_mps2"
unit = "m/s²"
distribution.gamma = { shape = 6.0, scale = 0.6, low = 0.1, high = 7.5 }
[dependence.gaussian-copula]
parameters = ["gap_m", "rate"]
correlation = [[1.0, -0.4], [-0.4, 1.0]]
"#;

fn traffic() -> ScenarioSpace {
    file::from_toml(TRAFFIC, Path::new("synthetic.toml"), &NoDriverFiles).unwrap()
}

fn fails(values: &[f64]) -> bool {
    values[0] < 2.2 * values[1]
}

fn failures(space: &ScenarioSpace, seed: u64, runs: u64) -> Result<u64, std::convert::Infallible> {
    Ok((0..runs)
        .filter(|&index| fails(&space.values(&space.draw_point(seed, index))))
        .count() as u64)
}

/// Observes traffic with a rate of episodes for some hours, and fits a space to it.
fn observe_traffic(
    truth: &ScenarioSpace,
    hours: f64,
    an_hour: f64,
    random: &mut Stream,
) -> ScenarioSpace {
    let waiting = Exp::new(an_hour).unwrap();
    let (mut at_hours, mut columns): (f64, [Vec<f64>; 2]) =
        (waiting.sample(random), Default::default());
    while at_hours < hours {
        let uniform = [random.random(), random.random()];
        let values = truth.values(&truth.quantile(&uniform));
        columns
            .iter_mut()
            .zip(values)
            .for_each(|(column, value)| column.push(value));
        at_hours += waiting.sample(random);
    }
    let mut spec = truth.spec().clone();
    let episodes = columns[0].len();
    let (kilometres, sources) = (70.0 * hours, Vec::new());
    spec.exposure = Some(DrivingExposure {
        episodes: episodes as u64,
        hours,
        kilometres,
        undescribed_brakings: 0,
        sources,
    });
    let parameters = truth
        .parameters()
        .iter()
        .zip(columns)
        .map(|(parameter, values)| ObservedParameter {
            name: parameter.name().to_owned(),
            low: parameter.range()[0],
            high: parameter.range()[1],
            point_mass: None,
            values,
        });
    let (braking_clusters, parameters) = ((0..episodes as u32).collect(), parameters.collect());
    let observed = ObservedData {
        braking_clusters,
        search_share: None,
        parameters,
    };
    spec.observed = Some(observed.clone());
    refit(&spec, &observed).unwrap()
}

/// Counts the trials whose intervals contain the true rate per hour, with and without data uncertainty.
fn coverage(trials: u64, hours: f64) -> [u64; 2] {
    const AN_HOUR: f64 = 12.0;
    let truth = traffic();
    let true_probability = failures(&truth, 1, 400_000).unwrap() as f64 / 400_000.0;
    let mut covered = [0; 2];
    for trial in 0..trials {
        let space = observe_traffic(
            &truth,
            hours,
            AN_HOUR,
            &mut stream(trial, Purpose::Search, 77),
        );
        let runs = 2000;
        let probability = FailureProbability::Counted {
            failures: failures(&space, trial, runs).unwrap(),
            unknown: 0,
            runs,
        };
        let resamples = count_on_resamples(&space, trial, 100, 200, &mut failures)
            .unwrap()
            .unwrap();
        let rate = RatePerExposure::new(&space, probability, Ok(&resamples)).unwrap();
        let holds = |figure: IntervalEstimate| {
            u64::from((figure.lower..=figure.upper).contains(&(AN_HOUR * true_probability)))
        };
        covered[0] += holds(rate.with_data_uncertainty.unwrap().rates.per_hour);
        covered[1] += holds(rate.fitted.per_hour);
    }
    println!(
        "{hours} h, failures {true_probability:.4} an episode: {covered:?} of {trials} intervals hold the rate per hour"
    );
    covered
}

/// Both intervals are joint and conservative. If an interval holds with a probability of 95 %, fewer than 36 of 40 hold
/// with a probability of 5 %.
#[test]
fn intervals_contain_the_true_rate_of_synthetic_traffic() {
    let [with_data, _] = coverage(40, 8.0);
    assert!(with_data >= 36, "{with_data}");
}

/// Full version, with the figures of docs/fitting.md.
#[test]
#[ignore = "takes minutes"]
fn coverage_at_several_exposures() {
    for hours in [3.0, 8.0, 25.0] {
        coverage(500, hours);
    }
}

fn space_with_exposure(undescribed_brakings: u64) -> ScenarioSpace {
    let mut spec = traffic().spec().clone();
    let (kilometres, sources) = (100.0, Vec::new());
    spec.exposure = Some(DrivingExposure {
        episodes: 50,
        hours: 2.0,
        kilometres,
        undescribed_brakings,
        sources,
    });
    ScenarioSpace::new(spec, Path::new(""), &NoDriverFiles).unwrap()
}

#[test]
fn rates_need_exposure_and_data_uncertainty_needs_episodes() {
    let truth = traffic();
    let probability = FailureProbability::Counted {
        failures: 3,
        unknown: 0,
        runs: 1000,
    };
    let none = Err(&ResamplingError::NotRequested);
    assert_eq!(RatePerExposure::new(&truth, probability, none), None);
    let space = space_with_exposure(0);
    assert_eq!(
        count_on_resamples(&space, 0, 79, 10, &mut failures).unwrap(),
        Err(ResamplingError::NoData)
    );
    let rate = RatePerExposure::new(&space, probability, none).unwrap();
    assert_eq!((rate.clusters, rate.with_data_uncertainty), (50, None));
    let FailureRates {
        per_episode,
        per_hour,
        per_1000_km,
    } = rate.fitted;
    assert!(
        (per_hour.estimate - 0.075).abs() < 1e-12 && (per_1000_km.estimate - 1.5).abs() < 1e-12
    );
    assert!(per_hour.upper / per_hour.estimate > per_episode.upper / per_episode.estimate);
    assert!(per_hour.lower < per_hour.estimate && per_hour.upper > per_hour.estimate);
}

#[test]
fn undescribed_brakings_count_in_rates_per_hour() {
    let probability = FailureProbability::Counted {
        failures: 30,
        unknown: 0,
        runs: 1000,
    };
    let rate = |undescribed_brakings: u64| {
        let space = space_with_exposure(undescribed_brakings);
        RatePerExposure::new(&space, probability, Err(&ResamplingError::NotRequested)).unwrap()
    };
    let (all, half) = (rate(0), rate(50));
    assert_eq!(
        (
            all.undescribed_brakings,
            half.undescribed_brakings,
            half.fitted.per_episode
        ),
        (0, 50, all.fitted.per_episode)
    );
    let numbers = |figure: IntervalEstimate| [figure.estimate, figure.lower, figure.upper];
    for (all_rates, half_rates) in [
        (all.fitted.per_hour, half.fitted.per_hour),
        (all.fitted.per_1000_km, half.fitted.per_1000_km),
    ] {
        assert!(
            numbers(all_rates)
                .iter()
                .zip(numbers(half_rates))
                .all(|(all_rates, half_rates)| (2.0 * all_rates - half_rates).abs() < 1e-12),
            "{all_rates:?} {half_rates:?}"
        );
    }
}

/// Without spread of the repetitions, their independent initial runs bound the rate.
#[test]
fn estimates_without_a_spread_still_bound_the_rate() {
    let space = space_with_exposure(0);
    let rate = |probability: Option<f64>, independent: (u64, u64)| {
        let (independent_failures, independent_runs) = independent;
        let estimate = RareEstimate {
            probability,
            coefficient_of_variation: probability
                .filter(|probability| *probability > 0.0)
                .map(|_| 0.0),
            repetitions: vec![probability.unwrap_or(0.0); 5],
            evaluations: independent_runs,
            independent_runs,
            independent_failures,
            ..RareEstimate::default()
        };
        RatePerExposure::new(
            &space,
            FailureProbability::Estimated(&estimate),
            Err(&ResamplingError::NotRequested),
        )
    };
    for nothing in [rate(None, (0, 500)), rate(Some(0.0), (0, 500))] {
        let FailureRates {
            per_episode,
            per_hour,
            ..
        } = nothing.expect("an upper end is known").fitted;
        assert_eq!(
            (per_episode.estimate, per_episode.lower, per_hour.estimate),
            (0.0, 0.0, 0.0)
        );
        assert!(
            (per_episode.upper - (1.0 - 0.025_f64.powf(1.0 / 500.0))).abs() < 1e-9,
            "{per_episode:?}"
        );
        // 50 episodes in 2 h: at most 69 expected, each with a probability of up to 0.9 %.
        assert!((0.2..0.35).contains(&per_hour.upper), "{per_hour:?}");
    }
    let all = rate(Some(1.0), (500, 500))
        .expect("a lower end is known")
        .fitted;
    assert_eq!(
        (all.per_episode.estimate, all.per_episode.upper),
        (1.0, 1.0)
    );
    assert!(
        (all.per_episode.lower - 0.025_f64.powf(1.0 / 500.0)).abs() < 1e-9,
        "{all:?}"
    );
    assert_eq!(rate(None, (0, 0)), None);
}

/// With 79 resamples, the first and the last leave 1.25 % at each end.
#[test]
fn percentiles_of_few_resamples_are_not_stated() {
    let resamples = |count: u32| {
        let values: Vec<f64> = (1..=count).map(f64::from).collect();
        Resamples {
            sorted_bounds: [values.clone(), values],
            failed_fits: 0,
            runs_each: None,
            data_variance: 0.0,
        }
    };
    assert_eq!(resamples(78).percentile_interval(0.975), None);
    assert_eq!(resamples(79).percentile_interval(0.975), Some([1.0, 79.0]));
    assert_eq!(resamples(79).percentile_interval(0.95), Some([2.0, 78.0]));
    assert_eq!(
        resamples(159).percentile_interval(0.975),
        Some([2.0, 158.0])
    );
    assert_eq!(resamples(200).percentile_interval(0.95), Some([5.0, 196.0]));
    let space = observe_traffic(&traffic(), 8.0, 12.0, &mut stream(3, Purpose::Search, 77));
    let few = count_on_resamples(&space, 0, 78, 10, &mut failures).unwrap();
    assert_eq!(few, Err(ResamplingError::TooFew { requested: 78 }));
    let mut spec = space.spec().clone();
    spec.parameters[0].distribution = traffic().spec().parameters[0].distribution.clone();
    let changed = ScenarioSpace::new(spec, Path::new(""), &NoDriverFiles).unwrap();
    let refused = count_on_resamples(&changed, 0, 79, 10, &mut failures).unwrap();
    assert_eq!(
        refused,
        Err(ResamplingError::Edited {
            what: "`gap_m`".to_owned()
        })
    );
}

#[test]
fn estimates_in_resamples_agree_with_new_runs() {
    let truth = traffic();
    let space = observe_traffic(&truth, 20.0, 12.0, &mut stream(3, Purpose::Search, 77));
    let estimate = |probability: Option<f64>| RareEstimate {
        probability,
        coefficient_of_variation: probability.map(|_| 1e-6),
        independent_runs: 500,
        levels: vec![Level {
            margin: 1.0,
            probability: 1e-3,
            share: 0.1,
            ..Level::default()
        }],
        ..RareEstimate::default()
    };
    let share = |space: &ScenarioSpace, seed: u64| {
        failures(space, seed, 4000).map(|failed| failed as f64 / 4000.0)
    };
    let climbed = estimate_on_resamples(&space, 9, 80, &mut |space: &ScenarioSpace, seed| {
        Ok::<_, std::convert::Infallible>(estimate(Some(share(space, seed)?)))
    });
    let (climbed, counted) = (
        climbed.unwrap().unwrap(),
        count_on_resamples(&space, 9, 80, 4000, &mut failures)
            .unwrap()
            .unwrap(),
    );
    for (a, b) in climbed.sorted_bounds[0]
        .iter()
        .zip(&counted.sorted_bounds[0])
    {
        assert!((a - b).abs() < 0.03, "{a} {b}");
    }
    let ratio = climbed.data_variance / counted.data_variance;
    assert!((0.7..1.4).contains(&ratio), "{ratio}");
    let none = estimate_on_resamples(&space, 9, 80, &mut |_: &ScenarioSpace, _| {
        Ok::<_, std::convert::Infallible>(estimate(None))
    });
    assert_eq!(
        none.unwrap().unwrap().percentile_interval(0.95),
        Some([0.0, 1e-3])
    );
}
