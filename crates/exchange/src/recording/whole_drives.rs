//! Whole recorded drives, and their scenarios.

use super::drive::{DriveInstant, DriveState, interpolate_states, split_drives};
use super::episode::{EpisodeVehicle, STEPS_PER_S};
use super::episodes::LeaderSelection;
use super::lead_vehicles::{LeadVehicle, VehicleAhead};
use super::motion::SpeedSample;
use super::series::round_to_milli;
use super::vehicle_line::{FollowerDriver, VehicleLine};
use super::vehicle_motion::VehicleMotion;
use super::{MAX_PLAUSIBLE_ACCEL_MPS2, Recording};
use crumple_sim::scenario::{InvalidField, RecordedMotion, Scenario, ScenarioSpec};

/// Interval of the speeds and gaps of a drive, in milliseconds. Speeds are linear between them.
const INTERVAL_MS: i64 = 100;
const INTERVAL_S: f64 = INTERVAL_MS as f64 / 1000.0;
/// Shortest drive that becomes a scenario, in seconds.
pub const MIN_DRIVE_S: f64 = 30.0;
/// Longest drive, in seconds: another one follows it. The file of an hour takes 1.5 MB.
pub const MAX_DRIVE_S: f64 = 3600.0;

/// A drive of a recorded vehicle behind its leader, without holes. Times count from its start unless stated otherwise.
#[derive(Debug, Clone, PartialEq)]
pub struct WholeDrive {
    /// Event of the recording, if the file names events; see [`RecordedPlatoon`](super::RecordedPlatoon).
    pub event: Option<String>,
    /// Line of the start, from 1.
    pub line: u64,
    /// Time of the start in the recording, in seconds.
    pub start_s: f64,
    /// Duration, in seconds.
    pub duration_s: f64,
    /// Leader, the vehicle itself and, if recorded at the start, the vehicle behind it.
    pub vehicles: Vec<EpisodeVehicle>,
    /// Vehicle ahead of the leader, which is not in the scenario.
    pub ahead: VehicleAhead,
    /// Motion of the leader.
    pub leader_motion: VehicleMotion,
    /// Motion of the vehicle itself, in whose place the controller under test drives.
    pub motion: RecordedMotion,
    /// Motion of the vehicle behind, up to a hole or to the first acceleration that no vehicle has.
    pub last_motion: Option<VehicleMotion>,
}

/// Finds the drives of at least [`MIN_DRIVE_S`] of every recorded vehicle behind its leader.
///
/// A drive ends where speeds or the gap are unknown, where another vehicle follows the leader, where a speed changes
/// faster than any road vehicle's, at the end of a part of a long recording, and after [`MAX_DRIVE_S`]. With
/// [`LeaderSelection::First`], the leader has no recorded vehicle ahead of it at the start.
#[must_use]
pub fn find_drives(recording: &Recording, leaders: LeaderSelection) -> Vec<WholeDrive> {
    let mut drives = Vec::new();
    for lead in recording.lead_vehicles() {
        for segment in lead.segments() {
            let pieces = split_drives(&*lead, &segment, |_, _| true)
                .into_iter()
                .flat_map(split_at_jumps);
            drives.extend(pieces.filter_map(|piece| WholeDrive::new(&*lead, &piece)));
        }
    }
    drives.retain(|drive| {
        leaders == LeaderSelection::Any || !matches!(drive.ahead, VehicleAhead::Recorded(_))
    });
    drives.sort_by_key(|drive| drive.line);
    drives
}

/// Splits a drive after [`MAX_DRIVE_S`], and where the speed of a vehicle changes faster than any road vehicle's.
pub(super) fn split_at_jumps(drive: Vec<DriveInstant>) -> Vec<Vec<DriveInstant>> {
    let Some(start_s) = drive.first().map(|first| first.time_s) else {
        return Vec::new();
    };
    let states = interpolate_states(&drive, INTERVAL_S);
    let mut cuts_s = Vec::new();
    let mut piece_start_s = start_s;
    for (index, pair) in states.windows(2).enumerate() {
        let at_s = start_s + (index + 1) as f64 * INTERVAL_S;
        if has_jump(pair) || at_s - piece_start_s > MAX_DRIVE_S + 0.5 * INTERVAL_S {
            cuts_s.push(at_s);
            piece_start_s = at_s;
        }
    }
    // From the end: each piece is then copied once.
    let mut rest = drive;
    let mut pieces = Vec::new();
    for cut_s in cuts_s.into_iter().rev() {
        let end = rest.partition_point(|instant| instant.time_s < cut_s - 1e-6);
        pieces.push(rest.split_off(end));
    }
    // The first piece would otherwise keep memory for the whole drive.
    rest.shrink_to_fit();
    pieces.push(rest);
    pieces.reverse();
    pieces
}

fn has_jump(pair: &[DriveState]) -> bool {
    let [from, to] = pair else { return false };
    let changes_mps = [
        to.leader_mps - from.leader_mps,
        to.speed_mps - from.speed_mps,
    ];
    let limit_mps = MAX_PLAUSIBLE_ACCEL_MPS2 * INTERVAL_S;
    changes_mps.iter().any(|change| change.abs() > limit_mps)
}

