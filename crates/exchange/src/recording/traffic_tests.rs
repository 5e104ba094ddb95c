//! Vehicles of tracks: lanes, lengths, and rows with faults.

use std::fmt::Write as _;
use std::path::Path;

use super::map_tests::{TRACKS, map, read_with};
use super::*;

#[test]
fn followers_change_where_vehicles_change_lanes() {
    // Lane 1 drives up, lane 2 down. Vehicle 7 leaves lane 1 at 0.2 s, so that 8 follows 6 from then on.
    let mut text = "made up\nframe;id;lane;y;v;length\n".to_owned();
    for k in 0..5 {
        for (id, lane, metres) in [
            (6, 1, 100.0),
            (7, if k < 2 { 1 } else { 3 }, 80.0),
            (8, 1, 60.0),
            (9, 2, 70.0),
            (10, 2, 90.0),
        ] {
            let moved_m = f64::from(k) * if lane == 2 { -2.0 } else { 2.0 };
            let _ = writeln!(
                text,
                "{k};{id};{lane};{};72;500",
                (metres + moved_m) / 0.3048
            );
        }
    }
    let recording = read_with(&text, TRACKS);
    assert_eq!(recording.dropped, []);
    let behind = |id: usize, at: usize| {
        let leads = recording.lead_vehicles();
        let lead = leads
            .iter()
            .find(|lead| lead.number() == id)
            .expect("recorded");
        let sample = lead.segments()[0][at];
        let followers = lead.followers_at(&sample);
        assert!(
            followers
                .iter()
                .all(|follower| follower.speed_mps == 20.0 && follower.length_m == Some(5.0))
        );
        followers
            .into_iter()
            .map(|follower| (follower.number, follower.gap_ahead_m))
            .collect::<Vec<_>>()
    };
    assert_eq!(behind(6, 1), [(7, 15.0), (8, 15.0)]);
    assert_eq!(behind(6, 2), [(8, 35.0)]);
    assert_eq!(behind(7, 2), []);
    assert_eq!(
        (behind(9, 0), behind(10, 0)),
        (vec![(10, 15.0)], vec![]),
        "down the road, 9 is ahead"
    );
}

#[test]
fn vehicles_are_as_long_as_recorded_and_lorries_are_heavy() {
    let mut text = "made up\nframe;id;lane;y;v;length\n".to_owned();
    for k in 0..60 {
        let lost_mps = 0.4 * f64::from(k - 20).clamp(0.0, 20.0);
        for (id, metres, cm) in [(1, 100.0, 420), (2, 80.0, 1250), (3, 50.0, 500)] {
            let (feet, kmh) = (
                (metres + 2.0 * f64::from(k)) / 0.3048,
                3.6 * (20.0 - lost_mps),
            );
            let _ = writeln!(text, "{k};{id};1;{feet};{kmh};{cm}");
        }
    }
    let recording = read_with(&text, &TRACKS.replace("centre", "front"));
    let episodes = find_episodes(&recording, MinBrake::default(), LeaderSelection::First).episodes;
    let scenario = episodes[0]
        .scenario("a".to_owned(), "a.csv", &FollowerDriver::Baseline)
        .expect("valid");
    let built: Vec<_> = scenario
        .vehicles()
        .iter()
        .map(|vehicle| (vehicle.class.name(), vehicle.length_m()))
        .collect();
    assert_eq!(built, [("light", 4.2), ("heavy", 12.5), ("light", 5.0)]);
    let gap_m = |index| scenario.initial_gap_m(index).expect("follows");
    assert!(
        (gap_m(1) - 15.8).abs() < 1e-9 && (gap_m(2) - 17.5).abs() < 1e-9,
        "{} {}",
        gap_m(1),
        gap_m(2)
    );
}

#[test]
fn impossible_values_are_excluded_and_reported() {
    let row =
        |frame: u32, id: u32, metres: f64| format!("{frame};{id};1;{};72;500\n", metres / 0.3048);
    let rows = [
        row(0, 1, 50.0),
        row(0, 2, 47.0),
        row(0, 1, 51.0),
        row(1, 1, 52.0),
        row(4, 1, 58.0),
        row(1, 2, 49.0),
    ];
    let text = format!("made up\nframe;id;lane;y;v;length\n{}", rows.concat());
    let message = |by: &str| {
        read_with(&text, by)
            .dropped
            .iter()
            .map(DroppedItem::to_string)
            .collect::<Vec<_>>()
    };
    let doubled =
        "a.csv:5: vehicle 1 is in two places at once here; of 1 such rows each first one is kept";
    let overlap = "times a vehicle overlaps the one ahead of it in its lane, the first time here: \
        it follows no vehicle then";
    assert_eq!(
        message(TRACKS),
        [doubled.to_owned(), format!("a.csv:4: 2 {overlap}")]
    );
    let filled = TRACKS.replace("lines_before", "interpolate_s = 0.3\nlines_before");
    assert_eq!(
        message(&filled)[1],
        "a.csv:6: 2 missing rows and values of vehicles were filled by straight lines, the first one here"
    );
    for (good, bad, expected) in [
        ("0;1;", "0;;", "a.csv:3: id: must not be empty"),
        ("0;1;", ";1;", "a.csv:3: frame: must not be empty"),
        (
            ";lane;",
            ";line;",
            "a.csv:2: lane: there is no such column among `frame, id, line, y, v, length`",
        ),
        (";lane;", ";id;", "a.csv:2: id: named twice"),
    ] {
        let text = text.replacen(good, bad, 1);
        let error =
            read(text.as_bytes(), Path::new("a.csv"), Some(&map(TRACKS))).expect_err("damaged");
        assert_eq!(error.to_string(), expected);
    }
}

