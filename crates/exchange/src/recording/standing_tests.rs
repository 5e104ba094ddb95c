//! Vehicles that stand: noise and bias of a sensor, rolling back, and times of day after midnight.

use std::fmt::Write as _;

use super::map_tests::read_with;
use super::*;

const PAIRS: &str = r#"version = 1
name = "pairs"
time.clock = { column = "t", unit = "s" }

[layout.pairs]
spacing = { column = "gap", unit = "m", from = "bumper-to-bumper" }
follower_speed = { column = "own", unit = "m/s" }
relative_speed = { column = "relative", unit = "m/s", sign = "leader-minus-follower" }
"#;

const TRACKS: &str = r#"version = 1
name = "tracks"
time.clock = { column = "t", unit = "s" }

[layout.tracks]
vehicle = "id"
lane = "lane"
position = { column = "x", unit = "m", of = "front" }
speed = { column = "v", unit = "m/s" }
length.metres = 5.0
"#;

/// Speeds of a leader that brakes at 4 m/s² from 10 s on and stands from 15 s to 60 s.
fn leader_mps(time_s: f64) -> f64 {
    (20.0 - 4.0 * (time_s - 10.0).max(0.0)).max(0.0)
}

/// A leader, whose relative speed has a bias, and a follower that drives as the leader does, a second later.
fn biased_pair(bias_mps: f64) -> Recording {
    let mut text = "t,gap,own,relative\n".to_owned();
    let mut gap_m = 30.0;
    for tenth in 0..600 {
        let time_s = f64::from(tenth) / 10.0;
        let own_mps = leader_mps(time_s - 1.0);
        let relative_mps = leader_mps(time_s) - own_mps;
        let _ = writeln!(
            text,
            "{time_s:.1},{gap_m:.4},{own_mps:.4},{:.4}",
            relative_mps + bias_mps
        );
        gap_m += 0.05 * (relative_mps + leader_mps(time_s + 0.1) - leader_mps(time_s - 0.9));
    }
    read_with(&text, PAIRS)
}

fn messages(recording: &Recording) -> Vec<String> {
    recording
        .dropped
        .iter()
        .map(DroppedItem::to_string)
        .collect()
}

/// A radar whose relative speed is a little too small makes a standing leader's speed negative: it stands.
#[test]
fn a_standing_leader_stands_whatever_the_bias_of_the_relative_speed() {
    for bias_mps in [0.0, -0.03, 0.03, -0.25] {
        let recording = biased_pair(bias_mps);
        let drives = find_drives(&recording, LeaderSelection::Any);
        assert_eq!(drives.len(), 1, "{bias_mps}: {:?}", messages(&recording));
        assert!(
            (drives[0].duration_s - 59.8).abs() < 0.2,
            "{}",
            drives[0].duration_s
        );
        let braking = find_episodes(&recording, MinBrake::default(), LeaderSelection::Any);
        let end_mps = braking.episodes[0].leader_motion.speed_mps.last().copied();
        assert_eq!(end_mps, Some(bias_mps.max(0.0)));
        let standing = "a.csv:152: the leader's speed: ";
        let expected = usize::from(bias_mps < 0.0);
        assert_eq!(
            messages(&recording)
                .iter()
                .filter(|line| line.starts_with(standing))
                .count(),
            expected
        );
    }
    let beyond = "a.csv:152: the leader's speed: 450 impossible speeds, the first one here, the last one on line 601, \
                  the worst -0.5 m/s";
    let lines = messages(&biased_pair(-0.5));
    assert!(lines.iter().any(|line| line == beyond), "{lines:?}");
}

/// Tracks of a leader and a follower in the direction of decreasing or increasing positions. The leader rolls back from
/// 20 s to 23 s at 0.5 m/s; both have noise of 0.1 m/s while they stand. Speeds have the sign of the position or none.
fn rolling_tracks(decreases: bool, has_sign: bool) -> Recording {
    let mut text = "t,id,lane,x,v\n".to_owned();
    let mut fronts_m = [60.0, 30.0];
    for tenth in 0..400 {
        let time_s = f64::from(tenth) / 10.0;
        let rolls = (20.0..23.0).contains(&time_s);
        for (vehicle, front_m) in fronts_m.iter_mut().enumerate() {
            let delay_s = vehicle as f64;
            let rolling_mps = if vehicle == 0 && rolls { -0.5 } else { 0.0 };
            let mean_mps =
                0.5 * (leader_mps(time_s - delay_s) + leader_mps(time_s + 0.1 - delay_s));
            let noise_mps = match (leader_mps(time_s - delay_s), rolls, tenth % 2) {
                (0.0, false, 0) => 0.1,
                (0.0, false, _) => -0.1,
                _ => 0.0,
            };
            let speed_mps = leader_mps(time_s - delay_s) + rolling_mps + noise_mps;
            let sign = if decreases { -1.0 } else { 1.0 };
            let written_mps = if has_sign {
                sign * speed_mps
            } else {
                speed_mps
            };
            let _ = writeln!(
                text,
                "{time_s:.1},{},1,{:.4},{written_mps:.3}",
                vehicle + 1,
                sign * *front_m
            );
            *front_m += 0.1 * (mean_mps + rolling_mps);
        }
    }
    read_with(&text, TRACKS)
}

