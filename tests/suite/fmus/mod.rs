//! FMUs as controllers: they equal the same controller in other forms, their errors end runs, and damaged files are
//! refused.

mod folders;
mod units;

use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;
use std::process::Command;

use crumple_controllers::find_for_user;
use crumple_sim::engine::SimulationResult;
use crumple_sim::scenario::built_in_scenario;
use rand::{RngExt as _, SeedableRng as _};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::command_line::{
    assert_refused, command, exit_code, run_crumple, stderr, stdout, temp_folder,
};
use crate::processes::{
    draw_scenarios, find_controller, simulate_in_lockstep, simulate_with_truth,
};

const EXAMPLE: &str = include_str!("../../../examples/controllers/fmu/follower.c");
const EXAMPLE_XML: &str = include_str!("../../../examples/controllers/fmu/modelDescription.xml");
const ODD: &str = include_str!("odd.c");
const ODD_XML: &str = include_str!("odd.xml");

pub(crate) fn library_member(edition: u32, name: &str) -> String {
    let system = if cfg!(target_os = "macos") {
        "darwin"
    } else {
        std::env::consts::OS
    };
    let extension = if cfg!(target_os = "macos") {
        "dylib"
    } else {
        "so"
    };
    let folder = match edition {
        2 => format!("{system}{}", usize::BITS),
        _ => format!("{}-{system}", std::env::consts::ARCH),
    };
    format!("binaries/{folder}/{name}.{extension}")
}

/// Compiles a C source to a library; prints a message and returns `None` without a compiler.
fn compile_library(folder: &Path, source: &str, what: &str) -> Option<Vec<u8>> {
    let (from, to) = (folder.join("source.c"), folder.join("library.so"));
    fs::write(&from, source).unwrap();
    let paths = ["-o", to.to_str().unwrap(), from.to_str().unwrap(), "-lm"];
    let done = Command::new("cc")
        .args(["-O2", "-shared", "-fPIC", what])
        .args(paths)
        .output();
    match done {
        Ok(done) if done.status.success() => Some(fs::read(to).unwrap()),
        Ok(done) => panic!("{}", String::from_utf8_lossy(&done.stderr)),
        Err(error) => {
            println!("skipped: no C compiler: {error}");
            None
        }
    }
}

