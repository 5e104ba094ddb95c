use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::map::RecordingMap;
use super::parts::{MAX_POINTS, PART_ROWS};
use super::{DroppedItem, ImportOptions, ImportResult, ImportedScenario, import, load_parts};

/// Speeds in m/s of a leader that brakes by 6 m/s each two minutes.
fn leader_mps(at_s: f64) -> f64 {
    let phase = at_s % 120.0;
    25.0 - 3.0 * (phase - 40.0).clamp(0.0, 2.0) + 0.6 * (phase - 60.0).clamp(0.0, 10.0)
}

fn position_m(at_s: f64) -> f64 {
    (0..(at_s * 10.0) as usize)
        .map(|tenth| 0.1 * leader_mps(tenth as f64 / 10.0))
        .sum()
}

/// Returns tracks of two vehicles, one behind the other by 0.8 s, as rows of one second at 10 Hz; in order of time, or
/// vehicle by vehicle.
fn tracks(minutes: usize, by_vehicle: bool) -> String {
    let mut text = "time,id,lane,x,speed\n".to_owned();
    let start_m = position_m(0.8);
    let mut rows = Vec::new();
    for vehicle in 0..2 {
        let mut at_m = if vehicle == 0 { start_m } else { 0.0 };
        for tenth in 0..600 * minutes {
            let at_s = tenth as f64 / 10.0 + if vehicle == 0 { 0.8 } else { 0.0 };
            let next_s = at_s + 0.1;
            rows.push((tenth, vehicle, at_m, leader_mps(at_s)));
            at_m += 0.05 * (leader_mps(at_s) + leader_mps(next_s));
        }
    }
    if !by_vehicle {
        rows.sort_by_key(|(tenth, vehicle, ..)| (*tenth, *vehicle));
    }
    for (tenth, vehicle, at_m, speed_mps) in rows {
        writeln!(
            text,
            "{:.1},{vehicle},1,{at_m:.3},{speed_mps:.4}",
            tenth as f64 / 10.0
        )
        .unwrap();
    }
    text
}

fn pairs(minutes: usize) -> String {
    let mut text =
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n".to_owned();
    let mut gap_m = 30.0;
    for tenth in 0..600 * minutes {
        let at_s = tenth as f64 / 10.0;
        let [lead, own] = [0.8, 0.0].map(|ahead_s| leader_mps(at_s + ahead_s));
        writeln!(
            text,
            "a,{at_s:.1},{gap_m:.3},{own:.4},{:.4},{lead:.4}",
            lead - own
        )
        .unwrap();
        gap_m += 0.1 * (lead - own);
    }
    text
}

fn platoon(minutes: usize) -> String {
    let header = "Date,1\nVehicle_order\nNumber_of_vehicles,2\nACC,1\nDistance_setting,S\n";
    let mut text = format!("{header}Time,Speed1,Speed2,IVS1\n");
    let mut gap_m = 30.0;
    for tenth in 0..600 * minutes {
        let at_s = tenth as f64 / 10.0;
        let [lead, own] = [0.8, 0.0].map(|ahead_s| leader_mps(at_s + ahead_s));
        writeln!(text, "{at_s:.1},{lead:.4},{own:.4},{gap_m:.3}").unwrap();
        gap_m += 0.1 * (lead - own);
    }
    text
}

fn tracks_map() -> RecordingMap {
    let map = "version = 1\nname = \"t\"\ntime.clock = { column = \"time\" }\n[layout.tracks]\nvehicle = \"id\"\n\
        lane = \"lane\"\nposition = { column = \"x\", of = \"front\" }\n\
        speed = { column = \"speed\" }\nlength.metres = 4.5\n";
    RecordingMap::from_toml(map, Path::new("t.toml")).unwrap()
}

fn imported(
    text: &str,
    map: Option<&RecordingMap>,
) -> (usize, Vec<ImportedScenario>, ImportResult) {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join("long.csv");
    std::fs::write(&path, text).unwrap();
    let mut parts = 0;
    load_parts(&path, map, None, &mut |_| {
        parts += 1;
        Ok(true)
    })
    .unwrap();
    let mut scenarios = Vec::new();
    let mut take = |scenario| {
        scenarios.push(scenario);
        true
    };
    let result = import(&[path], map, &ImportOptions::default(), None, &mut take).unwrap();
    (parts, scenarios, result)
}

/// Every braking of a recording of several parts makes one scenario, with the same speeds everywhere.
#[test]
fn reading_in_parts_changes_no_episode() {
    let map = tracks_map();
    // At least two and a half parts.
    let minutes = 5 * PART_ROWS / 1200 / 4 * 4 + 4;
    for (text, map, per_period) in [
        (tracks(minutes / 2, false), Some(&map), 1),
        (tracks(minutes / 2, true), Some(&map), 1),
        (pairs(minutes), None, 1),
        (platoon(minutes), None, 1),
    ] {
        let (parts, scenarios, result) = imported(&text, map);
        let rows = text.lines().count();
        assert!((2..=4).contains(&parts), "{parts} parts of {rows} rows");
        let periods = if text.starts_with("time") {
            minutes / 2
        } else {
            minutes
        } / 2;
        assert_eq!(
            scenarios.len(),
            per_period * periods,
            "{:?}",
            result.dropped
        );
        let duration_s: Vec<f64> = scenarios
            .iter()
            .map(|imported| imported.scenario.spec().duration_s)
            .collect();
        assert!(
            duration_s
                .iter()
                .all(|duration| (duration - duration_s[0]).abs() < 0.2),
            "{duration_s:?}"
        );
        let dropped = result.dropped.iter().map(DroppedItem::to_string);
        let dropped: Vec<_> = dropped
            .filter(|text| !text.contains("no vehicle is recorded behind it"))
            .collect();
        assert!(dropped.is_empty(), "{dropped:?}");
    }
}

/// Rows of a minute exceed a part. Each row of the same vehicle is half a second after the one before.
#[test]
fn memory_is_bounded_for_dense_traffic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dense.csv");
    let parts = |vehicle: &dyn Fn(usize) -> usize, step_s: f64, rows: usize| {
        let mut text = "time,id,lane,x,speed\n".to_owned();
        for row in 0..rows {
            let (at_s, id) = ((row / 500) as f64 * step_s, vehicle(row));
            writeln!(text, "{at_s},{id},{},{:.1},20", row % 500, 20.0 * at_s).unwrap();
        }
        std::fs::write(&path, text).unwrap();
        let mut sizes = Vec::new();
        load_parts(&path, Some(&tracks_map()), None, &mut |part| {
            let samples = part
                .lead_vehicles()
                .into_iter()
                .flat_map(|lead| lead.segments())
                .map(|segment| segment.len());
            sizes.push(samples.sum::<usize>());
            Ok(true)
        })
        .map(|()| sizes)
        .map_err(|error| error.to_string())
    };
    let sizes = parts(&|row| row % 500, 0.5, 8 * PART_ROWS).unwrap();
    assert!(
        sizes.len() > 3
            && sizes
                .iter()
                .all(|&rows| rows > PART_ROWS && rows <= MAX_POINTS),
        "{sizes:?}"
    );
    let refusals = [
        parts(&|row| row % 500, 0.0, MAX_POINTS + PART_ROWS).unwrap_err(),
        parts(&|row| row, 0.5, 3 * PART_ROWS).unwrap_err(),
    ];
    assert!(
        refusals[0].contains("more than 40000 rows at one time"),
        "{refusals:?}"
    );
    assert!(
        refusals[1].contains("dense.csv:40002: more than 40000 vehicles"),
        "{refusals:?}"
    );
}
