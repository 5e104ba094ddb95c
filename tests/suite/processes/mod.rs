//! Controllers that are processes: their errors end runs, and no process remains.

mod unanswered;

use crumple_controllers::{Controllers, ExternalPrograms};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crumple_controllers::find_for_user;
use crumple_report::assessment::AssessmentPlan;
use crumple_sim::control::{ControllerSource, IntoSource};
use crumple_sim::engine::{
    NamedController, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
    simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, Scenario, built_in_scenario, file};
use crumple_spaces::built_in_space;

use crate::command_line::{
    assert_refused, json_objects, run_crumple, spawn, stderr, stdout, temp_folder,
};
use crate::tiny::assert_contains;

const BAD_SCRIPT: &str = include_str!("bad.sh");

fn bad_process_folder(what: &str, files: &str) -> tempfile::TempDir {
    let folder = temp_folder();
    fs::write(folder.path().join("bad.sh"), BAD_SCRIPT).unwrap();
    let mark = folder.path().display();
    let text = format!(
        "version = 1\ncommand = [\"sh\", \"bad.sh\", \"{what}\", \"{mark}\"]\n{files}\nstart_within_s = \
         3.0\nanswer_within_s = 0.4\n"
    );
    fs::write(folder.path().join("bad.toml"), text).unwrap();
    folder
}

const LISTED_FILES: &str = "files = [\"bad.sh\"]";

pub(crate) fn find_controller(name: &str, folder: &Path) -> NamedController {
    find_for_user(name, folder).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn simulate_with_truth(
    controller: &Arc<dyn ControllerSource>,
    scenario: &Scenario,
) -> SimulationResult {
    let options = RunOptions::new(controller.clone()).with_estimator(EstimatorKind::Truth);
    simulate(&Run::new(scenario, options).unwrap(), RecordingLevel::Trace)
}

/// Answers 3 m/s² to everything, and writes the questions to a file.
const THROTTLE_SCRIPT: &str = r#"
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) printf '%s\n' '{"crumple":1,"name":"throttle","deterministic":false}' ;;
        *reset*) printf '%s\n' "{\"id\":$id,\"ready\":true}" ;;
        *) printf '%s\n' "$line" >>questions && printf '%s\n' "{\"id\":$id,\"acceleration_mps2\":3}" ;;
    esac
done
"#;

/// Warns always, and brakes never.
const WARNING_SCRIPT: &str = r#"
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) printf '%s\n' '{"crumple":1,"name":"warning","deterministic":true,"warns":true}' ;;
        *reset*) printf '%s\n' "{\"id\":$id,\"ready\":true}" ;;
        *) printf '%s\n' "{\"id\":$id,\"acceleration_mps2\":0,\"warning\":true}" ;;
    esac
done
"#;

/// The test driver brakes after the warning of a process. A promised warning that is missing is a failure.
#[test]
fn the_test_driver_brakes_after_the_warning_of_a_process() {
    let folder = temp_folder();
    let script = folder.path().join("warning.sh");
    fs::write(&script, WARNING_SCRIPT.trim_start()).unwrap();
    let name = "test-driver,brake_mps2=4,ramp_s=0,delay_s=0.5:exec:sh warning.sh";
    let controller = find_controller(name, folder.path());
    assert!(controller.source.reports_warnings());
    let scenario = built_in_scenario("paper-1").unwrap();
    let simulated = simulate_with_truth(&controller.source, &scenario);
    let own = &simulated.trace.as_ref().unwrap().vehicles[1];
    assert_eq!(own.acceleration_mps2[49..51], [0.0, -4.0]);
    for shield in ["shield", "shield2"] {
        let shielded =
            format!("test-driver,brake_mps2=4,ramp_s=0,delay_s=0.5:{shield}:exec:sh warning.sh");
        let controller = find_controller(&shielded, folder.path());
        let simulated = simulate_with_truth(&controller.source, &scenario);
        let own = &simulated.trace.as_ref().unwrap().vehicles[1];
        assert!(own.acceleration_mps2[50] <= -4.0, "{shield}");
    }
    let silent = WARNING_SCRIPT.replace(",\\\"warning\\\":true}", "}");
    fs::write(&script, silent.trim_start()).unwrap();
    let controller = find_controller(name, folder.path());
    let failed = simulate_with_truth(&controller.source, &scenario).outcome;
    let reason = failed.failed_controller().expect("a failure").reason();
    assert!(reason.contains("lacks `warning`"), "{reason}");
}

