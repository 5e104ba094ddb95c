//! Controllers that give no answer: reports of every result mention them, and draw no false conclusions.

use std::fs;
use std::path::Path;

use crumple_controllers::Controllers;
use crumple_sim::observation::EstimatorKind;
use crumple_suites::{SuiteRunError, TestSuite, run};
use serde_json::Value;

use super::{
    bad_process_folder, driven_by, find_controller, short_scenario, simulate_with_truth,
    write_short_space,
};
use crate::command_line::{exit_code, read_json, run_crumple, stderr, stdout, temp_folder};

/// A controller that keeps its speed, and exits when the gap ahead is below its argument, in whole metres.
const NEAR_SCRIPT: &str = r#"#!/bin/sh
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) printf '%s\n' '{"crumple":1,"name":"near","deterministic":true}' && continue ;;
        *reset*) printf '%s\n' "{\"id\":$id,\"ready\":true}" && continue ;;
    esac
    gap=${line##*'['}
    gap=${gap%%[!0-9]*}
    if [ "$gap" -lt "$1" ]; then
        echo "gap table: index $gap out of range" >&2
        exit 9
    fi
    printf '%s\n' "{\"id\":$id,\"acceleration_mps2\":0}"
done
"#;

/// Creates a folder with a space of short runs, a controller that exits at small gaps, one that never does, one that
/// remembers earlier runs, and two that cannot start.
fn controllers_folder() -> tempfile::TempDir {
    let folder = bad_process_folder("remember", "files = [\"bad.sh\"]");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("near.sh", NEAR_SCRIPT);
    let controller = |command: &str| {
        format!(
            "version = 1\ncommand = {command}\nfiles = [\"near.sh\"]\ninputs = [{{ quantity = \"gap_ahead_m\" }}]\n"
        )
    };
    write("near.toml", &controller("[\"sh\", \"near.sh\", \"24\"]"));
    write("far.toml", &controller("[\"sh\", \"near.sh\", \"0\"]"));
    write("missing.toml", &controller("[\"./no-such-program\"]"));
    write(
        "silent.toml",
        &controller("[\"sh\", \"-c\", \"echo no licence >&2; exit 4\"]"),
    );
    write_short_space(folder.path());
    folder
}

fn run_and_capture(folder: &Path, arguments: &str) -> (i32, String, String) {
    let output = run_crumple(folder, arguments);
    (
        exit_code(&output),
        stdout(&output).to_owned(),
        stderr(&output).to_owned(),
    )
}

const ASSESSMENT: &str = "version = 1\npaper = false\ndistributions = [\"short.toml\"]\ndraws = 8\neveryday_draws = \
    2\ncertificates = []\n\
                        search = { spaces = [\"short.toml\"], budget = 8 }\nrates = { runs = 0 }\n";

#[test]
fn a_program_that_cannot_be_started_is_bad_input_and_nothing_is_run() {
    let folder = controllers_folder();
    let commands = [
        "simulate paper-1 --controller",
        "falsify --space short.toml --budget 3 --out out --controller",
        "falsify --space short.toml --budget 3 --out out --controller idm --against",
        "verify rate --space short.toml --runs 5 --out out --controller",
        "verify rate --space short.toml --runs 5 --out out --controller idm --against",
        "worst-case paper-1 --controller",
        "suite run afgbv-cut-in --controller",
        "explore paper-1 --controller",
        "export paper-1 --to openscenario --out out --controller",
    ];
    for (controller, place, why) in [
        (
            "missing.toml",
            "missing.toml:2: command: ",
            "`./no-such-program` cannot be started: No such file",
        ),
        (
            "silent.toml",
            "silent.toml:2: command: ",
            "ended by itself with exit code 4; its last output: no licence",
        ),
        (
            "exec:./no-such-program",
            "controller `exec:./no-such-program`: ",
            "`./no-such-program` cannot be started: No such file",
        ),
        (
            "shield:missing.toml",
            "missing.toml:2: command: ",
            "cannot be started",
        ),
    ] {
        for command in commands {
            let (code, text, error) =
                run_and_capture(folder.path(), &format!("{command} {controller}"));
            assert_eq!(code, 2, "{command:?} {controller}: {text}{error}");
            assert!(
                error.contains(place) && error.contains(why),
                "{command:?}: {error}"
            );
            assert!(
                text.is_empty() && !folder.path().join("out").exists(),
                "{command:?}: {text}"
            );
        }
        if controller == "missing.toml" {
            let driven = driven_by("missing.toml");
            fs::write(folder.path().join("driven.toml"), driven).unwrap();
            let (code, _, error) =
                run_and_capture(folder.path(), "simulate driven.toml --allow-external");
            assert!(
                code == 2 && error.contains("driven.toml: vehicles[1].driver: "),
                "{error}"
            );
            assert!(error.contains(place) && error.contains(why), "{error}");
        }
        fs::write(
            folder.path().join("a.toml"),
            format!("{ASSESSMENT}controllers = [\"idm\", \"{controller}\"]\n"),
        )
        .unwrap();
        let (code, text, error) = run_and_capture(folder.path(), "assess a.toml --out out");
        assert_eq!(code, 2, "{text}{error}");
        assert!(
            error.contains("a.toml:9: controllers[1]: ") && error.contains(why),
            "{error}"
        );
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn a_search_reports_the_reason_of_a_missing_answer() {
    let folder = controllers_folder();
    let search = "falsify --controller near.toml --space short.toml --budget 10 --out out";
    let (code, text, error) = run_and_capture(folder.path(), search);
    let why = "its last output: gap table: index ";
    assert!(
        code == 0 && text.contains("the controller of vehicle 1 fails") && text.contains(why),
        "{text}{error}"
    );
    let summary = read_json(&folder.path().join("out/summary.json"));
    let reason = |of: &Value| of["reason"].as_str().unwrap_or_default().to_owned();
    assert!(
        reason(&summary["counterexamples"][0]).contains(why),
        "{summary}"
    );
    assert!(
        reason(&summary["failures"][0]).contains("`near` ended by itself with exit code 9"),
        "{summary}"
    );
    assert_eq!(summary["failures"][0]["failed_vehicle"], 1);
    let file = summary["counterexamples"][0]["file"]
        .as_str()
        .unwrap()
        .to_owned();
    let scenario = fs::read_to_string(folder.path().join("out").join(file)).unwrap();
    assert!(scenario.contains(why), "{scenario}");
    let nothing = "falsify --controller far.toml --space short.toml --budget 4 --out none";
    let (code, _, error) = run_and_capture(folder.path(), nothing);
    assert!(code == 0 && !error.contains("counterexamples"), "{error}");
}

#[test]
fn missing_answers_of_the_other_controller_count_for_neither() {
    let folder = controllers_folder();
    let against = |controller: &str, other: &str| {
        let search = "falsify --space short.toml --budget 10 --out out --format";
        let out = run_and_capture(
            folder.path(),
            &format!("{search} text --controller {controller} --against {other}"),
        );
        let summary = read_json(&folder.path().join("out/summary.json"));
        fs::remove_dir_all(folder.path().join("out")).unwrap();
        (out, summary)
    };
    let ((code, text, _), summary) = against("idm", "near.toml");
    assert!(
        code == 0 && text.contains("NOT COMPARED: `near.toml` gave no answer in "),
        "{text}"
    );
    assert!(text.contains("gap table: index"), "{text}");
    let gate = "falsify --space short.toml --budget 10 --out gate --controller idm --against";
    let (code, _, error) =
        run_and_capture(folder.path(), &format!("{gate} near.toml --expect nothing"));
    assert!(
        code == 1 && error.contains("the other controller gave no answer"),
        "{error}"
    );
    let silent = &summary["methods"][1]["second_missing_answers"];
    assert!(
        silent["runs"]
            .as_u64()
            .is_some_and(|runs| (1..10).contains(&runs)),
        "{summary}"
    );
    assert_eq!(
        (&summary["falsified"], &summary["methods"][1]["failures"]),
        (&Value::from(false), &Value::from(0))
    );
    // A controller that fails where the other gives no answer either has not failed in comparison.
    fs::copy(
        folder.path().join("near.toml"),
        folder.path().join("as-near.toml"),
    )
    .unwrap();
    let (_, summary) = against("near.toml", "as-near.toml");
    assert_eq!(summary["falsified"], false, "{summary}");

    let count = |controller: &str, other: Option<&str>, confidence: &str| {
        let rate =
            format!("verify rate --space short.toml --runs 60 --out out --controller {controller}");
        let other = other.map_or(String::new(), |other| format!("--against {other}"));
        let message = run_and_capture(
            folder.path(),
            &format!("{rate} --confidence {confidence} {other}"),
        );
        let tally = read_json(&folder.path().join("out/progress.json"));
        fs::remove_dir_all(folder.path().join("out")).unwrap();
        (message, tally)
    };
    let ((code, text, error), tally) = count("idm", Some("near.toml"), "0.9");
    assert_eq!(
        (code, &tally["only_second_failed"]),
        (1, &Value::from(0)),
        "{text}{error}"
    );
    assert!(
        error.contains("the other controller, whose runs without an answer count for neither, gave no answer in "),
        "{error}"
    );
    let ((code, text, _), tally) = count("near.toml", None, "0.9");
    assert!(
        code == 0 && text.contains("; the controller gave no answer in ") && text.contains("index"),
        "{text}"
    );
    assert!(
        tally["failures"]
            .as_u64()
            .is_some_and(|failures| failures > 0),
        "{tally}"
    );
    // Where the second gives no answer, a failure of the first is not one of both.
    let earlier = fs::read_to_string(folder.path().join("near.toml")).unwrap();
    let earlier = earlier.replace("24", "33");
    fs::write(folder.path().join("earlier.toml"), earlier).unwrap();
    let (_, tally) = count("near.toml", Some("earlier.toml"), "0.6");
    let resumed = "verify rate --space short.toml --runs 60 --out again --controller near.toml --confidence 0.6";
    for resume in ["", " --resume"] {
        let against = format!("{resumed} --against earlier.toml{resume}");
        let (_, text, error) = run_and_capture(folder.path(), &against);
        assert!(!error.contains("belongs to another"), "{text}{error}");
    }
    let counted = ["failures", "only_first_failed", "only_second_failed"].map(|name| &tally[name]);
    assert_eq!(counted, [&Value::from(0); 3], "{tally}");
    let ((_, _, error), tally) = count("near.toml", Some("idm"), "0.9");
    assert!(
        tally["only_first_failed"]
            .as_u64()
            .is_some_and(|failures| failures > 0),
        "{tally}"
    );
    assert!(
        error.contains("; the controller gave no answer in "),
        "{error}"
    );
}

#[test]
fn a_comparison_is_confirmed_by_the_definition_that_counted_it() {
    let folder = controllers_folder();
    let worse = fs::read_to_string(folder.path().join("near.toml"))
        .unwrap()
        .replace("24", "33");
    fs::write(folder.path().join("worse.toml"), worse).unwrap();
    // Both give no answer: that counts against the first, and not in favour of the second.
    let rate = "verify rate --space short.toml --runs 40 --confidence 0.6 --controller near.toml";
    let (code, text, error) = run_and_capture(
        folder.path(),
        &format!("{rate} --out out --against worse.toml"),
    );
    assert_eq!(code, 1, "{text}{error}");
    let (code, text, error) = run_and_capture(folder.path(), &format!("{rate} --out one"));
    assert_eq!(code, 0, "{text}{error}");
    let check = "check one/certificate.json --rerun --controller near.toml";
    let (code, text, error) = run_and_capture(folder.path(), check);
    assert!(code == 0 && text.contains("confirmed"), "{text}{error}");
}

#[test]
fn nothing_is_published_of_a_controller_that_remembers_the_runs_before() {
    let folder = controllers_folder();
    fs::write(
        folder.path().join("a.toml"),
        format!("{ASSESSMENT}controllers = [\"idm\", \"bad.toml\"]\n"),
    )
    .unwrap();
    let commands = [
        "simulate paper-1 paper-2 paper-3 --controller bad.toml",
        "simulate paper-1 paper-2 paper-3 --controller bad.toml --expect collision",
        "simulate paper-1 paper-2 paper-3 --controller shield:bad.toml --trace t.csv",
        "falsify --controller bad.toml --space short.toml --budget 5 --out out",
        "falsify --controller idm --against bad.toml --space short.toml --budget 5 --out out",
        "verify rate --controller bad.toml --space short.toml --runs 9 --out out",
        "suite run afgbv-cut-in --controller bad.toml",
        "worst-case paper-1 --controller bad.toml --budget 20",
        "assess a.toml --out out",
    ];
    for command in commands {
        let (code, text, error) = run_and_capture(folder.path(), command);
        assert_eq!(code, 2, "{command:?}: {text}{error}");
        let expected = [
            "bad.toml` failed during the command",
            "a fresh one -1.1 m/s²: is its state cleared at reset?",
        ];
        assert!(
            expected.iter().all(|expected| error.contains(expected)),
            "{command:?}: {error}"
        );
        assert!(text.is_empty(), "{command:?}: {text}");
        for name in [
            "summary.json",
            "certificate.json",
            "assessment.json",
            "counterexamples",
        ] {
            assert!(
                !folder.path().join("out").join(name).exists(),
                "{command:?}: {name}"
            );
        }
        let _ = fs::remove_dir_all(folder.path().join("out"));
    }
    assert!(
        fs::read_dir(folder.path())
            .unwrap()
            .flatten()
            .all(|file| file.path().extension() != Some("csv".as_ref()))
    );
}

/// A few later runs are also sent twice.
#[test]
fn state_that_appears_late_is_caught() {
    let folder = bad_process_folder("remember-late", "files = [\"bad.sh\"]");
    let controller = find_controller("bad.toml", folder.path());
    let scenario = short_scenario();
    let failed = (0..64).find(|_| {
        simulate_with_truth(&controller.source, &scenario)
            .outcome
            .failed_controller()
            .is_some()
    });
    assert!(failed.is_some_and(|run| run > 4), "{failed:?}");
    assert!(
        controller
            .ensure_trusted()
            .is_err_and(|error| error.to_string().contains("is its state cleared at reset?"))
    );
    assert!(
        find_controller("bad.toml", folder.path())
            .ensure_trusted()
            .is_ok()
    );
}

/// Suites themselves detect a controller that is refused during their runs.
#[test]
fn suites_find_nothing_of_a_controller_that_is_refused() {
    let folder = bad_process_folder("remember", "files = [\"bad.sh\"]");
    let suite = TestSuite::shipped("afgbv-cut-in").unwrap().unwrap();
    let refused = run(
        &suite,
        &[find_controller("bad.toml", folder.path())],
        EstimatorKind::Truth,
    );
    assert!(
        matches!(refused, Err(SuiteRunError::Refused(_))),
        "{refused:?}"
    );
}

/// Fields are found relative to the folder and behind a shield; a bare command has no file.
#[test]
fn a_field_of_a_controller_is_found_in_its_file() {
    let folder = controllers_folder();
    for name in ["near.toml", "shield:near.toml"] {
        let expected = find_controller(name, folder.path()).field_location("files");
        assert_eq!(
            expected,
            folder.path().join("near.toml:3: ").display().to_string()
        );
    }
    assert_eq!(
        find_controller("exec:near", folder.path()).field_location("files"),
        ""
    );
}

#[test]
fn an_assessment_takes_no_answer_for_nothing_but_that() {
    let folder = controllers_folder();
    let suites = "suites = [{ suite = \"afgbv-cut-in\", controllers = [\"near.toml\"] }]\n";
    let gates = [
        "require = \"no-avoidable-failure\"\ncontroller = \"near.toml\"\nspace = \"short.toml\"",
        "require = \"unnecessary-braking-at-most\"\ncontroller = \"near.toml\"\npercent = 5",
        "require = \"left-behind-at-most\"\ncontroller = \"near.toml\"\npercent = 5",
        "require = \"string-stable\"\ncontroller = \"near.toml\"",
        "require = \"suite-passed\"\ncontroller = \"near.toml\"\nsuite = \"afgbv-cut-in\"",
        "require = \"rate-not-above\"\ncontroller = \"idm\"\nthan = \"near.toml\"",
    ];
    let gates: String = gates
        .iter()
        .map(|gate| format!("[[gates]]\n{gate}\n"))
        .collect();
    // It fails in every drive, and immediately in most.
    let near = fs::read_to_string(folder.path().join("near.toml"))
        .unwrap()
        .replace("\"24\"", "\"900\"");
    fs::write(folder.path().join("near.toml"), near).unwrap();
    let config = format!(
        "{ASSESSMENT}controllers = [\"near.toml\", \"idm\"]\nsubject = \"near.toml\"\n\
         harm = {{ emergencies_per_hour = 1 }}\n{suites}{gates}"
    );
    fs::write(folder.path().join("a.toml"), config).unwrap();
    let (code, text, error) = run_and_capture(folder.path(), "assess a.toml --out out");
    assert_eq!(code, 1, "{text}{error}");
    let report = read_json(&folder.path().join("out/assessment.json"));
    let held: Vec<_> = report["summary"]["gates"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|gate| gate["holds"] == true)
        .collect();
    assert!(held.is_empty(), "{held:?}");
    let drawn = &report["rate_spaces"]["spaces"][0]["controllers"][0];
    assert_eq!(
        (&drawn["collisions"], &drawn["unanswered"]["runs"]),
        (&Value::from(0), &Value::from(8)),
        "{drawn}"
    );
    let harm = &report["harm"]["groups"][0]["controllers"][0];
    assert_eq!(harm["unanswered"], 8, "{harm}");
    let own = &report["usefulness"]["controllers"][0];
    assert_eq!(
        (&own["unnecessary_braking"], &own["unanswered"][0]["runs"]),
        (&Value::from(0), &Value::from(2)),
        "{own}"
    );
    // Drives without an answer are no hours without unnecessary braking.
    assert_eq!(
        own["unnecessary_braking_rates"],
        serde_json::json!([]),
        "{own}"
    );
    assert_eq!(
        own["oscillation_gain"]["unanswered"]["runs"], own["oscillation_gain"]["points"],
        "{own}"
    );
    let tested = &report["suites"]["suites"][0]["tests"][0]["outcomes"][0];
    assert_eq!(tested["unanswered"]["runs"], tested["points"], "{tested}");
    assert!(
        tested["unanswered"]["reason"]
            .as_str()
            .unwrap()
            .contains("gap table: index"),
        "{tested}"
    );
    let gates = report["summary"]["gates"].as_array().unwrap();
    let of_suite = gates
        .iter()
        .find(|gate| gate["gate"].as_str().unwrap().contains("afgbv-cut-in"))
        .unwrap();
    assert!(
        of_suite["reason"]
            .as_str()
            .unwrap()
            .contains("; it gave no answer in "),
        "{of_suite}"
    );
    let claims = report["summary"]["claims"].as_array().unwrap();
    let of_suite = claims
        .iter()
        .find(|claim| claim["part"] == "suites")
        .unwrap();
    assert_eq!(of_suite["statuses"][0]["basis"], "unanswered", "{of_suite}");
    for claim in report["summary"]["claims"].as_array().unwrap() {
        let (words, standing) = (claim["claim"].as_str().unwrap(), &claim["statuses"][0]);
        let of_driving = [
            "no unnecessary braking",
            "never falls behind",
            "largest gain",
        ];
        match of_driving.iter().any(|driving| words.starts_with(driving)) {
            true => assert_eq!(
                (&standing["basis"], &standing["refutes"]),
                (&"unanswered".into(), &false.into()),
                "{words}"
            ),
            false => assert_ne!(standing["basis"], "tested", "{words}: {standing}"),
        }
    }
    let markdown = fs::read_to_string(folder.path().join("out/assessment.md")).unwrap();
    assert!(!markdown.contains("NaN"), "{markdown}");
    let page = fs::read_to_string(folder.path().join("out/assessment.html")).unwrap();
    assert!(page.contains("Failure rate and its exact bounds"));
    for why in [
        "gap table: index",
        "gave no answer in 8 of 8",
        "never falls behind in 2 random scenarios of `traffic` (seed 0)",
        "only near.toml fails",
        "`near.toml` gave no answer in 8 drives, which its row leaves out. Comparisons with it",
        "| near.toml | – | – |",
    ] {
        assert!(markdown.contains(why), "{why}: {markdown}");
    }
    assert!(
        text.contains("gap table: index") && !text.contains("collision in 8 random scenarios"),
        "{text}"
    );
    assert!(
        !markdown.contains("more-than-once")
            && !text.contains("unnecessary braking in 2 of 2 random scenarios of `traffic`")
    );
}

#[test]
fn a_worst_case_without_an_answer_has_no_margin() {
    let folder = controllers_folder();
    let attack = "worst-case paper-1 --controller near.toml --budget 60";
    let (code, text, error) = run_and_capture(folder.path(), attack);
    assert!(
        code == 0 && text.contains("CONTROLLER FAILED") && text.contains("gap table: index"),
        "{text}{error}"
    );
    assert!(
        !text.contains("margin") && !text.contains("optimum"),
        "{text}"
    );
    let (_, text, _) = run_and_capture(folder.path(), &format!("{attack} --format json"));
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (&report["margin_m"], &report["method"], &report["found"]),
        (&Value::Null, &Value::Null, &true.into())
    );
}

/// A controller that gives no answer causes no collision, and is not run again with each fault.
#[test]
fn sensor_faults_of_a_controller_without_an_answer_are_not_searched() {
    let folder = controllers_folder();
    let attack = "worst-case paper-1 --controller near.toml --attack sensors --out w.toml";
    let (code, text, error) = run_and_capture(folder.path(), attack);
    for part in [
        "CONTROLLER FAILED and gave no answer in 1 of 1 simulations; the first: ",
        "gap table: index",
        "no fault was simulated",
    ] {
        assert!(text.contains(part), "{text}{error}");
    }
    assert!(
        !text.contains("collision") && !folder.path().join("w.toml").exists(),
        "{code}: {text}"
    );
    let (_, text, _) = run_and_capture(
        folder.path(),
        &attack.replace("--out w.toml", "--format json"),
    );
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["missing_answers"]["runs"], 1, "{report}");
    assert_eq!(report["mildest_collision"], Value::Null, "{report}");
    assert_eq!(report["fails_without_fault"], true, "{report}");
}

/// The error for a program, or for its source, explains how to name it.
#[test]
fn an_invalid_controller_file_gets_instructions() {
    let folder = temp_folder();
    for (name, expected) in [
        (
            "aeb",
            "is a file without an extension, not a controller: run a program with `exec:./aeb`",
        ),
        (
            "aeb.c",
            "is source code, not a controller: run a program with `exec:./aeb`",
        ),
        ("libaeb.so", "a shared library"),
        ("aeb.py", "`exec:python3 aeb.py`"),
    ] {
        fs::write(folder.path().join(name), "int main(void) {}").unwrap();
        let error = Controllers::default()
            .find(name, folder.path())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(expected) && error.contains("controller file"),
            "{error}"
        );
    }
    assert!(
        Controllers::default()
            .find("./none", folder.path())
            .unwrap_err()
            .to_string()
            .contains("there is no controller")
    );
}
