//! `crumple falsify`: results, output files, and resumption after a kill.

use flate2::read::GzDecoder;

use super::*;
use crate::damage::{assert_same_contents, read_tree};
use crumple_search::falsify::counterexample::ExpectedFile;

pub(crate) fn assert_same_folders(first: &Path, other: &Path) {
    assert_same_contents(&read_tree(first), &read_tree(other), "");
}

#[test]
fn a_json_summary_assigns_numbers_to_methods() {
    let folder = temp_folder();
    let search = "falsify --controller idm --budget 20 --out runs --format json";
    let summary = json_objects(&run_crumple(folder.path(), search)).remove(0);
    let kept = fs::read_to_string(folder.path().join("runs/summary.json")).unwrap();
    let kept: Value = serde_json::from_str(&kept).unwrap();
    for (name, value) in kept.as_object().unwrap() {
        assert_eq!(summary[name], *value, "{name} is as it is kept");
    }
    let (of_one, of_all) = (&summary["requested_method"], &summary["all_methods"]);
    assert_eq!(
        (&of_one["method"], &of_one["evaluations"]),
        (&summary["method"], &summary["evaluations"])
    );
    assert_eq!(
        (&of_all["methods"], &of_all["evaluations"]),
        (&3.into(), &60.into())
    );
    let failures: u64 = summary["methods"]
        .as_array()
        .unwrap()
        .iter()
        .map(|method| method["failures"].as_u64().unwrap())
        .sum();
    assert_eq!(
        (&of_all["failures"], &of_all["falsified"]),
        (&failures.into(), &summary["falsified"])
    );
    assert_eq!(
        of_all["distinct_failures"],
        summary["counterexamples"].as_array().unwrap().len()
    );
}

/// The message of a failed gate states the number of evaluations.
#[test]
fn a_search_may_be_expected_to_find_a_failure_or_nothing() {
    let folder = temp_folder();
    let (hits, drives_on) = ("no collision", "always v1.speed_mps >= 0");
    let cases = [
        (hits, "failure", 0, ""),
        (
            hits,
            "nothing",
            1,
            "failed: expected no failure, but found ",
        ),
        (drives_on, "nothing", 0, ""),
        (
            drives_on,
            "failure",
            1,
            "failed: expected a failure, but found none in 60 evaluations",
        ),
    ];
    for (number, (spec, expected, code, message)) in cases.into_iter().enumerate() {
        let out = format!("{number}");
        let search =
            format!("falsify --controller baseline --space paper --budget 20 --spec '{spec}'");
        let output = run_crumple(
            folder.path(),
            &format!("{search} --expect {expected} --out {out}"),
        );
        assert_reports(&output, code, message);
        assert!(!stdout(&output).is_empty());
    }
}

