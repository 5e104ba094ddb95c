//! A two-sided filter in closed loops: no collision on either side from inside its set.

mod closed_loop;
#[cfg(test)]
mod scenarios;

use closed_loop::TwoSidedLoop;
use proptest::prelude::*;
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;

fn check_no_collision(closed_loop: &TwoSidedLoop) -> Result<(), TestCaseError> {
    let result = closed_loop.run();
    if result.is_in_set {
        prop_assert!(!result.has_collision(), "{result:?} {closed_loop:?}");
        prop_assert!(!result.left_set, "{result:?} {closed_loop:?}");
    }
    Ok(())
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    #[test]
    fn no_collision_on_either_side_with_the_true_state(seed in any::<u64>()) {
        check_no_collision(&TwoSidedLoop::random(seed, true))?;
    }

    #[test]
    fn no_collision_on_either_side_with_errors_lag_and_noise(seed in any::<u64>()) {
        check_no_collision(&TwoSidedLoop::random(seed, false))?;
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(3000))]

    /// If the meter of levels finds a plan, so does the filter: at its first step, and after another command than its
    /// own was executed.
    #[test]
    fn a_filter_without_a_plan_finds_the_plan_of_the_meter(seed in any::<u64>(), is_exact in any::<bool>()) {
        let first_steps = TwoSidedLoop::random(seed, is_exact).first_steps();
        for [is_in_set, has_plan] in first_steps {
            prop_assert!(has_plan || !is_in_set, "{first_steps:?} {seed}");
        }
    }
}

/// A search that changes the leader's motion to reduce the smallest gap finds no collision.
#[test]
fn no_leader_that_a_search_finds_causes_a_collision() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    for seed in 0..40 {
        let mut best = TwoSidedLoop::random(seed, seed % 2 == 0);
        let mut least_m = f64::INFINITY;
        for _ in 0..25 {
            let changed = best.with_changed_leader(&mut random);
            let result = changed.run();
            if !result.is_in_set {
                break;
            }
            assert!(!result.has_collision(), "{result:?} {changed:?}");
            let min_m = result.min_gaps_m[0].min(result.min_gaps_m[1]);
            if min_m < least_m {
                (least_m, best) = (min_m, changed);
            }
        }
    }
}

/// Prints the processor time of the filter's steps.
#[cfg(unix)]
#[test]
#[ignore = "prints times"]
fn times_of_steps() {
    for is_exact in [true, false] {
        let loops_ns: Vec<Vec<u64>> = (0..400)
            .map(|seed| {
                TwoSidedLoop::random(seed, is_exact)
                    .run_timed(processor_time_ns)
                    .1
            })
            .collect();
        let slowest_first_ns = loops_ns
            .iter()
            .filter_map(|times_ns| times_ns.first())
            .max();
        let mut times_ns: Vec<u64> = loops_ns
            .iter()
            .flat_map(|times_ns| times_ns.iter().skip(1).copied())
            .collect();
        times_ns.sort_unstable();
        let at =
            |share: f64| times_ns[((times_ns.len() - 1) as f64 * share) as usize] as f64 / 1000.0;
        println!(
            "exact {is_exact}: {} steps after the first, µs: median {:.1}, 99 % {:.1}, 99.9 % {:.1}, slowest {:.1}; \
             slowest first step {:.1}",
            times_ns.len(),
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0),
            slowest_first_ns.map_or(0.0, |&time_ns| time_ns as f64 / 1000.0)
        );
    }
}

#[cfg(unix)]
fn processor_time_ns() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// With lag and delay, a jump of the bound of the speed fell between two roundings of the same time.
#[test]
fn times_of_steps_are_exact_with_lag_and_delay() {
    let result = TwoSidedLoop::random_with_gaps(1_669_150_717_687_597_407, false, [0.7, 4.4]).run();
    assert!(result.is_in_set && !result.has_collision(), "{result:?}");
}
