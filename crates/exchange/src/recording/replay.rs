//! Open-loop replay: the commands of a controller that observes a recorded drive and cannot change it.

use super::drive::{DriveInstant, DriveState, interpolate_states, split_drives};
use super::lead_vehicles::LeadVehicle;
use super::motion::SpeedSample;
use super::{CAR_LENGTH_M, EpisodeVehicle, Recording};
use crumple_core::digits::format_fixed;
use crumple_measure::{DriveStep, MIN_BRAKING_S, PairState, UnnecessaryBraking};
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
const MIN_REPLAY_S: f64 = 1.0;

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
    let total_s: f64 = leads
        .iter()
        .flat_map(|lead| lead.segments())
        .map(|segment| segment_duration_s(&segment))
        .sum();
    let mut done_s = 0.0;
    for lead in &leads {
        for segment in lead.segments() {
            for drive in drives_of_segment(&**lead, &segment) {
                let commands_mps2 =
                    drive.commands_mps2(options, &|now_s| advance(done_s + now_s, total_s))?;
                replayed.push(drive.evaluate(&commands_mps2, min_brake_mps2));
            }
            done_s += segment_duration_s(&segment);
        }
    }
    Ok(replayed)
}

/// Returns every recorded drive behind a leader that lasts at least a second.
#[must_use]
pub fn open_loop_drives(recording: &Recording) -> Vec<OpenLoopDrive> {
    let mut drives = Vec::new();
    for lead in &recording.lead_vehicles() {
        for segment in lead.segments() {
            drives.extend(drives_of_segment(&**lead, &segment));
        }
    }
    drives
}

fn drives_of_segment(
    lead: &dyn LeadVehicle,
    segment: &[SpeedSample],
) -> impl Iterator<Item = OpenLoopDrive> {
    let event = lead.event().map(str::to_owned);
    split_drives(lead, segment, DriveInstant::has_same_follower)
        .into_iter()
        .filter_map(move |instants| OpenLoopDrive::new(event.clone(), &instants))
}

fn segment_duration_s(segment: &[SpeedSample]) -> f64 {
    segment
        .first()
        .zip(segment.last())
        .map_or(0.0, |(first, last)| {
            (last.time_ms - first.time_ms) as f64 / 1000.0
        })
}

/// A recorded drive of one vehicle behind another, without holes, which a controller can observe but not change.
#[derive(Debug, Clone)]
pub struct OpenLoopDrive {
    event: Option<String>,
    first: DriveInstant,
    steps: Vec<ReplayStep>,
}

/// Recorded state of a drive at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReplayStep {
    /// Time of the recording, in seconds.
    pub time_s: f64,
    /// Observation of a controller in place of the vehicle.
    pub observed: Observation,
}

impl OpenLoopDrive {
    /// Duration of a step, in seconds.
    pub const STEP_S: f64 = STEP_S;

    /// Returns the drive of these instants; `None` if it is too short.
    fn new(event: Option<String>, instants: &[DriveInstant]) -> Option<Self> {
        let steps = resample(instants);
        let first = instants.first()?.clone();
        (steps.len() as f64 * STEP_S >= MIN_REPLAY_S).then_some(Self {
            event,
            first,
            steps,
        })
    }

    /// Returns the event, if the file names events.
    #[must_use]
    pub fn event(&self) -> Option<&str> {
        self.event.as_deref()
    }

    /// Returns the number of the vehicle that the controller replaces.
    #[must_use]
    pub fn vehicle(&self) -> usize {
        self.first.vehicle.number
    }

    /// Returns the recorded states, one each [`OpenLoopDrive::STEP_S`]; at least one.
    #[must_use]
    pub fn steps(&self) -> &[ReplayStep] {
        &self.steps
    }

    /// Returns the acceleration that the controller of `options` commands at each step, in m/s², within the limits of
    /// the vehicle. `advance` receives the replayed seconds.
    ///
    /// # Errors
    /// [`OpenLoopError`] if the controller cannot drive.
    pub fn commands_mps2(
        &self,
        options: &RunOptions,
        advance: &dyn Fn(f64),
    ) -> Result<Vec<f64>, OpenLoopError> {
        let run = Run::new(&initial_scenario(&self.first)?, options.clone())?;
        let Some(mut controller) = run.open_loop_controller(1) else {
            return Ok(Vec::new());
        };
        let commands = self.steps.iter().enumerate().map(|(index, step)| {
            if index % 256 == 0 {
                advance(step.time_s - self.first.time_s);
            }
            controller
                .command_mps2(&step.observed)
                .map_err(|failure| OpenLoopError::NoAnswer {
                    time_s: step.time_s,
                    reason: failure.to_string(),
                })
        });
        commands.collect()
    }

    /// Measures the braking that a controller commands, and that of the driver. Brakings count from `min_brake_mps2`
    /// on.
    #[must_use]
    pub fn evaluate(&self, commands_mps2: &[f64], min_brake_mps2: f64) -> ReplayedDrive {
        let steps = &self.steps;
        let controller_steps = steps
            .iter()
            .zip(commands_mps2)
            .map(|(step, &command_mps2)| step.with_acceleration(command_mps2));
        let driver_steps = steps
            .iter()
            .map(|step| step.with_acceleration(step.observed.acceleration_mps2));
        ReplayedDrive {
            event: self.event.clone(),
            vehicle: self.first.vehicle.clone(),
            duration_s: steps.len() as f64 * STEP_S,
            distance_m: steps
                .iter()
                .map(|step| step.observed.speed_mps * STEP_S)
                .sum(),
            brakings: replayed_brakings(steps, commands_mps2, min_brake_mps2),
            unnecessary: [
                UnnecessaryBraking::from_steps(controller_steps),
                UnnecessaryBraking::from_steps(driver_steps),
            ],
        }
    }
}

