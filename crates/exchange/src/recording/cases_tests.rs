//! Recordings that earlier releases imported wrongly, without a warning.

use std::path::{Path, PathBuf};

use super::map::RecordingMap;
use super::*;

fn case(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../corpora/recordings/cases")
        .join(file)
}

fn load_case(file: &str, map: &str) -> Result<Recording, RecordingError> {
    load(
        &case(file),
        Some(&RecordingMap::load(&case(map)).expect("a map")),
    )
}

/// Returns numbers of the vehicles and gaps ahead in metres, of the episode with most vehicles.
fn longest_line(file: &str, map: &str) -> (Vec<usize>, Vec<f64>) {
    let recording = load_case(file, map).expect("readable");
    let episodes = find_episodes(&recording, MinBrake::default(), LeaderSelection::Any).episodes;
    let longest = episodes
        .iter()
        .max_by_key(|episode| episode.vehicles.len())
        .expect("an episode");
    let numbers = longest
        .vehicles
        .iter()
        .map(|vehicle| vehicle.number)
        .collect();
    (
        numbers,
        longest
            .vehicles
            .iter()
            .skip(1)
            .map(|vehicle| vehicle.gap_ahead_m)
            .collect(),
    )
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
        let (numbers, followed_m) = longest_line(file, map);
        assert_eq!(numbers, vehicles, "{file}: {followed_m:?}");
        let errors_m = followed_m
            .iter()
            .zip(gaps_m)
            .map(|(gap_m, right_m)| (gap_m - right_m).abs());
        assert!(
            errors_m.fold(0.0, f64::max) < 0.05,
            "{file}: {followed_m:?}"
        );
    }
}

#[test]
fn columns_that_contradict_each_other_stop_the_import() {
    for (file, map, parts) in [
        (
            "n_basic.csv",
            "ng_wrong.toml",
            ["v_Vel looks like ft/s: ratio 3.28", "13.2 m/s", "43.5 m/s"],
        ),
        (
            "p_base.csv",
            "sign.toml",
            [
                "relative_speed_mps has the opposite sign",
                "m/s here",
                "correct the map",
            ],
        ),
    ] {
        let message = load_case(file, map)
            .expect_err("must be refused")
            .to_string();
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
            let (speed_mps, acceleration_mps2) =
                (20.0 + 4.0 * (0.4 * at_s).sin(), 1.6 * (0.4 * at_s).cos());
            text += &format!(
                "{at_s},30,{speed_mps},{speed_mps},{}\n",
                factor * acceleration_mps2 + offset
            );
        }
        read(text.as_bytes(), Path::new("a.csv"), Some(&map(unit)))
    };
    for (factor, unit) in [
        (1.0, "m/s2"),
        (1.0 / 0.3048, "ft/s2"),
        (1.0 / 9.806_65, "g"),
    ] {
        let recording = read_with(factor, 0.0, unit).expect("readable");
        assert!(recording.dropped.is_empty(), "{:?}", recording.dropped);
    }
    for (factor, unit, reason) in [
        (-1.0, "m/s2", "a has the opposite sign"),
        (1.0 / 9.806_65, "m/s2", "a looks like g: ratio 0.10"),
        (1.0 / 0.3048, "m/s2", "a looks like ft/s2: ratio 3.28"),
    ] {
        let message = read_with(factor, 0.0, unit)
            .expect_err("must be refused")
            .to_string();
        assert!(
            message.contains(reason) && message.contains("m/s² here"),
            "{message}"
        );
    }
    let dropped = read_with(1.0, 2.0, "m/s2").expect("readable").dropped;
    assert!(
        dropped.len() == 1 && dropped[0].to_string().contains("an offset of -2.0 m/s²"),
        "{dropped:?}"
    );
}

