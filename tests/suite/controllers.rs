//! Properties of every built-in controller for any observation.

use std::fs;
use std::path::{Path, PathBuf};

use crumple_controllers::{Controllers, find_for_user};
use crumple_measure::ttc_s;
use crumple_sim::control::{
    AebSettings, Baseline, BuiltIn, BuiltInController, CRUISE_PRESETS, Controller,
    ControllerSource, Ego, Role,
};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, SimulationResult, simulate};
use crumple_sim::observation::{Neighbour, Observation};
use crumple_sim::scenario::file;
use proptest::prelude::*;

use crate::generate::{any_controller, with_cases};

prop_compose! {
    fn any_ego()(max_brake_mps2 in 0.1..30.0_f64, max_accel_mps2 in 0.0..30.0_f64, length_m in 0.1..100.0_f64,
                 step_s in 1e-4..1.0_f64) -> Ego {
        Ego { vehicle: 1, max_brake_mps2, max_accel_mps2, length_m, step_s }
    }
}

/// Any observation, including diverged estimates such as negative gaps and impossible accelerations.
fn any_observation() -> impl Strategy<Value = Observation> {
    let neighbour = || {
        let seen = (-10.0..500.0_f64, 0.0..110.0_f64, -100.0..100.0_f64).prop_map(
            |(gap_m, speed_mps, acceleration_mps2)| Neighbour {
                gap_m,
                speed_mps,
                acceleration_mps2,
            },
        );
        prop::option::weighted(0.9, seen)
    };
    (0.0..110.0_f64, -100.0..100.0_f64, neighbour(), neighbour()).prop_map(
        |(speed_mps, acceleration_mps2, ahead, behind)| Observation {
            speed_mps,
            acceleration_mps2,
            ahead,
            behind,
        },
    )
}

proptest! {
    #![proptest_config(with_cases(1024))]

    #[test]
    fn commands_are_finite(
        spec in any_controller(),
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..20),
    ) {
        let mut controller = spec.start(&ego, 0).unwrap();
        for seen in &seen {
            let command = controller.decide(seen).unwrap();
            prop_assert!(command.is_finite(), "{} commands {command} for {seen:?}", spec.name());
        }
    }

    /// The baseline has two commands, and brakes from the first time to collision below its threshold on.
    #[test]
    fn the_baseline_brakes_from_the_first_ttc_below_its_threshold(
        threshold_s in 0.0..4.0_f64,
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..30),
    ) {
        let mut baseline = Baseline::start(&AebSettings { ttc_s: threshold_s }, &ego, 0);
        let mut braking = false;
        for seen in seen.iter().filter(|seen| seen.ahead.is_none_or(|ahead| ahead.gap_m > 0.0)) {
            let closing_s = seen.ahead.and_then(|ahead| ttc_s(ahead.gap_m, seen.speed_mps - ahead.speed_mps));
            braking |= closing_s.is_some_and(|closing_s| closing_s < threshold_s);
            prop_assert_eq!(baseline.decide(seen), Ok(if braking { -ego.max_brake_mps2 } else { 0.0 }));
        }
    }

    /// Controllers that do not observe the follower.
    #[test]
    fn built_in_controllers_look_ahead_only(
        spec in any_controller()
            .prop_filter("looks behind", |spec| !spec.observes_follower()),
        ego in any_ego(),
        seen in prop::collection::vec(any_observation(), 1..10),
    ) {
        let [mut looking, mut blind] = [0; 2].map(|_| spec.start(&ego, 0).unwrap());
        for seen in seen {
            prop_assert_eq!(looking.decide(&seen), blind.decide(&Observation { behind: None, ..seen }));
        }
    }
}

/// A new rule-based controller is generated too, with its settings.
#[test]
fn every_rule_is_generated() {
    for rule in BuiltInController::all()
        .into_iter()
        .filter(|spec| spec.role() <= Role::Reference)
    {
        assert!(
            crumple_testing::generator::CONTROLLERS.contains(&rule),
            "{}",
            rule.name()
        );
    }
}

proptest! {
    #![proptest_config(with_cases(64))]

    /// A controller file with settings is the built-in controller with these settings.
    #[test]
    fn a_controller_file_of_settings_is_the_built_in_controller(controller in any_controller()) {
        let argument = controller.to_arg();
        let mut settings = argument.split(',').map(|setting| setting.replacen('=', " = ", 1));
        let name = settings.next().unwrap_or_default();
        let lines: Vec<_> = settings.collect();
        let folder = tempfile::tempdir().expect("a temporary folder");
        let text = format!("version = 1\nbuilt_in = \"{name}\"\n[settings]\n{}\n", lines.join("\n"));
        fs::write(folder.path().join("a.toml"), text).expect("a new file");
        let opened = find_for_user("a.toml", folder.path()).expect("a valid file");
        prop_assert_eq!(opened.source.downcast_ref::<BuiltInController>(), Some(&controller));
        prop_assert_eq!(opened.disambiguating_hash(), controller.identity());
    }
}

