//! `avoid`, `check` and `worst-case` on the command line.

use crumple_sim::scenario::{Driver, built_in_scenario, file};

use super::*;

#[test]
fn an_escape_is_written_replayed_and_checked() {
    let folder = temp_folder();
    let run = |arguments: &str| run_crumple(folder.path(), arguments);
    let files = "--certificate proof.json --out escape.toml --plot escape.svg --format json";
    let avoided = run(&format!("avoid paper-1 {files}"));
    assert_eq!(exit_code(&avoided), 0);
    let report = json_objects(&avoided).remove(0);
    assert_eq!(report["verdict"], "avoidable");
    assert!(
        (report["best_min_gap_m"].as_f64().unwrap() - 8.4).abs() < 0.2,
        "{report}"
    );
    assert!(
        (report["trigger_time_s"].as_f64().unwrap() - 3.2).abs() < 0.2,
        "{report}"
    );
    assert_eq!(
        exit_code(&run("simulate escape.toml --dt 0.001 --expect safe")),
        0
    );
    assert_eq!(exit_code(&run("check proof.json --scenario paper-1")), 0);
    assert_eq!(exit_code(&run("check proof.json --scenario paper-2")), 1);
    assert_prints(
        &run("check proof.json --work-limit 0"),
        1,
        &["the check takes more than the allowed 0 operations"],
    );
    let proof = fs::read_to_string(folder.path().join("proof.json")).unwrap();
    fs::write(
        folder.path().join("forged.json"),
        proof.replace("\"ttc_s\":1.4", "\"ttc_s\":0.4"),
    )
    .unwrap();
    let forged = run("check forged.json");
    assert_eq!(exit_code(&forged), 1, "{}", stdout(&forged));
    fs::write(folder.path().join("other.json"), "{}").unwrap();
    assert_eq!(exit_code(&run("check other.json")), 2);
    assert_eq!(exit_code(&run("avoid paper-1 --grid 0.015")), 2);
}

/// An escape is only the best on its grid; the output must not call it optimal.
#[test]
fn an_escape_on_a_finer_grid_may_keep_more_and_none_is_called_the_best_there_is() {
    let folder = temp_folder();
    let gap_m = |grid: &str| {
        let message = run_ok(
            folder.path(),
            &format!("avoid paper-2 --grid {grid} --format json"),
        );
        let report = json_objects(&message).remove(0);
        let (kept_m, bound_m) = (
            report["best_min_gap_m"].as_f64().unwrap(),
            report["min_gap_bound_m"].as_f64().unwrap(),
        );
        assert!(kept_m <= bound_m, "{report}");
        assert!(
            report["escape_is_best_for"]
                .as_str()
                .unwrap()
                .contains("which hold accelerations over the steps of a time grid"),
            "{report}"
        );
        kept_m
    };
    assert!(gap_m("0.02") > gap_m("0.1") + 0.01);
    let words = run_crumple(folder.path(), "avoid paper-2");
    assert!(
        stdout(&words).contains("no driver keeps more than 9.20 m, proved"),
        "{}",
        stdout(&words)
    );
    run_ok(
        folder.path(),
        "avoid paper-2 --bound-certificate bound.json",
    );
    let checked = run_crumple(folder.path(), "check bound.json --scenario paper-2");
    assert_prints(
        &checked,
        0,
        &["for every command, some gap is at most 9.19"],
    );
    let other = run_crumple(folder.path(), "check bound.json --scenario paper-1");
    assert_eq!(exit_code(&other), 1, "{other:?}");
}

