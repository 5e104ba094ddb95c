//! Open-loop replay: the commands of a controller that observes a recorded drive and cannot change it.

use super::lead_vehicles::LeadVehicle;
use super::motion::SpeedSample;
use super::{CAR_LENGTH_M, EpisodeVehicle, Recording};
use crumple_core::digits::format_fixed;
use crumple_measure::{DriveStep, MIN_BRAKING_S, PairState, UnnecessaryBraking};
use crumple_sim::control::ControllerFailure;
use crumple_sim::engine::{Run, RunError, RunOptions};
use crumple_sim::observation::{Neighbour, Observation};
use crumple_sim::scenario::{
    Driver, InvalidField, LeadProfile, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
};

/// Time step, in seconds; states between samples are interpolated.
const STEP_S: f64 = 0.05;
/// Number of steps over which accelerations are measured, so that the noise of speeds is no braking.
const ACCELERATION_STEPS: usize = 10;
/// Shortest drive that is replayed, in seconds.
const MIN_DRIVE_S: f64 = 1.0;

/// A drive of one vehicle behind another, without holes.
#[derive(Debug, Clone, PartialEq)]
pub struct ReplayedDrive {
    /// Event, if the file names events.
    pub event: Option<String>,
    /// The vehicle that the controller replaces.
    pub vehicle: EpisodeVehicle,
    /// Duration, in seconds.
    pub duration_s: f64,
    /// Distance of the vehicle, in metres.
    pub distance_m: f64,
    /// Brakings of the controller.
    pub brakings: Vec<ReplayedBraking>,
    /// Unnecessary braking of the controller, and of the driver.
    pub unnecessary: [UnnecessaryBraking; 2],
}

/// Braking that the controller would have begun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayedBraking {
    /// Start, in seconds of the recording.
    pub from_s: f64,
    /// Duration, in seconds.
    pub duration_s: f64,
    /// Largest deceleration of the controller, in m/s².
    pub brake_mps2: f64,
    /// Largest deceleration of the driver in this time and the second after it, in m/s²; not below 0.
    pub driver_brake_mps2: f64,
    /// Speed at the start, in m/s.
    pub speed_mps: f64,
    /// Bumper gap at the start, in metres.
    pub gap_m: f64,
}

/// Reason why a controller cannot be replayed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenLoopError {
    /// A drive that is no valid scenario.
    #[error(transparent)]
    Drive(#[from] InvalidField),
    /// A controller that cannot drive in it.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A controller that gave no answer.
    #[error("at {} s of the recording the controller gave no answer: {reason}", format_fixed(*time_s, 2))]
    NoAnswer {
        /// Time of the recording, in seconds.
        time_s: f64,
        /// Failure of the controller.
        reason: String,
    },
}

/// Leader, the vehicle itself and its follower at one time.
#[derive(Clone)]
struct Instant {
    time_s: f64,
    leader_mps: f64,
    vehicle: EpisodeVehicle,
    behind: Option<EpisodeVehicle>,
}

/// Replays every recorded drive behind a leader. `options` names the controller, which observes the recorded state;
/// brakings count from `min_brake_mps2` on. `advance` receives the replayed seconds, and those of all leaders.
///
/// # Errors
/// [`OpenLoopError`] if the controller cannot drive.
pub fn replay(
    recording: &Recording,
    options: &RunOptions,
    min_brake_mps2: f64,
    advance: &dyn Fn(f64, f64),
) -> Result<Vec<ReplayedDrive>, OpenLoopError> {
    let mut replayed = Vec::new();
    let leads = recording.lead_vehicles();
    let duration_s = |segment: &Vec<SpeedSample>| {
        segment
            .first()
            .zip(segment.last())
            .map_or(0.0, |(from, to)| {
                (to.time_ms - from.time_ms) as f64 / 1000.0
            })
    };
    let total_s: f64 = leads
        .iter()
        .flat_map(|lead| lead.segments())
        .map(|segment| duration_s(&segment))
        .sum();
    let mut done_s = 0.0;
    for lead in &leads {
        for segment in lead.segments() {
            for drive in drives(&**lead, &segment) {
                let steps = resample(&drive);
                let lasts_long = steps.len() as f64 * STEP_S >= MIN_DRIVE_S;
                if let (Some(first), true) = (drive.first(), lasts_long) {
                    let advance = |now_s: f64| advance(done_s + now_s - first.time_s, total_s);
                    let commands_mps2 = commands(first, &steps, options, &advance)?;
                    replayed.push(evaluate(
                        lead.event(),
                        first,
                        (&steps, &commands_mps2),
                        min_brake_mps2,
                    ));
                }
            }
            done_s += duration_s(&segment);
        }
    }
    Ok(replayed)
}

