//! Following exposure of a recording, and the clusters of its braking episodes.

use super::Recording;
use super::episode::BrakingEpisode;
use super::episodes::LeaderSelection;
use super::lead_vehicles::VehicleAhead;
use super::motion::BRAKING_WINDOW_MS;

/// Largest time between brakings of one cluster, in seconds; equal to that of phases of one vehicle's braking.
const MERGE_WITHIN_S: f64 = 5.0;

/// Driving in which an episode could have begun.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FollowingExposure {
    /// Hours of selected leaders with enough followers, summed over leaders.
    pub hours: f64,
    /// Kilometres of the next follower in these hours.
    pub kilometres: f64,
}

/// Measures the driving in which an episode with at least `followers` (1 or more) could have begun.
///
/// Counts times between samples at most half a second apart with known speeds and gaps. The last second of each segment
/// does not count: braking is a loss of speed within one second, so none could have been detected in it.
#[must_use]
pub fn following_exposure(
    recording: &Recording,
    leaders: LeaderSelection,
    followers: usize,
) -> FollowingExposure {
    let mut sum = FollowingExposure::default();
    for lead in recording.lead_vehicles() {
        for run in lead.segments() {
            let speeds: Vec<Option<f64>> = run
                .iter()
                .map(|sample| {
                    let may_lead = leaders == LeaderSelection::Any
                        || !matches!(lead.vehicle_ahead_at(sample), VehicleAhead::Recorded(_));
                    lead.follower_speed_at_mps(sample, followers)
                        .filter(|_| may_lead)
                })
                .collect();
            let until_ms = run
                .last()
                .map_or(0, |last| last.time_ms - BRAKING_WINDOW_MS);
            for (samples, speeds) in run.windows(2).zip(speeds.windows(2)) {
                if let ([from, to], [Some(a), Some(b)]) = (samples, speeds)
                    && to.time_ms <= until_ms
                    && lead.core_ms().contains(&from.time_ms)
                {
                    let seconds = (to.time_ms - from.time_ms) as f64 / 1000.0;
                    sum.hours += seconds / 3600.0;
                    sum.kilometres += 0.5 * (a + b) * seconds / 1000.0;
                }
            }
        }
    }
    sum
}

/// Returns the cluster of each braking episode of one recording, numbered from 0.
///
/// Two episodes belong to one cluster if the leader of one is a vehicle of the other and they brake at most 5 s apart.
#[must_use]
pub fn braking_clusters(episodes: &[BrakingEpisode]) -> Vec<u32> {
    let mut cluster: Vec<usize> = (0..episodes.len()).collect();
    for (index, episode) in episodes.iter().enumerate() {
        for (earlier_index, earlier) in episodes.iter().enumerate().take(index) {
            if is_same_cluster(episode, earlier) {
                let from = cluster[index].max(cluster[earlier_index]);
                let to = cluster[index].min(cluster[earlier_index]);
                if from != to {
                    cluster
                        .iter_mut()
                        .filter(|cluster| **cluster == from)
                        .for_each(|cluster| *cluster = to);
                }
            }
        }
    }
    let mut in_order: Vec<usize> = Vec::new();
    let numbered = cluster.iter().map(|cluster| {
        in_order
            .iter()
            .position(|earlier| earlier == cluster)
            .unwrap_or_else(|| {
                in_order.push(*cluster);
                in_order.len() - 1
            }) as u32
    });
    numbered.collect()
}

fn is_same_cluster(a: &BrakingEpisode, b: &BrakingEpisode) -> bool {
    let [[a_from_s, a_to_s], [b_from_s, b_to_s]] = [a, b].map(|episode| {
        [episode.onset_s, episode.braking_end_s].map(|time_s| episode.start_s + time_s)
    });
    a_from_s <= b_to_s + MERGE_WITHIN_S
        && b_from_s <= a_to_s + MERGE_WITHIN_S
        && a.event == b.event
        && (contains_leader_of(a, b) || contains_leader_of(b, a))
}

/// Returns whether the leader of another episode is a vehicle of this one.
fn contains_leader_of(episode: &BrakingEpisode, other: &BrakingEpisode) -> bool {
    let leader = other.vehicles.first().map(|leader| leader.number);
    episode
        .vehicles
        .iter()
        .any(|vehicle| Some(vehicle.number) == leader)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{MinBrake, read};
    use std::fmt::Write;
    use std::path::Path;

    /// A platoon of four for 30 s; each brakes half a second after the one ahead, and again much later. One spacing is
    /// missing for a second.
    fn platoon() -> Recording {
        let header = "Date,1\nVehicle_order\nNumber_of_vehicles,4\nACC,1\nDistance_setting,S\n";
        let names = "Time,Speed1,Speed2,Speed3,Speed4,IVS1,IVS2,IVS3\n";
        let mut rows = String::new();
        for tenth in 0..600 {
            let at_s = f64::from(tenth) / 10.0;
            let speed = |car: f64| {
                20.0 - 3.0 * (at_s - 5.0 - 0.5 * car).clamp(0.0, 2.0)
                    + 6.0 * ((at_s - 20.0) / 10.0).clamp(0.0, 1.0)
                    - 3.0 * (at_s - 45.0 - 0.5 * car).clamp(0.0, 2.0)
            };
            let gap = if (100..110).contains(&tenth) {
                String::new()
            } else {
                "30.0".to_owned()
            };
            let speeds: Vec<_> = (0..4)
                .map(|car| format!("{:.3}", speed(f64::from(car))))
                .collect();
            writeln!(rows, "{at_s:.1},{},30.0,{gap},30.0", speeds.join(",")).unwrap();
        }
        read(
            format!("{header}{names}{rows}").as_bytes(),
            Path::new("p.csv"),
            None,
        )
        .unwrap()
    }

    #[test]
    fn exposure_sums_all_leaders_and_waves_form_clusters() {
        let recording = platoon();
        // 600 samples span 59.9 s; no braking can begin in the last second. Where the second spacing is missing, 1.1 s
        // of its pair and of those ahead do not count.
        let seconds =
            |leaders, followers| following_exposure(&recording, leaders, followers).hours * 3600.0;
        for (leaders, followers, wanted) in [
            (LeaderSelection::Any, 1, 3.0 * 58.9 - 1.1),
            (LeaderSelection::Any, 2, 2.0 * 57.8),
            (LeaderSelection::Any, 3, 57.8),
            (LeaderSelection::First, 3, 57.8),
        ] {
            let measured = seconds(leaders, followers);
            assert!(
                (measured - wanted).abs() < 1e-6,
                "{leaders:?} {followers}: {measured}"
            );
        }
        let driven = following_exposure(&recording, LeaderSelection::First, 1);
        assert!(
            driven.hours * 3600.0 < 62.0 && driven.kilometres > 0.8 && driven.kilometres < 1.2,
            "{driven:?}"
        );
        let episodes =
            crate::recording::find_episodes(&recording, MinBrake::default(), LeaderSelection::Any)
                .episodes;
        assert_eq!(
            (episodes.len(), braking_clusters(&episodes)),
            (6, [0, 0, 0, 1, 1, 1].to_vec())
        );
    }
}
