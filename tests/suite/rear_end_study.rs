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
    let program = env!("CARGO_BIN_EXE_crumple");
    for command in ["run", "repeat", "sensitivity"] {
        let folder = temp_folder();
        fs::create_dir(folder.path().join("runs")).unwrap();
        fs::write(folder.path().join("runs/program.sha256"), "0".repeat(64)).unwrap();
        if let Some(error) = error_of_study(&[command, program, "runs"], folder.path()) {
            assert_eq!(
                error,
                "error: runs has results of another program: use an empty folder\n"
            );
        }
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