#[test]
fn invalid_settings_of_a_controller_file_name_file_line_and_field() {
    let folder = tempfile::tempdir().unwrap();
    for (text, expected) in [
        (
            "built_in = \"none\"",
            ":2: built_in: there is no built-in controller `none`",
        ),
        (
            "built_in = \"idm,accel_mps2=1\"",
            ":2: built_in: there is no built-in controller",
        ),
        (
            "built_in = \"idm\"\n[settings]\nspeed = 1.0",
            ":4: settings.speed: `speed=1` is not a setting of idm",
        ),
        (
            "built_in = \"idm\"\n[settings]\naccel_mps2 = -1",
            ":4: settings.accel_mps2: idm: accel_mps2 must be a number from 0.01 to 30",
        ),
        (
            "built_in = \"idm\"\nnetwork = \"a.onnx\"",
            ":3: network: `built_in` is given already",
        ),
        (
            "built_in = \"idm\"\ndecision_interval_s = 0.1",
            ":3: decision_interval_s: is not for a built-in controller",
        ),
        (
            "command = [\"true\"]\n[settings]\na = 1",
            ":3: settings: is not for a command",
        ),
    ] {
        fs::write(
            folder.path().join("a.toml"),
            format!("version = 1\n{text}\n"),
        )
        .unwrap();
        let error = find_for_user("a.toml", folder.path())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(&format!("a.toml{expected}")),
            "{text}: {error}"
        );
    }
}

/// Returns the fitted controllers of production cars.
fn fitted_cars() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/controllers/openacc");
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// The models `cruise:...` have the settings of the files.
#[test]
fn a_fitted_car_is_a_model_of_the_same_name() {
    let files = fitted_cars();
    assert_eq!(files.len(), CRUISE_PRESETS.len());
    for path in files {
        let stem = path.file_stem().unwrap().to_str().unwrap();
        let model = find_for_user(&format!("cruise:{stem}"), Path::new("")).unwrap();
        let file = find_for_user(path.to_str().unwrap(), Path::new("")).unwrap();
        assert_eq!(model.source.identity(), file.source.identity(), "{stem}");
    }
}

/// Simulates a car that drives behind a braking leader and `idm`, in a scenario and in a random one of a space.
fn simulate_as_follower(driver: &str) -> [SimulationResult; 2] {
    let scenario = format!(
        "version = 1
name = \"cars\"
duration_s = 40.0
[[vehicles]]
class = \"light\"
position_m = 120.0
speed_mps = 20.0
driver.brake-to-speed = {{ onset_s = 1.0, rate_mps2 = 2.0, final_speed_mps = 8.0 }}
[[vehicles]]
class = \"light\"
position_m = 80.0
speed_mps = 20.0
driver = \"under-test\"
[[vehicles]]
class = \"light\"
position_m = 20.0
speed_mps = 20.0
{driver}
"
    );
    let base = scenario.replace("[[vehicles]]", "[[base.vehicles]]");
    let space = format!(
        "version = 1
name = \"cars\"
[base]
{base}
[[parameters]]
name = \"speed_mps\"
field = \"vehicles[*].speed_mps\"
unit = \"m/s\"
distribution.uniform = {{ low = 15.0, high = 20.0 }}
"
    );
    let opener = Controllers::default();
    let scenario = file::from_toml(&scenario, Path::new("cars.toml"), &opener).unwrap();
    let space = crumple_spaces::file::from_toml(&space, Path::new("space.toml"), &opener).unwrap();
    let idm = BuiltInController::from_name("idm").unwrap();
    [scenario, space.draw(1, 0).unwrap()].map(|scenario| {
        let run = Run::new(&scenario, RunOptions::new(idm.clone())).unwrap();
        simulate(&run, RecordingLevel::Trace)
    })
}

/// The files are followers in a scenario and in the base of a space, with the settings that they state.
#[test]
fn fitted_cars_are_followers_in_scenarios_and_spaces() {
    let cars = fitted_cars();
    assert_eq!(cars.len(), 20);
    for path in cars {
        let path = path.to_str().unwrap();
        let car = find_for_user(path, Path::new("")).unwrap().source;
        let name = car.downcast_ref::<BuiltInController>().unwrap().to_arg();
        let from_file = simulate_as_follower(&format!("driver.file = {{ path = {path:?} }}"));
        let stated = format!("driver = {name:?}");
        assert_eq!(from_file, simulate_as_follower(&stated), "{path}");
        assert!(
            from_file.iter().all(|result| result.outcome.is_safe()),
            "{path}"
        );
    }
}
