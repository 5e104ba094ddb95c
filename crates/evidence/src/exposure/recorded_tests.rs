//! Failure rates per hour of recordings whose rate is known, from the rows of the file to the interval.

use std::fmt::Write;
use std::path::Path;

use rand::RngExt;
use rand_distr::{Distribution, Gamma, LogNormal, Poisson};

use super::*;
use crate::fit::{EpisodeSample, ExtractionConfig, FitOptions, fit};
use crumple_exchange::recording::{LeaderSelection, MinBrake, read};
use crumple_sim::control::BuiltInController;
use crumple_sim::random::{Purpose, Stream, stream};

/// Time between rows of an episode, and its number of rows.
const STEP_S: f64 = 0.25;
const ROWS: u32 = 28;
/// Length of an episode, less the last second, in which no braking can begin.
const EPISODE_S: f64 = STEP_S * (ROWS - 1) as f64 - 1.0;

/// Traffic with independent decelerations and time gaps, and a controller that fails if the gap is short for the
/// deceleration.
struct KnownTraffic {
    episodes_per_hour: f64,
    hours: f64,
    /// Shape and scale, in m/s²; only decelerations that make episodes.
    brake: (f64, f64),
    /// Mean and standard deviation of the logarithm of the time gap in seconds.
    ln_gap: (f64, f64),
    /// Smallest time gap that prevents the failure, divided by the deceleration, in s³/m.
    limit: f64,
}

impl KnownTraffic {
    fn new(index: u32) -> Self {
        let turn = |step: f64| (f64::from(index) * step).fract();
        let episodes_per_hour = 8.0 + 16.0 * turn(0.618);
        Self {
            episodes_per_hour,
            // 40 to 120 episodes.
            hours: (40.0 + 80.0 * turn(0.414)) / episodes_per_hour,
            brake: (4.0 + 4.0 * turn(0.732), 0.4 + 0.2 * turn(0.303)),
            ln_gap: (0.3 + 0.3 * turn(0.236), 0.25 + 0.2 * turn(0.17)),
            limit: 0.25 + 0.15 * turn(0.55),
        }
    }

    /// Returns deceleration and time gap of an episode.
    fn draw(&self, random: &mut Stream) -> [f64; 2] {
        let brake = Gamma::new(self.brake.0, self.brake.1).unwrap();
        let gap = LogNormal::new(self.ln_gap.0, self.ln_gap.1).unwrap();
        let mut draw = |one: &dyn Fn(&mut Stream) -> f64, range: [f64; 2]| {
            std::iter::repeat_with(|| one(random))
                .find(|value| (range[0]..range[1]).contains(value))
                .unwrap()
        };
        [
            draw(&|random| brake.sample(random), [1.31, 11.5]),
            draw(&|random| gap.sample(random), [0.1, 20.0]),
        ]
    }

    fn fails(&self, brake_mps2: f64, gap_s: f64) -> bool {
        gap_s < self.limit * brake_mps2
    }

    fn failures_per_hour(&self, random: &mut Stream) -> f64 {
        const DRAWS: u32 = 100_000;
        let failed = (0..DRAWS).filter(|_| {
            let [brake_mps2, gap_s] = self.draw(random);
            self.fails(brake_mps2, gap_s)
        });
        self.episodes_per_hour * failed.count() as f64 / f64::from(DRAWS)
    }