/// Interpolates a drive to the time step, with the time of the recording.
fn resample(drive: &[DriveInstant]) -> Vec<ReplayStep> {
    let Some(first) = drive.first() else {
        return Vec::new();
    };
    let states = interpolate_states(drive, STEP_S);
    let steps = (0..states.len()).map(|step| ReplayStep {
        time_s: first.time_s + step as f64 * STEP_S,
        observed: observe(&states, step, first.behind.is_some()),
    });
    steps.collect()
}

/// Returns the observation of the controller at a step.
fn observe(states: &[DriveState], step: usize, has_follower: bool) -> Observation {
    let earlier_step = step.saturating_sub(ACCELERATION_STEPS);
    let seconds = (step - earlier_step).max(1) as f64 * STEP_S;
    let earlier = &states[earlier_step];
    let now = &states[step];
    Observation {
        speed_mps: now.speed_mps,
        acceleration_mps2: (now.speed_mps - earlier.speed_mps) / seconds,
        ahead: Some(Neighbour {
            gap_m: now.gap_m,
            speed_mps: now.leader_mps,
            acceleration_mps2: (now.leader_mps - earlier.leader_mps) / seconds,
        }),
        behind: has_follower.then(|| Neighbour {
            gap_m: now.gap_behind_m,
            speed_mps: now.behind_mps,
            acceleration_mps2: (now.behind_mps - earlier.behind_mps) / seconds,
        }),
    }
}

/// Returns a scenario of the vehicles at the start of a drive, of which the controller drives the second one.
fn initial_scenario(first: &DriveInstant) -> Result<Scenario, InvalidField> {
    let mut leader = VehicleSpec::new(
        VehicleClass::Light,
        0.0,
        first.sample.speed_mps,
        constant_speed(),
    );
    leader.length_m = Some(CAR_LENGTH_M);
    let front_m = -CAR_LENGTH_M - first.vehicle.gap_ahead_m;
    let follower = vehicle_spec(&first.vehicle, front_m, Driver::UnderTest);
    let mut vehicles = vec![leader, follower];
    if let Some(behind) = &first.behind {
        let length_m = first.vehicle.length_m.unwrap_or(CAR_LENGTH_M);
        let behind_front_m = front_m - length_m - behind.gap_ahead_m;
        vehicles.push(vehicle_spec(behind, behind_front_m, constant_speed()));
    }
    Scenario::new(ScenarioSpec {
        step_s: STEP_S,
        ..ScenarioSpec::new("replay".to_owned(), 1.0, vehicles)
    })
}

fn constant_speed() -> Driver {
    Driver::Profile(LeadProfile::ConstantSpeed)
}

fn vehicle_spec(vehicle: &EpisodeVehicle, position_m: f64, driver: Driver) -> VehicleSpec {
    let length_m = vehicle.length_m.unwrap_or(CAR_LENGTH_M);
    let class = VehicleClass::from_length(length_m);
    let mut spec = VehicleSpec::new(class, position_m, vehicle.speed_mps, driver);
    spec.length_m = Some(length_m);
    spec
}

impl ReplayStep {
    /// Returns the step of a drive in which the vehicle had this acceleration.
    fn with_acceleration(&self, acceleration_mps2: f64) -> DriveStep {
        let Self { time_s, observed } = self;
        DriveStep {
            time_s: *time_s,
            duration_s: STEP_S,
            speed_mps: observed.speed_mps,
            acceleration_mps2,
            ahead: observed.ahead.map(|ahead| PairState {
                time_s: *time_s,
                gap_m: ahead.gap_m,
                front_speed_mps: ahead.speed_mps,
                rear_speed_mps: observed.speed_mps,
                front_acceleration_mps2: ahead.acceleration_mps2,
                rear_acceleration_mps2: acceleration_mps2,
            }),
        }
    }
}

/// Finds the brakings that the controller commands for long enough.
fn replayed_brakings(
    steps: &[ReplayStep],
    commands_mps2: &[f64],
    min_brake_mps2: f64,
) -> Vec<ReplayedBraking> {
    let mut brakings = Vec::new();
    let is_braking: Vec<bool> = commands_mps2
        .iter()
        .map(|command| -command >= min_brake_mps2)
        .collect();
    let mut end = 0;
    for interval in is_braking.chunk_by(|a, b| a == b) {
        let start = end;
        end += interval.len();
        let duration_s = interval.len() as f64 * STEP_S;
        if !interval.contains(&true) || duration_s < MIN_BRAKING_S - 1e-9 {
            continue;
        }
        let until = (end + (1.0 / STEP_S) as usize).min(steps.len());
        let driver_brakes_mps2 = steps[start..until]
            .iter()
            .map(|step| -step.observed.acceleration_mps2);
        let ReplayStep { time_s, observed } = &steps[start];
        brakings.push(ReplayedBraking {
            from_s: *time_s,
            duration_s,
            brake_mps2: commands_mps2[start..end]
                .iter()
                .fold(0.0, |hardest: f64, command| hardest.max(-command)),
            driver_brake_mps2: driver_brakes_mps2.fold(0.0, f64::max),
            speed_mps: observed.speed_mps,
            gap_m: observed.ahead.map_or(0.0, |ahead| ahead.gap_m),
        });
    }
    brakings
}
