//! Random traffic with noise, missing rows, blips and a second carriageway, and single faults of recordings.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use proptest::prelude::*;

use super::super::map::RecordingMap;
use super::super::*;
use super::TrackPoint;

const MAP: &str = r#"version = 1
name = "tracks"
time.clock = { column = "t" }

[layout.tracks]
vehicle = "id"
lane = "lane"
position = { column = "x", of = "low-end" }
speed = { column = "v" }
length.column = { name = "length" }
"#;
const STEP_S: f64 = 0.1;
const ROWS: usize = 120;
const LENGTH_M: f64 = 4.5;

/// A row: step, id, lane, low end in metres, speed in m/s, length in metres.
type Row = (usize, String, u32, f64, f64, f64);

fn row(step: usize, id: impl ToString, lane: u32, x: f64, speed_mps: f64) -> Row {
    (step, id.to_string(), lane, x, speed_mps, LENGTH_M)
}

fn text(rows: &[Row]) -> String {
    rows.iter().fold(
        "t,id,lane,x,v,length\n".to_owned(),
        |mut text, (step, id, lane, x, speed, length)| {
            let _ = writeln!(
                text,
                "{:.1},{id},{lane},{x:.3},{speed:.3},{length}",
                *step as f64 * STEP_S
            );
            text
        },
    )
}

fn try_read(text: &str, map: &str) -> Result<Recording, RecordingError> {
    let map = RecordingMap::from_toml(map, Path::new("m.toml")).expect("a map");
    read(text.as_bytes(), Path::new("a.csv"), Some(&map))
}

fn read_rows(rows: &[Row]) -> Recording {
    try_read(&text(rows), MAP).expect("readable")
}

/// Returns leader and gap by time, in milliseconds, and follower.
fn links(recording: &Recording) -> BTreeMap<(i64, usize), (usize, f64)> {
    let traffic = recording.traffic.as_ref().expect("tracks");
    let number = |point: &TrackPoint| traffic.vehicles[point.vehicle as usize].number;
    let linked = traffic
        .points
        .iter()
        .filter_map(|point| Some((point, point.ahead?)));
    linked
        .map(|(point, (gap, ahead))| {
            (
                (point.time_ms, number(point)),
                (number(&traffic.points[ahead as usize]), gap),
            )
        })
        .collect()
}

/// Returns the vehicles and gaps of each episode.
fn lines(recording: &Recording) -> Vec<Vec<(usize, f64)>> {
    let episodes = find_episodes(recording, MinBrake::default(), LeaderSelection::Any).episodes;
    let line = |episode: BrakingEpisode| {
        episode
            .vehicles
            .iter()
            .map(|vehicle| (vehicle.number, vehicle.gap_ahead_m))
            .collect()
    };
    episodes.into_iter().map(line).collect()
}

fn messages(recording: &Recording) -> String {
    recording
        .dropped
        .iter()
        .map(|dropped| format!("{dropped}\n"))
        .collect()
}

