//! Synthetic recordings in the formats of the published ones.

use crumple_sim::scenario::NoDriverFiles;
use std::path::Path;

use super::*;

pub(super) const HEADER: &str =
    "Date,8,10,2019\nVehicle_order,A,B,C,\nNumber_of_vehicles,3\nACC,1\nDistance_setting,L\n";
const EVENTS: &str = "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n";

pub(super) fn read_text(text: &str) -> Result<Recording, RecordingError> {
    read(text.as_bytes(), Path::new("a.csv"), None)
}

fn error_of(text: &str) -> String {
    read_text(text).expect_err("must be refused").to_string()
}

pub(super) fn dropped_of(text: &str) -> Vec<String> {
    read_text(text)
        .expect("readable")
        .dropped
        .iter()
        .map(DroppedItem::to_string)
        .collect()
}

/// Writes a platoon whose leader brakes from 20 to 11 m/s between 5 s and 8 s.
pub(super) fn braking_platoon(vehicles: usize) -> String {
    let columns = |name: &str, count: usize| {
        (1..=count)
            .map(|k| format!(",{name}{k}"))
            .collect::<String>()
    };
    let mut text = format!(
        "{HEADER}Time{}{}\n",
        columns("Speed", vehicles),
        columns("IVS", vehicles - 1)
    );
    for k in 0..300 {
        let time_s = f64::from(k) * 0.1;
        let lead = 20.0 - 3.0 * (time_s - 5.0).clamp(0.0, 3.0);
        text += &format!(
            "{time_s:.1},{lead:.3}{}{}\n",
            ",20.5".repeat(vehicles - 1),
            ",15.25".repeat(vehicles - 1)
        );
    }
    text
}

#[test]
fn holes_in_the_numbering_split_the_platoon() {
    let rows = "0.0,1,2,3,4,5,10,11,12,13\n0.1,1,2,3,4,5,10,11,12,13\n";
    let text =
        format!("{HEADER}Time,Speed2,Speed3,Speed5,Speed6,Speed7,IVS2,IVS3,IVS5,IVS7\n{rows}");
    let recording = read_text(&text).expect("readable");
    let numbers: Vec<Vec<_>> = recording
        .platoons
        .iter()
        .map(|p| p.vehicles.iter().map(|vehicle| vehicle.number).collect())
        .collect();
    assert_eq!(numbers, [[2, 3], [5, 6]]);
    assert_eq!(
        recording.platoons[1].gap_ahead_m(1),
        [Some(12.0), Some(12.0)]
    );
    assert_eq!(
        recording.platoons[1].vehicles[1].speed_mps,
        [Some(4.0), Some(4.0)]
    );
    let expected = [
        "a.csv:6: vehicle 1 has no speed column: the platoon starts behind",
        "a.csv:6: vehicle 4 has no speed column: the platoon is split there, because the spacing is unknown",
        "a.csv:6: IVS6: no such column, so the platoon is split between vehicles 6 and 7",
        "a.csv:6: IVS3: ignored, because one of its two vehicles has no speed column",
        "a.csv:6: IVS7: ignored, because one of its two vehicles has no speed column",
        "a.csv:6: vehicle 7: left out, because no spacing to a vehicle ahead of it or behind it is recorded",
    ];
    assert_eq!(dropped_of(&text), expected);
}

#[test]
fn missing_and_impossible_values_are_excluded_and_reported() {
    let rows = "0.0,20,,5\n0.1,NaN,21,-3.5\n0.2,20,-1,0\n0.2,20,21,5\n0.1,20,21,5\n0.3,1e300,21,1e308\n0.4,20,21,5\n";
    let text = format!("{HEADER}Time,Speed1,Speed2,IVS1\n{rows}");
    let platoon = &read_text(&text).expect("readable").platoons[0];
    assert_eq!(platoon.time_s, [0.0, 0.1, 0.2, 0.3, 0.4]);
    assert_eq!(platoon.line, [7, 8, 9, 12, 13]);
    assert_eq!(
        platoon.vehicles[0].speed_mps,
        [Some(20.0), None, Some(20.0), None, Some(20.0)]
    );
    assert_eq!(
        platoon.vehicles[1].speed_mps,
        [None, Some(21.0), None, Some(21.0), Some(21.0)]
    );
    assert_eq!(
        platoon.gap_ahead_m(1),
        [Some(5.0), None, None, None, Some(5.0)]
    );
    let expected = [
        "a.csv:6: vehicle 3 has no speed column: the platoon ends before",
        "a.csv:10: Time: 2 rows are not later than the row before and were left out, the first one here \
         (0.2 s after 0.2 s)",
        "a.csv:8: Speed1: 1 of 7 values are missing, the first one here",
        "a.csv:12: Speed1: 1 impossible speeds, the first one here, the last one on line 12, the worst 1e300 m/s",
        "a.csv:7: Speed2: 1 of 7 values are missing, the first one here",
        "a.csv:9: Speed2: 1 impossible speeds, the first one here, the last one on line 9, the worst -1 m/s",
        "a.csv:8: IVS1: 3 impossible spacings, the first one here, the last one on line 12, the worst 1e308 m",
    ];
    assert_eq!(dropped_of(&text), expected);
}

