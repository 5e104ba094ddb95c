use crumple_sim::scenario::NoDriverFiles;
use std::fmt::Write;
use std::path::Path;

use rand::RngExt;

use super::dependence::{self, CopulaColumn};
use super::episodes::features;
use super::marginal::FamilyRanking;
use super::*;
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::{LeaderSelection, MinBrake, Recording, read};
use crumple_sim::control::BuiltInController;
use crumple_sim::random::{Purpose, stream};
use crumple_sim::scenario::{Driver, LeadProfile, VehicleClass};
use crumple_spaces::{
    Dependence, DistributionSpec, LogNormalSpec, NormalSpec, ObservedData, ObservedParameter,
    ScenarioSpace, ShapeScaleSpec, UniformSpec, file,
};

fn known_distributions() -> Vec<(DistributionSpec, DistributionFamily, [f64; 2], [f64; 2])> {
    let range = [0.2, 12.0];
    let [low, high] = range;
    vec![
        (
            DistributionSpec::Uniform(UniformSpec {
                low: 1.0,
                high: 4.0,
            }),
            DistributionFamily::Uniform,
            [1.0, 4.0],
            range,
        ),
        (
            DistributionSpec::Normal(NormalSpec {
                mean: 2.0,
                deviation: 1.2,
                low,
                high,
            }),
            DistributionFamily::Normal,
            [2.0, 1.2],
            range,
        ),
        (
            DistributionSpec::LogNormal(LogNormalSpec {
                ln_mean: 0.3,
                ln_deviation: 0.5,
                low,
                high,
            }),
            DistributionFamily::LogNormal,
            [0.3, 0.5],
            range,
        ),
        (
            DistributionSpec::Gamma(ShapeScaleSpec {
                shape: 4.0,
                scale: 0.5,
                low,
                high,
            }),
            DistributionFamily::Gamma,
            [4.0, 0.5],
            range,
        ),
        (
            DistributionSpec::Weibull(ShapeScaleSpec {
                shape: 2.0,
                scale: 2.2,
                low,
                high,
            }),
            DistributionFamily::Weibull,
            [2.0, 2.2],
            range,
        ),
    ]
}

fn draw_values(distribution: &DistributionSpec, count: usize, seed: u64) -> Vec<f64> {
    let (ready, mut random) = (
        distribution.build().unwrap(),
        stream(seed, Purpose::Resampling, 0),
    );
    (0..count)
        .map(|_| ready.quantile(random.random()))
        .collect()
}

fn options(name: &str) -> FitOptions {
    FitOptions {
        name: name.to_owned(),
        follower: BuiltInController::from_name("baseline").unwrap(),
        samples: 19,
        seed: 0,
    }
}

/// With 200 trials, an interval at 95 % misses at least 18 times with a probability below 2 %; the seeds are fixed.
#[test]
fn intervals_contain_the_parameters_of_known_distributions() {
    for (distribution, family, truth, range) in known_distributions() {
        let mut covered = [0; 2];
        for trial in 0..200 {
            let fit = family
                .fit(&draw_values(&distribution, 200, trial), range)
                .unwrap();
            let intervals = fit.intervals_95.unwrap();
            for which in 0..2 {
                let [low, high] = intervals[which];
                covered[which] += u32::from(low <= truth[which] && truth[which] <= high);
            }
        }
        println!(
            "{}: {covered:?} of 200 intervals hold the parameters",
            family.name()
        );
        assert!(
            covered.iter().all(|covered| (183..=200).contains(covered)),
            "{}: {covered:?}",
            family.name()
        );
    }
}

#[test]
fn the_family_that_values_were_drawn_from_is_chosen_most_often() {
    for (distribution, family, _, range) in known_distributions() {
        let chosen = |trial: u64| {
            FamilyRanking::fit(&draw_values(&distribution, 1000, 1000 + trial), range)
                .unwrap()
                .chosen
                .family
        };
        let right = (0..40).filter(|&trial| chosen(trial) == family).count();
        println!("{}: chosen in {right} of 40", family.name());
        assert!(right >= 24, "{}: {right}", family.name());
    }
}

