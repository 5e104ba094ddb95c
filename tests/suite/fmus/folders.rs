//! Folders into which FMUs are unpacked: none remains, and none is removed while it is in use.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Stdio};

use super::*;

fn odd_fmu_folder_with_resource(what: &str) -> Option<tempfile::TempDir> {
    let folder = odd_fmu_folder(what)?;
    fs::create_dir(folder.path().join("temporary")).unwrap();
    let library = fs::read(folder.path().join("library.so")).unwrap();
    let xml = ODD_XML.replace("\"ONCE\"", "\"false\"");
    write_fmu(
        &folder.path().join("odd.fmu"),
        &xml,
        &[
            (&library_member(3, "odd"), &library),
            ("resources/data", &[7; 1 << 20]),
        ],
    );
    Some(folder)
}

fn unpacked_folders(folder: &Path) -> Vec<std::path::PathBuf> {
    fs::read_dir(folder.join("temporary"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect()
}

fn start_host(folder: &Path) -> Child {
    let mut host = Command::new(env!("CARGO_BIN_EXE_crumple-fmu"))
        .args(["drive", "--input=speed", "--output=command", "odd.fmu"])
        .current_dir(folder)
        .env("TMPDIR", folder.join("temporary"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let hello =
        "{\"crumple\":1,\"hello\":{\"step_s\":0.01,\"inputs\":[\"speed_mps\"],\"history\":1}}\n";
    host.stdin
        .as_mut()
        .unwrap()
        .write_all(hello.as_bytes())
        .unwrap();
    let mut answer = String::new();
    BufReader::new(host.stdout.as_mut().unwrap())
        .read_line(&mut answer)
        .unwrap();
    assert!(answer.contains("\"crumple\":1"), "{answer}");
    host
}

fn simulate_odd(folder: &Path) -> std::process::Output {
    let mut simulate = command(folder, "simulate paper-1 --controller odd.toml");
    simulate
        .env("TMPDIR", folder.join("temporary"))
        .output()
        .unwrap()
}

#[test]
fn a_run_leaves_no_unpacked_folder_behind() {
    let Some(place) = odd_fmu_folder_with_resource("NOTHING") else {
        return;
    };
    let ran = simulate_odd(place.path());
    assert_eq!(exit_code(&ran), 0, "{}", stderr(&ran));
    assert_eq!(unpacked_folders(place.path()), [] as [&Path; 0]);
}

#[test]
fn folders_of_killed_hosts_are_removed_and_folders_in_use_are_not() {
    let Some(place) = odd_fmu_folder_with_resource("NOTHING") else {
        return;
    };
    let mut killed = [start_host(place.path()), start_host(place.path())];
    let mut running = start_host(place.path());
    assert_eq!(unpacked_folders(place.path()).len(), 3);
    for host in &mut killed {
        host.kill().unwrap();
        host.wait().unwrap();
    }
    assert_eq!(unpacked_folders(place.path()).len(), 3);
    assert_eq!(exit_code(&simulate_odd(place.path())), 0);
    let [left] = unpacked_folders(place.path())
        .try_into()
        .expect("that of the host that runs");
    assert_eq!(
        fs::metadata(left.join("resources/data")).unwrap().len(),
        1 << 20
    );
    drop(running.stdin.take());
    assert!(running.wait().unwrap().success());
    assert_eq!(unpacked_folders(place.path()), [] as [&Path; 0]);
}

/// A host that crashes cannot remove its folder; the next one does.
#[test]
fn crashes_leave_at_most_the_folders_of_the_last_hosts() {
    let Some(place) = odd_fmu_folder_with_resource("CRASH") else {
        return;
    };
    for _ in 0..3 {
        let ran = simulate_odd(place.path());
        assert!(stdout(&ran).contains("CONTROLLER FAILED"));
    }
    assert!(
        unpacked_folders(place.path()).len() <= 2,
        "{:?}",
        unpacked_folders(place.path())
    );
    drop(start_host(place.path()).wait_with_output());
    assert_eq!(unpacked_folders(place.path()), [] as [&Path; 0]);
}

#[test]
fn a_library_that_cannot_be_loaded_is_reported_with_the_loaders_reason() {
    let folder = temp_folder();
    let source = "extern int missing_symbol; int *reference = &missing_symbol;";
    let Some(undefined) = compile_library(folder.path(), source, "-DNOTHING") else {
        return;
    };
    for (library, reason) in [
        (undefined.as_slice(), "missing_symbol"),
        (&[b'x'; 100], "binaries/"),
    ] {
        write_fmu(
            &folder.path().join("follower.fmu"),
            EXAMPLE_XML,
            &[(&library_member(2, "follower"), library)],
        );
        let ran = run_crumple(folder.path(), "simulate paper-1 --controller follower.fmu");
        let text = stderr(&ran);
        assert_eq!(exit_code(&ran), 2, "{text}");
        assert!(
            text.contains("its library cannot be loaded: ") && text.contains(reason),
            "{text}"
        );
        assert!(
            text.contains("build the FMU for this system") && !text.contains("crumple-fmu-run-"),
            "{text}"
        );
    }
}
