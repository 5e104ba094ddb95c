//! The scripts of the study of rear-end collisions refuse results that they did not make.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::command_line::temp_folder;

/// Returns the error of `aeb_behind` with these arguments in a folder, or `None` without Python 3.11.
fn error_of_study(arguments: &[&str], folder: &Path) -> Option<String> {
    let has_python = Command::new("python3")
        .args(["-c", "import tomllib"])
        .output()
        .is_ok_and(|output| output.status.success());
    if !has_python {
        println!("skipped: no python3 of version 3.11");
        return None;
    }
    let output = Command::new("python3")
        .arg("-B")
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/studies/aeb_behind"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    Some(String::from_utf8(output.stderr).unwrap())
}

#[test]
fn results_of_another_program_are_refused() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("runs")).unwrap();
    fs::write(folder.path().join("runs/program.sha256"), "0".repeat(64)).unwrap();
    let arguments = ["run", env!("CARGO_BIN_EXE_crumple"), "runs"];
    if let Some(error) = error_of_study(&arguments, folder.path()) {
        assert_eq!(
            error,
            "error: runs has results of another program: use an empty folder\n"
        );
    }
}

#[test]
fn results_of_an_unknown_program_are_refused() {
    let folder = temp_folder();
    fs::create_dir_all(folder.path().join("runs/hold-kalman")).unwrap();
    let arguments = ["run", env!("CARGO_BIN_EXE_crumple"), "runs"];
    if let Some(error) = error_of_study(&arguments, folder.path()) {
        assert_eq!(
            error,
            "error: runs has files, but no program.sha256: use an empty folder\n"
        );
    }
}

#[test]
fn a_page_of_other_inputs_is_refused() {
    let folder = temp_folder();
    let part = folder.path().join("runs/hold-kalman");
    fs::create_dir_all(&part).unwrap();
    fs::write(part.join("emergencies.toml"), "version = 1\n").unwrap();
    fs::create_dir(part.join("report")).unwrap();
    fs::write(
        part.join("report/runs.csv"),
        "space,controller,follower,harm\n",
    )
    .unwrap();
    if let Some(error) = error_of_study(&["page", "runs", "page.md"], folder.path()) {
        assert_eq!(
            error,
            "error: runs/hold-kalman has no results of today's emergencies.toml: run it again\n"
        );
    }
}

/// Returns a file of the study's reports.
fn report(name: &str) -> String {
    fs::read_to_string(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("reports")
            .join(name),
    )
    .unwrap()
}

/// Returns the numbers of the last `count` columns of each row of a table, with its first column.
fn last_columns(table: &str, count: usize) -> Vec<(&str, Vec<f64>)> {
    let rows = table.lines().skip(1).map(|line| {
        let mut values: Vec<f64> = line
            .rsplit(',')
            .take(count)
            .map(|value| value.parse().unwrap())
            .collect();
        values.reverse();
        (line.split(',').next().unwrap(), values)
    });
    rows.collect()
}

#[test]
fn the_page_is_short() {
    let page = report("aeb-behind.md");
    let words = page
        .split_whitespace()
        .filter(|word| word.chars().any(char::is_alphanumeric));
    assert!(words.count() <= 2500);
    for row in page.lines().filter(|line| line.starts_with('|')) {
        assert!(row.matches('|').count() <= 7, "{row}");
    }
}

#[test]
fn no_interval_of_the_field_is_empty() {
    for (_, row) in last_columns(&report("aeb-behind/field.csv"), 6) {
        assert!(row[1] < row[2] && row[4] < row[5], "{row:?}");
    }
}

/// A common answer is that of every comparison in both runs.
#[test]
fn common_answers_hold_in_both_runs() {
    let page = report("aeb-behind.md");
    let first = page.split("\n## ").nth(1).unwrap().replace("\n   ", " ");
    let runs = ["answers.csv", "repeated.csv"].map(|name| report(&format!("aeb-behind/{name}")));
    let rows = runs.iter().flat_map(|run| last_columns(run, 2));
    for (question, bounds) in rows {
        let start = format!("\n{question}. **");
        let answer = first.split(&start).nth(1).unwrap();
        let answer = answer.split("** ").nth(1).unwrap();
        if answer.starts_with("Fewer") {
            assert!(bounds[1] < 0.0, "{question}: {bounds:?}");
        } else if answer.starts_with("More") {
            assert!(bounds[0] > 0.0, "{question}: {bounds:?}");
        }
    }
}
