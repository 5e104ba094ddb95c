//! Where the leader of a recorded platoon brakes, and where to start a scenario from.

use std::cmp::Reverse;

use super::dropped::{Dropped, NoScenario, Omission};
use super::episode::{Episode, Placed};
use super::error::RecordingError;
use super::motion::{Braking, Sample, brakings, runs, speed_at_mps};
use super::series::rounded;
use super::{HARDEST_CHANGE_MPS2, Platoon, Recording};

/// A scenario starts about this long before braking does, so that sensors and filters have settled, in milliseconds.
const LEAD_IN_MS: i64 = 1_000;
/// A start is looked for within this long before braking, in milliseconds.
const START_WITHIN_MS: i64 = 2_000;
/// A scenario lasts this long beyond the end of braking, unless the leader brakes anew before, in milliseconds. A
/// brake wave passes from car to car in about a second, and the last of them still has to stop.
const TAIL_MS: i64 = 10_000;

/// The least braking that makes an episode: the speed lost within one second, in m/s².
///
/// The default is 1.3 m/s², the deceleration above which a car that brakes electrically or automatically must light its
/// stop lamps (UN Regulation 13-H, 5.2.22.4): what the driver behind has to be warned of. On samples of the published
/// data (two OpenACC files of two minutes and one and a half, twenty NGSIM events) it yields 23 episodes; 1.0 yields 36
/// and 2.0 yields 8.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MinBrake(f64);

impl MinBrake {
    /// A threshold in m/s².
    ///
    /// # Errors
    /// [`RecordingError::MinBrake`] unless it is above 0 and at most 12 m/s², which no road vehicle exceeds.
    pub fn new(mps2: f64) -> Result<Self, RecordingError> {
        let possible = mps2 > 0.0 && mps2 <= HARDEST_CHANGE_MPS2;
        if possible { Ok(Self(mps2)) } else { Err(RecordingError::MinBrake { found: mps2 }) }
    }

    /// The threshold in m/s².
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

/// Braking episodes, and those that were left out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FoundEpisodes {
    /// Episodes in the order of the file.
    pub episodes: Vec<Episode>,
    /// Episodes no scenario can be made of.
    pub dropped: Vec<Dropped>,
}

/// Finds the braking episodes of a recording.
///
/// An episode is a drop of the leader's speed by more than the threshold within one second, merged with those that
/// follow within 5 s of its end. It starts about 1 s before, at the sample at which the longest unbroken line of
/// followers has known speeds and gaps, and ends 10 s after braking or when the next episode begins.
///
/// The leader is the first vehicle of the platoon, and wherever the vehicles ahead of it are not recorded, the first one
/// that is: a platoon whose first cars drop out for a while has a leader all the same. Braking of the cars behind it is
/// their reaction, which is for the controllers to decide, and makes no episode.
#[must_use]
pub fn episodes(recording: &Recording, min_brake: MinBrake) -> FoundEpisodes {
    let mut found = FoundEpisodes::default();
    for platoon in &recording.platoons {
        for leader in 0..platoon.vehicles.len().saturating_sub(1) {
            for run in runs(platoon, leader) {
                let brakings = brakings(&run, min_brake.mps2());
                let next_onsets = brakings.iter().skip(1).map(|next| Some(next.onset_ms)).chain([None]);
                for (braking, next_onset_ms) in brakings.iter().zip(next_onsets) {
                    let window = Window { platoon, leader, run: &run, braking, next_onset_ms };
                    window.find(recording, &mut found);
                }
            }
        }
    }
    let start = |episode: &Episode| episode.line;
    found.episodes.sort_by_key(start);
    found
}

/// One braking and what surrounds it.
struct Window<'a> {
    platoon: &'a Platoon,
    leader: usize,
    run: &'a [Sample],
    braking: &'a Braking,
    next_onset_ms: Option<i64>,
}

