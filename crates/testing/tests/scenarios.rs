//! Families of scenarios: strategies of proptest, and their shrinking.
#![expect(clippy::panic, reason = "a test may panic, also in its functions")]

use crumple_testing::Scenarios;
use crumple_testing::sim::scenario::{Scenario, built_in_scenario, file};
use proptest::prelude::*;
use proptest::test_runner::{TestError, TestRunner};

/// Returns the scenario to which a violation of `holds` shrinks.
fn shrunk(scenarios: &Scenarios, holds: impl Fn(&Scenario) -> bool) -> Scenario {
    let result = TestRunner::deterministic().run(scenarios, |scenario| {
        prop_assert!(holds(&scenario));
        Ok(())
    });
    match result {
        Err(TestError::Fail(_, scenario)) => scenario,
        other => panic!("{other:?}"),
    }
}

#[test]
fn scenarios_of_a_space_shrink_to_the_nominal_one_and_round_numbers() {
    let scenarios = Scenarios::space("high-risk").unwrap();
    let fast = |scenario: &Scenario| scenario.vehicles()[0].speed_mps > 31.3;
    let smallest = shrunk(&scenarios, |scenario| !fast(scenario));
    let faster = |speed_mps| {
        scenarios.read(&[]).edited(|spec| {
            spec.vehicles
                .iter_mut()
                .for_each(|vehicle| vehicle.speed_mps = speed_mps)
        })
    };
    assert_eq!(smallest, faster(32.0).unwrap());
}

#[test]
fn any_scenarios_shrink_to_the_nominal_one_and_round_numbers() {
    let smallest = shrunk(&Scenarios::any(), |scenario| {
        scenario.vehicles().len() < 4 || scenario.vehicles()[1].speed_mps < 31.3
    });
    let nominal = Scenarios::any().read(&[2]);
    assert_eq!(smallest.vehicles().len(), 4);
    let expected = nominal
        .edited(|spec| spec.vehicles[1].speed_mps = 32.0)
        .unwrap();
    assert_eq!(smallest.edited(|spec| spec.seed = 0).unwrap(), expected);
}

#[test]
fn scenarios_near_a_given_one_are_valid_and_keep_it_as_the_nominal_one() {
    for name in ["paper-1", "paper-2", "paper-3"] {
        let scenario = built_in_scenario(name).unwrap();
        let near = Scenarios::near(&scenario).unwrap();
        assert_eq!(near.read(&[]).vehicles(), scenario.vehicles());
        let gap_m = scenario.initial_gap_m(1).unwrap();
        let mut runner = TestRunner::new(crumple_cases::with_cases(100));
        let near = near.prop_map(|scenario| scenario.initial_gap_m(1).unwrap());
        let is_near = |own_m: f64| {
            prop_assert!((own_m / gap_m - 1.0).abs() < 0.2501);
            Ok(())
        };
        runner.run(&near, is_near).unwrap();
    }
}

#[test]
fn a_folder_of_scenario_files_is_a_family() {
    let folder = tempfile::tempdir().unwrap();
    assert!(Scenarios::files(folder.path()).is_err());
    for name in ["paper-1", "paper-2"] {
        let text = file::to_toml(&built_in_scenario(name).unwrap()).unwrap();
        std::fs::write(folder.path().join(name).with_extension("toml"), text).unwrap();
    }
    let scenarios = Scenarios::try_from(folder.path().to_str().unwrap()).unwrap();
    assert_eq!(scenarios.read(&[1]), built_in_scenario("paper-2").unwrap());
    assert_eq!(
        shrunk(&scenarios, |scenario| scenario.spec().name != "paper-1"),
        scenarios.read(&[])
    );
}
