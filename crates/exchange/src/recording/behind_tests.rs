//! Pairs with a vehicle behind, as a car with front and rear radar records them.

use std::path::Path;

use super::map::{LayoutSpec, RecordingMap};
use super::*;

const MAP: &str = "version = 1\nname = \"own-car\"\ntime.clock = { column = \"t\" }\n[layout.pairs]\n\
    spacing = { column = \"gap\" }\nfollower_speed = { column = \"v\" }\nleader_speed = { column = \"lead\" }\n";

fn speed_mps(car: usize, time_s: f64) -> f64 {
    20.0 + 3.0 * (0.5 * time_s - 0.4 * car as f64).sin()
}

fn gap_m(car: usize, time_s: f64) -> f64 {
    let integral = |car: usize| -6.0 * (0.5 * time_s - 0.4 * car as f64).cos();
    30.0 + integral(car - 1) - integral(car)
}

/// Rows of time, gap and speeds of leader and follower, with gap to the vehicle behind and a value about its speed.
fn rows(seconds: usize, behind: impl Fn(f64) -> [f64; 2]) -> String {
    let rows = (0..10 * seconds).map(|tenth| {
        let time_s = tenth as f64 / 10.0;
        let [gap_behind, speed_behind] = behind(time_s);
        let [lead, own] = [0, 1].map(|car| speed_mps(car, time_s));
        let gap = gap_m(1, time_s);
        format!("{time_s:.1},{gap:.4},{own:.4},{lead:.4},{gap_behind:.4},{speed_behind:.4}\n")
    });
    rows.collect()
}

fn read_with(map: &str, rows: &str) -> Result<Recording, RecordingError> {
    let map = RecordingMap::from_toml(map, Path::new("map.toml")).expect("a map");
    let text = format!("t,gap,v,lead,rear_gap,rear_v\n{rows}");
    read(text.as_bytes(), Path::new("a.csv"), Some(&map))
}

#[test]
fn the_vehicle_behind_is_the_third_of_the_line_and_no_subject() {
    let by_speed =
        "behind = { spacing = { column = \"rear_gap\" }, speed = { column = \"rear_v\" } }\n";
    let by_difference = "behind = { spacing = { column = \"rear_gap\" }, relative_speed = { column = \"rear_v\", \
        sign = \"follower-minus-leader\" } }\n";
    let absolute = rows(60, |time_s| [gap_m(2, time_s), speed_mps(2, time_s)]);
    let relative = rows(60, |time_s| {
        [
            gap_m(2, time_s),
            speed_mps(2, time_s) - speed_mps(1, time_s),
        ]
    });
    for (behind, rows) in [(by_speed, absolute), (by_difference, relative)] {
        let recording = read_with(&format!("{MAP}{behind}"), &rows).expect("readable");
        assert_eq!(recording.dropped, []);
        let drives = find_drives(&recording, LeaderSelection::Any);
        assert_eq!(drives.len(), 1, "the car behind is not under test");
        let last = &drives[0].vehicles[2];
        assert!((last.gap_ahead_m - gap_m(2, 0.0)).abs() < 1e-3, "{last:?}");
        assert!(
            (last.speed_mps - speed_mps(2, 0.0)).abs() < 1e-3,
            "{last:?}"
        );
        let episodes =
            find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes;
        let leads_with_both = |episode: &BrakingEpisode| {
            let numbers: Vec<_> = episode
                .vehicles
                .iter()
                .map(|vehicle| vehicle.number)
                .collect();
            numbers == [1, 2, 3]
        };
        assert!(!episodes.is_empty() && episodes.iter().all(leads_with_both));
    }
}

/// A sensor at the rear that reports distances as negative positions.
#[test]
fn a_column_behind_without_a_possible_value_stops_the_import() {
    let behind =
        "behind = { spacing = { column = \"rear_gap\" }, speed = { column = \"rear_v\" } }\n";
    let read = |sign: fn(f64) -> f64| {
        let rows = rows(60, |time_s| {
            [sign(time_s) * gap_m(2, time_s), speed_mps(2, time_s)]
        });
        read_with(&format!("{MAP}{behind}"), &rows)
    };
    let error = read(|_| -1.0).unwrap_err().to_string();
    assert!(
        error.starts_with("a.csv:2: rear_gap: 600 impossible spacings")
            && error.contains("sign or unit"),
        "{error}"
    );
    // Single impossible values are left out, as in other columns.
    let recording = read(|time_s| if time_s < 2.0 { -1.0 } else { 1.0 }).unwrap();
    assert!(
        recording.dropped[0]
            .to_string()
            .contains("20 impossible spacings")
    );
}