#[test]
fn the_baseline_collides_in_the_papers_space_at_once() {
    let folder = temp_folder();
    let campaign =
        "falsify --controller baseline --space paper --budget 40 --out found --format json";
    let output = run_ok(folder.path(), campaign);
    let summary = json_objects(&output).remove(0);
    assert_eq!(
        (&summary["evaluations"], &summary["falsified"]),
        (&40.into(), &true.into())
    );
    assert!(
        summary["first_falsification"].as_u64().unwrap() <= 3,
        "{}",
        summary["first_falsification"]
    );
    assert!(summary["best_robustness"].as_f64().unwrap() < -5.0);
    let methods: Vec<_> = summary["methods"]
        .as_array()
        .unwrap()
        .iter()
        .map(|m| m["method"].clone())
        .collect();
    assert_eq!(
        methods,
        ["auto", "uniform", "halton"],
        "the reference searches always run"
    );
    let counterexamples = summary["counterexamples"].as_array().unwrap();
    assert!(!counterexamples.is_empty());
    let classed = |class: &str| {
        counterexamples
            .iter()
            .filter(|counterexample| counterexample["avoidability"] == class)
            .count()
    };
    assert_eq!(summary["avoidability"]["avoidable"], classed("avoidable"));
    assert!(
        classed("avoidable") > 0,
        "another controller could have done better than the baseline"
    );
    for counterexample in counterexamples {
        for field in ["robustness", "impact_speed_mps", "ln_likelihood"] {
            assert!(
                counterexample[field].is_f64(),
                "{field} in {counterexample}"
            );
        }
        assert_eq!(counterexample["dt_fragile"], false);
        let avoidable = match counterexample["avoidability"].as_str().unwrap() {
            "avoidable" => Value::Bool(counterexample["best_min_gap_m"].as_f64().unwrap() > 0.0),
            "unavoidable" => Value::Bool(false),
            "undecided" => Value::Null,
            other => panic!("{other}"),
        };
        assert_eq!(
            (
                &counterexample["avoidable"],
                counterexample["best_min_gap_m"].is_f64()
            ),
            (&avoidable, avoidable == true)
        );
        // The file is self-contained, and a smaller step gives the same result.
        let file = format!("found/{}", counterexample["file"].as_str().unwrap());
        for dt in ["0.01", "0.001"] {
            let replay = format!(
                "simulate {file} --controller baseline --dt {dt} --expect collision --format json"
            );
            let replayed = run_ok(folder.path(), &replay);
            let outcome = &json_objects(&replayed)[0]["outcome"];
            assert_eq!(outcome["rear_vehicle"], counterexample["rear_vehicle"]);
            let (replayed, counterexample) = (
                outcome["time_s"].as_f64().unwrap(),
                counterexample["collision_time_s"].as_f64().unwrap(),
            );
            assert!((replayed - counterexample).abs() < 1e-3);
        }
    }
    // Printed and stored summaries agree, except for the fields that distinguish the methods.
    let mut kept: Value = fs::read_to_string(folder.path().join("found/summary.json"))
        .unwrap()
        .parse()
        .unwrap();
    for key in ["requested_method", "all_methods"] {
        kept[key] = summary[key].clone();
    }
    assert_eq!(
        (&kept, &summary["requested_method"]),
        (&summary, &summary["methods"][0])
    );
    check_log(&folder.path().join("found/evaluations/part-00000.csv.gz"));
    let again = run_crumple(folder.path(), campaign);
    assert_eq!(
        exit_code(&again),
        2,
        "an existing campaign is not overwritten"
    );
    let resumed = run_ok(folder.path(), &format!("{campaign} --resume"));
    assert_eq!(
        stdout(&resumed),
        stdout(&output),
        "a complete one only repeats its summary"
    );
    let other = run_crumple(folder.path(), &format!("{campaign} --resume --seed 5"));
    assert_refused(
        &other,
        "found/campaign.toml: the campaign there has a different configuration",
    );
}

/// Checks that a log has forty rows for each method, named columns, and a collision where robustness is negative.
fn check_log(path: &Path) {
    let mut reader = csv::Reader::from_reader(GzDecoder::new(fs::File::open(path).unwrap()));
    let columns = reader.headers().unwrap().clone();
    let at = |name: &str| columns.iter().position(|column| column == name).unwrap();
    at("ego_braking");
    let number = |row: &csv::StringRecord, name: &str| row[at(name)].parse::<f64>();
    let mut rows = 0;
    for (index, row) in reader.records().enumerate() {
        let row = row.unwrap();
        assert_eq!(row[0], *["auto", "uniform", "halton"][index / 40]);
        assert_eq!(row[1], (index % 40 + 1).to_string());
        assert!((2.0..=4.0).contains(&number(&row, "lead_brake_mps2").unwrap()));
        assert!(number(&row, "ln_likelihood").is_ok());
        assert!(["light", "heavy"].contains(&&row[at("follower_class")]));
        let failed = number(&row, "robustness").unwrap() < 0.0;
        assert_eq!(number(&row, "collision_time_s").is_ok(), failed);
        rows += 1;
    }
    assert_eq!(rows, 120);
}

const CAMPAIGN_ARGS: &str = "falsify --controller match-leader --budget 250 --seed 3";

#[test]
fn a_campaign_killed_again_and_again_ends_with_the_same_bytes_on_any_number_of_threads() {
    let folder = temp_folder();
    let through = assert_survives_kills(
        folder.path(),
        CAMPAIGN_ARGS,
        (0..12).map(|round| 5..150 + 100 * round),
    );
    assert_eq!(exit_code(&through), 0);
}

