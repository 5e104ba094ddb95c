//! Compares controllers behind recorded leaders: collisions, distance driven, false brakes, induced braking of the
//! follower.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- \
//!   behind_recorded recordings/*.csv idm acc-aeb corpora/policy/road.safetensors
//! ```
//! Arguments that end in `.csv` are recordings that `crumple import` reads, the others controllers. Every recorded
//! vehicle is a leader once. Its uninterrupted motion is cut into pieces of 30 s; the last one counts if it is longer
//! than 10 s. The ego vehicle starts at the recorded speed and gap of the vehicle behind, or, if unknown, at the
//! leader's speed with a time gap of 1.5 s. Behind it `acc-aeb` follows at the ego's speed with 2 m and 1.2 s.

use std::path::Path;

use crate::ExperimentError;
use crumple::world::control::ControllerSpec;
use crumple::world::measure::UsefulnessMeasures;
use crumple::world::observation::EstimatorKind;
use crumple::world::recording::{CAR_LENGTH_M, RecordedPlatoon, load};
use crumple::world::scenario::{
    Driver, Environment, LeadProfile, RecordedSpeeds, SCENARIO_VERSION, Scenario, ScenarioSpec, Sensors, VehicleClass,
    VehicleSpec,
};
use crumple::world::sim::{NamedController, RecordingLevel, Run, RunOptions, Trace, simulate_batch};

const STEP_S: f64 = 0.01;
const PIECE_S: f64 = 30.0;
const MIN_PIECE_S: f64 = 10.0;
/// A longer gap between two samples ends a piece of motion.
const MAX_SAMPLE_GAP_S: f64 = 0.5;

#[derive(Default)]
struct ReplayTotals {
    runs: u64,
    leader_contacts: u64,
    rear_contacts: u64,
    ego_distance_m: f64,
    leader_distance_m: f64,
    false_brakes: u64,
    driven_s: f64,
    induced_braking_mps2: Vec<f64>,
    squares: [f64; 2],
}

struct ReplayArgs {
    scenarios: Vec<Scenario>,
    controllers: Vec<NamedController>,
}

impl ReplayArgs {
    fn parse(arguments: impl Iterator<Item = String>) -> Result<Self, ExperimentError> {
        let (recordings, names): (Vec<String>, Vec<String>) =
            arguments.partition(|argument| argument.ends_with(".csv"));
        if recordings.is_empty() {
            return Err("which recordings?".into());
        }
        if names.is_empty() {
            return Err("which controllers?".into());
        }
        let found = names.iter().map(|name| NamedController::find_and_try(name, Path::new("")));
        let controllers = found.collect::<Result<_, _>>()?;
        let mut scenarios = Vec::new();
        for path in &recordings {
            let recording = load(Path::new(path), None)?;
            for platoon in &recording.platoons {
                for leader in 0..platoon.vehicles.len() {
                    scenarios.extend(scenarios_behind(platoon, leader));
                }
            }
        }
        if scenarios.is_empty() {
            let problem = format!("nobody leads for {MIN_PIECE_S} s without a break in {}", recordings.join(", "));
            return Err(problem.into());
        }
        Ok(Self { scenarios, controllers })
    }
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let ReplayArgs { scenarios, controllers } = ReplayArgs::parse(arguments.iter().cloned())?;
    println!("{} pieces of recorded leaders\n", scenarios.len());
    println!(
        "| controller | into the leader | from behind | distance, relative to the leader's | false brakes a minute | \
         mean of the hardest braking imposed, m/s² | rms a | rms jerk |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for controller in &controllers {
        let (name, sums) = (&controller.name, simulate_all(&scenarios, controller)?);
        let n = sums.runs.max(1) as f64;
        println!(
            "| {name} | {} | {} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} |",
            sums.leader_contacts,
            sums.rear_contacts,
            sums.ego_distance_m / sums.leader_distance_m,
            60.0 * sums.false_brakes as f64 / sums.driven_s,
            sums.induced_braking_mps2.iter().sum::<f64>() / sums.induced_braking_mps2.len().max(1) as f64,
            (sums.squares[0] / n).sqrt(),
            (sums.squares[1] / n).sqrt(),
        );
    }
    Ok(())
}