/// The input `last_answer_mps2` of a process is the command that its shield gave in place of the answer.
#[test]
fn a_process_learns_of_the_commands_that_its_shield_replaces() {
    let folder = temp_folder();
    let controller = "version = 1\ncommand = [\"sh\", \"throttle.sh\"]\ninputs = [{ quantity = \
                      \"last_answer_mps2\" }]\n";
    fs::write(
        folder.path().join("throttle.sh"),
        THROTTLE_SCRIPT.trim_start(),
    )
    .unwrap();
    fs::write(folder.path().join("throttle.toml"), controller).unwrap();
    let scenario = built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.vehicles.truncate(2))
        .unwrap();
    let result = simulate_with_truth(
        &find_controller("shield:throttle.toml", folder.path()).source,
        &scenario,
    );
    let questions = fs::read_to_string(folder.path().join("questions")).unwrap();
    let seen: Vec<&str> = questions
        .lines()
        .map(|line| line.split_once("\"see\":[").unwrap().1)
        .collect();
    let steps = |time_s: f64| (time_s / 0.01).round() as usize;
    assert!(
        !result.interventions.is_empty() && seen.len() > 500,
        "{}",
        seen.len()
    );
    assert!(seen[0].starts_with('0'), "{}", seen[0]);
    for (step, seen) in seen.iter().enumerate().skip(1) {
        let is_replaced = result.interventions.iter().any(|intervention| {
            (steps(intervention.from_s)..steps(intervention.to_s)).contains(&(step - 1))
        });
        assert_eq!(
            *seen,
            if is_replaced { "-7.5]}" } else { "3.0]}" },
            "step {step}"
        );
    }
}

fn running_processes(mark: &str) -> Vec<String> {
    let Ok(all) = fs::read_dir("/proc") else {
        return Vec::new();
    };
    let commands = all
        .flatten()
        .filter_map(|entry| fs::read(entry.path().join("cmdline")).ok());
    let commands = commands.map(|command| String::from_utf8_lossy(&command).replace('\0', " "));
    commands.filter(|command| command.contains(mark)).collect()
}

/// Asserts that the processes end; the system takes a moment.
fn assert_no_process_remains(mark: &str) {
    let end = Instant::now() + Duration::from_secs(20);
    while !running_processes(mark).is_empty() {
        assert!(Instant::now() < end, "{:?}", running_processes(mark));
        sleep(Duration::from_millis(20));
    }
}

fn short_scenario() -> Scenario {
    built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.duration_s = 1.0)
        .unwrap()
}

/// Returns the file of a short scenario, which names the file of its driver.
fn driven_by(controller: &str) -> String {
    let driver = format!("{{ file = {{ path = \"{controller}\" }} }}");
    file::to_toml(&short_scenario())
        .unwrap()
        .replace("\"under-test\"", &driver)
}

fn write_short_space(folder: &Path) {
    fs::write(
        folder.join("base.toml"),
        file::to_toml(&short_scenario()).unwrap(),
    )
    .unwrap();
    let space = "version = 1\nname = \"short\"\nbase = \"base.toml\"\n\n[[parameters]]\nname = \"gap_m\"\nfield \
        = \"vehicles[1].gap_m\"\n\
                 unit = \"m\"\ndistribution.uniform = { low = 15.0, high = 40.0 }\n";
    fs::write(folder.join("short.toml"), space).unwrap();
}

