//! Closed-loop rollouts: time to observe, decide and move one vehicle by one step.
//!
//! `cargo bench --bench rollout`. The counted item is one vehicle-step; a run that ends at a collision counts its
//! steps. Random scenarios of the paper's distribution with its noise; every vehicle but the leader is under test, with
//! the Kalman filter where stated. The time includes the setup of the engine.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Scenario;
use crumple_world::sim::{RecordingLevel, Run, simulate, simulate_batch};
use divan::Bencher;
use divan::counter::ItemsCount;
use rayon::ThreadPool;

#[path = "work/rollouts.rs"]
#[allow(dead_code, missing_docs, unreachable_pub, reason = "shared with other benches, none of which needs all of it")]
mod rollouts;

fn main() {
    divan::main();
}

const RUNS: u64 = 1024;
const CASES: [(&str, EstimatorKind); 7] = [
    ("baseline", EstimatorKind::Truth),
    ("baseline", EstimatorKind::Kalman),
    ("match-leader", EstimatorKind::Truth),
    ("match-leader", EstimatorKind::Kalman),
    ("idm", EstimatorKind::Truth),
    ("idm", EstimatorKind::Kalman),
    ("predictive", EstimatorKind::Kalman),
];

fn runs((controller, estimator): (&str, EstimatorKind), scenarios: &[Scenario]) -> Vec<Run> {
    rollouts::runs(scenarios, rollouts::built_in(controller), estimator)
}

fn thread_pool(count: usize) -> ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads")
}

fn lockstep(bencher: Bencher<'_, '_>, case: (&str, EstimatorKind), thread_count: usize) {
    let scenarios = rollouts::scenarios(RUNS);
    let runs = runs(case, &scenarios);
    let threads = thread_pool(thread_count);
    bencher
        .counter(ItemsCount::new(rollouts::vehicle_steps(&runs)))
        .bench_local(|| threads.install(|| simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome)));
}

#[divan::bench(args = CASES, sample_count = 20)]
fn lockstep_one_core(bencher: Bencher<'_, '_>, case: (&str, EstimatorKind)) {
    lockstep(bencher, case, 1);
}

#[divan::bench(args = CASES, sample_count = 20)]
fn lockstep_two_cores(bencher: Bencher<'_, '_>, case: (&str, EstimatorKind)) {
    lockstep(bencher, case, 2);
}

#[divan::bench(args = CASES, sample_count = 10)]
fn scalar_engine(bencher: Bencher<'_, '_>, case: (&str, EstimatorKind)) {
    let scenarios = rollouts::scenarios(RUNS);
    let runs = runs(case, &scenarios);
    bencher
        .counter(ItemsCount::new(rollouts::vehicle_steps(&runs)))
        .bench_local(|| runs.iter().map(|run| simulate(run, RecordingLevel::Summary).outcome).collect::<Vec<_>>());
}