    /// Returns a recording with a random number of brakings, and free driving for the rest of the time.
    fn record(&self, random: &mut Stream) -> String {
        let mut text =
            "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n"
                .to_owned();
        let episodes = Poisson::new(self.episodes_per_hour * self.hours)
            .unwrap()
            .sample(random) as u32;
        for event in 0..episodes {
            let [brake_mps2, time_gap_s] = self.draw(random);
            let (lead_mps, share) = (
                20.0 + 10.0 * random.random::<f64>(),
                0.95 + 0.1 * random.random::<f64>(),
            );
            let braking_s = if random.random() { 1.25 } else { 1.5 };
            let leader_mps = |at_s: f64| lead_mps - brake_mps2 * (at_s - 3.0).clamp(0.0, braking_s);
            // The follower brakes half a second later.
            let follower_mps = |at_s: f64| share * leader_mps(at_s - 0.5);
            let mut gap_m = time_gap_s * share * lead_mps;
            for row in 0..ROWS {
                let at_s = STEP_S * f64::from(row);
                let [leader, follower] = [leader_mps(at_s), follower_mps(at_s)];
                writeln!(
                    text,
                    "{event},{at_s},{gap_m:.4},{follower:.4},{:.4},{leader:.4}",
                    leader - follower
                )
                .unwrap();
                let [next_leader, next_follower] =
                    [leader_mps(at_s + STEP_S), follower_mps(at_s + STEP_S)];
                gap_m += 0.5 * STEP_S * (leader + next_leader - follower - next_follower);
            }
        }
        let rest_s = 3600.0 * self.hours - EPISODE_S * f64::from(episodes);
        for row in 0..=(2.0 * (rest_s + 1.0)) as u32 {
            writeln!(text, "free,{},30,20,0,20", f64::from(row) / 2.0).unwrap();
        }
        text
    }
}

/// If each interval holds the truth with a probability of 95 %, fewer than 10 of 12 hold it with a probability of 2 %
/// (binomial distribution). The seed is fixed.
#[test]
fn intervals_contain_the_true_rates_of_recordings() {
    let extraction = ExtractionConfig {
        vehicles: 2,
        min_brake: MinBrake::default(),
        leaders: LeaderSelection::Any,
    };
    let mut covered = 0;
    for index in 0..12 {
        let traffic = KnownTraffic::new(index);
        let random = &mut stream(u64::from(index), Purpose::Search, 54);
        let recording = read(
            traffic.record(random).as_bytes(),
            Path::new("known.csv"),
            None,
        )
        .unwrap();
        assert_eq!(recording.dropped, [], "{index}");
        let sample = EpisodeSample::from_recordings(&[recording], extraction).unwrap();
        assert!(
            (sample.exposure.hours - traffic.hours).abs() < 1e-3,
            "{} {}",
            sample.exposure.hours,
            traffic.hours
        );
        let options = FitOptions {
            name: "known".to_owned(),
            follower: BuiltInController::from_name("baseline").unwrap(),
            samples: 19,
            seed: 0,
        };
        let space = fit(&sample, &options).unwrap().space;
        let coordinate_of = |name: &str| {
            space
                .parameters()
                .iter()
                .position(|parameter| parameter.name() == name)
                .unwrap()
        };
        let [brake, gap] = ["lead_brake_mps2", "time_gap_1_s"].map(coordinate_of);
        let mut failures = |space: &ScenarioSpace, seed: u64, runs: u64| {
            let fails = |index| {
                let values = space.values(&space.draw_point(seed, index));
                traffic.fails(values[brake], values[gap])
            };
            Ok::<_, std::convert::Infallible>((0..runs).filter(|&index| fails(index)).count() as u64)
        };
        let runs = 2000;
        let failed = failures(&space, 0, runs).unwrap();
        let probability = FailureProbability::Counted {
            failures: failed,
            unknown: 0,
            runs,
        };
        let resamples = count_on_resamples(&space, 0, 79, 200, &mut failures)
            .unwrap()
            .unwrap();
        let rate = RatePerExposure::new(&space, probability, Ok(&resamples)).unwrap();
        let interval = rate.with_data_uncertainty.unwrap().rates.per_hour;
        let truth = traffic.failures_per_hour(random);
        let holds = (interval.lower..=interval.upper).contains(&truth);
        println!(
            "{} episodes, {truth:.3} failures an hour, {interval:.3?}, {holds}",
            sample.exposure.episodes
        );
        covered += u32::from(holds);
    }
    println!("{covered} of 12 intervals hold the rate per hour");
    assert!(covered >= 10, "{covered}");
}