#[test]
fn p_values_are_uniform_if_the_family_is_right() {
    let (distribution, family, _, range) = known_distributions().remove(2);
    let evaluated = |values: &mut Vec<f64>, family: DistributionFamily, trial: u64| {
        values.sort_by(f64::total_cmp);
        let fit = family.fit(values, range).unwrap();
        GoodnessOfFit::bootstrap(
            values,
            range,
            &fit,
            &fit.distribution.build().unwrap(),
            (99, trial, 0),
        )
    };
    let mut low = 0;
    for trial in 0..60 {
        let goodness = evaluated(
            &mut draw_values(&distribution, 100, 500 + trial),
            family,
            trial,
        );
        low += u32::from(goodness.cramer_von_mises_p <= 0.2);
    }
    assert!((4..=22).contains(&low), "{low} of 60 below 0.2");
    let two_humps: Vec<f64> = (0..100)
        .map(|i| if i % 2 == 0 { 1.0 } else { 5.0 } + 0.01 * f64::from(i))
        .collect();
    let goodness = evaluated(&mut two_humps.clone(), DistributionFamily::Normal, 0);
    assert!(
        goodness.cramer_von_mises_p <= 0.01 && goodness.kolmogorov_smirnov_p <= 0.01,
        "{goodness:?}"
    );
}

fn dependent_space() -> ScenarioSpace {
    let text = r#"
version = 1
name = "known"
base = "paper-1"
[[parameters]]
name = "friction"
field = "environment.friction"
unit = "1"
distribution.gamma = { shape = 20.0, scale = 0.035, low = 0.3, high = 1.0 }
[[parameters]]
name = "ahead_m"
field = "vehicles[1].gap_m"
unit = "m"
distribution.log-normal = { ln_mean = 3.0, ln_deviation = 0.4, low = 2.0, high = 100.0 }
[[parameters]]
name = "behind_m"
field = "vehicles[2].gap_m"
unit = "m"
distribution.weibull = { shape = 2.0, scale = 20.0, low = 1.0, high = 100.0 }
[dependence.gaussian-copula]
parameters = ["behind_m", "friction", "ahead_m"]
correlation = [[1.0, -0.3, 0.7], [-0.3, 1.0, 0.2], [0.7, 0.2, 1.0]]
"#;
    file::from_toml(text, Path::new("known.toml"), &NoDriverFiles).unwrap()
}

/// The standard deviation of the estimate for −0.3 from 2000 samples is 0.02; one in seventy has an error above 0.05.
#[test]
fn the_correlation_of_2000_samples_is_recovered() {
    let space = dependent_space();
    let truth = [[1.0, -0.3, 0.7], [-0.3, 1.0, 0.2], [0.7, 0.2, 1.0]];
    let (mut close, mut sums) = (0, [0.0; 3]);
    for seed in 0..30 {
        let draws: Vec<Vec<f64>> = (0..2000)
            .map(|index| space.values(&space.draw_point(seed, index)))
            .collect();
        let column = |which: usize| draws.iter().map(|draw| draw[which]).collect::<Vec<f64>>();
        let columns = [column(2), column(0), column(1)];
        let distribution = &space.spec().parameters[0].distribution;
        let correlation =
            dependence::estimate_correlation(&columns.each_ref().map(|values| CopulaColumn {
                values,
                distribution,
            }));
        for (index, (row, column)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            let off: f64 = correlation[row][column] - truth[row][column];
            close += u32::from(off.abs() < 0.05);
            sums[index] += off / 30.0;
        }
    }
    println!("{close} of 90 correlations to 0.05, mean errors {sums:.4?}");
    assert!(
        close >= 86 && sums.iter().all(|mean| mean.abs() < 0.012),
        "{close} {sums:?}"
    );
}

