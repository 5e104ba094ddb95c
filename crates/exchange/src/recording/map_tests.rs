//! One motion in several layouts and units yields equal episodes; map errors name their line.

use std::fmt::Write as _;
use std::path::Path;

use proptest::prelude::*;

use super::map::RecordingMap;
use super::motion_tests::{PlatoonMotion, any_motion};
use super::tests::read_text;
use super::*;

/// Tracks of vehicles that drive towards smaller positions, in feet, kilometres per hour and frames.
pub(super) const TRACKS: &str = r#"version = 1
name = "tracks"
delimiter = "semicolon"
lines_before_names = 1
time.frames = { column = "frame", rate_hz = 10.0 }

[layout.tracks]
vehicle = "id"
lane = "lane"
position = { column = "y", unit = "ft", of = "centre" }
speed = { column = "v", unit = "km/h" }
length.column = { name = "length", unit = "cm" }
"#;

/// Pairs, in miles per hour and from front to front, with the closing speed instead of the leader's speed.
const PAIRS: &str = r#"version = 1
name = "pairs"
delimiter = "tab"
time.clock = { column = "ms", unit = "ms" }

[layout.pairs]
spacing = { column = "range", unit = "ft", from = "front-to-front" }
length_m = 4.5
follower_speed = { column = "ego", unit = "mph" }
relative_speed = { column = "closing", unit = "mph", sign = "follower-minus-leader" }
"#;

pub(super) fn map(text: &str) -> RecordingMap {
    RecordingMap::from_toml(text, Path::new("map.toml")).expect("a map")
}

fn map_error(text: &str) -> String {
    RecordingMap::from_toml(text, Path::new("m.toml"))
        .expect_err("wrong")
        .to_string()
}

pub(super) fn read_with(text: &str, by: &str) -> Recording {
    read(text.as_bytes(), Path::new("a.csv"), Some(&map(by))).expect("readable")
}

/// Returns the data of each scenario: start and duration, braking and leader speeds, initial states.
fn episode_data(recording: &Recording) -> Vec<[Vec<f64>; 4]> {
    let episodes = find_episodes(recording, MinBrake::default(), LeaderSelection::Any).episodes;
    let mut rows: Vec<_> = episodes
        .into_iter()
        .map(|episode| {
            let states = episode
                .vehicles
                .iter()
                .flat_map(|vehicle| [vehicle.gap_ahead_m, vehicle.speed_mps])
                .collect();
            [
                vec![episode.start_s, episode.duration_s],
                episode.leader_motion.time_s,
                episode.leader_motion.speed_mps,
                states,
            ]
        })
        .collect();
    rows.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
    rows
}

/// Returns the mean speed of a vehicle between two rows, in m/s.
fn mean_mps(rows: &[Vec<Option<f64>>], index: usize) -> f64 {
    rows.iter()
        .map(|row| row[index].expect("known"))
        .sum::<f64>()
        / rows.len() as f64
}

fn as_tracks(motion: &PlatoonMotion) -> String {
    let mut text = "made up\nframe;id;lane;y;v;length\n".to_owned();
    for (k, (speeds, gaps)) in motion.speeds.iter().zip(&motion.gaps).enumerate() {
        let mut front_m: f64 = motion.speeds[..=k]
            .windows(2)
            .map(|rows| 0.1 * mean_mps(rows, 0))
            .sum();
        for (index, speed) in speeds.iter().enumerate() {
            front_m -= if index == 0 {
                0.0
            } else {
                gaps[index - 1].expect("known") + 4.5
            };
            let (centre_ft, kmh) = (-(front_m - 2.25) / 0.3048, speed.expect("known") * 3.6);
            let _ = writeln!(
                text,
                "{};{};2;{centre_ft};{};450",
                4800 + k,
                motion.first + index,
                -kmh
            );
        }
    }
    text
}