/// A vehicle that rolls back does not drive forwards at the same speed: the gap says where it is.
#[test]
fn a_leader_that_rolls_back_has_no_positive_speed() {
    for (decreases, has_sign) in [(false, true), (true, true), (true, false)] {
        let recording = rolling_tracks(decreases, has_sign);
        let drives = find_drives(&recording, LeaderSelection::Any);
        assert_eq!(drives.len(), 1);
        let standing = |time_s: &f64| (16.0..39.0).contains(time_s);
        let motion = &drives[0].leader_motion;
        let times_s = motion.time_s.iter();
        let fastest_mps = times_s
            .zip(&motion.speed_mps)
            .filter(|(time_s, _)| standing(time_s))
            .fold(0.0_f64, |fastest, (_, speed_mps)| fastest.max(*speed_mps));
        assert!(fastest_mps <= 0.1, "{fastest_mps}");
        assert_eq!(
            messages(&recording),
            ["a.csv:402: vehicle 1 rolls back here; 30 such speeds, from 0.3 to 3 m/s, count as 0"]
        );
    }
}

/// A vehicle that turns and drives back in another lane drives forward there, whether speeds have a sign or not.
#[test]
fn vehicles_that_turn_keep_their_speeds() {
    for has_sign in [true, false] {
        let mut text = "t,id,lane,x,v\n".to_owned();
        for tenth in 0..1300 {
            let time_s = f64::from(tenth) / 10.0;
            for (vehicle, start_m) in [(1, 40.0), (2, 0.0)] {
                let (lane, x, sign) = match 10.0 * time_s + start_m {
                    way_m if way_m < 650.0 => (1, way_m, 1.0),
                    way_m => (2, 1300.0 - way_m, -1.0),
                };
                let speed_mps = if has_sign { 10.0 * sign } else { 10.0 };
                let _ = writeln!(text, "{time_s:.1},{vehicle},{lane},{x:.3},{speed_mps:.1}");
            }
        }
        let recording = read_with(&text, TRACKS);
        let drives = find_drives(&recording, LeaderSelection::Any);
        assert_eq!(drives.len(), 2);
        for drive in drives {
            let speeds_mps = &drive.leader_motion.speed_mps;
            assert!(
                speeds_mps.iter().all(|speed_mps| *speed_mps == 10.0),
                "{speeds_mps:?}"
            );
        }
    }
}

/// A recording over midnight is one recording, with rows by time or by vehicle.
#[test]
fn times_of_day_continue_after_midnight() {
    let of_day = |tenth: u32| {
        let time_s = (86_370.0 + f64::from(tenth) / 10.0) % 86_400.0;
        let [hours, minutes] = [time_s / 3600.0, time_s / 60.0 % 60.0].map(|value| value as u32);
        format!("{hours:02}:{minutes:02}:{:04.1}", time_s % 60.0)
    };
    let row = |vehicle: u32, tenth: u32| {
        let front_m = f64::from(tenth) + 100.0 - 40.0 * f64::from(vehicle);
        format!("{},{vehicle},1,{front_m:.3},10.0\n", of_day(tenth))
    };
    let by_time: String = (0..600)
        .flat_map(|tenth| [row(1, tenth), row(2, tenth)])
        .collect();
    let by_vehicle: String = [1, 2]
        .iter()
        .flat_map(|id| (0..600).map(|tenth| row(*id, tenth)))
        .collect();
    // Midnight has passed before the first row; the other vehicle comes from the day before.
    let late: String = (400..600)
        .map(|tenth| row(1, tenth))
        .chain((0..600).map(|tenth| row(2, tenth)))
        .collect();
    let drives = find_drives(
        &read_with(&format!("t,id,lane,x,v\n{late}"), TRACKS),
        LeaderSelection::Any,
    );
    assert!(drives.is_empty(), "the leader is recorded for 20 s");
    for rows in [by_time, by_vehicle] {
        let recording = read_with(&format!("t,id,lane,x,v\n{rows}"), TRACKS);
        assert_eq!(messages(&recording), Vec::<String>::new());
        let drives = find_drives(&recording, LeaderSelection::Any);
        assert_eq!(drives.len(), 1);
        assert!(
            (drives[0].duration_s - 59.8).abs() < 0.2,
            "{}",
            drives[0].duration_s
        );
    }
}

/// The start of another vehicle, hours before, is no midnight.
#[test]
fn a_day_recorded_vehicle_by_vehicle_has_no_midnight() {
    let row = |vehicle: u32, tenth: u32| {
        let second = tenth / 10;
        let front_m = f64::from(tenth) + 100.0 - 40.0 * f64::from(vehicle);
        let [hours, minutes] = [second / 3600, second / 60 % 60];
        let seconds = f64::from(tenth % 600) / 10.0;
        format!("{hours:02}:{minutes:02}:{seconds:04.1},{vehicle},1,{front_m:.3},10.0\n")
    };
    // In the morning and in the evening, and in the evening only.
    for tenths in [
        [252_000..253_000, 696_000..697_000],
        [720_000..721_000, 730_000..731_000],
    ] {
        let early: String = (250_000..250_500).map(|tenth| row(9, tenth)).collect();
        let rows: String = [1, 2]
            .iter()
            .flat_map(|id| {
                tenths
                    .clone()
                    .into_iter()
                    .flatten()
                    .map(|tenth| row(*id, tenth))
            })
            .collect();
        let recording = read_with(&format!("t,id,lane,x,v\n{early}{rows}"), TRACKS);
        let drives = find_drives(&recording, LeaderSelection::Any);
        let driven_s: f64 = drives.iter().map(|drive| drive.duration_s).sum();
        assert!((driven_s - 199.5).abs() < 1.0, "{driven_s} s of 200 s");
    }
}