fn observe_draws(space: &ScenarioSpace, count: u32, seed: u64) -> ObservedData {
    let draws: Vec<Vec<f64>> = (0..count.into())
        .map(|index| space.values(&space.draw_point(seed, index)))
        .collect();
    let observe =
        |(which, parameter): (usize, &crumple_spaces::SpaceParameter)| ObservedParameter {
            name: parameter.name().to_owned(),
            low: parameter.range()[0],
            high: parameter.range()[1],
            point_mass: match &space.spec().parameters[which].distribution {
                DistributionSpec::PointMass(point) => Some(point.at),
                _ => None,
            },
            values: draws.iter().map(|draw| draw[which]).collect(),
        };
    ObservedData {
        braking_clusters: (0..count).collect(),
        search_share: None,
        parameters: space.parameters().iter().enumerate().map(observe).collect(),
    }
}

const WITH_POINTS: &str = r#"
version = 1
name = "known"
base = "paper-1"
[[parameters]]
name = "friction"
field = "environment.friction"
unit = "1"
distribution.point-mass.at = 0.3
distribution.point-mass.probability = 0.3
distribution.point-mass.others.normal = { mean = 0.7, deviation = 0.15, low = 0.3, high = 1.0 }
[[parameters]]
name = "ahead_m"
field = "vehicles[1].gap_m"
unit = "m"
distribution.log-normal = { ln_mean = 3.0, ln_deviation = 0.4, low = 2.0, high = 100.0 }
[[parameters]]
name = "size_m"
field = "vehicles[2].size_m"
unit = "m"
nominal = 4.5
distribution.choice = { values = [4.5, 12.0], weights = [3.0, 1.0] }
[dependence.gaussian-copula]
parameters = ["friction", "ahead_m", "size_m"]
correlation = [[1.0, 0.6, -0.5], [0.6, 1.0, 0.3], [-0.5, 0.3, 1.0]]
"#;

/// If all values but at most one are that of the point mass, the error states how many are.
#[test]
fn a_point_mass_without_two_other_values_is_an_error_that_counts_them() {
    let space = file::from_toml(WITH_POINTS, Path::new("points.toml"), &NoDriverFiles).unwrap();
    for (others, why) in [(0, "there is no value"), (1, "all values are 0.7")] {
        let mut observed = observe_draws(&space, 30, 0);
        observed.parameters[0].values = vec![0.3; 30];
        observed.parameters[0].values[..others].fill(0.7);
        let error = refit(space.spec(), &observed).unwrap_err().to_string();
        let count = 30 - others;
        let expected = format!(
            "friction: {count} of 30 values are 0.3, and a distribution of the others needs two different ones: {why}"
        );
        assert_eq!(error, expected);
    }
}

#[test]
fn point_masses_and_sizes_are_recovered_with_their_dependence() {
    let space = file::from_toml(WITH_POINTS, Path::new("points.toml"), &NoDriverFiles).unwrap();
    let truth = [[1.0, 0.6, -0.5], [0.6, 1.0, 0.3], [-0.5, 0.3, 1.0]];
    let (mut errors, mut most) = ([0.0; 3], 0.0_f64);
    for seed in 0..8 {
        let observed = observe_draws(&space, 2000, seed);
        let refitted = refit(space.spec(), &observed).unwrap();
        let Some(Dependence::GaussianCopula(copula)) = &refitted.spec().dependence else {
            panic!("dependent")
        };
        for (index, (row, column)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            let off: f64 = copula.correlation[row][column] - truth[row][column];
            errors[index] += off / 8.0;
            most = most.max(off.abs());
        }
        let [friction, _, size] = &refitted.spec().parameters[..] else {
            panic!("three")
        };
        let DistributionSpec::PointMass(point) = &friction.distribution else {
            panic!("{friction:?}")
        };
        assert!(
            point.at == 0.3 && (point.probability - 0.3).abs() < 0.035,
            "{point:?}"
        );
        let (fitted, stated) = (
            point.others.build().unwrap(),
            space.spec().parameters[0].distribution.build().unwrap(),
        );
        for u in [0.35, 0.5, 0.7, 0.9] {
            let value = stated.quantile(u);
            assert!(
                (fitted.cdf(value) - (u - 0.3) / 0.7).abs() < 0.04,
                "{value}"
            );
        }
        let DistributionSpec::Choice(choice) = &size.distribution else {
            panic!("{size:?}")
        };
        assert!(
            (choice.weights.as_ref().unwrap()[1] / 2000.0 - 0.25).abs() < 0.035,
            "{choice:?}"
        );
        let text = file::to_toml(&refitted).unwrap();
        assert_eq!(
            file::from_toml(&text, Path::new("again.toml"), &NoDriverFiles)
                .unwrap()
                .draw(3, 4),
            refitted.draw(3, 4)
        );
        assert_eq!(find_edit(&refitted, &observed), Ok(None));
    }
    println!("mean errors {errors:.4?}, the largest {most:.3}");
    assert!(
        most < 0.12 && errors.iter().all(|error| error.abs() < 0.02),
        "{errors:?} {most}"
    );
    // The mean of the density ratio over independent samples is 1. The mean of its inverse is as well, but with
    // infinite variance.
    let apart = file::from_toml(
        WITH_POINTS.split("[dependence").next().unwrap(),
        Path::new("apart.toml"),
        &NoDriverFiles,
    )
    .unwrap();
    let density =
        |point: Vec<f64>| (space.ln_likelihood(&point) - apart.ln_likelihood(&point)).exp();
    let mean: f64 = (0..20_000)
        .map(|index| density(apart.draw_point(5, index)) / 20_000.0)
        .sum();
    assert!((mean - 1.0).abs() < 0.1, "{mean}");
    let heavy = (0..2000)
        .filter(|&index| space.draw(8, index).unwrap().vehicles()[2].class == VehicleClass::Heavy);
    assert!((450..550).contains(&heavy.count()));
}