#[test]
fn a_formula_is_falsified_without_a_collision() {
    let folder = temp_folder();
    let formula = "always v1.time_gap_s > 0.3";
    let arguments =
        format!("falsify --controller match-leader --space paper --budget 60 --spec '{formula}'");
    let output = run_ok(folder.path(), &format!("{arguments} --format json"));
    let summary = json_objects(&output).remove(0);
    assert_eq!(summary["specification"], "always (v1.time_gap_s > 0.3)");
    assert!(summary["methods"][0]["best_robustness"].as_f64().is_some());
    // Counterexamples are ranked by the violation, which replays.
    let counterexamples = summary["counterexamples"].as_array().unwrap();
    let robustness: Vec<f64> = counterexamples
        .iter()
        .map(|counterexample| counterexample["robustness"].as_f64().unwrap())
        .collect();
    assert!(
        !counterexamples.is_empty()
            && robustness.is_sorted()
            && robustness.iter().all(|r| *r < 0.0),
        "{robustness:?}"
    );
    for counterexample in counterexamples {
        assert!(
            counterexample["kind"]
                .as_str()
                .unwrap()
                .starts_with("the specification is violated"),
            "{counterexample}"
        );
        let file = format!(
            "crumple-campaign/{}",
            counterexample["file"].as_str().unwrap()
        );
        assert!(file.ends_with("-violation.toml"));
        let replay = |spec: &str, expectation: &str| {
            let arguments = format!("simulate {file} --controller match-leader --format json");
            run_crumple(
                folder.path(),
                &format!("{arguments} --spec '{spec}' --expect {expectation}"),
            )
        };
        let replayed = replay(formula, "violated");
        assert_eq!(exit_code(&replayed), 0, "{}", stderr(&replayed));
        let evaluated = &json_objects(&replayed)[0]["specifications"][0];
        assert_eq!(
            (&evaluated["satisfied"], &evaluated["robustness"]),
            (&false.into(), &counterexample["robustness"])
        );
        assert_eq!(exit_code(&replay(formula, "satisfied")), 1);
        assert_eq!(
            exit_code(&replay("always v1.speed_mps >= 0", "satisfied")),
            0
        );
    }
}

/// Recorded verdicts are no scenario; version 0.1.0 called that file `expected.toml`.
#[test]
fn every_toml_file_beside_counterexamples_is_a_scenario() {
    let folder = temp_folder();
    let arguments = "falsify --controller=match-leader --space=high-risk --budget=40 --out=found";
    run_ok(folder.path(), arguments);
    let counterexamples = folder.path().join("found/counterexamples");
    let files = || {
        let names = file_names_in(&counterexamples)
            .into_iter()
            .filter(|name| name.ends_with(".toml"));
        names
            .map(|name| format!("found/counterexamples/{name}"))
            .collect::<Vec<_>>()
    };
    let simulate = || {
        let arguments = "--controller=match-leader --format=json --expect=collision";
        json_objects(&run_ok(
            folder.path(),
            &format!("simulate {} {arguments}", files().join(" ")),
        ))
        .iter()
        .filter(|report| report["scenario"].is_string())
        .count()
    };
    let file_count = files().len();
    assert!(file_count > 0 && simulate() == file_count);
    fs::rename(
        counterexamples.join("expected.verdicts"),
        counterexamples.join("expected.toml"),
    )
    .unwrap();
    assert_eq!((files().len(), simulate()), (file_count + 1, file_count));
    let recorded = ExpectedFile::load_from_folder(&counterexamples).unwrap();
    assert!(recorded.expected.len() >= file_count);
}

#[test]
fn an_aim_at_likely_failures_finds_likelier_ones() {
    let folder = temp_folder();
    let likeliest = |aim: &str| {
        run_ok(
            folder.path(),
            &format!(
                "falsify --controller baseline --space paper --budget 60 --aim {aim} --out {aim}"
            ),
        );
        let table = folder
            .path()
            .join(aim)
            .join("evaluations/part-00000.csv.gz");
        let mut reader = csv::Reader::from_reader(GzDecoder::new(fs::File::open(table).unwrap()));
        let columns = reader.headers().unwrap().clone();
        let column = |name: &str| columns.iter().position(|column| column == name).unwrap();
        let [robustness, likelihood] = ["robustness", "ln_likelihood"].map(column);
        let number = |row: &csv::StringRecord, column: usize| row[column].parse::<f64>().unwrap();
        let rows = reader
            .records()
            .map(Result::unwrap)
            .filter(|row| number(row, robustness) < 0.0);
        rows.map(|row| number(&row, likelihood))
            .fold(f64::NEG_INFINITY, f64::max)
    };
    assert!(likeliest("likeliest") > likeliest("severest"));
}

