//! Tests with synthetic recordings.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use super::controller_toml;
use super::drives::{self, DistanceSetting, Half};
use super::fit::{FAMILIES, FIT_STEP_S, FollowingModel};
use crumple_core::digest::sha256;
use crumple_sim::control::BuiltInController;

/// Speed of the leader of a synthetic recording, in m/s.
fn leader_mps(time_s: f64) -> f64 {
    15.0 + 4.0 * (0.2 * time_s).sin()
}

/// Acceleration of the published model with its usual parameters, written again.
fn idm_mps2(speed_mps: f64, gap_m: f64, ahead_mps: f64, time_gap_s: f64) -> f64 {
    let braking_m = speed_mps * (speed_mps - ahead_mps) / (2.0 * (1.4_f64 * 2.0).sqrt());
    let wanted_m = 3.0 + (speed_mps * time_gap_s + braking_m).max(0.0);
    1.4 * (1.0 - (speed_mps / 30.0).powi(4) - (wanted_m / gap_m).powi(2))
}

/// Writes a recording of a car with that model, whose samples have a hole of a second after 60 s of 140 s.
fn write_recording(file: &Path, setting: &str, time_gap_s: f64) -> String {
    let mut text = format!(
        "Date,1,1,2020\nVehicle_order,LEADER,CAR_1\nNumber_of_vehicles,2\nACC,1\nDistance_setting,{setting}\n\
         Time,Speed1,Speed2,IVS1\n"
    );
    let (mut speed_mps, mut gap_m) = (14.0, 24.0);
    for step in 0..1400 {
        let time_s = f64::from(step) / 10.0;
        let ahead_mps = leader_mps(time_s);
        if !(600..610).contains(&step) {
            writeln!(text, "{time_s:.1},{ahead_mps:.6},{speed_mps:.6},{gap_m:.6}").unwrap();
        }
        let next_mps = speed_mps + 0.1 * idm_mps2(speed_mps, gap_m, ahead_mps, time_gap_s);
        gap_m += 0.05 * (ahead_mps + leader_mps(time_s + 0.1) - speed_mps - next_mps);
        speed_mps = next_mps;
    }
    fs::write(file, &text).unwrap();
    sha256(text)
}

fn write_recordings(folder: &Path) -> String {
    let files = [
        ("a", "S", 1.2),
        ("b", "S", 1.2),
        ("c", "L", 2.2),
        ("d", "SL", 1.2),
    ];
    let lines = files.map(|(name, setting, time_gap_s)| {
        let digest = write_recording(&folder.join(format!("{name}.csv")), setting, time_gap_s);
        format!("{digest}  some folder/{name}.csv\n")
    });
    lines.concat() + "00  other/missing.csv\n"
}

#[test]
fn drives_have_no_holes_and_belong_to_the_half_of_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let read = drives::read(folder.path(), &write_recordings(folder.path())).unwrap();
    assert_eq!(read.missing, ["missing.csv"]);
    let halves: Vec<_> = read.drives.iter().map(|drive| drive.source.half).collect();
    let [fit, held_out] = [Half::Fit, Half::HeldOut];
    assert_eq!(halves, [fit, fit, held_out, held_out, fit, fit]);
    for drive in &read.drives {
        let duration_s = drive.time_s.last().unwrap();
        assert!((59.0..81.0).contains(duration_s), "{duration_s}");
        assert_eq!(drive.gap_m.len(), drive.time_s.len());
        assert!(drive.follows() && drive.source.car == "CAR_1");
    }
}

#[test]
fn a_recording_that_differs_from_the_list_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let list = write_recordings(folder.path());
    fs::write(folder.path().join("b.csv"), "Date").unwrap();
    let error = drives::read(folder.path(), &list)
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.ends_with("b.csv differs from the file of the list"),
        "{error}"
    );
}

/// The closed loop agrees with an independent implementation of the model, and the search finds settings like its own.
#[test]
fn the_fit_of_a_known_car_has_almost_no_error() {
    let folder = tempfile::tempdir().unwrap();
    let read = drives::read(folder.path(), &write_recordings(folder.path())).unwrap();
    let all: Vec<_> = read.drives.iter().collect();
    let shared =
        "idm,desired_speed_mps=30,standstill_gap_m=3,accel_mps2=1.4,comfortable_brake_mps2=2";
    let short = FollowingModel::from_arg(&format!("{shared},time_headway_s=1.2")).unwrap();
    let mut short_drives = all.clone();
    short_drives.retain(|drive| drive.source.setting == DistanceSetting::Short);
    let error_m = short.error(&short_drives, FIT_STEP_S).unwrap().rms_m();
    assert!(error_m < 0.01, "{error_m}");
    let mut fit = all.clone();
    fit.retain(|drive| drive.source.half == Half::Fit);
    let model = FAMILIES[0].fit(&fit).unwrap();
    let error = model.error(&all, FIT_STEP_S).unwrap();
    let defaults = FollowingModel::from_arg("idm")
        .unwrap()
        .error(&all, FIT_STEP_S)
        .unwrap();
    assert!(
        error.rms_m() < 0.05 * defaults.rms_m(),
        "{error:?} {defaults:?}"
    );
    assert_eq!(error.collisions, 0);
}

/// The published files have the settings of the models `cruise:...`, and the experiment writes them again.
#[test]
fn a_controller_file_has_all_fitted_settings() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/controllers/openacc");
    let mut files = 0;
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap();
        let model = BuiltInController::from_preset(&format!("cruise:{stem}")).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let (comment, settings) = text.split_at(text.find("version = 1").unwrap());
        assert!(comment.starts_with('#'), "{stem}");
        assert_eq!(settings, controller_toml(&model), "{stem}");
        files += 1;
    }
    assert_eq!(files, 20);
}
