//! Rollouts with built-in controllers, on one and on two threads.

use crumple_sim::engine::{Outcome, RecordingLevel, Run, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Brake, Driver, LeadProfile, PlantKind, Scenario, built_in_scenario};

use crate::clock::{cpu_time_s, min_cpu_time_s, min_wall_time_s};
use crate::limits::normals_per_second;
use crate::table::Measurement;
use crate::work::rollouts::{built_in, runs, scenarios, vehicle_steps};

const RUNS: u64 = 256;

pub fn measure(say: &mut dyn FnMut(Measurement)) {
    let scenarios = scenarios(RUNS);
    let truth = runs(&scenarios, built_in("baseline"), EstimatorKind::Truth);
    let kalman = runs(&scenarios, built_in("baseline"), EstimatorKind::Kalman);
    let predictive = runs(&scenarios, built_in("predictive"), EstimatorKind::Kalman);
    let [truth_s, kalman_s, predictive_s] = min_cpu_time_s(
        40,
        [&mut all(&truth), &mut all(&kalman), &mut all(&predictive)],
    );
    let ns = |seconds: f64, runs| 1e9 * seconds / vehicle_steps(runs) as f64;
    say(Measurement::at_most(
        5.0,
        "ns",
        "vehicle-step, baseline, true state",
        ns(truth_s, &truth),
    ));
    // Noise is computed for two of three vehicles.
    let share = 100.0 * (2.0 / 3.0) / normals_per_second() / (1e-9 * ns(truth_s, &truth));
    say(Measurement::at_least(
        25.0,
        "%",
        "the same, share of its time that its normal numbers alone would take",
        share,
    ));
    say(Measurement::at_most(
        25.0,
        "ns",
        "vehicle-step, baseline, Kalman filter",
        ns(kalman_s, &kalman),
    ));
    let predictive_ns = ns(predictive_s, &predictive);
    say(Measurement::at_most(
        100.0,
        "ns",
        "vehicle-step, predictive, Kalman filter",
        predictive_ns,
    ));
    for (speed_mps, name) in [
        (
            30.0,
            "vehicle-step, multi-body plant, 30 m/s, baseline, true state",
        ),
        (20.0, "the same at 20 m/s"),
        (10.0, "the same at 10 m/s"),
        (
            1.0,
            "the same at 1 m/s, where the wheels need small integration steps",
        ),
        (
            25.0,
            "the same, mean of the 10 s in which idm stops from 25 m/s",
        ),
    ] {
        let driver = built_in(if speed_mps == 25.0 { "idm" } else { "baseline" });
        let following = runs(&[following_at(speed_mps)], driver, EstimatorKind::Truth);
        let [seconds] = min_cpu_time_s(10, [&mut all(&following)]);
        // The scripted leader takes a negligible time. The Python package of CommonRoad needs 8.2 ms.
        say(Measurement::at_most(
            8200.0,
            "ns",
            name,
            1e9 * seconds / following[0].scenario().steps() as f64,
        ));
    }
    let [one, two] = [1, 2].map(|count| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(count)
            .build()
            .expect("threads")
    });
    let [one_s, two_s] = min_wall_time_s(
        40,
        [&mut || one.install(all(&kalman)), &mut || {
            two.install(all(&kalman))
        }],
    );
    say(Measurement::at_least(
        1.9,
        "times",
        "rollouts, two threads against one (wall clock)",
        one_s / two_s,
    ));
}

/// Returns a function that simulates all runs.
fn all(runs: &[Run]) -> impl FnMut() + Send + '_ {
    move || {
        std::hint::black_box(simulate_batch(
            runs,
            RecordingLevel::Summary,
            |_, result| result.outcome,
        ));
    }
}

/// Returns 10 s of one multi-body vehicle that follows a leader of the same speed, which brakes from 25 m/s to rest.
fn following_at(speed_mps: f64) -> Scenario {
    let following = built_in_scenario("paper-1")
        .expect("built in")
        .edited(|spec| {
            spec.duration_s = 10.0;
            spec.vehicles.truncate(2);
            spec.vehicles
                .iter_mut()
                .for_each(|vehicle| vehicle.speed_mps = speed_mps);
            spec.vehicles[0].driver = Driver::Profile(match speed_mps {
                25.0 => LeadProfile::Brake(Brake {
                    onset_s: 0.0,
                    rate_mps2: 3.0,
                }),
                _ => LeadProfile::ConstantSpeed,
            });
            spec.vehicles[1].plant = PlantKind::MultiBody;
        });
    following.expect("valid")
}

/// Measures scenarios per second on one thread, from construction to outcome, as a mean over some seconds: paper-1 with
/// a car-following model in all followers.
pub fn scenarios_per_second() -> f64 {
    let paper = built_in_scenario("paper-1").expect("built in");
    let of_run = |index: u64| {
        let scenario = paper.edited(|spec| {
            spec.seed = index;
            spec.vehicles[1..]
                .iter_mut()
                .for_each(|vehicle| vehicle.driver = Driver::UnderTest);
        });
        scenario.expect("valid")
    };
    let (start_s, mut made) = (cpu_time_s(), 0);
    while cpu_time_s() - start_s < 2.0 {
        let scenarios: Vec<_> = (made..made + RUNS).map(of_run).collect();
        let runs = runs(&scenarios, built_in("idm"), EstimatorKind::Truth);
        let outcomes = simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome);
        assert!(
            outcomes
                .iter()
                .all(|outcome| *outcome == Outcome::NoCollision),
            "all steps are made"
        );
        made += RUNS;
    }
    made as f64 / (cpu_time_s() - start_s)
}
