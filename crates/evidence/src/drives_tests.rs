//! Drives of a folder, with counts and measures that are known beforehand.

use std::path::Path;

use super::drive_report::DriveReport;
use super::drive_search::DriveSearch;
use super::drives::{DriveEnd, DriveSet, DriveSetError};
use crumple_core::observer::Quiet;
use crumple_measure::{CollisionRole, Specification};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::RunOptions;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::to_toml;
use crumple_sim::scenario::{
    Driver, LeadProfile, NoDriverFiles, RecordedMotion, RecordedSpeeds, Scenario, ScenarioSpec,
    VehicleClass, VehicleSpec,
};

const DURATION_S: f64 = 60.0;

/// Repeats the speed 20 m/s, from a time on another one, reached at 1 m/s².
fn speeds(change_s: f64, then_mps: f64) -> Driver {
    let ramp_s = (then_mps - 20.0_f64).abs().max(0.1);
    Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
        time_s: vec![0.0, change_s, change_s + ramp_s, DURATION_S],
        speed_mps: vec![20.0, 20.0, then_mps, then_mps],
    }))
}

/// A drive of a car 30 m behind a leader, as recorded at 20 m/s; `behind` drives a car 30 m behind it.
fn drive(name: &str, leader: Driver, behind: Option<Driver>) -> Scenario {
    let vehicle =
        |position_m, driver| VehicleSpec::new(VehicleClass::Light, position_m, 20.0, driver);
    let mut vehicles = vec![vehicle(64.0, leader), vehicle(32.0, Driver::UnderTest)];
    vehicles.extend(behind.map(|driver| vehicle(0.0, driver)));
    // No two drives have the same recorded motion.
    let mut gap_m = vec![30.0; 600];
    gap_m[599] += 0.001 * (f64::from(name.as_bytes()[0]) - f64::from(b's'));
    vehicles[1].recorded = Some(Box::new(RecordedMotion {
        interval_s: 0.1,
        gap_m,
        speed_mps: vec![20.0; 600],
    }));
    Scenario::new(ScenarioSpec::new(name.to_owned(), DURATION_S, vehicles)).unwrap()
}

fn load(folder: &Path, scenarios: &[Scenario]) -> Result<DriveSet, DriveSetError> {
    for scenario in scenarios {
        let path = folder.join(format!("{}.toml", scenario.spec().name));
        std::fs::write(path, to_toml(scenario).unwrap()).unwrap();
    }
    DriveSet::load(folder, &NoDriverFiles)
}

fn options(controller: &str) -> RunOptions {
    RunOptions::new(BuiltInController::from_name(controller).unwrap())
        .with_estimator(EstimatorKind::Truth)
}

/// The leader slows to 10 m/s. The car behind cannot react, or drives on at 20 m/s, or is a human.
fn drives() -> Vec<Scenario> {
    let slows = || speeds(10.0, 10.0);
    vec![
        drive("a-recorded", slows(), Some(speeds(10.0, 20.0))),
        drive(
            "b-scripted",
            slows(),
            Some(Driver::Profile(LeadProfile::ConstantSpeed)),
        ),
        drive(
            "c-human",
            slows(),
            BuiltInController::from_name("human").map(Driver::Controller),
        ),
        drive("d-alone", slows(), None),
    ]
}

