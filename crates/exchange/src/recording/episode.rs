//! Braking episodes and their scenarios.

use crumple_sim::control::{AebSettings, BuiltInController};
use crumple_sim::scenario::{
    Driver, InvalidField, LeadProfile, RecordedSpeeds, Scenario, ScenarioSpec, VehicleClass,
    VehicleSpec,
};

use super::lead_vehicles::VehicleAhead;
use super::series::round_to_milli;

/// Length of a recorded car, in metres: antenna distance less bumper spacing, on average over twelve pairs of the
/// published files. The class length of 2 m is the paper's.
pub const CAR_LENGTH_M: f64 = 4.5;
/// Steps per second of the scenarios. Durations are rounded up to whole steps.
const STEPS_PER_S: f64 = 100.0;

/// Braking of a leader and initial state of its followers. Times count from the start of the scenario unless stated
/// otherwise.
#[derive(Debug, Clone, PartialEq)]
pub struct BrakingEpisode {
    /// Event of the recording, if the file names events; see [`RecordedPlatoon`](super::RecordedPlatoon).
    pub event: Option<String>,
    /// Line of the start, from 1.
    pub line: u64,
    /// Time of the start in the recording, in seconds.
    pub start_s: f64,
    /// Onset of the leader's braking above the threshold, in seconds.
    pub onset_s: f64,
    /// End of the last second of such braking, in seconds.
    pub braking_end_s: f64,
    /// Duration of the scenario, in seconds. After the end of the recording the leader holds its speed.
    pub duration_s: f64,
    /// Speed of the leader at the onset, in m/s.
    pub onset_speed_mps: f64,
    /// Speed of the leader at the end of braking, in m/s.
    pub end_speed_mps: f64,
    /// Largest loss of speed over one second, in m/s.
    pub largest_drop_mps: f64,
    /// Hardest braking between two samples, in m/s², positive.
    pub hardest_brake_mps2: f64,
    /// Hardest acceleration between two samples, in m/s².
    pub hardest_accel_mps2: f64,
    /// Vehicles at the start, front to rear, with the leader first.
    pub vehicles: Vec<EpisodeVehicle>,
    /// Vehicle ahead of the leader, which is not in the scenario.
    pub ahead: VehicleAhead,
    /// Number of the vehicle behind the last, if its gap or speed is unknown at the start.
    pub not_recorded_behind: Option<usize>,
    /// Time of each of the leader's samples, in seconds, to the millisecond.
    pub time_s: Vec<f64>,
    /// Speed of the leader at each of them, in m/s, to three decimals.
    pub speed_mps: Vec<f64>,
}

/// A vehicle at the start of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeVehicle {
    /// Number in the recording.
    pub number: usize,
    /// Make or role, if recorded.
    pub name: Option<String>,
    /// Bumper gap ahead, in metres, to three decimals; 0 for the leader.
    pub gap_ahead_m: f64,
    /// Speed in m/s, to three decimals.
    pub speed_mps: f64,
    /// Length from bumper to bumper, in metres, to three decimals, if recorded.
    pub length_m: Option<f64>,
}

impl BrakingEpisode {
    /// Creates the scenario: the leader drives as recorded, the others start as recorded and are then driven by
    /// controllers.
    ///
    /// The last of three or more vehicles drives the baseline ADAS, so that those under test have a follower; all other
    /// followers are under test. Vehicles of unknown length are light with 4.5 m; vehicles from 7.5 m on are heavy. The
    /// leader's limits are raised to its recorded motion where necessary.
    ///
    /// `file` is the name of the recording in the scenario's `about`.
    ///
    /// # Errors
    /// [`InvalidField`] for numbers that a scenario may not hold, such as positions beyond 1000 km.
    pub fn scenario(&self, name: String, file: &str) -> Result<Scenario, InvalidField> {
        let mut vehicles = self.vehicle_specs();
        if let Some(leader) = vehicles.first_mut() {
            leader.max_brake_mps2 = raise_limit(leader.max_brake_mps2(), self.hardest_brake_mps2);
            leader.max_accel_mps2 = raise_limit(leader.max_accel_mps2(), self.hardest_accel_mps2);
        }
        // Division rounds to the decimals of the file; multiplication by the step would not.
        let duration_s =
            (round_to_milli(self.duration_s) * STEPS_PER_S - 1e-6).ceil() / STEPS_PER_S;
        Scenario::new(ScenarioSpec {
            about: self.about(file),
            step_s: 1.0 / STEPS_PER_S,
            ..ScenarioSpec::new(name, duration_s, vehicles)
        })
    }

