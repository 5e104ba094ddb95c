//! Detection of braking episodes and of their start.

use std::cmp::Reverse;

use super::dropped::{CHECK_UNIT, DroppedItem, EpisodeProblem, Omission};
use super::episode::BrakingEpisode;
use super::error::RecordingError;
use super::lead_vehicles::{LeadVehicle, VehicleAhead};
use super::motion::{BrakingEvent, SpeedSample, find_brakings, speed_at_mps};
use super::vehicle_motion::VehicleMotion;
use super::{MAX_PLAUSIBLE_ACCEL_MPS2, Recording};
use crumple_core::digits::{format_fixed, format_number};

/// Time before braking at which a scenario starts, in milliseconds; sensors and filters settle in it.
const LEAD_IN_MS: i64 = 1_000;
/// Time before braking within which a start is searched, in milliseconds.
const START_SEARCH_MS: i64 = 2_000;
/// Time that a scenario continues after braking, unless the leader brakes again, in milliseconds. A braking wave passes
/// from car to car in about a second, and the last car still has to stop.
const TAIL_MS: i64 = 10_000;

/// Mean braking over a second that is reported, because a unit may be wrong, in m/s².
const MAX_USUAL_BRAKE_MPS2: f64 = 10.0;

/// Smallest braking of an episode: the speed lost within one second, in m/s².
///
/// The default is 1.3 m/s², above which a car with electric or automatic braking must light its stop lamps (UN
/// Regulation 13-H, 5.2.22.4). On samples of the published data (two OpenACC files of two minutes and one and a half,
/// twenty NGSIM events) it yields 23 episodes; 1.0 yields 36 and 2.0 yields 8.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MinBrake(f64);

impl MinBrake {
    /// Creates a threshold in m/s².
    ///
    /// # Errors
    /// [`RecordingError::MinBrake`] unless it is above 0 and at most 12 m/s², which no road vehicle exceeds.
    pub fn new(mps2: f64) -> Result<Self, RecordingError> {
        let possible = mps2 > 0.0 && mps2 <= MAX_PLAUSIBLE_ACCEL_MPS2;
        if possible {
            Ok(Self(mps2))
        } else {
            Err(RecordingError::MinBrake { found: mps2 })
        }
    }

    /// Returns the threshold in m/s².
    #[must_use]
    pub fn mps2(self) -> f64 {
        self.0
    }
}

impl Default for MinBrake {
    fn default() -> Self {
        Self(1.3)
    }
}

/// Braking episodes, and dropped ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FoundEpisodes {
    /// Episodes, in the order of the file.
    pub episodes: Vec<BrakingEpisode>,
    /// Episodes without a scenario, and with unusual braking.
    pub dropped: Vec<DroppedItem>,
}

/// A selection of the vehicles whose braking makes episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LeaderSelection {
    /// Every vehicle with a follower.
    #[default]
    Any,
    /// Vehicles without a recorded vehicle ahead: the others only react to it.
    First,
}

/// Finds the braking episodes of a recording.
///
/// An episode is a loss of speed above the threshold within one second, merged with those within 5 s of its end. It
/// starts about 1 s earlier, at the sample with the most followers with known speeds and gaps, and ends 10 s after
/// braking or at the next episode of the vehicle.
///
/// The braking vehicle leads the scenario. A growing braking wave thus makes an episode at each car. With
/// [`LeaderSelection::First`], only vehicles without a recorded vehicle ahead at that time lead.
#[must_use]
pub fn find_episodes(
    recording: &Recording,
    min_brake: MinBrake,
    leaders: LeaderSelection,
) -> FoundEpisodes {
    let mut result = FoundEpisodes::default();
    for lead in recording.lead_vehicles() {
        for run in lead.segments() {
            let brakings = find_brakings(&run, min_brake.mps2());
            let next_onsets = brakings
                .iter()
                .skip(1)
                .map(|next| Some(next.onset_ms))
                .chain([None]);
            for (braking, next_onset_ms) in brakings.iter().zip(next_onsets) {
                if !lead.core_ms().contains(&braking.onset_ms) {
                    continue;
                }
                let window = EpisodeWindow {
                    lead: &*lead,
                    run: &run,
                    braking,
                    next_onset_ms,
                };
                window.extract(recording, leaders, &mut result);
            }
        }
    }
    result.episodes.sort_by_key(|episode| episode.line);
    result
}

struct EpisodeWindow<'a> {
    lead: &'a dyn LeadVehicle,
    run: &'a [SpeedSample],
    braking: &'a BrakingEvent,
    next_onset_ms: Option<i64>,
}

