//! The oracles of suite and fuzzer detect faults, and earlier findings of the fuzzer stay fixed.

mod fault_injection;

use crumple_sim::scenario::NoDriverFiles;
use std::fs;
use std::path::{Path, PathBuf};

use crumple_fuzzing::oracle::{
    avoidability_bound_holds, metrics_agree, shield_prevents_front_collisions,
};
use crumple_fuzzing::targets::{self, TARGETS};
use crumple_fuzzing::{CollisionSearch, ORACLES, TEST_CASE_BYTES, TestCase, behaviour};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use proptest::prelude::*;

use self::fault_injection::{Fault, FaultySystem};
use crate::generate::{any_bytes, any_test_case, check_oracle, first_values, with_cases};
use crate::tiny::assert_contains;

fn fuzz_seeds(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpora/fuzz")
        .join(target);
    let entries =
        fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    // A local fuzzer names its inputs by hash; these are not committed.
    let is_committed = |path: &PathBuf| path.file_name().is_some_and(|name| name.len() != 40);
    let mut seeds: Vec<PathBuf> = entries
        .map(|entry| entry.expect("readable").path())
        .filter(is_committed)
        .collect();
    seeds.sort();
    seeds
}

#[test]
fn committed_seeds_pass() {
    for (name, target) in TARGETS {
        let seeds = fuzz_seeds(name);
        assert!(seeds.len() >= 5, "{name} has {} seeds", seeds.len());
        for seed in seeds {
            let bytes = fs::read(&seed).expect("readable");
            if let Err(violation) = target(&bytes) {
                panic!("{}: {violation}", seed.display());
            }
        }
    }
}

#[test]
fn hardly_any_trial_is_left_undecided() {
    let strategy = any_bytes(TEST_CASE_BYTES);
    let answers = first_values(64, &strategy).map(|bytes| targets::count_decided(&bytes).unwrap());
    let decided: usize = answers.sum();
    let asked = 64 * ORACLES.len();
    assert!(decided >= asked - 6, "{decided} of {asked} answers");
}

proptest! {
    #![proptest_config(with_cases(12))]

    /// Any change of the files of a campaign folder is detected.
    #[test]
    fn no_changed_folder_is_believed(changes in prop::collection::vec(any::<u8>(), 0..14)) {
        if let Err(violation) = targets::work_folder(&changes) {
            panic!("{violation}");
        }
    }
}

proptest! {
    #![proptest_config(with_cases(256))]

    #[test]
    fn a_shield_keeps_clear(test_case in any_test_case()) {
        check_oracle(&test_case, shield_prevents_front_collisions)?;
    }

    /// No controller survives an unavoidable scenario, or exceeds the bound of the gap.
    #[test]
    fn no_controller_does_the_impossible(test_case in any_test_case()) {
        check_oracle(&test_case, avoidability_bound_holds)?;
    }
}

/// The message has the finding and a command to reproduce it, with a valid scenario file.
#[test]
fn a_violation_brings_a_scenario_file() {
    let test_case = TestCase::from_bytes(&[]);
    let violation = test_case
        .check(metrics_agree, &FaultySystem(Fault::CollisionForgotten))
        .expect_err("must be noticed");
    let path = Path::new("reproducer.toml");
    let read = crumple_sim::scenario::file::from_toml(&violation.reproducer, path, &NoDriverFiles)
        .expect("a scenario file");
    assert_eq!(read, test_case.scenario);
    assert!(
        violation
            .reproducer
            .starts_with("# crumple simulate THIS-FILE.toml --controller baseline\n")
    );
    assert!(
        violation
            .to_string()
            .contains("verdict, summary and trace agree"),
        "{violation}"
    );
}

