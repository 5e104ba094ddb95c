//! Random search for escapes, compared with `avoid` behind reacting followers.
//!
//! Shares no code with the optimiser: profiles are pieces with random knots, levels and held constants; half of them
//! are random changes of the best ones so far.

use crumple_sim::scenario::NoDriverFiles;
use std::path::Path;

use crumple_search::worst_case::{
    AvoidOptions, Avoidance, AvoidanceVerdict, EmergencyBrake, Optimality, avoid,
};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunOptions, simulate, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, file};
use crumple_spaces::built_in_space;

use super::scenes::{Dice, with_pieces};

/// Tries between two updates of the best profiles.
const BATCH: usize = 250;
const ELITE_COUNT: usize = 5;
/// Shares of the duration in which all knots of a random profile lie.
const HORIZON_SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.12];

#[derive(Debug, Clone)]
pub(super) struct TriedProfile {
    pub(super) pieces: Vec<(f64, f64)>,
    pub(super) margin_m: f64,
}

/// Returns the random profile of vehicle 1 with the largest minimum gap; its margin is negative if each profile
/// collides.
pub(super) fn random_search(scenario: &Scenario, tries: usize, seed: u64) -> TriedProfile {
    let dice = &mut Dice(seed);
    let mut best: Vec<TriedProfile> = Vec::new();
    let mut left = tries;
    while left > 0 {
        let profiles: Vec<_> = (0..left.min(BATCH))
            .map(|_| match best.is_empty() || dice.between(0.0, 1.0) < 0.4 {
                true => random_profile(scenario, dice),
                false => {
                    let from =
                        &best[(dice.between(0.0, best.len() as f64) as usize).min(best.len() - 1)];
                    mutate_profile(scenario, from.pieces.clone(), dice)
                }
            })
            .collect();
        left -= profiles.len();
        best.extend(simulate_profiles(scenario, profiles));
        best.sort_by(|a, b| b.margin_m.total_cmp(&a.margin_m));
        best.truncate(ELITE_COUNT);
    }
    best.swap_remove(0)
}

/// Returns an acceleration of vehicle 1: a limit, zero, or a value in between.
fn random_level_mps2(scenario: &Scenario, dice: &mut Dice) -> f64 {
    let (low, high) = (
        -scenario.usable_brake_mps2(1),
        scenario.vehicles()[1].max_accel_mps2(),
    );
    match dice.between(0.0, 6.0) as usize {
        0 => low,
        1 => 0.0,
        2 => high,
        3 => dice.between(low, high),
        _ => dice.between(low, 0.0),
    }
}

fn random_profile(scenario: &Scenario, dice: &mut Dice) -> Vec<(f64, f64)> {
    let horizon = HORIZON_SHARES[(dice.between(0.0, 4.0) as usize).min(3)];
    let count = 1 + dice.between(0.0, 8.0) as usize;
    let mut pieces = vec![(0.0, random_level_mps2(scenario, dice))];
    for _ in 1..count {
        pieces.push((
            horizon * scenario.spec().duration_s * dice.between(0.0, 1.0),
            random_level_mps2(scenario, dice),
        ));
    }
    normalise_profile(scenario, pieces)
}

/// Makes one to three random changes: of a level, of a knot, of all levels, or of the number of pieces.
fn mutate_profile(
    scenario: &Scenario,
    mut pieces: Vec<(f64, f64)>,
    dice: &mut Dice,
) -> Vec<(f64, f64)> {
    for _ in 0..1 + dice.between(0.0, 3.0) as usize {
        let at = (dice.between(0.0, pieces.len() as f64) as usize).min(pieces.len() - 1);
        // Small changes as often as large ones.
        let size = 10.0_f64.powf(dice.between(-2.0, 0.5))
            * if dice.between(0.0, 1.0) < 0.5 {
                -1.0
            } else {
                1.0
            };
        match dice.between(0.0, 6.0) as usize {
            0 | 1 => pieces[at].1 += size,
            2 => pieces[at].0 += 0.5 * size,
            3 => pieces[at].1 = random_level_mps2(scenario, dice),
            4 => {
                let spread = scenario.spec().duration_s
                    * HORIZON_SHARES[(dice.between(0.0, 4.0) as usize).min(3)];
                pieces.push((
                    spread * dice.between(0.0, 1.0),
                    random_level_mps2(scenario, dice),
                ));
            }
            _ if pieces.len() > 1 => drop(pieces.remove(at)),
            _ => pieces
                .iter_mut()
                .for_each(|(_, held)| *held *= 1.0 + 0.1 * size),
        }
    }
    normalise_profile(scenario, pieces)
}

/// Puts knots on the scenario's steps, in order, from the start on, and levels within the limits.
fn normalise_profile(scenario: &Scenario, mut pieces: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let step_s = scenario.spec().step_s;
    let (low, high) = (
        -scenario.usable_brake_mps2(1),
        scenario.vehicles()[1].max_accel_mps2(),
    );
    for (from_s, held) in &mut pieces {
        *from_s =
            (from_s.clamp(0.0, scenario.spec().duration_s - step_s) / step_s).round() * step_s;
        *held = held.clamp(low, high);
    }
    pieces.sort_by(|a, b| a.0.total_cmp(&b.0));
    pieces.dedup_by(|after, before| after.0 - before.0 < 0.5 * step_s);
    pieces[0].0 = 0.0;
    pieces
}

