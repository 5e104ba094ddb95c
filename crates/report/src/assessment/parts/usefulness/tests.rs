use std::path::Path;

use super::*;
use crate::assessment::{AssessConfig, EvidenceCache};
use crumple_core::observer::{ProgressCounter, Quiet};

#[test]
fn both_measures_are_reported_for_every_controller() {
    let controllers = ["idm", "retrained"].map(str::to_owned).into();
    let config = AssessConfig {
        controllers,
        gates: Vec::new(),
        ..AssessConfig::default()
    };
    let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
    let cache = EvidenceCache::disabled();
    let work = GatherContext::new(&plan, &cache, ProgressCounter::new(&Quiet, None));
    let report = UsefulnessReport::gather(&work).unwrap().unwrap();
    let [idm, retrained] = &report.controllers[..] else {
        panic!("one entry per controller")
    };
    assert_eq!(
        (
            idm.failures,
            idm.unnecessary_braking,
            idm.hard_braking,
            retrained.failures
        ),
        (0, 0, 0, 0)
    );
    assert!(
        retrained.unnecessary_braking > report.random_scenarios / 2
            && retrained.progress < idm.progress
    );
    assert!(
        retrained.high_risk_percent.observed < idm.high_risk_percent.observed,
        "the other side"
    );
    for useful in [idm, retrained] {
        assert_eq!(
            useful.hit[1] + useful.was_hit[1],
            useful.high_risk_failures,
            "a failure is a collision"
        );
    }
    assert!(idm.was_hit[1] > 0 || idm.hit[1] > 0);
    let largest = idm.oscillation_gain.largest.unwrap();
    assert!(
        (largest.gain.value() - 1.035).abs() < 0.002 && largest.mean_speed_mps.value() < 8.0,
        "{largest:?}"
    );
    assert!(!idm.oscillation_gain.damps_all() && !retrained.oscillation_gain.damps_all());
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(
        serde_json::to_string(&serde_json::from_str::<UsefulnessReport>(&json).unwrap()).unwrap(),
        json
    );
    let mut document = ReportDocument::new();
    report.write(&mut document);
    assert!(
        document.to_markdown().into_string().contains("| idm |")
            && document.to_html().into_string().contains("<svg")
    );
}
