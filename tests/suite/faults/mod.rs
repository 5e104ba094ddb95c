//! Fault injection: every system call that changes a file may fail, be the last one, or be lost in a power failure.
//! Resumed work then ends with the bytes of undisturbed work.
//!
//! A library (`shim.c`) intercepts the calls. `FAULTS` is the number of calls of each command that are tried with each
//! fault, spread over all calls and varied by `FAULTS_SEED`; `FAULTS=all` tries every call.

mod power;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::command_line::command;
use crate::damage::{assert_same_contents, read_files, scratch_folder};
use crate::tiny;

/// Number of calls tried with each fault, unless `FAULTS` overrides it.
const DEFAULT_TRIED_CALLS: usize = 1;

/// A command that can resume its work in the folder `run`, and its preset.
struct ResumableCommand(&'static str, Option<fn() -> String>);

const CAMPAIGN: ResumableCommand = ResumableCommand(
    "falsify --controller baseline --space paper --budget 60",
    None,
);

const COUNT: ResumableCommand = ResumableCommand(
    "verify rate --controller idm --space paper --runs 400 --confidence 0.9",
    None,
);

const ESTIMATE: ResumableCommand = ResumableCommand(
    "verify rate --controller match-leader --rare --estimator truth --samples 50 --repetitions 10",
    None,
);

const TRAINING: ResumableCommand = ResumableCommand(
    "train --preset tiny.toml --seed 1 --episodes 33",
    Some(tiny::training),
);

/// In this space an avoidable collision is quickly found to be avoidable, and every round searches for some.
const RETRAINING: ResumableCommand = ResumableCommand(
    "retrain --preset tiny.toml --space paper --rounds 2 --episodes 12 --budget 5 --draws 5 \
     --validation-draws 3 --nominal 3 \
     --test-draws 3 --regression traffic --regression-draws 3 --seed 3",
    Some(tiny::retraining),
);

type FolderFiles = BTreeMap<String, Vec<u8>>;

impl ResumableCommand {
    fn new_folder(&self) -> tempfile::TempDir {
        let folder = scratch_folder();
        if let Some(preset) = self.1 {
            fs::write(
                folder.path().join("tiny.toml"),
                tiny::with_small_memory(&preset()),
            )
            .unwrap();
        }
        folder
    }

    fn command(&self, folder: &Path) -> Command {
        let mut command = command(folder, self.0);
        command
            .args(["--resume", "--quiet", "--out"])
            .arg(folder.join("run"));
        command.env("RAYON_NUM_THREADS", "1");
        command
    }

    fn assert_completes(&self, folder: &Path, genuine: &FolderFiles, what: &str) {
        let ended = self.command(folder).output().unwrap();
        // A gate may fail, as without faults.
        assert!(
            matches!(ended.status.code(), Some(0 | 1)),
            "{what}: {}",
            describe_output(&ended)
        );
        assert_same_contents(&read_files(&folder.join("run")), genuine, what);
    }

    fn run_without_faults(&self, shim: &Path) -> (FolderFiles, Vec<u8>) {
        let folder = self.new_folder();
        let trace = folder.path().join("trace");
        let ended = with_shim(
            &mut self.command(folder.path()),
            shim,
            &folder.path().join("run"),
        )
        .env("FAULT_TRACE", &trace)
        .output()
        .unwrap();
        assert!(
            matches!(ended.status.code(), Some(0 | 1)),
            "{}",
            describe_output(&ended)
        );
        let renamed = String::from_utf8_lossy(&fs::read(&trace).unwrap())
            .matches("\nrename ")
            .count();
        assert!(renamed > 5, "what it does is seen");
        (
            read_files(&folder.path().join("run")),
            fs::read(&trace).unwrap(),
        )
    }
}

fn describe_output(output: &Output) -> String {
    format!(
        "{:?}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    )
}

fn with_shim<'a>(command: &'a mut Command, shim: &Path, under: &Path) -> &'a mut Command {
    command.env("LD_PRELOAD", shim).env("FAULT_UNDER", under)
}

fn build_shim(folder: &Path) -> PathBuf {
    let library = folder.join("shim.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/suite/faults/shim.c");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(source)
        .args(["-ldl", "-lpthread"])
        .output();
    let built = built.unwrap();
    assert!(built.status.success(), "{}", describe_output(&built));
    library
}