/// Each error ends the run in which it happens. The message has the vehicle, the time, the reason and the last output.
#[test]
fn any_process_error_ends_the_run() {
    let cases = [
        (
            "end-early",
            0.0,
            "`sh bad.sh end-early",
            "ended by itself with exit code 3",
        ),
        (
            "sleep-early",
            0.0,
            "`sh bad.sh sleep-early",
            "gave no answer within 3 s",
        ),
        (
            "babble",
            0.0,
            "`sh bad.sh babble",
            "answered `hello`, which is not a valid answer: a line is a JSON object",
        ),
        (
            "list",
            0.0,
            "`sh bad.sh list",
            "which is not a valid answer: a line is a JSON object",
        ),
        (
            "other-version",
            0.0,
            "`sh bad.sh",
            "speaks version 2 of the protocol, and crumple speaks 1",
        ),
        (
            "other-inputs",
            0.0,
            "`sh bad.sh",
            "expects 7 inputs, and crumple sends 10",
        ),
        (
            "negative-interval",
            0.0,
            "`sh bad.sh",
            "decides every -1 s, which is not a positive time",
        ),
        (
            "odd-interval",
            0.0,
            "`bad`",
            "decides every 0.015 s, which is not a multiple of the scenario's step of 0.01 s",
        ),
        ("not-ready", 0.0, "`bad`", "it is not ready"),
        (
            "miscount",
            0.0,
            "`bad`",
            "gave 2 answers, and was asked for 1",
        ),
        ("crash", 0.03, "`bad`", "ended by signal 11"),
        ("end", 0.03, "`bad`", "ended by itself with exit code 7"),
        ("sleep", 0.03, "`bad`", "gave no answer within 0.4 s"),
        ("fork", 0.03, "`bad`", "ended by itself with exit code 7"),
        ("close", 0.03, "`bad`", "closed its pipes"),
        (
            "flood",
            0.03,
            "`bad`",
            "wrote more than 1048576 bytes without the end of a line",
        ),
        (
            "chatter",
            0.04,
            "`bad`",
            "answered question 5 where it was asked question 6",
        ),
        (
            "not-a-number",
            0.03,
            "`bad`",
            "answered with a number that is not finite",
        ),
        (
            "exceed",
            0.03,
            "`bad`",
            "answered 31 m/s², which is outside its range of -30 to 30 m/s²",
        ),
        (
            "leave-out",
            0.03,
            "`bad`",
            "which is not a valid answer: missing field `acceleration_mps2`",
        ),
        ("stay", f64::INFINITY, "", ""),
    ];
    let scenario = short_scenario();
    for (what, time_s, who, why) in cases {
        let folder = bad_process_folder(what, LISTED_FILES);
        let controller = find_controller("bad.toml", folder.path()).source;
        match simulate_with_truth(&controller, &scenario).outcome {
            Outcome::ControllerFailed(failed) => {
                let message = failed.to_string();
                assert!(
                    message.contains(who) && message.contains(why),
                    "{what}: {message}"
                );
                assert!(
                    failed.vehicle == 1 && (failed.time_s - time_s).abs() < 1e-9,
                    "{what}: {message}"
                );
                let last = if time_s > 0.0 {
                    format!("its last output: will {what}")
                } else {
                    String::new()
                };
                assert!(message.contains(&last), "{what}: {message}");
                serde_json::to_string(&failed).unwrap();
            }
            other => assert!(who.is_empty(), "{what}: {other:?}"),
        }
        drop(controller);
        assert_no_process_remains(&folder.path().display().to_string());
    }
    let failed = simulate_with_truth(
        &find_controller("exec:no-such-command-anywhere", Path::new("")).source,
        &scenario,
    )
    .outcome;
    let message = failed.failed_controller().unwrap().to_string();
    assert_contains(
        &message,
        &["failed at 0.00 s: `no-such-command-anywhere` cannot be started: No such file"],
    );
    assert!(find_for_user("exec:sh 'open", Path::new("")).is_err());
    assert!(find_for_user("exec:", Path::new("")).is_err());
}

pub(crate) fn draw_scenarios(seed: u64, count: u64) -> Vec<Scenario> {
    let space = built_in_space("high-risk").unwrap();
    (0..count)
        .map(|index| {
            space
                .draw(seed, index)
                .unwrap()
                .edited(|spec| spec.duration_s = 3.0)
                .unwrap()
        })
        .collect()
}

