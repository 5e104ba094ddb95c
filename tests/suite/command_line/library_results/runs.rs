//! Simulated runs, suites, assessments, folders of results, and lists.

use crumple_controllers::Controllers;
use crumple_evidence::describe_followers;
use crumple_measure::{RunFindings, RunReport, RunTotal, SpecificationResult, TotalReport};
use crumple_report::assessment::{AssessmentPlan, EvidenceCache, assess};
use crumple_report::suite::{render_junit, render_markdown_table, render_text};
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::verify_journal;
use crumple_sim::control::TwoSidedSettings;
use crumple_sim::engine::{RecordingLevel, Run, simulate};
use crumple_sim::scenario::built_in_scenario_names;
use crumple_spaces::{BUILT_IN_SPACES, VARIANT_SPACES};
use crumple_store::run_folder::{FolderReport, examine};
use crumple_suites::{SHIPPED_SUITES, SuiteList, TestSuite, run};

use super::*;
use crate::suite_pages::standing_suite;

const SPECIFICATIONS: [&str; 2] = ["no collision", "always v1.time_gap_s > 0.3"];

#[test]
fn a_run_with_specifications_and_levels() {
    let folder = temp_folder();
    let controller = find_controller("idm");
    let options = run_options("idm");
    let run = Run::new(&find_scenario("paper-1"), options.clone()).unwrap();
    let simulated = simulate(&run, RecordingLevel::Trace);
    let texts = SPECIFICATIONS.map(str::to_owned);
    let specifications =
        SpecificationResult::evaluate_all(&texts, run.scenario(), &options, true).unwrap();
    let settings = TwoSidedSettings::parse_for_levels("reacts=1").unwrap();
    let report = RunReport::new(&run, &controller, &simulated)
        .with_specifications(specifications)
        .with_levels(&run, &simulated, &settings, describe_followers);
    let [safe, apart] = SPECIFICATIONS;
    assert_same(
        folder.path(),
        &format!(
            "simulate paper-1 --controller idm --spec '{safe}' --spec '{apart}' --parts --level=reacts=1"
        ),
        &LibraryResult::new(&report, report.to_text()),
    );
}

/// Several scenarios have their texts and a total; those of a folder have a line each.
#[test]
fn several_runs_and_their_total() {
    let folder = temp_folder();
    fs::create_dir(folder.path().join("scenarios")).unwrap();
    let mut all = LibraryResult {
        text: String::new(),
        json: String::new(),
    };
    let mut lines = String::new();
    let mut findings = Vec::new();
    for name in ["paper-1", "paper-2"] {
        let scenario = find_scenario(name);
        let text = crumple_sim::scenario::file::to_toml(&scenario).unwrap();
        fs::write(folder.path().join(format!("scenarios/{name}.toml")), text).unwrap();
        let run = Run::new(&scenario, run_options("baseline")).unwrap();
        let simulated = simulate(&run, RecordingLevel::Trace);
        let controller = find_controller("baseline");
        let report = RunReport::new(&run, &controller, &simulated);
        let report = report.with_cause_of_braking(&run).unwrap();
        all.text += &report.to_text();
        all.json += &json_line(&report);
        lines += &report.to_line();
        findings.push(RunFindings::new(&report));
    }
    let total = RunTotal::new(&findings, false);
    let total_text = total.to_text("baseline", "kalman");
    all.text += &total_text;
    lines += &total_text;
    all.json += &json_line(&TotalReport { total });
    assert_same(folder.path(), "simulate paper-1 paper-2", &all);
    assert_output(folder.path(), 0, "simulate scenarios", &lines);
}

#[test]
fn a_suite_in_three_formats() {
    let folder = temp_folder();
    fs::write(folder.path().join("own.toml"), standing_suite()).unwrap();
    let suite = TestSuite::from_toml(&standing_suite(), Path::new("own.toml")).unwrap();
    let controllers = [find_controller("baseline")];
    let result = run(&suite, &controllers, EstimatorKind::Kalman).unwrap();
    let command = "suite run own.toml --controller baseline";
    let text = render_text(&result, |_, _| None);
    assert_same(folder.path(), command, &LibraryResult::new(&result, text));
    let junit = format!("{command} --format junit");
    assert_output(folder.path(), 0, &junit, &render_junit(&result));
}