pub(crate) fn zip_archive(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        archive
            .start_file(*name, SimpleFileOptions::default())
            .unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

fn write_fmu(path: &Path, xml: &str, members: &[(&str, &[u8])]) {
    let description = ("modelDescription.xml", xml.as_bytes());
    fs::write(path, zip_archive(&[&[description], members].concat())).unwrap();
}

pub(crate) fn example_fmu_folder() -> Option<tempfile::TempDir> {
    let folder = temp_folder();
    let library = compile_library(folder.path(), EXAMPLE, "-DEXAMPLE")?;
    write_fmu(
        &folder.path().join("follower.fmu"),
        EXAMPLE_XML,
        &[(&library_member(2, "follower"), &library)],
    );
    Some(folder)
}

fn odd_fmu_folder(what: &str) -> Option<tempfile::TempDir> {
    let folder = temp_folder();
    let library = compile_library(folder.path(), ODD, &format!("-DWHAT={what}"))?;
    let xml = ODD_XML.replace(
        "\"ONCE\"",
        if what == "ONCE" {
            "\"true\""
        } else {
            "\"false\""
        },
    );
    write_fmu(
        &folder.path().join("odd.fmu"),
        &xml,
        &[(&library_member(3, "odd"), &library)],
    );
    fs::write(folder.path().join("odd.toml"), ODD_CONTROLLER).unwrap();
    Some(folder)
}

const ODD_CONTROLLER: &str = r#"version = 1
fmu = "odd.fmu"
answer_within_s = 0.5
parameters = { "set speed" = 30.0, lanes = 1 }
output = { variable = "command", low_mps2 = -7.5, high_mps2 = 2.0 }

[[inputs]]
quantity = "speed_mps"
variable = "speed"
[[inputs]]
quantity = "gap_ahead_m"
variable = "distance"
[[inputs]]
quantity = "is_ahead"
variable = "ahead"
[[inputs]]
quantity = "relative_speed_ahead_mps"
variable = "rate"
"#;

/// FMI 2, FMI 3 with other names, one instance for all runs, and a process without FMI give the same bits in both
/// engines.
#[test]
fn one_controller_drives_the_same_as_fmi_2_fmi_3_and_built_in() {
    let Some(example) = example_fmu_folder() else {
        return;
    };
    let source = include_str!("../../../examples/controllers/follower.c");
    fs::write(example.path().join("process.c"), source).unwrap();
    let arguments = ["-O2", "-o", "process", "process.c", "-lm"];
    assert!(
        Command::new("cc")
            .args(arguments)
            .current_dir(example.path())
            .status()
            .unwrap()
            .success()
    );
    let scenarios = draw_scenarios(5, 25);
    let expected = simulate_in_lockstep(
        &find_controller("exec:./process", example.path()).source,
        &scenarios,
    );
    let by_fmi_2 = find_controller("follower.fmu", example.path()).source;
    assert_eq!(simulate_in_lockstep(&by_fmi_2, &scenarios), expected);
    assert_eq!(simulate_with_truth(&by_fmi_2, &scenarios[7]), expected[7]);
    for what in ["NOTHING", "ONCE", "PRINT", "WARN"] {
        let odd = odd_fmu_folder(what).unwrap();
        assert_eq!(
            simulate_in_lockstep(&find_controller("odd.toml", odd.path()).source, &scenarios),
            expected,
            "{what}"
        );
    }
}

/// The state of an FMU advances by one decision interval per decision, from initialisation on: here a lag in closed
/// form.
#[test]
fn an_fmu_with_a_state_of_its_own_steps_by_the_decision_interval() {
    let Some(odd) = odd_fmu_folder("LATER") else {
        return;
    };
    let text = ODD_CONTROLLER.replace("fmu =", "decision_interval_s = 0.1\nfmu =");
    fs::write(odd.path().join("odd.toml"), text).unwrap();
    let scenario = built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.duration_s = 2.0)
        .unwrap();
    let controller = find_controller("odd.toml", odd.path()).source;
    let simulated = simulate_with_truth(&controller, &scenario);
    let trace = simulated.trace.as_ref().unwrap();
    let (gaps_m, [ahead, own]) = (trace.gaps_m(1), [&trace.vehicles[0], &trace.vehicles[1]]);
    let decay = 1.0 - (-0.1_f64 / 0.3).exp();
    let (mut filtered_mps2, mut checked) = (0.0, 0);
    for k in (0..200).step_by(10) {
        let (gap_m, speed_mps) = (gaps_m[k].unwrap(), own.speed_mps[k]);
        let wanted = 0.3 * (gap_m - 4.0 - 1.4 * speed_mps) + 0.9 * (ahead.speed_mps[k] - speed_mps);
        filtered_mps2 += (wanted.min(2.0).min(30.0 - speed_mps).max(-7.5) - filtered_mps2) * decay;
        assert!(
            (own.acceleration_mps2[k] - filtered_mps2).abs() < 1e-9,
            "{k}"
        );
        assert!(
            (own.acceleration_mps2[k + 9] - filtered_mps2).abs() < 1e-9,
            "{k}"
        );
        checked += 1;
    }
    assert_eq!(checked, 20);
    assert_eq!(simulate_with_truth(&controller, &scenario), simulated);
}

/// With its command as its warning, an FMU warns as soon as it accelerates with more than 0.5 m/s².
#[test]
fn the_test_driver_brakes_after_the_warning_of_an_fmu() {
    let Some(odd) = odd_fmu_folder("NOTHING") else {
        return;
    };
    let text = ODD_CONTROLLER.replace("fmu =", "warning = \"command\"\nfmu =");
    fs::write(odd.path().join("odd.toml"), text).unwrap();
    let scenario = built_in_scenario("paper-1")
        .unwrap()
        .edited(|spec| spec.vehicles[1].speed_mps -= 5.0)
        .unwrap();
    let accelerations = |name: &str| {
        let controller = find_controller(name, odd.path()).source;
        assert!(controller.reports_warnings());
        let simulated = simulate_with_truth(&controller, &scenario);
        simulated.trace.unwrap().vehicles[1]
            .acceleration_mps2
            .clone()
    };
    let alone = accelerations("odd.toml");
    let warned = alone.iter().position(|command| *command > 0.5);
    assert!(warned.is_some());
    let driven = accelerations("test-driver,brake_mps2=9,ramp_s=0,delay_s=0.2:odd.toml");
    let braking = driven.iter().position(|command| *command <= -7.5);
    assert_eq!(braking, warned.map(|step| step + 20));
}