/// The search keeps one scenario file for each kind of collision, which collides when simulated, and gives the fuzzer
/// feedback.
#[test]
fn a_hunt_keeps_collisions_as_scenario_files() {
    let folder = tempfile::tempdir().expect("a place for temporary files");
    let attack = CollisionSearch::new("baseline", Some(folder.path())).expect("built in");
    for input in [&[][..], &[0], &[3], &[0; 100]] {
        let features = attack.run_input(input).expect("no law is broken");
        assert!(
            !features.is_empty()
                && features
                    .iter()
                    .all(|&feature| feature < behaviour::FEATURE_COUNT)
        );
    }
    let mut files = crumple_sim::scenario::file::load_all(folder.path(), &NoDriverFiles)
        .expect("scenario files");
    assert_eq!(
        files.len(),
        2,
        "the paper's scenario 1 once, and scenario 3"
    );
    let (path, scenario) = files.remove(0);
    assert_eq!(
        path.file_name().unwrap(),
        "baseline-1-of-3-hit-by-baseline-at-10-mps.toml"
    );
    let baseline = crumple_sim::control::BuiltInController::from_name("baseline").unwrap();
    let run = Run::new(&scenario, RunOptions::new(baseline)).unwrap();
    assert!(
        simulate(&run, RecordingLevel::Summary)
            .outcome
            .collision()
            .is_some()
    );
    assert!(CollisionSearch::new("unknown", None).is_err());
}

/// Otherwise every run would fail, and no input would collide.
#[test]
fn a_search_starts_processes_and_refuses_those_that_do_not_start() {
    for name in ["exec:./none", "shield:exec:./none"] {
        let refused = CollisionSearch::new(name, None)
            .expect_err("no such program")
            .to_string();
        assert!(refused.contains("none"), "{refused}");
    }
    let folder = tempfile::tempdir().expect("a place for temporary files");
    let process = format!(
        "exec:python3 {}/examples/controllers/follower.py",
        env!("CARGO_MANIFEST_DIR")
    );
    let search = CollisionSearch::new(&process, Some(folder.path())).expect("starts");
    let runs = |search: &CollisionSearch| search.run_input(&[]).expect("no law is broken");
    assert_eq!(runs(&search), runs(&search));
}

/// Scenarios whose step does not divide the decision interval get a suitable step.
#[test]
fn a_search_takes_controllers_of_any_decision_interval() {
    let folder = tempfile::tempdir().expect("a place for temporary files");
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/controllers");
    std::fs::copy(
        corpus.join("acc-5x20.onnx"),
        folder.path().join("acc-5x20.onnx"),
    )
    .expect("copied");
    let text = std::fs::read_to_string(corpus.join("acc.toml")).expect("there");
    let (before, rest) = text
        .split_once("decision_interval_s = ")
        .expect("says its interval");
    let after = rest.split_once('\n').expect("a line").1;
    let path = folder.path().join("acc.toml");
    for interval_s in [0.05, 0.03, 0.125, 0.004, 0.1, 0.7] {
        std::fs::write(
            &path,
            format!("{before}decision_interval_s = {interval_s}\n{after}"),
        )
        .expect("written");
        let search = CollisionSearch::new(&path.display().to_string(), None).expect("a network");
        let mut own_steps_s = Vec::new();
        for choice in 0..8 {
            let input = [0, choice];
            own_steps_s.push(TestCase::from_bytes(&input).scenario.spec().step_s);
            search
                .run_input(&input)
                .unwrap_or_else(|error| panic!("{interval_s}: {error}"));
        }
        own_steps_s.sort_by(f64::total_cmp);
        own_steps_s.dedup();
        assert_eq!(own_steps_s, [0.01, 0.02, 0.05, 0.1]);
    }
    std::fs::write(
        &path,
        format!("{before}decision_interval_s = 1e-9\n{after}"),
    )
    .expect("written");
    let refused = CollisionSearch::new(&path.display().to_string(), None)
        .expect_err("no step")
        .to_string();
    assert_contains(
        &refused,
        &["has a decision interval of 0.000000001 s, which fits the step of no scenario"],
    );
}
