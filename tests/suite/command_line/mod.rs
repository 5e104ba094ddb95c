//! The command line: printed text, written files and exit codes.

mod bad_input;
mod certificates;
mod drives;
mod exchange;
pub(crate) mod falsify;
mod fit;
mod import_openscenario;
mod library_results;
mod new;
mod output_folders;
mod outputs;
mod printed_text;
mod reports;
mod retrain;
mod shell;
mod train;
mod tune;
mod verify;
mod worst_case;

use std::collections::BTreeSet;
use std::fs;
use std::ops::Range;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use crumple_core::digest::sha256;
use crumple_exchange::recording::{READS_MDF, READS_PARQUET};
use crumple_report::draw::WRITES_PNG;
use crumple_report::export::WRITES_PARQUET;
use crumple_sim::control::{BuiltInController, CONTROLLERS_FOR_TESTS};
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use crate::tiny::{self, assert_contains, replace_passages};

/// Returns the subcommands that a `--help` output lists between usage and options.
pub(crate) fn listed_subcommands(help: &Output) -> BTreeSet<String> {
    let text = stdout(help);
    let listed = text
        .split("\nOptions:")
        .next()
        .and_then(|before| before.split("Usage:").nth(1))
        .unwrap();
    let lines = listed.lines().filter_map(|line| line.strip_prefix("  "));
    let names = lines.filter(|line| line.starts_with(|first: char| first.is_ascii_lowercase()));
    names
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

/// Runs `crumple` in a folder, with arguments that are written as in a shell.
pub(crate) fn run_crumple(folder: &Path, arguments: &str) -> Output {
    command(folder, arguments).output().expect("starts")
}

pub(crate) fn run_ok(folder: &Path, arguments: &str) -> Output {
    let output = run_crumple(folder, arguments);
    assert_eq!(exit_code(&output), 0, "{arguments}: {}", stderr(&output));
    output
}

pub(crate) fn command(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
    command
        .current_dir(folder)
        .args(shlex::split(arguments).expect("closed quotes"))
        .env("NO_COLOR", "1");
    command
}

pub(crate) fn run_on_threads(folder: &Path, threads: &str, arguments: &str) -> Output {
    command(folder, arguments)
        .env("RAYON_NUM_THREADS", threads)
        .output()
        .expect("starts")
}

/// Starts a command whose output is read later.
pub(crate) fn spawn(folder: &Path, arguments: &str) -> Child {
    command(folder, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts")
}

/// Presses Ctrl-C.
pub(crate) fn interrupt(child: Child) -> Output {
    let interrupted = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill is there");
    assert!(interrupted.success());
    child.wait_with_output().expect("ends")
}

pub(crate) fn exit_code(output: &Output) -> i32 {
    output.status.code().expect("not ended by a signal")
}

pub(crate) fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).expect("text")
}

pub(crate) fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).expect("text")
}

/// Checks the exit code, and that standard output contains some passages.
#[track_caller]
pub(crate) fn assert_prints(output: &Output, code: i32, passages: &[&str]) {
    assert_eq!(
        exit_code(output),
        code,
        "{}{}",
        stdout(output),
        stderr(output)
    );
    assert_contains(stdout(output), passages);
}

/// Checks the exit code, and that standard error contains a passage.
#[track_caller]
pub(crate) fn assert_reports(output: &Output, code: i32, passage: &str) {
    assert_eq!(
        exit_code(output),
        code,
        "{}{}",
        stdout(output),
        stderr(output)
    );
    assert_contains(stderr(output), &[passage]);
}

#[track_caller]
pub(crate) fn assert_refused(output: &Output, message: &str) {
    assert_reports(output, 2, message);
}

pub(crate) fn json_objects(output: &Output) -> Vec<Value> {
    stdout(output)
        .lines()
        .map(|line| serde_json::from_str(line).expect("one object a line"))
        .collect()
}

pub(crate) fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).expect("readable")).expect("JSON")
}

pub(crate) fn temp_folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a place for temporary files")
}

pub(crate) fn file_names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("readable");
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

const PAPER_SCENARIOS: [&str; 3] = ["paper-1", "paper-2", "paper-3"];

