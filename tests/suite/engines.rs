//! The batch engine gives the scalar engine's results to the last bit, whatever shares a batch, on any number of
//! threads.

use crumple_fuzzing::RunSetup;
use crumple_fuzzing::oracle::result_bits;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    AfterCollision, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};
use crumple_sim::scenario::{PaperDistribution, Scenario};
use crumple_testing::generator::{DriverKind, ScenarioShape};
use proptest::prelude::*;

use crate::generate::{
    any_after_collision, any_scenario_of_shape, any_setup, any_shape, with_cases,
};

type ScenarioSetup = (Scenario, RunSetup);

/// A shape and a variant that differs in one property, with a few shuffled runs of each: runs of one shape share a
/// batch, runs of the variant must not join it.
fn any_batch() -> impl Strategy<Value = Vec<ScenarioSetup>> {
    let alike = |shape: &ScenarioShape, setup: &RunSetup| {
        let setup = setup.clone();
        let after = move |after_collision| RunSetup {
            after_collision,
            ..setup.clone()
        };
        prop::collection::vec(
            (
                any_scenario_of_shape(shape),
                any_after_collision().prop_map(after),
            ),
            1..8,
        )
    };
    (
        any_shape(),
        any_setup(),
        any::<u8>().prop_map(DriverKind::non_nominal),
        0..5_u8,
    )
        .prop_flat_map(move |(shape, setup, kind, difference)| {
            let (mut other, mut other_setup) = (shape.clone(), setup.clone());
            match difference {
                0 => other.step_s = if shape.step_s == 0.05 { 0.1 } else { 0.05 },
                1 => other.drivers[0] = kind,
                2 => other.drivers.push(kind),
                3 => other_setup.substeps += 1,
                _ => other_setup.estimator = setup.other_estimator(),
            }
            (alike(&shape, &setup), alike(&other, &other_setup))
        })
        .prop_map(|(these, those)| [these, those].concat())
        .prop_shuffle()
}

fn build_runs<'s>(cases: impl IntoIterator<Item = &'s ScenarioSetup>) -> Vec<Run> {
    let run = |(scenario, setup): &'s ScenarioSetup| {
        Run::new(scenario, setup.options(scenario.spec().step_s)).expect("fits")
    };
    cases.into_iter().map(run).collect()
}

fn batch_bits(runs: &[Run], keep: RecordingLevel, threads: usize) -> Vec<Vec<u64>> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads");
    pool.install(|| simulate_batch(runs, keep, |_, result| result_bits(&result)))
}

proptest! {
    #![proptest_config(with_cases(256))]

    /// Traces, impacts and summaries of a mixed batch equal those of single runs, on any number of threads, in any
    /// order.
    #[test]
    fn a_batch_is_its_runs_one_by_one(batch in any_batch()) {
        let runs = build_runs(&batch);
        for keep in [RecordingLevel::Trace, RecordingLevel::Summary] {
            let one_by_one: Vec<_> = runs.iter().map(|run| result_bits(&simulate(run, keep))).collect();
            for threads in 1..=3 {
                let together = batch_bits(&runs, keep, threads);
                for (index, (one, other)) in one_by_one.iter().zip(&together).enumerate() {
                    prop_assert!(one == other, "run {index} differs with {keep:?} and {threads} threads");
                }
                prop_assert_eq!(together.len(), runs.len());
            }
            let mut backwards = batch_bits(&build_runs(batch.iter().rev()), keep, 2);
            backwards.reverse();
            prop_assert!(backwards == one_by_one, "the other way round with {keep:?}");
        }
    }
}

/// More runs than one batch of 64 holds, all of one shape, with every controller: the paper's distribution.
#[test]
fn full_blocks_of_the_papers_distribution_agree_with_the_scalar_engine() {
    let draws: Vec<_> = (0..70)
        .map(|index| PaperDistribution { seed: 5 }.draw(index).unwrap())
        .collect();
    for controller in BuiltInController::all() {
        for after_collision in [AfterCollision::Stop, AfterCollision::Continue] {
            let options = RunOptions::new(controller.clone()).with_after_collision(after_collision);
            let runs: Vec<_> = draws
                .iter()
                .map(|draw| Run::new(draw, options.clone()).unwrap())
                .collect();
            let together = batch_bits(&runs, RecordingLevel::Summary, 3);
            for (run, bits_together) in runs.iter().zip(together) {
                let name = &run.scenario().spec().name;
                assert!(
                    result_bits(&simulate(run, RecordingLevel::Summary)) == bits_together,
                    "{name} {}",
                    controller.name()
                );
            }
        }
    }
}

/// The index given to `reduce` is that of the run, and results are in the order of the runs.
#[test]
fn results_come_back_in_order() {
    let draws: Vec<_> = (0..100)
        .map(|index| PaperDistribution { seed: 6 }.draw(index).unwrap())
        .collect();
    let options = RunOptions::new(BuiltInController::from_name("match-leader").unwrap());
    let runs: Vec<_> = draws
        .iter()
        .map(|draw| Run::new(draw, options.clone()).unwrap())
        .collect();
    let indices = simulate_batch(&runs, RecordingLevel::Summary, |index, _| index);
    assert_eq!(indices, (0..100).collect::<Vec<_>>());
    assert!(simulate_batch(&[], RecordingLevel::Trace, |index, _| index).is_empty());
}