pub(crate) fn simulate_in_lockstep(
    controller: &Arc<dyn ControllerSource>,
    scenarios: &[Scenario],
) -> Vec<SimulationResult> {
    let options = RunOptions::new(controller.clone()).with_estimator(EstimatorKind::Truth);
    let runs: Vec<_> = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()).unwrap())
        .collect();
    simulate_batch(&runs, RecordingLevel::Trace, |_, simulated| simulated)
}

const EXAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/controllers");

/// Creates a folder with the examples; prints a message and returns `None` without Python.
fn python_example_folder() -> Option<tempfile::TempDir> {
    if !Command::new("python3")
        .arg("--version")
        .output()
        .is_ok_and(|output| output.status.success())
    {
        println!("skipped: there is no python3");
        return None;
    }
    let folder = temp_folder();
    for name in ["follower.py", "follower.toml", "follower.c"] {
        fs::copy(Path::new(EXAMPLES).join(name), folder.path().join(name)).unwrap();
    }
    Some(folder)
}

/// Python in batches, Python run by run, and C give the same answers, in both engines.
#[test]
fn the_examples_drive_alike() {
    let Some(folder) = python_example_folder() else {
        return;
    };
    let mut commands = vec!["exec:python3 follower.py", "exec:python3 follower.py alone"];
    let compiled = Command::new("cc")
        .args(["-O2", "-o", "follower", "follower.c", "-lm"])
        .current_dir(folder.path())
        .output();
    match compiled {
        Ok(compiled) if compiled.status.success() => commands.push("exec:./follower"),
        _ => println!("skipped follower.c: there is no C compiler"),
    }
    let scenarios = draw_scenarios(3, 30);
    let first = simulate_in_lockstep(
        &find_controller(commands[0], folder.path()).source,
        &scenarios,
    );
    for command in commands {
        let controller = find_controller(command, folder.path()).source;
        assert_eq!(
            simulate_in_lockstep(&controller, &scenarios),
            first,
            "{command}"
        );
        assert_eq!(
            simulate_with_truth(&controller, &scenarios[3]),
            first[3],
            "{command}"
        );
    }
    let controller = find_controller("follower.toml", folder.path()).source;
    assert!(
        simulate_with_truth(&controller, &built_in_scenario("paper-1").unwrap())
            .outcome
            .is_safe()
    );
}

/// The first runs are sent twice; after a contradiction the process is not started again.
#[test]
fn false_claims_of_determinism_are_caught_within_two_runs() {
    for (what, caught_in_run) in [("differ", 0), ("remember", 1)] {
        let folder = bad_process_folder(what, LISTED_FILES);
        let controller = find_controller("bad.toml", folder.path()).source;
        for run in 0..4 {
            let outcome = simulate_with_truth(&controller, &short_scenario()).outcome;
            let message = outcome
                .failed_controller()
                .map(ToString::to_string)
                .unwrap_or_default();
            let is_caught =
                message.contains("declares that it is deterministic, but to the same observations");
            assert_eq!(is_caught, run >= caught_in_run, "{what} {run}: {message}");
        }
    }
}

#[test]
fn declared_nondeterminism_is_marked() {
    let own = bad_process_folder("admit", LISTED_FILES);
    let failed = simulate_with_truth(
        &find_controller("bad.toml", own.path()).source,
        &short_scenario(),
    )
    .outcome;
    assert!(
        failed
            .failed_controller()
            .unwrap()
            .to_string()
            .contains("set `deterministic = false` in its controller file")
    );
    let folder = bad_process_folder("admit", &format!("{LISTED_FILES}\ndeterministic = false"));
    let simulated = run_crumple(
        folder.path(),
        "simulate paper-1 --controller bad.toml --format json",
    );
    let report = &json_objects(&simulated)[0];
    assert_eq!(report["nondeterministic"], true, "{report}");
    let text = run_crumple(
        folder.path(),
        "simulate paper-1 --controller 'exec:sh bad.sh admit'",
    );
    assert_contains(
        stdout(&text),
        &["the controller declares that it is not deterministic"],
    );
    write_short_space(folder.path());
    let search = "falsify --controller bad.toml --space short.toml --budget 3 --format json";
    let summary = run_crumple(folder.path(), search);
    assert_eq!(json_objects(&summary)[0]["nondeterministic"], true);
}

