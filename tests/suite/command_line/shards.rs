//! Divided work: `--shard`, `crumple merge`, `crumple plan` and its job files.

use std::fs;
use std::path::Path;

use crumple_core::digest::sha256;

use super::{assert_refused, exit_code, file_names_in, json_objects, run_crumple, run_ok, stderr, stdout, temp_folder};

const COUNT_ARGS: [&str; 7] =
    ["verify", "rate", "--controller=idm", "--space=high-risk", "--estimator=truth", "--runs=900", "--confidence=0.9"];

fn run_shard(folder: &Path, which: &str, out: &str) {
    run_ok(folder, &[&COUNT_ARGS[..], &["--shard", which, "--out", out]].concat());
}

fn assert_same_files(folder: &Path, one: &str, other: &str) {
    for name in file_names_in(&folder.join(one)) {
        let read = |of: &str| fs::read(folder.join(of).join(&name)).unwrap();
        assert_eq!(read(one), read(other), "{name}");
    }
}

#[test]
fn merged_shards_equal_one_count_and_missing_shards_are_named() {
    let folder = temp_folder();
    let folder = folder.path();
    assert_eq!(exit_code(&run_crumple(folder, &[&COUNT_ARGS[..], &["--out", "single"]].concat())), 0);
    run_shard(folder, "2/3", "s/b");
    run_shard(folder, "3/3", "s/c");
    let merge = |more: &[&str]| run_crumple(folder, &[&["merge", "--out", "rate"], more].concat());
    let output = merge(&["s/c", "s/b", "--format", "json"]);
    assert_eq!(exit_code(&output), 1);
    assert_eq!(json_objects(&output)[0]["missing_shards"], serde_json::json!([1]));
    assert!(stderr(&output).contains("300 runs are missing, and nothing is written"), "{}", stderr(&output));
    assert!(stdout(&merge(&["s/b"])).contains("missing of 3 shards: 1,3\n"));
    assert!(!folder.join("rate").exists());
    fs::create_dir(folder.join("s/a")).unwrap();
    assert!(stderr(&merge(&["s/a", "s/b"])).contains("s/a: not started"));
    run_shard(folder, "1/3", "s/a");
    for _ in 0..2 {
        let output = merge(&["s/c", "s/a", "s/b", "s/a"]);
        assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
        assert!(stdout(&output).contains("of 900 runs\nrate/certificate.json: accepted"), "{}", stdout(&output));
        assert_same_files(folder, "single", "rate");
    }
    assert_refused(
        &merge(&["s/a", "single"]),
        "single: a count, but the folders before it are of kind shard of a count",
    );
    assert_refused(&merge(&["s/a", "s/b", "--partial"]), "--partial: only for searches");
    assert_refused(&run_crumple(folder, &["merge", "s/a", "s/b", "s/c", "--out=s/b/rate"]), "is in the shard s/b;");
    // The error for another count in the folder names the field and both values.
    let other = run_crumple(folder, &[&COUNT_ARGS[..], &["--seed=1", "--shard=1/3", "--out=s/a", "--resume"]].concat());
    assert_refused(
        &other,
        "s/a/shard.json: the shard of a count there has a different \
        `count.registration.configuration.seed`: \"0\" instead of \"1\"",
    );
    let other = run_crumple(folder, &[&COUNT_ARGS[..], &["--seed=1", "--out=rate", "--resume"]].concat());
    assert_refused(
        &other,
        "rate/registration.json: the count there has a different `configuration.seed`: \"0\" instead of \"1\"",
    );
    assert_refused(&merge(&["nowhere"]), "nowhere: there is no such folder");
    run_shard(folder, "1/2", "half");
    assert_refused(&merge(&["s/a", "half"]), "half: shard 1/2 repeats work of shard 1/3 in s/a");
    // A folder without a manifest is no shard.
    fs::rename(folder.join("s/b/work.json"), folder.join("kept.json")).unwrap();
    for order in [["s/a", "s/b"], ["s/b", "s/a"]] {
        assert_refused(&merge(&order), "s/b/work.json: the file is missing");
    }
    fs::rename(folder.join("kept.json"), folder.join("s/b/work.json")).unwrap();
    let progress = folder.join("s/a/progress.json");
    let text = fs::read_to_string(&progress).unwrap();
    fs::write(&progress, text.replacen("\"runs\": 300", "\"runs\": 400", 1)).unwrap();
    assert_refused(&merge(&["s/a", "s/b"]), "s/a/progress.json: has changed since it was written");
    assert_refused(
        &run_crumple(folder, &[&COUNT_ARGS[..], &["--shard", "1/10"]].concat()),
        "there are 9 blocks of runs",
    );
}

