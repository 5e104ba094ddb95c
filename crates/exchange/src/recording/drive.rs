//! Drives of a recorded vehicle behind its leader, without holes.

use super::EpisodeVehicle;
use super::lead_vehicles::LeadVehicle;
use super::motion::SpeedSample;

/// Leader, the vehicle itself and its follower at one sample of the leader.
#[derive(Debug, Clone)]
pub(super) struct DriveInstant {
    pub(super) sample: SpeedSample,
    /// Time of the sample in the recording, in seconds.
    pub(super) time_s: f64,
    pub(super) vehicle: EpisodeVehicle,
    pub(super) behind: Option<EpisodeVehicle>,
}

/// Splits a segment of a leader where the vehicle behind it is unknown, or another one, and where `continues` denies
/// that two successive instants belong together.
pub(super) fn split_drives(
    lead: &dyn LeadVehicle,
    segment: &[SpeedSample],
    continues: fn(&DriveInstant, &DriveInstant) -> bool,
) -> Vec<Vec<DriveInstant>> {
    let mut drives: Vec<Vec<DriveInstant>> = Vec::new();
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
        let instant = DriveInstant {
            sample: *sample,
            time_s: sample.time_ms as f64 / 1000.0,
            vehicle,
            behind: followers.next(),
        };
        match drives.last_mut() {
            Some(drive)
                if is_open
                    && drive.last().is_some_and(|last| {
                        last.vehicle.number == instant.vehicle.number && continues(last, &instant)
                    }) =>
            {
                drive.push(instant);
            }
            _ => drives.push(vec![instant]),
        }
        is_open = true;
    }
    drives
}

impl DriveInstant {
    pub(super) fn has_same_follower(&self, other: &Self) -> bool {
        let [own, others] =
            [self, other].map(|instant| instant.behind.as_ref().map(|vehicle| vehicle.number));
        own == others
    }

    /// Returns speeds and gaps of all three vehicles.
    fn state(&self) -> DriveState {
        let [gap_behind_m, behind_mps] = self
            .behind
            .as_ref()
            .map_or([0.0; 2], |behind| [behind.gap_ahead_m, behind.speed_mps]);
        DriveState {
            leader_mps: self.sample.speed_mps,
            gap_m: self.vehicle.gap_ahead_m,
            speed_mps: self.vehicle.speed_mps,
            gap_behind_m,
            behind_mps,
        }
    }
}

/// Speeds and gaps of the three vehicles at one time; 0 for a missing follower.
#[derive(Debug, Clone, Copy)]
pub(super) struct DriveState {
    pub(super) leader_mps: f64,
    pub(super) gap_m: f64,
    pub(super) speed_mps: f64,
    pub(super) gap_behind_m: f64,
    pub(super) behind_mps: f64,
}

impl DriveState {
    /// Returns the state at a share of the way to another one.
    fn interpolate(&self, to: &Self, share: f64) -> Self {
        let between = |from: f64, to: f64| from + share * (to - from);
        Self {
            leader_mps: between(self.leader_mps, to.leader_mps),
            gap_m: between(self.gap_m, to.gap_m),
            speed_mps: between(self.speed_mps, to.speed_mps),
            gap_behind_m: between(self.gap_behind_m, to.gap_behind_m),
            behind_mps: between(self.behind_mps, to.behind_mps),
        }
    }
}

/// Returns the state at each step before the last instant, interpolated between samples.
pub(super) fn interpolate_states(drive: &[DriveInstant], step_s: f64) -> Vec<DriveState> {
    let Some((first, last)) = drive.first().zip(drive.last()) else {
        return Vec::new();
    };
    let count = ((last.time_s - first.time_s) / step_s + 1e-6) as usize;
    let mut after = 1;
    let mut states = Vec::with_capacity(count);
    for step in 0..count {
        let at_s = first.time_s + step as f64 * step_s;
        while drive.get(after).is_some_and(|next| next.time_s <= at_s) {
            after += 1;
        }
        let Some((from, to)) = drive.get(after - 1).zip(drive.get(after)) else {
            break;
        };
        let share = ((at_s - from.time_s) / (to.time_s - from.time_s)).clamp(0.0, 1.0);
        states.push(from.state().interpolate(&to.state(), share));
    }
    states
}
