use std::path::PathBuf;

use super::*;
use crate::assessment::{
    AssessConfig, AssessmentGate, AssessmentPlan, EvidenceCache, GateConfig, assess,
};
use crumple_core::observer::Quiet;
use crumple_sim::scenario::{built_in_scenario, built_in_scenario_names, file};

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
    // The report has no file of the paper's scenarios.
    assert_eq!(in_paper.file, None);
    assert_eq!(in_files.file.as_deref(), Some("scenarios/copy.toml"));
}
