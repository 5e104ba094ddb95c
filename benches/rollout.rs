//! Closed-loop rollouts: time for a vehicle to be observed, decided for and moved by one step.
//!
//! `cargo bench --bench rollout`. The item counted is one vehicle-step; a run that ends at a contact counts the steps it
//! made. Draws of the paper's distribution with its noise, in which everybody but the leader is under test: two vehicles of
//! three have the controller and, where it says so, the Kalman filter. Setting the engine up is part of the time.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use crumple::estimate::EstimatorKind;
use crumple::scenario::{ControllerSpec, Driver, PaperDistribution, Scenario};
use crumple::sim::{Keep, Run, RunOptions, simulate, simulate_batch};
use divan::Bencher;
use divan::counter::ItemsCount;
use rayon::ThreadPool;

fn main() {
    divan::main();
}

const RUNS: u64 = 1024;
const CASES: [(&str, EstimatorKind); 6] = [
    ("baseline", EstimatorKind::Truth),
    ("baseline", EstimatorKind::Kalman),
    ("match-leader", EstimatorKind::Truth),
    ("match-leader", EstimatorKind::Kalman),
    ("idm", EstimatorKind::Truth),
    ("idm", EstimatorKind::Kalman),
];

fn scenarios() -> Vec<Scenario> {
    let draw = |index| {
        let drawn = PaperDistribution { seed: 1 }.draw(index).expect("valid");
        drawn.edited(|spec| spec.vehicles[2].driver = Driver::UnderTest).expect("still valid")
    };
    (0..RUNS).map(draw).collect()
}

fn runs<'s>(scenarios: &'s [Scenario], (controller, estimator): (&str, EstimatorKind)) -> Vec<Run<'s>> {
    let controller = ControllerSpec::named(controller).expect("built in");
    let options = RunOptions::new(controller).with_estimator(estimator);
    scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).expect("valid")).collect()
}

fn vehicle_steps(runs: &[Run<'_>]) -> ItemsCount {
    let made = simulate_batch(runs, Keep::Summary, |index, result| {
        let scenario = runs[index].scenario();
        let step_s = scenario.spec().step_s;
        let steps = result.outcome.contact().map_or(scenario.steps(), |contact| (contact.time_s / step_s) as usize + 1);
        steps * scenario.vehicles().len()
    });
    ItemsCount::new(made.into_iter().sum::<usize>())
}

fn threads(count: usize) -> ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads")
}

fn lockstep(bencher: Bencher<'_, '_>, case: (&str, EstimatorKind), thread_count: usize) {
    let scenarios = scenarios();
    let runs = runs(&scenarios, case);
    let threads = threads(thread_count);
    bencher
        .counter(vehicle_steps(&runs))
        .bench_local(|| threads.install(|| simulate_batch(&runs, Keep::Summary, |_, result| result.outcome)));
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
    let scenarios = scenarios();
    let runs = runs(&scenarios, case);
    bencher
        .counter(vehicle_steps(&runs))
        .bench_local(|| runs.iter().map(|run| simulate(run, Keep::Summary).outcome).collect::<Vec<_>>());
}