#[test]
fn a_wrong_sign_behind_stops_the_import() {
    let behind = "behind = { spacing = { column = \"rear_gap\" }, relative_speed = { column = \"rear_v\" } }\n";
    let rows = rows(60, |time_s| {
        [
            gap_m(2, time_s),
            speed_mps(2, time_s) - speed_mps(1, time_s),
        ]
    });
    let message = read_with(&format!("{MAP}{behind}"), &rows)
        .expect_err("refused")
        .to_string();
    assert!(
        message.contains("rear_v has the opposite sign"),
        "{message}"
    );
}

#[test]
fn maps_need_one_speed_of_the_vehicle_behind() {
    for (behind, problem) in [
        (
            "{ spacing = { column = \"g\" } }",
            "layout.pairs.behind: needs either speed or relative_speed",
        ),
        (
            "{ spacing = { column = \"g\", from = \"front-to-front\" }, speed = { column = \"s\" } }",
            "layout.pairs.behind: length_m: is needed",
        ),
        (
            "{ spacing = { column = \"gap\" }, speed = { column = \"s\" } }",
            "`gap` is already the column",
        ),
    ] {
        let map = format!("{MAP}behind = {behind}\n");
        let refused = RecordingMap::from_toml(&map, Path::new("map.toml")).expect_err("refused");
        assert!(refused.to_string().contains(problem), "{refused}");
    }
}

/// A guess finds the columns of the vehicle behind, their units and the sign of the difference.
#[test]
fn guesses_recognise_the_vehicle_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.csv");
    for sign in [1.0, -1.0] {
        let rows = rows(60, |time_s| {
            let closing_mps = speed_mps(1, time_s) - speed_mps(2, time_s);
            [gap_m(2, time_s), sign * closing_mps]
        });
        let names = "time,gap_front,v_ego,v_lead,gap_rear,rel_speed_rear";
        std::fs::write(&path, format!("{names}\n{rows}")).unwrap();
        let draft = guess::guess(&path).unwrap().expect("a draft");
        let LayoutSpec::Pairs(pairs) = &draft.map.layout else {
            panic!("{:?}", draft.map)
        };
        let columns = (
            pairs.spacing.column.as_str(),
            pairs
                .behind
                .as_ref()
                .map(|behind| behind.spacing.column.as_str()),
        );
        assert_eq!(columns, ("gap_front", Some("gap_rear")));
        let third = &draft.recording.platoons[0].vehicles[2];
        let read_mps = third.speed_mps[100].expect("known");
        assert!(
            (read_mps - speed_mps(2, 10.0)).abs() < 0.01,
            "{read_mps} {:?}",
            draft.map
        );
    }
    let speeds = rows(60, |time_s| [gap_m(2, time_s), speed_mps(2, time_s)]);
    std::fs::write(
        &path,
        format!("time,distance,speed,lead_speed,distance_back,speed_back\n{speeds}"),
    )
    .unwrap();
    let draft = guess::guess(&path).unwrap().expect("a draft");
    assert!(
        draft.map.to_toml().unwrap().contains("distance_back"),
        "{:?}",
        draft.map
    );
}

