//! Files of version 0.1.0 are read, or refused by an error that says why.

use std::fs;
use std::path::Path;

use crate::command_line::{exit_code, run_crumple, stderr, stdout, temp_folder};

/// Copies a folder, so that commands that resume cannot change the committed one.
fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Each command with its exit code, and a part of its output or error.
const COMMANDS: [(&str, i32, &str); 16] = [
    (
        "simulate scenarios/escape.toml --expect safe",
        0,
        "no collision",
    ),
    (
        "simulate scenarios/episode.toml --controller idm",
        0,
        "openacc",
    ),
    (
        "simulate campaign/counterexamples/01-2-hits-1.toml --controller match-leader --estimator truth --expect \
         collision",
        0,
        "vehicle 2 hits vehicle 1",
    ),
    (
        "simulate paper-1 --controller train/seed-1/policy.safetensors --expect safe",
        0,
        "seed-1",
    ),
    (
        "verify rate --controller idm --space space.toml --runs 20 --confidence 0.9 --out counted",
        0,
        "accepted",
    ),
    (
        "check certificates/kernel.json certificates/avoid.json",
        0,
        "version 1",
    ),
    (
        "check certificates/rate.json certificates/policy-against-baseline.json",
        0,
        "version 1, an old one",
    ),
    (
        "check certificates/reach-paper-1.json --policy POLICY",
        0,
        "version 1 does not bind the statement to a text",
    ),
    (
        "falsify --controller match-leader --out campaign --resume",
        2,
        "to version 0.1.0",
    ),
    (
        "verify rate --controller match-leader --runs 200 --out rate --resume",
        2,
        "to version 0.1.0",
    ),
    ("retrain --out retrain --resume", 2, "to version 0.1.0"),
    (
        "train --preset fast --seed 1 --out train --resume",
        2,
        "train/seed-1/work.json: the file is missing",
    ),
    ("fsck campaign", 2, "not a result folder"),
    (
        "explore campaign --format json",
        2,
        "work.json: the file is missing",
    ),
    (
        "assess --against assessment.json --out report",
        2,
        "version: 2 is not supported",
    ),
    (
        "simulate paper-1 --controller hardened",
        0,
        "paper-1: retrained",
    ),
];

#[test]
fn files_of_0_1_0_are_read_or_refused() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let policy = root.join("corpora/scenarios/policies/reference-94021f6edd21.safetensors");
    let folder = temp_folder();
    copy_folder(&root.join("corpora/versions/0.1.0"), folder.path());
    for (line, code, expected) in COMMANDS {
        let output = run_crumple(
            folder.path(),
            &line.replace("POLICY", &format!("'{}'", policy.display())),
        );
        let printed = format!("{}{}", stdout(&output), stderr(&output));
        assert_eq!(exit_code(&output), code, "{line}: {printed}");
        assert!(printed.contains(expected), "{line}: {printed}");
    }
}
