//! Compares worst-case profiles of convex programming with those of sampling and searches, in the same envelope and
//! budget.
//!
//! `cargo run --release -p crumple-experiments -- worst_case_comparison` prints the tables of reports/worst-case.md.

use crate::ExperimentError;
use crumple_core::observer::Quiet;
use crumple_search::falsify::{Method, UnitCube};
use crumple_search::worst_case::{AttackObjective, Envelope, attack};
use crumple_world::control::ControllerSpec;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{Driver, LeadProfile, PiecewiseAcceleration, Scenario, built_in_scenario};
use crumple_world::sim::{Outcome, RecordingLevel, Run, RunOptions, simulate_batch};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const CELL_S: f64 = 0.1;
const SAMPLES: usize = 100_000;
const BATCH: usize = 1000;
const SEEDS: u64 = 5;
const BUDGET: usize = 3000;
const KNOTS: usize = 26;

pub(crate) fn run(_: &[String]) -> Result<(), ExperimentError> {
    compare_with_samples();
    compare_with_searches();
    Ok(())
}

/// Part 1: the mildest profile against `baseline`, and the mildest of uniform samples.
fn compare_with_samples() {
    println!(
        "| scenario | family | samples | collide | least ∫a² of samples | mildest ∫a² | how | simulations | programs |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for name in ["paper-1", "paper-2"] {
        let scenario = built_in_scenario(name).expect("built in");
        let options = options("baseline", EstimatorKind::Truth);
        let envelope = Envelope::from_scenario(&scenario);
        let mildest = attack(&scenario, &options, AttackObjective::Mildest, envelope, 0, &Quiet)
            .expect("a scripted leader")
            .attack;
        let mildest = mildest.expect("the baseline collides");
        for (family, is_scaled) in [("uniform", false), ("scaled", true)] {
            let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
            let (mut collided, mut least) = (0, f64::INFINITY);
            for _ in 0..SAMPLES / BATCH {
                let profiles: Vec<_> =
                    (0..BATCH).map(|_| random_profile(&scenario, envelope, is_scaled, &mut random)).collect();
                for (profile, (outcome, _)) in profiles.iter().zip(simulate_profiles(&scenario, &options, &profiles)) {
                    if outcome != Outcome::NoCollision {
                        collided += 1;
                        least = effort_m2ps3(profile).min(least);
                    }
                }
            }
            println!(
                "| {name} | {family} | {SAMPLES} | {collided} | {least:.3} | {:.3} | {:?} | {} | {} |",
                mildest.effort_m2ps3, mildest.method, mildest.evaluations, mildest.programs
            );
        }
    }
}

/// Returns braking in one to six pieces with uniform borders and uniform decelerations up to the maximum (of one sample
/// with `is_scaled`, itself uniform), followed as fast as the jerk limit allows.
fn random_profile(
    scenario: &Scenario,
    envelope: Envelope,
    is_scaled: bool,
    random: &mut Xoshiro256PlusPlus,
) -> Vec<f64> {
    let duration_s = scenario.spec().duration_s;
    let pieces = random.random_range(1..=6);
    let mut borders_s: Vec<f64> = (1..pieces).map(|_| random.random_range(0.0..duration_s)).collect();
    borders_s.sort_by(f64::total_cmp);
    let most_mps2 = if is_scaled { random.random::<f64>() } else { 1.0 } * envelope.max_brake_mps2;
    let targets: Vec<f64> = (0..pieces).map(|_| -most_mps2 * random.random::<f64>()).collect();
    let wanted = |cell: usize| {
        let piece = borders_s.partition_point(|border_s| *border_s <= cell as f64 * CELL_S);
        targets.get(piece).copied().unwrap_or(0.0)
    };
    limit_jerk((0..cell_count(scenario)).map(wanted), envelope)
}