/// Splits a segment where the follower changes.
fn drives(lead: &dyn LeadVehicle, segment: &[SpeedSample]) -> Vec<Vec<Instant>> {
    let mut drives: Vec<Vec<Instant>> = Vec::new();
    let mut is_open = false;
    for sample in segment
        .iter()
        .filter(|sample| lead.core_ms().contains(&sample.time_ms))
    {
        let mut followers = lead.followers_at(sample).into_iter();
        let Some(vehicle) = followers.next() else {
            is_open = false;
            continue;
        };
        let time_s = sample.time_ms as f64 / 1000.0;
        let instant = Instant {
            time_s,
            leader_mps: sample.speed_mps,
            vehicle,
            behind: followers.next(),
        };
        let number = |behind: &Option<EpisodeVehicle>| behind.as_ref().map(|one| one.number);
        let continues = |last: &Instant| {
            last.vehicle.number == instant.vehicle.number
                && number(&last.behind) == number(&instant.behind)
        };
        match drives.last_mut() {
            Some(drive) if is_open && drive.last().is_some_and(continues) => drive.push(instant),
            _ => drives.push(vec![instant]),
        }
        is_open = true;
    }
    drives
}

/// Interpolates to the time step, with the time of the recording.
fn resample(drive: &[Instant]) -> Vec<(f64, Observation)> {
    let (Some(first), Some(last)) = (drive.first(), drive.last()) else {
        return Vec::new();
    };
    let count = ((last.time_s - first.time_s) / STEP_S + 1e-6) as usize;
    // Leader's speed, gap, own speed, gap and speed behind.
    let state = |one: &Instant| {
        let [gap_m, speed_mps] = one
            .behind
            .as_ref()
            .map_or([0.0; 2], |behind| [behind.gap_ahead_m, behind.speed_mps]);
        [
            one.leader_mps,
            one.vehicle.gap_ahead_m,
            one.vehicle.speed_mps,
            gap_m,
            speed_mps,
        ]
    };
    let mut after = 1;
    let mut states: Vec<[f64; 5]> = Vec::with_capacity(count);
    for step in 0..count {
        let at_s = first.time_s + step as f64 * STEP_S;
        while drive.get(after).is_some_and(|next| next.time_s <= at_s) {
            after += 1;
        }
        let (Some(from), Some(to)) = (drive.get(after - 1), drive.get(after)) else {
            break;
        };
        let share = ((at_s - from.time_s) / (to.time_s - from.time_s)).clamp(0.0, 1.0);
        let (from, to) = (state(from), state(to));
        states.push(std::array::from_fn(|index| {
            from[index] + share * (to[index] - from[index])
        }));
    }
    let acceleration = |step: usize, index: usize| {
        let before = step.saturating_sub(ACCELERATION_STEPS);
        let seconds = (step - before).max(1) as f64 * STEP_S;
        (states[step][index] - states[before][index]) / seconds
    };
    let observation =
        |(step, &[leader_mps, gap_m, speed_mps, gap_behind_m, behind_mps]): (usize, &[f64; 5])| {
            let neighbour = |gap_m, speed_mps, acceleration_mps2| Neighbour {
                gap_m,
                speed_mps,
                acceleration_mps2,
            };
            let observed = Observation {
                speed_mps,
                acceleration_mps2: acceleration(step, 2),
                ahead: Some(neighbour(gap_m, leader_mps, acceleration(step, 0))),
                behind: first
                    .behind
                    .as_ref()
                    .map(|_| neighbour(gap_behind_m, behind_mps, acceleration(step, 4))),
            };
            (first.time_s + step as f64 * STEP_S, observed)
        };
    states.iter().enumerate().map(observation).collect()
}