#[test]
fn controllers_without_listed_files_are_not_resumed_certified_or_cached() {
    let folder = bad_process_folder("be good", "");
    let refused = |arguments: &str, message: &str| {
        assert_refused(&run_crumple(folder.path(), arguments), message)
    };
    for controller in ["bad.toml", "exec:sh bad.sh"] {
        refused(
            &format!("falsify --controller '{controller}' --resume"),
            "states no identity",
        );
        refused(
            &format!("verify rate --controller '{controller}' --runs 5"),
            "states no identity",
        );
    }
    let text = driven_by("bad.toml");
    fs::write(folder.path().join("driven.toml"), text).unwrap();
    let message = "has no identity: the driver of a scenario must list its `files`";
    refused("simulate driven.toml --allow-external", message);
    let config = "version = 1\npaper = false\ncontrollers = [\"idm\", \"exec:sh bad.sh\"]\n";
    fs::write(folder.path().join("a.toml"), config).unwrap();
    let plan = AssessmentPlan::load(&folder.path().join("a.toml"), Controllers::default())
        .unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(
        plan.first_without_identity()
            .map(|unknown| unknown.name.as_str()),
        Some("exec:sh bad.sh")
    );
}

#[test]
fn a_scenario_may_have_a_process_as_a_driver() {
    let controllers = Controllers {
        external: ExternalPrograms::Allowed,
    };
    let folder = bad_process_folder("be good", LISTED_FILES);
    let text = driven_by("bad.toml");
    let driven = file::from_toml(&text, &folder.path().join("driven.toml"), &controllers)
        .unwrap_or_else(|error| panic!("{error}"));
    assert!(matches!(&driven.vehicles()[1].driver, Driver::File(_)));
    let under_test = simulate_with_truth(
        &find_controller("bad.toml", folder.path()).source,
        &short_scenario(),
    );
    let idm = crumple_sim::control::BuiltInController::from_name("idm").unwrap();
    assert_eq!(simulate_with_truth(&idm.into_source(), &driven), under_test);
}

