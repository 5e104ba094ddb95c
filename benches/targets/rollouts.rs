//! Rollouts with built-in controllers, on one thread and on two.

use crumple::estimate::EstimatorKind;
use crumple::sim::{Keep, simulate_batch};

use crate::clock::{least_s, least_wall_s};
use crate::table::Figure;
use crate::work::rollouts::{built_in, runs, scenarios, vehicle_steps};

const RUNS: u64 = 256;

pub fn figures(say: &mut dyn FnMut(Figure)) {
    let scenarios = scenarios(RUNS);
    let truth = runs(&scenarios, built_in("baseline"), EstimatorKind::Truth);
    let kalman = runs(&scenarios, built_in("baseline"), EstimatorKind::Kalman);
    let all = |runs| {
        move || {
            std::hint::black_box(simulate_batch(runs, Keep::Summary, |_, result| result.outcome));
        }
    };
    let [truth_s, kalman_s] = least_s(40, [&mut all(&truth), &mut all(&kalman)]);
    let ns = |seconds: f64, runs| 1e9 * seconds / vehicle_steps(runs) as f64;
    say(Figure::at_most(5.0, "ns", "vehicle-step, baseline, true state", ns(truth_s, &truth)));
    say(Figure::at_most(25.0, "ns", "vehicle-step, baseline, Kalman filter", ns(kalman_s, &kalman)));
    let [one, two] = [1, 2].map(|count| rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads"));
    let [one_s, two_s] = least_wall_s(40, [&mut || one.install(all(&kalman)), &mut || two.install(all(&kalman))]);
    say(Figure::at_least(1.9, "times", "rollouts, two threads against one (wall clock)", one_s / two_s));
}

/// Scenarios a second, one thread: the paper's first scenario with a car-following model in all followers.
pub fn scenarios_per_second() -> f64 {
    let scenario = crumple::scenario::built_in("paper-1").expect("built in");
    let idm = scenario.edited(|spec| {
        for vehicle in &mut spec.vehicles[1..] {
            vehicle.driver = crumple::scenario::Driver::UnderTest;
        }
    });
    let scenarios = vec![idm.expect("valid"); RUNS as usize];
    let runs = runs(&scenarios, built_in("idm"), EstimatorKind::Truth);
    let mut all = || {
        std::hint::black_box(simulate_batch(&runs, Keep::Summary, |_, result| result.outcome));
    };
    let [seconds] = least_s(20, [&mut all]);
    RUNS as f64 / seconds
}