/// Part 2: the sequential program against `policy`, and the mildest collision of each search with as many simulations.
fn compare_with_searches() {
    println!(
        "\n| scenario | seed | sequential ∫a² | simulations | auto | auto, told of the leader | cma-es | uniform | \
         auto, tenfold |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for name in ["paper-1", "paper-2"] {
        for seed in 0..SEEDS {
            let scenario =
                built_in_scenario(name).expect("built in").edited(|spec| spec.seed = seed).expect("any seed is valid");
            let options = options("policy", EstimatorKind::Kalman);
            let envelope = Envelope::from_scenario(&scenario);
            let hunted = attack(&scenario, &options, AttackObjective::Mildest, envelope, BUDGET, &Quiet)
                .expect("a scripted leader");
            let own = hunted.attack.map_or(f64::INFINITY, |found| found.effort_m2ps3);
            let plain = UnitCube::new([KNOTS]).expect("not empty");
            let enlarged = plain.clone().with_leader_coordinates(0..KNOTS);
            let least = |method: &Method, cube: &UnitCube, times: usize| {
                let budget = times * hunted.evaluations;
                let least = mildest_of_search(method, cube, seed, &scenario, &options, envelope, budget);
                if least.is_finite() { format!("{least:.3}") } else { "none".to_owned() }
            };
            println!(
                "| {name} | {seed} | {own:.3} | {} | {} | {} | {} | {} | {} |",
                hunted.evaluations,
                least(&Method::Auto, &plain, 1),
                least(&Method::Auto, &enlarged, 1),
                least(&Method::CmaEs, &plain, 1),
                least(&Method::Uniform, &plain, 1),
                least(&Method::Auto, &plain, 10),
            );
        }
    }
}

/// Returns the least ∫a² of a collision that a search finds with a number of simulations; infinite if it finds none.
///
/// A point is a deceleration at each knot, linear between them. Robustness is the smallest gap; for a collision, it is
/// the more negative the milder the profile is.
fn mildest_of_search(
    method: &Method,
    cube: &UnitCube,
    seed: u64,
    scenario: &Scenario,
    options: &RunOptions,
    envelope: Envelope,
    budget: usize,
) -> f64 {
    let mut search = method.start(cube, seed);
    let (mut least, mut spent) = (f64::INFINITY, 0);
    while spent < budget {
        let points = search.ask();
        let asked: Vec<_> =
            points.iter().take(budget - spent).map(|point| profile_from_point(point, scenario, envelope)).collect();
        spent += asked.len();
        let robustness = |(profile, (outcome, gap_m)): (&Vec<f64>, (Outcome, f64))| match outcome {
            Outcome::NoCollision => gap_m.max(0.0),
            Outcome::Collision(_) | Outcome::ControllerFailed(_) => {
                least = effort_m2ps3(profile).min(least);
                -1000.0 / (1.0 + effort_m2ps3(profile))
            }
        };
        let results = simulate_profiles(scenario, options, &asked);
        let values: Vec<f64> = asked.iter().zip(results).map(robustness).collect();
        search.tell(&values);
    }
    least
}

fn profile_from_point(point: &[f64], scenario: &Scenario, envelope: Envelope) -> Vec<f64> {
    let cells = cell_count(scenario);
    let knot = |index: usize| point.get(index.min(point.len() - 1)).copied().unwrap_or(0.0);
    let wanted = |cell: usize| {
        let place = (cell as f64 + 0.5) * (KNOTS - 1) as f64 / cells as f64;
        let (left, share) = (place.floor() as usize, place.fract());
        -envelope.max_brake_mps2 * (knot(left) * (1.0 - share) + knot(left + 1) * share)
    };
    limit_jerk((0..cells).map(wanted), envelope)
}

fn limit_jerk(wanted: impl Iterator<Item = f64>, envelope: Envelope) -> Vec<f64> {
    let most = envelope.jerk_mps3 * CELL_S;
    let mut now = 0.0;
    let followed = wanted.map(|wanted| {
        now += (wanted - now).clamp(-most, most);
        now
    });
    followed.collect()
}

fn options(controller: &str, estimator: EstimatorKind) -> RunOptions {
    let controller = ControllerSpec::from_name(controller).expect("built in");
    RunOptions::new(controller).with_estimator(estimator)
}

fn cell_count(scenario: &Scenario) -> usize {
    (scenario.spec().duration_s / CELL_S).round() as usize
}

fn effort_m2ps3(profile: &[f64]) -> f64 {
    profile.iter().map(|a| a * a * CELL_S).sum()
}

/// Simulates each profile of the leader. Returns the outcomes and the smallest gaps in metres.
fn simulate_profiles(scenario: &Scenario, options: &RunOptions, profiles: &[Vec<f64>]) -> Vec<(Outcome, f64)> {
    let scripted = |profile: &Vec<f64>| {
        let from_s = (0..profile.len()).map(|cell| cell as f64 * CELL_S).collect();
        let script = LeadProfile::Pieces(PiecewiseAcceleration { from_s, accel_mps2: profile.clone() });
        scenario.edited(|spec| spec.vehicles[0].driver = Driver::Profile(script)).expect("within the envelope")
    };
    let scenarios: Vec<_> = profiles.iter().map(scripted).collect();
    let runs: Vec<_> = scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).expect("it fits")).collect();
    simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
        let gaps = result.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m);
        (result.outcome, gaps.fold(f64::INFINITY, f64::min))
    })
}