#[test]
fn unusable_files_name_line_and_column() {
    let named = format!("{HEADER}Time,Speed1,Speed2,IVS1\n");
    let cases = [
        (String::new(), "a.csv: the recording is empty"),
        ("a,b\n".to_owned(), "a.csv:1: `a`: neither an OpenACC"),
        (
            "frame;id;x;y;width;height;xVelocity;yVelocity;laneId\n".to_owned(),
            "a.csv:1: these are the columns of the built-in map `highd`: name it (--map highd)",
        ),
        (
            "Date,1\nACC,1\n".to_owned(),
            "a.csv:2: the recording ends here, before the end of its header lines",
        ),
        (
            HEADER.to_owned(),
            "a.csv:5: the recording ends here, before the names of its columns",
        ),
        (
            named.clone(),
            "a.csv:6: the recording ends here, before its first sample",
        ),
        (
            named.replace("Time,", "Speed9,"),
            "a.csv:6: Time: there is no such column among `Speed9, Speed1",
        ),
        (
            named.replace("Speed2", "Speed1"),
            "a.csv:6: Speed1: named twice",
        ),
        (
            named.replace("Speed2", "Speed3"),
            "a.csv:6: IVS1: no such column is between two `Speed` columns of successive numbers",
        ),
        (
            format!("{named}0.0,1,2,3\n0.1,1\n"),
            "a.csv:8: Speed2: 2 fields in a row of 4",
        ),
        (
            format!("{named}0.0,1,2,3,4\n"),
            "a.csv:7: IVS1: 5 fields in a row of 4",
        ),
        (
            format!("{named}0.0,1,fast,3\n"),
            "a.csv:7: Speed2: must be a finite number or empty, found `fast`",
        ),
        (
            format!("{named}0.0,1,2,-inf\n"),
            "a.csv:7: IVS1: must be a finite number or empty, found `-inf`",
        ),
        (
            format!("{named}0.0,1,1e999,3\n"),
            "a.csv:7: Speed2: must be a finite number or empty, found `1e999`",
        ),
        (
            format!("{named},1,2,3\n"),
            "a.csv:7: Time: must not be empty",
        ),
        (
            format!("{named}1e11,1,2,3\n"),
            "a.csv:7: Time: must be from -10000000000 to 10000000000, found 100000000000",
        ),
        (
            EVENTS.to_owned(),
            "a.csv:1: the recording ends here, before its first sample",
        ),
        (
            EVENTS.replace("gap_m", "gap"),
            "a.csv:1: gap_m: there is no such column among `event, time_s, gap, foll",
        ),
        (
            EVENTS.replace("\n", ",gap_m\n"),
            "a.csv:1: gap_m: named twice",
        ),
        (
            format!("{EVENTS}1,0.0,5,1,0,1\n,0.1,5,1,0,1\n"),
            "a.csv:3: event: must not be empty",
        ),
        (
            format!("{EVENTS}1,0.0,5,1,0,1\n2,0.0,5,1,0,1\n1,0.1,5,1,0,1\n"),
            "a.csv:4: event: event `1`, whose last row was line 2, continues here after rows of other events: sort the \
                rows by event",
        ),
        (
            format!("{EVENTS}1,0.0,5,1\n"),
            "a.csv:2: relative_speed_mps: 4 fields in a row of 6",
        ),
        (
            EVENTS.replace("event", "\"event\""),
            "a.csv:1: the recording ends here, before its first sample",
        ),
        (
            named.replace("Speed2", &"x".repeat(99)) + "0,1\n",
            "a.csv:6: IVS1: no such column",
        ),
        (
            named.replace('\n', &format!(",{}\n", "x\u{1b}".repeat(99))) + "0,1,2,3\n",
            "a.csv:7: x",
        ),
        (
            format!("{EVENTS}\"1\",0.0,5,1,0,1\n1,0.1,5,1,0,1\n\"1,0.2,5,1,0,1\n1,0.3,5,1,0,1\n"),
            "a.csv:4: a quotation mark in this row is not closed",
        ),
        (
            format!("{EVENTS}1,zero,5,1,0,1\n"),
            "a.csv:2: time_s: must be a finite number or empty, found `zero`",
        ),
    ];
    for (text, expected) in cases {
        let message = error_of(&text);
        assert!(
            message.starts_with(expected),
            "{message}\n  should start with\n{expected}"
        );
        assert!(
            message.len() < 250 && !message.contains(char::is_control),
            "one line: {message:?}"
        );
    }
    let utf_16 = |text: &[u16]| {
        text.iter()
            .copied()
            .flat_map(u16::to_le_bytes)
            .collect::<Vec<_>>()
    };
    let names = utf_16(&"\u{feff}event,time_s\n".encode_utf16().collect::<Vec<_>>());
    let half_letter = utf_16(&[0xfeff, 0xd800, 0x20]);
    for (bytes, expected) in [
        (
            names,
            "a.csv:1: gap_m: there is no such column among `event, time_s`",
        ),
        (half_letter, "a.csv:1: is not text in UTF-16LE"),
        (
            b"PK\x03\x04".to_vec(),
            "a.csv: this is a ZIP archive or an Excel workbook: export the recording as CSV, Parquet or MDF 4",
        ),
    ] {
        let message = read(&bytes, Path::new("a.csv"), None)
            .expect_err("not text")
            .to_string();
        assert_eq!(message, expected);
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let message = load(folder.path(), None).expect_err("a folder").to_string();
    assert!(
        message.starts_with(&format!("{}: ", folder.path().display())),
        "{message}"
    );
    assert!(!message.contains('\n'), "{message}");
    let missing = load(Path::new("no/such/recording.csv"), None)
        .expect_err("missing")
        .to_string();
    assert!(missing.starts_with("no/such/recording.csv: "), "{missing}");
}

#[test]
fn recordings_too_large_for_memory_are_refused() {
    let endless = read(&[b'7'; 2 << 20], Path::new("a.csv"), None)
        .expect_err("endless line")
        .to_string();
    assert!(endless.contains("a line of more than"), "{endless}");
    let columns: String = (1..=201).map(|k| format!(",Speed{k}")).collect();
    let message = error_of(&format!("{HEADER}Time{columns}\n"));
    assert!(
        message.starts_with("a.csv:6: more than 200 vehicles"),
        "{message}"
    );
}

#[test]
fn each_car_following_event_is_a_platoon_of_two() {
    let rows = "7,0.0,5,10,1,11\n7,0.1,5,,1,11\n7,0.2,5,10,1,\n7,0.3,5,10,1,13\n9,0.0,-1,10,,11\n";
    let recording = read_text(&format!("{EVENTS}{rows}")).expect("readable");
    assert_eq!(
        recording
            .platoons
            .iter()
            .map(|platoon| platoon.event.as_deref())
            .collect::<Vec<_>>(),
        [Some("7"), Some("9")]
    );
    let [leader, follower] = &recording.platoons[0].vehicles[..] else {
        panic!("not a pair")
    };
    assert_eq!(
        leader.speed_mps,
        [Some(11.0), Some(11.0), Some(11.0), None],
        "the relative speed supplies it"
    );
    assert_eq!(
        follower.speed_mps,
        [Some(10.0), Some(10.0), Some(10.0), None]
    );
    assert_eq!(recording.platoons[1].gap_ahead_m(1), [None]);
    let output = dropped_of(&format!("{EVENTS}{rows}")).join("\n");
    let contradiction =
        "a.csv:5: relative_speed_mps: differs from leader_speed_mps - follower_speed_mps in 1 rows";
    assert!(output.contains(contradiction), "{output}");
    assert!(
        output.contains("a.csv:6: gap_m: 1 impossible spacings"),
        "{output}"
    );
}

/// Concatenated files restart their events at time 0.
#[test]
fn an_event_whose_time_starts_anew_is_another_event() {
    let rows = "1,0.0,5,1,0,1\n1,0.1,5,1,0,1\n\
        2,0.0,5,1,0,1\n1,0.0,5,1,0,1\n1,9.1,5,1,0,1\n1,0.0,5,1,0,1\n1,0.1,5,1,0,1\n";
    let recording = read_text(&format!("{EVENTS}{rows}")).expect("readable");
    let events: Vec<_> = recording
        .platoons
        .iter()
        .map(|platoon| platoon.event.as_deref())
        .collect();
    assert_eq!(events, [Some("1"), Some("2"), Some("1"), Some("1")]);
    let message = "a.csv:7: time_s: the time starts anew here (0 s after 9.1 s); of 1 such places each begins another";
    assert!(
        recording.dropped[0].to_string().starts_with(message),
        "{:?}",
        recording.dropped
    );
}

#[test]
fn events_that_differ_in_their_last_letter_are_two() {
    let name = "x".repeat(200);
    let recording =
        read_text(&format!("{EVENTS}{name}a,0,5,1,0,1\n{name}b,1,5,1,0,1\n")).expect("readable");
    let shown = format!("{}...", "x".repeat(40));
    let platoons: Vec<_> = recording
        .platoons
        .iter()
        .map(|p| (p.event.as_deref(), p.time_s.as_slice()))
        .collect();
    assert_eq!(
        platoons,
        [
            (Some(shown.as_str()), &[0.0][..]),
            (Some(shown.as_str()), &[1.0][..])
        ]
    );
}

#[test]
fn a_byte_order_mark_and_carriage_returns_change_nothing() {
    for text in [
        braking_platoon(3),
        format!("{EVENTS}7,0.0,5,10,1,11\n7,0.1,5,,1,11\n"),
    ] {
        for line_end in ["\r\n", "\r"] {
            let foreign = format!("\u{feff}{}", text.replace('\n', line_end));
            assert_eq!(
                read_text(&foreign).expect("readable"),
                read_text(&text).expect("readable")
            );
        }
    }
}

/// The end of a file may cut a number without a trace in its row, except for the missing line end.
#[test]
fn a_row_without_its_end_is_left_out() {
    let rows = "7,0.0,5.0,10.0,1.25,11.25\n7,0.1,5.1,10.0,1.25,11.25\n";
    for (last, samples) in [
        ("7,0.2,5.2,10.0,0.2,10.2", 2),
        ("7,0.2,5.2,10.0,0.2,10.2\n", 3),
        ("7,0.2,5.2,10.0,0.21,10.21", 3),
    ] {
        let text = format!("{EVENTS}{rows}{last}");
        assert_eq!(
            read_text(&text).expect("readable").platoons[0].time_s.len(),
            samples,
            "{text}"
        );
        let cut = "a.csv:4: the file ends within this line, so it was left out";
        assert_eq!(dropped_of(&text), [cut][..usize::from(samples == 2)]);
    }
}

/// Time stamps are times, whatever unit the map states for numbers.
#[test]
fn time_stamps_need_no_unit() {
    let rows = "7,2026-03-01T12:00:00.0Z,5,10,1,11\n7,2026-03-01T12:00:00.5Z,5,10,1,11\n";
    let recording = read_text(&format!("{EVENTS}{rows}")).expect("readable");
    let time_s = &recording.platoons[0].time_s;
    assert_eq!(
        (time_s[1] - time_s[0], recording.text.time),
        (0.5, Some("ISO 8601 time stamps"))
    );
}

#[test]
fn names_of_imported_scenarios_are_distinct_and_errors_end_the_import() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let other = dir.path().join("other");
    std::fs::create_dir(&other).expect("temporary folder");
    let paths = [
        dir.path().join("Long setting_16.csv"),
        other.join("long-setting 16.csv"),
    ];
    for (path, text) in paths
        .iter()
        .zip([braking_platoon(3), braking_platoon(3) + "\n"])
    {
        std::fs::write(path, text).expect("temporary file");
    }
    let mut scenarios = Vec::new();
    let mut take = |scenario| {
        scenarios.push(scenario);
        true
    };
    import(&paths, None, &ImportOptions::default(), None, &mut take).expect("both readable");
    let names: Vec<_> = scenarios.iter().map(|s| s.file_name.as_str()).collect();
    assert_eq!(
        names,
        [
            "openacc-long-setting-16-01.toml",
            "openacc-long-setting-16-02.toml"
        ]
    );
    for imported in &scenarios {
        let read_back = crumple_sim::scenario::file::from_toml(
            &imported.toml,
            Path::new(&imported.file_name),
            &NoDriverFiles,
        );
        assert_eq!(read_back.expect("valid"), imported.scenario);
    }
    let with_missing = [paths[0].clone(), dir.path().join("gone.csv")];
    assert!(
        import(
            &with_missing,
            None,
            &ImportOptions::default(),
            None,
            &mut |_| true
        )
        .is_err()
    );
    let mut taken = 0;
    let mut take_one = |_| {
        taken += 1;
        false
    };
    let ended =
        import(&paths, None, &ImportOptions::default(), None, &mut take_one).expect("readable");
    assert_eq!((taken, ended.sources.len()), (1, 1));
    for wrong in [0.0, -1.0, 12.1, f64::NAN, f64::INFINITY] {
        assert!(MinBrake::new(wrong).is_err());
    }
}