#[test]
fn any_fmu_error_ends_the_run() {
    let cases = [
        ("CRASH", 0.03, "ended by signal 6", ""),
        (
            "NO_NUMBER",
            0.03,
            "exit code 2",
            "its output is NaN, at 0.03 s",
        ),
        (
            "TO_DISCARD",
            0.03,
            "exit code 2",
            "the FMU discarded it (fmi3DoStep)",
        ),
        (
            "TO_FAIL",
            0.03,
            "exit code 2",
            "the FMU reports an error (fmi3DoStep)",
        ),
        (
            "TO_END",
            0.03,
            "exit code 2",
            "the FMU requested the end of the simulation at 0.04 s",
        ),
        ("HANG", 0.03, "gave no answer within 0.5 s", ""),
        (
            "NO_INSTANCE",
            0.0,
            "exit code 2",
            "the FMU cannot be instantiated (fmi3InstantiateCoSimulation)",
        ),
    ];
    for (what, time_s, why, last) in cases {
        let Some(odd) = odd_fmu_folder(what) else {
            return;
        };
        let failed = simulate_with_truth(
            &find_controller("odd.toml", odd.path()).source,
            &built_in_scenario("paper-1").unwrap(),
        )
        .outcome;
        let failed = failed
            .failed_controller()
            .unwrap_or_else(|| panic!("{what} drives on"));
        let message = failed.to_string();
        assert!(
            (failed.time_s - time_s).abs() < 1e-9 && message.contains("`odd.fmu`"),
            "{what}: {message}"
        );
        assert!(
            message.contains(why) && message.contains(last),
            "{what}: {message}"
        );
    }
}

/// The identity does not depend on the path.
#[test]
fn the_identity_of_an_fmu_is_its_file_and_its_wiring() {
    let Some(odd) = odd_fmu_folder("NOTHING") else {
        return;
    };
    let identity = |folder: &Path| {
        find_controller("odd.toml", folder)
            .source
            .identity()
            .expect("has one")
    };
    let first = identity(odd.path());
    let elsewhere = temp_folder();
    for name in ["odd.toml", "odd.fmu"] {
        fs::copy(odd.path().join(name), elsewhere.path().join(name)).unwrap();
    }
    assert_eq!(identity(elsewhere.path()), first);
    fs::write(
        elsewhere.path().join("odd.toml"),
        ODD_CONTROLLER.replace("= 30.0", "= 29.0"),
    )
    .unwrap();
    assert_ne!(identity(elsewhere.path()), first);
    let search = "falsify --controller odd.toml --budget 2 --out found --format json";
    let output = run_crumple(odd.path(), search);
    assert!([0, 1].contains(&exit_code(&output)), "{}", stderr(&output));
}