#[test]
fn shards_of_an_estimate_are_merged() {
    let folder = temp_folder();
    let folder = folder.path();
    let rare = ["verify", "rate", "--controller=match-leader", "--rare", "--samples=50", "--repetitions=5"];
    let single = run_crumple(folder, &[&rare[..], &["--out", "single"]].concat());
    for index in ["1", "2"] {
        let which = format!("{index}/2");
        assert_eq!(exit_code(&run_crumple(folder, &[&rare[..], &["--shard", &which, "--out", index]].concat())), 0);
    }
    let output = run_crumple(folder, &["merge", "2", "--out", "rare"]);
    assert_eq!(exit_code(&output), 1);
    assert!(stderr(&output).contains("2 repetitions are missing, shards 1 of 2"), "{}", stderr(&output));
    let output = run_crumple(folder, &["merge", "2", "--out", "rare", "--format=json"]);
    assert_eq!(exit_code(&output), 1);
    let missing = serde_json::json!({ "missing_repetitions": 2, "of_shards": 2, "missing_shards": [1] });
    assert_eq!(json_objects(&output), [missing]);
    let output = run_crumple(folder, &["merge", "2", "1", "--out", "rare"]);
    assert_eq!((exit_code(&output), stdout(&output)), (0, stdout(&single)), "{}", stderr(&output));
    assert_same_files(folder, "single", "rare");
}

const SEARCH_ARGS: [&str; 5] =
    ["falsify", "--controller=match-leader", "--estimator=truth", "--budget=60", "--method=halton"];

/// Four files per shard; merged, a reference search gives the output of one machine, and an incomplete one the missing
/// ranges.
#[test]
fn shards_of_a_search_are_one_campaign() {
    let folder = temp_folder();
    let folder = folder.path();
    let single = run_ok(folder, &[&SEARCH_ARGS[..], &["--log=summary", "--out=single"]].concat());
    for index in ["1", "2", "3"] {
        let which = format!("{index}/3");
        run_ok(folder, &[&SEARCH_ARGS[..], &["--shard", &which, "--out", index]].concat());
        assert_eq!(file_names_in(&folder.join(index)), ["findings.json", "shard.json", "work.json", "work.lock"]);
    }
    let output = run_crumple(folder, &["merge", "3", "1", "--out=campaign"]);
    assert_eq!(exit_code(&output), 1);
    assert!(stdout(&output).contains("INCOMPLETE: missing of 3 shards: 2\n"), "{}", stdout(&output));
    assert!(stderr(&output).contains("20 evaluations of each method are missing, shards 2 of 3; nothing is written"));
    assert!(!folder.join("campaign").exists());
    let output = run_crumple(folder, &["merge", "3", "1", "--partial", "--out=part"]);
    assert_eq!(exit_code(&output), 1);
    assert!(file_names_in(&folder.join("part")).contains(&"summary.json".to_owned()));
    for _ in 0..2 {
        let output = run_crumple(folder, &["merge", "3", "1", "2", "3", "--out=campaign"]);
        assert_eq!((exit_code(&output), stdout(&output)), (0, stdout(&single)), "{}", stderr(&output));
    }
    for name in ["campaign.toml", "summary.json", "summary.txt", "work.json"] {
        assert_eq!(
            fs::read(folder.join("single").join(name)).unwrap(),
            fs::read(folder.join("campaign").join(name)).unwrap()
        );
    }
    assert_same_files(folder, "single/counterexamples/originals", "campaign/counterexamples/originals");
    // The result is a normal campaign, and a partial one is incomplete.
    let looked = run_crumple(folder, &["fsck", "campaign", "part"]);
    assert_eq!(exit_code(&looked), 0);
    assert!(stdout(&looked).contains("campaign: a campaign, complete; "), "{}", stdout(&looked));
    assert!(
        stdout(&looked).contains("part: a campaign, incomplete: merged without 20 evaluations of each method"),
        "{}",
        stdout(&looked)
    );
    let again = run_crumple(folder, &[&SEARCH_ARGS[..], &["--log=summary", "--out=campaign", "--resume"]].concat());
    assert_eq!((exit_code(&again), stdout(&again)), (0, stdout(&single)));
    let part = run_crumple(folder, &[&SEARCH_ARGS[..], &["--log=summary", "--out=part", "--resume"]].concat());
    assert_refused(&part, "the campaign there has a different `divided`");
    assert_refused(
        &run_crumple(folder, &["merge", "1", "2", "--partial", "--out=part"]),
        "the campaign there has a different `divided.missing_",
    );
    assert_refused(
        &run_crumple(folder, &[&SEARCH_ARGS[..], &["--shard=1/2", "--log=full"]].concat()),
        "a shard has no log",
    );
    assert_refused(
        &run_crumple(folder, &["merge", "1", "--format=junit", "--out=x"]),
        "JUnit and HTML are only for suites",
    );
}