impl EpisodeWindow<'_> {
    /// Adds the episode, or the reason why there is none.
    fn extract(&self, recording: &Recording, leaders: LeaderSelection, result: &mut FoundEpisodes) {
        let candidates = self.samples_between(
            self.braking.onset_ms - START_SEARCH_MS,
            self.braking.onset_ms,
        );
        if leaders == LeaderSelection::First && candidates.iter().any(|sample| self.follows(sample))
        {
            return;
        }
        let Some(start) = candidates.iter().max_by_key(|sample| self.rank(sample)) else {
            return;
        };
        let number = self.lead.number();
        let onset_s = self.braking.onset_ms as f64 / 1000.0;
        let omission = match self.build_episode(start) {
            Ok(episode) => {
                let unusual = (episode.largest_drop_mps > MAX_USUAL_BRAKE_MPS2).then(|| {
                    let brake_mps2 = format_fixed(episode.largest_drop_mps, 1);
                    let onset_s = format_number(onset_s);
                    Omission::Note(format!(
                        "vehicle {number} brakes by {brake_mps2} m/s² at {onset_s} s: {CHECK_UNIT}"
                    ))
                });
                result.episodes.push(episode);
                unusual
            }
            Err(reason) => Some(Omission::Episode {
                number,
                onset_s,
                reason,
            }),
        };
        result.dropped.extend(omission.map(|omission| DroppedItem {
            path: recording.path.clone(),
            line: self.lead.line_of(start),
            omission,
        }));
    }

    /// Returns whether the leader itself follows a recorded vehicle.
    fn follows(&self, sample: &SpeedSample) -> bool {
        let ahead = self.lead.vehicle_ahead_at(sample);
        matches!(ahead, VehicleAhead::Recorded(_))
    }

    /// Ranks a start by the number of its followers, and then by its distance from the usual time before braking.
    fn rank(&self, start: &SpeedSample) -> (usize, Reverse<i64>) {
        let usual_ms = self.braking.onset_ms - LEAD_IN_MS;
        let distance_ms = (start.time_ms - usual_ms).abs();
        (self.lead.followers_at(start).len(), Reverse(distance_ms))
    }

    fn samples_between(&self, from_ms: i64, to_ms: i64) -> &[SpeedSample] {
        let from = self.run.partition_point(|sample| sample.time_ms < from_ms);
        let to = self.run.partition_point(|sample| sample.time_ms <= to_ms);
        self.run.get(from..to).unwrap_or_default()
    }

    fn build_episode(&self, start: &SpeedSample) -> Result<BrakingEpisode, EpisodeProblem> {
        let followers = self.lead.followers_at(start);
        if followers.is_empty() {
            let within_s = START_SEARCH_MS as f64 / 1000.0;
            return Err(match self.lead.next_behind(0) {
                Some(follower) => EpisodeProblem::NoFollower { follower, within_s },
                None => EpisodeProblem::NoVehicleBehind { within_s },
            });
        }
        let end_ms = (self.braking.end_ms + TAIL_MS).min(self.next_onset_ms.unwrap_or(i64::MAX));
        let samples = self.samples_between(start.time_ms, end_ms);
        let leader_motion = VehicleMotion::new(samples)?;
        let last = Some(followers.len()).filter(|count| *count > 1);
        let last_motion = last.map(|last| {
            VehicleMotion::until_jump(&self.lead.speeds_of_follower(start, last, end_ms))
        });
        let since_start_s = |time_ms: i64| (time_ms - start.time_ms) as f64 / 1000.0;
        let not_recorded_behind = self.lead.next_behind(followers.len());
        Ok(BrakingEpisode {
            event: self.lead.event().map(str::to_owned),
            line: self.lead.line_of(start),
            start_s: start.time_ms as f64 / 1000.0,
            onset_s: since_start_s(self.braking.onset_ms),
            braking_end_s: since_start_s(self.braking.end_ms),
            duration_s: since_start_s(end_ms),
            onset_speed_mps: speed_at_mps(self.run, self.braking.onset_ms),
            end_speed_mps: speed_at_mps(self.run, self.braking.end_ms),
            largest_drop_mps: self.braking.largest_drop_mps,
            vehicles: [vec![self.lead.episode_vehicle(start)], followers].concat(),
            ahead: self.lead.vehicle_ahead_at(start),
            not_recorded_behind,
            leader_motion,
            last_motion,
        })
    }
}
