//! The report states the same as the commands, whose text is `to_text` of a result of the libraries. Each test computes
//! such a result apart from the assessment, and looks for the statements of the one in the text of the other.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use super::rate_certificates::COUNT_SEED_MASK;
use super::*;
use crate::assessment::{
    AssessConfig, AssessmentReport, EvidenceCache, HarmConfig, RatesConfig, SearchConfig,
    SuiteConfig, assess,
};
use crate::suite::render_text;
use crumple_controllers::{Controllers, find_for_user};
use crumple_core::observer::Quiet;
use crumple_evidence::drives::DriveSet;
use crumple_evidence::{
    CertificateReport, CountReport, DriveReport, RateConfig, RatePlan, report_text,
};
use crumple_measure::{RunReport, harm};
use crumple_search::falsify::campaign::Campaign;
use crumple_search::worst_case::{AvoidOptions, AvoidReport, avoid};
use crumple_sim::engine::{
    AfterCollision, NamedController, RecordingLevel, Run, RunOptions, simulate,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{
    Driver, LeadProfile, NoDriverFiles, RecordedMotion, RecordedSpeeds, Scenario, ScenarioSpec,
    VehicleClass, VehicleSpec, built_in_scenario, file,
};
use crumple_spaces::built_in_space;
use crumple_store::study::Study;
use crumple_suites::{SuiteResult, TestSuite};
use crumple_verify::Certificate;
use serde_json::Value;

/// Returns a configuration that asks for nothing.
fn nothing(controllers: &[&str]) -> AssessConfig {
    AssessConfig {
        controllers: controllers.iter().map(|&name| name.to_owned()).collect(),
        gates: Vec::new(),
        paper: false,
        draws: 0,
        everyday_draws: 0,
        distributions: Some(Vec::new()),
        certificates: Some(Vec::new()),
        search: SearchConfig {
            spaces: Some(Vec::new()),
            ..SearchConfig::default()
        },
        ..AssessConfig::default()
    }
}

fn report(config: AssessConfig, folder: &Path) -> AssessmentReport {
    let plan = AssessmentPlan::new(config, [], folder).unwrap();
    assess(&plan, &EvidenceCache::disabled(), None, &Quiet).unwrap()
}

fn controller(name: &str) -> NamedController {
    find_for_user(name, Path::new("")).unwrap()
}

/// Returns a section of the Markdown, as a reader sees it: without escapes.
fn section(report: &AssessmentReport, title: &str) -> String {
    let markdown = report.to_markdown().replace('\\', "");
    let begin = markdown.find(&format!("## {title}\n")).expect(title);
    let rest = &markdown[begin + 3..];
    let end = rest.find("\n## ").unwrap_or(rest.len());
    rest[..end].to_owned()
}

fn subsection<'a>(section: &'a str, title: &str) -> &'a str {
    let begin = section.find(&format!("### {title}\n")).expect(title);
    let rest = &section[begin..];
    let end = rest[4..].find("\n### ");
    &rest[..end.map_or(rest.len(), |end| end + 4)]
}

/// Returns a report about two controllers in the paper's scenarios.
fn paper_report() -> &'static AssessmentReport {
    static REPORT: OnceLock<AssessmentReport> = OnceLock::new();
    REPORT.get_or_init(|| {
        let config = AssessConfig {
            paper: true,
            ..nothing(&["baseline", "idm"])
        };
        report(config, Path::new(""))
    })
}

/// Returns the cells of the rows about a controller, without their marks.
fn cells<'a>(section: &'a str, name: &str) -> Vec<&'a str> {
    let begin = format!("| {name} |");
    let rows = section.lines().filter(|line| line.starts_with(&begin));
    let cells = rows.flat_map(|row| row.split('|'));
    let cells = cells.map(|cell| cell.trim().trim_start_matches(['✓', '✗']).trim());
    cells
        .filter(|cell| !["", "–", name].contains(cell))
        .collect()
}

