//! Inference and training, compared with the machine's speed of matrix products.

use std::hint::black_box;
use std::sync::Arc;

use crumple_learn::rl::{EvaluationSet, Learner, Trainer, TrainingConfig};
use crumple_sim::engine::{RecordingLevel, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::{Purpose, stream};

use crate::clock::{cpu_time_s, min_cpu_time_s, min_wall_time_s};
use crate::limits::register_operations_per_second;
use crate::table::Measurement;
use crate::work::networks::{
    self, acting_operations, batch, config, large_product, learner, operations, products,
    random_policy, td3,
};
use crate::work::rollouts::{runs, scenarios, steps};

pub fn measure(say: &mut dyn FnMut(Measurement)) {
    let registers = register_operations_per_second();
    compare_with_peak(registers, say);
    let [td3_s] = min_cpu_time_s(60, [&mut batch_updates(&td3(64, 128), 128, 1)]);
    say(Measurement::at_most(
        0.38,
        "ms",
        "TD3 step, 3 x 64, batch 128, two critics",
        1e3 * td3_s,
    ));
    let peak_share = 100.0 * operations(&products(64, 128, 2)) as f64 / td3_s / registers;
    say(Measurement::at_least(
        35.0,
        "%",
        "the same, share of fused multiply-adds in registers",
        peak_share,
    ));
    let [one, two] = [1, 2].map(|count| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(count)
            .build()
            .expect("threads")
    });
    let [mut alone, mut together] = [0; 2].map(|_| batch_updates(&config(256, 512), 512, 8));
    let [one_s, two_s] = min_wall_time_s(
        8,
        [&mut || one.install(&mut alone), &mut || {
            two.install(&mut together)
        }],
    );
    let name = "DDPG update, 3 x 256, batch 512, two threads against one (wall clock)";
    say(Measurement::at_least(1.7, "times", name, one_s / two_s));
}

fn batch_updates(config: &TrainingConfig, count: usize, each: usize) -> impl FnMut() + use<> {
    let mut learner: Learner = learner(config);
    let (batch, mut noise) = (batch(count), stream(1, Purpose::TargetNoise, 0));
    move || {
        for _ in 0..each {
            black_box(learner.update(&batch, &mut noise));
        }
    }
}

/// Measures rollouts and updates relative to a large product and to `registers`, the result of
/// [`register_operations_per_second`].
fn compare_with_peak(registers: f64, say: &mut dyn FnMut(Measurement)) {
    let (mut large, states, large_operations) = large_product();
    let scenarios = scenarios(64);
    let runs = runs(
        &scenarios,
        Arc::new(random_policy(256)),
        EstimatorKind::Truth,
    );
    let acts = |index: usize, result| 2 * steps(&runs[index], &result);
    let acts: usize = simulate_batch(&runs, RecordingLevel::Summary, acts)
        .iter()
        .sum();
    let [large_s, rollouts_s, update_s] = min_cpu_time_s(
        12,
        [
            &mut || _ = black_box(large.act(&states)[0]),
            &mut || {
                _ = black_box(simulate_batch(
                    &runs,
                    RecordingLevel::Summary,
                    |_, result| result.outcome,
                ))
            },
            &mut batch_updates(&config(256, 512), 512, 1),
        ],
    );
    let speed = |operations: usize, seconds: f64| operations as f64 / seconds;
    let peak = speed(large_operations, large_s);
    let share_of = |limit, operations, seconds| 100.0 * speed(operations, seconds) / limit;
    let name = format!(
        "lockstep rollouts, 3 x 256 actor, share of a large product ({:.0} billion operations a second)",
        peak / 1e9
    );
    say(Measurement::at_least(
        70.0,
        "%",
        name,
        share_of(peak, acts * acting_operations(256), rollouts_s),
    ));
    let name = format!(
        "DDPG update, 3 x 256, batch 512 ({:.2} ms), share of the large product",
        1e3 * update_s
    );
    let updating = operations(&products(256, 512, 1));
    say(Measurement::at_least(
        80.0,
        "%",
        name,
        share_of(peak, updating, update_s),
    ));
    let name = "lockstep rollouts, 3 x 256 actor, share of fused multiply-adds in registers";
    say(Measurement::at_least(
        60.0,
        "%",
        name,
        share_of(registers, acts * acting_operations(256), rollouts_s),
    ));
    let name = "DDPG update, 3 x 256, batch 512, share of fused multiply-adds in registers";
    say(Measurement::at_least(
        60.0,
        "%",
        name,
        share_of(registers, updating, update_s),
    ));
}

/// Measures the processor time in seconds until an evaluation finds every held-out scenario safe: the median over
/// seeds.
pub fn time_to_first_safe(seeds: u64, say: &mut dyn FnMut(Measurement)) {
    let config = TrainingConfig::preset("fast").expect("a preset");
    let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
    let mut times_s: Vec<f64> = (0..seeds)
        .map(|seed| time_to_safe_s(&config, &held_out, seed))
        .collect();
    times_s.sort_by(f64::total_cmp);
    let middle = times_s.len() / 2;
    let median_s = (times_s[middle] + times_s[times_s.len().div_ceil(2).max(1) - 1]) / 2.0;
    let name = format!(
        "`train --preset fast` to the first evaluation without collision, median of {seeds} seeds"
    );
    say(Measurement::at_most(10.0, "s", name, median_s));
}

fn time_to_safe_s(config: &TrainingConfig, held_out: &EvaluationSet, seed: u64) -> f64 {
    let start_s = cpu_time_s();
    let mut trainer = Trainer::new(config, seed);
    let is_safe =
        |trainer: &mut Trainer| trainer.evaluate(held_out).expect("fits").is_mastered(0.0);
    while !(trainer.is_evaluation_due() && is_safe(&mut trainer)) {
        if trainer.is_done() {
            return f64::INFINITY;
        }
        trainer.run_episode().expect("converges");
    }
    cpu_time_s() - start_s
}

/// Measures training decisions per second: inference, the environment's step, replay sampling and one update each.
pub fn decisions_per_second(width: usize, count: usize) -> f64 {
    let mut config = networks::config(width, count);
    config.exploration.learning_starts_episode = 0;
    config.learning.decisions_per_update = 1;
    config.environment.action_repeat = 10;
    let mut trainer = Trainer::new(&config, 1);
    let mut made = || {
        trainer.run_episode().expect("converges").steps / config.environment.action_repeat as usize
    };
    // Updates begin when the replay memory contains a batch.
    let mut decisions = 0;
    while decisions < count {
        decisions += made();
    }
    let (start_s, mut decisions) = (cpu_time_s(), 0);
    while cpu_time_s() - start_s < 2.0 {
        decisions += made();
    }
    decisions as f64 / (cpu_time_s() - start_s)
}
