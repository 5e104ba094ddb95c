//! `crumple train`: output files, and resumption after a kill.

use super::*;

fn assert_same_seed_files(folder: &Path, runs: [&str; 2], seed: u64) {
    for name in ["policy.safetensors", "log.jsonl", "checkpoint.safetensors"] {
        let [one, other] =
            runs.map(|out| fs::read(folder.join(out).join(format!("seed-{seed}/{name}"))).unwrap());
        assert!(one == other, "{runs:?}, seed {seed}: {name}");
    }
}

/// A training may be extended after an evaluation or between two.
#[test]
fn a_training_that_is_made_longer_is_one_that_was_as_long_from_the_start() {
    let folder = temp_folder();
    let preset = replace_passages(
        &tiny::training(),
        &[("every_episodes = 1", "every_episodes = 3")],
    );
    fs::write(folder.path().join("tiny.toml"), preset).unwrap();
    let train = |out: &str, episodes: &str, more: &str| {
        let common = format!("train --preset tiny.toml --seed 4 --episodes {episodes} --out {out}");
        let trained = run_crumple(folder.path(), &format!("{common} {more}"));
        assert!(
            [0, 1].contains(&exit_code(&trained)),
            "{}",
            stderr(&trained)
        );
    };
    train("straight", "14", "");
    // Ends immediately, before learning starts, after an evaluation and between two.
    for (out, ends) in [("short", ["2", "3"]), ("longer", ["6", "11"])] {
        train(out, ends[0], "");
        let log = fs::read_to_string(folder.path().join(out).join("seed-4/log.jsonl")).unwrap();
        let last = log.lines().last().unwrap();
        let is_of_the_end =
            last.contains("evaluation") && last.contains(&format!("\"episode\":{}", ends[0]));
        assert!(is_of_the_end, "the last episode is evaluated: {last}");
        for episodes in [ends[1], "14"] {
            train(out, episodes, "--resume");
        }
        assert_same_seed_files(folder.path(), ["straight", out], 4);
    }
}

/// `training.json` covers all seeds, in any order and number of commands.
#[test]
fn seeds_are_gathered_and_trainings_of_another_kind_are_not_mixed_with_them() {
    let folder = temp_folder();
    fs::write(folder.path().join("tiny.toml"), tiny::training()).unwrap();
    let train = |more: &str| {
        let common = "train --preset tiny.toml --episodes 12 --out run";
        run_crumple(folder.path(), &format!("{common} {more}"))
    };
    let json = || read_json(&folder.path().join("run/training.json"));
    assert_eq!(exit_code(&train("--seed 5")), 0);
    let alone = json();
    assert_eq!(exit_code(&train("--seed 4")), 0);
    let both = json();
    let seeds: Vec<_> = both["seeds"]
        .as_array()
        .unwrap()
        .iter()
        .map(|seed| seed["seed"].as_u64().unwrap())
        .collect();
    assert_eq!(seeds, [4, 5]);
    assert_eq!(both["seeds"][1], alone["seeds"][0]);
    let curve = fs::read_to_string(folder.path().join("run/learning-curve.json")).unwrap();
    assert!(curve.contains("\"seeds\": 2"));
    // A copy of a seed folder under another spelling of its number is ignored.
    fs::create_dir(folder.path().join("run/seed-04")).unwrap();
    for name in file_names_in(&folder.path().join("run/seed-4")) {
        fs::copy(
            folder.path().join("run/seed-4").join(&name),
            folder.path().join("run/seed-04").join(&name),
        )
        .unwrap();
    }
    assert_eq!(exit_code(&train("--seed 4 --resume")), 0);
    assert_eq!(json()["seeds"], both["seeds"]);
    let other = replace_passages(&tiny::training(), &[("batch = 8", "batch = 9")]);
    fs::write(folder.path().join("other.toml"), other).unwrap();
    let other = run_crumple(
        folder.path(),
        "train --preset other.toml --seed 7 --out run",
    );
    for part in [
        "run/seed-4/training.toml: the training there has a different configuration: line ",
        " is `batch = 8` there, and `batch = 9` now",
    ] {
        assert_refused(&other, part);
    }
    assert!(
        !folder.path().join("run/seed-7").exists(),
        "nothing is begun"
    );
    // `training.toml` in the folder is a preset that gives the same policy.
    run_ok(
        folder.path(),
        "train --preset run/seed-5/training.toml --seed 5 --out again",
    );
    let policy =
        |run: &str| fs::read(folder.path().join(run).join("seed-5/policy.safetensors")).unwrap();
    assert!(policy("run") == policy("again"));
}