#[test]
fn shards_of_a_suite_give_the_result_of_one_machine() {
    let folder = temp_folder();
    let folder = folder.path();
    let run = ["suite", "run", "afgbv-cut-in", "--controller=match-leader", "--controller=idm", "--estimator=truth"];
    for index in ["1", "2", "3", "4"] {
        let which = format!("{index}/4");
        run_ok(folder, &[&run[..], &["--shard", &which, "--out", index]].concat());
    }
    for format in ["text", "json", "junit"] {
        let single = run_crumple(folder, &[&run[..], &["--out=failures", "--format", format]].concat());
        fs::rename(folder.join("failures"), folder.join("single")).unwrap();
        let merged = run_crumple(folder, &["merge", "4", "2", "1", "3", "1", "--out=failures", "--format", format]);
        assert_eq!((exit_code(&merged), stdout(&merged)), (0, stdout(&single)), "{}", stderr(&merged));
        assert_same_files(folder, "single", "failures");
        fs::remove_dir_all(folder.join("single")).unwrap();
    }
    let output = run_crumple(folder, &["merge", "1", "2", "4", "--out=x"]);
    assert_eq!(exit_code(&output), 1);
    assert!(
        stderr(&output).contains("tests are missing, shards 3 of 4; nothing is written: cut-in-"),
        "{}",
        stderr(&output)
    );
    let output = run_crumple(folder, &["merge", "1", "2", "4", "--out=x", "--format=json"]);
    assert_eq!(exit_code(&output), 1);
    let missing = &json_objects(&output)[0];
    assert_eq!((&missing["missing_shards"], &missing["of_shards"]), (&serde_json::json!([3]), &serde_json::json!(4)));
    assert_eq!(missing["missing_tests"].as_array().unwrap().len(), 3, "{missing}");
    assert!(!folder.join("x").exists());
    run_ok(folder, &["suite", "run", "afgbv-cut-in", "--controller=idm", "--shard=1/2", "--out=other"]);
    assert_refused(&run_crumple(folder, &["merge", "1", "other", "--out=x"]), "the list of controllers differs");
    let results = folder.join("2/results.json");
    let text = fs::read_to_string(&results).unwrap();
    fs::write(&results, text.replacen("\"passed\":", "\"passed\": ", 1)).unwrap();
    assert_refused(
        &run_crumple(folder, &["merge", "1", "2", "--out=x"]),
        "2/results.json: has changed since it was written: it is longer",
    );
    assert_refused(&run_crumple(folder, &[&run[..], &["--shard=13/13"]].concat()), "which make 12 shards at most");
}

