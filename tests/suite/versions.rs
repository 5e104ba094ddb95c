//! Files of earlier versions are read, or refused by an error that says why.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use crumple_learn::rl::TrainingConfig;
use crumple_sim::scenario::NoDriverFiles;
use crumple_spaces::file;
use crumple_suites::TestSuite;

use crate::command_line::{exit_code, run_crumple, stderr, stdout, temp_folder};
use crate::damage::{assert_same_contents, read_files};

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

/// A command with its exit code, and a part of its output or error.
type ExpectedOutput = (&'static str, i32, &'static str);

const COMMANDS_0_1_0: [ExpectedOutput; 16] = [
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

/// A finished study of another version is read; an unfinished one is refused with what to do.
const COMMANDS_0_3_0: [ExpectedOutput; 11] = [
    (
        "falsify --controller match-leader --space paper --budget 60 --seed 3 --out campaign --resume",
        0,
        "FALSIFIED: 3 distinct failures",
    ),
    (
        "simulate campaign/counterexamples/01-2-hits-1.toml --controller match-leader --expect collision",
        0,
        "vehicle 2 hits vehicle 1",
    ),
    (
        "verify rate --controller idm --space paper --runs 300 --seed 3 --confidence 0.9 --out count --resume",
        0,
        "0 failures in 300 runs",
    ),
    (
        "verify rate --rare --controller match-leader --space paper --samples 50 --repetitions 5 --seed 3 --out \
         estimate --resume",
        0,
        "probability of a failure 0.009442",
    ),
    (
        "tune --controller idm --space paper --evaluations 8 --runs 5 --test-runs 5 --out tuning --resume",
        0,
        "# Tuning of `idm",
    ),
    (
        "train --preset training-preset.toml --seed 3 --episodes 12 --out training --resume",
        0,
        "6c624085cb37",
    ),
    (
        "retrain --policy policy --space paper --preset retraining-preset.toml --rounds 1 --episodes 12 --method \
         uniform --budget 5 --draws 5 --validation-draws 3 \
         --nominal 3 --regression none --test-draws 3 --seed 3 --out retraining \
         --resume",
        0,
        "c168ff6345c2fe83665fc9b64051e0730571fd71b7cb696a7ca6bfe09ac3d98f",
    ),
    (
        "falsify --controller predictive --space paper --budget 20000 --method cma-es --seed 3 --out unfinished \
         --resume",
        2,
        "another build of crumple started this work: resume it with that build, or start again without --resume in \
         another --out",
    ),
    (
        "explore unfinished",
        2,
        "the campaign is not complete: another build of crumple started this work",
    ),
    (
        "falsify --controller match-leader --space paper --budget 60 --seed 3 --out campaign --resume --format json",
        0,
        "\"specification\":\"no collision\"",
    ),
    (
        "verify rate --rare --controller match-leader --space paper --samples 50 --repetitions 5 --seed 3 --out \
         estimate --resume --format json",
        0,
        "\"specification\":\"no collision\"",
    ),
];

/// Files with the names of fields before 0.4.0 are read, with one message for each name.
const OLD_NAMES_0_3_0: [ExpectedOutput; 12] = [
    ("simulate scenario.toml --controller idm", 0, "emergency"),
    (
        "suite run suite.toml --controller idm",
        0,
        "suite.toml:6: `figures_from` is now `parameter_source`",
    ),
    (
        "suite run suite.toml --controller idm",
        0,
        "suite.toml:17: `push` is now `parameter`",
    ),
    (
        "falsify --controller idm --space space.toml --budget 3 --out searched",
        0,
        "space.toml:33: `waves` is now `braking_clusters`",
    ),
    (
        "train --preset training-preset.toml --seed 3 --episodes 12 --out training --resume",
        0,
        "training-preset.toml:49: `soft_update` is now `tau`",
    ),
    (
        "assess assessment.toml --out report --against assessment.json",
        0,
        "assessment.toml:15: `needless-braking-at-most` is now `unnecessary-braking-at-most`",
    ),
    (
        "assess assessment.toml --out report --against assessment.json",
        0,
        "0 worse, 8 new, 0 gone, 0 changed without being better or worse",
    ),
    (
        "falsify --controller match-leader --against idm --space space.toml --budget 30 --seed 3 --out \
         search-in-fitted-space --resume",
        0,
        "vehicle 2 (light) hits the ego (vehicle 1)",
    ),
    (
        "verify rate --controller idm --space space.toml --runs 200 --seed 3 --confidence 0.9 --out \
         count-in-fitted-space --resume",
        0,
        "in 200 runs",
    ),
    (
        "check count-in-fitted-space/certificate.json",
        0,
        "accepted",
    ),
    ("check certificates/heavy-behind-heavy.json", 0, "accepted"),
    ("check certificates/rate-policy.json", 0, "accepted"),
];

fn check_commands(version: &str, commands: &[ExpectedOutput]) -> TempDir {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let policy = root.join("corpora/scenarios/policies/reference-94021f6edd21.safetensors");
    let folder = temp_folder();
    copy_folder(&root.join("corpora/versions").join(version), folder.path());
    for (line, code, expected) in commands {
        let output = run_crumple(
            folder.path(),
            &line.replace("POLICY", &format!("'{}'", policy.display())),
        );
        let printed = format!("{}{}", stdout(&output), stderr(&output));
        assert_eq!(exit_code(&output), *code, "{line}: {printed}");
        assert!(printed.contains(expected), "{line}: {printed}");
    }
    folder
}

#[test]
fn files_of_0_1_0_are_read_or_refused() {
    check_commands("0.1.0", &COMMANDS_0_1_0);
}

#[test]
fn files_of_0_3_0_with_old_names_are_read() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = check_commands("0.3.0", &OLD_NAMES_0_3_0);
    for kind in ["search-in-fitted-space", "count-in-fitted-space"] {
        assert_same_contents(
            &read_files(&folder.path().join(kind)),
            &read_files(&root.join("corpora/versions/0.3.0").join(kind)),
            kind,
        );
    }
}