fn scenarios_behind(platoon: &RecordedPlatoon, leader: usize) -> Vec<Scenario> {
    let speeds = &platoon.vehicles[leader].speed_mps;
    let follower = (leader + 1 < platoon.vehicles.len()).then_some(leader + 1);
    let known: Vec<usize> = (0..speeds.len()).filter(|&sample| speeds[sample].is_some()).collect();
    let time_s = &platoon.time_s;
    let mut pieces: Vec<Vec<usize>> = Vec::new();
    for sample in known {
        match pieces.last_mut() {
            Some(piece)
                if time_s[sample] - time_s[piece[piece.len() - 1]] <= MAX_SAMPLE_GAP_S
                    && time_s[sample] - time_s[piece[0]] <= PIECE_S =>
            {
                piece.push(sample);
            }
            _ => pieces.push(vec![sample]),
        }
    }
    pieces.iter().filter_map(|piece| scenario_from_piece(platoon, leader, follower, piece)).collect()
}

/// Returns `None` for a piece that is too short, or whose initial state is not valid in a scenario.
fn scenario_from_piece(
    platoon: &RecordedPlatoon,
    leader: usize,
    follower: Option<usize>,
    piece: &[usize],
) -> Option<Scenario> {
    let (&first, &last) = (piece.first()?, piece.last()?);
    let start_s = platoon.time_s[first];
    let duration_s = platoon.time_s[last] - start_s;
    if duration_s < MIN_PIECE_S {
        return None;
    }
    let milli = |value: f64| (1000.0 * value).round() / 1000.0;
    let recorded = |sample: usize| platoon.vehicles[leader].speed_mps[sample];
    let speed_mps: Vec<f64> = piece.iter().filter_map(|&sample| recorded(sample)).map(milli).collect();
    let time_s: Vec<f64> = piece.iter().map(|&sample| milli(platoon.time_s[sample] - start_s)).collect();
    let hardest_mps2 =
        time_s.windows(2).zip(speed_mps.windows(2)).fold([0.0_f64; 2], |[brake, accel], (time, speed)| {
            let slope = (speed[1] - speed[0]) / (time[1] - time[0]);
            [brake.max(-slope), accel.max(slope)]
        });
    let behind = follower.and_then(|follower| {
        Some([platoon.vehicles[follower].speed_mps[first]?, platoon.gap_ahead_m(follower)[first]?])
    });
    let [ego_mps, gap_m] = behind.unwrap_or([speed_mps[0], 2.0 + 1.5 * speed_mps[0]]).map(milli);
    let ego_m = milli(CAR_LENGTH_M + 2.0 + 1.2 * ego_mps);
    let leader_m = milli(ego_m + CAR_LENGTH_M + gap_m);
    let leads = LeadProfile::Recorded(RecordedSpeeds { time_s, speed_mps: speed_mps.clone() });
    let acc_aeb = Driver::Controller(ControllerSpec::from_name("acc-aeb")?);
    let vehicle = |position_m, speed_mps, driver| VehicleSpec {
        length_m: Some(CAR_LENGTH_M),
        ..VehicleSpec::new(VehicleClass::Light, position_m, speed_mps, driver)
    };
    let mut vehicles = vec![
        vehicle(leader_m, speed_mps[0], Driver::Profile(leads)),
        vehicle(ego_m, ego_mps, Driver::UnderTest),
        vehicle(0.0, ego_mps, acc_aeb),
    ];
    // Recorded speeds contain receiver noise; the leader's limits must allow these accelerations.
    let [brake_mps2, accel_mps2] = hardest_mps2.map(|mps2| (10.0 * mps2).ceil() / 10.0 + 0.1);
    vehicles[0].max_brake_mps2 = Some(brake_mps2.max(vehicles[0].max_brake_mps2()));
    vehicles[0].max_accel_mps2 = Some(accel_mps2.max(vehicles[0].max_accel_mps2()));
    let spec = ScenarioSpec {
        version: SCENARIO_VERSION,
        name: format!("recorded-{leader}-{first}"),
        about: String::new(),
        duration_s: (duration_s / STEP_S).floor() * STEP_S,
        step_s: STEP_S,
        seed: first as u64,
        environment: Environment::default(),
        sensors: Sensors::default(),
        vehicles,
    };
    Scenario::new(spec).inspect_err(|error| eprintln!("left out: vehicle {leader}, sample {first}: {error}")).ok()
}

