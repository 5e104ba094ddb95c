//! Braking episodes and their scenarios.

use super::lead_vehicles::VehicleAhead;
use super::series::round_to_milli;
use super::vehicle_line::{FollowerDriver, VehicleLine};
use super::vehicle_motion::VehicleMotion;
use crumple_sim::scenario::{InvalidField, Scenario, ScenarioSpec};

/// Length of a recorded car, in metres: antenna distance less bumper spacing, on average over twelve pairs of the
/// published files. The class length of 2 m is the paper's.
pub const CAR_LENGTH_M: f64 = 4.5;
/// Steps per second of the scenarios. Durations are rounded up to whole steps.
pub(super) const STEPS_PER_S: f64 = 100.0;

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
    /// Vehicles at the start, front to rear, with the leader first.
    pub vehicles: Vec<EpisodeVehicle>,
    /// Vehicle ahead of the leader, which is not in the scenario.
    pub ahead: VehicleAhead,
    /// Number of the vehicle behind the last, if its gap or speed is unknown at the start.
    pub not_recorded_behind: Option<usize>,
    /// Motion of the leader.
    pub leader_motion: VehicleMotion,
    /// Motion of the last of three or more vehicles, up to the first acceleration that no vehicle has.
    pub last_motion: Option<VehicleMotion>,
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
    /// `follower` drives the last of three or more vehicles; all other followers are under test. Vehicles of unknown
    /// length are light with 4.5 m; vehicles from 7.5 m on are heavy. The limits of vehicles that repeat recorded
    /// speeds are raised to their motion where necessary. With a human follower, the seed follows from the name.
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
        // Division rounds to the decimals of the file; multiplication by the step would not.
        let duration_s =
            (round_to_milli(self.duration_s) * STEPS_PER_S - 1e-6).ceil() / STEPS_PER_S;
        Scenario::new(ScenarioSpec {
            about: self.about(file, follower),
            step_s: 1.0 / STEPS_PER_S,
            seed: follower.seed(&name),
            ..ScenarioSpec::new(name, duration_s, self.line_of_vehicles().specs(follower))
        })
    }

    fn line_of_vehicles(&self) -> VehicleLine<'_> {
        VehicleLine {
            vehicles: &self.vehicles,
            leader_motion: &self.leader_motion,
            last_motion: self.last_motion.as_ref(),
        }
    }

    /// Describes the episode in sentences.
    fn about(&self, file: &str, follower: &FollowerDriver) -> String {
        let mut sentences = vec![
            self.describe_braking(file),
            self.describe_followers(),
            self.line_of_vehicles()
                .describe_last(follower, self.duration_s),
        ];
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
        let end = self
            .leader_motion
            .describe_end("the leader's", self.duration_s);
        sentences.extend(end);
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