/// Beside columns of the vehicle ahead, a follower is the vehicle behind; alone it is the vehicle under test.
#[test]
fn a_guess_reads_columns_of_a_follower_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.csv");
    let speeds = rows(60, |time_s| [gap_m(2, time_s), speed_mps(2, time_s)]);
    for names in [
        "t,dx_lead,v_ego,v_lead,dx_follow,v_follow",
        "time,gap,v,v_lead,gap_follower,v_follower",
        "time,dist_preceding,v_ego,v_preceding,dist_following,v_following",
        "Time,Gap,Speed,LeadSpeed,TailGap,TailSpeed",
        "time,leadgap,egospeed,leadspeed,tailgap,tailspeed",
        "time,range_front,v_ego,v_front,trailing_range,trailing_v",
        "time,gap,v,v_lead,tailgater_distance,tailgater_speed",
        "Zeit,Abstand,v,v_vorne,Abstand_Nachfolger,v_Nachfolger",
    ] {
        std::fs::write(&path, format!("{names}\n{speeds}")).unwrap();
        let draft = guess::guess(&path).unwrap().expect("a draft");
        let LayoutSpec::Pairs(pairs) = &draft.map.layout else {
            panic!("{:?}", draft.map)
        };
        let behind = pairs.behind.as_ref().expect("a vehicle behind");
        let names: Vec<_> = names.split(',').collect();
        assert_eq!(behind.spacing.column, names[4]);
        assert_eq!(behind.speed.as_ref().unwrap().column, names[5]);
        assert_eq!(pairs.follower_speed.as_ref().unwrap().column, names[2]);
        assert!(draft.unread.is_empty(), "{:?}", draft.unread);
    }
    // The gap of the follower to its leader is the only one: the follower is under test.
    let names = "time,gap_follower,v_follower,v_lead,distance_left,note";
    std::fs::write(&path, format!("{names}\n{speeds}")).unwrap();
    let draft = guess::guess(&path).unwrap().expect("a draft");
    let LayoutSpec::Pairs(pairs) = &draft.map.layout else {
        panic!("{:?}", draft.map)
    };
    assert!(pairs.behind.is_none());
    assert_eq!(pairs.follower_speed.as_ref().unwrap().column, "v_follower");
    assert_eq!(draft.unread, ["distance_left"]);
}

/// Wheels have the speed of the own vehicle, whatever else their names have.
#[test]
fn a_guess_reads_no_wheel_as_a_vehicle_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.csv");
    let speeds = rows(60, |time_s| [gap_m(2, time_s), speed_mps(2, time_s)]);
    let pairs = |names: &str| {
        std::fs::write(&path, format!("{names}\n{speeds}")).unwrap();
        let draft = guess::guess(&path).unwrap().expect("a draft");
        match draft.map.layout {
            LayoutSpec::Pairs(pairs) => pairs,
            layout => panic!("{layout:?}"),
        }
    };
    for wheel in [
        "rear wheel speed",
        "wheel_speed_rr",
        "WheelSpeedRear",
        "rearwheelspeed",
        "speed_rl_rear",
    ] {
        let pairs = pairs(&format!("time,gap,v_ego,v_lead,gap_rear,{wheel}"));
        assert!(pairs.behind.is_none(), "{wheel}: {pairs:?}");
    }
    // Without another one, a wheel has the own speed.
    let pairs = pairs("time,gap,rear wheel speed,v_lead,gap_tail,v_tail");
    assert_eq!(pairs.follower_speed.unwrap().column, "rear wheel speed");
    assert_eq!(pairs.behind.unwrap().speed.unwrap().column, "v_tail");
}

/// At constant gaps and equal speeds, no candidate contradicts itself: each choice is the first of its order.
#[test]
fn of_several_consistent_candidates_the_first_is_the_draft() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.csv");
    let names = "time,gap,distance,v,speed,v_lead,v_rel,tail_gap,tail_v,rear_gap,rear_v";
    let row = |tenth: usize| format!("{:.1},30,30,20,20,20,0,30,20,30,20\n", tenth as f64 / 10.0);
    let rows: String = (0..600).map(row).collect();
    std::fs::write(&path, format!("{names}\n{rows}")).unwrap();
    let draft = guess::guess(&path).unwrap().expect("a draft").map;
    let text = "version = 1\nname = \"draft\"\ntime.clock = { column = \"time\" }\n[layout.pairs]\n\
        spacing = { column = \"gap\", unit = \"m\" }\nfollower_speed = { column = \"v\", unit = \"m/s\" }\n\
        leader_speed = { column = \"v_lead\", unit = \"m/s\" }\n\
        relative_speed = { column = \"v_rel\", unit = \"m/s\", sign = \"leader-minus-follower\" }\n\
        [layout.pairs.behind]\nspacing = { column = \"rear_gap\", unit = \"m\" }\n\
        speed = { column = \"rear_v\", unit = \"m/s\" }\n";
    let expected = RecordingMap::from_toml(text, Path::new("map.toml")).unwrap();
    assert_eq!(draft, *expected.spec());
}