/// One object per scenario and line, with the fields that other programs use, and no other output.
#[test]
fn simulate_prints_one_json_object_a_line() {
    let folder = temp_folder();
    let arguments = "simulate --controller baseline --estimator truth --format json";
    let output = run_crumple(
        folder.path(),
        &format!("{arguments} {}", PAPER_SCENARIOS.join(" ")),
    );
    assert_eq!((exit_code(&output), stderr(&output)), (0, ""));
    let mut reports = json_objects(&output);
    let total = reports.pop().expect("a total");
    assert!(
        total["total"].is_object() || total["total"].is_u64(),
        "{total}"
    );
    assert_eq!(
        reports
            .iter()
            .map(|report| report["scenario"].clone())
            .collect::<Vec<_>>(),
        PAPER_SCENARIOS
    );
    for report in &reports {
        assert_eq!(report["controller"], "baseline");
        assert_eq!(report["estimator"], "truth");
        assert_eq!(
            (&report["dt_s"], &report["seed"]),
            (&json!(0.01), &json!(0))
        );
        assert_eq!(report["outcome"]["kind"], "collision");
        assert_eq!(
            (
                &report["outcome"]["front_vehicle"],
                &report["outcome"]["rear_vehicle"]
            ),
            (&json!(1), &json!(2))
        );
        for number in [
            "time_s",
            "front_speed_mps",
            "rear_speed_mps",
            "impact_speed_mps",
        ] {
            assert!(
                report["outcome"][number]
                    .as_f64()
                    .is_some_and(|number| number > 0.0),
                "{number} in {report}"
            );
        }
        let vehicles = report["vehicles"].as_array().expect("one entry a vehicle");
        assert_eq!(
            vehicles[0]["min_gap_m"],
            Value::Null,
            "no vehicle is ahead of the leader"
        );
        for vehicle in vehicles {
            let fields: Vec<_> = vehicle
                .as_object()
                .unwrap()
                .keys()
                .map(String::as_str)
                .collect();
            let expected = ["max_brake_mps2", "min_gap_m", "min_ttc_s", "stopped"];
            assert!(
                expected.iter().all(|field| fields.contains(field)),
                "{fields:?}"
            );
            assert!(vehicle["stopped"].is_boolean());
        }
    }
    assert_eq!(reports[0]["vehicles"].as_array().unwrap().len(), 3);
    assert_eq!(reports[2]["vehicles"].as_array().unwrap().len(), 5);
    assert!((reports[0]["vehicles"][1]["min_gap_m"].as_f64().unwrap() - 4.34).abs() < 0.05);
}

#[test]
fn options_reach_the_simulation() {
    let folder = temp_folder();
    let run = |arguments: &str| {
        json_objects(&run_crumple(
            folder.path(),
            &format!("simulate paper-1 --format json {arguments}"),
        ))
        .remove(0)
    };
    assert_eq!(
        run("--controller match-leader")["outcome"],
        json!({ "kind": "no_collision" })
    );
    assert_eq!(run("")["estimator"], "kalman", "the default");
    assert_eq!(run("--dt 0.001")["dt_s"], 0.001);
    assert_eq!(run("--seed 7")["seed"], 7);
    // The baseline hardly reacts to noise; this controller copies its observation.
    let noisy =
        |seed: u64| run(&format!("--controller match-leader --seed {seed}"))["vehicles"].clone();
    assert_ne!(noisy(7), noisy(8), "noise is another");
    assert_eq!(noisy(7), noisy(7), "one seed decides everything");
    let arguments = "simulate paper-3 --estimator truth --after-collision continue --format json";
    let pile_up = json_objects(&run_crumple(folder.path(), arguments)).remove(0);
    assert_eq!(pile_up["impacts"].as_array().unwrap().len(), 4);
    assert_eq!(pile_up["vehicles_involved"], 5);
}

