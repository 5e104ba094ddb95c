//! Text and JSON of results: the program prints those of the library's type for the same input.
//!
//! Each test computes a result with the library, and compares its text and JSON with both outputs of the program. Where
//! the text names files, both get the same paths. For these comparisons in Python: `python/tests/test_same_results.py`.

mod certificates;
mod learning;
mod recordings;
mod runs;
mod searches;

use std::fmt::Debug;
use std::path::PathBuf;

use serde::Serialize;

use super::*;
use crate::suites::find_controller;
use crumple_core::observer::Quiet;
use crumple_sim::engine::RunOptions;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, built_in_scenario};
use crumple_spaces::{ScenarioSpace, built_in_space};
use crumple_store::study::Study;

/// Text and JSON of a result of the library.
struct LibraryResult {
    text: String,
    json: String,
}

impl LibraryResult {
    fn new(report: &impl Serialize, text: String) -> Self {
        Self {
            text,
            json: json_line(report),
        }
    }
}

fn json_line(report: &impl Serialize) -> String {
    serde_json::to_string(report).expect("serializes") + "\n"
}

/// Checks both outputs of a command that is run twice. `code` is its exit code.
#[track_caller]
fn assert_same_with_code(folder: &Path, code: i32, arguments: &str, expected: &LibraryResult) {
    assert_output(
        folder,
        code,
        &format!("{arguments} --format text"),
        &expected.text,
    );
    assert_output(
        folder,
        code,
        &format!("{arguments} --format json"),
        &expected.json,
    );
}

#[track_caller]
fn assert_same(folder: &Path, arguments: &str, expected: &LibraryResult) {
    assert_same_with_code(folder, 0, arguments, expected);
}

/// Checks the text of a study in a new folder, and the JSON of the finished study. `code` is the exit code of both.
#[track_caller]
fn assert_same_study(folder: &Path, code: i32, arguments: &str, expected: &LibraryResult) {
    assert_output(folder, code, arguments, &expected.text);
    let again = format!("{arguments} --resume --format json");
    assert_output(folder, code, &again, &expected.json);
}

#[track_caller]
fn assert_output(folder: &Path, code: i32, arguments: &str, expected: &str) {
    let output = run_crumple(folder, &format!("{arguments} --quiet"));
    assert_eq!(exit_code(&output), code, "{arguments}: {}", stderr(&output));
    assert!(!expected.trim().is_empty(), "{arguments}: no text");
    assert_eq!(stdout(&output), expected, "{arguments}");
}

/// Runs a study of the library in a folder of its own.
fn run_study<S: Study>(study: &S) -> S::Report
where
    S::Error: Debug,
{
    let folder = temp_folder();
    study
        .run(&folder.path().join("study"), false, &Quiet)
        .expect("runs")
}

fn find_scenario(name: &str) -> Scenario {
    built_in_scenario(name).expect("built in")
}

fn find_space(name: &str) -> ScenarioSpace {
    built_in_space(name).expect("built in")
}

/// Returns the options of a controller, with the estimator that is the program's default.
fn run_options(controller: &str) -> RunOptions {
    RunOptions::new(find_controller(controller).source).with_estimator(EstimatorKind::Kalman)
}

/// Returns an argument for a path, which may contain spaces.
fn quote(path: &Path) -> String {
    format!("'{}'", path.display())
}

fn corpus(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpora")
        .join(path)
}
