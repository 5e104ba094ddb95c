//! The committed report is current.

use crumple_controllers::Controllers;
use crumple_sim::scenario::NoDriverFiles;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use crumple_core::observer::Quiet;
use crumple_report::assessment::{
    AssessConfig, AssessmentPlan, AssessmentReport, EvidenceCache, RunInfo, assess,
};
use crumple_search::worst_case::AvoidanceClass;
use saphyr::{LoadableYamlNode, Yaml};
use serde_json::Value;

static BUILT_IN_ASSESSMENT: LazyLock<AssessmentReport> = LazyLock::new(|| {
    assess(
        &AssessmentPlan::built_in().expect("valid"),
        &EvidenceCache::disabled(),
        None,
        &Quiet,
    )
    .expect("runs")
});

static BUILT_IN_FILES: LazyLock<Vec<(String, Vec<u8>)>> =
    LazyLock::new(|| BUILT_IN_ASSESSMENT.files().expect("renders"));

fn read_committed(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("reports")
        .join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Removes the date and the machine, which differ each time.
pub(crate) fn without_build_info(name: &str, text: &str) -> String {
    match name.rsplit('.').next() {
        Some("html") => {
            let text = without_dates(text);
            let Some((before, made)) = text.split_once("<p id=\"made\">") else {
                return text;
            };
            let (_, after) = made.split_once("</p>").expect("the paragraph ends");
            format!("{before}{after}")
        }
        Some("md") => without_dates(text)
            .lines()
            .filter(|line| !line.starts_with("Run of "))
            .map(|line| format!("{line}\n"))
            .collect(),
        Some("xml") => without_dates(text)
            .lines()
            .map(|line| match line.split_once(" time=\"") {
                Some((before, after)) => {
                    let (_, rest) = after.split_once('"').expect("a quoted number");
                    format!("{before}{rest}\n")
                }
                None => format!("{line}\n"),
            })
            .collect(),
        Some("yaml") => without_dates(text),
        Some("json") if name == "assessment.json" => {
            let mut value: Value = serde_json::from_str(text).expect("JSON");
            value["provenance"]["run_info"] = Value::Null;
            format!("{value:#}\n")
        }
        _ => text.to_owned(),
    }
}

/// Replaces each date, such as `2026-11-28` or `2026-11-28T22:25:44Z`, by a placeholder.
fn without_dates(text: &str) -> String {
    let is_day = |day: &str| {
        day.bytes().enumerate().all(|(place, letter)| match place {
            4 | 7 => letter == b'-',
            _ => letter.is_ascii_digit(),
        })
    };
    let mut out = String::new();
    let mut rest = text;
    while let Some(letter) = rest.chars().next() {
        if rest.get(..10).is_some_and(is_day) {
            out += "DATE";
            let is_time = rest
                .get(10..20)
                .is_some_and(|time| time.starts_with('T') && time.ends_with('Z'));
            rest = &rest[if is_time { 20 } else { 10 }..];
        } else {
            out.push(letter);
            rest = &rest[letter.len_utf8()..];
        }
    }
    out
}

/// Returns the time, program and machine that the committed report states.
fn committed_run_info() -> RunInfo {
    let evidence: Value = serde_json::from_str(&read_committed("assessment.json")).expect("JSON");
    let run_info = &evidence["provenance"]["run_info"];
    let text = |field: &str| run_info[field].as_str().unwrap_or_default().to_owned();
    RunInfo {
        at: text("at"),
        commit: run_info["commit"].as_str().map(str::to_owned),
        program_sha256: text("program_sha256"),
        program_commit: evidence["identity"]["crumple_commit"]
            .as_str()
            .map(str::to_owned),
        machine: text("machine"),
        duration_s: run_info["duration_s"].as_u64().unwrap_or_default(),
    }
}

fn assert_current(name: &str, now: &[u8]) {
    let now = without_build_info(name, std::str::from_utf8(now).expect("text"));
    let then = without_build_info(name, &read_committed(name));
    let same = then
        .chars()
        .zip(now.chars())
        .take_while(|(then, now)| then == now)
        .count();
    let around = |text: &str| {
        text.chars()
            .skip(same.saturating_sub(100))
            .take(300)
            .collect::<String>()
    };
    assert!(
        then == now,
        "reports/{name} is out of date; CONTRIBUTING.md has the command that renews it. The first change is in\n{}\n{}",
        around(&then),
        around(&now)
    );
}

/// The box of initial states around a scenario is named like it.
#[test]
fn no_claim_is_named_by_a_hash() {
    let claims: Vec<&str> = BUILT_IN_ASSESSMENT
        .summary
        .claims
        .iter()
        .map(|row| row.claim.as_str())
        .collect();
    for scenario in ["paper-1", "paper-2"] {
        let words =
            format!("no collision from the box of initial states around `{scenario}` for 15 s");
        assert!(
            claims.iter().any(|claim| claim.starts_with(&words)),
            "{claims:#?}"
        );
    }
    let is_hash =
        |word: &str| word.len() >= 8 && word.chars().all(|letter| letter.is_ascii_hexdigit());
    let has_hash = |claim: &&str| {
        claim
            .split(|letter: char| !letter.is_alphanumeric())
            .any(is_hash)
    };
    assert!(!claims.iter().any(has_hash), "{claims:#?}");
}

/// The committed report satisfies the schemas; [`the_committed_report_is_current`] compares it with an assessment.
#[test]
fn schemas_are_those_of_the_types() {
    use crate::schema::{assert_committed, validate};
    let evidence = schemars::schema_for!(AssessmentReport).to_value();
    assert_committed(
        "crates/report/src/assessment/evidence.schema.json",
        &evidence,
    );
    let config = schemars::schema_for!(AssessConfig).to_value();
    assert_committed(
        "crates/report/src/assessment/configuration.schema.json",
        &config,
    );
    let report = serde_json::from_str(&read_committed("assessment.json")).expect("JSON");
    validate(&evidence, &evidence, &report, "evidence").expect("as the schema says");
    let default = serde_json::to_value(AssessConfig::default()).expect("serializes");
    validate(&config, &config, &default, "configuration").expect("as the schema says");
}

/// Every file of the report is committed, with no other counterexample or certificate. Exports for other simulators (9
/// MB) are not committed.
#[test]
fn the_committed_report_is_current() {
    let assessment = BUILT_IN_ASSESSMENT
        .clone()
        .with_run_info(committed_run_info());
    let files = assessment.files().expect("renders");
    for (name, now) in &files {
        if name == "work.json" {
            // The manifest also covers the date on the page.
            let reports = Path::new(env!("CARGO_MANIFEST_DIR")).join("reports");
            let examination =
                crumple_store::run_folder::examine(&reports).expect("it has a manifest");
            assert!(
                examination.is_intact() && examination.files.len() + 1 == files.len(),
                "{examination:?}"
            );
        } else if name.ends_with(".safetensors") {
            let there = fs::read(
                Path::new(env!("CARGO_MANIFEST_DIR"))
                    .join("reports")
                    .join(name),
            );
            assert!(
                there.is_ok_and(|there| there == *now),
                "reports/{name} is out of date"
            );
        } else {
            assert_current(name, now);
        }
    }
    for folder in ["counterexamples", "certificates", "figures"] {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("reports");
        for path in crate::documentation::files_below(root.join(folder)) {
            let name = path
                .strip_prefix(&root)
                .expect("below")
                .to_string_lossy()
                .into_owned();
            assert!(
                files.iter().any(|(known, _)| *known == name),
                "reports/{name} belongs to no assessment"
            );
        }
    }
}

/// The committed report states the commit that made it, without changes, in each of its formats. Where the history is
/// there, that commit belongs to it.
#[test]
fn the_committed_report_was_made_from_a_clean_commit() {
    let evidence: Value = serde_json::from_str(&read_committed("assessment.json")).expect("JSON");
    let commit = evidence["provenance"]["run_info"]["commit"]
        .as_str()
        .expect("the report states a commit");
    let is_hash = |commit: &str| {
        commit.len() == 40 && commit.chars().all(|letter| letter.is_ascii_hexdigit())
    };
    // A debug build states no commit of the program.
    let program = evidence["identity"]["crumple_commit"].as_str();
    assert!(
        is_hash(commit) && program.is_none_or(is_hash),
        "reports/assessment.json was made from `{commit}` by a program of `{program:?}`: commit first, and renew the \
         reports then"
    );
    for name in ["assessment.md", "assessment.html"] {
        let text = read_committed(name);
        assert!(
            text.contains(&format!(", commit {commit}, program ")),
            "reports/{name} states another commit"
        );
    }
    let git = |arguments: &[&str]| {
        let mut git = std::process::Command::new("git");
        git.arg("-C")
            .arg(env!("CARGO_MANIFEST_DIR"))
            .args(arguments)
            .output()
            .ok()
            .filter(|out| out.status.success())
    };
    // Without a prefix, the repository is that of this folder.
    let is_own = git(&["rev-parse", "--show-prefix"]).is_some_and(|out| out.stdout == b"\n");
    let is_shallow =
        git(&["rev-parse", "--is-shallow-repository"]).is_none_or(|out| out.stdout != b"false\n");
    if is_own && !is_shallow {
        let is_ancestor = git(&["merge-base", "--is-ancestor", commit, "HEAD"]).is_some();
        assert!(
            is_ancestor,
            "commit {commit} of reports/assessment.json is not in the history"
        );
    }
}

/// A follower can cause a collision from behind, so the first page names its driver with every figure about collisions.
#[test]
fn the_first_page_names_the_followers() {
    let page = &BUILT_IN_ASSESSMENT.first_page;
    let about_collisions: Vec<&String> = page
        .against
        .iter()
        .chain(&page.speaks_for)
        .filter(|line| line.contains("collision ") || line.contains("failure"))
        .collect();
    assert!(about_collisions.len() > 5, "{about_collisions:?}");
    for line in about_collisions {
        assert!(line.contains("drives the follower"), "{line}");
    }
    let markdown = read_committed("assessment.md");
    let (_, after_claims) = markdown.split_once("| claim |").expect("a table");
    assert!(
        after_claims
            .contains("\nFollowers: in the paper's scenarios, `paper` and `high-risk`, `baseline`"),
        "{after_claims:.2000}"
    );
}

/// JUnit has one test per gate, which fails if the gate does not hold; refuted claims fail no build.
#[test]
fn junit_holds_each_gate_as_a_test() {
    let (_, xml) = BUILT_IN_FILES
        .iter()
        .find(|(name, _)| name.ends_with("junit.xml"))
        .expect("written");
    let report = quick_junit::Report::deserialize_from_str(std::str::from_utf8(xml).expect("text"))
        .expect("JUnit");
    let summary = &BUILT_IN_ASSESSMENT.summary;
    let mut suites = report.test_suites.iter();
    let gates = suites
        .find(|suite| suite.name.as_str() == "gates")
        .expect("gates");
    assert_eq!(gates.tests, summary.gates.len());
    assert_eq!(
        gates.failures,
        summary.gates.iter().filter(|gate| !gate.holds).count()
    );
    let claims: usize = summary
        .claims
        .iter()
        .map(|row| row.claims.iter().flatten().count())
        .sum();
    // Cases are about the subject, properties about the other controllers; each suite also has the identity.
    let suites = report.test_suites.iter();
    let stated: Vec<_> = suites
        .filter(|suite| suite.name.as_str().starts_with("claims: "))
        .collect();
    let stated_claims = |suite: &&quick_junit::TestSuite| {
        suite.test_cases.len() + suite.properties.len() - gates.properties.len()
    };
    assert_eq!(stated.iter().map(stated_claims).sum::<usize>(), claims);
    // A part that was simulated has its measured time; gates and cases have none.
    assert!(
        stated
            .iter()
            .any(|suite| suite.time.is_some_and(|time| !time.is_zero()))
    );
    assert!(gates.time.is_none());
}

/// The goal structure is valid YAML: no dangling references, one connected structure, and challenged goals are
/// defeated.
#[test]
fn the_goal_structure_has_no_dangling_reference() {
    let text = BUILT_IN_ASSESSMENT.argument.to_yaml();
    let documents = Yaml::load_from_str(&text).expect("YAML");
    let elements = documents[0].as_mapping().expect("a mapping");
    let ids: Vec<&str> = elements
        .keys()
        .map(|id| id.as_str().expect("a name"))
        .collect();
    let mut reached = vec![ids[0]];
    for (id, element) in elements {
        let id = id.as_str().expect("a name");
        assert!(!element["text"].as_str().expect("text").is_empty());
        let field = |name: &str| element.as_mapping_get(name);
        for list in ["supportedBy", "inContextOf"].into_iter().filter_map(field) {
            for reference in list.as_sequence().expect("a list") {
                let reference = reference.as_str().expect("a name");
                assert!(ids.contains(&reference), "{id} names {reference}");
                reached.push(reference);
            }
        }
        let kind = |id: &str| {
            id.trim_end_matches(|letter: char| letter.is_ascii_digit())
                .to_owned()
        };
        let list = |name: &str| -> Vec<String> {
            let all = field(name)
                .and_then(Yaml::as_sequence)
                .into_iter()
                .flatten();
            all.map(|reference| kind(reference.as_str().expect("a name")))
                .collect()
        };
        // Allowed support relations of the GSN Community Standard, version 3, part 1.
        let may: &[&str] = match kind(id).as_str() {
            "G" => &["G", "S", "Sn"],
            "S" => &["G"],
            _ => &[],
        };
        assert!(
            list("supportedBy")
                .iter()
                .all(|below| may.contains(&below.as_str())),
            "{id}"
        );
        assert!(
            list("inContextOf")
                .iter()
                .all(|around| around == "C" || around == "A"),
            "{id}"
        );
        let undeveloped = field("undeveloped").is_some();
        let bare = list("supportedBy").is_empty() && field("defeated").is_none();
        assert_eq!(kind(id) == "G" && bare, undeveloped, "{id}");
        if let Some(challenged) = field("challenges").and_then(Yaml::as_str) {
            assert!(ids.contains(&challenged), "{id} challenges {challenged}");
            let target = elements
                .iter()
                .find(|(other, _)| other.as_str() == Some(challenged))
                .expect("there")
                .1;
            assert_eq!(
                target.as_mapping_get("defeated").and_then(Yaml::as_bool),
                Some(true),
                "{challenged}"
            );
            reached.push(id);
        }
        let evidence = field("url").and_then(Yaml::as_str);
        if let Some(part) = evidence.and_then(|url| url.strip_prefix("assessment.html#")) {
            assert!(
                BUILT_IN_ASSESSMENT
                    .sections()
                    .iter()
                    .any(|entry| entry.anchor == part),
                "{id} points to {part}"
            );
        }
    }
    for id in ids {
        assert!(reached.contains(&id), "{id} supports nothing");
    }
}

/// Every listed counterexample collides when its file is replayed alone, and matches its row.
#[test]
fn every_counterexample_of_the_report_collides() {
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::file;
    let mut replayed = 0;
    for search in BUILT_IN_ASSESSMENT
        .results
        .searches
        .spaces
        .iter()
        .flat_map(|space| &space.controllers)
    {
        let controller = Controllers::default()
            .find(&search.controller, Path::new(""))
            .expect("known")
            .source;
        for failure in &search.failures {
            let (_, text) = BUILT_IN_FILES
                .iter()
                .find(|(name, _)| *name == failure.file)
                .expect("written");
            let text = std::str::from_utf8(text).expect("text");
            let scenario =
                file::from_toml(text, Path::new(&failure.file), &NoDriverFiles).expect("valid");
            let run = Run::new(&scenario, RunOptions::new(controller.clone())).expect("runs");
            let outcome = simulate(&run, RecordingLevel::Summary).outcome;
            let collision = outcome
                .collision()
                .unwrap_or_else(|| panic!("{} is safe", failure.file));
            let shown = failure.impact_speed_mps.expect("a speed").value();
            assert!(
                (collision.impact_speed_mps - shown).abs() <= 0.051,
                "{}: {shown}",
                failure.file
            );
            replayed += 1;
        }
    }
    assert!(replayed > 20, "{replayed}");
}

/// Each failed case about runs of a report names the file of a scenario, and the scenarios that violate claims about
/// collisions collide.
#[test]
fn failed_cases_name_scenarios_that_fail() {
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::file;
    let contents = |path: &str| {
        let (_, contents) = BUILT_IN_FILES
            .iter()
            .find(|(name, _)| name == path)
            .unwrap_or_else(|| panic!("{path} is no file of the report"));
        std::str::from_utf8(contents).expect("text")
    };
    let junit = contents("assessment.junit.xml");
    let failed = junit
        .split("<testcase ")
        .skip(1)
        .filter(|case| case.contains("<failure"));
    let mut named = 0;
    for case in failed.filter(|case| !case.contains("largest gain")) {
        let (_, file) = case.split_once(" file=\"").expect(case);
        let (file, _) = file.split_once('"').expect("a quoted path");
        assert!(!contents(file).is_empty());
        named += 1;
    }
    assert!(named > 5, "{junit}");
    let mut collided = 0;
    for violation in &BUILT_IN_ASSESSMENT.violations.scenarios {
        let path = Path::new(&violation.file);
        let scenario =
            file::from_toml(contents(&violation.file), path, &NoDriverFiles).expect("valid");
        let controller = Controllers::default()
            .find(&violation.controller, Path::new(""))
            .expect("known")
            .source;
        let run = Run::new(&scenario, RunOptions::new(controller)).expect("runs");
        let outcome = simulate(&run, RecordingLevel::Summary).outcome;
        let is_about_collisions = violation.claim.starts_with("no collision");
        assert!(
            outcome.collision().is_some() || !is_about_collisions,
            "{violation:?}"
        );
        collided += usize::from(is_about_collisions);
    }
    assert!(collided > 2, "{collided}");
}

/// A comparison with itself finds no change; with one good claim turned bad it finds only that.
#[test]
fn a_comparison_finds_changes() {
    use crumple_report::assessment::EarlierAssessment;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.json");
    let again = |text: &str| {
        fs::write(&path, text).expect("writes");
        let earlier = EarlierAssessment::load(&path).expect("evidence");
        BUILT_IN_ASSESSMENT
            .compare_with(&earlier)
            .expect("comparable")
    };
    let json = BUILT_IN_ASSESSMENT.to_json().expect("serializes");
    let same = again(&json);
    assert_eq!(
        (
            same.better.len(),
            same.worse.len(),
            same.new.len(),
            same.gone.len()
        ),
        (0, 0, 0, 0)
    );
    let mut evidence: Value = serde_json::from_str(&json).expect("JSON");
    evidence["summary"]["claims"][0]["statuses"][0] =
        serde_json::json!({ "strength": "tested", "runs": 3 });
    let changed = again(&evidence.to_string());
    assert_eq!(
        (
            changed.better.len(),
            changed.worse.len(),
            changed.new.len(),
            changed.gone.len()
        ),
        (0, 1, 0, 0)
    );
    assert!(
        changed.worse[0]
            .description
            .starts_with("baseline: no collision"),
        "{:?}",
        changed.worse
    );
}

/// In the whole comparison, no search that found more failures is better in any row, and a claim whose evidence was
/// counted runs is not compared with results of a search.
#[test]
fn a_search_with_more_failures_is_worse_in_every_row() {
    use crumple_report::assessment::EarlierAssessment;
    let mut evidence: Value =
        serde_json::from_str(&BUILT_IN_ASSESSMENT.to_json().expect("serializes")).expect("JSON");
    // The earlier search of `road` in `high-risk` found one failure less, and all of them were avoidable.
    let spaces = evidence["searches"]["spaces"]
        .as_array_mut()
        .expect("spaces");
    let space = spaces
        .iter_mut()
        .find(|space| space["name"] == "high-risk")
        .expect("searched");
    let searches = space["controllers"].as_array_mut().expect("controllers");
    let search = searches
        .iter_mut()
        .find(|search| search["controller"] == "road")
        .expect("searched");
    let failures = search["failures"].as_array_mut().expect("failures");
    failures.pop().expect("it fails");
    failures
        .iter_mut()
        .for_each(|failure| failure["class"] = "avoidable".into());
    let count = failures.len();
    let position = evidence["summary"]["controllers"]
        .as_array()
        .expect("names")
        .iter()
        .position(|name| name == "road");
    let position = position.expect("assessed");
    let mut anywhere = None;
    for row in evidence["summary"]["claims"]
        .as_array_mut()
        .expect("claims")
    {
        let words = row["claim"].as_str().expect("words").to_owned();
        let status = &mut row["statuses"][position];
        if words.starts_with("no collision in a search of `high-risk`") {
            (status["failures"], status["avoidable"]) = (count.into(), count.into());
        } else if words == "no collision anywhere in `high-risk`" {
            // Failures of a search refuted it, and now random scenarios do, or the reverse.
            *status = match status["basis"] == "falsified" {
                true => serde_json::json!({ "strength": "refuted", "failures": 150, "runs": 200 }),
                false => {
                    serde_json::json!({ "strength": "falsified", "failures": 150, "avoidable": 150 })
                }
            };
            anywhere = Some(words);
        }
    }
    assert!(anywhere.is_some(), "claimed");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.json");
    fs::write(&path, evidence.to_string()).expect("writes");
    let earlier = EarlierAssessment::load(&path).expect("evidence");
    let case = BUILT_IN_ASSESSMENT
        .compare_with(&earlier)
        .expect("comparable");
    assert!(case.better.is_empty(), "{:?}", case.better);
    let [worse] = &case.worse[..] else {
        panic!("{:?}", case.worse)
    };
    assert!(
        worse
            .description
            .starts_with("road: no collision in a search of `high-risk`"),
        "{worse:?}"
    );
    let before = worse.before.as_deref().unwrap_or_default();
    assert!(before.contains(&format!("{count} distinct")), "{before}");
    let [changed] = &case.changed[..] else {
        panic!("{:?}", case.changed)
    };
    assert_eq!(
        changed.description,
        "road: no collision anywhere in `high-risk`"
    );
}

/// The verdict table follows from the evidence alone.
#[test]
fn the_verdict_is_that_of_the_evidence() {
    let evidence: Value = serde_json::from_str(&read_committed("assessment.json")).expect("JSON");
    let names: Vec<_> = evidence["summary"]["controllers"]
        .as_array()
        .expect("names")
        .clone();
    let claims = evidence["summary"]["claims"].as_array().expect("claims");
    for (index, name) in names.iter().enumerate() {
        let scenarios = evidence["paper_scenarios"]["scenarios"]
            .as_array()
            .expect("scenarios");
        let case = |scenario: &Value| {
            let cases = scenario["cases"].as_array().expect("cases").clone();
            cases
                .into_iter()
                .find(|case| case["controller"] == *name)
                .expect("every controller has a case")
        };
        let failures = scenarios
            .iter()
            .filter(|s| case(s)["verdict"]["kind"] != "safe")
            .count();
        let strength = &claims[0]["statuses"][index];
        match failures {
            0 => assert_eq!(strength["basis"], "tested", "{name}"),
            _ => assert_eq!(strength["failures"], failures, "{name}"),
        }
        let sampled = &evidence["rate_spaces"]["spaces"][0]["controllers"][index];
        assert_eq!(sampled["controller"], *name);
        let collisions = sampled["collisions"].as_u64().expect("a count");
        let strength = &claims[1]["statuses"][index];
        match collisions {
            0 => assert_eq!(strength["basis"], "tested", "{name}"),
            _ => assert_eq!(strength["failures"], collisions, "{name}"),
        }
        let by_kind = sampled["hit"].as_u64().expect("a count")
            + sampled["was_hit"].as_u64().expect("a count");
        assert_eq!(
            by_kind, collisions,
            "{name}: with one ego every collision involves it"
        );
    }
}

/// No controller exceeds the bound over all of them, and regret matches the shown numbers.
#[test]
fn no_controller_exceeds_the_bound_and_regrets_add_up() {
    let scenarios = &BUILT_IN_ASSESSMENT
        .results
        .paper_scenarios
        .as_ref()
        .expect("asked for")
        .scenarios;
    assert_eq!(
        scenarios.len(),
        crumple_sim::scenario::built_in_scenario_names().len()
    );
    for scenario in scenarios {
        let report = scenario.avoidance.as_ref().expect("an analysis");
        assert_eq!(report.verdict, AvoidanceClass::Avoidable);
        // The report shows these numbers.
        let shown = &serde_json::to_value(scenario).unwrap()["avoidance"];
        let bound_m = shown["min_gap_bound_m"].as_f64().expect("a bound");
        let escape_m = shown["escape_min_gap_m"].as_f64().expect("a gap");
        assert!(report.min_gap_bound_m.expect("a bound") <= bound_m);
        assert!(escape_m <= report.escape_min_gap_m.expect("a gap"));
        assert!(escape_m <= bound_m);
        assert_eq!(
            scenario.cases.len(),
            BUILT_IN_ASSESSMENT.summary.controllers.len()
        );
        for case in &scenario.cases {
            let (own_m, regret_m) = (
                case.min_gap_m.expect("a gap").value(),
                case.regret_m.expect("a regret").value(),
            );
            assert!(own_m <= bound_m, "{}: {own_m} m", case.controller);
            assert!((own_m + regret_m - escape_m).abs() < 1e-9 || regret_m == 0.0);
            let pairs = [case.ahead.min_gap_m, case.behind.min_gap_m]
                .into_iter()
                .flatten();
            assert_eq!(
                pairs.map(|gap| gap.value()).reduce(f64::min),
                Some(own_m),
                "{}",
                case.controller
            );
        }
    }
}

#[test]
fn every_certificate_is_accepted() {
    let accepted = BUILT_IN_ASSESSMENT
        .results
        .proofs
        .certificates
        .iter()
        .filter(|proof| proof.is_accepted());
    assert_eq!(
        accepted.count(),
        BUILT_IN_ASSESSMENT.results.proofs.certificates.len()
    );
    for statement in ["kernel", "rate", "comparison", "reach"] {
        assert!(
            BUILT_IN_ASSESSMENT
                .results
                .proofs
                .certificates
                .iter()
                .any(|proof| proof.statement == statement),
            "{statement}"
        );
    }
}

#[test]
fn the_page_is_self_contained_and_its_links_lead_somewhere() {
    let page = BUILT_IN_ASSESSMENT.to_html();
    for outside in [
        "http://",
        "https://",
        "src=",
        "@import",
        "url(",
        "<script src",
        "<link",
        "fetch(",
        "XMLHttp",
        "import(",
    ] {
        let inside = ["http://www.w3.org/2000/svg", "url(#"];
        let anchor = page
            .match_indices(outside)
            .filter(|(at, _)| inside.iter().all(|i| !page[*at..].starts_with(i)));
        assert_eq!(anchor.count(), 0, "{outside}");
    }
    assert_links_lead_somewhere(&page);
}

/// Checks that no identifier stands twice, and that every link within the page leads to one.
pub(crate) fn assert_links_lead_somewhere(page: &str) {
    let ids: Vec<&str> = page
        .split(" id=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    assert_eq!(
        ids.iter().collect::<BTreeSet<_>>().len(),
        ids.len(),
        "an identifier stands twice"
    );
    for link in page
        .split("href=\"#")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
    {
        assert!(ids.contains(&link), "#{link} leads nowhere");
    }
}