#[test]
fn the_shipped_suites_and_their_table() {
    let folder = temp_folder();
    let list = SuiteList::load().unwrap();
    assert_same(
        folder.path(),
        "suite list",
        &LibraryResult::new(&list, list.to_text()),
    );
    let controllers = [find_controller("idm")];
    let results: Vec<_> = SHIPPED_SUITES
        .iter()
        .map(|(name, _)| TestSuite::shipped(name).unwrap().unwrap())
        .map(|suite| run(&suite, &controllers, EstimatorKind::Kalman).unwrap())
        .collect();
    let expected = LibraryResult {
        text: render_markdown_table(&results),
        json: results.iter().map(json_line).collect(),
    };
    assert_same(folder.path(), "suite table --controller idm", &expected);
}

const ASSESSMENT: &str = r#"version = 1
controllers = ["baseline", "idm"]
paper = false
draws = 20
everyday_draws = 0
search = { spaces = [], budget = 20 }
rates = { runs = 0 }
[[gates]]
require = "rate-not-above"
controller = "idm"
than = "baseline"
"#;

#[test]
fn an_assessment() {
    let folder = temp_folder();
    let path = folder.path().join("a.toml");
    fs::write(&path, ASSESSMENT).unwrap();
    let plan = AssessmentPlan::load(&path, Controllers::default()).unwrap();
    let assessed = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
    assert_same(
        folder.path(),
        "assess a.toml --out report",
        &LibraryResult::new(&assessed.summary, assessed.to_text()),
    );
}

#[test]
fn a_damaged_folder_of_results() {
    let folder = temp_folder();
    let out = folder.path().join("count");
    run_ok(
        folder.path(),
        "verify rate --controller idm --runs 10 --confidence 0.9 --out count",
    );
    fs::write(out.join("certificate.json"), "{}").unwrap();
    fs::write(out.join("note.txt"), "own").unwrap();
    let report = FolderReport::new(&out, &verify_journal_of(&out));
    assert!(report.is_damaged());
    let text = report.to_text();
    assert_same_with_code(
        folder.path(),
        1,
        &format!("fsck {}", quote(&out)),
        &LibraryResult::new(&[report], text),
    );
}

fn verify_journal_of(out: &Path) -> crumple_store::run_folder::FolderExamination {
    verify_journal(out, examine(out).unwrap()).unwrap()
}

/// The program wraps lines for the terminal, so the text is compared without white space.
#[test]
fn lists_of_built_in_items() {
    let folder = temp_folder();
    let spaces = BUILT_IN_SPACES.into_iter().chain(VARIANT_SPACES);
    let lists: [(&str, Vec<(&str, &str)>); 3] = [
        ("scenarios", built_in_scenario_names().into()),
        (
            "spaces",
            spaces.map(|(name, about, _)| (name, about)).collect(),
        ),
        (
            "methods",
            Method::ALL
                .iter()
                .map(|method| (method.name(), method.summary()))
                .collect(),
        ),
    ];
    for (what, entries) in lists {
        let printed = run_ok(folder.path(), &format!("list {what}"));
        let words = |text: &str| text.split_whitespace().collect::<String>();
        let expected: String = entries
            .iter()
            .map(|(name, about)| format!("{name}{about}"))
            .collect();
        assert_eq!(words(stdout(&printed)), words(&expected), "{what}");
        let entries: Vec<_> = entries
            .iter()
            .map(|(name, summary)| json!({"name": name, "summary": summary}))
            .collect();
        let printed = run_ok(folder.path(), &format!("list {what} --format json"));
        assert_eq!(json_objects(&printed), [json!({what: entries})]);
    }
}