/// The report is written from merged evidence without new runs.
#[test]
fn shards_of_an_assessment_are_its_evidence() {
    let folder = temp_folder();
    let folder = folder.path();
    let config = "version = 1\ncontrollers = [\"baseline\", \"idm\"]\nsubject = \"idm\"\npaper = false\ndistributions \
        = [\"paper\"]\n\
                  draws = 20\neveryday_draws = 2\nsearch = { spaces = [\"paper\"], budget = 20 }\nrates = \
                  { runs = 100, confidence = 0.9 }\n";
    fs::write(folder.join("a.toml"), config).unwrap();
    assert_eq!(exit_code(&run_crumple(folder, &["assess", "a.toml", "--out=single"])), 0);
    for index in ["1", "2"] {
        let which = format!("{index}/2");
        run_ok(folder, &["assess", "a.toml", "--shard", &which, "--out", index]);
        assert_eq!(file_names_in(&folder.join(index)), ["evidence.json", "shard.json", "work.json", "work.lock"]);
    }
    let output = run_crumple(folder, &["merge", "2", "--out=report"]);
    assert_eq!(exit_code(&output), 1);
    assert!(stderr(&output).contains("evidence is missing, shards 1 of 2; `assess` would compute it: "));
    let output = run_crumple(folder, &["merge", "2", "--out=report", "--format=json"]);
    assert_eq!(exit_code(&output), 1);
    let message = &json_objects(&output)[0];
    assert_eq!(
        (&message["pieces"], &message["missing_shards"]),
        (&serde_json::json!(3), &serde_json::json!([1])),
        "{message}"
    );
    assert!(message["is_of_this_build"] == true && message["missing"].as_array().unwrap().len() == 2, "{message}");
    run_ok(folder, &["merge", "2", "1", "2", "--out=report"]);
    assert_same_files(folder, "single/evidence", "report/evidence");
    let output = run_crumple(folder, &["assess", "a.toml", "--out=report"]);
    assert!(stderr(&output).contains("5 of 5 pieces of evidence were reused"), "{}", stderr(&output));
    let report = |of: &str| {
        let text = fs::read_to_string(folder.join(of).join("assessment.json")).unwrap();
        let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
        // Date and duration differ.
        report["provenance"]["made"] = serde_json::Value::Null;
        report
    };
    assert_eq!(report("single"), report("report"));
    fs::write(folder.join("b.toml"), config.replace("draws = 20", "draws = 21")).unwrap();
    assert_eq!(exit_code(&run_crumple(folder, &["assess", "b.toml", "--shard=1/2", "--out=b"])), 0);
    assert_refused(
        &run_crumple(folder, &["merge", "2", "b", "--out=x"]),
        "the configuration, or a file that it names, differs",
    );
    assert_refused(
        &run_crumple(folder, &["assess", "a.toml", "--shard=6/6", "--out=x"]),
        "there are 5 pieces of evidence",
    );
}