    /// Returns the vehicles of the scenario, front to rear; the last one is at position 0.
    fn vehicle_specs(&self) -> Vec<VehicleSpec> {
        let mut position_m = 0.0;
        let mut specs = Vec::with_capacity(self.vehicles.len());
        for (index, vehicle) in self.vehicles.iter().enumerate().rev() {
            let length_m = vehicle.length_m.unwrap_or(CAR_LENGTH_M);
            let class = VehicleClass::from_length(length_m);
            let driver = self.driver(index);
            let mut spec = VehicleSpec::new(class, position_m, vehicle.speed_mps, driver);
            spec.length_m = Some(length_m);
            specs.push(spec);
            let ahead = index
                .checked_sub(1)
                .and_then(|ahead| self.vehicles.get(ahead));
            let ahead_length_m = ahead
                .and_then(|ahead| ahead.length_m)
                .unwrap_or(CAR_LENGTH_M);
            position_m = round_to_milli(position_m + vehicle.gap_ahead_m + ahead_length_m);
        }
        specs.reverse();
        specs
    }

    /// Returns the driver of a vehicle of the scenario.
    fn driver(&self, index: usize) -> Driver {
        let last = self.vehicles.len().saturating_sub(1);
        match index {
            0 => Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
                time_s: self.time_s.clone(),
                speed_mps: self.speed_mps.clone(),
            })),
            _ if index == last && last > 1 => {
                Driver::Controller(BuiltInController::Baseline(AebSettings::default()))
            }
            _ => Driver::UnderTest,
        }
    }

    /// Describes the episode in sentences.
    fn about(&self, file: &str) -> String {
        let mut sentences = vec![self.describe_braking(file), self.describe_followers()];
        match self.ahead {
            VehicleAhead::None => {}
            VehicleAhead::Recorded(number) => sentences.push(format!(
                "Vehicle {number}, ahead of it, is no part of the scenario."
            )),
            VehicleAhead::NotRecorded(number) => sentences.push(format!(
                "Vehicle {number}, ahead of it, was not recorded at the time."
            )),
        }
        if let Some(number) = self.not_recorded_behind {
            sentences.push(format!(
                "Gap or speed of vehicle {number} is missing, so the line ends before it."
            ));
        }
        if let Some(&end_s) = self.time_s.last()
            && end_s < self.duration_s
        {
            sentences.push(format!(
                "The recording of its speed ends after {end_s:.1} s; it then holds the last one."
            ));
        }
        sentences.join(" ")
    }

    /// Describes place and braking of the leader.
    fn describe_braking(&self, file: &str) -> String {
        let event = self
            .event
            .as_ref()
            .map(|event| format!(", event {event}"))
            .unwrap_or_default();
        let leader = self
            .vehicles
            .first()
            .map(EpisodeVehicle::to_string)
            .unwrap_or_default();
        format!(
            "Recorded in {file}{event}, from {:.1} s on (line {}): {leader} slows from {:.1} to {:.1} m/s within {:.1} \
             s, by {:.2} m/s in its hardest second.",
            self.start_s,
            self.line,
            self.onset_speed_mps,
            self.end_speed_mps,
            self.braking_end_s - self.onset_s,
            self.largest_drop_mps,
        )
    }

    /// Describes the vehicles behind the leader.
    fn describe_followers(&self) -> String {
        let followers: Vec<_> = self
            .vehicles
            .iter()
            .skip(1)
            .map(EpisodeVehicle::to_string)
            .collect();
        let names = followers.join(", ");
        if followers.len() == 1 {
            format!("Behind it starts {names} at the recorded gap and speed.")
        } else {
            format!("Behind it start {names} at the recorded gaps and speeds.")
        }
    }
}

impl std::fmt::Display for EpisodeVehicle {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.name {
            Some(name) => write!(out, "vehicle {} ({name})", self.number),
            None => write!(out, "vehicle {}", self.number),
        }
    }
}

/// Returns the limit, rounded up to a tenth, if the recording exceeds the class.
fn raise_limit(class_mps2: f64, recorded_mps2: f64) -> Option<f64> {
    (recorded_mps2 > class_mps2)
        .then(|| (recorded_mps2 * 10.0).floor() / 10.0 + 0.1)
        .map(round_to_milli)
}