fn assert_states(text: &str, statement: &str) {
    assert!(text.contains(statement), "`{statement}` is not in:\n{text}");
}

/// Returns a drive behind a leader that slows down; the driver behind repeats the recorded 20 m/s.
fn drive(name: &str, then_mps: f64) -> Scenario {
    let profile = |speed_mps: [f64; 4]| {
        Driver::Profile(LeadProfile::Recorded(RecordedSpeeds {
            time_s: vec![0.0, 20.0, 22.0, 60.0],
            speed_mps: speed_mps.into(),
        }))
    };
    let vehicle =
        |position_m, driver| VehicleSpec::new(VehicleClass::Light, position_m, 20.0, driver);
    let mut tested = vehicle(32.0, Driver::UnderTest);
    tested.recorded = Some(Box::new(RecordedMotion {
        interval_s: 0.1,
        gap_m: vec![30.0; 600],
        speed_mps: (0..600)
            .map(|step| if step == 599 { then_mps } else { 20.0 })
            .collect(),
    }));
    let vehicles = vec![
        vehicle(64.0, profile([20.0, 20.0, then_mps, then_mps])),
        tested,
        vehicle(0.0, profile([20.0; 4])),
    ];
    Scenario::new(ScenarioSpec::new(name.to_owned(), 60.0, vehicles)).unwrap()
}

#[test]
fn recorded_drives_are_those_of_the_drive_report() {
    let folder = tempfile::tempdir().unwrap();
    let drives = folder.path().join("drives");
    fs::create_dir(&drives).unwrap();
    for (name, then_mps) in [("slow", 4.0), ("steady", 19.0)] {
        let text = file::to_toml(&drive(name, then_mps)).unwrap();
        fs::write(drives.join(format!("{name}.toml")), text).unwrap();
    }
    let names = ["baseline", "idm"];
    let config = AssessConfig {
        drives: Some(PathBuf::from("drives")),
        ..nothing(&names)
    };
    let section = section(&report(config, folder.path()), "Recorded drives");
    let set = DriveSet::load(&drives, &NoDriverFiles).unwrap();
    for name in names {
        let options =
            RunOptions::new(controller(name).source).with_estimator(EstimatorKind::default());
        let runs = set.run(&options, &Quiet).unwrap();
        let text = DriveReport::new(name, &runs, &set).to_text();
        let shown = cells(&section, name);
        assert!(shown.len() > 8, "{section}");
        for cell in shown.into_iter().chain(cells(&section, "recorded cars")) {
            assert_states(&text, cell);
        }
    }
}

#[test]
fn escapes_and_certificates_are_those_of_avoid_and_check() {
    let report = paper_report();
    let paper = section(report, "The paper's scenarios");
    let scenarios = &report.results.paper_scenarios.as_ref().unwrap().scenarios;
    for cases in scenarios {
        let scenario = built_in_scenario(&cases.scenario).unwrap();
        let options = AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        };
        let avoidance = avoid(&scenario, options).unwrap();
        let expected = AvoidReport::new(&scenario, &avoidance);
        let own = subsection(&paper, &cases.scenario);
        let statements = expected.main_statements();
        assert!(statements.len() > 3, "{statements:?}");
        for statement in &statements {
            assert_states(&expected.to_text(), statement);
            assert_states(own, statement);
        }
        assert_states(own, &format!("{}.", statements.join("; ")));
    }
    let proofs = section(report, "Proofs");
    let certificates = &report.results.proofs.certificates;
    assert!(certificates.len() >= scenarios.len());
    for proof in certificates {
        let certificate = Certificate::from_json(&proof.text).unwrap();
        let checked =
            CertificateReport::new(proof.name.clone(), &certificate, Controllers::default());
        let text = report_text(&[checked], None);
        let shown = proof.status.describe();
        assert_states(&text, &format!("{}: accepted: {shown}\n", proof.name));
        assert_states(&proofs, &shown);
        assert_states(&text, &format!(": {}\n", proof.sha256));
        assert_states(&proofs, &proof.sha256);
        for assumption in &proof.assumptions {
            assert_states(&text, &format!("assuming that {assumption}\n"));
            assert_states(&proofs, &assumption.to_string());
        }
    }
}