#[test]
fn mismatches_with_an_fmu_are_refused_by_file_line_and_field() {
    let Some(odd) = odd_fmu_folder("NOTHING") else {
        return;
    };
    let cases = [
        (
            "\"speed\"",
            "\"Speed\"",
            "odd.toml:7: inputs[0]: the FMU has no `Speed` among its inputs: distance, rate, speed, ahead",
        ),
        (
            "\"rate\"",
            "\"speed\"",
            "odd.toml:16: inputs[3]: the FMU's input `speed` is set twice",
        ),
        (
            "variable = \"rate\"",
            "",
            "inputs[3]: the FMU has no `relative_speed_ahead_mps` among its inputs",
        ),
        (
            "variable = \"command\", ",
            "",
            "output.variable: the FMU has no `acceleration_mps2` among its outputs: command, spare",
        ),
        (
            "lanes = 1",
            "lanes = 1.5",
            "parameters.lanes: 1.5 is not a value of a parameter that is integer",
        ),
        (
            "lanes",
            "roads",
            "the FMU has no `roads` among its parameters",
        ),
        (
            "fmu = ",
            "history = 2\nfmu = ",
            "odd.toml:2: history: is not for an FMU",
        ),
        (
            "fmu = ",
            "files = [\"a\"]\nfmu = ",
            "odd.toml:2: files: is not for an FMU",
        ),
        (
            "fmu = ",
            "command = [\"a\"]\nfmu = ",
            "odd.toml:2: command: `fmu` is given already: keep one of them",
        ),
        ("odd.fmu", "none.fmu", "odd.toml:2: fmu: there is no file "),
        ("odd.fmu", ".", "odd.toml:2: fmu: "),
        ("odd.fmu", ".", " cannot be read: is not a regular file"),
        (
            "odd.fmu",
            "bad.fmu",
            "bad.fmu is not an FMU: it is not a zip archive, or it was cut off",
        ),
    ];
    fs::write(odd.path().join("bad.fmu"), "no archive").unwrap();
    for (was, is, message) in cases {
        fs::write(
            odd.path().join("odd.toml"),
            ODD_CONTROLLER.replacen(was, is, 1),
        )
        .unwrap();
        let error = find_for_user("odd.toml", odd.path())
            .expect_err(is)
            .to_string();
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
    let bare = find_for_user("odd.fmu", odd.path())
        .expect_err("needs wiring")
        .to_string();
    assert!(
        bare.contains("odd.fmu: inputs: its input `distance` has not the name of a quantity"),
        "{bare}"
    );
    let mut absent = command(odd.path(), "simulate paper-1 --controller odd.toml");
    let absent = absent.env("CRUMPLE_FMU", "/nowhere").output().unwrap();
    fs::write(odd.path().join("odd.toml"), ODD_CONTROLLER).unwrap();
    assert_eq!(exit_code(&absent), 2);
}

/// Each of 200 damaged files, and each unusual archive, gives one clear error and exit code 2.
#[test]
fn damaged_fmus_are_refused() {
    let Some(example) = example_fmu_folder() else {
        return;
    };
    let path = example.path().join("follower.fmu");
    let whole = fs::read(&path).unwrap();
    let refused = |what: &str| match find_for_user("follower.fmu", example.path()) {
        Ok(_) => None,
        Err(error) => {
            let error = error.to_string();
            assert!(
                error.contains("follower.fmu: ") && !error.contains('\n'),
                "{what}: {error:?}"
            );
            Some(error)
        }
    };
    let mut random = rand::rngs::Xoshiro256PlusPlus::seed_from_u64(20);
    let mut accepted = 0;
    for number in 0..200 {
        let mut bytes = whole.clone();
        if number % 2 == 0 {
            bytes.truncate(random.random_range(0..whole.len()));
        } else {
            // The parts that are read before driving: the description at the start, the central directory at the end.
            let position = random.random_range(0..1200);
            let position = if position < 900 {
                position
            } else {
                whole.len() - (position - 899)
            };
            bytes[position] ^= 1 << random.random_range(0..8);
        }
        fs::write(&path, bytes).unwrap();
        accepted += usize::from(refused(&format!("{number}")).is_none());
    }
    // Some changes affect only a name or a date.
    assert!(accepted < 40, "{accepted} of 200 are accepted");

    let library = library_member(2, "follower");
    let far = "../".repeat(9) + "tmp/evil";
    let big = EXAMPLE_XML.replace("</fmi", &(" ".repeat(17 << 20) + "</fmi"));
    let model = |was: &str, is: &str| EXAMPLE_XML.replacen(was, is, 1);
    let described = [
        (
            model("<CoSimulation", "<ModelExchange"),
            "does not support co-simulation",
        ),
        (
            model("fmiVersion=\"2.0\"", "fmiVersion=\"1.0\""),
            "FMI version \"1.0\" is not supported; crumple reads FMI 2.0 and 3.0",
        ),
        (
            model(
                "modelIdentifier=\"follower\"",
                "modelIdentifier=\"../follower\"",
            ),
            "is no identifier of C",
        ),
        (
            model("modelIdentifier=\"follower\"", "modelIdentifier=\"other\""),
            "has no library for this platform",
        ),
        (
            model("canHandle", "needsExecutionTool=\"true\" canHandle"),
            "cannot run without the tool that exported it",
        ),
        (
            model("valueReference=\"0\"", "valueReference=\"-1\""),
            "line 12: valueReference \"-1\" is no whole number",
        ),
        (
            model("name=\"speed_mps\"", "name=\"gap_ahead_m\""),
            "there are two variables \"gap_ahead_m\"",
        ),
        (
            model(
                "<?xml version=\"1.0\" encoding=\"UTF-8\"?>",
                "<!DOCTYPE a [<!ENTITY b \"c\">]>",
            ),
            "modelDescription.xml, line 1: has a document type declaration",
        ),
        (
            model("</ModelVariables>", ""),
            "modelDescription.xml, line 29: ill-formed document: expected `</ModelVariables>`",
        ),
        (big, "has more than 16777216 bytes"),
    ];
    for (xml, message) in described {
        write_fmu(&path, &xml, &[(&library, &whole)]);
        let error = refused(message).unwrap_or_else(|| panic!("accepted, should say {message}"));
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
    let xml = EXAMPLE_XML.as_bytes();
    fs::write(
        &path,
        zip_archive(&[
            ("resources/../../evil", xml),
            ("modelDescription.xml", xml),
            (&library, xml),
            (&far, xml),
        ]),
    )
    .unwrap();
    let ran = run_crumple(example.path(), "simulate paper-1 --controller follower.fmu");
    assert_refused(&ran, "leads out of the archive");
    for bytes in [&whole[..700], b"PK", b""] {
        fs::write(&path, bytes).unwrap();
        let ran = run_crumple(example.path(), "simulate paper-1 --controller follower.fmu");
        assert_eq!(exit_code(&ran), 2);
        let message = stderr(&ran);
        assert_eq!(message.matches("follower.fmu: ").count(), 1, "{message}");
    }
}
