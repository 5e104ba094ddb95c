//! Scenarios that are kept because a controller failed in them: each is replayed and must reproduce its recorded
//! verdict.

use std::fs;
use std::path::PathBuf;

use crumple_controllers::Controllers;
use crumple_search::falsify::counterexample::{Avoidability, AvoidabilityClass, ExpectedFile};
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::file::{EXPECTED_FILE_NAME, load};

fn scenario_corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpora/scenarios")
}

/// Returns the paths of all recorded scenario files, each once.
fn scenario_paths(index: &ExpectedFile) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = index
        .expected
        .iter()
        .map(|expected| scenario_corpus().join(&expected.scenario))
        .collect();
    paths.sort();
    paths.dedup();
    paths
}

#[test]
fn every_kept_scenario_still_ends_as_recorded() {
    let path = scenario_corpus().join(EXPECTED_FILE_NAME);
    let mut index = ExpectedFile::load(&path).unwrap();
    if std::env::var_os("UPDATE_CORPORA").is_some() {
        for expected in &mut index.expected {
            *expected = expected
                .renew(&scenario_corpus(), Controllers::default())
                .unwrap();
        }
        let about = "# How each scenario ends under which controller. `tests/suite/corpora.rs` replays every entry; \
            with UPDATE_CORPORA=1 it\n# renews them.\n";
        fs::write(
            &path,
            format!("{about}{}", toml::to_string(&index).unwrap()),
        )
        .unwrap();
    }
    assert!(index.expected.len() >= 4, "a handful at least");
    let mut failures = Vec::new();
    for expected in &index.expected {
        let replayed = expected
            .replay(&scenario_corpus(), Controllers::default())
            .unwrap();
        if !replayed.as_recorded {
            failures.push(format!(
                "{} under {}: {replayed:?}",
                expected.scenario, expected.controller
            ));
        }
    }
    assert!(
        failures.is_empty(),
        "{}: if that is meant, run with UPDATE_CORPORA=1",
        failures.join("\n")
    );
}

/// The controller in the file name still fails, and the recorded avoidability is still the result of convex
/// programming.
#[test]
fn every_kept_scenario_still_has_its_failure_and_its_class() {
    let index = ExpectedFile::load_from_folder(&scenario_corpus()).unwrap();
    for path in scenario_paths(&index) {
        let file = path.file_name().unwrap().to_str().unwrap();
        let own: Vec<_> = index
            .expected
            .iter()
            .filter(|expected| expected.scenario == file)
            .collect();
        let named = own.iter().find(|expected| {
            file.starts_with(&expected.controller)
                || (file.starts_with("policy") && expected.policy_sha256.is_some())
        });
        assert!(
            named.is_some_and(|expected| expected.violated),
            "{file}: the controller that it is named after does not fail"
        );
        let class = Avoidability::classify_collision(&load(&path, &NoDriverFiles).unwrap());
        for expected in own {
            let recorded = if expected.violated {
                class.class()
            } else {
                AvoidabilityClass::NotAsked
            };
            assert_eq!(expected.avoidable, recorded, "{file}");
            let gaps = expected.best_min_gap_m.zip(class.best_min_gap_m());
            // Differences between solvers on different machines are smaller.
            assert!(
                gaps.is_none_or(|(recorded, found)| (recorded - found).abs() < 1e-3),
                "{file}: {gaps:?}"
            );
        }
    }
}

#[test]
fn every_corpus_scenario_is_recorded_with_its_reason() {
    let index = ExpectedFile::load_from_folder(&scenario_corpus()).unwrap();
    let recorded = scenario_paths(&index);
    let mut kept: Vec<PathBuf> = std::fs::read_dir(scenario_corpus())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    kept.sort();
    assert_eq!(kept, recorded);
    for path in kept {
        let scenario = load(&path, &NoDriverFiles).unwrap();
        assert!(
            scenario.spec().about.len() > 40,
            "{} does not say why it is there",
            path.display()
        );
    }
}