#[test]
fn controller_files_of_commands_are_refused_by_file_line_and_field() {
    let folder = bad_process_folder("be good", LISTED_FILES);
    let whole = fs::read_to_string(folder.path().join("bad.toml")).unwrap();
    let cases = [
        (
            "command = [\"sh\", ",
            "command = [] # ",
            "bad.toml:2: command: must be a program",
        ),
        (
            "[\"bad.sh\"]",
            "[\"none.sh\"]",
            "bad.toml:3: files[0]: none.sh: No such file",
        ),
        (
            "[\"bad.sh\"]",
            "[\".\"]",
            "bad.toml:3: files[0]: .: is not a regular file",
        ),
        (
            "answer_within_s = 0.4",
            "answer_within_s = 0",
            "bad.toml:5: answer_within_s: must be above 0",
        ),
        (
            "version = 1",
            "version = 1\nnetwork = \"a.onnx\"",
            "bad.toml:3: command: `network` is given already: keep one of them",
        ),
        (
            "files",
            "[output]\nanswer = 1\nlow_mps2 = -1\nhigh_mps2 = 1\n[[inputs]]\nconstant = 1 #",
            "bad.toml:4: output.answer: must be 0",
        ),
        (
            "command",
            "# ",
            "bad.toml:1: version: one of `built_in`, `network`, `fmu` and `command` is required",
        ),
    ];
    for (was, is, message) in cases {
        assert!(whole.contains(was), "{was}");
        let mut text = whole.replacen(was, is, 1);
        if is.starts_with("[output]") {
            text = text
                .replace("start_within_s", "# ")
                .replace("answer_within_s", "# ");
        }
        fs::write(folder.path().join("bad.toml"), text).unwrap();
        let error = find_for_user("bad.toml", folder.path())
            .expect_err(is)
            .to_string();
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
}

/// The identity covers everything that affects the answers, and the files must not change during use.
#[test]
fn the_identity_of_a_process_is_that_of_its_files() {
    let folder = bad_process_folder("be good", LISTED_FILES);
    let path = folder.path().join("bad.sh");
    let controller = find_controller("bad.toml", folder.path()).source;
    assert_eq!(
        controller.identity(),
        find_controller("bad.toml", folder.path()).source.identity()
    );
    fs::write(&path, format!("{BAD_SCRIPT}\n# changed\n")).unwrap();
    assert_ne!(
        controller.identity(),
        find_controller("bad.toml", folder.path()).source.identity()
    );
    let message = simulate_with_truth(&controller, &short_scenario())
        .outcome
        .failed_controller()
        .unwrap()
        .to_string();
    assert!(
        message.contains("cannot be started again: bad.sh has changed since it was read"),
        "{message}"
    );
}

/// The system closes the pipes of the watchdogs, however crumple ends.
#[cfg(target_os = "linux")]
#[test]
fn nothing_stays_behind_a_kill() {
    let folder = bad_process_folder("sleep", LISTED_FILES);
    let mark = folder.path().display().to_string();
    let text = fs::read_to_string(folder.path().join("bad.toml"))
        .unwrap()
        .replace("0.4", "600.0");
    fs::write(folder.path().join("bad.toml"), text).unwrap();
    let mut killed = spawn(folder.path(), "simulate paper-1 --controller bad.toml");
    let watchdogs = format!("crumple-watchdog-{}", killed.id());
    // Two processes that are sent the same queries, each with a lingering child.
    let end = Instant::now() + Duration::from_secs(60);
    while running_processes(&mark).len() < 3 {
        assert!(Instant::now() < end, "{:?}", running_processes(&mark));
        sleep(Duration::from_millis(20));
    }
    assert_eq!(running_processes(&watchdogs).len(), 2);
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_no_process_remains(&mark);
    assert_no_process_remains(&watchdogs);
}

/// Runs share one process per vehicle and thread; runs that fail leave none either.
#[cfg(target_os = "linux")]
#[test]
fn ten_thousand_runs_leave_no_process_and_no_descriptor() {
    let Some(folder) = python_example_folder() else {
        return;
    };
    let mark = folder.path().display().to_string();
    write_short_space(folder.path());
    let text = fs::read_to_string(folder.path().join("follower.toml")).unwrap();
    let alone = text.replace(
        "\"follower.py\"]\nfiles",
        &format!("\"follower.py\", \"alone\", \"{mark}\"]\nfiles"),
    );
    fs::write(folder.path().join("alone.toml"), alone).unwrap();
    fs::write(folder.path().join("bad.sh"), BAD_SCRIPT).unwrap();
    let crash = format!(
        "version = 1\ncommand = [\"sh\", \"bad.sh\", \"end\", \"{mark}\"]\nfiles = [\"bad.sh\"]\n"
    );
    fs::write(folder.path().join("crash.toml"), crash).unwrap();
    for (controller, runs) in [("alone.toml", "10000"), ("crash.toml", "200")] {
        // Four descriptors for each of at most four processes: two threads, with a second process each in the first
        // runs.
        let script = "ulimit -n 64; exec \"$0\" \"$@\"";
        let count = format!(
            "verify rate --controller {controller} --space short.toml --estimator truth --runs {runs}"
        );
        let count = format!("{count} --confidence 0.9 --out {runs}");
        let mut counted = Command::new("sh");
        counted
            .args(["-c", script, env!("CARGO_BIN_EXE_crumple")])
            .args(count.split(' '));
        counted
            .env("RAYON_NUM_THREADS", "2")
            .current_dir(folder.path());
        let counted = counted.output().unwrap();
        let message = format!("{}{}", stderr(&counted), stdout(&counted));
        let expected = if controller == "crash.toml" {
            "200 failures in 200 runs"
        } else {
            "0 failures in 10000 runs"
        };
        assert!(message.contains(expected), "{message}");
        assert_no_process_remains(&mark);
    }
    let complete = run_crumple(folder.path(), "fsck 200");
    let message = stdout(&complete);
    assert!(
        message.starts_with("200: a count, complete;"),
        "all is counted, though nothing is shown: {message}"
    );
}