/// The policy file names the spaces of its training; an unknown space is refused before anything is written.
#[test]
fn episodes_are_drawn_from_spaces_by_name_and_file() {
    let folder = temp_folder();
    fs::write(folder.path().join("tiny.toml"), tiny::training()).unwrap();
    fs::write(
        folder.path().join("wet.toml"),
        "version = 1\nname = \"wet\"\nbase = \"paper-1\"\n[[parameters]]\nname = \"friction\"\nfield = \
         \"environment.friction\"\nunit = \"1\"\ndistribution.uniform = { low = 0.5, high = 1.0 }\n",
    )
    .unwrap();
    let train = |out: &str, spaces: &str| {
        let common = "train --preset tiny.toml --episodes 6 --seed 4";
        run_crumple(folder.path(), &format!("{common} --out {out} {spaces}"))
    };
    let of_paper = train("paper", "");
    let of_spaces = train("spaces", "--space wet.toml=3 --space steady");
    assert!(
        [0, 1].contains(&exit_code(&of_spaces)),
        "{}",
        stderr(&of_spaces)
    );
    assert!(
        [0, 1].contains(&exit_code(&of_paper)),
        "{}",
        stderr(&of_paper)
    );
    let text = fs::read_to_string(folder.path().join("spaces/seed-4/training.toml")).unwrap();
    assert!(
        text.contains("space = \"wet.toml\"") && text.contains("weight = 3.0"),
        "{text}"
    );
    let log = |out: &str| fs::read(folder.path().join(out).join("seed-4/log.jsonl")).unwrap();
    assert!(log("paper") != log("spaces"));
    for (space, reason) in [
        (
            "nowhere",
            "error: --space nowhere: `nowhere` is neither a built-in space",
        ),
        (
            "steady=0",
            "error: --space steady: the weight must be between 0.000001 and 1000000, found 0",
        ),
        ("steady=much", "`much` is not a weight"),
        ("steady=", "the weight after `=` is missing"),
        (
            "=1",
            "'=1' for '--space <S[=WEIGHT]>': the name of the scenario space is empty",
        ),
        ("paper-3.toml", "paper-3.toml"),
    ] {
        assert_refused(&train("refused", &format!("--space '{space}'")), reason);
        assert!(!folder.path().join("refused").exists());
    }
    let doubled = "error: --space traffic: `traffic` is named twice: give it one weight";
    assert_refused(
        &train(
            "refused",
            "--space traffic=0.5 --space steady --space traffic=0.5",
        ),
        doubled,
    );
    assert!(!folder.path().join("refused").exists());
}

/// With learning rates of 0 no checkpoint is better than the untrained network.
#[test]
fn a_failed_training_writes_no_policy_and_exits_with_an_error() {
    let folder = temp_folder();
    let still = replace_passages(
        &tiny::training(),
        &[
            ("actor_rate = 1e-4", "actor_rate = 0.0"),
            ("critic_rate = 1e-3", "critic_rate = 0.0"),
        ],
    );
    fs::write(folder.path().join("still.toml"), still).unwrap();
    let train = "train --preset still.toml --episodes 6 --out run";
    let trained = run_crumple(folder.path(), train);
    assert_reports(
        &trained,
        1,
        "no checkpoint was better than the untrained network",
    );
    assert!(
        stdout(&trained).contains("none: nothing learned"),
        "{}",
        stdout(&trained)
    );
    let seed = folder.path().join("run/seed-0");
    assert!(!seed.join("policy.safetensors").exists() && seed.join("result.json").exists());
    let again = run_crumple(folder.path(), &format!("{train} --resume"));
    assert_eq!((exit_code(&again), stdout(&again)), (1, stdout(&trained)));
}

#[test]
fn a_trained_policy_drives_and_a_damaged_one_is_refused() {
    let folder = temp_folder();
    fs::write(folder.path().join("tiny.toml"), tiny::training()).unwrap();
    run_ok(
        folder.path(),
        "train --preset tiny.toml --seed 4 --episodes 6 --out run",
    );
    let policy = "run/seed-4/policy.safetensors";
    let driven = run_ok(
        folder.path(),
        &format!("simulate paper-1 paper-3 --controller {policy}"),
    );
    assert!(stdout(&driven).starts_with(&format!("paper-1: {policy}, estimator kalman")));
    for name in ["training.json", "learning-curve.svg"] {
        assert!(folder.path().join("run").join(name).exists(), "{name}");
    }
    let bytes = fs::read(folder.path().join(policy)).unwrap();
    fs::write(
        folder.path().join("cut.safetensors"),
        &bytes[..bytes.len() - 9],
    )
    .unwrap();
    for (file, reason) in [
        ("cut.safetensors", "not a whole safetensors file"),
        ("none.safetensors", "No such file"),
    ] {
        assert_refused(
            &run_crumple(
                folder.path(),
                &format!("simulate paper-1 --controller {file}"),
            ),
            reason,
        );
    }
    let refused = run_crumple(folder.path(), &format!("train --preset {policy}"));
    assert_refused(
        &refused,
        &format!("{policy}: is not a preset, but a policy"),
    );
    // The error names the kind of the file, and the command that takes it.
    for (command, wanted) in [
        ("describe", "is not an imported network"),
        ("check", "is not a certificate"),
    ] {
        let drives = "but a policy: use it with `crumple simulate paper-1 --controller FILE`";
        let refused = run_crumple(folder.path(), &format!("{command} {policy}"));
        assert_refused(&refused, &format!("error: {policy}: {wanted}, {drives}"));
        let refused = run_crumple(
            folder.path(),
            &format!("{command} run/seed-4/checkpoint.safetensors"),
        );
        assert_refused(
            &refused,
            &format!("{wanted}, but a checkpoint: resume it with `crumple train`"),
        );
    }
    let described = run_crumple(folder.path(), "describe baseline");
    assert_refused(
        &described,
        "baseline: is not an imported network, but a controller",
    );
    assert_refused(
        &run_crumple(folder.path(), "check none.safetensors"),
        "none.safetensors: No such file",
    );
}

/// A training writes only inside its folder.
#[cfg(unix)]
#[test]
fn a_seed_folder_that_is_a_link_is_refused() {
    let folder = temp_folder();
    let elsewhere = folder.path().join("elsewhere");
    fs::create_dir_all(&elsewhere).unwrap();
    fs::create_dir_all(folder.path().join("out")).unwrap();
    std::os::unix::fs::symlink(&elsewhere, folder.path().join("out/seed-0")).unwrap();
    let output = run_crumple(folder.path(), "train --episodes 1 --out out --resume");
    assert_eq!(exit_code(&output), 2);
    assert_contains(stderr(&output), &["out/seed-0: is a symbolic link"]);
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
}