#[test]
fn shards_of_trainings_are_put_together_with_their_results() {
    let folder = temp_folder();
    let folder = folder.path();
    let train = ["train", "--seeds=3", "--episodes=4"];
    run_crumple(folder, &[&train[..], &["--out=single"]].concat());
    for index in ["1", "2"] {
        let which = format!("{index}/2");
        run_crumple(folder, &[&train[..], &["--shard", &which, "--out", index]].concat());
    }
    assert!(stderr(&run_crumple(folder, &["merge", "2", "--out=all"])).contains("missing seeds of 3: 0"));
    let output = run_crumple(folder, &["merge", "2", "1", "2", "--out=all"]);
    assert!(!stderr(&output).contains("missing"), "{}", stderr(&output));
    assert_eq!(file_names_in(&folder.join("single")), file_names_in(&folder.join("all")));
    for name in ["training.json", "learning-curve.json", "learning-curve.svg"] {
        assert_eq!(
            fs::read(folder.join("single").join(name)).unwrap(),
            fs::read(folder.join("all").join(name)).unwrap()
        );
    }
    for seed in 0..3 {
        assert_same_files(folder, &format!("single/seed-{seed}"), &format!("all/seed-{seed}"));
    }
    let output = run_crumple(folder, &["merge", "2", "--out=some", "--format=json"]);
    let message = &json_objects(&output)[0];
    assert_eq!(
        (&message["missing_seeds"], &message["missing_shards"]),
        (&serde_json::json!([0]), &serde_json::json!([1]))
    );
    assert_eq!(message["seeds"].as_array().unwrap().len(), 2, "{message}");
    // A shard that was not begun is missing, in any order.
    fs::create_dir(folder.join("not")).unwrap();
    for order in [["not", "2"], ["2", "not"]] {
        let output = run_crumple(folder, &[&["merge", "--out=some"], &order[..]].concat());
        assert_eq!(exit_code(&output), 1);
        assert!(
            stderr(&output).contains("not: not started")
                && stderr(&output).contains("missing seeds of 3: 0, shards 1 of 2")
        );
    }
    let refused = |folders: &[&str], message: &str| {
        assert_refused(&run_crumple(folder, &[&["merge", "--out=x"], folders].concat()), message);
        assert!(!folder.join("x").exists());
    };
    run_crumple(folder, &[&train[..], &["--shard=1/1", "--out=whole"]].concat());
    refused(&["2", "whole"], "whole: shard 1/1 repeats work of shard 2/2 in 2");
    refused(&["1", "2", "--partial"], "--partial: only for searches");
    assert_refused(&run_crumple(folder, &["merge", "1", "2", "--out=2"]), "is in the shard 2;");
    run_shard(folder, "1/3", "count");
    let (count, trainings) = ("shard of a count", "shard of trainings");
    for (order, kind, earlier_kind) in [(["count", "1"], trainings, count), (["1", "count"], count, trainings)] {
        refused(&order, &format!("{}: a {kind}, but the folders before it are of kind {earlier_kind}", order[1]));
    }
    // A copy of a shard with another result for the same seed.
    run_crumple(folder, &[&train[..], &["--shard=1/2", "--out=copy"]].concat());
    let result = folder.join("copy/seed-0/result.json");
    let text = fs::read_to_string(&result).unwrap();
    let changed = text.replacen("\"unseen_contacts\": ", "\"unseen_contacts\": 1", 1);
    rewrite_with_manifest(&folder.join("copy/seed-0"), "result.json", &changed);
    refused(&["1", "2", "copy"], "copy: shard 1/2 has a different result in 1");
    // A seed in another shard, a shard with another record, and one without a record.
    fs::rename(folder.join("1/seed-0"), folder.join("2/seed-2-was")).unwrap();
    fs::rename(folder.join("2/seed-2"), folder.join("1/seed-0")).unwrap();
    refused(&["1", "2"], "1/seed-0/training.toml: differs from the configuration or seed");
    let text = fs::read_to_string(folder.join("2/shard.json")).unwrap();
    fs::write(folder.join("2/shard.json"), text.replace("\"seeds\": 3", "\"seeds\": 4")).unwrap();
    refused(&["2"], "2/shard.json: has changed since it was written");
    refused(&["single"], "single/shard.json: the file is missing");
}

fn rewrite_with_manifest(folder: &Path, name: &str, text: &str) {
    fs::write(folder.join(name), text).unwrap();
    let path = folder.join("work.json");
    let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let written = fs::read_to_string(&path).unwrap();
    let known = &manifest["files"][name]["whole"];
    let (bytes, digest) = (known["bytes"].as_u64().unwrap(), known["sha256"].as_str().unwrap());
    let of = |bytes: u64, digest: &str| format!("\"bytes\": {bytes},\n        \"sha256\": \"{digest}\"");
    let written = written.replace(&of(bytes, digest), &of(text.len() as u64, &sha256(text)));
    let own = manifest["sha256"].take();
    let own = own.as_str().unwrap();
    let bare = written.replace(own, "");
    fs::write(&path, written.replace(own, &sha256(bare))).unwrap();
}