/// Three cars in one lane; a field of the second car's second row is damaged. No vehicle follows across it.
#[test]
fn no_vehicle_follows_across_an_unknown_one() {
    let text = |damage: &dyn Fn(u32, u32) -> [String; 4]| {
        let mut text = "made up\nframe;id;lane;y;v;length\n".to_owned();
        for k in 0..3 {
            for id in [1, 2, 3] {
                let [lane, y, v, length] = damage(k, id);
                let _ = writeln!(text, "{k};{id};{lane};{y};{v};{length}");
            }
        }
        text
    };
    let whole = |k: u32, id: u32| {
        let metres = 100.0 - 20.0 * f64::from(id) + 2.0 * f64::from(k);
        [
            "1".to_owned(),
            format!("{}", metres / 0.3048),
            "72".to_owned(),
            "500".to_owned(),
        ]
    };
    let damaged = |field: usize, with: &str| {
        text(&|k, id| {
            let mut row = whole(k, id);
            if (k, id) == (1, 2) {
                row[field] = with.to_owned();
            }
            row
        })
    };
    let behind = |recording: &Recording| -> Vec<Vec<usize>> {
        let leads = recording.lead_vehicles();
        let first = leads
            .iter()
            .find(|lead| lead.number() == 1)
            .expect("recorded");
        let numbers = |sample| {
            first
                .followers_at(sample)
                .into_iter()
                .map(|follower| follower.number)
                .collect()
        };
        first.segments()[0].iter().map(numbers).collect()
    };
    assert_eq!(
        behind(&read_with(&text(&whole), TRACKS)),
        [[2, 3], [2, 3], [2, 3]]
    );
    let cannot = "once the position or the length of a vehicle is not known, the first time here: no vehicle follows \
    it, or a vehicle beyond it, then";
    let filled = TRACKS.replace("lines_before", "interpolate_s = 0.3\nlines_before");
    for (field, with, message) in [
        (
            1,
            "",
            "a.csv:7: y: 1 of 9 values are missing, the first one here",
        ),
        (
            3,
            "",
            "a.csv:7: length: 1 of 9 values are missing, the first one here",
        ),
        (
            3,
            "-500",
            "a.csv:7: length: 1 impossible lengths, the first one here, the last one on line 7, the worst -5 m",
        ),
        (
            3,
            "25000",
            "a.csv:7: length: 1 impossible lengths, the first one here, the last one on line 7, the worst 250 m",
        ),
    ] {
        let recording = read_with(&damaged(field, with), TRACKS);
        assert_eq!(
            behind(&recording),
            [vec![2, 3], vec![], vec![2, 3]],
            "{field} {with}"
        );
        let dropped: Vec<_> = recording
            .dropped
            .iter()
            .map(DroppedItem::to_string)
            .collect();
        assert_eq!(dropped, [message.to_owned(), format!("a.csv:7: {cannot}")]);
        // The map can fill such holes.
        let recording = read_with(&damaged(field, with), &filled);
        assert_eq!(
            behind(&recording),
            [[2, 3], [2, 3], [2, 3]],
            "{field} {with}"
        );
        assert!(
            recording.dropped[1]
                .to_string()
                .contains("1 missing rows and values of vehicles were filled"),
            "{:?}",
            recording.dropped
        );
    }
    // An impossible speed is reported, and ends the line of vehicles there.
    let recording = read_with(&damaged(2, "-1e300"), TRACKS);
    assert_eq!(behind(&recording), [vec![2, 3], vec![], vec![2, 3]]);
    let [message] = &recording.dropped[..] else {
        panic!("{:?}", recording.dropped)
    };
    let worst = "a.csv:7: v: 1 impossible speeds, the first one here, the last one on line 7, the worst -2.7";
    assert!(
        message.to_string().starts_with(worst) && message.to_string().ends_with("e299 m/s"),
        "{message}"
    );
    for mark in ["", "-", "NaN", "NA", "None", "null"] {
        let lost = damaged(0, mark);
        let nameless = lost.replace(&format!("1;2;{mark};"), &format!("1;{mark};1;"));
        for (text, column) in [(lost, "lane"), (nameless, "id")] {
            let error = read(text.as_bytes(), Path::new("a.csv"), Some(&map(TRACKS)))
                .expect_err("in no lane");
            assert_eq!(
                error.to_string(),
                format!("a.csv:7: {column}: must not be empty"),
                "{mark}"
            );
        }
    }
}