#[test]
fn expectations_decide_the_exit_code_and_say_so_on_standard_error() {
    let folder = temp_folder();
    let run = |arguments: &str| run_crumple(folder.path(), &format!("simulate {arguments}"));
    let collided = run("paper-1 --expect safe --format json");
    assert_eq!(
        (exit_code(&collided), stderr(&collided)),
        (
            1,
            "failed: expected no collision, and answers of every controller in paper-1\n"
        )
    );
    assert_eq!(
        json_objects(&collided).len(),
        1,
        "the results are printed all the same"
    );
    assert_eq!(exit_code(&run("paper-1 --expect collision")), 0);
    let all = format!("{} --controller match-leader", PAPER_SCENARIOS.join(" "));
    assert_eq!(exit_code(&run(&format!("{all} --expect safe"))), 0);
    let missed = run(&format!("{all} --expect collision"));
    assert_eq!(
        (exit_code(&missed), stderr(&missed)),
        (
            1,
            "failed: expected a collision in paper-1, paper-2, paper-3\n"
        )
    );
}

/// A controller that stops a scenario by unnecessary braking is safe, but not useful.
#[test]
fn unnecessary_braking_is_reported_and_decides_usefulness() {
    let folder = temp_folder();
    let quiet = "version = 1\nname = \"quiet\"\nduration_s = 20.0\n\
        [[vehicles]]\nclass = \"light\"\nposition_m = 60.0\nspeed_mps = 25.0\ndriver = \"constant-speed\"\n\
        [[vehicles]]\nclass = \"light\"\nposition_m = 10.0\nspeed_mps = 25.0\ndriver = \"under-test\"\n";
    fs::write(folder.path().join("quiet.toml"), quiet).expect("writable");
    let run = |controller: &str, more: &str| {
        run_crumple(
            folder.path(),
            &format!("simulate quiet.toml --controller {controller} {more}"),
        )
    };
    assert_eq!(exit_code(&run("random-actions", "--expect safe")), 0);
    let output = run("random-actions", "--expect useful");
    let message = "failed: expected no collision, answers of every controller, no unnecessary braking and no vehicle \
                   that falls behind in quiet\n";
    assert_eq!(stderr(&output), message);
    assert_prints(
        &output,
        1,
        &[
            "\n  vehicle 1 brakes unnecessarily for ",
            " was justified\n",
        ],
    );

    let useful = run("idm", "--expect useful --format json");
    assert_eq!(exit_code(&useful), 0);
    let none = json!([{ "vehicle": 1, "time_s": 0.0, "count": 0, "hardest": null }]);
    assert_eq!(json_objects(&useful)[0]["unnecessary_braking"], none);
    let report = json_objects(&run("random-actions", "--format json")).remove(0);
    let braking = &report["unnecessary_braking"][0];
    let hardest = |field: &str| braking["hardest"][field].as_f64().expect("a number");
    assert!(
        braking["count"].as_u64() > Some(0)
            && hardest("brake_mps2") > hardest("justified_mps2") + 2.0,
        "{report}"
    );
    let left = run_crumple(
        folder.path(),
        "simulate quiet.toml --controller policy --expect useful",
    );
    assert_prints(&left, 1, &["vehicle 1 falls behind its leader"]);
    let collision = run_crumple(folder.path(), "simulate paper-1 --expect useful");
    assert_eq!(
        exit_code(&collision),
        1,
        "a collision is not useful, either"
    );
}

/// `predictive` brakes harder than its leader for the human behind, and without it not; `acc-aeb,ttc_s=8` always does.
#[test]
fn braking_that_only_the_vehicle_behind_causes_is_useful() {
    let folder = temp_folder();
    let vehicle = |position_m: u32, driver: &str| {
        format!(
            "[[vehicles]]\nclass = \"light\"\nposition_m = {position_m}\nspeed_mps = 20.0\n{driver}\n"
        )
    };
    let leader = "driver.recorded = { time_s = [0.0, 10.0, 12.0, 60.0], speed_mps = [20.0, 20.0, 10.0, 10.0] }";
    let scenario = "version = 1\nname = \"hard\"\nduration_s = 60.0\n".to_owned()
        + &vehicle(64, leader)
        + &vehicle(32, "driver = \"under-test\"")
        + &vehicle(0, "driver = \"human\"");
    fs::write(folder.path().join("hard.toml"), scenario).unwrap();
    let simulate = |controller: &str, more: &str| {
        let arguments = "simulate hard.toml --estimator truth --expect useful";
        run_crumple(
            folder.path(),
            &format!("{arguments} --controller {controller} {more}"),
        )
    };
    let cause = "; only with the vehicle behind: does not count against the controller\n";
    for (controller, code) in [("predictive", 0), ("acc-aeb,ttc_s=8", 1)] {
        let output = simulate(controller, "");
        assert_prints(&output, code, &["vehicle 1 brakes unnecessarily for "]);
        assert_eq!(stdout(&output).contains(cause), code == 0, "{controller}");
        let report = json_objects(&simulate(controller, "--format json")).remove(0);
        let is_caused = report.get("brakes_only_with_vehicle_behind");
        assert_eq!(is_caused, (code == 0).then_some(&json!(true)));
    }
    let total = "  2 of 2  unnecessary braking, 2 of them only with the vehicle behind: not counted against \
        the controller\n";
    assert_prints(&simulate("predictive", "hard.toml"), 0, &[total]);
}