/// Selects the calls to try: `FAULTS` is a number of calls, which are spread over all, or `PART/PARTS` of all.
fn selected_calls(calls: usize, salt: usize) -> Vec<usize> {
    let number = |name| {
        std::env::var(name)
            .ok()
            .and_then(|number| number.parse::<usize>().ok())
    };
    if let Some((part, parts)) = std::env::var("FAULTS").unwrap_or_default().split_once('/') {
        let [part, parts] =
            [part, parts].map(|number| number.parse::<usize>().expect("FAULTS is PART/PARTS"));
        let part = (1..=calls)
            .filter(|call| call % parts == part % parts)
            .collect::<Vec<_>>();
        println!("{} of {calls} calls", part.len());
        return part;
    }
    let wanted = number("FAULTS").unwrap_or(DEFAULT_TRIED_CALLS).min(calls);
    let from = number("FAULTS_SEED")
        .unwrap_or_default()
        .wrapping_add(salt)
        .wrapping_mul(7919);
    (0..wanted)
        .map(|index| 1 + (index * calls / wanted).wrapping_add(from) % calls)
        .collect()
}

fn call_count(trace: &[u8]) -> usize {
    let text = String::from_utf8_lossy(trace);
    text.trim_end()
        .rsplit_once("calls ")
        .unwrap()
        .1
        .parse()
        .unwrap()
}

/// Injects a full disk, a failing disk, a sudden end and a power failure at the selected calls.
fn assert_survives(kept: &ResumableCommand) {
    let folder = tempfile::tempdir().unwrap();
    let shim = build_shim(folder.path());
    let (genuine, trace) = kept.run_without_faults(&shim);
    assert_survives_power_loss(kept, &genuine, &power::parse_operations(&trace));
    let calls = call_count(&trace);
    for (salt, fault) in ["enospc", "eio", "kill"].into_iter().enumerate() {
        for at in selected_calls(calls, salt) {
            let (place, what) = (
                kept.new_folder(),
                format!("{fault} at call {at} of {calls}"),
            );
            let mut command = kept.command(place.path());
            let faulty = with_shim(&mut command, &shim, &place.path().join("run"))
                .env("FAULT_AT", at.to_string())
                .env("FAULT", fault);
            let ended = faulty.output().unwrap();
            match (ended.status.code(), fault) {
                // Errors of cleanup may be ignored.
                (Some(3), "enospc" | "eio") | (None, "kill") | (Some(0 | 1), _) => {}
                _ => panic!("{what}: {}", describe_output(&ended)),
            }
            if ended.status.code() == Some(3) {
                assert!(
                    describe_output(&ended).contains("run"),
                    "{what} names no file: {}",
                    describe_output(&ended)
                );
            }
            kept.assert_completes(place.path(), &genuine, &what);
        }
    }
}

/// Injects a power failure at the selected calls, with all or a part of the unsynchronised changes lost.
fn assert_survives_power_loss(
    kept: &ResumableCommand,
    genuine: &FolderFiles,
    changes: &[power::DiskOperation],
) {
    for (salt, loss) in power::PowerLoss::ALL.into_iter().enumerate() {
        for at in selected_calls(changes.len(), salt) {
            let folder = kept.new_folder();
            power::disk_after_power_loss(&changes[..at], loss).write_to(&folder.path().join("run"));
            let what = format!("power lost at change {at} of {}, {loss:?}", changes.len());
            kept.assert_completes(folder.path(), genuine, &what);
        }
    }
}

#[test]
fn a_campaign_survives_faults_and_loss_of_power() {
    assert_survives(&CAMPAIGN);
}

#[test]
fn a_count_survives_faults_and_loss_of_power() {
    assert_survives(&COUNT);
}

#[test]
fn an_estimate_survives_faults_and_loss_of_power() {
    assert_survives(&ESTIMATE);
}

#[test]
fn a_training_survives_faults_and_loss_of_power() {
    assert_survives(&TRAINING);
}

#[test]
fn a_retraining_survives_faults_and_loss_of_power() {
    assert_survives(&RETRAINING);
}
