//! Files that are not regular, such as pipes and devices, long messages, and errors of the disk.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crumple_core::quoting::MAX_MESSAGE_CHARS;

use crate::command_line::{
    assert_refused, assert_reports, command, run_crumple, run_ok, stderr, temp_folder,
};

/// Returns all files below a folder.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            paths.extend(files_below(&path))
        } else {
            paths.push(path)
        }
    }
    paths
}

/// Uses of the standard library that open files which no user names, by file.
const OWN_FILES: [(&str, usize); 10] = [
    // Folders, to sync them, and its own temporary files.
    ("crates/store/src/disk.rs", 2),
    ("crates/store/src/disk/unfinished.rs", 1),
    ("crates/store/src/run_folder/lock.rs", 1),
    ("crates/exchange/src/recording/spill.rs", 1),
    ("crates/report/src/assessment/parts/search_campaign.rs", 1),
    // The running program, and the system's description of the processor.
    ("crates/store/src/program.rs", 1),
    ("crates/report/src/assessment/run_info.rs", 1),
    // The functions that open regular files; the checker of certificates has its own.
    ("crates/core/src/regular_file.rs", 2),
    ("verify/src/certificate.rs", 1),
    // A file for another program of this workspace.
    ("crates/fuzzing/src/run_folder.rs", 1),
];

fn is_test(path: &Path) -> bool {
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    name == "tests"
        || name.ends_with("_tests")
        || path.components().any(|part| part.as_os_str() == "tests")
}

#[test]
fn files_that_users_name_are_opened_by_one_function() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![
        root.join("src"),
        root.join("verify/src"),
        root.join("python/src"),
    ];
    folders.extend(
        fs::read_dir(root.join("crates"))
            .unwrap()
            .map(|entry| entry.unwrap().path().join("src")),
    );
    let is_source = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension == "rs") && !is_test(path)
    };
    let mut problems = Vec::new();
    for path in folders
        .iter()
        .flat_map(|folder| files_below(folder))
        .filter(is_source)
    {
        let text = fs::read_to_string(&path).unwrap();
        let code = text.split("mod tests {").next().unwrap_or_default();
        let code: String = code
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"))
            .collect();
        // Other functions of these names.
        let is_other = |before: &str| {
            !["Recording", "self"]
                .iter()
                .any(|other| before.ends_with(other))
        };
        let opening = ["File::open(", "fs::read(", "fs::read_to_string(", ".open("];
        let calls = opening.iter().flat_map(|call| code.match_indices(call));
        let calls = calls.filter(|(at, _)| is_other(&code[..*at])).count();
        let name = path
            .strip_prefix(root)
            .unwrap()
            .to_string_lossy()
            .into_owned();
        let own = OWN_FILES
            .iter()
            .find(|(own, _)| *own == name)
            .map_or(0, |(_, count)| *count);
        if calls != own {
            problems.push(format!(
                "{name}: {calls} instead of {own}: use crumple_core::regular_file"
            ));
        }
    }
    assert!(problems.is_empty(), "{problems:#?}");
}