/// A folder is a table: one line for each scenario, and a total by kind of collision, in both formats.
#[test]
fn a_folder_has_a_line_for_each_scenario_and_a_total() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("all")).unwrap();
    for name in PAPER_SCENARIOS {
        let shown = run_ok(folder.path(), &format!("show {name}"));
        fs::write(
            folder.path().join(format!("all/{name}.toml")),
            stdout(&shown),
        )
        .unwrap();
    }
    let open = "version = 1\nname = \"open\"\nduration_s = 2.0\n\
        [[vehicles]]\nclass = \"light\"\nposition_m = 200.0\nspeed_mps = 20.0\ndriver = \"constant-speed\"\n\
        [[vehicles]]\nclass = \"light\"\nposition_m = 10.0\nspeed_mps = 20.0\ndriver = \"under-test\"\n";
    fs::write(folder.path().join("all/open.toml"), open).unwrap();
    let stopped = open.replace(
        "position_m = 200.0\nspeed_mps = 20.0",
        "position_m = 30.0\nspeed_mps = 0.0",
    );
    let stopped = stopped.replace("\"open\"", "\"stopped\"");
    fs::write(folder.path().join("all/stopped.toml"), stopped).unwrap();

    let arguments = "simulate all --estimator truth --spec 'always v1.gap_m > 60'";
    let lines: Vec<_> = stdout(&run_ok(folder.path(), arguments))
        .lines()
        .map(str::to_owned)
        .collect();
    assert!(
        lines[0].starts_with("open: no collision, smallest gap 1"),
        "{lines:#?}"
    );
    assert!(
        lines[1].starts_with("paper-1: COLLISION at ")
            && lines[1].contains("vehicle 2 hits vehicle 1 at ")
    );
    assert!(
        lines[4].starts_with("stopped: ") && lines[4].contains("vehicle 1 hits vehicle 0"),
        "{lines:#?}"
    );
    assert!(
        lines[4].contains("; VIOLATED, robustness -") && !lines[0].contains("VIOLATED"),
        "{lines:#?}"
    );
    let total = [
        "total of 5 scenarios: baseline, estimator truth",
        "      1 of 5  no collision",
        "      2 of 5  COLLISION: the ego vehicle hits its leader",
        "      2 of 5  COLLISION: the ego vehicle is hit from behind",
        "      2 of 5  unnecessary braking",
        "      4 of 5  VIOLATED: a specification",
        "      2 of 5  no vehicle behind: collisions from behind cannot happen",
    ];
    assert_eq!(lines[5..], total);

    let reports = json_objects(&run_ok(
        folder.path(),
        &format!("{arguments} --format json"),
    ));
    assert_eq!(
        (reports.len(), &reports[0]["scenario"]),
        (6, &json!("open"))
    );
    let expected = json!({
        "scenarios": 5, "no_collision": 1, "ego_hits_leader": 2, "ego_hit_from_behind": 2, "others_collide": 0,
        "controller_failed": 0, "brakes_unnecessarily": 2, "fell_behind": 0,
        "violated": 4, "without_vehicle_behind": 2,
    });
    assert_eq!(reports[5]["total"], expected);
    let details = run_ok(folder.path(), "simulate all --details");
    assert!(
        stdout(&details).lines().count() > 30
            && stdout(&details).contains("total of 5 scenarios: baseline")
    );
}

