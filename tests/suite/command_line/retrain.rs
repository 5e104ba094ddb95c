//! `crumple retrain`: output files, and resumption after a kill.

use super::*;

const RETRAIN_ARGS: &str = "retrain --preset tiny.toml --space high-risk --rounds 2 --episodes 25 --budget 12 \
    --draws 15 --validation-draws 8 --nominal 10 --test-draws 12 --regression-draws 10 --seed 3";

fn file_sha256(path: &Path) -> String {
    sha256(fs::read(path).unwrap())
}

mod tier_2 {
    use super::*;

    #[test]
    #[ignore = "tier 2: eight retrainings"]
    fn a_retraining_killed_again_and_again_ends_with_the_same_bytes_on_any_number_of_threads() {
        let folder = temp_folder();
        // The preset's scenario spaces replace the paper's distribution in the training.
        let traffic = "[[spaces]]\nspace = \"traffic\"\nweight = 1\ncost_multiplier = 100\n";
        fs::write(
            folder.path().join("tiny.toml"),
            format!("{}\n{traffic}", tiny::retraining()),
        )
        .unwrap();
        let json = format!("{RETRAIN_ARGS} --format json");
        let through = assert_survives_kills(
            folder.path(),
            &json,
            (0..6).map(|attempt| 20..300 + 200 * attempt),
        );
        check_report(&folder.path().join("through"), &json_objects(&through)[0]);
        for round in ["01", "02"] {
            let path = folder
                .path()
                .join("through/rounds")
                .join(round)
                .join("candidate.safetensors");
            let header = crumple_sim::policy::Policy::load(&path)
                .unwrap()
                .header()
                .training
                .clone();
            let scenarios = header["scenarios"].as_str().unwrap();
            assert_contains(
                scenarios,
                &[
                    "a share of 0.2 of ",
                    " cases (",
                    "otherwise a share of 1 of the space `traffic`",
                ],
            );
        }
        let plan = fs::read_to_string(folder.path().join("through/retrain.toml")).unwrap();
        assert_contains(&plan, &["nominal_share = 0", "cost_multiplier = 100"]);
        let again = run_crumple(folder.path(), &format!("{RETRAIN_ARGS} --out killed"));
        assert_eq!(
            exit_code(&again),
            2,
            "an existing retraining is not overwritten"
        );
        let policy = "--policy through/rounds/01/before.safetensors";
        let other = run_crumple(
            folder.path(),
            &format!("{RETRAIN_ARGS} --out killed --resume {policy}"),
        );
        assert_refused(&other, "the retraining there has a different configuration");
        let read = run_crumple(folder.path(), &format!("{json} --out killed --resume"));
        assert_eq!(
            (exit_code(&read), stdout(&read)),
            (exit_code(&through), stdout(&through)),
            "a complete one is read"
        );
        let whole = run_crumple(folder.path(), "fsck killed");
        assert!(
            exit_code(&whole) == 0 && !stdout(&whole).contains("not part of these results"),
            "{}",
            stdout(&whole)
        );
        fs::write(
            folder.path().join("killed/rounds/01/search/mine.txt"),
            "of another",
        )
        .unwrap();
        fs::create_dir(folder.path().join("killed/rounds/001")).unwrap();
        let looked = run_crumple(folder.path(), "fsck killed");
        for stranger in ["rounds/01/search/mine.txt", "rounds/001"] {
            assert_contains(
                stdout(&looked),
                &[&format!("  {stranger}: not part of these results")],
            );
        }
    }
}

/// Checks hashes, that every round was searched and decided, and that the exit code states whether one was accepted.
fn check_report(folder: &Path, report: &Value) {
    assert_eq!(
        *report,
        fs::read_to_string(folder.join("report.json"))
            .unwrap()
            .parse::<Value>()
            .unwrap()
    );
    let files = report["files"].as_array().unwrap();
    let names: Vec<_> = files
        .iter()
        .map(|file| file["file"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "policy.safetensors",
            "retrained-on.json",
            "selection.json",
            "validation-set.json",
            "test-set.json"
        ]
    );
    for file in files {
        assert_eq!(
            file["sha256"],
            file_sha256(&folder.join(file["file"].as_str().unwrap()))
        );
    }
    assert_eq!(report["retrained_sha256"], files[0]["sha256"]);
    assert_eq!(
        report["plan_sha256"],
        file_sha256(&folder.join("retrain.toml"))
    );
    let rounds = report["rounds"].as_array().unwrap();
    assert_eq!(rounds.len(), 2);
    let mut standing = &report["first_results"];
    for round in rounds {
        assert_eq!(
            round["findings"]["evaluations"], 36,
            "the method and both reference searches"
        );
        assert!(
            !round["findings"]["avoidable_draws"]["indices"]
                .as_array()
                .unwrap()
                .is_empty()
        );
        if round["acceptance"] == "accepted" {
            // The acceptance rule, checked on the lists.
            let list = |of: &Value, field: &str| of[field].as_array().unwrap().clone();
            for field in ["paper", "nominal"] {
                let before = list(standing, field);
                assert!(
                    list(&round["after"], field)
                        .iter()
                        .all(|failure| before.contains(failure)),
                    "{field}"
                );
            }
            assert!(
                list(&round["after"], "validation_set").len()
                    <= list(standing, "validation_set").len()
            );
            standing = &round["after"];
        }
    }
    assert_eq!(report["retrained_results"], *standing);
    assert_eq!(report["test_draws"], 12);
    let pairs = &report["pairs"];
    let pairs: u64 = ["both", "first_only", "retrained_only", "neither"]
        .map(|field| pairs[field].as_u64().unwrap())
        .iter()
        .sum();
    assert_eq!(pairs, 12);
    assert!(
        fs::read_to_string(folder.join("report.md"))
            .unwrap()
            .starts_with("# Retraining of `policy` in the space")
    );
}