/// Runs a command that must end soon.
fn run_within_a_minute(folder: &Path, arguments: &str) -> Output {
    let mut child = command(folder, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    let began = Instant::now();
    while child.try_wait().expect("is there").is_none() {
        if began.elapsed() > Duration::from_secs(60) {
            child.kill().expect("ends");
            panic!("`crumple {arguments}` waits");
        }
        sleep(Duration::from_millis(20));
    }
    child.wait_with_output().expect("ended")
}

/// Writes files that name the files `STEM.*`, and the file `dbc`.
fn write_files_that_name(folder: &Path, stem: &str, dbc: &str) {
    let write = |name: &str, text: &str| fs::write(folder.join(name), text).unwrap();
    let rest = "decision_interval_s = 0.1\n[output]\nanswer = 0\nlow_mps2 = -1.0\nhigh_mps2 = 1.0\n[[inputs]]\n\
                constant = 1.0\n";
    write(
        "network.toml",
        &format!("version = 1\nnetwork = \"{stem}.onnx\"\n{rest}"),
    );
    write(
        "fmu.toml",
        &format!("version = 1\nfmu = \"{stem}.fmu\"\n{rest}"),
    );
    let map = r#"
time.clock = { column = "t" }
[layout.pairs]
spacing = { column = "gap", from = "bumper-to-bumper" }
follower_speed = { column = "a" }
leader_speed = { column = "b" }
"#;
    write(
        "map.toml",
        &format!("version = 1\nname = \"m\"\ndbc = \"{dbc}\"{map}"),
    );
    write("log.mf4", "MDF     4.10    ");
    write(
        "space.toml",
        &format!("version = 1\nname = \"s\"\nbase = \"{stem}.toml\"\nparameters = []\n"),
    );
    write(
        "report.toml",
        &format!("version = 1\ncontrollers = [\"idm\"]\ncertificates = [\"{stem}.json\"]\n"),
    );
}

#[test]
fn pipes_and_devices_are_refused_wherever_they_are_named() {
    let folder = temp_folder();
    let at = |name: &str| folder.path().join(name);
    run_ok(
        folder.path(),
        "export paper-1 --to openscenario --as actions --out .",
    );
    fs::remove_file(at("paper-1.xodr")).unwrap();
    let names = [
        "p.safetensors",
        "p.onnx",
        "p.fmu",
        "p.toml",
        "p.json",
        "p.csv",
        "p.dbc",
        "p.xosc",
        "paper-1.xodr",
    ];
    write_files_that_name(folder.path(), "p", "p.dbc");
    let commands = [
        "simulate paper-1 --controller p.safetensors",
        "simulate paper-1 --controller p.onnx",
        "simulate paper-1 --controller p.fmu",
        "simulate paper-1 --controller p.toml",
        "simulate paper-1 --controller network.toml",
        "simulate paper-1 --controller fmu.toml",
        "simulate p.toml",
        "simulate p.json",
        "falsify --controller idm --space p.toml --budget 5 --out f",
        "falsify --controller idm --space space.toml --budget 5 --out f",
        "import p.csv",
        "import p.xosc",
        "import paper-1.xosc",
        "import log.mf4 --map map.toml",
        "import log.mf4 --map p.toml",
        "check p.json",
        "describe p.onnx",
        "describe p.fmu",
        "assess report.toml --out r",
        "assess p.toml --out r",
        "replay p.csv --controller idm",
        "fit p.csv --out s.toml",
        "train --preset p.toml --out t",
    ];
    for is_device in [false, true] {
        for name in names {
            let _ = fs::remove_file(at(name));
            match is_device {
                true => std::os::unix::fs::symlink("/dev/zero", at(name)).unwrap(),
                false => assert!(
                    Command::new("mkfifo")
                        .arg(at(name))
                        .status()
                        .unwrap()
                        .success()
                ),
            }
        }
        for arguments in commands {
            let ended = run_within_a_minute(folder.path(), arguments);
            assert_reports(&ended, 2, "is not a regular file");
        }
    }
}

#[test]
fn standard_input_may_be_named_as_an_argument_and_not_within_a_file() {
    let folder = temp_folder();
    let feed = |arguments: &str, text: &[u8]| {
        let mut command = command(folder.path(), arguments);
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("starts");
        let _ = child.stdin.take().expect("a pipe").write_all(text);
        child.wait_with_output().expect("ends")
    };
    fs::write(
        folder.path().join("e.csv"),
        "event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps\n",
    )
    .unwrap();
    let map = run_ok(folder.path(), "show car-following").stdout;
    let [whole, damaged] =
        [&map[..], b"version = 7"].map(|map| feed("import e.csv --map /dev/stdin", map));
    assert_reports(&whole, 2, "e.csv:");
    assert_reports(&damaged, 2, "/dev/stdin:1: ");
    fs::write(
        folder.path().join("space.toml"),
        "version = 1\nname = \"s\"\nbase = \"/dev/stdin\"\nparameters = []\n",
    )
    .unwrap();
    let scenario = run_ok(folder.path(), "show paper-1").stdout;
    assert_refused(
        &feed(
            "falsify --controller idm --space space.toml --budget 5",
            &scenario,
        ),
        "/dev/stdin",
    );
}

#[test]
fn messages_are_short_whatever_they_quote() {
    let folder = temp_folder();
    let long = "k".repeat(1_000_000);
    let scenario = stdout_of(folder.path(), "show paper-1");
    fs::write(
        folder.path().join("key.toml"),
        format!("{scenario}\n[{long}]\n"),
    )
    .unwrap();
    fs::write(
        folder.path().join("value.toml"),
        scenario.replacen("name = \"", &format!("name = \"{long}"), 1),
    )
    .unwrap();
    fs::write(folder.path().join("key.json"), format!("{{\"{long}\": 1}}")).unwrap();
    fs::write(folder.path().join("log.csv"), format!("{long},b\n1,2\n")).unwrap();
    fs::write(folder.path().join("f.xosc"), format!("<{long}>")).unwrap();
    for arguments in [
        "simulate key.toml",
        "simulate value.toml",
        "simulate key.json",
        "check key.json",
        "import log.csv",
        "import f.xosc",
    ] {
        let refused = run_crumple(folder.path(), arguments);
        assert_reports(&refused, 2, arguments.split(' ').next_back().unwrap());
        assert!(
            stderr(&refused).chars().count() <= MAX_MESSAGE_CHARS + 100,
            "{arguments}: {}",
            stderr(&refused).len()
        );
    }
}

fn stdout_of(folder: &Path, arguments: &str) -> String {
    String::from_utf8(run_ok(folder, arguments).stdout).expect("text")
}

#[cfg(target_os = "linux")]
#[test]
fn errors_of_the_disk_end_with_3_whatever_is_read_or_written() {
    let folder = temp_folder();
    // Reading the memory of a process at address 0 is an input/output error.
    for ending in ["safetensors", "onnx", "toml", "json", "csv", "xosc"] {
        std::os::unix::fs::symlink("/proc/self/mem", folder.path().join(format!("m.{ending}")))
            .unwrap();
    }
    run_ok(
        folder.path(),
        "export paper-1 --to openscenario --as actions --out .",
    );
    fs::remove_file(folder.path().join("paper-1.xodr")).unwrap();
    std::os::unix::fs::symlink("/proc/self/mem", folder.path().join("paper-1.xodr")).unwrap();
    write_files_that_name(folder.path(), "m", "m.csv");
    for arguments in [
        "simulate paper-1 --controller m.safetensors",
        "simulate paper-1 --controller network.toml",
        "simulate m.toml",
        "falsify --controller idm --space m.toml --budget 5 --out f",
        "falsify --controller idm --space space.toml --budget 5 --out f",
        "retrain --space m.toml --out r",
        "import m.csv",
        "import m.xosc",
        "import paper-1.xosc",
        "import paper-1.xosc --distribution m.xosc",
        "import log.mf4 --map map.toml",
        "import log.mf4 --map m.toml",
        "check m.json",
        "describe m.onnx",
        "assess report.toml --out r",
        "fit m.csv --out s.toml",
        "train --preset m.toml --out t",
    ] {
        assert_reports(
            &run_crumple(folder.path(), arguments),
            3,
            ": Input/output error",
        );
    }
    // The temporary files of a long recording.
    let mut text = String::from("frame,id,x,width,xVelocity,laneId\n");
    for row in 0..500_100 {
        text += &format!("{},1,{row},4,25,1\n", row + 1);
    }
    fs::write(folder.path().join("tracks.csv"), text).unwrap();
    let mut command = command(folder.path(), "import tracks.csv --map highd");
    let full = command
        .env("TMPDIR", folder.path().join("none"))
        .output()
        .unwrap();
    assert_reports(&full, 3, "tracks.csv: a temporary file of the recording: ");
}