/// Four lanes of four vehicles; positions decrease in lanes 3 and 4. In each lane, vehicles repeat the first one's
/// motion later and further behind (Newell's model); it may stand for a while.
fn traffic(brakes: [(f64, f64); 4]) -> Vec<Row> {
    let mut rows = Vec::new();
    for (lane, (speed_mps, brake_mps2)) in (1..).zip(brakes) {
        for index in 0..4 {
            let (mut x, mut now_mps) = (
                300.0 - (9.0 + 0.8 * speed_mps) * f64::from(index),
                speed_mps,
            );
            for step in 0..ROWS {
                let braking_s = step as f64 * STEP_S - 4.0 - 0.8 * f64::from(index);
                let next_mps = (speed_mps - brake_mps2 * braking_s.clamp(0.0, 3.0)).max(0.0);
                x += 0.5 * (now_mps + next_mps) * STEP_S;
                now_mps = next_mps;
                let (down, id) = (lane > 2, 10 * lane + index + 1);
                let low_end_m = if down { -x } else { x - LENGTH_M };
                rows.push(row(
                    step,
                    id,
                    lane,
                    low_end_m,
                    if down { -now_mps } else { now_mps },
                ));
            }
        }
    }
    rows
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(64))]

    /// Damaged rows yield the same links, with gaps within 0.4 m. Links are missing only while a vehicle of the lane
    /// has no row. The mirror image has the same links and episodes.
    #[test]
    fn damaged_rows_change_no_link(
        brakes in prop::array::uniform4((2.0..30.0_f64, 0.0..8.0_f64)),
        noise in prop::collection::vec((-0.15..0.15_f64, -0.2..0.2_f64), 4 * 4 * ROWS),
        absences in prop::collection::vec((0..16_usize, 1..ROWS - 20, 1..20_usize), 0..6),
        blips in prop::collection::vec((0..ROWS - 4, 1..5_usize, 1..5_u32, prop::bool::ANY), 16),
    ) {
        let whole = traffic(brakes);
        let reference = links(&read_rows(&whole));
        prop_assert!(reference.len() == 12 * ROWS, "{}", reference.len());
        let (mut damaged, mut absent) = (Vec::new(), BTreeSet::new());
        for (index, (mut row, noise)) in whole.iter().cloned().zip(&noise).enumerate() {
            let (vehicle, step) = (index / ROWS, index % ROWS);
            let is_absent = absences
                .iter()
                .any(|&(absent, from, rows)| absent == vehicle && (from..from + rows).contains(&step));
            if is_absent {
                absent.insert((step, row.2));
                continue;
            }
            let (from, rows, lane, repeats) = blips[vehicle];
            // Blips around an absence may look like a longer stay in the lane.
            let is_blip = match repeats && absences.iter().all(|absence| absence.0 != vehicle) {
                true => step % 5 == from % 5,
                false => (from..from + rows).contains(&step),
            };
            row.2 = if is_blip { lane } else { row.2 };
            damaged.push((row.0, row.1, row.2, row.3 + noise.0, row.4 + noise.1, row.5));
        }
        let recording = read_rows(&damaged);
        let damaged_links = links(&recording);
        for (&(time_ms, follower), &(leader, gap_m)) in &damaged_links {
            let &(expected, expected_m) = reference.get(&(time_ms, follower)).expect("linked without damage");
            prop_assert!(leader == expected && (gap_m - expected_m).abs() < 0.4, "{time_ms} {follower} {leader}");
        }
        let is_whole = |&&(time_ms, follower): &&(i64, usize)| {
            !absent.contains(&((time_ms / 100) as usize, follower as u32 / 10))
        };
        let lost: Vec<_> = reference.keys().filter(is_whole).filter(|key| !damaged_links.contains_key(key)).collect();
        prop_assert!(lost.is_empty(), "{lost:?}\n{}", messages(&recording));

        let mirrored = |(step, id, lane, x, speed, length): &Row| {
            (*step, id.clone(), *lane, 1000.0 - x - length, -speed, *length)
        };
        let mirrored = read_rows(&damaged.iter().map(mirrored).collect::<Vec<_>>());
        let is_near = |(a, b): (&(usize, f64), &(usize, f64))| a.0 == b.0 && (a.1 - b.1).abs() < 3e-3;
        let mirrored_links = links(&mirrored);
        prop_assert!(damaged_links.keys().eq(mirrored_links.keys()));
        prop_assert!(damaged_links.values().zip(mirrored_links.values()).all(is_near));
        let damaged_lines = lines(&recording);
        let mirrored_lines = lines(&mirrored);
        prop_assert_eq!(damaged_lines.len(), mirrored_lines.len());
        prop_assert!(damaged_lines.iter().flatten().zip(mirrored_lines.iter().flatten()).all(is_near));
    }
}

/// A leader that drives at 20 m/s and brakes at 3 m/s² from 4 s to 7 s, with vehicles behind it.
fn braking(steps: usize, mut vehicle: impl FnMut(usize, f64, f64) -> Vec<Row>) -> Vec<Row> {
    let mut x = 200.0;
    let mut rows = Vec::new();
    for step in 0..steps {
        let braking_s = |step: usize| (step as f64 * STEP_S - 4.0).clamp(0.0, 3.0);
        let speed_mps = 20.0 - 3.0 * braking_s(step);
        rows.extend(vehicle(step, x, speed_mps));
        x += STEP_S * 0.5 * (speed_mps + 20.0 - 3.0 * braking_s(step + 1));
    }
    rows
}

#[test]
fn vehicles_that_stand_have_the_direction_of_their_lane() {
    for sign in [1.0, -1.0] {
        let low_end_m = |front_m: f64| {
            if sign > 0.0 {
                front_m - LENGTH_M
            } else {
                -front_m
            }
        };
        let rows = braking(120, |step, x, mps| {
            let jitter_m = if step == 119 { -0.01 } else { 0.0 };
            let standing = |id, front_m: f64| row(step, id, 1, low_end_m(front_m) + jitter_m, 0.0);
            let moving = row(step, 1, 1, low_end_m(x), sign * mps);
            vec![
                moving,
                standing(2, 190.0),
                standing(3, 180.0),
                row(
                    step,
                    9,
                    if step == 60 { 1 } else { 2 },
                    low_end_m(-x),
                    -sign * mps,
                ),
            ]
        });
        let recording = read_rows(&rows);
        let [line] = &lines(&recording)[..] else {
            panic!("{:?}", lines(&recording))
        };
        assert_eq!((line.len(), line[1].0, line[2]), (3, 2, (3, 5.5)), "{sign}");
        let blip = "vehicle 9 has another lane for less than 0.5 s here; 1 such blips, in which \
            vehicles keep their lane\n";
        assert!(
            messages(&recording).ends_with(blip) && recording.dropped.len() == 1,
            "{}",
            messages(&recording)
        );
    }
}

