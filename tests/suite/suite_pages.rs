//! Reports of suites: tolerances, and suites in assessments.

use std::fs;
use std::path::Path;

use crumple_core::observer::Quiet;
use crumple_report::assessment::{
    AssessmentGate, AssessmentPlan, EvidenceCache, GateConfig, PlannedSuiteResult, Property,
    Strength, SuiteConfig, assess,
};
use crumple_search::falsify::counterexample::Avoidability;
use crumple_sim::observation::EstimatorKind;
use crumple_suites::{MarginEnd, SweepFailure, TestSuite, run};

use crate::assessments::config;
use crate::command_line::{run_ok, temp_folder};
use crate::suites::{OWN_SUITE, find_controller, first_result, load_suite};
use crate::tiny::replace_passages;

/// A suite with a test of two speeds and a tolerance, and without margins.
pub(crate) fn standing_suite() -> String {
    let margins = OWN_SUITE
        .lines()
        .find(|line| line.starts_with("margins"))
        .expect("there");
    let speeds = "values = [36.0, 50.0], unit = \"km/h\", origin = \"chosen\"";
    let tolerance = "values = [60.0, 75.0], unit = \"km/h\", origin = \"chosen\", tolerance = 2.0";
    let changes = [
        ("\"own\"", "\"stands\""),
        (&format!("{margins}\n"), ""),
        (speeds, tolerance),
    ];
    replace_passages(OWN_SUITE, &changes)
}

/// The baseline stops from at most 75.06 km/h: at 75 it passes, and fails within a tolerance of 2 km/h.
#[test]
fn a_tolerance_belongs_to_the_criterion() {
    let tested = |text: &str| first_result(&load_suite(text).unwrap(), "baseline");
    let with = tested(&standing_suite());
    let within = with
        .worst_in_tolerance
        .as_ref()
        .expect("a tolerance is searched within");
    assert!(with.verdict.is_passed() && within.verdict.is_failure() && !with.is_passed());
    let speed_kmph: f64 = within.point.split(' ').nth(2).unwrap().parse().unwrap();
    assert!((75.06..=77.0).contains(&speed_kmph), "{}", within.point);
    assert!(
        within.failures > 0 && within.failures < within.points_run,
        "points about 60 km/h pass"
    );
    let without = tested(&replace_passages(
        &standing_suite(),
        &[(", tolerance = 2.0", "")],
    ));
    assert!(without.worst_in_tolerance.is_none() && without.is_passed());
    let near = tested(&replace_passages(&standing_suite(), &[("75.0", "70.0")]));
    assert!(near.is_passed() && near.worst_in_tolerance.is_some());
    for (tolerance, message) in [
        (
            "-1.0",
            "own.toml:15: clauses[0].tests[0].parameters.own_speed.tolerance: must be 0 or more, found -1",
        ),
        ("nan", "must be 0 or more, found NaN"),
        ("inf", "must be 0 or more, found inf"),
        (
            "59.0",
            "own_speed.tolerance: must be from 1.8 to 360 km/h, found 1",
        ),
    ] {
        let text = replace_passages(
            &standing_suite(),
            &[("tolerance = 2.0", &format!("tolerance = {tolerance}"))],
        );
        let error = load_suite(&text).unwrap_err();
        assert!(error.contains(message), "{tolerance}: {error}");
    }
}

#[test]
fn a_margin_reports_a_test_that_cannot_be_run() {
    let suite = TestSuite::load(Path::new("examples/suites/lane-changes.toml")).unwrap();
    let result = run(
        &suite,
        &[find_controller("shield:policy")],
        EstimatorKind::Truth,
    )
    .unwrap();
    let margins = &result.clauses[0].tests[0].controllers[0].margins;
    assert!(!margins.is_empty());
    assert!(
        margins.iter().all(|margin| margin.end
            == MarginEnd::None {
                failure: SweepFailure::Refused
            }),
        "{margins:?}"
    );
}

