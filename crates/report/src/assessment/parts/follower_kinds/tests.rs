use std::path::Path;

use super::*;
use crate::assessment::{AssessConfig, EvidenceCache};
use crumple_core::observer::{ProgressCounter, Quiet};

/// Kinds of follower whose only brake fires late: only there does `idm` collide in everyday driving.
const LATE_BRAKES: [&str; 3] = ["baseline", "late", "weak"];

#[test]
fn counts_name_the_follower_and_add_up() {
    let config = AssessConfig {
        controllers: vec!["idm".to_owned(), "predictive".to_owned()],
        gates: Vec::new(),
        everyday_draws: 30,
        ..AssessConfig::default()
    };
    let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
    let cache = EvidenceCache::disabled();
    let work = GatherContext::new(&plan, &cache, ProgressCounter::new(&Quiet, None));
    let report = FollowerReport::gather(&work).unwrap().unwrap();
    assert_eq!(FollowerReport::runs(&plan), 2 * 2 * 7 * 30);
    for space in &report.spaces {
        assert_eq!(space.kinds.len(), 7);
        for results in &space.controllers {
            let counted = |count: fn(&KindCounts) -> u64| {
                let kinds: u64 = results.by_kind.values().map(count).sum();
                assert_eq!(kinds, count(&results.all), "{}", results.controller);
                kinds
            };
            assert_eq!(counted(|counts| counts.random_scenarios), 210);
            counted(|counts| counts.ends.failures());
            counted(|counts| counts.hard_braking);
            counted(|counts| counts.left_behind);
            counted(|counts| counts.unnecessary_braking);
        }
    }
    let everyday = report.find_space("everyday").unwrap();
    for (kind, counts) in &everyday.find("idm").unwrap().by_kind {
        assert!(
            counts.ends.collisions == 0 || LATE_BRAKES.contains(&kind.as_str()),
            "{kind}"
        );
    }
    let emergencies = report.find_space("followers").unwrap();
    let [idm, predictive] = ["idm", "predictive"].map(|name| emergencies.find(name).unwrap());
    assert!(predictive.all.ends.collisions < idm.all.ends.collisions / 2);
    assert_eq!(idm.by_kind["none"].ends.collisions, 0);
    check_pages(&report);
}

/// Both forms name each kind in every table of collisions, and the limit from which a controller falls behind.
fn check_pages(report: &FollowerReport) {
    let mut document = ReportDocument::new();
    report.write(&mut document);
    report.write_first_page(&mut document);
    let pages = [
        document.to_markdown().into_string(),
        document.to_html().into_string(),
    ];
    for page in pages {
        for kind in &report.spaces[0].kinds {
            assert_eq!(page.matches(&format!("{kind} behind")).count(), 4, "{kind}");
        }
        assert!(
            page.contains("20 m plus 6 s times the leader's speed"),
            "{page}"
        );
    }
    let json = serde_json::to_string(report).unwrap();
    let read: FollowerReport = serde_json::from_str(&json).unwrap();
    assert_eq!(serde_json::to_string(&read).unwrap(), json);
}