/// Returns the words of the row about a vehicle in the table of a run report: index, class, driver, gap, time to
/// collision and braking.
fn vehicle_row(text: &str, vehicle: &str) -> Vec<String> {
    let rows = text.lines().skip_while(|line| !line.contains("min gap m"));
    let mut rows = rows.map(|row| row.split_whitespace().map(str::to_owned).collect());
    rows.find(|row: &Vec<String>| row[0] == vehicle)
        .expect(text)
}

#[test]
fn scenario_cases_are_those_of_the_run_reports() {
    let paper = section(paper_report(), "The paper's scenarios");
    // Their only vehicle under test is vehicle 1.
    for scenario in ["paper-1", "paper-2"] {
        let own = subsection(&paper, scenario);
        for name in ["baseline", "idm"] {
            let named = controller(name);
            let options =
                RunOptions::new(named.source.clone()).with_estimator(EstimatorKind::default());
            let run = Run::new(&built_in_scenario(scenario).unwrap(), options).unwrap();
            let result = simulate(&run, RecordingLevel::Summary);
            let text = RunReport::new(&run, &named, &result).to_text();
            let [tested, behind] = ["1", "2"].map(|vehicle| vehicle_row(&text, vehicle));
            let printed = [&tested[3], &behind[3], &tested[4], &tested[5]];
            let shown = cells(own, name);
            assert_eq!([shown[1], shown[2], shown[4], shown[5]], printed, "{own}");
        }
    }
}

#[test]
fn suites_are_those_of_the_suite_result() {
    let shipped = TestSuite::shipped("un-r152").unwrap().unwrap();
    let mut spec = shipped.spec().clone();
    spec.name = "own".to_owned();
    spec.clauses.truncate(1);
    spec.clauses[0].tests.truncate(1);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("own.toml");
    fs::write(&path, toml::to_string(&spec).unwrap()).unwrap();
    let names = ["baseline", "idm"];
    let config = AssessConfig {
        suites: vec![SuiteConfig {
            suite: "own.toml".to_owned(),
            controllers: None,
        }],
        ..nothing(&names)
    };
    let report = report(config, folder.path());
    let section = section(&report, "Tests modelled on regulations");
    let suite = TestSuite::load(&path).unwrap();
    let result =
        crumple_suites::run(&suite, &names.map(controller), EstimatorKind::default()).unwrap();
    let text = render_text(&result, |_, _| None);
    let json = serde_json::to_string(&result).unwrap();
    let read: SuiteResult = serde_json::from_str(&json).unwrap();
    assert_eq!(render_text(&read, |_, _| None), text);
    assert_eq!(serde_json::to_string(&read).unwrap(), json);
    let suites = serde_json::to_value(&report.results.suites).unwrap();
    let reported = &suites["suites"][0];
    let mut statements = vec![&reported["parameter_source"]];
    statements.extend(reported["not_modelled"].as_array().unwrap());
    statements.extend(reported["omitted_parameters"].as_array().unwrap());
    let tests = reported["tests"].as_array().unwrap();
    for outcome in tests
        .iter()
        .flat_map(|test| test["outcomes"].as_array().unwrap())
    {
        // A test that passes at each stated point may fail within the tolerances, which the text states instead.
        let fails_in_tolerance = outcome["verdict"] == "PASSED" && outcome["passed"] == false;
        statements.extend(Some(&outcome["verdict"]).filter(|_| !fails_in_tolerance));
        statements.extend(outcome["margins"].as_array().unwrap());
        let worst = &outcome["worst"];
        statements.extend([
            &outcome["worst_in_tolerance"],
            &outcome["warning"],
            &worst["point"],
            &worst["preventable"],
        ]);
    }
    let statements: Vec<&str> = statements.into_iter().filter_map(Value::as_str).collect();
    assert!(statements.len() > 6, "{statements:?}");
    for statement in statements {
        assert_states(&text, statement);
        assert_states(&section, statement);
    }
}

