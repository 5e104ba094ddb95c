//! The two engines are one: the batch engine gives the scalar engine's results to the last bit, whatever shares a block,
//! on any number of threads.

use crumple::scenario::{ControllerSpec, PaperDistribution, Scenario};
use crumple::sim::{AfterContact, Keep, Run, RunOptions, Simulated, Track, simulate, simulate_batch};
use proptest::prelude::*;

use crate::generate::{Setup, any_after_contact, any_setup, any_shape, cases, scenario_of};

/// Everything a result holds, as bits: 0 and -0 are different here.
fn bits(result: &Simulated) -> Vec<u64> {
    let mut numbers: Vec<f64> = Vec::new();
    for impact in &result.impacts {
        let contact = &impact.contact;
        let indices = [contact.front_vehicle, contact.rear_vehicle, impact.first_involved, impact.last_involved];
        numbers.extend(indices.map(|index| index as f64));
        numbers.extend([contact.time_s, contact.front_speed_mps, contact.rear_speed_mps]);
        numbers.extend([contact.impact_speed_mps, impact.common_speed_mps]);
    }
    for vehicle in &result.vehicles {
        let absent = f64::from_bits(u64::MAX);
        numbers.extend([vehicle.min_gap_m.unwrap_or(absent), vehicle.min_ttc_s.unwrap_or(absent)]);
        numbers.extend([vehicle.max_brake_mps2, f64::from(vehicle.stopped)]);
    }
    if let Some(trace) = &result.trace {
        numbers.extend(&trace.time_s);
        for Track { position_m, speed_mps, acceleration_mps2, .. } in &trace.vehicles {
            numbers.extend([position_m, speed_mps, acceleration_mps2].into_iter().flatten());
        }
    }
    numbers.into_iter().map(f64::to_bits).collect()
}

/// A scenario and how to run it.
type Case = (Scenario, Setup, AfterContact);

/// A few shapes with a few runs of each, shuffled: runs of one shape share a block and differ in everything else.
fn batch() -> impl Strategy<Value = Vec<Case>> {
    let alike = (any_shape(), any_setup()).prop_flat_map(|(shape, setup)| {
        prop::collection::vec((scenario_of(&shape), Just(setup), any_after_contact()), 1..8)
    });
    prop::collection::vec(alike, 1..4).prop_map(|shapes| shapes.concat()).prop_shuffle()
}

fn runs<'s>(cases: impl IntoIterator<Item = &'s Case>) -> Vec<Run<'s>> {
    let run = |(scenario, setup, after_contact): &'s Case| {
        Run::new(scenario, setup.options(scenario.spec().step_s, *after_contact)).expect("fits")
    };
    cases.into_iter().map(run).collect()
}

fn batch_bits(runs: &[Run<'_>], keep: Keep, threads: usize) -> Vec<Vec<u64>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(|| simulate_batch(runs, keep, |_, result| bits(&result)))
}

proptest! {
    #![proptest_config(cases(256))]

    /// Traces, impacts and summaries of a mixed batch are those of the runs one by one.
    #[test]
    fn a_batch_is_its_runs_one_by_one(batch in batch()) {
        let runs = runs(&batch);
        for keep in [Keep::Trace, Keep::Summary] {
            let one_by_one: Vec<_> = runs.iter().map(|run| bits(&simulate(run, keep))).collect();
            let together = simulate_batch(&runs, keep, |_, result| bits(&result));
            for (index, (one, other)) in one_by_one.iter().zip(&together).enumerate() {
                prop_assert!(one == other, "run {index} differs with {keep:?}");
            }
        }
    }

    /// Neither the number of threads nor the order of the runs reaches a result.
    #[test]
    fn threads_and_order_change_nothing(batch in batch()) {
        let forwards = batch_bits(&runs(&batch), Keep::Trace, 1);
        for threads in [2, 3] {
            prop_assert!(batch_bits(&runs(&batch), Keep::Trace, threads) == forwards, "{threads} threads");
        }
        let mut backwards = batch_bits(&runs(batch.iter().rev()), Keep::Trace, 2);
        backwards.reverse();
        prop_assert!(backwards == forwards, "the other way round");
    }
}

/// More runs than one block holds, all of one shape, with every controller: the paper's distribution.
#[test]
fn full_blocks_of_the_papers_distribution_agree_with_the_scalar_engine() {
    let draws: Vec<_> = (0..150).map(|index| PaperDistribution { seed: 5 }.draw(index).unwrap()).collect();
    for controller in ControllerSpec::built_in() {
        for after_contact in [AfterContact::Stop, AfterContact::Continue] {
            let options = RunOptions::new(controller.clone()).with_after_contact(after_contact);
            let runs: Vec<_> = draws.iter().map(|draw| Run::new(draw, options.clone()).unwrap()).collect();
            let together = batch_bits(&runs, Keep::Summary, 3);
            for (run, bits_together) in runs.iter().zip(together) {
                let name = &run.scenario().spec().name;
                assert!(bits(&simulate(run, Keep::Summary)) == bits_together, "{name} {}", controller.name());
            }
        }
    }
}

/// The index handed to `reduce` is that of the run, and results come back in the order of the runs.
#[test]
fn results_come_back_in_order() {
    let draws: Vec<_> = (0..100).map(|index| PaperDistribution { seed: 6 }.draw(index).unwrap()).collect();
    let options = RunOptions::new(ControllerSpec::named("match-leader").unwrap());
    let runs: Vec<_> = draws.iter().map(|draw| Run::new(draw, options.clone()).unwrap()).collect();
    let indices = simulate_batch(&runs, Keep::Summary, |index, _| index);
    assert_eq!(indices, (0..100).collect::<Vec<_>>());
    assert!(simulate_batch(&[], Keep::Trace, |index, _| index).is_empty());
}