/// Returns a recording of a drive: the gap ahead with noise, the gap behind, and both closing speeds.
fn two_gaps(noise_m: f64, resolution_m: f64) -> String {
    let (mut text, mut gaps_m) = (
        "t,front,rear,front_closing,rear_closing,v\n".to_owned(),
        [40.0, 25.0],
    );
    let mut random = 1_u64;
    for tenth in 0..1200 {
        let at_s = f64::from(tenth) / 10.0;
        let speeds = |at_s: f64| [(0.6 * at_s).sin(), 1.2 * (0.37 * at_s + 1.0).cos()];
        let rates_mps = speeds(at_s);
        // A sum of uniform numbers is nearly normal.
        let mut noise = || {
            let mut uniform = || {
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (random >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            };
            noise_m * (0..12).map(|_| uniform()).sum::<f64>()
        };
        let shown = gaps_m.map(|gap_m| ((gap_m + noise()) / resolution_m).round() * resolution_m);
        text += &format!(
            "{at_s},{},{},{},{},20\n",
            shown[0], shown[1], rates_mps[0], rates_mps[1]
        );
        let next_mps = speeds(at_s + 0.1);
        for (gap_m, (rate_mps, next_mps)) in
            gaps_m.iter_mut().zip(rates_mps.into_iter().zip(next_mps))
        {
            *gap_m += 0.05 * (rate_mps + next_mps);
        }
    }
    text
}

fn contradictions(text: &str, gap: &str, closing: &str) -> Vec<String> {
    let map = format!(
        "version = 1\nname = \"a\"\ntime.clock = {{ column = \"t\" }}\n[layout.pairs]\n\
         spacing = {{ column = \"{gap}\" }}\nfollower_speed = {{ column = \"v\" }}\n\
         relative_speed = {{ column = \"{closing}\" }}\n"
    );
    let map = RecordingMap::from_toml(&map, Path::new("a.toml")).expect("a map");
    let recording = read(text.as_bytes(), Path::new("a.csv"), Some(&map)).expect("readable");
    let dropped = recording
        .dropped
        .iter()
        .filter(|item| matches!(item.omission, Omission::ColumnsContradict(_)));
    dropped.map(ToString::to_string).collect()
}

/// The rear gap with the closing speed ahead is wrong by about 1 m/s; noise of a gap is no contradiction.
#[test]
fn columns_of_different_vehicles_are_reported_and_noise_is_not() {
    for (noise_m, resolution_m) in [
        (0.0, 1e-3),
        (0.1, 1e-3),
        (0.3, 1e-3),
        (0.5, 1e-3),
        (1.0, 1e-3),
        (0.0, 1.0),
        (0.1, 0.5),
    ] {
        let text = two_gaps(noise_m, resolution_m);
        for (gap, closing) in [("front", "front_closing"), ("rear", "rear_closing")] {
            assert_eq!(
                contradictions(&text, gap, closing),
                Vec::<String>::new(),
                "{noise_m} {resolution_m} {gap}"
            );
        }
        for (gap, closing) in [("rear", "front_closing"), ("front", "rear_closing")] {
            let messages = contradictions(&text, gap, closing);
            let expected = format!("the change of {gap} is");
            assert!(
                messages.len() == 1 && messages[0].contains(&expected),
                "{noise_m} {resolution_m} {gap}: {messages:?}"
            );
            assert!(
                messages[0].ends_with("no other unit or sign explains this"),
                "{messages:?}"
            );
        }
    }
}

/// Returns a recording of pairs whose gap changes by `ratio` times the closing speed and an offset; the gap has noise.
fn drive(
    [offset_mps, ratio, amplitude_mps]: [f64; 3],
    noise_m: f64,
    seconds: u32,
    seed: u64,
) -> String {
    let (mut text, mut gap_m) = ("t,gap,closing,v\n".to_owned(), 400.0);
    let mut random = seed;
    let mut uniform = || {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (random >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let closing_mps = |at_s: f64| amplitude_mps * (0.5 * at_s).sin();
    for tenth in 0..=10 * seconds {
        let at_s = f64::from(tenth) / 10.0;
        let noise_m = noise_m * (0..12).map(|_| uniform()).sum::<f64>();
        text += &format!("{at_s},{},{},20\n", gap_m + noise_m, closing_mps(at_s));
        let mean_mps = 0.5 * (closing_mps(at_s) + closing_mps(at_s + 0.1));
        gap_m += 0.1 * (ratio * mean_mps + offset_mps);
    }
    text
}

/// Gaps that change by 0.5 to 0.6 m/s more or less than the closing speed, which may be 0.
#[test]
fn contradictions_from_half_a_metre_per_second_on_are_reported_with_their_reason() {
    for offset_mps in [-0.6, -0.5, 0.5, 0.55, 0.6] {
        for (amplitude_mps, noise_m) in [(0.0, 0.0), (0.0, 0.05), (0.4, 0.2), (2.0, 0.05)] {
            let text = drive([offset_mps, 1.0, amplitude_mps], noise_m, 60, 7);
            let messages = contradictions(&text, "gap", "closing");
            assert!(
                messages.len() == 1 && messages[0].contains("the change of gap is"),
                "{offset_mps} {amplitude_mps} {noise_m}: {messages:?}"
            );
        }
        let messages = contradictions(&drive([offset_mps, 1.0, 0.4], 0.0, 60, 7), "gap", "closing");
        let reason = format!(
            "an offset of {} m/s",
            crumple_core::digits::format_fixed(offset_mps, 1)
        );
        assert!(messages[0].contains(&reason), "{messages:?}");
    }
    // The same between columns that are constant: the gap, and the closing speed.
    let mut constant = "t,gap,closing,v\n".to_owned();
    (0..600).for_each(|tenth| constant += &format!("{},40,0.55,20\n", f64::from(tenth) / 10.0));
    let messages = contradictions(&constant, "gap", "closing");
    assert!(
        messages.len() == 1 && messages[0].contains("gap is 0.0 m/s here, but closing is 0."),
        "{messages:?}"
    );
    for offset_mps in [-0.2, 0.0, 0.2] {
        for noise_m in [0.0, 0.05, 0.2, 0.5, 1.0] {
            let text = drive([offset_mps, 1.0, 2.0], noise_m, 60, 7);
            assert_eq!(
                contradictions(&text, "gap", "closing"),
                Vec::<String>::new(),
                "{offset_mps} {noise_m}"
            );
        }
    }
}

/// Speeds that are 1.10 times too small differ from the positions by a ratio, which an offset explains less.
#[test]
fn a_ratio_is_named_where_it_leaves_less_than_an_offset() {
    let map = "version = 1\nname = \"a\"\ntime.clock = { column = \"t\" }\n[layout.tracks]\nvehicle = \"id\"\n\
               position = { column = \"x\", of = \"front\" }\nspeed = { column = \"v\" }\nlength.metres = 5.0\n";
    let map = RecordingMap::from_toml(map, Path::new("a.toml")).expect("a map");
    let dropped = |speed: &dyn Fn(f64) -> f64, ratio: f64, offset_mps: f64| {
        let (mut text, mut position_m) = ("t,id,x,v\n".to_owned(), 0.0);
        for tenth in 0..600 {
            let at_s = f64::from(tenth) / 10.0;
            let shown_mps = speed(at_s) / ratio - offset_mps;
            text += &format!("{at_s},1,{position_m},{shown_mps}\n");
            position_m += 0.05 * (speed(at_s) + speed(at_s + 0.1));
        }
        let recording = read(text.as_bytes(), Path::new("a.csv"), Some(&map)).expect("readable");
        let all: Vec<_> = recording.dropped.iter().map(ToString::to_string).collect();
        all.join("; ")
    };
    let nearly_constant = |at_s: f64| 8.8 + 0.4 * (0.3 * at_s).sin();
    let note = dropped(&nearly_constant, 1.1, 0.0);
    assert!(
        note.ends_with(": this looks like a ratio of 1.10"),
        "{note}"
    );
    let note = dropped(&nearly_constant, 1.0, 0.8);
    assert!(
        note.ends_with(": this looks like an offset of 0.8 m/s"),
        "{note}"
    );
    // At a constant speed, both leave nothing. A ratio of speeds that vary leaves no offset.
    let note = dropped(&|_| 8.8, 1.1, 0.0);
    assert!(
        note.ends_with(": this looks like an offset of 0.8 m/s, or a ratio of 1.10"),
        "{note}"
    );
    let note = dropped(&|at_s| 12.0 + 8.0 * (0.3 * at_s).sin(), 1.1, 0.0);
    assert!(
        note.ends_with(": this looks like a ratio of 1.10"),
        "{note}"
    );
    let note = dropped(&|at_s| 12.0 + 8.0 * (0.3 * at_s).sin(), 1.04, 0.0);
    assert!(
        note.ends_with(": this looks like a ratio of 1.04"),
        "{note}"
    );
}