#[test]
fn searches_are_those_of_the_campaign_summary() {
    let config = AssessConfig {
        search: SearchConfig {
            spaces: Some(vec!["high-risk".to_owned()]),
            budget: 60,
        },
        ..nothing(&["baseline"])
    };
    let report = report(config, Path::new(""));
    let section = section(&report, "Counterexamples found by search");
    let search = report.results.searches.spaces[0].find("baseline").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let campaign =
        Campaign::new(controller("baseline"), built_in_space("high-risk").unwrap()).with_budget(60);
    let summary = campaign.run(folder.path(), false, &Quiet).unwrap();
    let text = summary.to_text();
    let distinct = search.distinct_count() + search.collisions_of_others;
    assert_states(&text, &format!("FALSIFIED: {distinct} distinct failure"));
    for method in &search.methods {
        let mut rows = text
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>());
        let row = rows.find(|row| row.first() == Some(&method.method.as_str()));
        let row = row.unwrap_or_else(|| panic!("{}: {text}", method.method));
        let failures = (method.failures + method.collisions_of_others).to_string();
        assert_eq!(row[1], method.evaluations.to_string(), "{text}");
        assert_eq!(row[3], failures, "{text}");
    }
    assert!(!search.failures.is_empty());
    for failure in &search.failures {
        let begin = text.find(failure.short_name()).unwrap();
        let own: Vec<&str> = text[begin..].lines().take(6).collect();
        assert_states(&section, failure.short_name());
        for changed in &failure.changed {
            assert_states(&own.join("\n"), changed);
            assert_states(&section, changed);
        }
        if let Some(impact_mps) = failure.impact_speed_mps {
            assert_states(own[1], &format!("{impact_mps} m/s"));
            assert_states(&section, &format!("| {impact_mps} |"));
        }
    }
}

/// Counts runs apart from the assessment, and returns the report of the count with its certificate.
fn count(config: RateConfig) -> (CountReport, Certificate) {
    let folder = tempfile::tempdir().unwrap();
    let plan = RatePlan::new(config).unwrap();
    let result = plan.run(folder.path(), false, &Quiet).unwrap();
    let certificate = result.certificate.clone().unwrap();
    let path = folder.path().to_owned();
    let report = CountReport::new(&plan, &result, path, PathBuf::from("certificate.json"));
    (report, certificate)
}

/// Returns the number in a column of the row about a controller.
fn count_in(section: &str, name: &str, column: &str) -> u64 {
    let split = |row: &str| -> Vec<String> {
        let cells = row.split('|');
        cells
            .map(|cell| cell.trim().trim_start_matches(['✓', '✗']).trim().to_owned())
            .collect()
    };
    let mut rows = section.lines().filter(|line| line.starts_with('|'));
    let header = split(rows.next().expect("a table"));
    let row = rows.map(split).find(|row| row[1] == name).expect(name);
    let index = header.iter().position(|cell| cell == column).expect(column);
    row[index].parse().expect(column)
}

