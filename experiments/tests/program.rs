//! Checks answers of the program to bad arguments.
#![allow(clippy::unwrap_used, reason = "everything here is a test")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use crumple_core::digest::sha256;

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
            &["car_brakes", "predict", "3", "tests.csv", "folder"][..],
            "`3` is no attempt: there are 1 to 2; usage: car_brakes predict ATTEMPT TESTS.csv FOLDER |",
        ),
        (
            &["car_brakes", "sensitivity", "1", "nowhere.csv"][..],
            "nowhere.csv: ",
        ),
        (
            &["controllers", "rows", "draws=0"][..],
            "`0` is no number of draws from 1 to 1000000; usage: controllers ROWS",
        ),
        (
            &["both_sides", "0"][..],
            "usage: both_sides RUNS CONTROLLER...",
        ),
        (
            &["follower_kinds", "10", "nowhere", "idm"][..],
            "`nowhere` is neither a built-in space",
        ),
        (
            &["steady_drives"][..],
            "how many drives?; usage: steady_drives RUNS REFERENCE CONTROLLER... [seed=N]",
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

/// The script takes files from a folder or from an address, and refuses missing and other files.
#[test]
fn kinds_of_follower_come_from_a_space_in_a_file_too() {
    let output = run(&[
        "follower_kinds",
        "30",
        "corpora/spaces/everyday-cars.toml",
        "idm",
    ]);
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{table}");
    assert!(table.contains("| all | idm | 30 |"), "{table}");
    assert!(table.contains("| cruise:"), "{table}");
}

#[test]
fn the_reference_differs_from_itself_in_no_steady_drive() {
    let output = run(&["steady_drives", "20", "idm", "idm"]);
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{table}");
    let of_all = table.lines().filter(|line| line.starts_with("| all |"));
    let rows: Vec<_> = of_all.collect();
    assert_eq!(
        rows, ["| all | idm | 20 | 0 | 0.000 | 0 | 0.000 | 0 |"; 2],
        "{table}"
    );
}

#[test]
fn the_script_of_openacc_checks_each_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("source/long setting")).unwrap();
    fs::write(path("source/long setting/a.csv"), "Date,1,1,2020\n").unwrap();
    let list = format!("{}  long setting/a.csv\n", sha256("Date,1,1,2020\n"));
    fs::write(path("list.sha256"), &list).unwrap();
    let fetch = |source: &[&str]| {
        Command::new("python3")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/studies/openacc/fetch.py"))
            .args(["out", "--list", "list.sha256"])
            .args(source)
            .current_dir(folder.path())
            .output()
            .unwrap()
    };
    let address = format!("file://{}", path("source").display());
    for source in [["--from", "."], ["--source", &address]] {
        let output = fetch(&source);
        assert!(output.status.success(), "{output:?}");
        assert_eq!(fs::read(path("out/a.csv")).unwrap(), b"Date,1,1,2020\n");
        fs::remove_dir_all(path("out")).unwrap();
    }
    fs::write(path("list.sha256"), list + "00  b.csv\n").unwrap();
    fs::write(path("source/long setting/a.csv"), "other").unwrap();
    let output = fetch(&["--source", &address]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(error.contains("long setting/a.csv: differs") && error.contains("b.csv: missing"));
}