/// `--after-collision` is the name of version 0.3.0.
#[test]
fn the_earlier_name_of_after_collision_is_still_accepted() {
    let folder = temp_folder();
    let run = |option: &str| {
        run_ok(
            folder.path(),
            &format!("simulate paper-3 {option} continue --format json"),
        )
    };
    assert_eq!(
        run("--after-contact").stdout,
        run("--after-collision").stdout
    );
    let earlier = run_ok(folder.path(), "simulate paper-1 --spec 'no contact'");
    assert_eq!(
        earlier.stdout,
        run_ok(folder.path(), "simulate paper-1 --spec 'no collision'").stdout
    );
    assert!(
        stdout(&earlier).contains("VIOLATED, robustness ")
            && stdout(&earlier).contains(": no collision\n")
    );
}

/// One row for each sample and vehicle: every step up to the collision, and the collision itself.
#[test]
fn traces_have_one_row_a_sample_and_vehicle() {
    let folder = temp_folder();
    for (after_collision, samples) in [("stop", None), ("continue", Some(1501))] {
        let mut reports = Vec::new();
        for file in TRACES {
            let arguments = format!(
                "simulate paper-1 --after-collision {after_collision} --trace {file} --format json"
            );
            reports = json_objects(&run_ok(folder.path(), &arguments));
        }
        let collision_s = reports[0]["outcome"]["time_s"].as_f64().unwrap();
        let samples = samples.unwrap_or((collision_s / 0.01).ceil() as usize + 1);
        let mut csv = csv::Reader::from_path(folder.path().join("trace.csv")).unwrap();
        assert_eq!(
            csv.headers().unwrap(),
            &[
                "time_s",
                "vehicle",
                "position_m",
                "speed_mps",
                "acceleration_mps2",
                "gap_m"
            ][..]
        );
        let rows: Vec<_> = csv.records().map(Result::unwrap).collect();
        assert_eq!(rows.len(), samples * 3);
        let end_s = if after_collision == "stop" {
            collision_s
        } else {
            15.0
        };
        assert_eq!(rows.last().unwrap()[0].parse::<f64>().unwrap(), end_s);
        // `crumple-report` compares the rows of both formats.
        if TRACES.len() > 1 {
            let parquet = fs::read(folder.path().join("trace.parquet")).unwrap();
            assert!(parquet.starts_with(b"PAR1") && parquet.ends_with(b"PAR1"));
        }
    }
    assert_eq!(
        file_names_in(folder.path()),
        TRACES,
        "nothing else is left behind"
    );
}

const TRACES: &[&str] = if WRITES_PARQUET {
    &["trace.csv", "trace.parquet"]
} else {
    &["trace.csv"]
};

#[test]
fn plots_match_their_file_names() {
    let folder = temp_folder();
    let png = WRITES_PNG.then_some(("p.png", &b"\x89PNG\r\n"[..]));
    for (file, opening) in [("p.svg", &b"<"[..])].into_iter().chain(png) {
        run_ok(folder.path(), &format!("simulate paper-1 --plot {file}"));
        assert!(
            fs::read(folder.path().join(file))
                .unwrap()
                .starts_with(opening),
            "{file}"
        );
    }
}

/// Refused before any run, with the command that enables the feature, as in `doctor`. The libraries decide: other
/// packages of the same build may enable their features.
#[test]
fn a_missing_feature_is_refused_with_the_way_to_enable_it() {
    let folder = temp_folder();
    let doctor = json_objects(&run_crumple(folder.path(), "doctor --format json"));
    let doctor_text = run_crumple(folder.path(), "doctor");
    for (feature, enabled, arguments) in [
        ("png", WRITES_PNG, "simulate paper-1 --plot p.png"),
        (
            "parquet",
            WRITES_PARQUET,
            "simulate paper-1 --trace t.parquet",
        ),
        (
            "parquet",
            READS_PARQUET,
            "import CORPORA/fuzz/binary_recording/parquet-snappy --map CORPORA/recordings/mdf/map.toml --out P",
        ),
        (
            "mdf",
            READS_MDF,
            "import CORPORA/fuzz/binary_recording/transposed-clocks --map CORPORA/recordings/mdf/map.toml --out M",
        ),
    ] {
        let listed = doctor[0]["features"]
            .as_array()
            .unwrap()
            .iter()
            .find(|listed| listed["name"] == feature)
            .unwrap();
        assert_eq!(
            listed["enabled"],
            enabled && (feature != "parquet" || READS_PARQUET && WRITES_PARQUET)
        );
        let command = format!("cargo install --locked --path . --features {feature}");
        assert_eq!(
            stdout(&doctor_text).contains(&command),
            listed["enabled"] == false
        );
        let arguments =
            arguments.replace("CORPORA", concat!(env!("CARGO_MANIFEST_DIR"), "/corpora"));
        let output = run_crumple(folder.path(), &arguments);
        match enabled {
            true => assert_eq!(exit_code(&output), 0, "{}", stderr(&output)),
            false => assert_refused(&output, &command),
        }
    }
    assert_eq!(
        file_names_in(folder.path()).is_empty(),
        !(WRITES_PNG || WRITES_PARQUET || READS_PARQUET || READS_MDF)
    );
}