/// A bound does not cover followers outside its scene, and `check` mentions them.
#[test]
fn vehicles_that_a_bound_leaves_out_are_counted() {
    let folder = temp_folder();
    let followed = |vehicles: usize, name: &str| {
        let paper = built_in_scenario("paper-2").unwrap().edited(|spec| {
            spec.vehicles[2].driver =
                Driver::Controller(BuiltInController::from_name("idm").unwrap());
            spec.vehicles.truncate(vehicles);
        });
        fs::write(
            folder.path().join("followed.toml"),
            file::to_toml(&paper.unwrap()).unwrap(),
        )
        .unwrap();
        run_ok(
            folder.path(),
            &format!("avoid followed.toml --bound-certificate {name}"),
        );
        stdout(&run_crumple(folder.path(), &format!("check {name}"))).to_owned()
    };
    let message = followed(3, "three.json");
    assert!(
        message.contains("  behind: 1 vehicle, not part of the claim\n"),
        "{message}"
    );
    let message = followed(2, "two.json");
    assert!(message.contains("  behind: no vehicle\n"), "{message}");
}

/// The follower's brake fired in the replay of an escape that was reported not to trigger it.
#[test]
fn an_escape_before_a_modelled_follower_states_optimum_and_replay() {
    let folder = temp_folder();
    let scenario = include_str!("../worst_case/escapes/acc-aeb-fires.toml");
    fs::write(folder.path().join("law.toml"), scenario).unwrap();
    let run = |arguments: &str| run_crumple(folder.path(), &format!("avoid law.toml {arguments}"));
    let report = json_objects(&run("--format json --out escape.toml")).remove(0);
    assert_eq!(
        (&report["escape_found_by"], &report["optimality"]),
        (&"closed-loop".into(), &"best-found".into())
    );
    let simulations = report["simulations"].as_u64().expect("a number");
    let optimised = report["escape_is_best_for"].as_str().expect("words");
    assert!(
        optimised.contains(&format!("found in {simulations} simulated profiles")),
        "{optimised}"
    );
    assert_eq!(
        report["emergency_brake_fires"],
        !report["trigger_time_s"].is_null()
    );
    let words = run("");
    assert_eq!(
        stdout(&words).contains("no emergency brake behind fires"),
        report["emergency_brake_fires"] == false,
        "{}",
        stdout(&words)
    );
    assert!(
        stdout(&words).contains(" m, best found\n") && stdout(&words).contains(optimised),
        "{}",
        stdout(&words)
    );
    run_ok(folder.path(), "simulate escape.toml --expect safe");
}

/// The output notes simulations beyond the budget.
#[test]
fn simulations_beyond_the_budget_are_reported() {
    let folder = temp_folder();
    let attack = |more: &str| {
        run_ok(
            folder.path(),
            &format!("worst-case paper-1 --controller idm {more}"),
        )
    };
    let report = json_objects(&attack("--budget 1 --format json")).remove(0);
    assert!(report["evaluations"].as_u64() > Some(1), "{report}");
    assert_eq!(
        (&report["budget"], &report["is_over_budget"]),
        (&1.into(), &true.into())
    );
    assert!(stdout(&attack("--budget 1")).contains("more simulations than --budget 1: "));
    let report = json_objects(&attack("--format json")).remove(0);
    assert_eq!(
        (
            &report["is_over_budget"],
            report["over_budget_because"].is_null()
        ),
        (&false.into(), true),
        "{report}"
    );
}

#[test]
fn a_worst_case_is_written_and_collides() {
    let folder = temp_folder();
    let message = run_ok(
        folder.path(),
        "worst-case paper-1 --controller idm --budget 500 --out worst.toml --format json",
    );
    let report = json_objects(&message).remove(0);
    assert_eq!(
        (&report["found"], &report["method"]),
        (&true.into(), &"sequential".into())
    );
    assert_eq!(report["optimality"], "best-found");
    let words = run_crumple(
        folder.path(),
        "worst-case paper-1 --controller idm --budget 500",
    );
    assert!(
        stdout(&words).contains("  best found; ") && !stdout(&words).contains("optimum"),
        "{}",
        stdout(&words)
    );
    run_ok(
        folder.path(),
        "simulate worst.toml --controller idm --expect collision",
    );
}
