use super::*;
use crumple_world::random::{Purpose, stream};
use crumple_world::scenario::space::{LogNormal, Normal, ShapeScale, Uniform, file};
use rand::RngExt;

/// A distribution with its parameters, cut where a scenario could be.
fn known() -> Vec<(Distribution, Family, [f64; 2], [f64; 2])> {
    let range = [0.2, 12.0];
    let [low, high] = range;
    vec![
        (Distribution::Uniform(Uniform { low: 1.0, high: 4.0 }), Family::Uniform, [1.0, 4.0], range),
        (Distribution::Normal(Normal { mean: 2.0, deviation: 1.2, low, high }), Family::Normal, [2.0, 1.2], range),
        (
            Distribution::LogNormal(LogNormal { ln_mean: 0.3, ln_deviation: 0.5, low, high }),
            Family::LogNormal,
            [0.3, 0.5],
            range,
        ),
        (Distribution::Gamma(ShapeScale { shape: 4.0, scale: 0.5, low, high }), Family::Gamma, [4.0, 0.5], range),
        (Distribution::Weibull(ShapeScale { shape: 2.0, scale: 2.2, low, high }), Family::Weibull, [2.0, 2.2], range),
    ]
}

fn drawn(distribution: &Distribution, count: usize, seed: u64) -> Vec<f64> {
    let (ready, mut random) = (distribution.ready().unwrap(), stream(seed, Purpose::Resampling, 0));
    (0..count).map(|_| ready.quantile(random.random())).collect()
}

/// 200 trials of 200 draws each: an interval at 95 % misses 18 times or more with a probability below 2 %, and these seeds are fixed.
#[test]
fn intervals_hold_the_parameters_of_known_distributions() {
    for (distribution, family, truth, range) in known() {
        let mut held = [0; 2];
        for trial in 0..200 {
            let fit = family.fit(&drawn(&distribution, 200, trial), range).unwrap();
            let intervals = fit.intervals_95.unwrap();
            for which in 0..2 {
                let [low, high] = intervals[which];
                held[which] += u32::from(low <= truth[which] && truth[which] <= high);
            }
        }
        println!("{}: {held:?} of 200 intervals hold the parameters", family.name());
        assert!(held.iter().all(|held| (183..=200).contains(held)), "{}: {held:?}", family.name());
    }
}

#[test]
fn the_family_that_values_were_drawn_from_is_chosen_most_often() {
    for (distribution, family, _, range) in known() {
        let chosen = |trial: u64| all_families(&drawn(&distribution, 1000, 1000 + trial), range).0.remove(0).family;
        let right = (0..40).filter(|&trial| chosen(trial) == family).count();
        println!("{}: chosen in {right} of 40", family.name());
        assert!(right >= 24, "{}: {right}", family.name());
    }
}

/// Samples of the fitted family are as far from their own fit as it says; of another family further.
#[test]
fn the_p_value_is_even_where_the_family_is_right() {
    let (distribution, family, _, range) = known().remove(2);
    let judged = |values: &mut Vec<f64>, family: Family, trial: u64| {
        values.sort_by(f64::total_cmp);
        let fit = family.fit(values, range).unwrap();
        Goodness::of(values, range, &fit, &fit.distribution.ready().unwrap(), (99, trial, 0))
    };
    let mut low = 0;
    for trial in 0..60 {
        let goodness = judged(&mut drawn(&distribution, 100, 500 + trial), family, trial);
        low += u32::from(goodness.cramer_von_mises_p <= 0.2);
    }
    assert!((4..=22).contains(&low), "{low} of 60 below 0.2");
    let two_humps: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 1.0 } else { 5.0 } + 0.01 * f64::from(i)).collect();
    let goodness = judged(&mut two_humps.clone(), Family::Normal, 0);
    assert!(goodness.cramer_von_mises_p <= 0.01 && goodness.kolmogorov_smirnov_p <= 0.01, "{goodness:?}");
}

/// A space with dependent parameters: three of a scenario with brake-to-speed.
fn dependent() -> Space {
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
    file::from_toml(text, Path::new("known.toml")).unwrap()
}

/// The estimate of a correlation of −0.3 from 2000 draws has a standard deviation of 0.02: one in seventy is off by more than 0.05.
#[test]
fn the_correlation_of_2000_draws_is_recovered() {
    let space = dependent();
    let truth = [[1.0, -0.3, 0.7], [-0.3, 1.0, 0.2], [0.7, 0.2, 1.0]];
    let (mut close, mut sums) = (0, [0.0; 3]);
    for seed in 0..30 {
        let draws: Vec<Vec<f64>> = (0..2000).map(|index| space.values(&space.draw_point(seed, index))).collect();
        let column = |which: usize| draws.iter().map(|draw| draw[which]).collect::<Vec<f64>>();
        let columns = [column(2), column(0), column(1)];
        let found = dependence::correlation(&columns.each_ref().map(Vec::as_slice));
        for (place, (row, column)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            let off: f64 = found[row][column] - truth[row][column];
            close += u32::from(off.abs() < 0.05);
            sums[place] += off / 30.0;
        }
    }
    println!("{close} of 90 correlations to 0.05, mean errors {sums:.4?}");
    assert!(close >= 86 && sums.iter().all(|mean| mean.abs() < 0.012), "{close} {sums:?}");
}

#[test]
fn a_fit_to_draws_of_a_space_gives_the_space_back() {
    let space = dependent();
    let draws: Vec<Vec<f64>> = (0..2000).map(|index| space.values(&space.draw_point(9, index))).collect();
    let observed = Observed {
        waves: (0..2000).collect(),
        parameters: space
            .parameters()
            .iter()
            .enumerate()
            .map(|(which, parameter)| ObservedParameter {
                name: parameter.name().to_owned(),
                low: parameter.range()[0],
                high: parameter.range()[1],
                values: draws.iter().map(|draw| draw[which]).collect(),
            })
            .collect(),
    };
    let again = refitted(space.spec(), &observed).unwrap();
    for u in [0.02, 0.2, 0.5, 0.8, 0.98] {
        for (before, after) in space.spec().parameters.iter().zip(&again.spec().parameters) {
            let [a, b] = [before, after].map(|parameter| parameter.distribution.ready().unwrap());
            let off = (a.share_below(b.quantile(u)) - u).abs();
            assert!(off < 0.03, "{}: {off} at {u}", before.name);
        }
    }
    // What was fitted is written and read as it is.
    let text = file::to_toml(&again).unwrap();
    let read = file::from_toml(&text, Path::new("again.toml")).unwrap();
    assert_eq!(read.draw(3, 4), again.draw(3, 4));
    // A resample keeps whole waves, and as many of them.
    let paired = Observed { waves: (0..2000).map(|index| index / 2).collect(), ..observed };
    let one = resampled(&paired, 1, 0);
    assert_eq!((one.waves.len(), one.parameters[0].values.len()), (2000, 2000));
    assert!(one.parameters[0].values.chunks(2).all(|pair| {
        let at = paired.parameters[0].values.iter().position(|value| value == &pair[0]).unwrap();
        paired.parameters[0].values[at + 1] == pair[1]
    }));
    assert_ne!(one, resampled(&paired, 1, 1));
    assert_eq!(one, resampled(&paired, 1, 0));
}
