//! The lockstep engine: simulates many runs at once, on all cores.
//!
//! Runs with the same shape (number of vehicles, steps, kinds of drivers) form blocks. A block stores each quantity of
//! each vehicle as one array over its runs, so that a step consists of a few tight loops. Runs are independent, so
//! results depend neither on the blocks nor on the number of threads.

mod block;
mod column;
mod drivers;
mod followers;
mod leaders;
mod loops;
mod noise;
mod per_run;
mod view;

use std::cmp::Ordering;

use pulp::Arch;
use rayon::prelude::*;

use self::block::LockstepBlock;
use self::per_run::RunSet;
use super::{RecordingLevel, Run, SimulationResult, simulate};
use crate::control::BuiltInController;

/// Maximum number of runs in a block: enough to fill vector registers and hide latencies, few enough for the L1 cache.
const MAX_RUNS: usize = RunSet::CAPACITY;

/// Maximum number of runs in a block with traces, all of which a thread holds in memory.
const MAX_TRACED_RUNS: usize = 8;

/// Maximum number of vehicle samples in all traces of a thread (48 MB), unless a single run has more.
const MAX_TRACED_SAMPLES: usize = 2_000_000;

/// Simulates all `runs` and passes each result, with the index of its run, to `reduce` as soon as it is available.
///
/// Returns the values of `reduce` in the order of `runs`. Only results that `reduce` returned stay in memory.
///
/// ```
/// use crumple_sim::control::BuiltInController;
/// use crumple_sim::scenario::PaperDistribution;
/// use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
///
/// let paper = PaperDistribution { seed: 0 };
/// let scenarios: Vec<_> = (0..100).map(|index| paper.draw(index).unwrap()).collect();
/// let options = RunOptions::new(BuiltInController::from_name("baseline").unwrap());
/// let runs: Vec<_> = scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).unwrap()).collect();
/// let safe = simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome.is_safe());
/// assert_eq!(safe.into_iter().filter(|&safe| safe).count(), 0);
/// ```
pub fn simulate_batch<R: Send>(
    runs: &[Run],
    keep: RecordingLevel,
    reduce: impl Fn(usize, SimulationResult) -> R + Sync,
) -> Vec<R> {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    order.sort_by(|&a, &b| compare_shapes(&runs[a], &runs[b]).then(a.cmp(&b)));
    let mut results: Vec<(usize, R)> = split_into_blocks(runs, &order, keep)
        .into_par_iter()
        .flat_map_iter(|members| {
            let mut done = Vec::with_capacity(members.len());
            let mut keep_result = |index, simulated| done.push((index, reduce(index, simulated)));
            if members
                .iter()
                .all(|&run| runs[run].scenario().keeps_lanes())
            {
                LockstepBlock::new(Arch::new(), runs, members, keep).run(&mut keep_result);
            } else {
                // Columns have fixed leaders, so that runs with lane changes are simulated one by one.
                members
                    .iter()
                    .for_each(|&index| keep_result(index, simulate(&runs[index], keep)));
            }
            done
        })
        .collect();
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Splits runs, ordered by shape, into blocks of runs with the same shape, at least one for each thread.
fn split_into_blocks<'o>(
    runs: &[Run],
    order: &'o [usize],
    keep: RecordingLevel,
) -> Vec<&'o [usize]> {
    let max_runs = if keep == RecordingLevel::Trace {
        let largest = runs.iter().map(Run::vehicle_samples).max().unwrap_or(1);
        (MAX_TRACED_SAMPLES / largest.max(1)).clamp(1, MAX_TRACED_RUNS)
    } else {
        MAX_RUNS
    };
    order
        .chunk_by(|&a, &b| compare_shapes(&runs[a], &runs[b]) == Ordering::Equal)
        .flat_map(|group| {
            let supports_lockstep = group.iter().all(|&run| runs[run].supports_lockstep());
            let max_runs = if supports_lockstep { max_runs } else { 1 };
            let per_thread = group.len().div_ceil(rayon::current_num_threads());
            group.chunks(per_thread.min(max_runs))
        })
        .collect()
}

/// Orders runs so that runs with equal shapes are adjacent.
fn compare_shapes(a: &Run, b: &Run) -> Ordering {
    block_shape(a)
        .cmp(&block_shape(b))
        .then_with(|| driver_names(a).cmp(driver_names(b)))
}

fn driver_names(run: &Run) -> impl Iterator<Item = &str> {
    run.scenario()
        .vehicles()
        .iter()
        .map(|vehicle| vehicle.driver.name())
}

/// Returns the properties that runs of one block share, except the kinds of drivers.
fn block_shape(run: &Run) -> (usize, bool, u64, u64, &'static str, &'static str) {
    let controller = &run.options().controller;
    let under_test = match controller.downcast_ref::<BuiltInController>() {
        Some(spec) => spec.name(),
        None if controller.as_shield().is_some() => "shield",
        None if controller.program_field().is_some() => "program",
        None => "other",
    };
    let spec = run.scenario().spec();
    let steps = (spec.step_s.to_bits(), run.dt_s().to_bits());
    (
        spec.vehicles.len(),
        run.scenario().keeps_lanes(),
        steps.0,
        steps.1,
        under_test,
        run.options().estimator.name(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::RunOptions;
    use crate::policy::available_archs;
    use crate::scenario::{Driver, PaperDistribution};

    /// The register width does not change any bit of the results.
    #[test]
    fn every_register_width_gives_the_same_results() {
        let draws = (0..20).map(|index| PaperDistribution { seed: 6 }.draw(index).unwrap());
        let lines = draws.map(|draw| {
            draw.edited(|spec| spec.vehicles[2].driver = Driver::UnderTest)
                .unwrap()
        });
        let lines: Vec<_> = lines.collect();
        for spec in BuiltInController::all() {
            let runs: Vec<_> = lines
                .iter()
                .map(|line| Run::new(line, RunOptions::new(spec.clone())).unwrap())
                .collect();
            let members: Vec<usize> = (0..runs.len()).collect();
            let results = available_archs().into_iter().map(|path| {
                let mut results = Vec::new();
                LockstepBlock::new(path, &runs, &members, RecordingLevel::Trace)
                    .run(&mut |index, result| results.push((index, result)));
                results
            });
            let results: Vec<_> = results.collect();
            assert!(
                results.windows(2).all(|pair| pair[0] == pair[1]),
                "{}",
                spec.name()
            );
        }
    }
}