/// Every field that was renamed has the same meaning in a file of 0.3.0.
#[test]
fn presets_suites_and_spaces_of_0_3_0_have_present_names() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/versions/0.3.0");
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let present =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/learn/src/rl/tests/every-field.toml");
    let present = fs::read_to_string(present).unwrap();
    let old = read("every-field-preset.toml");
    let preset = |text: &str| TrainingConfig::parse(text, Path::new("preset.toml")).unwrap();
    assert_eq!(preset(&old), preset(&present));
    let path = Path::new("file.toml");
    let suite = TestSuite::from_toml(&read("suite.toml"), path).unwrap();
    let written = toml::to_string(suite.spec()).unwrap();
    assert_eq!(TestSuite::from_toml(&written, path).unwrap(), suite);
    let space = file::from_toml(&read("space.toml"), path, &NoDriverFiles).unwrap();
    let written = file::to_toml(&space).unwrap();
    let same = file::from_toml(&written, path, &NoDriverFiles).unwrap();
    assert_eq!(same.spec(), space.spec());
    for text in [&present, &toml::to_string(suite.spec()).unwrap(), &written] {
        for old in [
            "soft_update",
            "needless",
            "imposed",
            "figures",
            "push",
            "says",
            "left_out",
            "waves",
        ] {
            assert!(!text.contains(old), "{old}: {text}");
        }
    }
}

/// Reading changes no file.
#[test]
fn studies_of_0_3_0_are_read_or_refused() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = check_commands("0.3.0", &COMMANDS_0_3_0);
    for kind in [
        "campaign",
        "count",
        "estimate",
        "tuning",
        "retraining",
        "unfinished",
    ] {
        assert_same_contents(
            &read_files(&folder.path().join(kind)),
            &read_files(&root.join("corpora/versions/0.3.0").join(kind)),
            kind,
        );
    }
}
