//! Divided work: `--shard` and `crumple merge`.

use super::*;

const COUNT_ARGS: &str = "verify rate --controller=idm --space=high-risk --estimator=truth --runs=900 --confidence=0.9";

fn run_shard(folder: &Path, which: &str, out: &str) {
    run_ok(folder, &format!("{COUNT_ARGS} --shard {which} --out {out}"));
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
    run_ok(folder, &format!("{COUNT_ARGS} --out single"));
    run_shard(folder, "2/3", "s/b");
    run_shard(folder, "3/3", "s/c");
    let merge = |more: &str| run_crumple(folder, &format!("merge --out rate {more}"));
    let output = merge("s/c s/b --format json");
    assert_eq!(exit_code(&output), 1);
    assert_eq!(json_objects(&output)[0]["missing_shards"], json!([1]));
    assert!(stderr(&output).contains("300 runs are missing, and nothing is written"), "{}", stderr(&output));
    assert!(stdout(&merge("s/b")).contains("missing of 3 shards: 1,3\n"));
    assert!(!folder.join("rate").exists());
    fs::create_dir(folder.join("s/a")).unwrap();
    assert!(stderr(&merge("s/a s/b")).contains("s/a: not started"));
    run_shard(folder, "1/3", "s/a");
    for _ in 0..2 {
        assert_prints(&merge("s/c s/a s/b s/a"), 0, &["of 900 runs\nrate/certificate.json: accepted"]);
        assert_same_files(folder, "single", "rate");
    }
    assert_refused(&merge("s/a single"), "single: a count, but the folders before it are of kind shard of a count");
    assert_refused(&run_crumple(folder, "merge s/a s/b s/c --out=s/b/rate"), "is in the shard s/b;");
    // The error for another count in the folder names the field and both values.
    let other = run_crumple(folder, &format!("{COUNT_ARGS} --seed=1 --shard=1/3 --out=s/a --resume"));
    assert_refused(
        &other,
        "s/a/shard.json: the shard of a count there has a different \
        `count.registration.configuration.seed`: \"0\" instead of \"1\"",
    );
    let other = run_crumple(folder, &format!("{COUNT_ARGS} --seed=1 --out=rate --resume"));
    assert_refused(
        &other,
        "rate/registration.json: the count there has a different `configuration.seed`: \"0\" instead of \"1\"",
    );
    assert_refused(&merge("nowhere"), "nowhere: there is no such folder");
    run_shard(folder, "1/2", "half");
    assert_refused(&merge("s/a half"), "half: shard 1/2 repeats work of shard 1/3 in s/a");
    // A folder without a manifest is no shard.
    fs::rename(folder.join("s/b/work.json"), folder.join("kept.json")).unwrap();
    for order in ["s/a s/b", "s/b s/a"] {
        assert_refused(&merge(order), "s/b/work.json: the file is missing");
    }
    fs::rename(folder.join("kept.json"), folder.join("s/b/work.json")).unwrap();
    let progress = folder.join("s/a/progress.json");
    let text = fs::read_to_string(&progress).unwrap();
    fs::write(&progress, text.replacen("\"runs\": 300", "\"runs\": 400", 1)).unwrap();
    assert_refused(&merge("s/a s/b"), "s/a/progress.json: has changed since it was written");
    assert_refused(&run_crumple(folder, &format!("{COUNT_ARGS} --shard 1/10")), "there are 9 blocks of runs");
}

#[test]
fn shards_of_trainings_are_put_together_with_their_results() {
    let folder = temp_folder();
    let folder = folder.path();
    let train = "train --seeds=3 --episodes=4";
    run_crumple(folder, &format!("{train} --out=single"));
    for index in ["1", "2"] {
        let which = format!("{index}/2");
        run_crumple(folder, &format!("{train} --shard {which} --out {index}"));
    }
    assert!(stderr(&run_crumple(folder, "merge 2 --out=all")).contains("missing seeds of 3: 0"));
    let output = run_crumple(folder, "merge 2 1 2 --out=all");
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
    let output = run_crumple(folder, "merge 2 --out=some --format=json");
    let message = &json_objects(&output)[0];
    assert_eq!((&message["missing_seeds"], &message["missing_shards"]), (&json!([0]), &json!([1])));
    assert_eq!(message["seeds"].as_array().unwrap().len(), 2, "{message}");
    // A shard that was not begun is missing, in any order.
    fs::create_dir(folder.join("not")).unwrap();
    for order in ["not 2", "2 not"] {
        let output = run_crumple(folder, &format!("merge --out=some {order}"));
        assert_reports(&output, 1, "not: not started");
        assert_contains(stderr(&output), &["missing seeds of 3: 0, shards 1 of 2"]);
    }
    let refused = |folders: &str, message: &str| {
        assert_refused(&run_crumple(folder, &format!("merge --out=x {folders}")), message);
        assert!(!folder.join("x").exists());
    };
    run_crumple(folder, &format!("{train} --shard=1/1 --out=whole"));
    refused("2 whole", "whole: shard 1/1 repeats work of shard 2/2 in 2");
    assert_refused(&run_crumple(folder, "merge 1 2 --out=2"), "is in the shard 2;");
    run_shard(folder, "1/3", "count");
    let mixed =
        |kind: &str, earlier_kind: &str| format!("a {kind}, but the folders before it are of kind {earlier_kind}");
    refused("count 1", &format!("1: {}", mixed("shard of trainings", "shard of a count")));
    refused("1 count", &format!("count: {}", mixed("shard of a count", "shard of trainings")));
    // A copy of a shard with another result for the same seed.
    run_crumple(folder, &format!("{train} --shard=1/2 --out=copy"));
    let result = folder.join("copy/seed-0/result.json");
    let text = fs::read_to_string(&result).unwrap();
    let changed = text.replacen("\"unseen_contacts\": ", "\"unseen_contacts\": 1", 1);
    fs::write(result, changed).unwrap();
    rehash_manifest(&folder.join("copy/seed-0"));
    refused("1 2 copy", "copy: shard 1/2 has a different result in 1");
    // A seed in another shard, a shard with another record, and one without a record.
    fs::rename(folder.join("1/seed-0"), folder.join("2/seed-2-was")).unwrap();
    fs::rename(folder.join("2/seed-2"), folder.join("1/seed-0")).unwrap();
    refused("1 2", "1/seed-0/training.toml: differs from the configuration or seed");
    let text = fs::read_to_string(folder.join("2/shard.json")).unwrap();
    fs::write(folder.join("2/shard.json"), text.replace("\"seeds\": 3", "\"seeds\": 4")).unwrap();
    refused("2", "2/shard.json: has changed since it was written");
    refused("single", "single/shard.json: the file is missing");
}