fn simulate_profiles(scenario: &Scenario, profiles: Vec<Vec<(f64, f64)>>) -> Vec<TriedProfile> {
    let scripted = |pieces: &Vec<(f64, f64)>| {
        let (from_s, accel_mps2) = pieces.iter().copied().unzip();
        with_pieces(scenario, 1, from_s, accel_mps2)
    };
    let scenarios: Vec<_> = profiles.iter().map(scripted).collect();
    let runs: Vec<_> = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, script_options()).expect("fits"))
        .collect();
    let margins_m = simulate_batch(
        &runs,
        RecordingLevel::Summary,
        |_, simulated| match &simulated.outcome {
            Outcome::Collision(collision) => -0.1 * collision.impact_speed_mps.powi(2),
            _ => super::smallest_gap_m(&simulated),
        },
    );
    profiles
        .into_iter()
        .zip(margins_m)
        .map(|(pieces, margin_m)| TriedProfile { pieces, margin_m })
        .collect()
}

fn script_options() -> RunOptions {
    RunOptions::new(BuiltInController::MatchLeader(Default::default()))
        .with_estimator(EstimatorKind::Truth)
}

fn load_escape_scenario(name: &str) -> Scenario {
    file::load(
        &Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/suite/worst_case/escapes")
            .join(name),
        &NoDriverFiles,
    )
    .expect("a scenario")
}

fn avoid_with_bound(scenario: &Scenario) -> Avoidance {
    avoid(
        scenario,
        AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        },
    )
    .expect("the default grid fits")
}

/// Comparison of a random search with `avoid` in random scenarios of the space `assisted`.
#[derive(Debug, Default)]
struct SearchComparison {
    /// Scenarios in which the search keeps a gap that is larger by more than 2 % and 0.05 m.
    improved: Vec<(u64, f64, f64)>,
    undecided: Vec<u64>,
}

fn compare(scenarios: std::ops::Range<u64>, tries: usize) -> SearchComparison {
    let space = built_in_space("assisted").expect("built in");
    let mut comparison = SearchComparison::default();
    for index in scenarios {
        let scenario = space.draw(49, index).expect("a draw");
        let avoidance = avoid_with_bound(&scenario);
        let random_m = random_search(&scenario, tries, index).margin_m;
        let kept_m = match &avoidance.verdict {
            AvoidanceVerdict::Avoidable(escape) => escape.min_gap_m,
            AvoidanceVerdict::Unavoidable(_) => {
                assert!(
                    random_m <= 0.0,
                    "{index}: a random profile keeps {random_m} m of what is proved unavoidable"
                );
                continue;
            }
            AvoidanceVerdict::Undecided(_) => {
                comparison.undecided.push(index);
                0.0
            }
        };
        assert!(
            avoidance
                .min_gap_bound_m
                .is_none_or(|bound_m| random_m.max(kept_m) <= bound_m + 1e-6),
            "{index}"
        );
        if random_m > kept_m + f64::max(0.05, 0.02 * kept_m) {
            comparison.improved.push((index, kept_m, random_m));
        }
    }
    comparison
}

/// A part of the comparison below.
#[test]
fn a_short_random_search_finds_no_larger_gap() {
    let comparison = compare(0..4, 500);
    assert!(comparison.improved.is_empty(), "{comparison:?}");
}

#[test]
#[ignore = "two million simulations: some minutes of an optimised build"]
fn a_long_random_search_finds_larger_gaps_in_few_scenarios() {
    let comparison = compare(0..200, 10_000);
    println!(
        "{} of 200 improved: {comparison:?}",
        comparison.improved.len()
    );
    assert!(comparison.improved.len() <= 4, "{comparison:?}");
}

/// Gaps of a random search where the programs, which do not model the follower's controller, kept 0.045 and 3.750 m.
#[test]
fn behind_a_modelled_leader_the_gap_is_exact() {
    let acc_aeb = load_escape_scenario("acc-aeb-fires.toml");
    let avoidance = avoid_with_bound(&acc_aeb);
    let escape = avoidance.verdict.escape().expect("avoidable");
    assert!(escape.min_gap_m >= 0.381, "{}", escape.min_gap_m);
    // The replay shows whether the brake fires.
    let trace = simulate(
        &Run::new(&escape.scenario, script_options()).unwrap(),
        RecordingLevel::Trace,
    )
    .trace
    .unwrap();
    let hardest_mps2 = trace.vehicles[2]
        .acceleration_mps2
        .iter()
        .copied()
        .fold(0.0, f64::min);
    let fires = hardest_mps2 < -3.5;
    assert_eq!(
        fires,
        matches!(
            escape.emergency_brake,
            EmergencyBrake::Fires { vehicle: 2, .. }
        ),
        "{hardest_mps2}"
    );

    let idm = load_escape_scenario("idm-bound.toml");
    let avoidance = avoid_with_bound(&idm);
    let escape = avoidance.verdict.escape().expect("avoidable");
    assert!(escape.min_gap_m >= 5.742, "{}", escape.min_gap_m);
    assert_eq!(avoidance.optimality, Optimality::Bound);
    assert!(avoidance.bound_certificate.is_some());
    assert_eq!(escape.emergency_brake, EmergencyBrake::NeverFires);
}