#[test]
fn random_scenarios_are_those_of_the_count_report() {
    const RUNS: u64 = 300;
    let names = ["baseline", "idm"];
    let config = AssessConfig {
        distributions: Some(vec!["high-risk".to_owned()]),
        draws: RUNS,
        rates: RatesConfig {
            runs: 0,
            ..RatesConfig::default()
        },
        ..nothing(&names)
    };
    let section = section(&report(config, Path::new("")), "Collision rates");
    let space = built_in_space("high-risk").unwrap();
    let count_of = |name: &str| RateConfig {
        estimator: EstimatorKind::default(),
        ..RateConfig::new(controller(name), space.clone(), RUNS)
    };
    for name in names {
        let (counted, _) = count(count_of(name));
        let failures =
            count_in(&section, name, "collisions") + count_in(&section, name, "ended by others");
        assert!(failures > 0, "{section}");
        let statement = format!("{failures} failures in {RUNS} runs");
        assert_states(&counted.to_text(), &statement);
    }
    let (counted, _) = count(RateConfig {
        second_controller: Some(controller("baseline")),
        ..count_of("idm")
    });
    let [only_baseline, only_idm] = ["only baseline collides", "only this collides"]
        .map(|column| count_in(&section, "idm", column));
    assert_states(
        &counted.to_text(),
        &format!(
            "{only_idm} runs in which only the first failed, {only_baseline} only the second, "
        ),
    );
}

#[test]
fn rate_certificates_are_those_of_the_count_report() {
    let rates = RatesConfig {
        runs: 700,
        confidence: 0.9,
    };
    let config = AssessConfig {
        distributions: Some(vec!["high-risk".to_owned()]),
        rates: rates.clone(),
        ..nothing(&["baseline", "policy"])
    };
    let report = report(config, Path::new(""));
    let proofs = section(&report, "Proofs");
    let mut certificates = report.results.proofs.certificates.iter();
    let reported = certificates
        .find(|proof| proof.name == "rate-policy")
        .unwrap();
    let (counted, certificate) = count(RateConfig {
        seed: COUNT_SEED_MASK,
        estimator: EstimatorKind::default(),
        confidence: rates.confidence,
        ..RateConfig::new(
            controller("policy"),
            built_in_space("high-risk").unwrap(),
            rates.runs,
        )
    });
    let conclusion = reported.status.describe();
    assert_states(
        &counted.to_text(),
        &format!("certificate.json: accepted: {conclusion}\n"),
    );
    assert_states(&proofs, &conclusion);
    assert_eq!(reported.sha256, certificate.digest());
    assert_states(&proofs, &reported.sha256);
}

#[test]
fn harm_is_that_of_the_run_reports() {
    const RUNS: u64 = 60;
    let config = AssessConfig {
        distributions: Some(vec!["high-risk".to_owned()]),
        draws: RUNS,
        rates: RatesConfig {
            runs: 0,
            ..RatesConfig::default()
        },
        harm: Some(HarmConfig {
            emergencies_per_hour: 0.5,
            ..HarmConfig::default()
        }),
        ..nothing(&["full-throttle", "idm"])
    };
    let report = report(config, Path::new(""));
    let section = section(
        &report,
        "Collisions ahead avoided, collisions behind caused, and harm",
    );
    let space = built_in_space("high-risk").unwrap();
    for name in ["full-throttle", "idm"] {
        let named = controller(name);
        let options = RunOptions::new(named.source.clone())
            .with_estimator(EstimatorKind::default())
            .with_after_collision(AfterCollision::Hold);
        let mut total_harm = 0.0;
        let mut ahead = 0;
        for index in 0..RUNS {
            let scenario = space.draw(0, index).unwrap();
            let run = Run::new(&scenario, options.clone()).unwrap();
            let result = simulate(&run, RecordingLevel::Summary);
            total_harm += harm(&result.impacts, scenario.vehicles().len());
            let text = RunReport::new(&run, &named, &result).to_text();
            ahead += u64::from(text.contains("vehicle 1 hits vehicle 0"));
        }
        let shown = cells(&section, name);
        let ahead_percent = 100.0 * ahead as f64 / RUNS as f64;
        assert_eq!(
            shown[1].split(' ').next(),
            Some(&*format!("{ahead_percent:.2}")),
            "{section}"
        );
        let harm_per_1000 = 1000.0 * total_harm / RUNS as f64;
        assert!(
            shown
                .iter()
                .any(|cell| cell.starts_with(&format!("{harm_per_1000:.3} ± "))),
            "{name}: {harm_per_1000}: {section}"
        );
    }
}
