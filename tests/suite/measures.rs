//! Five measures of a report, recomputed from an exported trace by an independent implementation.

use std::fs;

use serde_json::Value;

use crate::command_line::{exit_code, run_crumple, temp_folder};

struct TrackSample {
    time_s: f64,
    speed_mps: f64,
    gap_m: Option<f64>,
}

fn parse_tracks(csv: &str) -> Vec<Vec<TrackSample>> {
    let mut tracks: Vec<Vec<TrackSample>> = Vec::new();
    for line in csv.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |index: usize| fields[index].parse::<f64>().ok();
        let vehicle = number(1).expect("an index") as usize;
        if vehicle == tracks.len() {
            tracks.push(Vec::new());
        }
        tracks[vehicle].push(TrackSample {
            time_s: number(0).expect("a time"),
            speed_mps: number(3).expect("a speed"),
            gap_m: number(5),
        });
    }
    tracks
}

#[test]
fn five_measures_of_the_report_follow_from_the_exported_trace() {
    let folder = temp_folder();
    let report = fs::read_to_string(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/reports/assessment.json"
    ))
    .expect("committed");
    let report: Value = serde_json::from_str(&report).expect("JSON");
    for controller in ["acc-aeb", "idm", "policy", "road"] {
        let arguments = format!("simulate paper-1 --controller {controller} --trace trace.csv");
        assert_eq!(exit_code(&run_crumple(folder.path(), &arguments)), 0);
        let tracks =
            parse_tracks(&fs::read_to_string(folder.path().join("trace.csv")).expect("written"));
        let (ahead, own) = (&tracks[0], &tracks[1]);
        let (mut gap_m, mut ttc_s, mut drac_mps2) = (f64::INFINITY, f64::INFINITY, 0.0_f64);
        let (mut tet_s, mut tit_s2) = (0.0, 0.0);
        for (index, sample) in own.iter().enumerate() {
            let gap = sample.gap_m.expect("a vehicle is ahead");
            let closing_mps = sample.speed_mps - ahead[index].speed_mps;
            let step_s = own
                .get(index + 1)
                .map_or(0.0, |next| next.time_s - sample.time_s);
            gap_m = gap_m.min(gap);
            if closing_mps > 0.0 {
                let now_s = gap / closing_mps;
                ttc_s = ttc_s.min(now_s);
                drac_mps2 = drac_mps2.max(closing_mps * closing_mps / (2.0 * gap));
                if now_s < 3.0 {
                    tet_s += step_s;
                    tit_s2 += (3.0 - now_s) * step_s;
                }
            }
        }
        let cases = report["paper_scenarios"]["scenarios"][0]["cases"]
            .as_array()
            .expect("cases");
        let case = cases
            .iter()
            .find(|case| case["controller"] == controller)
            .expect("assessed");
        // Sums over samples differ by the value of one step.
        let close = |name: &str, own: f64, within: f64| {
            let shown = case["ahead"][name].as_f64().expect("a number");
            assert!(
                (shown - own).abs() <= within + 0.005,
                "{controller}: {name}: {shown} in the report, {own} here"
            );
        };
        close("min_gap_m", gap_m, 1e-3);
        close("min_ttc_s", ttc_s, 1e-3);
        close("max_drac_mps2", drac_mps2, 1e-3);
        close("tet_s", tet_s, 0.02);
        close("tit_s2", tit_s2, 0.03);
    }
}
