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
    assert_refused(&merge("s/a single"), "single: a count, not a shard of a count");
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