/// Suites are claims, in every rendering, tests of the build, and files that replay; their evidence is kept.
#[test]
fn suites_are_evidence_of_an_assessment() {
    let folder = temp_folder();
    fs::write(
        folder.path().join("own.toml"),
        replace_passages(&standing_suite(), &[(", tolerance = 2.0", "")]),
    )
    .unwrap();
    let suite = |suite: &str, controllers: &[&str]| -> SuiteConfig {
        serde_json::from_value(serde_json::json!({ "suite": suite, "controllers": controllers }))
            .unwrap()
    };
    let mut asked = config(&["idm", "full-throttle", "policy"]);
    (asked.draws, asked.everyday_draws) = (0, 0);
    asked.suites = vec![
        suite("un-r152", &["full-throttle", "idm"]),
        suite("own.toml", &["policy", "idm"]),
    ];
    let gate = |controller: &str, suite: &str| {
        GateConfig::from(AssessmentGate::SuitePassed {
            controller: controller.to_owned(),
            suite: suite.to_owned(),
        })
    };
    asked.gates = vec![
        gate("idm", "un-r152"),
        gate("full-throttle", "un-r152"),
        gate("policy", "own.toml"),
    ];
    let plan = AssessmentPlan::new(asked.clone(), [], folder.path()).unwrap();
    let gather = || {
        let store = EvidenceCache::open(&folder.path().join("kept"), "program", false).unwrap();
        (
            assess(&plan, &store, None, &Quiet).unwrap(),
            store.reuse_counts(),
        )
    };
    let (found, _) = gather();
    assert_eq!(
        found
            .summary
            .gates
            .iter()
            .map(|gate| gate.holds)
            .collect::<Vec<_>>(),
        [true, false, true]
    );
    let row = found
        .summary
        .claims
        .iter()
        .find(|row| row.part == "suites")
        .expect("claimed");
    assert!(
        row.claims
            .iter()
            .flatten()
            .all(|claim| claim.property == Property::PassesTests)
    );
    assert!(
        matches!(row.statuses[0].strength, Strength::Tested { runs } if runs == 21 + 5 * 496),
        "{row:?}"
    );
    // For failed tests, points of the search do not count.
    assert_eq!(
        row.statuses[1].strength,
        Strength::Refuted {
            failures: 21,
            runs: 21
        }
    );
    assert!(row.claims[2].is_none(), "the policy is not tested by it");
    let files = found.files().unwrap();
    let text = |name: &str| {
        String::from_utf8(
            files
                .iter()
                .find(|(file, _)| file == name)
                .unwrap()
                .1
                .clone(),
        )
        .unwrap()
    };
    for name in ["assessment.md", "assessment.html"] {
        assert!(text(name).contains("no certification"), "{name}");
    }
    assert!(text("replay.sh").contains("counterexamples/suites/un-r152-stationary-20-"));
    let is_failed =
        |file: &str| file.starts_with("counterexamples/suites/") && !file.ends_with("-escape.toml");
    let (_, scenario) = files.iter().find(|(file, _)| is_failed(file)).unwrap();
    fs::write(folder.path().join("failed.toml"), scenario).unwrap();
    run_ok(
        folder.path(),
        "simulate failed.toml --controller full-throttle --expect collision",
    );
    // The escape of an avoidable failure is next to it.
    let tests = found
        .results
        .suites
        .iter()
        .flat_map(|part| &part.suites)
        .flat_map(PlannedSuiteResult::tests);
    let failures: Vec<_> = tests
        .flatten()
        .filter_map(|outcome| Some((outcome.tested.fastest_failure()?, outcome.failure?)))
        .collect();
    for (failed, failure) in &failures {
        assert_eq!(
            failure.escape.is_some(),
            matches!(failed.avoidability, Avoidability::Avoidable { .. }),
            "{failure:?}"
        );
    }
    let escape = failures
        .iter()
        .find_map(|(_, failure)| failure.escape.as_ref())
        .expect("something is avoidable");
    fs::write(folder.path().join("escape.toml"), text(&escape.file)).unwrap();
    run_ok(folder.path(), "simulate escape.toml --expect safe");
    assert!(
        text("replay.sh").contains(&format!("run simulate {} --expect safe\n", escape.file)),
        "{escape:?}"
    );
    let (again, (pieces, reused)) = gather();
    assert_eq!(pieces, reused, "nothing is worked out again");
    let [again, first] = [again.files().unwrap(), files].map(without_times);
    assert_eq!(again, first);
    for (from, suites, gates, message) in [
        (
            "nowhere",
            "fmvss-12",
            vec![],
            "suites[0].suite: `fmvss-12` is neither a built-in suite",
        ),
        ("a file that is not there", "gone.toml", vec![], "gone.toml"),
        (
            "another's gate",
            "fmvss-127",
            vec![gate("policy", "fmvss-127")],
            "gates[0].controller: `policy` is not tested",
        ),
        (
            "no such suite",
            "fmvss-127",
            vec![gate("idm", "own.toml")],
            "gates[0].suite: `own.toml` is not among `suites`",
        ),
    ] {
        let mut asked = asked.clone();
        (asked.suites, asked.gates) = (vec![suite(suites, &["idm"])], gates);
        let error = AssessmentPlan::new(asked, [], folder.path())
            .unwrap_err()
            .to_string();
        assert!(error.contains(message), "{from}: {error}");
    }
    for (suites, message) in [
        (
            vec![suite("fmvss-127", &["rss"])],
            "suites[0].controllers[0]: `rss` is not among `controllers`",
        ),
        (
            vec![suite("fmvss-127", &[])],
            "suites[0].controllers: must name at least one",
        ),
        (
            vec![suite("own.toml", &["idm"]), suite("own.toml", &["idm"])],
            "suites[1].suite: another suite has the name `stands`; rename one of them",
        ),
    ] {
        let mut asked = asked.clone();
        (asked.suites, asked.gates) = (suites, Vec::new());
        let error = AssessmentPlan::new(asked, [], folder.path())
            .unwrap_err()
            .to_string();
        assert!(error.contains(message), "{error}");
    }
}

/// Replaces what differs between two runs: the measured times of JUnit, and its hash in `work.json`.
fn without_times(mut files: Vec<(String, Vec<u8>)>) -> Vec<(String, Vec<u8>)> {
    for (name, bytes) in &mut files {
        let text = String::from_utf8_lossy(bytes);
        if name.ends_with(".junit.xml") {
            let (head, parts) = text.split_once(" time=\"").unwrap();
            let rests = parts
                .split(" time=\"")
                .map(|part| part.split_once('"').unwrap().1);
            *bytes = [head].into_iter().chain(rests).collect::<String>().into();
        } else if name == "work.json" {
            let mut manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
            let files = manifest["files"].as_object_mut().unwrap();
            files.remove("assessment.junit.xml").unwrap();
            manifest["sha256"] = serde_json::Value::Null;
            *bytes = manifest.to_string().into();
        }
    }
    files
}