/// Runs the planned commands of a search as an engine would.
#[cfg(unix)]
#[test]
fn a_plan_of_a_search_makes_its_shards() {
    let folder = temp_folder();
    let folder = folder.path();
    let formula = "--spec=always v1.gap_m > 0.5";
    let plan =
        ["plan", "--controller=idm", "--space=high-risk", "--budget=40", "--shards=2", "--method=uniform", formula];
    let output = run_ok(folder, &[&plan[..], &["--out=p"]].concat());
    assert!(stdout(&output).contains("80 evaluations: 40 by uniform"), "{}", stdout(&output));
    for index in ["1", "2"] {
        let mut task = std::process::Command::new("sh");
        task.args(["p/task.sh", index]).current_dir(folder).env("CRUMPLE", env!("CARGO_BIN_EXE_crumple"));
        assert!(task.output().unwrap().status.success());
    }
    let merged = run_crumple(folder, &["merge", "p/shards/1", "p/shards/2", "--out=campaign"]);
    let planned: serde_json::Value = serde_json::from_slice(&fs::read(folder.join("p/plan.json")).unwrap()).unwrap();
    let words: Vec<String> = serde_json::from_value(planned["command"].clone()).unwrap();
    let words: Vec<&str> = words.iter().skip(1).map(String::as_str).collect();
    let single = run_crumple(folder, &[&words[..], &["--log=summary", "--out=single"]].concat());
    assert_eq!((exit_code(&merged), stdout(&merged)), (0, stdout(&single)), "{}", stderr(&merged));
    assert_refused(&run_crumple(folder, &[&plan[..], &["--runs=10"]].concat()), "cannot be used with");
    assert_refused(&run_crumple(folder, &[&plan[..], &["--out=p"]].concat()), "p: is not empty: use --force");
    let again = run_ok(folder, &[&plan[..], &["--out=p", "--force", "--format=json"]].concat());
    let read = |text: &[u8]| serde_json::from_slice::<serde_json::Value>(text).unwrap();
    assert_eq!(read(&again.stdout), read(&fs::read(folder.join("p/plan.json")).unwrap()));
    let output = run_ok(folder, &[&plan[..], &["--out=-x"]].concat());
    for line in
        ["python3 ./-x/hyperqueue_job.py\n", "sbatch ./-x/slurm.sh\n", "merge ./-x/shards/* --out ./-x/campaign\n"]
    {
        assert!(stdout(&output).contains(line), "{}", stdout(&output));
    }
    let mut task = std::process::Command::new("sh");
    task.args(["./-x/task.sh", "1"]).current_dir(folder).env("CRUMPLE", env!("CARGO_BIN_EXE_crumple"));
    assert!(task.output().unwrap().status.success() && folder.join("-x/shards/1/work.json").exists());
    assert_eq!(exit_code(&run_crumple(folder, &["merge", "./-x/shards/1", "p/shards/2", "--out=campaign"])), 0);
    assert_refused(
        &run_crumple(folder, &["plan", "--controller=idm", "--budget=3", "--shards=4"]),
        "there are 3 evaluations",
    );
}

/// Runs the planned commands as an engine would.
#[cfg(unix)]
#[test]
fn job_files_produce_the_planned_result() {
    let folder = temp_folder();
    let folder = folder.path();
    let plan = ["plan", "--controller=idm", "--rate-below=0.01", "--failures=1", "--confidence=0.9", "--shards=3"];
    let output = run_crumple(folder, &[&plan[..], &["--estimator=truth", "--out", "it's; a plan"]].concat());
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    assert!(stdout(&output).contains("crumple merge 'it'\\''s; a plan/shards'/* --out"), "{}", stdout(&output));
    let out = folder.join("it's; a plan");
    assert_eq!(file_names_in(&out), ["hyperqueue_job.py", "plan.json", "ray_job.py", "slurm.sh", "task.sh"]);
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
    run_ok(folder, &[&["merge", "--out", "rate"], &shards[..]].concat());
    let words: Vec<String> = serde_json::from_value(planned["command"].clone()).unwrap();
    let words: Vec<&str> = words.iter().skip(1).map(String::as_str).collect();
    assert_eq!(exit_code(&run_crumple(folder, &[&words[..], &["--out", "single"]].concat())), 0);
    assert_same_files(folder, "single", "rate");
    for (more, message) in [
        ("--rate-below=0", "rate: must be above 0 and below 1"),
        ("--rate-below=1e-12", "would take more than 1000000000 runs"),
        ("--runs=0", "runs: must be from 1 to 1000000000"),
    ] {
        assert_refused(&run_crumple(folder, &["plan", "--controller=idm", more]), message);
    }
}

