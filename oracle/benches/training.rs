//! Training and inference: time of one update and of one decision.
//!
//! `cargo bench -p crumple-oracle` compares the hand-written update, the plain formulation on candle, and the matrix
//! products of an update on candle, in one run, on one thread. The counted item is a floating-point operation of the
//! matrix products. Upper bounds are one large product of candle and of this project; the bench `targets` measures
//! multiply-adds in registers, and lockstep rollouts.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use candle_core::{Device, Tensor};
use crumple_oracle::ReferenceLearner;
use crumple_world::policy::{FrameStack, Workspace};
use crumple_world::random::{Purpose, stream};
use divan::Bencher;
use divan::counter::ItemsCount;

#[path = "../../benches/work/networks.rs"]
#[allow(dead_code, missing_docs, unreachable_pub, reason = "shared with other benches, none of which needs all of it")]
mod networks;

use networks::{
    LARGE_PRODUCT_SIZE, acting_operations, batch, config, large_product, learner, observations, operations, products,
    random_policy,
};

fn main() {
    // One thread: trainings run in parallel, not the products of one training.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("threads");
    divan::main();
}

const PAPER: (&str, usize, usize) = ("3 x 256, batch 512", 256, 512);
const FAST: (&str, usize, usize) = ("3 x 64, batch 128", 64, 128);

fn items_count(products: &[[usize; 3]]) -> ItemsCount {
    ItemsCount::new(operations(products))
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn update_by_hand(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let mut learner = learner(&config(width, count));
    let (batch, mut noise) = (batch(count), stream(1, Purpose::TargetNoise, 0));
    bencher.counter(items_count(&products(width, count, 1))).bench_local(|| learner.update(&batch, &mut noise));
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn update_on_candle(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let config = config(width, count);
    let mut oracle = ReferenceLearner::new(&learner(&config), &config.learning, &config.td3).expect("tensors");
    let (batch, mut noise) = (batch(count), stream(1, Purpose::TargetNoise, 0));
    let counter = items_count(&products(width, count, 1));
    bencher.counter(counter).bench_local(|| oracle.update(&batch, &mut noise).expect("tensors"));
}

fn random_tensor(rows: usize, columns: usize) -> Tensor {
    Tensor::rand(-1.0_f32, 1.0, (rows, columns), &Device::Cpu).expect("a tensor")
}

#[divan::bench(args = [PAPER, FAST], sample_count = 40, sample_size = 1)]
fn products_of_an_update_on_candle(bencher: Bencher<'_, '_>, (_, width, count): (&str, usize, usize)) {
    let products = products(width, count, 1);
    let factors: Vec<_> = products.iter().map(|&[m, k, n]| (random_tensor(m, k), random_tensor(k, n))).collect();
    bencher.counter(items_count(&products)).bench_local(|| {
        for (left, right) in &factors {
            divan::black_box(left.matmul(right).expect("shapes fit"));
        }
    });
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn a_large_product_on_candle(bencher: Bencher<'_, '_>) {
    let (left, right) =
        (random_tensor(LARGE_PRODUCT_SIZE, LARGE_PRODUCT_SIZE), random_tensor(LARGE_PRODUCT_SIZE, LARGE_PRODUCT_SIZE));
    bencher.counter(items_count(&[[LARGE_PRODUCT_SIZE; 3]])).bench_local(|| left.matmul(&right).expect("shapes fit"));
}

/// Measures a wide network on many states: one large product, and little else.
#[divan::bench(sample_count = 20, sample_size = 1)]
fn a_large_product_by_hand(bencher: Bencher<'_, '_>) {
    let (mut learner, states, operations) = large_product();
    let counter = ItemsCount::new(operations);
    bencher.counter(counter).bench_local(|| learner.act(&states)[0]);
}

#[divan::bench(args = [64, 256])]
fn act_on_one_state(bencher: Bencher<'_, '_>, width: usize) {
    let (policy, seen, mut space) = (random_policy(width), observations(1), Workspace::default());
    let mut past = FrameStack::default();
    let bencher = bencher.counter(ItemsCount::new(acting_operations(width)));
    bencher.bench_local(|| policy.choose(policy.observe(&seen[0], 0.0, &mut past), &mut space));
}

#[divan::bench(args = [64, 256])]
fn act_on_512_states(bencher: Bencher<'_, '_>, width: usize) {
    let (policy, seen, mut space) = (random_policy(width), observations(512), Workspace::default());
    let mut actions = vec![0.0; seen.len()];
    let counter = ItemsCount::new(seen.len() * acting_operations(width));
    bencher.counter(counter).bench_local(|| {
        let rows: Vec<f32> =
            seen.iter().flat_map(|seen| policy.observe(seen, 0.0, &mut FrameStack::default()).to_vec()).collect();
        policy.choose_batch(&rows, &mut space, &mut actions);
    });
}
