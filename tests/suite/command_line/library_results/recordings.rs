//! Imported recordings and OpenSCENARIO files, exports, and results about recorded drives.

use crumple_controllers::Controllers;
use crumple_evidence::drives::DriveSet;
use crumple_evidence::fit::{EpisodeCollector, ExtractionConfig, FitOptions, FitReport, fit};
use crumple_evidence::{
    CERTIFICATE_FILE, CountReport, DriveOfRecording, DriveReport, RateConfig, RatePlan,
    ReplayReport,
};
use crumple_exchange::openscenario::export::{
    ExportReport, ExportedController, ExportedScenario, export_actions, export_trajectories,
};
use crumple_exchange::openscenario::{OpenScenarioReport, OpenScenarioSource};
use crumple_exchange::recording::guess::guess;
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::replay::replay;
use crumple_exchange::recording::{
    FollowerDriver, ImportOptions, ImportReport, ImportScope, LeaderSelection, MinBrake,
    RecordingSummary, import, load, load_first_part, preview,
};
use crumple_sim::engine::{RecordingLevel, Run, simulate};

use super::*;
use crate::command_line::drives::platoon_csv;
use crate::command_line::exchange::logged_pair_csv;
use crate::command_line::fit::events_csv;

/// Imports a recording with the library, without writing files, and with the program.
fn compare_import(recording: &Path, scope: ImportScope, option: &str) {
    let folder = temp_folder();
    let out = folder.path().join("scenarios");
    let options = ImportOptions {
        min_brake: MinBrake::default(),
        leaders: LeaderSelection::Any,
        follower: FollowerDriver::from_name("human").unwrap(),
        scope,
    };
    let mut names = Vec::new();
    let imported = import(
        &[recording.to_owned()],
        None,
        &options,
        None,
        &mut |scenario| {
            names.push(scenario.file_name);
            true
        },
    )
    .unwrap();
    assert!(!names.is_empty());
    let report = ImportReport::new(&imported, &out, &names);
    assert_same(
        folder.path(),
        &format!("import {} {option} --out {}", quote(recording), quote(&out)),
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn imported_episodes_and_drives() {
    let platoon = corpus("recordings/synthetic-platoon.csv");
    compare_import(&platoon, ImportScope::Episodes, "");
    let folder = temp_folder();
    let platoon = folder.path().join("platoon.csv");
    fs::write(&platoon, platoon_csv()).unwrap();
    compare_import(&platoon, ImportScope::WholeDrives, "--whole");
}

#[test]
fn the_interpretation_of_a_recording() {
    let folder = temp_folder();
    let path = folder.path().join("hard.csv");
    fs::write(&path, logged_pair_csv(3.0)).unwrap();
    let map_path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/maps/logged-pair.toml");
    let map = RecordingMap::load(&map_path).unwrap();
    let recording = load_first_part(&path, Some(&map)).unwrap();
    let name = path.display().to_string();
    let summary = RecordingSummary::new(&name, &recording, &preview(&recording).unwrap());
    assert_same(
        folder.path(),
        &format!(
            "import {} --map {} --preview p.svg",
            quote(&path),
            quote(&map_path)
        ),
        &LibraryResult::new(&summary, summary.to_text()),
    );
}

#[test]
fn a_drafted_map() {
    let folder = temp_folder();
    let path = folder.path().join("platoon.csv");
    fs::write(&path, platoon_csv()).unwrap();
    let map = guess(&path).unwrap().expect("a draft").map;
    let text = map.to_toml().unwrap();
    assert_same(
        folder.path(),
        &format!("import {} --guess", quote(&path)),
        &LibraryResult::new(&map, text),
    );
}

/// The files of an export are imported again.
#[test]
fn exported_and_imported_openscenario_files() {
    let folder = temp_folder();
    let out = Path::new("out");
    let scenario = find_scenario("paper-3");
    let paths = [out.join("paper-3.xosc"), out.join("paper-3.xodr")];
    let paths = [paths[0].as_path(), paths[1].as_path()];
    let options = run_options("policy");
    let run = Run::new(&scenario, options).unwrap();
    let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
    let driven = export_trajectories(&scenario, &trace, Some("policy"), "paper-3.xodr").unwrap();
    let controller = ExportedController {
        name: "policy",
        estimator: EstimatorKind::Kalman,
    };
    let actions = export_actions(&scenario, "paper-3.xodr").unwrap();
    let exported = [
        (
            "--controller policy",
            ExportedScenario::new(&scenario, &driven, paths, Some(controller)),
        ),
        (
            "--as actions",
            ExportedScenario::new(&scenario, &actions, paths, None),
        ),
    ];
    for (options, exported) in exported {
        let report = ExportReport {
            scenarios: vec![exported],
        };
        assert_same(
            folder.path(),
            &format!("export paper-3 --to openscenario {options} --out out"),
            &LibraryResult::new(&report, report.to_text()),
        );
    }
    let file = folder.path().join("out/paper-3.xosc");
    let imported = OpenScenarioSource::load(&file)
        .unwrap()
        .scenario(None, &[])
        .unwrap();
    let names = ["paper-3.toml"].into_iter();
    let report = OpenScenarioReport::new(Path::new("in"), names, 0, Vec::new(), imported.notes);
    assert_same(
        folder.path(),
        "import out/paper-3.xosc --out in",
        &LibraryResult::new(&report, report.to_text()),
    );
}

/// A space is fitted to events, and a rate is counted in it: failures per hour and per 1000 km.
#[test]
fn a_fitted_space_and_rates_per_hour() {
    let folder = temp_folder();
    let path = folder.path().join("events.csv");
    fs::write(&path, events_csv(40)).unwrap();
    let extraction = ExtractionConfig {
        vehicles: 2,
        min_brake: MinBrake::default(),
        leaders: LeaderSelection::Any,
    };
    let mut collector = EpisodeCollector::new(extraction).unwrap();
    collector.add(&load(&path, None).unwrap()).unwrap();
    let sample = collector.finish().unwrap();
    let options = FitOptions {
        name: "fitted".to_owned(),
        follower: crumple_sim::control::BuiltInController::from_name("baseline").unwrap(),
        samples: 19,
        seed: 0,
    };
    let fitted = fit(&sample, &options).unwrap();
    let report = FitReport::new(&sample, &fitted);
    assert_same(
        folder.path(),
        &format!("fit {} --samples 19 --out fitted.toml", quote(&path)),
        &LibraryResult::new(&report.to_json().unwrap(), report.to_text()),
    );
    let space =
        crumple_spaces::file::load(&folder.path().join("fitted.toml"), &Controllers::default())
            .unwrap();
    let plan = RatePlan::new(RateConfig {
        confidence: 0.9,
        ..RateConfig::new(find_controller("idm"), space, 100)
    })
    .unwrap()
    .with_resampling(0, 500);
    let counted = run_study(&plan);
    let exposure = plan.rate_per_exposure(&counted.tally, &Quiet).unwrap();
    assert!(exposure.is_some());
    let out = PathBuf::from("count");
    let certificate = out.join(CERTIFICATE_FILE);
    let report = CountReport::new(&plan, &counted, out, certificate).with_exposure(exposure);
    assert_same_study(
        folder.path(),
        0,
        "verify rate --controller idm --space fitted.toml --runs 100 --confidence 0.9 --resamples 0 --out count",
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn commands_on_recorded_drives() {
    let folder = temp_folder();
    let path = corpus("recordings/synthetic-platoon.csv");
    let options = run_options("acc-aeb").with_estimator(EstimatorKind::Truth);
    let min_brake_mps2 = MinBrake::default().mps2();
    let recording = load(&path, None).unwrap();
    let drives: Vec<_> = replay(&recording, &options, min_brake_mps2, &|_, _| {})
        .unwrap()
        .into_iter()
        .map(|drive| DriveOfRecording {
            recording: path.display().to_string(),
            drive,
        })
        .collect();
    let report = ReplayReport::new("acc-aeb", min_brake_mps2, &drives);
    assert_same(
        folder.path(),
        &format!("replay {} --controller acc-aeb", quote(&path)),
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn rates_on_recorded_drives() {
    let folder = temp_folder();
    fs::write(folder.path().join("platoon.csv"), platoon_csv()).unwrap();
    run_ok(folder.path(), "import platoon.csv --whole --out drives");
    let path = folder.path().join("drives");
    let drives = DriveSet::load(&path, &Controllers::default()).unwrap();
    let runs = drives.run(&run_options("idm"), &Quiet).unwrap();
    let report = DriveReport::new("idm", &runs, &drives);
    assert_same(
        folder.path(),
        &format!("verify rate --controller idm --drives {}", quote(&path)),
        &LibraryResult::new(&report, report.to_text()),
    );
}
