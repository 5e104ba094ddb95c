//! Checks answers of the program to bad arguments.
#![allow(clippy::unwrap_used, reason = "everything here is a test")]

use std::path::Path;
use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    Command::new(env!("CARGO_BIN_EXE_crumple-experiments"))
        .args(arguments)
        .current_dir(root)
        .output()
        .unwrap()
}

#[test]
fn bad_arguments_are_one_error_with_the_usage() {
    for (arguments, expected) in [
        (&[][..], "name an experiment:"),
        (&["nowhere"][..], "name an experiment:"),
        (
            &["filter_errors"][..],
            "usage: filter_errors SCENARIO [FACTOR]",
        ),
        (
            &["filter_errors", "nowhere"][..],
            "nowhere: no built-in scenario; usage: filter_errors SCENARIO [FACTOR]",
        ),
        (
            &["both_sides", "0"][..],
            "usage: both_sides RUNS CONTROLLER...",
        ),
    ] {
        let output = run(arguments);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(2) && output.stdout.is_empty(),
            "{arguments:?}: {error}"
        );
        assert!(
            error.starts_with("error: ") && error.contains(expected),
            "{arguments:?}: {error}"
        );
    }
}