#[test]
fn list_names_all_inputs_of_simulate() {
    let folder = temp_folder();
    let all = run_crumple(folder.path(), "list --all");
    assert_eq!((exit_code(&all), stderr(&all)), (0, ""));
    // Controllers for tests are listed on request only.
    let usual = run_crumple(folder.path(), "list controllers");
    for name in CONTROLLERS_FOR_TESTS {
        let entry = format!("\n  {name} ");
        assert!(
            stdout(&all).contains(&entry) && !stdout(&usual).contains(&entry),
            "{name}"
        );
    }
    let controllers = BuiltInController::all();
    for name in PAPER_SCENARIOS
        .into_iter()
        .chain(controllers.iter().map(BuiltInController::name))
    {
        assert!(
            stdout(&all)
                .lines()
                .any(|line| line.split_whitespace().next() == Some(name)),
            "{name}"
        );
    }
    let long: Vec<_> = stdout(&all)
        .lines()
        .filter(|line| line.chars().count() > 100)
        .collect();
    assert!(long.is_empty(), "wrapped in a pipe: {long:?}");
    // A value that switches its setting off is marked.
    for off in ["set_speed_mps=100 (off)\n", "aeb_ttc_s=0 (off),"] {
        assert!(stdout(&all).contains(off), "{off:?}");
    }
    let listed = &json_objects(&run_crumple(folder.path(), "list --all --format json"))[0];
    let words = |text: &str| text.split_whitespace().collect::<String>();
    for entry in ["scenarios", "controllers", "spaces", "methods"]
        .iter()
        .flat_map(|catalogue| listed[catalogue].as_array().unwrap())
    {
        let (name, summary) = (
            entry["name"].as_str().unwrap(),
            entry["summary"].as_str().unwrap(),
        );
        assert!(
            words(stdout(&all)).contains(&words(&format!("{name}{summary}"))),
            "nothing is left out: {name}"
        );
    }
    for controller in listed["controllers"].as_array().unwrap() {
        let name = controller["name"].as_str().unwrap();
        let output = run_crumple(
            folder.path(),
            &format!("simulate paper-1 --controller {name}"),
        );
        assert_eq!(exit_code(&output), 0, "{name}: {}", stderr(&output));
        assert!(stdout(&output).starts_with(&format!("paper-1: {name}, ")));
    }
}