impl WholeDrive {
    /// Describes the instants of a drive; `None` if it is too short.
    fn new(lead: &dyn LeadVehicle, instants: &[DriveInstant]) -> Option<Self> {
        let first = instants.first()?;
        let states = interpolate_states(instants, INTERVAL_S);
        let duration_s = round_to_milli(states.len().saturating_sub(1) as f64 * INTERVAL_S);
        if duration_s < MIN_DRIVE_S {
            return None;
        }
        let values = |value: fn(&DriveState) -> f64| -> Vec<f64> {
            states
                .iter()
                .map(|state| round_to_milli(value(state)))
                .collect()
        };
        let until_ms = first.sample.time_ms + (duration_s * 1000.0) as i64;
        let last_motion = first.behind.is_some().then(|| {
            let samples = lead.speeds_of_follower(&first.sample, 2, until_ms);
            VehicleMotion::until_jump(&thinned(&samples))
        });
        let leader = EpisodeVehicle {
            speed_mps: round_to_milli(first.sample.speed_mps),
            ..lead.episode_vehicle(&first.sample)
        };
        let vehicles = [leader, first.vehicle.clone()]
            .into_iter()
            .chain(first.behind.clone());
        Some(Self {
            event: lead.event().map(str::to_owned),
            line: lead.line_of(&first.sample),
            start_s: first.time_s,
            duration_s,
            vehicles: vehicles.collect(),
            ahead: lead.vehicle_ahead_at(&first.sample),
            leader_motion: VehicleMotion::until_jump(&samples_at_intervals(&values(|state| {
                state.leader_mps
            }))),
            motion: RecordedMotion {
                interval_s: INTERVAL_S,
                gap_m: values(|state| state.gap_m),
                speed_mps: values(|state| state.speed_mps),
            },
            last_motion,
        })
    }

    /// Creates the scenario: the leader drives as recorded, the controller under test starts at the recorded gap and
    /// speed of the vehicle, and `follower` drives the vehicle behind it from its recorded start on.
    ///
    /// `file` is the name of the recording in the scenario's `about`.
    ///
    /// # Errors
    /// [`InvalidField`] for numbers that a scenario may not hold, such as positions beyond 1000 km.
    pub fn scenario(
        &self,
        name: String,
        file: &str,
        follower: &FollowerDriver,
    ) -> Result<Scenario, InvalidField> {
        let line = VehicleLine {
            vehicles: &self.vehicles,
            leader_motion: &self.leader_motion,
            last_motion: self.last_motion.as_ref(),
        };
        let mut vehicles = line.specs(follower);
        if let Some(tested) = vehicles.get_mut(1) {
            tested.recorded = Some(Box::new(self.motion.clone()));
        }
        Scenario::new(ScenarioSpec {
            about: [
                self.describe_drive(file),
                line.describe_last(follower, self.duration_s),
            ]
            .join(" "),
            step_s: 1.0 / STEPS_PER_S,
            seed: follower.seed(&name),
            ..ScenarioSpec::new(name, self.duration_s, vehicles)
        })
    }

    /// Describes place, leader and vehicle.
    fn describe_drive(&self, file: &str) -> String {
        let event = self
            .event
            .as_ref()
            .map(|event| format!(", event {event}"))
            .unwrap_or_default();
        let [leader, vehicle] = [0, 1].map(|index| {
            self.vehicles
                .get(index)
                .map(EpisodeVehicle::to_string)
                .unwrap_or_default()
        });
        let speeds = self.leader_motion.speed_mps.iter().copied();
        let [lowest_mps, highest_mps] = [
            speeds.clone().fold(f64::INFINITY, f64::min),
            speeds.fold(0.0, f64::max),
        ];
        format!(
            "Recorded in {file}{event}, from {:.1} s on (line {}): {leader} leads for {:.1} s at {lowest_mps:.1} to \
             {highest_mps:.1} m/s. The vehicle under test starts in the place of {vehicle}.",
            self.start_s, self.line, self.duration_s,
        )
    }
}

/// Returns speeds at the intervals of a drive as samples.
fn samples_at_intervals(speeds_mps: &[f64]) -> Vec<SpeedSample> {
    let samples = speeds_mps
        .iter()
        .zip(0_i64..)
        .map(|(&speed_mps, index)| SpeedSample {
            index: 0,
            time_ms: index * INTERVAL_MS,
            speed_mps,
        });
    samples.collect()
}

/// Returns samples of which two are at least nearly an interval apart.
fn thinned(samples: &[SpeedSample]) -> Vec<SpeedSample> {
    let mut thinned: Vec<SpeedSample> = Vec::new();
    for sample in samples {
        let is_near = thinned
            .last()
            .is_some_and(|last| sample.time_ms - last.time_ms < INTERVAL_MS * 9 / 10);
        if !is_near {
            thinned.push(*sample);
        }
    }
    thinned
}
