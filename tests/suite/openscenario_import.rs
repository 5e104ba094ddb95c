//! Import of OpenSCENARIO: round trips of exports, and damaged files.

use std::fs;

use crumple_exchange::openscenario::export::{OpenScenario, export_actions, export_trajectories};
use crumple_exchange::openscenario::{OpenScenarioSource, known_constructs};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{AfterCollision, RunOptions, Trace};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, Scenario, built_in_scenario, built_in_scenario_names};
use proptest::prelude::*;
use tempfile::TempDir;

use crate::generate::{any_scenario, simulate_traced, with_cases, without_noise};

/// Tolerance: 1 cm; of speeds 1 cm/s. Trajectories determine only mean speeds between vertices: 3 cm/s in the built-in
/// scenarios, whose round positions are read as if rounded to 1 mm, and 10 cm/s in random ones, whose controllers may
/// change the acceleration in each step.
const TOLERANCE: f64 = 0.01;
const BUILT_IN_TRAJECTORY_MPS: f64 = 0.03;
const RANDOM_TRAJECTORY_MPS: f64 = 0.1;

fn import(exported: &OpenScenario) -> Result<Scenario, String> {
    let folder = TempDir::new().expect("created");
    let path = folder.path().join("imported.xosc");
    fs::write(&path, &exported.scenario).expect("written");
    fs::write(folder.path().join("road.xodr"), &exported.road).expect("written");
    let imported = OpenScenarioSource::load(&path).and_then(|source| source.scenario(None, &[]));
    imported
        .map(|imported| imported.scenario)
        .map_err(|error| error.to_string())
}

fn drive(scenario: &Scenario) -> Trace {
    let options = RunOptions::new(BuiltInController::from_name("baseline").expect("built in"));
    let options = options
        .with_estimator(EstimatorKind::Truth)
        .with_after_collision(AfterCollision::Stop);
    simulate_traced(scenario, &options).trace.expect("traced")
}

/// Compares motions until the first of them ends.
fn assert_same_motion(trace: &Trace, again: &Trace, tolerance_mps: f64) {
    for (index, (track, other)) in trace.vehicles.iter().zip(&again.vehicles).enumerate() {
        // A collision ends the last step early.
        let steps = trace.time_s.len().min(again.time_s.len()) - 1;
        for k in 0..steps {
            let off_m = (track.position_m[k] - other.position_m[k]).abs();
            let off_mps = (track.speed_mps[k] - other.speed_mps[k]).abs();
            let time_s = trace.time_s[k];
            assert!(
                off_m <= TOLERANCE && off_mps <= tolerance_mps,
                "vehicle {index} at {time_s} s: {off_m} m, {off_mps} m/s"
            );
        }
    }
    assert_eq!(trace.vehicles.len(), again.vehicles.len());
}

/// Returns the scenario without what OpenSCENARIO cannot represent: noise, other steps and step-long durations. A
/// human driver is the average one, because its random numbers depend on the seed, which is not exported.
fn representable(scenario: &Scenario) -> Option<Scenario> {
    let edited = without_noise(scenario).edited(|spec| {
        spec.duration_s = (spec.duration_s * 100.0).ceil().min(2000.0) / 100.0;
        spec.step_s = 0.01;
    });
    edited.ok()
}

/// Compares two files. Numbers may differ in the ninth decimal: braking is a product of numbers with nine decimals.
fn assert_same_file(file: &[u8], again: &[u8]) {
    let [file, again] = [file, again].map(String::from_utf8_lossy);
    assert_eq!(file.split('"').count(), again.split('"').count());
    for (value, other) in file.split('"').zip(again.split('"')) {
        let is_near =
            || Some((value.parse::<f64>().ok()? - other.parse::<f64>().ok()?).abs() <= 1e-8);
        assert!(
            value == other || is_near() == Some(true),
            "{value} instead of {other} in {again}"
        );
    }
}

fn assert_actions_survive(scenario: &Scenario) {
    let exported = export_actions(scenario, "road.xodr").expect("exports");
    let imported = import(&exported).expect("imports");
    let again = export_actions(&imported, "road.xodr").expect("exports again");
    assert_same_file(&exported.scenario, &again.scenario);
    assert_same_file(&exported.road, &again.road);
    assert_same_motion(&drive(scenario), &drive(&imported), TOLERANCE);
}

fn assert_trajectories_survive(scenario: &Scenario, tolerance_mps: f64) {
    let trace = drive(scenario);
    let exported = export_trajectories(scenario, &trace, None, "road.xodr").expect("exports");
    let imported = import(&exported).expect("imports");
    assert!(
        imported
            .vehicles()
            .iter()
            .all(|vehicle| matches!(vehicle.driver, Driver::Profile(_)))
    );
    assert_same_motion(&trace, &drive(&imported), tolerance_mps);
}

/// The page lists each action and condition that the import knows, with its clause.
#[test]
fn the_page_lists_each_construct_with_its_clause() {
    let page = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/exchange.md"))
        .expect("a page");
    for construct in known_constructs() {
        let row = format!("| `{}` | {} | ", construct.element, construct.clause);
        let line = page.lines().find_map(|line| line.strip_prefix(&*row));
        let line = line.unwrap_or_else(|| panic!("no row {row}"));
        match construct.reason {
            None => assert_eq!(line, "read |", "{row}"),
            Some(reason) => assert!(line.ends_with(&format!("{reason} |")), "{row}"),
        }
    }
}

#[test]
fn built_in_scenarios_survive_export_and_import() {
    for (name, _) in built_in_scenario_names() {
        let scenario = representable(&built_in_scenario(name).expect("built in")).expect("valid");
        assert_actions_survive(&scenario);
        assert_trajectories_survive(&scenario, BUILT_IN_TRAJECTORY_MPS);
    }
}

proptest! {
    #![proptest_config(with_cases(200))]

    #[test]
    fn random_scenarios_survive_export_and_import(scenario in any_scenario()) {
        let Some(scenario) = representable(&scenario) else { return Err(TestCaseError::reject("a longer step")) };
        assert_actions_survive(&scenario);
        assert_trajectories_survive(&scenario, RANDOM_TRAJECTORY_MPS);
    }
}