/// CAN frames of a front and a rear radar, decoded with a DBC file.
#[cfg(feature = "mdf")]
#[test]
fn frames_of_a_rear_radar_are_read_with_a_dbc_file() {
    use super::mdf::test_file::frames_file;
    let folder = tempfile::tempdir().unwrap();
    let dbc = "VERSION \"\"\nNS_ :\nBS_:\nBU_: A\nBO_ 1 Front: 8 A\n SG_ gap : 0|16@1+ (0.01,0) [0|0] \"m\" A\n \
        SG_ v : 16|16@1+ (0.01,0) [0|0] \"m/s\" A\n SG_ lead : 32|16@1+ (0.01,0) [0|0] \"m/s\" A\n\
        BO_ 2 Rear: 8 A\n SG_ rear_gap : 0|16@1+ (0.01,0) [0|0] \"m\" A\n \
        SG_ rear_v : 16|16@1+ (0.01,0) [0|0] \"m/s\" A\n";
    std::fs::write(folder.path().join("bus.dbc"), dbc).unwrap();
    let map = format!(
        "dbc = \"bus.dbc\"\n{MAP}behind.spacing.column = \"rear_gap\"\nbehind.speed.column = \"rear_v\"\n"
    );
    std::fs::write(folder.path().join("map.toml"), map).unwrap();
    let frame = |id: u32, values: &[f64]| {
        let mut bytes = [0; 8];
        for (at, value) in values.iter().enumerate() {
            let raw = (100.0 * value).round() as u16;
            bytes[2 * at..2 * at + 2].copy_from_slice(&raw.to_le_bytes());
        }
        (1, id, bytes)
    };
    // A frame each 0.1 s, of both radars in turn.
    let frames: Vec<_> = (0..800)
        .map(|index| {
            let time_s = f64::from(index) / 10.0;
            if index % 2 == 0 {
                frame(
                    1,
                    &[gap_m(1, time_s), speed_mps(1, time_s), speed_mps(0, time_s)],
                )
            } else {
                frame(2, &[gap_m(2, time_s), speed_mps(2, time_s)])
            }
        })
        .collect();
    let path = folder.path().join("log.mf4");
    std::fs::write(&path, frames_file(&frames)).unwrap();
    let map = RecordingMap::load(&folder.path().join("map.toml")).unwrap();
    let recording = load(&path, Some(&map)).unwrap();
    let platoon = &recording.platoons[0];
    // Rows have the times of the front radar.
    assert!((platoon.time_s[11] - platoon.time_s[10] - 0.2).abs() < 1e-9);
    let gap_behind_m = platoon.gap_ahead_m(2)[50].expect("known");
    let time_s = platoon.time_s[50];
    assert!(
        (gap_behind_m - gap_m(2, time_s)).abs() < 0.05,
        "{gap_behind_m} {time_s}"
    );
}

/// The unit of a time is no word of a position.
#[test]
fn a_guess_takes_no_time_for_a_position() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tracks.csv");
    let rows: String = (0..40)
        .map(|index| {
            let time_s = f64::from(index) / 10.0;
            let row = |id: u32, start_m: f64| {
                format!("{time_s},{id},1,{},20,4.5\n", start_m + 20.0 * time_s)
            };
            row(1, 50.0) + &row(2, 10.0)
        })
        .collect();
    for time in ["time_s", "time [s]", "t_s"] {
        std::fs::write(&path, format!("{time},id,lane,pos,vel,len\n{rows}")).unwrap();
        let draft = guess::guess(&path).unwrap().expect("a draft");
        let LayoutSpec::Tracks(tracks) = &draft.map.layout else {
            panic!("{:?}", draft.map)
        };
        assert_eq!(tracks.position.column, "pos", "{time}");
    }
}
