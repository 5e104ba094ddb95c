//! The committed report is what the code says today.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use crumple::report::{Assessment, Best, KernelStatus, Plan, assess};
use serde_json::Value;

static BUILT_IN: LazyLock<Assessment> = LazyLock::new(|| assess(&Plan::built_in(), &|_| {}).expect("runs"));

fn committed(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("reports").join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn assert_current(name: &str, now: &str) {
    let then = committed(name);
    let changed = then.lines().zip(now.lines()).find(|(then, now)| then != now);
    assert!(
        then == now,
        "reports/{name} is out of date, first at {changed:#?}; see CONTRIBUTING.md for the command that renews it"
    );
}

#[test]
fn the_committed_markdown_and_evidence_are_current() {
    assert_current("assessment.md", &BUILT_IN.markdown());
    assert_current("assessment.json", &BUILT_IN.json().expect("serializes"));
}

/// The verdict table follows from the evidence alone.
#[test]
fn the_verdict_is_that_of_the_evidence() {
    let evidence: Value = serde_json::from_str(&committed("assessment.json")).expect("JSON");
    let names: Vec<_> = evidence["summary"]["controllers"].as_array().expect("names").clone();
    let claims = evidence["summary"]["claims"].as_array().expect("claims");
    for (index, name) in names.iter().enumerate() {
        let scenarios = evidence["paper_scenarios"]["scenarios"].as_array().expect("scenarios");
        let case = |scenario: &Value| {
            let cases = scenario["cases"].as_array().expect("cases").clone();
            cases.into_iter().find(|case| case["controller"] == *name).expect("every controller has a case")
        };
        let failures = scenarios.iter().filter(|s| case(s)["verdict"]["kind"] != "safe").count();
        let strength = &claims[0]["strengths"][index];
        match failures {
            0 => assert_eq!(strength["strength"], "tested", "{name}"),
            _ => assert_eq!(strength["failures"], failures, "{name}"),
        }
        let sampled = &evidence["distribution"]["controllers"][index];
        assert_eq!(sampled["controller"], *name);
        let collisions = sampled["collisions"].as_u64().expect("a count");
        let strength = &claims[1]["strengths"][index];
        match collisions {
            0 => assert_eq!(strength["strength"], "tested", "{name}"),
            _ => assert_eq!(strength["failures"], collisions, "{name}"),
        }
        let by_kind = sampled["hit"].as_u64().expect("a count") + sampled["was_hit"].as_u64().expect("a count");
        assert_eq!(by_kind, collisions, "{name}: with one ego every collision involves it");
    }
}

/// No controller does better than the bound over all of them, and regret is what the shown numbers make it.
#[test]
fn nobody_beats_the_bound_and_regrets_add_up() {
    let mut compared = 0;
    for scenario in &BUILT_IN.paper_scenarios.scenarios {
        let Some(Best::Avoidable { min_gap_m, min_gap_bound_m, .. }) = &scenario.best else { panic!("avoidable") };
        let bound_m = min_gap_bound_m.expect("a bound").value();
        assert!(min_gap_m.value() <= bound_m);
        for case in &scenario.cases {
            let (own_m, regret_m) = (case.min_gap_m.expect("a gap").value(), case.regret_m.expect("a regret").value());
            assert!(own_m <= bound_m, "{}: {own_m} m", case.controller);
            assert!((own_m + regret_m - min_gap_m.value()).abs() < 1e-9 || regret_m == 0.0);
            let pairs = [case.ahead.min_gap_m, case.behind.min_gap_m].into_iter().flatten();
            assert_eq!(pairs.map(|gap| gap.value()).reduce(f64::min), Some(own_m), "{}", case.controller);
            compared += 1;
        }
    }
    assert_eq!(compared, 21);
}

#[test]
fn worst_profiles_collide_and_kernels_are_proved() {
    let worst = BUILT_IN.worst_profiles.as_ref().expect("shipped");
    for profile in &worst.profiles {
        let Some(mildest) = &profile.mildest else { continue };
        assert!(mildest.verdict.is_collision() && mildest.margin_m.value() <= 0.0, "{}", profile.controller);
        assert!(mildest.peak_brake_mps2 <= worst.max_brake_mps2, "{}", profile.controller);
    }
    let statuses: Vec<_> = BUILT_IN.proofs.kernels.iter().map(|kernel| &kernel.status).collect();
    assert_eq!(statuses, [&KernelStatus::Accepted; 4]);
}

#[test]
fn the_page_is_self_contained_and_its_links_lead_somewhere() {
    let page = BUILT_IN.html();
    for outside in
        ["http://", "https://", "src=", "@import", "url(", "<script src", "<link", "fetch(", "XMLHttp", "import("]
    {
        let inside = ["http://www.w3.org/2000/svg", "url(#"];
        let found = page.match_indices(outside).filter(|(at, _)| inside.iter().all(|i| !page[*at..].starts_with(i)));
        assert_eq!(found.count(), 0, "{outside}");
    }
    let ids: Vec<&str> = page.split("id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    let mut unique = ids.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), ids.len(), "an id is used twice");
    for link in page.split("href=\"#").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert!(ids.contains(&link), "#{link} leads nowhere");
    }
}