#[test]
fn collisions_count_by_their_cause() {
    let folder = tempfile::tempdir().unwrap();
    let drives = load(folder.path(), &drives()).unwrap();
    let runs = drives.run(&options("idm"), &Quiet).unwrap();
    let roles: Vec<_> = runs
        .iter()
        .map(|run| match &run.end {
            DriveEnd::Collision(role, _) => Some(*role),
            _ => None,
        })
        .collect();
    assert_eq!(
        roles,
        [
            Some(CollisionRole::HitByRecording),
            Some(CollisionRole::HitFromBehind),
            None,
            None
        ]
    );
    let report = DriveReport::new("idm", &runs, &drives);
    assert_eq!(
        (
            report.failures.count,
            report.hit_from_behind,
            report.hit_by_recording,
            report.without_vehicle_behind,
            report.ended_before_unnecessary_braking
        ),
        (1, 1, 1, 1, 2)
    );
    // Hours end with the collision of the run.
    let ends_s: f64 = runs
        .iter()
        .map(|run| match &run.end {
            DriveEnd::Collision(_, collision) => collision.time_s,
            _ => DURATION_S,
        })
        .sum();
    assert!(
        (3600.0 * report.comfort.hours - ends_s).abs() < 1e-6,
        "{report:?}"
    );
    // Garwood's interval of one event.
    let rate = report.failures.per_hour;
    assert!(
        (rate.upper * report.comfort.hours - 5.5716).abs() < 1e-3,
        "{rate:?}"
    );
    assert!(
        (rate.lower * report.comfort.hours - 0.025_318).abs() < 1e-5,
        "{rate:?}"
    );
    let text = report.to_text();
    for part in [
        "4 recorded drives, each once",
        "1 collision from behind with a vehicle that repeats recorded speeds",
        "1 drive without a vehicle behind",
        "recorded cars",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

/// The recorded car holds 20 m/s at 30 m: a time gap of 1.5 s, without jerk.
#[test]
fn recorded_cars_are_measured_beside_the_controller() {
    let folder = tempfile::tempdir().unwrap();
    let steady = drive("steady", speeds(10.0, 20.0), None);
    let drives = load(folder.path(), &[steady]).unwrap();
    let runs = drives.run(&options("idm"), &Quiet).unwrap();
    let report = DriveReport::new("idm", &runs, &drives);
    let recorded = report.recorded;
    assert_eq!((recorded.drives, recorded.hard_braking_drives), (1, 0));
    assert!((recorded.time_gap_s.unwrap() - 1.5).abs() < 1e-9);
    assert!(recorded.rms_jerk_sampled_mps3.unwrap() < 1e-9);
    assert!((recorded.kilometres - 0.02 * 59.9).abs() < 1e-6);
    // idm widens the gap from 30 m to its own: the error is between 0 and that change.
    let gap_m = report.comfort.time_gap_s.unwrap() * 20.0;
    let error_m = report.rms_spacing_error_m.unwrap();
    assert!(
        gap_m > 30.0 && error_m > 0.0 && error_m < 20.0,
        "{gap_m} {error_m}"
    );
}

fn search(drives: &DriveSet, controller: &str, text: &str) -> DriveSearch {
    let specification = DriveSearch::parse_specification(text, drives).unwrap();
    DriveSearch::run(
        drives,
        (controller, options(controller)),
        (text, &specification),
        &Quiet,
    )
    .unwrap()
}

fn failed_drives(search: &DriveSearch) -> Vec<&str> {
    let names = search.failures.iter().map(|failure| failure.name.as_str());
    names.collect()
}

#[test]
fn a_search_lists_the_failures_that_count_against_the_controller() {
    let folder = tempfile::tempdir().unwrap();
    let drives = load(folder.path(), &drives()).unwrap();
    let collisions = search(&drives, "idm", Specification::NO_COLLISION);
    assert_eq!(failed_drives(&collisions), ["b-scripted"]);
    let slow = search(&drives, "idm", "always v1.speed_mps > 15");
    assert_eq!((slow.failures.len(), slow.violations.count), (4, 4));
    let robustness: Vec<_> = slow
        .failures
        .iter()
        .map(|failure| failure.robustness)
        .collect();
    assert!(robustness.is_sorted(), "{robustness:?}");
}

/// The leader slows from 20 to 10 m/s at 5 m/s², with a human behind the vehicle under test, and with no vehicle.
fn hard_drives() -> [Scenario; 2] {
    let hard = || {
        Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
            time_s: vec![0.0, 10.0, 12.0, DURATION_S],
            speed_mps: vec![20.0, 20.0, 10.0, 10.0],
        }))
    };
    let human = BuiltInController::from_name("human").map(Driver::Controller);
    [
        drive("a-human", hard(), human),
        drive("b-alone", hard(), None),
    ]
}