/// Returns the acceleration that the controller commands at each step, within the limits of the vehicle.
fn commands(
    first: &Instant,
    steps: &[(f64, Observation)],
    options: &RunOptions,
    advance: &dyn Fn(f64),
) -> Result<Vec<f64>, OpenLoopError> {
    let placed = |vehicle: &EpisodeVehicle, position_m, driver| {
        let length_m = vehicle.length_m.unwrap_or(CAR_LENGTH_M);
        let mut spec = VehicleSpec::new(
            VehicleClass::from_length(length_m),
            position_m,
            vehicle.speed_mps,
            driver,
        );
        spec.length_m = Some(length_m);
        spec
    };
    let holds_speed = || Driver::Profile(LeadProfile::ConstantSpeed);
    let mut leader = VehicleSpec::new(VehicleClass::Light, 0.0, first.leader_mps, holds_speed());
    leader.length_m = Some(CAR_LENGTH_M);
    let front_m = -CAR_LENGTH_M - first.vehicle.gap_ahead_m;
    let mut vehicles = vec![leader, placed(&first.vehicle, front_m, Driver::UnderTest)];
    if let Some(behind) = &first.behind {
        let length_m = first.vehicle.length_m.unwrap_or(CAR_LENGTH_M);
        vehicles.push(placed(
            behind,
            front_m - length_m - behind.gap_ahead_m,
            holds_speed(),
        ));
    }
    let spec = ScenarioSpec {
        step_s: STEP_S,
        ..ScenarioSpec::new("replay".to_owned(), 1.0, vehicles)
    };
    let run = Run::new(&Scenario::new(spec)?, options.clone())?;
    let Some(mut controller) = run.open_loop_controller(1) else {
        return Ok(Vec::new());
    };
    let mut command = |(time_s, observed): &(f64, Observation)| {
        let no_answer = |failure: ControllerFailure| OpenLoopError::NoAnswer {
            time_s: *time_s,
            reason: failure.to_string(),
        };
        controller.command_mps2(observed).map_err(no_answer)
    };
    let commands = steps.iter().enumerate().map(|(index, step)| {
        if index % 256 == 0 {
            advance(step.0);
        }
        command(step)
    });
    commands.collect()
}

fn evaluate(
    event: Option<&str>,
    first: &Instant,
    (steps, commands_mps2): (&[(f64, Observation)], &[f64]),
    min_brake_mps2: f64,
) -> ReplayedDrive {
    let drive_step = |&(time_s, observed): &(f64, Observation), acceleration_mps2: f64| {
        let ahead = observed.ahead.map(|ahead| PairState {
            time_s,
            gap_m: ahead.gap_m,
            front_speed_mps: ahead.speed_mps,
            rear_speed_mps: observed.speed_mps,
            front_acceleration_mps2: ahead.acceleration_mps2,
            rear_acceleration_mps2: acceleration_mps2,
        });
        DriveStep {
            time_s,
            duration_s: STEP_S,
            speed_mps: observed.speed_mps,
            acceleration_mps2,
            ahead,
        }
    };
    let of_controller = steps
        .iter()
        .zip(commands_mps2)
        .map(|(step, &command)| drive_step(step, command));
    let of_driver = steps
        .iter()
        .map(|step| drive_step(step, step.1.acceleration_mps2));
    let mut brakings = Vec::new();
    let is_braking: Vec<bool> = commands_mps2
        .iter()
        .map(|command| -command >= min_brake_mps2)
        .collect();
    let mut from = 0;
    for part in is_braking.chunk_by(|a, b| a == b) {
        let (start, end) = (from, from + part.len());
        from = end;
        if !part.contains(&true) || part.len() as f64 * STEP_S < MIN_BRAKING_S - 1e-9 {
            continue;
        }
        let until = (end + (1.0 / STEP_S) as usize).min(steps.len());
        let driver = steps[start..until]
            .iter()
            .map(|(_, observed)| -observed.acceleration_mps2);
        let (from_s, observed) = steps[start];
        brakings.push(ReplayedBraking {
            from_s,
            duration_s: part.len() as f64 * STEP_S,
            brake_mps2: commands_mps2[start..end]
                .iter()
                .fold(0.0, |hardest: f64, command| hardest.max(-command)),
            driver_brake_mps2: driver.fold(0.0, f64::max),
            speed_mps: observed.speed_mps,
            gap_m: observed.ahead.map_or(0.0, |ahead| ahead.gap_m),
        });
    }
    ReplayedDrive {
        event: event.map(str::to_owned),
        vehicle: first.vehicle.clone(),
        duration_s: steps.len() as f64 * STEP_S,
        distance_m: steps
            .iter()
            .map(|(_, observed)| observed.speed_mps * STEP_S)
            .sum(),
        brakings,
        unnecessary: [
            UnnecessaryBraking::from_steps(of_controller),
            UnnecessaryBraking::from_steps(of_driver),
        ],
    }
}