fn as_pairs(motion: &PlatoonMotion) -> String {
    let mut text = "ms\tego\tclosing\trange\n".to_owned();
    for (k, (speeds, gaps)) in motion.speeds.iter().zip(&motion.gaps).enumerate() {
        let [leader, follower] = [0, 1].map(|index| speeds[index].expect("known") / 0.447_04);
        let range_ft = (gaps[0].expect("known") + 4.5) / 0.3048;
        let _ = writeln!(
            text,
            "{}\t{follower}\t{}\t{range_ft}",
            480_000 + 100 * k,
            follower - leader
        );
    }
    text
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(64))]

    #[test]
    fn every_layout_of_a_motion_gives_the_same_episodes(mut motion in any_motion(0.0)) {
        // Each follower is a little slower than the vehicle ahead, so that gaps grow.
        for row in &mut motion.speeds {
            let lead_mps = row[0].expect("known");
            row.iter_mut().enumerate().for_each(|(index, speed)| *speed = Some(lead_mps * 0.99_f64.powi(index as i32)));
        }
        for k in 1..motion.gaps.len() {
            for index in 0..motion.gaps[0].len() {
                let [ahead_mps, mps] = [index, index + 1].map(|index| mean_mps(&motion.speeds[k - 1..=k], index));
                motion.gaps[k][index] = motion.gaps[k - 1][index].map(|gap_m| gap_m + 0.1 * (ahead_mps - mps));
            }
        }
        // Values are written and read to a millimetre in any unit.
        for value in motion.speeds.iter_mut().chain(&mut motion.gaps).flatten().flatten() {
            *value = (*value * 1000.0).round() / 1000.0;
        }
        let expected = episode_data(&read_text(&motion.to_csv()).expect("readable"));
        prop_assert_eq!(&episode_data(&read_with(&as_tracks(&motion), TRACKS)), &expected);
        let pair = PlatoonMotion {
            first: 1,
            speeds: motion.speeds.iter().map(|row| row[..2].to_vec()).collect(),
            gaps: motion.gaps.iter().map(|row| row[..1].to_vec()).collect(),
        };
        let expected = episode_data(&read_text(&pair.to_csv()).expect("readable"));
        prop_assert_eq!(&episode_data(&read_with(&as_pairs(&pair), PAIRS)), &expected);
    }
}

/// Too sparse or too short recordings are not reported as free of braking.
#[test]
fn absent_braking_is_reported_only_where_observed() {
    let pair = |step_ms: u32, count: u32, ego: &str| {
        let rows: String = (0..count)
            .map(|k| format!("{}\t{ego}\t0\t100\n", step_ms * k))
            .collect();
        hardest_braking(&read_with(
            &format!("ms\tego\tclosing\trange\n{rows}"),
            PAIRS,
        ))
        .to_string()
    };
    assert_eq!(pair(100, 50, "20"), "no vehicle brakes");
    assert_eq!(
        pair(1000, 50, "20"),
        "the speeds of a vehicle are 1.000 s apart, more than the limit of 0.5 s: crumple cannot find braking"
    );
    assert_eq!(
        pair(100, 9, "20"),
        "no vehicle has a known speed for a whole second without a gap in the data, 0.800 s at most: crumple cannot \
            find braking"
    );
    assert_eq!(
        pair(100, 50, ""),
        "no vehicle that can be a leader has a known speed, so crumple cannot find braking"
    );
    let slow = read_with(
        "ms\tego\tclosing\trange\n0\t20\t0\t100\n1000\t20\t0\t100\n2000\t20\t0\t100\n",
        PAIRS,
    );
    assert_eq!(preview(&slow).expect("speeds are known").step_s, Some(1.0));
}

#[test]
fn gaps_are_filled_up_to_the_length_in_the_map() {
    let values = |by: &str| {
        let rows =
            "0\t10\t0\t50\n100\t\t0\t50\n200\t14\t0\t\n300\t\t0\t\n400\t\t0\t\n500\t20\t0\t80\n";
        let recording = read_with(&format!("ms\tego\tclosing\trange\n{rows}"), by);
        let follower = recording.platoons[0].vehicles[1].speed_mps.clone();
        follower
            .into_iter()
            .map(|mps| mps.map(|mps| (mps / 0.447_04 * 1e6).round() / 1e6))
            .collect::<Vec<_>>()
    };
    let holes = [Some(10.0), None, Some(14.0), None, None, Some(20.0)];
    assert_eq!(values(PAIRS), holes);
    let filled = |seconds: &str| {
        values(&PAIRS.replace("time.", &format!("interpolate_s = {seconds}\ntime.")))
    };
    assert_eq!(
        filled("0.2"),
        [Some(10.0), Some(12.0), Some(14.0), None, None, Some(20.0)]
    );
    assert_eq!(
        filled("0.3"),
        [10.0, 12.0, 14.0, 16.0, 18.0, 20.0].map(Some)
    );
}