#[test]
fn the_help_of_assess_names_the_controllers_and_gates_of_this_version() {
    let help = run_crumple(temp_folder().path(), "assess --help");
    let words = stdout(&help)
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    let compared = crumple_report::assessment::AssessConfig::default()
        .controllers
        .join(", ");
    assert_contains(
        &words,
        &[&format!("`assess` compares {compared}. It simulates")],
    );
    let schema = include_str!("../../../crates/report/src/assessment/configuration.schema.json");
    let constants = schema
        .split("\"const\": \"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next());
    // The others are the names of estimators.
    let gates: Vec<&str> = constants.filter(|name| name.contains('-')).collect();
    assert!(gates.len() >= 12, "{gates:?}");
    let configuration = stdout(&run_crumple(temp_folder().path(), "show assessment")).to_owned();
    assert_contains(&configuration, &gates);
}

/// The configuration that users edit has a comment for its fields, and lines that an editor need not wrap.
#[test]
fn the_printed_configuration_has_comments_and_short_lines() {
    let printed = run_crumple(temp_folder().path(), "show assessment");
    let lines: Vec<&str> = stdout(&printed).lines().collect();
    assert!(
        lines.iter().filter(|line| line.starts_with('#')).count() > 15
            && lines.iter().all(|line| line.chars().count() <= 120),
        "{lines:?}"
    );
    toml::from_str::<toml::Table>(&lines.join("\n")).expect("is TOML");
}

/// No panic and no message; a failed gate still fails.
#[test]
fn a_closed_pipe_is_no_error() {
    let folder = temp_folder();
    for (arguments, expected) in [
        ("simulate paper-1 paper-2 paper-3 --dt 0.0001", 0),
        ("simulate paper-1 --dt 0.0001 --expect safe", 1),
        ("simulate --help", 0),
    ] {
        let mut child = spawn(folder.path(), arguments);
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("ends");
        assert_eq!(exit_code(&output), expected, "{}", stderr(&output));
        assert!(
            !stderr(&output).contains("panicked") && !stderr(&output).contains("error"),
            "{}",
            stderr(&output)
        );
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_under_standard_output_is_reported() {
    let full = fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .expect("there on Linux");
    for arguments in [
        "simulate paper-1",
        "--help",
        "-h",
        "help",
        "help simulate",
        "simulate --help",
        "verify rate -h",
        "--version",
        "completions bash",
        "list",
        "list controllers",
        "show un-r152",
        "suite list",
        "doctor",
    ] {
        let output = command(temp_folder().path(), arguments)
            .stdout(full.try_clone().expect("another handle"))
            .output()
            .expect("starts");
        assert_eq!(exit_code(&output), 3, "{arguments}");
        assert!(
            stderr(&output).starts_with("error: standard output: "),
            "{arguments}: {}",
            stderr(&output)
        );
    }
}

/// Builds between two releases have the version of the earlier one. A release build also states its commit.
#[test]
fn the_version_has_the_commit_of_a_release_build() {
    let commit =
        option_env!("CRUMPLE_COMMIT").map_or_else(String::new, |id| format!(", commit {id}"));
    let output = run_ok(temp_folder().path(), "--version");
    let expected = format!("crumple {}{commit}\n", env!("CARGO_PKG_VERSION"));
    assert_eq!(stdout(&output), expected);
}

/// Starts a command once for each range and kills it after a random but reproducible number of milliseconds. Returns
/// the number of commands that were still running then.
fn kill_at_random_times(
    folder: &Path,
    arguments: &str,
    after_ms: impl Iterator<Item = Range<u64>>,
) -> usize {
    let mut moments = rand::rngs::Xoshiro256PlusPlus::seed_from_u64(1);
    let was_killed = |range: Range<u64>| {
        let mut command = command(folder, arguments);
        command
            .env("RAYON_NUM_THREADS", "3")
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        sleep(Duration::from_millis(moments.random_range(range)));
        // SIGKILL: no cleanup.
        child.kill().unwrap();
        child.wait().unwrap().code().is_none()
    };
    after_ms.map(was_killed).filter(|&killed| killed).count()
}

/// Checks that work in the folder `killed`, killed at random times and resumed on three threads, ends with the output
/// and the bytes of undisturbed work on one thread in the folder `through`. Returns the output of the latter.
pub(crate) fn assert_survives_kills(
    folder: &Path,
    arguments: &str,
    after_ms: impl Iterator<Item = Range<u64>>,
) -> Output {
    let through = run_on_threads(folder, "1", &format!("{arguments} --out through"));
    let resume = format!("{arguments} --out killed --resume");
    let killed = kill_at_random_times(folder, &resume, after_ms);
    assert!(killed >= 2, "killed {killed} times");
    let ended = run_on_threads(folder, "3", &resume);
    assert_eq!(
        (exit_code(&ended), stdout(&ended)),
        (exit_code(&through), stdout(&through)),
        "{}",
        stderr(&ended)
    );
    falsify::assert_same_folders(&folder.join("through"), &folder.join("killed"));
    through
}