#[test]
fn positions_that_start_anew_and_ids_that_are_used_again_split_tracks() {
    // Edges of 60 m, as in SUMO; text ids.
    let rows = braking(120, |step, x, mps| {
        let edge = |id: &str, x: f64| row(step, id, 10 + (x / 60.0) as u32, x % 60.0, mps);
        vec![edge("flow.0", x), edge("flow.1", x - 20.0)]
    });
    let recording = read_rows(&rows);
    assert!(
        links(&recording)
            .values()
            .all(|&(leader, gap_m)| leader == 1 && (gap_m - 15.5).abs() < 1e-6)
    );
    assert!(links(&recording).len() > 60);
    assert!(
        messages(&recording).contains("the position of vehicle flow.0 starts anew here"),
        "{}",
        messages(&recording)
    );
    let episodes = find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes;
    assert_eq!(episodes[0].vehicles[0].to_string(), "vehicle 1 (flow.0)");
    // A lorry and then, ten seconds later, a car have the id 2^63.
    let id = 1_u64 << 63;
    let rows = braking(300, |step, x, mps| match step {
        0..100 => vec![
            (step, id.to_string(), 1, x, mps, 12.5),
            row(step, 4, 1, x - 20.0, mps),
        ],
        100..200 => vec![row(step, 4, 1, x - 20.0, mps)],
        _ => vec![
            row(step, id, 1, x - 250.0, mps),
            row(step, 4, 1, x - 20.0, mps),
        ],
    });
    let recording = read_rows(&rows);
    let tracks: BTreeSet<u32> = recording
        .traffic
        .as_ref()
        .expect("tracks")
        .points
        .iter()
        .map(|point| point.track)
        .collect();
    assert_eq!(tracks.len(), 3);
    assert_eq!(
        links(&recording).len(),
        200,
        "no vehicle is absent between its tracks"
    );
    let episodes = find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes;
    assert_eq!(
        (
            episodes[0].vehicles[0].number as u64,
            episodes[0].vehicles[0].length_m
        ),
        (id, Some(12.5))
    );
}

#[test]
fn no_vehicle_is_linked_across_one_that_is_absent() {
    let rows = braking(120, |step, x, mps| {
        let mut rows = vec![row(step, 1, 1, x, mps), row(step, 3, 1, x - 40.0, mps)];
        if !(20..50).contains(&step) {
            rows.push(row(step, 2, 1, x - 20.0, mps));
        }
        rows
    });
    let recording = read_rows(&rows);
    assert!(
        links(&recording)
            .iter()
            .all(|((time_ms, _), _)| !(2000..5000).contains(time_ms))
    );
    assert!(
        messages(&recording).contains(
            "30 times a vehicle that has rows before and after may be between two others"
        )
    );
}

#[test]
fn vehicles_with_rows_at_different_times_are_linked_by_interpolation() {
    let rows = braking(120, |step, x, mps| {
        vec![if step % 2 == 0 {
            row(step, 1, 1, x, mps)
        } else {
            row(step, 2, 1, x - 20.0, mps)
        }]
    });
    let map = MAP.replace("[layout.tracks]", "interpolate_s = 0.5\n[layout.tracks]");
    let linked = links(&try_read(&text(&rows), &map).expect("readable"));
    assert!(
        linked
            .values()
            .all(|&(leader, gap_m)| leader == 1 && (gap_m - 15.5).abs() < 0.02),
        "{linked:?}"
    );
    assert_eq!(linked.len(), 118);
}