#[test]
#[cfg(unix)]
fn used_interrupted_and_damaged_campaigns_are_reported() {
    let folder = temp_folder();
    let arguments = "falsify --controller policy --budget 50000 --out busy --resume";
    let child = spawn(folder.path(), arguments);
    let manifest = folder.path().join("busy/work.json");
    let begun = || fs::read_to_string(&manifest).is_ok_and(|text| text.contains("growing"));
    let empty = "\"bytes\": 0,";
    while !begun() || fs::read_to_string(&manifest).is_ok_and(|text| text.contains(empty)) {
        sleep(Duration::from_millis(20));
    }
    assert_refused(
        &run_crumple(folder.path(), arguments),
        "busy: another process is working on the campaign there",
    );
    let message = "interrupted: the results so far are in busy: the same command with --resume";
    assert_reports(&interrupt(child), 130, message);
    // An existing file in the place of a result is an error before any work.
    fs::write(folder.path().join("busy/summary.json"), "{}").unwrap();
    assert_refused(
        &run_crumple(folder.path(), arguments),
        "busy/summary.json: work.json does not list this file",
    );
    let damaged = "2 of 2 files are intact\n  summary.json: not part of these results, in a folder";
    assert_prints(&run_crumple(folder.path(), "fsck busy"), 1, &[damaged]);
}

#[test]
fn mistakes_are_reported_before_anything_is_written() {
    let folder = temp_folder();
    let good = include_str!("../../../crates/spaces/src/built_in/paper.toml");
    let line = 1 + good
        .lines()
        .position(|line| line.contains("deviation = 0.2, low = 2.0"))
        .unwrap();
    fs::write(
        folder.path().join("bad.toml"),
        good.replace("deviation = 0.2, low = 2.0", "deviation = -1, low = 2.0"),
    )
    .unwrap();
    let falsify = |arguments: &str| {
        let output = run_crumple(
            folder.path(),
            &format!("falsify --controller baseline {arguments}"),
        );
        assert_eq!((exit_code(&output), stdout(&output)), (2, ""));
        stderr(&output).to_owned()
    };
    let expected = format!(
        "error: bad.toml:{line}: parameters[4].distribution.normal: deviation must be above 0, found -1"
    );
    let output = falsify("--space bad.toml");
    assert!(output.starts_with(&expected), "{output}");
    assert!(
        falsify("--space nowhere")
            .contains("neither a built-in space (paper, high-risk, traffic, ")
    );
    assert!(falsify("--space none.toml").contains("none.toml: No such file"));
    assert!(falsify("--spec 'always v1.gap_m >'").contains("--spec: column 18"));
    for misspelt in [
        "no amplificaton",
        "imposed braking at most 4",
        "imposed braking at most -4 m/s2",
    ] {
        let output = falsify(&format!("--spec '{misspelt}'"));
        assert!(
            output.contains("`no amplification`") && output.contains("`no collision`"),
            "{misspelt}: {output}"
        );
    }
    let unknown = falsify("--spec 'always v7.gap_m > 0'");
    let expected = "--spec: column 8: there is no signal `v7.gap_m`; there are: v0.position_m";
    assert!(unknown.contains(expected), "{unknown}");
    assert!(
        falsify("--aim worst")
            .contains("unknown aim `worst`; the aims are: severest, likeliest, nearest")
    );
    assert!(falsify("--against baseline").contains("`baseline` is compared with itself"));
    assert!(falsify("--method best").contains("unknown search method `best`"));
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "only the bad space is there"
    );
}

#[test]
fn parts_of_formulas_without_a_temporal_operator_are_warned_of() {
    let folder = temp_folder();
    let warned = |arguments: &str| {
        let output = run_ok(folder.path(), arguments);
        (stdout(&output).to_owned(), stderr(&output).to_owned())
    };
    let formula = "always v2.gap_m > 1 and v1.gap_m > 5";
    let warning = "warning: --spec: `v1.gap_m > 5` has no temporal operator";
    let (printed, message) = warned(&format!(
        "simulate paper-1 --controller idm --spec '{formula}'"
    ));
    assert_contains(
        &printed,
        &[
            "holds, robustness",
            ": (always (v2.gap_m > 1)) and (v1.gap_m > 5)",
        ],
    );
    assert!(message.contains(warning), "{message}");
    let (_, message) = warned(&format!(
        "falsify --controller idm --budget 1 --spec '{formula}' --out found"
    ));
    assert!(message.contains(warning), "{message}");
    let (_, message) = warned("simulate paper-1 --controller idm --spec 'always (v1.gap_m > 1)'");
    assert!(!message.contains("warning"), "{message}");
}