#[test]
fn errors_of_a_map_name_line_and_field() {
    let length = "length_m = 4.5\n";
    let cases = [
        (
            PAIRS,
            "version = 1",
            "version = 2",
            "1: version: version 2 is not supported: this release reads version 1",
        ),
        (
            PAIRS,
            "\"pairs\"",
            "\"My pairs\"",
            "2: name: must be 1 to 40 lower-case letters, digits and hyphens",
        ),
        (
            PAIRS,
            "\"tab\"",
            "\"blank\"",
            "3: delimiter: unknown variant `blank`, expected",
        ),
        (
            PAIRS,
            "unit = \"ms\"",
            "unit = \"h\"",
            "4: time.clock.unit: unknown variant `h`, expected",
        ),
        (
            PAIRS,
            "\"range\"",
            "\"\"",
            "7: layout.pairs.spacing.column: must be 1 to 200 letters",
        ),
        (
            PAIRS,
            length,
            "",
            "6: layout.pairs: length_m: is needed for spacings from front to front",
        ),
        (
            PAIRS,
            ", from = \"front-to-front\"",
            "",
            "8: layout.pairs.length_m: is not used for spacings from bumper to bumper: remove it",
        ),
        (
            PAIRS,
            length,
            "length_m = nan\n",
            "8: layout.pairs.length_m: must be from 0.1 to 100, found NaN",
        ),
        (
            PAIRS,
            "follower_speed",
            "leaders_speed",
            "9: layout.pairs.leaders_speed: unknown field `leaders_speed`",
        ),
        (
            TRACKS,
            "lines_before_names = 1",
            "lines_before_names = 1001",
            "4: lines_before_names: must be at most 1000",
        ),
        (
            TRACKS,
            "rate_hz = 10.0",
            "rate_hz = 0.0",
            "5: time.frames.rate_hz: must be from 0.5 to 1000, found 0",
        ),
        (
            TRACKS,
            "\"centre\"",
            "\"middle\"",
            "10: layout.tracks.position.of: unknown variant `middle`",
        ),
        (TRACKS, "[layout.tracks]", "[layout.traces]", "7: layout"),
        (
            TRACKS,
            "vehicle = \"id\"\n",
            "",
            "7: layout.tracks: missing field `vehicle`",
        ),
        (
            TRACKS,
            "\"lane\"",
            "\"id\"",
            "9: layout.tracks.lane: `id` is already the column of `layout.tracks.vehicle`",
        ),
        (
            TRACKS,
            "{ column = \"v\"",
            "{ column = \"y\"",
            "11: layout.tracks.speed.column: `y` is already the column of `layout.tracks.position.column`",
        ),
        (
            TRACKS,
            "name = \"length\"",
            "name = \"frame\"",
            "12: layout.tracks.length.column.name: `frame` is already the column of `time.frames.column`",
        ),
        (
            PAIRS,
            "\"closing\"",
            "\"ego\"",
            "10: layout.pairs.relative_speed.column: `ego` is already the column of \
                `layout.pairs.follower_speed.column`",
        ),
        (
            TRACKS,
            "lines_before",
            "interpolate_s = 3.0\nlines_before",
            "4: interpolate_s: must be from 0 to 2, found 3",
        ),
    ];
    for (text, good, bad, expected) in cases {
        let changed = text.replacen(good, bad, 1);
        assert_ne!(changed, text);
        let (message, expected) = (map_error(&changed), format!("m.toml:{expected}"));
        assert!(
            message.starts_with(&expected),
            "{message}\n  should start with\n{expected}"
        );
    }
    let two = TRACKS.to_owned() + "[layout.pairs]\nspacing = { column = \"x\" }\n";
    assert!(map_error(&two).contains("several kinds are given"));
}

#[test]
fn platoons_from_front_to_front_need_their_cars_length() {
    let text = "t,v1,v2,d1\n0,10,11,20\n0.1,10,11,4\n";
    let by = "version = 1\nname = \"own\"\ntime.clock = { column = \"t\" }\n[layout.platoon]\nspeed = \
        { column = \"v{}\" }\n\
              spacing = { column = \"d{}\", from = \"front-to-front\" }\nlength_m = 5.0\n";
    assert_eq!(
        read_with(text, by).platoons[0].gap_ahead_m(1),
        [Some(15.0), None]
    );
    for (good, bad) in [("\"v{}\"", "\"v\""), ("\"v{}\"", "\"v{}{}\"")] {
        let expected = "m.toml:5: layout.platoon.speed.column: must hold `{}` once, where the vehicle's number stands";
        assert_eq!(map_error(&by.replace(good, bad)), expected);
    }
}

#[test]
fn the_hardest_braking_is_found_at_any_threshold() {
    let rows: String = (0..60)
        .map(|k| {
            format!(
                "{}\t20\t{}\t100\n",
                100 * k,
                0.05 * f64::from(k - 20).clamp(0.0, 15.0)
            )
        })
        .collect();
    let recording = read_with(&format!("ms\tego\tclosing\trange\n{rows}"), PAIRS);
    assert_eq!(
        find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes,
        []
    );
    let HardestBrakingResult::Braking(hardest) = hardest_braking(&recording) else {
        panic!("it brakes")
    };
    assert!(
        (hardest.drop_mps - 0.5 * 0.447_04).abs() < 2e-3 && (2.0..=2.5).contains(&hardest.from_s),
        "{hardest:?}"
    );
    let preview = preview(&recording).expect("speeds are known");
    assert_eq!(
        (preview.lead_vehicles, preview.samples, preview.step_s),
        (1, 60, Some(0.1))
    );
    assert_eq!((preview.time_s, preview.lines.len()), ([0.0, 5.9], 1));
}