/// The policy observes its last answer, and is attacked in every space of its preset.
#[test]
fn an_imitation_is_retrained_in_all_spaces() {
    let folder = temp_folder();
    let imitation = include_str!("../../../crates/learn/src/rl/tests/imitation.toml");
    let spaces = ["high-risk", "paper"]
        .map(|space| format!("[[spaces]]\nspace = \"{space}\"\nweight = 1\n"))
        .concat();
    let preset = tiny::retraining().replace("episodes = 1000", "episodes = 0");
    fs::write(
        folder.path().join("tiny.toml"),
        format!("{preset}\n{imitation}\n{spaces}"),
    )
    .unwrap();
    run_ok(
        folder.path(),
        "train --preset tiny.toml --seed 1 --out first",
    );
    let arguments = "retrain --policy first/seed-1/policy.safetensors --preset tiny.toml --rounds 1 --budget 12 \
        --draws 15 --validation-draws 8 --nominal 10 --test-draws 12 --regression-draws 10 --format json";
    let retrained = run_crumple(folder.path(), arguments);
    let report = &json_objects(&retrained)[0];
    assert_eq!(report["space"], "high-risk, paper");
    let round = &report["rounds"][0];
    assert_eq!(
        (
            &round["findings"]["draws"],
            &round["findings"]["evaluations"]
        ),
        (&30.into(), &72.into())
    );
    assert_eq!(
        (&round["training"]["to_episode"], &report["test_draws"]),
        (&0.into(), &24.into())
    );
    let expected = if !report["retrained_results"]["paper"]
        .as_array()
        .unwrap()
        .is_empty()
    {
        "failed: seed 0: the policy collides in paper-"
    } else if round["acceptance"] == "accepted" {
        ""
    } else {
        "failed: no round was accepted"
    };
    assert_contains(
        stderr(&retrained),
        &["It ended with its last round: 1 made, ", expected],
    );
    assert_eq!(exit_code(&retrained), i32::from(!expected.is_empty()));
    let again = run_crumple(folder.path(), &format!("{arguments} --resume"));
    assert_eq!(
        (exit_code(&again), stdout(&again)),
        (exit_code(&retrained), stdout(&retrained))
    );
}

#[test]
fn mistakes_are_reported_before_anything_is_written() {
    let folder = temp_folder();
    let retrain = |arguments: &str| {
        let output = run_crumple(folder.path(), &format!("retrain {arguments}"));
        assert_eq!((exit_code(&output), stdout(&output)), (2, ""));
        stderr(&output).to_owned()
    };
    assert!(
        retrain("--policy idm")
            .contains("`idm` cannot be retrained: use `policy`, `retrained`, `road`, or")
    );
    assert!(retrain("--policy shield:policy").contains("cannot be retrained"));
    fs::write(
        folder.path().join("lists.toml"),
        "version = 1\nname = \"x\"\nepisodes = 1\nenvironment = [1, 2]\n",
    )
    .unwrap();
    assert!(retrain("--preset lists.toml").starts_with("error: lists.toml:4: environment: "));
    fs::remove_file(folder.path().join("lists.toml")).unwrap();
    assert!(retrain("--space ''").contains("the name of the scenario space is empty"));
    assert!(
        retrain("--space nowhere")
            .contains("neither a built-in space (paper, high-risk, traffic, ")
    );
    // A network trained with another scaling would misread its inputs.
    let differ = "and the training preset `road` differ in the observation or its scaling";
    assert!(retrain("--preset road").contains(differ));
    let road = format!(
        "{}/crates/sim/src/policy/road.safetensors",
        env!("CARGO_MANIFEST_DIR")
    );
    let differ = "and the training preset `retrain` differ in";
    assert!(retrain(&format!("--policy '{road}' --preset retrain")).contains(differ));
    assert!(
        retrain("--scenario paper-3")
            .contains("--scenario: `paper-3` cannot be trained on: only vehicle 1 ")
    );
    assert!(
        retrain("--scenario none --scenario paper-1")
            .contains("`none` cannot be combined with scenarios")
    );
    assert!(
        retrain("--regression none --regression paper")
            .contains("`none` cannot be combined with spaces")
    );
    assert!(
        retrain("--regression paper --regression paper")
            .contains("two spaces have the name `paper`")
    );
    assert!(retrain("--regression nowhere").contains("--regression: `nowhere` is neither"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