#[test]
fn columns_that_contradict_each_other_are_reported_with_the_reason() {
    let rows = braking(120, |step, x, mps| {
        vec![row(step, 1, 1, x, mps), row(step, 2, 1, x - 20.0, mps)]
    });
    let error = |map: &str| {
        try_read(&text(&rows), map)
            .expect_err("contradicts")
            .to_string()
    };
    let message = error(&MAP.replace("column = \"v\"", "column = \"v\", unit = \"km/h\""));
    assert!(
        message.ends_with("v looks like m/s: ratio 0.28; correct the map"),
        "{message}"
    );
    let message = error(&MAP.replace("column = \"x\"", "column = \"x\", unit = \"ft\""));
    assert!(message.contains("x looks like m: ratio 0.30"), "{message}");
    let in_feet: Vec<Row> = rows
        .iter()
        .cloned()
        .map(|row| (row.0, row.1, row.2, row.3, row.4 / 0.3048, row.5))
        .collect();
    let in_kmh = MAP.replace("column = \"v\"", "column = \"v\", unit = \"km/h\"");
    let message = try_read(&text(&in_feet), &in_kmh)
        .expect_err("contradicts")
        .to_string();
    assert!(
        message.contains("v looks like ft/s: ratio 0.91"),
        "{message}"
    );
    let slowed = |factor: usize| {
        let rows = rows
            .iter()
            .cloned()
            .map(|row| (factor * row.0, row.1, row.2, row.3, row.4, row.5));
        text(&rows.collect::<Vec<_>>())
    };
    let message = try_read(&slowed(1000), MAP)
        .expect_err("contradicts")
        .to_string();
    assert!(message.contains("t looks like ms: ratio 1000"), "{message}");
    let frames = MAP.replace(
        "clock = { column = \"t\"",
        "frames = { column = \"t\", rate_hz = 12.5",
    );
    let message = try_read(&slowed(10), &frames)
        .expect_err("contradicts")
        .to_string();
    assert!(
        message.contains("t looks like 10 Hz: ratio 0.80"),
        "{message}"
    );

    let map = |follower: &str| {
        let columns = "spacing = { column = \"gap\" }\nrelative_speed = { column = \"closing\" }\n";
        let follower = format!("follower_speed = {{ column = \"v\", unit = \"{follower}\" }}\n");
        let head = "version = 1\nname = \"own\"\ntime.clock = { column = \"t\" }\n[layout.pairs]\n";
        format!("{head}{columns}{follower}leader_speed = {{ column = \"lead\" }}\n")
    };
    let pairs = |sign: f64, offset_mps: f64, switch_m: f64| {
        let (mut text, mut gap_m) = ("t,gap,v,closing,lead\n".to_owned(), 40.0);
        for step in 0..150 {
            let lead_mps = 20.0 - 3.0 * (f64::from(step) * STEP_S - 4.0).clamp(0.0, 2.0);
            let closing = sign * (lead_mps - 20.0) + offset_mps;
            let shown_m = if step < 100 { gap_m } else { gap_m + switch_m };
            let _ = writeln!(
                text,
                "{:.1},{shown_m:.3},20,{closing:.3},{lead_mps:.3}",
                f64::from(step) * STEP_S
            );
            gap_m += STEP_S * (lead_mps - 20.0) * if gap_m > 5.0 { 1.0 } else { 0.0 };
        }
        text
    };
    let error = |text: &str, unit: &str| {
        try_read(text, &map(unit))
            .expect_err("contradicts")
            .to_string()
    };
    let message = error(&pairs(-1.0, 0.0, 0.0), "m/s");
    assert!(
        message.ends_with("closing has the opposite sign; correct the map"),
        "{message}"
    );
    let message = error(&pairs(1.0, 0.0, 0.0), "km/h");
    assert!(
        message.contains("v looks like m/s: ratio 0.28"),
        "{message}"
    );
    let message = messages(&try_read(&pairs(1.0, 2.0, 0.0), &map("m/s")).expect("readable"));
    assert!(message.contains("an offset of"), "{message}");
    let recording = try_read(&pairs(1.0, 0.0, 12.0), &map("m/s")).expect("readable");
    let lengths: Vec<usize> = recording
        .platoons
        .iter()
        .map(|platoon| platoon.time_s.len())
        .collect();
    assert_eq!(lengths, [100, 50]);
    assert!(
        messages(&recording).contains("a.csv:102: the gap changes by"),
        "{}",
        messages(&recording)
    );
}

/// A walk over all instants for each vehicle took more than a minute.
#[test]
fn sparse_vehicles_are_linked_in_linear_time() {
    use super::link::link;
    let count = 200_000_u32;
    let point = |track: u32, time_ms: i64| TrackPoint {
        vehicle: track,
        track,
        lane: track % 7,
        time_ms,
        line: 1,
        position_m: Some(f64::from(track)),
        speed_mps: Some(0.0),
        length_m: Some(4.0),
        front_m: f64::from(track),
        ..TrackPoint::default()
    };
    // Each vehicle has a row at its own time and one at the end.
    let rows = |track: u32| {
        [
            point(track, i64::from(track)),
            point(track, i64::from(2 * count - track)),
        ]
    };
    let mut points: Vec<TrackPoint> = (0..count).flat_map(rows).collect();
    let started = std::time::Instant::now();
    link(&mut points, 500, &mut Vec::new());
    assert!(started.elapsed().as_secs() < 20, "{:?}", started.elapsed());
}