#[test]
fn refit_names_changed_values_and_keeps_unobserved_ones() {
    let space = dependent_space();
    let observed = observe_draws(&space, 300, 4);
    let fitted = refit(space.spec(), &observed).unwrap();
    assert_eq!(find_edit(&fitted, &observed), Ok(None));
    assert_eq!(
        find_edit(&space, &observed),
        Ok(Some("friction".to_owned()))
    );
    let changed = |change: &dyn Fn(&mut crumple_spaces::SpaceSpec)| {
        let mut spec = fitted.spec().clone();
        change(&mut spec);
        find_edit(
            &ScenarioSpace::new(spec, Path::new(""), &NoDriverFiles).unwrap(),
            &observed,
        )
        .unwrap()
    };
    let narrower = changed(&|spec| {
        let values = &observed.parameters[1].values;
        let [low, high] =
            [f64::min, f64::max].map(|extreme| values.iter().copied().reduce(extreme).unwrap());
        spec.parameters[1].distribution = DistributionSpec::Uniform(UniformSpec { low, high });
    });
    assert_eq!(narrower.as_deref(), Some("ahead_m"));
    assert_eq!(
        changed(&|spec| spec.dependence = None).as_deref(),
        Some("dependence")
    );
    assert_eq!(changed(&|spec| spec.name = "mine".to_owned()), None);
    let stated = |space: &ScenarioSpace| match &space.spec().dependence {
        Some(Dependence::GaussianCopula(copula)) => copula.clone(),
        None => panic!("dependent"),
    };
    for observed_count in [1, 2] {
        let parameters = observed.parameters[..observed_count].to_vec();
        let refitted = refit(
            space.spec(),
            &ObservedData {
                parameters,
                ..observed.clone()
            },
        )
        .unwrap();
        let (before, after) = (stated(&space), stated(&refitted));
        assert_eq!(before.parameters, after.parameters);
        for (row, a) in before.parameters.iter().enumerate() {
            for (column, b) in before.parameters.iter().enumerate() {
                let is_fitted = observed_count == 2 && a != "behind_m" && b != "behind_m" && a != b;
                let is_same = before.correlation[row][column] == after.correlation[row][column];
                assert_eq!(is_same, !is_fitted, "{observed_count} {a} {b}");
            }
        }
    }
}

const TRACKS: &str = r#"
version = 1
name = "tracks"
time.frames = { column = "frame", rate_hz = 10.0 }
[layout.tracks]
vehicle = "id"
lane = "lane"
position = { column = "x", of = "front" }
speed = { column = "v" }
length.column = { name = "length" }
"#;

