//! Training and acting: time of one update and of one decision.
//!
//! `cargo bench --bench training`. `update` compares, in one run on one thread: the update by hand, the plain formulation
//! on candle, and the matrix products that an update contains, made by candle.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use candle_core::{Device, Tensor};
use crumple::estimate::{Neighbour, Observation};
use crumple::policy::{
    ActionBounds, Network, ObservationScaling, POLICY_VERSION, Policy, PolicyHeader, STATE, Workspace,
};
use crumple::random::{Purpose, stream};
use crumple::rl::{Batch, Learner, TrainingConfig, Transition, oracle::Oracle};
use divan::Bencher;
use rand::RngExt;

fn main() {
    // One thread: trainings run side by side, not inside one product.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("threads");
    divan::main();
}

const PAPER: (&str, usize, usize) = ("3 x 256, batch 512", 256, 512);
const FAST: (&str, usize, usize) = ("3 x 64, batch 128", 64, 128);

fn config(width: usize, batch: usize) -> TrainingConfig {
    let mut config = TrainingConfig::preset("paper-net").expect("a preset");
    config.network.hidden = vec![width; 3];
    config.learning.batch = batch;
    config
}

fn learner(config: &TrainingConfig) -> Learner {
    Learner::new(&config.network, &config.learning, &config.td3, 1)
}

fn batch(count: usize) -> Batch {
    let mut stream = stream(1, Purpose::ReplayDraw, 0);
    let mut batch = Batch::default();
    for _ in 0..count {
        let mut state = || std::array::from_fn(|_| stream.random_range(-1.0..1.0));
        let (state, next_state) = (state(), state());
        let (action, reward) = (stream.random_range(-1.0..1.0), stream.random_range(-1.0..1.0));
        batch.push(&Transition { state, action, reward, next_state, continues: true, contact: false });
    }
    batch
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn update_by_hand(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let mut learner = learner(&config(width, count));
    let (batch, mut noise) = (batch(count), stream(1, Purpose::TargetNoise, 0));
    bencher.bench_local(|| learner.update(&batch, &mut noise));
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn update_on_candle(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let config = config(width, count);
    let mut oracle = Oracle::new(&learner(&config), &config.learning, &config.td3).expect("tensors");
    let (batch, mut noise) = (batch(count), stream(1, Purpose::TargetNoise, 0));
    bencher.bench_local(|| oracle.update(&batch, &mut noise).expect("tensors"));
}

/// The products of one update as (rows, inner, columns).
///
/// Forward: actor', critic', critic, actor, critic again. Backward: inputs and weights of critic and actor, and inputs of
/// the critic once more for the actor's slope; the first layers' inputs need no slope.
fn products(width: usize, count: usize) -> Vec<[usize; 3]> {
    let forward = |inputs: usize| vec![[count, inputs, width], [count, width, width], [count, width, width]];
    let hidden_inputs = vec![[count, width, width]; 2];
    let weights = |inputs: usize| vec![[inputs, count, width], [width, count, width], [width, count, width]];
    let (actor, critic) = (STATE, STATE + 1);
    let mut all = Vec::new();
    for inputs in [actor, critic, critic, actor, critic] {
        all.extend(forward(inputs));
    }
    for _ in 0..3 {
        all.extend(hidden_inputs.clone());
    }
    all.extend(weights(critic));
    all.extend(weights(actor));
    all
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn products_of_an_update_on_candle(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let random =
        |rows: usize, columns: usize| Tensor::rand(-1.0_f32, 1.0, (rows, columns), &Device::Cpu).expect("a tensor");
    let factors: Vec<_> = products(width, count).into_iter().map(|[m, k, n]| (random(m, k), random(k, n))).collect();
    bencher.bench_local(|| {
        for (left, right) in &factors {
            divan::black_box(left.matmul(right).expect("shapes fit"));
        }
    });
}

fn policy(width: usize) -> Policy {
    let hidden = vec![width; 3];
    let mut network = Network::zeros(&[&[STATE], hidden.as_slice(), &[1]].concat());
    let mut stream = stream(1, Purpose::FirstWeights, 0);
    network.parameters_mut().iter_mut().for_each(|parameter| *parameter = stream.random_range(-0.1..0.1));
    let header = PolicyHeader {
        version: POLICY_VERSION,
        crumple: "bench".to_owned(),
        hidden,
        observation: ObservationScaling::default(),
        action: ActionBounds::default(),
        decision_interval_s: 0.1,
        estimator: crumple::estimate::EstimatorKind::Kalman,
        seed: 1,
        episode: 0,
        training: serde_json::Value::Null,
    };
    Policy::new(header, network).expect("valid")
}

fn seen(count: usize) -> Vec<Observation> {
    let neighbour = |gap_m| Some(Neighbour { gap_m, speed_mps: 20.0, acceleration_mps2: -1.0 });
    (0..count)
        .map(|index| Observation {
            speed_mps: 20.0 + index as f64 / 100.0,
            acceleration_mps2: -0.5,
            ahead: neighbour(15.0),
            behind: neighbour(12.0),
        })
        .collect()
}

#[divan::bench(args = [64, 256])]
fn act_on_one_state(bencher: Bencher<'_, '_>, width: usize) {
    let (policy, seen, mut space) = (policy(width), seen(1), Workspace::default());
    bencher.bench_local(|| policy.act(&seen[0], &mut space));
}

#[divan::bench(args = [64, 256])]
fn act_on_512_states(bencher: Bencher<'_, '_>, width: usize) {
    let (policy, seen, mut space) = (policy(width), seen(512), Workspace::default());
    let mut commands_mps2 = vec![0.0; seen.len()];
    bencher.bench_local(|| policy.act_all(&seen, &mut space, &mut commands_mps2));
}