impl Window<'_> {
    fn find(&self, recording: &Recording, found: &mut FoundEpisodes) {
        let candidates = self.between(self.braking.onset_ms - START_WITHIN_MS, self.braking.onset_ms);
        let known_ahead = |sample: &Sample| {
            let ahead = self.leader.checked_sub(1).and_then(|ahead| self.platoon.vehicles.get(ahead));
            ahead.is_some_and(|ahead| ahead.speed_at_mps(sample.index).is_some())
                && self.platoon.following(self.leader, sample.index).is_some()
        };
        if candidates.iter().any(known_ahead) {
            return;
        }
        let nearness_ms = |sample: &Sample| (sample.time_ms - (self.braking.onset_ms - LEAD_IN_MS)).abs();
        let best = candidates.iter().max_by_key(|sample| (self.followers_at(sample), Reverse(nearness_ms(sample))));
        let Some(start) = best else { return };
        match self.episode(start) {
            Ok(episode) => found.episodes.push(episode),
            Err(why) => {
                let (number, onset_s) = (self.number_of(self.leader), self.braking.onset_ms as f64 / 1000.0);
                let line = self.line_of(start);
                let what = Omission::Episode { number, onset_s, why };
                found.dropped.push(Dropped { path: recording.path.clone(), line, what });
            }
        }
    }

    /// The samples of the run from one time to another, both included.
    fn between(&self, from_ms: i64, to_ms: i64) -> &[Sample] {
        let from = self.run.partition_point(|sample| sample.time_ms < from_ms);
        let to = self.run.partition_point(|sample| sample.time_ms <= to_ms);
        self.run.get(from..to).unwrap_or_default()
    }

    /// How many vehicles behind the leader have known speeds and gaps, without a break.
    fn followers_at(&self, start: &Sample) -> usize {
        (self.leader + 1..self.platoon.vehicles.len())
            .take_while(|&index| self.platoon.following(index, start.index).is_some())
            .count()
    }

    fn episode(&self, start: &Sample) -> Result<Episode, NoScenario> {
        let followers = self.followers_at(start);
        if followers == 0 {
            let within_s = START_WITHIN_MS as f64 / 1000.0;
            return Err(NoScenario::NoFollower { follower: self.number_of(self.leader + 1), within_s });
        }
        let end_ms = (self.braking.end_ms + TAIL_MS).min(self.next_onset_ms.unwrap_or(i64::MAX));
        let samples = self.between(start.time_ms, end_ms);
        let mut hardest_brake_mps2: f64 = 0.0;
        let mut hardest_accel_mps2: f64 = 0.0;
        for pair in samples.windows(2) {
            if let [a, b] = pair {
                let found_mps2 = 1000.0 * (b.speed_mps - a.speed_mps) / (b.time_ms - a.time_ms) as f64;
                if found_mps2.abs() > HARDEST_CHANGE_MPS2 {
                    return Err(NoScenario::Jump { at_s: b.time_ms as f64 / 1000.0, found_mps2 });
                }
                hardest_brake_mps2 = hardest_brake_mps2.max(-found_mps2);
                hardest_accel_mps2 = hardest_accel_mps2.max(found_mps2);
            }
        }
        let since_start_s = |time_ms: i64| (time_ms - start.time_ms) as f64 / 1000.0;
        let mut vehicles = vec![self.placed(self.leader, 0.0, start.speed_mps)];
        for index in self.leader + 1..=self.leader + followers {
            if let Some((gap_m, speed_mps)) = self.platoon.following(index, start.index) {
                vehicles.push(self.placed(index, rounded(gap_m), rounded(speed_mps)));
            }
        }
        Ok(Episode {
            event: self.platoon.event.clone(),
            line: self.line_of(start),
            start_s: start.time_ms as f64 / 1000.0,
            onset_s: since_start_s(self.braking.onset_ms),
            braking_end_s: since_start_s(self.braking.end_ms),
            duration_s: since_start_s(end_ms),
            onset_speed_mps: speed_at_mps(self.run, self.braking.onset_ms),
            end_speed_mps: speed_at_mps(self.run, self.braking.end_ms),
            largest_drop_mps: self.braking.largest_drop_mps,
            hardest_brake_mps2,
            hardest_accel_mps2,
            vehicles,
            not_recorded_ahead: self.leader.checked_sub(1).map(|ahead| self.number_of(ahead)),
            not_recorded_behind: (self.leader + followers + 1 < self.platoon.vehicles.len())
                .then(|| self.number_of(self.leader + followers + 1)),
            time_s: samples.iter().map(|sample| since_start_s(sample.time_ms)).collect(),
            speed_mps: samples.iter().map(|sample| sample.speed_mps).collect(),
        })
    }

    fn placed(&self, index: usize, gap_ahead_m: f64, speed_mps: f64) -> Placed {
        let name = self.platoon.vehicles.get(index).and_then(|vehicle| vehicle.name.clone());
        Placed { number: self.number_of(index), name, gap_ahead_m, speed_mps }
    }

    fn number_of(&self, index: usize) -> usize {
        self.platoon.vehicles.get(index).map_or(0, |vehicle| vehicle.number)
    }

    fn line_of(&self, sample: &Sample) -> u64 {
        self.platoon.line.get(sample.index).copied().unwrap_or(0)
    }
}