/// Writes stubs of the engines' packages, which print their arguments and report that no server answers.
#[cfg(unix)]
fn write_engine_stubs(folder: &Path) {
    let write = |name: &str, text: &str| {
        let path = folder.join("packages").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    write(
        "ray.py",
        "import os\ndef init(**asked):\n    print(asked, os.environ.get('RAY_AUTH_MODE'))\n    raise \
         ConnectionError('nobody\\nis there')\n",
    );
    write("hyperqueue/__init__.py", "Job = None\n");
    write("hyperqueue/cluster.py", "LocalCluster = WorkerConfig = None\n");
    write("hyperqueue/ffi/__init__.py", "");
    write("hyperqueue/ffi/protocol.py", "ResourceRequest = None\n");
    write(
        "hyperqueue/client.py",
        "class Client:\n    def __init__(self, folder):\n        raise Exception('nobody\\nis there')\n",
    );
}

/// Without a named cluster no job starts; an unreachable one gives a one-line error.
#[cfg(unix)]
#[test]
fn job_files_connect_only_to_named_hosts() {
    let folder = temp_folder();
    let folder = folder.path();
    let python = |words: &[&str], address: Option<&str>| {
        let mut python = std::process::Command::new("python3");
        python.args(words).current_dir(folder).env("PYTHONPATH", folder.join("packages"));
        python.env_remove("RAY_ADDRESS").env_remove("RAY_AUTH_MODE");
        address.map(|address| python.env("RAY_ADDRESS", address));
        python.output()
    };
    if !python(&["--version"], None).is_ok_and(|found| found.status.success()) {
        println!("skipped: there is no python3");
        return;
    }
    write_engine_stubs(folder);
    assert_eq!(
        exit_code(&run_crumple(folder, &["plan", "--controller=idm", "--runs=100", "--shards=1", "--out=p"])),
        0
    );
    let message = |words: &[&str], address: Option<&str>| {
        let output = python(words, address).unwrap();
        assert_eq!((exit_code(&output), stderr(&output).lines().count()), (1, 1), "{}", stderr(&output));
        (stdout(&output).to_owned(), stderr(&output).to_owned())
    };
    let (asked, why) = message(&["p/ray_job.py"], None);
    assert!(asked.is_empty() && why.starts_with("no cluster is named: ") && why.contains("--local N"), "{asked}{why}");
    for (words, address, asked_for) in [
        (&["p/ray_job.py", "--address=auto"][..], None, "{'address': 'auto'} None\n"),
        (&["p/ray_job.py"], Some("10.0.0.1:6379"), "{'address': '10.0.0.1:6379'} None\n"),
        (&["p/ray_job.py"], Some("local"), "{'address': 'local'} disabled\n"),
        (
            &["p/ray_job.py", "--local=2"],
            Some("auto"),
            "{'address': 'local', 'num_cpus': 2, 'include_dashboard': False} disabled\n",
        ),
    ] {
        let (asked, why) = message(words, address);
        assert_eq!(asked, asked_for);
        assert!(why.ends_with(": nobody\n"), "{why}");
    }
    let (_, why) = message(&["p/hyperqueue_job.py"], None);
    assert!(why.starts_with("no server of HyperQueue runs here") && why.contains("--local N starts one"), "{why}");
}
