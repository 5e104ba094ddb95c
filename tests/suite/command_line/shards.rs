//! Work that is divided: `--shard`, `crumple merge`, `crumple plan` and the job files that it writes.

use std::fs;
use std::path::Path;

use super::{assert_refused, code, crumple, folder, names_in, objects, stderr, stdout};

const COUNT: [&str; 7] =
    ["verify", "rate", "--controller=idm", "--space=high-risk", "--estimator=truth", "--runs=900", "--confidence=0.9"];

fn shard(folder: &Path, which: &str, out: &str) {
    let output = crumple(folder, &[&COUNT[..], &["--shard", which, "--out", out]].concat());
    assert_eq!(code(&output), 0, "{}", stderr(&output));
}

fn same_files(folder: &Path, one: &str, other: &str) {
    for name in names_in(&folder.join(one)) {
        let read = |of: &str| fs::read(folder.join(of).join(&name)).unwrap();
        assert_eq!(read(one), read(other), "{name}");
    }
}

#[test]
fn shards_that_are_merged_are_the_count_of_one_machine_and_what_is_missing_is_said() {
    let folder = folder();
    let folder = folder.path();
    assert_eq!(code(&crumple(folder, &[&COUNT[..], &["--out", "single"]].concat())), 0);
    shard(folder, "2/3", "s/b");
    shard(folder, "3/3", "s/c");
    let merge = |more: &[&str]| crumple(folder, &[&["merge", "--out", "rate"], more].concat());
    let output = merge(&["s/c", "s/b", "--format", "json"]);
    assert_eq!(code(&output), 1);
    assert_eq!(objects(&output)[0]["missing_shards"], serde_json::json!([1]));
    assert!(stderr(&output).contains("300 runs are missing, and nothing is written"), "{}", stderr(&output));
    assert!(stdout(&merge(&["s/b"])).contains("missing of 3 shards: 1,3\n"));
    assert!(!folder.join("rate").exists());
    fs::create_dir(folder.join("s/a")).unwrap();
    assert!(stderr(&merge(&["s/a", "s/b"])).contains("s/a: not begun"));
    shard(folder, "1/3", "s/a");
    for _ in 0..2 {
        let output = merge(&["s/c", "s/a", "s/b", "s/a"]);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        assert!(stdout(&output).contains("of 900 runs\nrate/certificate.json: accepted"), "{}", stdout(&output));
        same_files(folder, "single", "rate");
    }
    assert_refused(&merge(&["s/a", "single"]), "single: a count, which those before it are not");
    assert_refused(&merge(&["nowhere"]), "nowhere: there is no such folder");
    shard(folder, "1/2", "half");
    assert_refused(&merge(&["s/a", "half"]), "half: shard 1/2 has done what shard 1/3 in s/a has done, too");
    let progress = folder.join("s/a/progress.json");
    let text = fs::read_to_string(&progress).unwrap();
    fs::write(&progress, text.replacen("\"runs\": 300", "\"runs\": 400", 1)).unwrap();
    assert_refused(&merge(&["s/a", "s/b"]), "s/a/progress.json: not as it was written");
    assert_refused(&crumple(folder, &[&COUNT[..], &["--shard", "1/10"]].concat()), "there are 9 blocks of runs");
}

#[test]
fn shards_of_an_estimate_are_merged() {
    let folder = folder();
    let folder = folder.path();
    let rare = ["verify", "rate", "--controller=match-leader", "--rare", "--samples=50", "--repetitions=5"];
    let single = crumple(folder, &[&rare[..], &["--out", "single"]].concat());
    for index in ["1", "2"] {
        let which = format!("{index}/2");
        assert_eq!(code(&crumple(folder, &[&rare[..], &["--shard", &which, "--out", index]].concat())), 0);
    }
    let output = crumple(folder, &["merge", "2", "--out", "rare"]);
    assert_eq!(code(&output), 1);
    assert!(stderr(&output).contains("2 repetitions are missing, shards 1 of 2"), "{}", stderr(&output));
    let output = crumple(folder, &["merge", "2", "1", "--out", "rare"]);
    assert_eq!((code(&output), stdout(&output)), (0, stdout(&single)), "{}", stderr(&output));
    same_files(folder, "single", "rare");
}

/// As an engine would, with the words that the plan says.
#[cfg(unix)]
#[test]
fn what_a_plan_writes_makes_what_it_says() {
    let folder = folder();
    let folder = folder.path();
    let plan = ["plan", "--controller=idm", "--rate-below=0.01", "--failures=1", "--confidence=0.9", "--shards=3"];
    let output = crumple(folder, &[&plan[..], &["--estimator=truth", "--out", "it's; a plan"]].concat());
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(stdout(&output).contains("crumple merge 'it'\\''s; a plan/shards'/* --out"), "{}", stdout(&output));
    let out = folder.join("it's; a plan");
    assert_eq!(names_in(&out), ["hyperqueue_job.py", "plan.json", "ray_job.py", "slurm.sh", "task.sh"]);
    let planned: serde_json::Value = serde_json::from_slice(&fs::read(out.join("plan.json")).unwrap()).unwrap();
    assert!(planned["rate_at_most"].as_f64().unwrap() <= 0.01, "{planned}");
    for index in 1..=3 {
        let mut slurm = std::process::Command::new("sh");
        slurm.arg(out.join("slurm.sh")).current_dir(folder).env("SLURM_ARRAY_TASK_ID", index.to_string());
        let made = slurm.env("CRUMPLE", env!("CARGO_BIN_EXE_crumple")).output().unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    }
    let shards: Vec<String> = (1..=3).map(|index| format!("it's; a plan/shards/{index}")).collect();
    let shards: Vec<&str> = shards.iter().map(String::as_str).collect();
    let merged = crumple(folder, &[&["merge", "--out", "rate"], &shards[..]].concat());
    assert_eq!(code(&merged), 0, "{}", stderr(&merged));
    let words: Vec<String> = serde_json::from_value(planned["command"].clone()).unwrap();
    let words: Vec<&str> = words.iter().skip(1).map(String::as_str).collect();
    assert_eq!(code(&crumple(folder, &[&words[..], &["--out", "single"]].concat())), 0);
    same_files(folder, "single", "rate");
    for (more, said) in [
        ("--rate-below=0", "rate: must be above 0 and below 1"),
        ("--rate-below=1e-12", "would take more than 1000000000 runs"),
        ("--runs=0", "runs: must be from 1 to 1000000000"),
    ] {
        assert_refused(&crumple(folder, &["plan", "--controller=idm", more]), said);
    }
}