fn simulate_all(scenarios: &[Scenario], controller: &NamedController) -> Result<ReplayTotals, ExperimentError> {
    let options = RunOptions::new(controller.kind.clone()).with_estimator(EstimatorKind::Kalman);
    let runs = scenarios.iter().map(|one| Run::new(one, options.clone())).collect::<Result<Vec<_>, _>>()?;
    let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
        let trace = result.trace.as_ref();
        let useful = trace.and_then(|trace| UsefulnessMeasures::from_trace(trace, &result.impacts, 1));
        (result.outcome.contact().copied(), useful, trace.map(DriveSummary::new))
    });
    let mut sums = ReplayTotals::default();
    for (contact, useful, ridden) in results {
        sums.runs += 1;
        let into_the_leader = contact.is_some_and(|contact| contact.front_vehicle == 0);
        sums.leader_contacts += u64::from(into_the_leader);
        sums.rear_contacts += u64::from(contact.is_some() && !into_the_leader);
        let Some(ridden) = ridden else { continue };
        sums.ego_distance_m += ridden.ego_distance_m;
        sums.leader_distance_m += ridden.leader_distance_m;
        sums.false_brakes += ridden.false_brakes;
        sums.driven_s += ridden.driven_s;
        let Some(useful) = useful else { continue };
        sums.squares[0] += useful.rms_acceleration_mps2.unwrap_or(0.0).powi(2);
        sums.squares[1] += useful.rms_jerk_mps3.unwrap_or(0.0).powi(2);
        sums.induced_braking_mps2.extend(useful.induced.and_then(|imposed| imposed.peak_brake_mps2));
    }
    Ok(sums)
}

struct DriveSummary {
    ego_distance_m: f64,
    leader_distance_m: f64,
    false_brakes: u64,
    driven_s: f64,
}

impl DriveSummary {
    /// Measures a trace. A false brake is braking harder than 2 m/s² while the time to collision exceeds 4 s, the time
    /// gap exceeds 0.8 s, and the leader brakes with less than 1 m/s²; an uninterrupted one counts once.
    fn new(trace: &Trace) -> Self {
        let (leader, ego) = (&trace.vehicles[0], &trace.vehicles[1]);
        let travelled = |positions: &[f64]| positions.last().unwrap_or(&0.0) - positions.first().unwrap_or(&0.0);
        let is_false = |sample: usize| {
            let gap_m = leader.position_m[sample] - leader.length_m - ego.position_m[sample];
            let closing_mps = ego.speed_mps[sample] - leader.speed_mps[sample];
            ego.acceleration_mps2[sample] < -2.0
                && leader.acceleration_mps2[sample] > -1.0
                && gap_m > 4.0 * closing_mps
                && gap_m > 0.8 * ego.speed_mps[sample]
        };
        let mut was_false = false;
        let mut false_brakes = 0;
        for sample in 0..trace.time_s.len() {
            let now = is_false(sample);
            false_brakes += u64::from(now && !was_false);
            was_false = now;
        }
        Self {
            ego_distance_m: travelled(&ego.position_m),
            leader_distance_m: travelled(&leader.position_m),
            false_brakes,
            driven_s: trace.time_s.last().copied().unwrap_or(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLATOON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../corpora/recordings/synthetic-platoon.csv");

    #[test]
    fn arguments_that_make_no_sense_are_named() {
        let refused = |arguments: &[&str]| {
            ReplayArgs::parse(arguments.iter().map(|argument| (*argument).to_owned()))
                .err()
                .expect("refused")
                .to_string()
        };
        assert_eq!(refused(&[]), "which recordings?");
        assert_eq!(refused(&["idm"]), "which recordings?");
        assert_eq!(refused(&[PLATOON]), "which controllers?");
        assert!(refused(&["missing.csv", "idm"]).starts_with("missing.csv: "));
        assert!(refused(&[PLATOON, "hal"]).contains("`hal`"), "{}", refused(&[PLATOON, "hal"]));
        let asked = ReplayArgs::parse([PLATOON, "idm"].into_iter().map(str::to_owned)).unwrap();
        assert!(!asked.scenarios.is_empty() && asked.controllers.len() == 1);
    }
}
