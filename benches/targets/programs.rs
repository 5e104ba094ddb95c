//! The program as a user starts it, in wall-clock time.

use std::process::{Command, Stdio};

use crate::clock::min_wall_time_s;
use crate::table::Measurement;

fn run_crumple(arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
    let status = command
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    assert!(status.expect("starts").success(), "{arguments:?}");
}

pub fn measure(say: &mut dyn FnMut(Measurement)) {
    let [help_s, list_s] = min_wall_time_s(
        40,
        [&mut || run_crumple(&["--help"]), &mut || {
            run_crumple(&["list"])
        }],
    );
    say(Measurement::at_most(
        10.0,
        "ms",
        "`crumple --help` (wall clock)",
        1e3 * help_s,
    ));
    say(Measurement::at_most(
        10.0,
        "ms",
        "`crumple list` (wall clock)",
        1e3 * list_s,
    ));
}

/// Measures the peak memory of a campaign, on Linux only.
pub fn campaign_memory(say: &mut dyn FnMut(Measurement)) {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("campaign").display().to_string();
    // The second reference search makes the same number of evaluations.
    let arguments = [
        "--controller",
        "baseline",
        "--space",
        "paper",
        "--method",
        "uniform",
        "--budget",
        "5000000",
    ];
    let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
    command
        .args(["falsify", "-q", "--estimator", "truth", "--out", &out])
        .args(arguments);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    let mut campaign = command.spawn().expect("starts");
    let account = format!("/proc/{}/status", campaign.id());
    let mut most_kib = 0.0_f64;
    let status = loop {
        if let Some(status) = campaign.try_wait().expect("is there") {
            break status;
        }
        let text = std::fs::read_to_string(&account).unwrap_or_default();
        let peak = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = peak.and_then(|peak| peak.trim().trim_end_matches(" kB").parse().ok());
        most_kib = most_kib.max(kib.unwrap_or(0.0));
        std::thread::sleep(std::time::Duration::from_millis(50));
    };
    assert!(
        status.success() && most_kib > 0.0,
        "{status}, {most_kib} KiB"
    );
    say(Measurement::at_most(
        500.0,
        "MB",
        "memory of a campaign of 10⁷ evaluations, points that depend on nothing",
        1024.0 * most_kib / 1e6,
    ));
}

pub fn assessment(say: &mut dyn FnMut(Measurement)) {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("report").display().to_string();
    let start_s = crate::clock::wall_time_s();
    run_crumple(&["--quiet", "assess", "--out", &out]);
    say(Measurement::at_most(
        60.0,
        "s",
        "`crumple assess` (wall clock)",
        crate::clock::wall_time_s() - start_s,
    ));
}