/// `predictive` brakes harder than its leader for the human, and `r157-simple` also without one.
#[test]
fn braking_that_only_the_vehicle_behind_causes_does_not_count_against_the_controller() {
    let folder = tempfile::tempdir().unwrap();
    let drives = load(folder.path(), &hard_drives()).unwrap();
    for (controller, counted, caused_behind) in [("predictive", 0, 1), ("r157-simple", 2, 0)] {
        let runs = drives.run(&options(controller), &Quiet).unwrap();
        let report = DriveReport::new(controller, &runs, &drives);
        let counts = [
            report.comfort.unnecessary_braking.count,
            report.comfort.unnecessary_braking_drives,
            report.caused_by_vehicle_behind.count,
            report.caused_by_vehicle_behind_drives,
        ];
        assert_eq!(counts, [counted, counted, caused_behind, caused_behind]);
        let note = "does not have without the vehicle behind: not counted against the controller";
        assert_eq!(report.to_text().contains(note), caused_behind > 0);
        // A search counts alike, by the rule and by a formula.
        for text in ["no braking without cause", "always v1.accel_mps2 > -5.5"] {
            let search = search(&drives, controller, text);
            assert_eq!(search.counts, report, "{text}");
            let violations = [
                search.violations.count,
                search.violated_only_with_vehicle_behind,
            ];
            assert_eq!(violations, [counted, caused_behind], "{controller} {text}");
        }
    }
}

#[test]
fn a_formula_about_the_vehicle_behind_applies_where_there_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let [human, alone] = hard_drives();
    let both = load(folder.path(), &[human, alone.clone()]).unwrap();
    for text in ["always v2.gap_m > 100", "imposed braking at most 0.1 m/s2"] {
        let behind = search(&both, "idm", text);
        assert_eq!(failed_drives(&behind), ["a-human"], "{text}");
        assert_eq!(behind.not_applicable, 1, "{text}");
        let hours = 1.0 / behind.violations.per_hour.estimate;
        assert!((hours * 3600.0 - DURATION_S).abs() < 0.3, "{hours}");
    }
    let folder = tempfile::tempdir().unwrap();
    let without = load(folder.path(), &[alone]).unwrap();
    let refused = DriveSearch::parse_specification("always v2.gap_m > 1", &without).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "the formula names `v2`, but the drives have only the vehicles `v0` to `v1`; no drive has a vehicle behind the \
         one under test"
    );
}

#[test]
fn a_folder_of_other_scenarios_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let empty = DriveSet::load(folder.path(), &NoDriverFiles).unwrap_err();
    assert!(matches!(empty, DriveSetError::Empty { .. }), "{empty}");
    let two = drive("two", speeds(10.0, 20.0), Some(Driver::UnderTest));
    let refused = load(folder.path(), &[two]).unwrap_err().to_string();
    assert!(
        refused.contains("two.toml: vehicles: 2 vehicles under test"),
        "{refused}"
    );
}

#[test]
fn a_scenario_that_is_no_recorded_drive_is_refused_by_file_and_field() {
    let steady = drive("steady", speeds(10.0, 20.0), None);
    let with_motion = |change: &dyn Fn(&mut RecordedMotion)| {
        let changed = steady.edited(|spec| {
            let mut motion = spec.vehicles[1].recorded.clone().unwrap();
            change(&mut motion);
            spec.vehicles[1].recorded = Some(motion);
        });
        changed.unwrap()
    };
    let scripted = drive("steady", Driver::Profile(LeadProfile::ConstantSpeed), None);
    let longer = steady.edited(|spec| spec.duration_s = 90.0).unwrap();
    let without = steady.edited(|spec| spec.vehicles[1].recorded = None);
    for (scenario, problem) in [
        (
            scripted,
            "vehicles[0].driver: is `constant-speed`, but the leader",
        ),
        (
            longer,
            "vehicles[0].driver.recorded.time_s: lasts 60.0 s, but the drive 90.0 s",
        ),
        (without.unwrap(), "vehicles[1].recorded: is missing"),
        (
            with_motion(&|motion| motion.gap_m[0] = 25.0),
            "vehicles[1].recorded.gap_m[0]: begins with 25 m, but the vehicle starts with 30 m",
        ),
        (
            with_motion(&|motion| motion.speed_mps[0] = 0.0),
            "vehicles[1].recorded.speed_mps[0]: begins with 0 m/s",
        ),
        (
            with_motion(&|motion| motion.interval_s = 0.2),
            "vehicles[1].recorded: lasts 119.8",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let refused = load(folder.path(), &[scenario]).unwrap_err().to_string();
        let expected = format!("steady.toml: {problem}");
        assert!(refused.contains(&expected), "{refused}");
    }
    let folder = tempfile::tempdir().unwrap();
    let copy = steady.edited(|spec| spec.name = "copy".to_owned()).unwrap();
    let refused = load(folder.path(), &[steady, copy])
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("steady.toml: vehicles[1].recorded: is the motion in ")
            && refused.contains("copy.toml, and each drive counts once"),
        "{refused}"
    );
}
