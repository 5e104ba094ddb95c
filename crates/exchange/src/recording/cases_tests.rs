//! Recordings that earlier releases imported wrongly, without a warning.

use std::path::{Path, PathBuf};

use super::map::RecordingMap;
use super::*;

fn case(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../corpora/recordings/cases").join(file)
}

fn load_case(file: &str, map: &str) -> Result<Recording, RecordingError> {
    load(&case(file), Some(&RecordingMap::load(&case(map)).expect("a map")))
}

/// Returns numbers of the vehicles and gaps ahead in metres, of the episode with most vehicles.
fn longest_line(file: &str, map: &str) -> (Vec<usize>, Vec<f64>) {
    let recording = load_case(file, map).expect("readable");
    let found = find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes;
    let longest = found.iter().max_by_key(|episode| episode.vehicles.len()).expect("an episode");
    let numbers = longest.vehicles.iter().map(|vehicle| vehicle.number).collect();
    (numbers, longest.vehicles.iter().skip(1).map(|vehicle| vehicle.gap_ahead_m).collect())
}

#[test]
fn vehicles_follow_those_ahead_of_them() {
    for (file, map, vehicles, gaps_m) in [
        ("sumo2.csv", "sumo.toml", &[0, 1][..], &[25.0][..]),
        ("h_flick_in.csv", "ngsim.toml", &[1, 2], &[20.0]),
        ("h_queue.csv", "ngsim.toml", &[1, 2, 3], &[24.7, 5.5]),
        ("q_fwd.csv", "highd.toml", &[1, 2, 3], &[24.38, 5.5]),
        ("q_rev.csv", "highd.toml", &[1, 2, 3], &[24.38, 5.5]),
    ] {
        let (found, found_m) = longest_line(file, map);
        assert_eq!(found, vehicles, "{file}: {found_m:?}");
        let errors_m = found_m.iter().zip(gaps_m).map(|(found, right)| (found - right).abs());
        assert!(errors_m.fold(0.0, f64::max) < 0.05, "{file}: {found_m:?}");
    }
}

#[test]
fn columns_that_contradict_each_other_stop_the_import() {
    for (file, map, parts) in [
        ("n_basic.csv", "ng_wrong.toml", ["v_Vel looks like ft/s: ratio 3.28", "13.2 m/s", "43.5 m/s"]),
        ("p_base.csv", "sign.toml", ["relative_speed_mps has the opposite sign", "m/s here", "correct the map"]),
    ] {
        let message = load_case(file, map).expect_err("must be refused").to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

/// Accelerations take part in the consistency check.
#[test]
fn accelerations_that_contradict_the_speeds_stop_the_import() {
    let map = |unit: &str| {
        let acceleration = format!("acceleration = {{ column = \"a\", unit = \"{unit}\" }}");
        let text = format!(
            "version = 1\nname = \"a\"\ntime.clock = {{ column = \"t\" }}\n[layout.pairs]\n\
             spacing = {{ column = \"gap\" }}\nfollower_speed = {{ column = \"v\", {acceleration} }}\n\
             leader_speed = {{ column = \"lead\" }}\n"
        );
        RecordingMap::from_toml(&text, Path::new("a.toml")).expect("a map")
    };
    let read_with = |factor: f64, offset: f64, unit| {
        let mut text = "t,gap,v,lead,a\n".to_owned();
        for tenth in 0..600 {
            let at_s = f64::from(tenth) / 10.0;
            let (speed_mps, acceleration_mps2) = (20.0 + 4.0 * (0.4 * at_s).sin(), 1.6 * (0.4 * at_s).cos());
            text += &format!("{at_s},30,{speed_mps},{speed_mps},{}\n", factor * acceleration_mps2 + offset);
        }
        read(text.as_bytes(), Path::new("a.csv"), Some(&map(unit)))
    };
    for (factor, unit) in [(1.0, "m/s2"), (1.0 / 0.3048, "ft/s2"), (1.0 / 9.806_65, "g")] {
        let recording = read_with(factor, 0.0, unit).expect("readable");
        assert!(recording.dropped.is_empty(), "{:?}", recording.dropped);
    }
    for (factor, unit, reason) in [
        (-1.0, "m/s2", "a has the opposite sign"),
        (1.0 / 9.806_65, "m/s2", "a looks like g: ratio 0.10"),
        (1.0 / 0.3048, "m/s2", "a looks like ft/s2: ratio 3.28"),
    ] {
        let message = read_with(factor, 0.0, unit).expect_err("must be refused").to_string();
        assert!(message.contains(reason) && message.contains("m/s² here"), "{message}");
    }
    let dropped = read_with(1.0, 2.0, "m/s2").expect("readable").dropped;
    assert!(dropped.len() == 1 && dropped[0].to_string().contains("an offset of -2.0 m/s²"), "{dropped:?}");
}
