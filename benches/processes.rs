//! Controllers that are processes: time per decision, from the observation to the command.
//!
//! `cargo bench --bench processes`. The counted item is one decision, at every step of 0.01 s; its time includes the
//! simulated step and the process. The examples of `examples/controllers` read three inputs; those without a compiler
//! or interpreter on this machine are skipped. One thread; for one core, prefix `taskset -c 0`.

#![allow(clippy::expect_used, reason = "a bench may stop at what cannot happen")]

use std::path::Path;
use std::process::Command;
use std::{fs, iter};

use crumple_controllers::find_for_user;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{Scenario, built_in_scenario};
use crumple_world::sim::{NamedController, RecordingLevel, Run, RunOptions, simulate_batch};
use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    divan::main();
}

/// Commands of the examples, and the number of simultaneous runs.
const CASES: [(&str, usize); 3] = [
    ("\"python3\", \"follower.py\", \"alone\"", 1),
    ("\"./follower\"", 1),
    ("\"python3\", \"follower.py\"", 64),
];

/// Writes a controller file that passes a command the inputs of the examples.
fn write_controller(command: &str, folder: &Path) -> Option<NamedController> {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/controllers");
    fs::copy(examples.join("follower.py"), folder.join("follower.py")).expect("the example");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-O2", "-lm", "-o", "follower"])
        .arg(examples.join("follower.c"))
        .arg("-lm")
        .current_dir(folder);
    let needed = if command.contains("python3") {
        Command::new("python3").arg("--version").output()
    } else {
        compiler.output()
    };
    if !needed.is_ok_and(|needed| needed.status.success()) {
        return None;
    }
    let inputs = ["gap_ahead_m", "relative_speed_ahead_mps", "speed_mps"];
    let inputs: String = inputs
        .map(|name| format!("[[inputs]]\nquantity = \"{name}\"\n"))
        .concat();
    let text = format!("version = 1\ncommand = [{command}]\n{inputs}");
    fs::write(folder.join("controller.toml"), text).expect("writable");
    Some(find_for_user("controller.toml", folder).expect("a controller file"))
}

fn long_scenario() -> Scenario {
    built_in_scenario("paper-1")
        .expect("built in")
        .edited(|spec| spec.duration_s = 60.0)
        .expect("valid")
}

#[divan::bench(args = CASES, sample_count = 20)]
fn decisions(bencher: Bencher<'_, '_>, (command, runs): (&str, usize)) {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(controller) = write_controller(command, folder.path()) else {
        return;
    };
    let scenario = long_scenario();
    let options = RunOptions::new(controller.source).with_estimator(EstimatorKind::Truth);
    let runs: Vec<_> = iter::repeat_with(|| Run::new(&scenario, options.clone()).expect("it fits"))
        .take(runs)
        .collect();
    let threads = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a thread");
    let drive = || {
        threads
            .install(|| simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome))
    };
    // The determinism check sends every query of the first two runs twice.
    assert!(
        (0..2).all(|_| drive().iter().all(|outcome| outcome.is_safe())),
        "the examples are safe"
    );
    bencher
        .counter(ItemsCount::new(runs.len() * scenario.steps()))
        .bench_local(drive);
}
