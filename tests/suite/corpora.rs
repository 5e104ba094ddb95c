//! Scenarios kept because somebody failed in them: each is replayed, and its recorded verdict must still be true.

use std::path::PathBuf;

use crumple::falsify::counterexample::ExpectedFile;
use crumple::scenario::file::load;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpora/scenarios")
}

#[test]
fn every_kept_scenario_still_ends_as_recorded() {
    let index = ExpectedFile::load(&folder().join("expected.toml")).unwrap();
    assert!(index.expected.len() >= 4, "a handful at least");
    let mut failures = Vec::new();
    for expected in &index.expected {
        let replayed = expected.replay(&folder()).unwrap();
        if !replayed.as_recorded {
            failures.push(format!("{} under {}: {replayed:?}", expected.scenario, expected.controller));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_kept_scenario_is_recorded_and_says_why_it_is_there() {
    let index = ExpectedFile::load(&folder().join("expected.toml")).unwrap();
    let recorded = index.scenarios(&folder());
    let mut kept: Vec<PathBuf> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml") && !path.ends_with("expected.toml"))
        .collect();
    kept.sort();
    assert_eq!(kept, recorded);
    for path in kept {
        let scenario = load(&path).unwrap();
        assert!(scenario.spec().about.len() > 40, "{} does not say why it is there", path.display());
    }
}
