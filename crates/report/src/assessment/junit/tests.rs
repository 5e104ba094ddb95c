use std::path::{Path, PathBuf};

use super::*;
use crate::assessment::{
    AssessConfig, AssessmentGate, AssessmentPlan, EvidenceCache, GateConfig, assess,
};
use crumple_controllers::{Controllers, find_built_in};
use crumple_core::observer::Quiet;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::scenario::{NoDriverFiles, built_in_scenario, built_in_scenario_names, file};

/// The baseline fails in the paper's scenarios, and in a copy of one of them in a file.
#[test]
fn a_failed_gate_names_a_scenario_of_its_own_claim() {
    let controller = "baseline".to_owned();
    let gates = [
        AssessmentGate::NoCollisionInPaperScenarios {
            controller: controller.clone(),
        },
        AssessmentGate::NoCollisionInScenarioFiles {
            controller: controller.clone(),
        },
    ];
    let config = AssessConfig {
        controllers: vec![controller],
        gates: gates.map(GateConfig::from).into(),
        draws: 0,
        everyday_draws: 0,
        scenarios: vec![PathBuf::from("copy.toml")],
        certificates: Some(Vec::new()),
        distributions: Some(Vec::new()),
        search: crate::assessment::SearchConfig {
            spaces: Some(Vec::new()),
            ..Default::default()
        },
        ..AssessConfig::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let (name, _) = built_in_scenario_names()[0];
    let copy = built_in_scenario(name)
        .unwrap()
        .edited(|spec| spec.name = "copy".to_owned())
        .unwrap();
    std::fs::write(
        folder.path().join("copy.toml"),
        file::to_toml(&copy).unwrap(),
    )
    .unwrap();
    let plan = AssessmentPlan::new(config, [], folder.path()).unwrap();
    let report = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
    let gates = report.summary.gates.iter();
    let cases: Vec<JunitCase> = gates.map(|gate| report.gate_case(gate)).collect();
    let [in_paper, in_files] = &cases[..] else {
        panic!("one case per gate")
    };
    assert_eq!(in_paper.status, JunitStatus::Failed, "{in_paper:?}");
    assert_eq!(in_files.status, JunitStatus::Failed, "{in_files:?}");
    assert_eq!(in_paper.file.as_deref(), Some("violations/paper-1.toml"));
    assert_eq!(in_files.file.as_deref(), Some("scenarios/copy.toml"));
}

/// A failed gate on counted runs, and one on random scenarios, is about a claim on the same runs, and names a scenario
/// of them that fails.
#[test]
fn a_failed_gate_on_runs_names_the_runs_that_decide_it() {
    let controller = "baseline".to_owned();
    let space = Some("paper".to_owned());
    let gates = [
        AssessmentGate::RateNotAbove {
            controller: controller.clone(),
            than: "idm".to_owned(),
            space: space.clone(),
        },
        AssessmentGate::NoCollisionInSpace {
            controller: controller.clone(),
            space: "paper".to_owned(),
        },
        AssessmentGate::RateAtMost {
            controller: controller.clone(),
            percent: 0.5,
            space,
        },
    ];
    let mut config = AssessConfig {
        controllers: vec!["idm".to_owned(), controller.clone()],
        subject: Some(controller),
        gates: gates.map(GateConfig::from).into(),
        draws: 20,
        everyday_draws: 0,
        certificates: Some(Vec::new()),
        ..AssessConfig::default()
    };
    (config.rates.runs, config.search.spaces) = (200, Some(Vec::new()));
    let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
    let report = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();
    let seed_of_counts = 0x5eed;
    let expected = [
        (
            "fewer failures than idm in the distribution of `paper`",
            seed_of_counts,
        ),
        ("no collision in 20 random scenarios of `paper` (seed 0)", 0),
        (
            "failure rate at most 0.5 % in the distribution of `paper`",
            0,
        ),
    ];
    for (gate, (claim, seed)) in report.summary.gates.iter().zip(expected) {
        assert!(!gate.holds, "{gate:?}");
        let stated = format!("baseline: {claim}");
        assert_eq!(gate.indicator.claim.as_deref(), Some(stated.as_str()));
        let interval = gate.indicator.interval.unwrap();
        let value = gate.indicator.value.unwrap().value();
        assert!(
            interval.lower.value() <= value && value <= interval.upper.value(),
            "{gate:?}"
        );
        let file = report.gate_case(gate).file.unwrap();
        assert_eq!(file, format!("violations/paper-{seed}-0.toml"));
        let files = report.files().unwrap();
        let (_, contents) = files.iter().find(|(path, _)| *path == file).unwrap();
        let text = std::str::from_utf8(contents).unwrap();
        let scenario = file::from_toml(text, Path::new(&file), &NoDriverFiles).unwrap();
        let baseline = find_built_in("baseline").unwrap();
        let run = Run::new(&scenario, RunOptions::new(baseline.source)).unwrap();
        let outcome = simulate(&run, RecordingLevel::Summary).outcome;
        assert!(outcome.collision().is_some(), "{file}");
    }
}

/// A suite that no controller passes.
const SUITE: &str = r#"
version = 1
name = "own"
about = "A vehicle that cuts in too late."
document = "None"
edition = "1"
parameter_source = "Chosen."

[[clauses]]
clause = "1"
summary = "A slower vehicle cuts in."

[[clauses.tests]]
name = "cut-in"
lead = "cut-in"

[clauses.tests.parameters]
own_speed = { values = [60.0], unit = "km/h", origin = "chosen" }
lead_speed = { values = [20.0], unit = "km/h", origin = "chosen" }
closing_time = { values = [0.2], unit = "s", origin = "chosen" }
"#;

/// The file of the suite has another name than the suite, with a backtick.
const CONFIGURATION: &str = r#"
version = 1
controllers = ["idm", "acc-aeb,ttc_s=1.5", "acc-aeb,ttc_s=2.5", "baseline"]
subject = "baseline"
paper = false
distributions = ["high-risk"]
draws = 5
everyday_draws = 0
search = { spaces = ["high-risk"], budget = 10 }
rates.runs = 0

[[suites]]
suite = "the`file.toml"

[[suites]]
suite = "other.toml"

[[gates]]
require = "suite-passed"
controller = "baseline"
suite = "the`file.toml"
"#;

#[test]
fn a_failure_names_a_scenario_of_its_own_claim_only() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("the`file.toml", SUITE);
    write("other.toml", &SUITE.replace("\"own\"", "\"other\""));
    write("assessment.toml", CONFIGURATION);
    let path = folder.path().join("assessment.toml");
    let plan = AssessmentPlan::load(&path, Controllers::default()).unwrap();
    let report = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap();

    let gate = report.gate_case(&report.summary.gates[0]);
    let condition = "baseline: passes every test of suite `own` that can be run";
    assert_eq!(
        (gate.name.as_str(), gate.status),
        (condition, JunitStatus::Failed)
    );
    assert!(gate.file.unwrap().starts_with("counterexamples/suites/"));

    let scenario_against = |is_wanted: &dyn Fn(&AssuranceClaim) -> bool| {
        let rows = report.summary.claims.iter();
        let mut claims = rows.flat_map(|row| row.claims.iter().flatten());
        let claim =
            claims.find(|claim| claim.subject.controller.name == "baseline" && is_wanted(claim));
        report.failing_scenario(claim.unwrap())
    };
    let searched = scenario_against(&|claim| matches!(claim.domain, Domain::Search { .. }));
    assert!(searched.unwrap().starts_with("counterexamples/high-risk/"));
    // `idm` may fail, too, in a scenario that a search with `baseline` found.
    let compared = scenario_against(&|claim| {
        matches!(claim.domain, Domain::Space { .. })
            && matches!(claim.property, Property::FailsLessOften { .. })
    });
    assert_eq!(compared, None);

    let suites = &report.results.suites.as_ref().unwrap().suites;
    let cases: Vec<JunitCase> = suites.iter().flat_map(suite_cases).collect();
    let last_part = |class: &str| class.rsplit('.').next().unwrap().to_owned();
    let identities = cases
        .iter()
        .map(|case| (last_part(&case.class), &case.name));
    let identities: std::collections::BTreeSet<_> = identities.collect();
    assert_eq!((identities.len(), cases.len()), (8, 8));
}
