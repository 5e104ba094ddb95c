//! `crumple tune`: report, resumption and errors.

use super::drives::platoon_csv;
use super::*;

const TUNE_ARGS: &str = "tune --controller baseline --setting ttc_s=0..3 --space standing --space paper=0.5 \
    --evaluations 8 --runs 5 --test-runs 6 --seed 3";

/// The report has the settings, both sides of three controllers, and a text that other commands accept.
#[test]
fn a_tuning_reports_both_sides_and_is_read_again() {
    let folder = temp_folder();
    let first = run_ok(
        folder.path(),
        &format!("{TUNE_ARGS} --out tuned --format json"),
    );
    assert_contains(
        stderr(&first),
        &["wrote tuned (candidates.jsonl, report.md, report.json)"],
    );
    let report = &json_objects(&first)[0];
    assert_eq!(*report, read_json(&folder.path().join("tuned/report.json")));
    assert_eq!(report["settings"][0]["range"], json!([0.0, 3.0]));
    let controllers: Vec<_> = report["test"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| &row["controller"])
        .collect();
    assert_eq!(
        controllers,
        [&json!("baseline"), &report["tuned"], &json!("idm")]
    );
    let tuned = report["tuned"].as_str().unwrap();
    run_ok(
        folder.path(),
        &format!("simulate paper-1 --controller {tuned}"),
    );
    let candidates = fs::read_to_string(folder.path().join("tuned/candidates.jsonl")).unwrap();
    assert_eq!(candidates.lines().count(), 8);
    let text = run_ok(folder.path(), &format!("{TUNE_ARGS} --out tuned --resume"));
    assert_contains(
        stdout(&text),
        &[
            "| `ttc_s` | s | 0 to 3 | 1.4 |",
            "| collisions in standing | ",
            "| objective | ",
        ],
    );
    assert_eq!(
        stdout(&text),
        fs::read_to_string(folder.path().join("tuned/report.md")).unwrap()
    );
    assert_prints(
        &run_crumple(folder.path(), "fsck tuned"),
        0,
        &["tuned: a tuning, complete; 4 of 4 files are intact"],
    );
    let other = run_crumple(
        folder.path(),
        &format!("{TUNE_ARGS} --out tuned --resume --objective safety"),
    );
    assert_refused(&other, "the tuning there has a different configuration");
}

/// Recorded drives are a limit of tuning, training and retraining, and a resumed tuning needs the same ones.
#[test]
fn recorded_drives_are_usability_limits() {
    let folder = temp_folder();
    fs::write(folder.path().join("platoon.csv"), platoon_csv()).unwrap();
    run_ok(folder.path(), "import platoon.csv --whole --out drives");
    let tune = format!("{TUNE_ARGS} --drives drives --out tuned");
    run_ok(folder.path(), &tune);
    let report = read_json(&folder.path().join("tuned/report.json"));
    let [initial, idm] = [0, 2].map(|row| &report["test"][row]["traffic"]["recorded"]);
    assert_eq!(
        *idm,
        json!({"drive_count": 2, "faults": 0, "jerk_times_idm": 1.0})
    );
    assert_eq!(initial["drive_count"], 2);
    let text = fs::read_to_string(folder.path().join("tuned/report.md")).unwrap();
    assert_contains(
        &text,
        &[
            "| faults in recorded drives | ",
            "The 2 recorded drives count",
        ],
    );

    for command in ["train --preset fast", "retrain"] {
        let refused = run_crumple(folder.path(), &format!("{command} --drives drives"));
        assert_refused(
            &refused,
            "--drives: needs evaluation.usefulness_draws of at least 1",
        );
    }
    let missing = "train --preset road --drives missing --out missing-training";
    assert_refused(
        &run_crumple(folder.path(), missing),
        "--drives: missing: is no folder",
    );
    fs::remove_file(folder.path().join("drives/openacc-platoon-drive-02.toml")).unwrap();
    assert_refused(
        &run_crumple(folder.path(), &format!("{tune} --resume")),
        "the tuning there has a different configuration",
    );
}

#[test]
fn mistakes_are_reported_before_anything_is_written() {
    let folder = temp_folder();
    let cases = [
        (
            "--controller policy",
            "`policy` has no settings to tune; the controllers with settings are ",
        ),
        (
            "--controller shield:idm",
            "`shield:idm` is not a built-in controller; those with settings are ",
        ),
        (
            "--controller own.toml",
            "`own.toml` is not a built-in controller",
        ),
        (
            "--controller acc-aeb,ttc=1",
            "`ttc=1` is not a setting of acc-aeb",
        ),
        (
            "--controller baseline,ttc_s=1",
            "no setting is left to tune: `baseline,ttc_s=1` fixes all of them",
        ),
        (
            "--controller idm --setting ttc_s",
            "error: --setting ttc_s: is not a setting of idm: there are ",
        ),
        (
            "--controller acc-aeb --setting ttc_s=3",
            "a range is written as LOW..HIGH, for example ttc_s=0.5..3",
        ),
        (
            "--controller acc-aeb --setting ttc_s=3..2",
            "error: --setting ttc_s: a range must be LOW..HIGH",
        ),
        (
            "--controller idm --space nowhere",
            "`nowhere` is neither a built-in space",
        ),
        ("--controller idm --space paper=x", "`x` is not a weight"),
        (
            "--controller idm --space paper=-1",
            "error: --space paper: the weight must be between 0.000001 and 1000000",
        ),
        (
            "--controller idm --space paper --space paper",
            "error: --space paper: occurs twice: give it one weight",
        ),
        (
            "--controller idm --method halton",
            "invalid value 'halton' for '--method <M>'",
        ),
        (
            "--controller idm --objective fast",
            "invalid value 'fast' for '--objective <O>'",
        ),
        (
            "--controller idm --evaluations 1",
            "must be a whole number from 2 to 10000",
        ),
    ];
    for (arguments, expected) in cases {
        let output = run_crumple(folder.path(), &format!("tune {arguments}"));
        assert_refused(&output, expected);
        assert_eq!(stdout(&output), "", "{arguments}");
    }
    assert_eq!(file_names_in(folder.path()), [""; 0]);
}