/// Forty lanes with a pair each, whose leader brakes once. Every fifth leader stops, every fourth follower is a lorry.
/// Of the last two pairs, one has a jump in speed, and the other no follower.
fn pairs_in_lanes(brake_mps2: f64) -> Recording {
    let mut text = "frame,id,lane,x,v,length
"
    .to_owned();
    for pair in 0..40_u32 {
        let turn = |step: f64| (f64::from(pair) * step).fract();
        let (speed, brake) = (12.0 + 12.0 * turn(0.618), brake_mps2 + 3.0 * turn(0.414));
        let lasts_s = if pair % 5 == 0 {
            100.0
        } else {
            1.5 + turn(0.732)
        };
        let length = if pair % 4 == 0 {
            12.5
        } else {
            4.0 + turn(0.303)
        };
        for tenth in 0..200 {
            let at_s = f64::from(tenth) / 10.0;
            let jump = if pair == 38 && tenth > 45 { 6.0 } else { 0.0 };
            // Recorded speeds of standing vehicles are not exactly zero.
            let leader = (speed - brake * (at_s - 4.0).clamp(0.0, lasts_s)).max(0.02) + jump;
            let x = 500.0 + speed * at_s;
            writeln!(text, "{tenth},{},{pair},{x:.3},{leader:.3},4.6", 2 * pair).unwrap();
            if pair < 39 {
                let behind = x - 4.6 - (0.7 + 1.6 * turn(0.236)) * speed;
                writeln!(
                    text,
                    "{tenth},{},{pair},{behind:.3},{:.3},{length:.3}",
                    2 * pair + 1,
                    speed * (0.95 + 0.1 * turn(0.17))
                )
                .unwrap();
            }
        }
    }
    let map = RecordingMap::from_toml(TRACKS, Path::new("m.toml")).unwrap();
    read(text.as_bytes(), Path::new("pairs.csv"), Some(&map)).unwrap()
}

#[test]
fn each_recorded_episode_is_in_the_space_or_counted_as_excluded() {
    let extraction = ExtractionConfig {
        vehicles: 2,
        min_brake: MinBrake::default(),
        leaders: LeaderSelection::Any,
    };
    let sample = EpisodeSample::from_recordings(&[pairs_in_lanes(2.0)], extraction).unwrap();
    let exclusions = ExclusionCounts {
        no_follower: 1,
        impossible_speeds: 1,
        ..ExclusionCounts::default()
    };
    assert_eq!(
        (
            sample.exclusions,
            sample.exposure.episodes,
            sample.exposure.undescribed_brakings
        ),
        (exclusions, 38, 1)
    );
    assert_eq!(sample.exposure.sources[0].undescribed_brakings, 1);
    // 39 leaders with a follower, for 19.9 s each; braking cannot begin in the last second.
    assert!(
        (sample.exposure.hours * 3600.0 - 39.0 * 18.9).abs() < 1e-6,
        "{}",
        sample.exposure.hours
    );
    let [leaders, followers] = &sample.sizes[..] else {
        panic!("{:?}", sample.sizes)
    };
    assert_eq!(
        (leaders.light, leaders.light_m, leaders.heavy),
        (38, 4.6, 0)
    );
    assert_eq!(
        (followers.light, followers.heavy, followers.heavy_m),
        (28, 10, 12.5)
    );
    let FittedSpace {
        space,
        features: numbers,
        sizes,
        copula_parameters: depending,
        ..
    } = fit(&sample, &options("mine")).unwrap();
    let point = numbers[2].point_mass.expect("some stand");
    assert_eq!(
        (
            point.at,
            point.count,
            numbers[2].chosen.distribution.build().unwrap().cdf(0.0)
        ),
        (0.0, 8, 0.0)
    );
    assert_eq!(
        (sizes[0].values[1].at, sizes[0].values[1].count),
        (12.5, 10)
    );
    assert_eq!(depending.len(), 6);
    let about = &space.spec().about;
    for message in [
        "1 episodes without a known follower",
        "1 episodes with impossible speeds",
        "10 heavy ones (median 12.5 m)",
    ] {
        assert!(about.contains(message), "{about}");
    }
    let drawn: Vec<_> = (0..400)
        .map(|index| space.draw(1, index).unwrap())
        .collect();
    let heavy = drawn
        .iter()
        .filter(|scenario| scenario.vehicles()[1].class == VehicleClass::Heavy);
    assert!(
        (70..140).contains(&heavy.clone().count()),
        "a quarter are lorries: {}",
        heavy.count()
    );
    assert!(
        drawn
            .iter()
            .all(|scenario| [4.6].contains(&scenario.vehicles()[0].length_m()))
    );
    // At every corner of the space, braking ends ten seconds before the end.
    let tried = drawn.into_iter().chain((0..32).map(|corner| {
        let at = |bit: usize| f64::from(corner >> bit & 1);
        space
            .scenario_at(&[at(0), at(1), at(2), at(3), at(4), 0.5])
            .unwrap()
    }));
    for scenario in tried {
        let leader = &scenario.vehicles()[0];
        let Driver::Profile(LeadProfile::BrakeToSpeed(brake)) = &leader.driver else {
            panic!("{leader:?}")
        };
        let over_s = brake.onset_s + (leader.speed_mps - brake.final_speed_mps) / brake.rate_mps2;
        assert!(over_s + 10.0 <= scenario.spec().duration_s, "{over_s}");
    }
}

#[test]
fn thresholds_are_kept_and_unobservable_values_are_named() {
    let extraction = |mps2| ExtractionConfig {
        vehicles: 2,
        min_brake: MinBrake::new(mps2).unwrap(),
        leaders: LeaderSelection::Any,
    };
    assert_eq!(features(&extraction(11.5))[1].range, [11.5, 12.0]);
    assert!(matches!(
        EpisodeSample::from_recordings(&[], extraction(12.0)),
        Err(FitError::MinBrake { .. })
    ));
    let header = "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps
";
    let rows: String = (0..30)
        .map(|second| {
            format!(
                "1,{second},30,20,0,20
"
            )
        })
        .collect();
    let slow = read(
        format!("{header}{rows}").as_bytes(),
        Path::new("slow.csv"),
        None,
    )
    .unwrap();
    let message = EpisodeSample::from_recordings(&[slow], extraction(1.3))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("; slow.csv: the speeds of a vehicle are 1.000 s apart"),
        "{message}"
    );
}

#[test]
fn a_fit_to_samples_of_a_space_recovers_the_space() {
    let space = dependent_space();
    let observed = observe_draws(&space, 2000, 9);
    let refitted = refit(space.spec(), &observed).unwrap();
    for u in [0.02, 0.2, 0.5, 0.8, 0.98] {
        for (before, after) in space
            .spec()
            .parameters
            .iter()
            .zip(&refitted.spec().parameters)
        {
            let [a, b] = [before, after].map(|parameter| parameter.distribution.build().unwrap());
            let off = (a.cdf(b.quantile(u)) - u).abs();
            assert!(off < 0.03, "{}: {off} at {u}", before.name);
        }
    }
    let text = file::to_toml(&refitted).unwrap();
    let read = file::from_toml(&text, Path::new("again.toml"), &NoDriverFiles).unwrap();
    assert_eq!(read.draw(3, 4), refitted.draw(3, 4));
    let paired = ObservedData {
        braking_clusters: (0..2000).map(|index| index / 2).collect(),
        ..observed
    };
    let resampled = resample(&paired, 1, 0);
    assert_eq!(
        (
            resampled.braking_clusters.len(),
            resampled.parameters[0].values.len()
        ),
        (2000, 2000)
    );
    assert!(resampled.parameters[0].values.chunks(2).all(|pair| {
        let at = paired.parameters[0]
            .values
            .iter()
            .position(|value| value == &pair[0])
            .unwrap();
        paired.parameters[0].values[at + 1] == pair[1]
    }));
    assert_ne!(resampled, resample(&paired, 1, 1));
    assert_eq!(resampled, resample(&paired, 1, 0));
}
