//! Failure rates and proofs: certificates, estimates, and the verdicts of `crumple check`.

use crumple_controllers::Controllers;
use crumple_evidence::rare::{RarePlan, SplittingConfig};
use crumple_evidence::{
    BlockSelection, BoxSpec, CERTIFICATE_FILE, CertificateReport, CountReport, CountsStatus,
    InvariantOptions, InvariantPlan, InvariantReport, InvariantSpec, PoolCheck, RateConfig,
    RatePlan, ReachPlan, ReachReport, RejectedPool, Rerun, ScenarioFollower, UncheckedCertificate,
    check_covers_scenario, initial_state_certificate, report_json, report_text, required_runs,
    shipped_kernels, unchecked_json,
};
use crumple_measure::Specification;
use crumple_sim::control::TwoSidedSettings;
use crumple_sim::engine::Run;
use crumple_verify::invariant::MotionModel;
use crumple_verify::{Certificate, WorkLimit, check_with};

use super::*;
use crate::forgery::change_statement;
use crate::forgery::rates::rate_claim;

/// Returns the count of a plan, as the program describes it in the folder `count`.
fn count(plan: &RatePlan) -> (CountReport, Result<Certificate, String>) {
    let counted = run_study(plan);
    let folder = PathBuf::from("count");
    let path = folder.join(CERTIFICATE_FILE);
    let report = CountReport::new(plan, &counted, folder, path);
    (
        report,
        counted
            .certificate
            .map_err(|rejection| rejection.to_string()),
    )
}

fn rate_config(controller: &str, space: &str, runs: u64, confidence: f64) -> RateConfig {
    RateConfig {
        confidence,
        ..RateConfig::new(find_controller(controller), find_space(space), runs)
    }
}

#[test]
fn a_count_of_stated_or_required_runs() {
    let folder = temp_folder();
    let plan = RatePlan::new(rate_config("idm", "paper", 70, 0.9)).unwrap();
    let (report, certificate) = count(&plan);
    certificate.unwrap();
    assert_same_study(
        folder.path(),
        0,
        "verify rate --controller idm --runs 70 --confidence 0.9 --out count",
        &LibraryResult::new(&report, report.to_text()),
    );
    let folder = temp_folder();
    let runs = required_runs(0.05, 0.9, 1).unwrap();
    let plan = RatePlan::new(rate_config("road", "paper", runs, 0.9)).unwrap();
    let (report, certificate) = count(&plan);
    certificate.unwrap();
    assert_same_study(
        folder.path(),
        0,
        "verify rate --controller road --rate-below 0.05 --failures 1 --confidence 0.9 --out count",
        &LibraryResult::new(&report, report.to_text()),
    );
}

/// The first controller fails more often, so the counts prove nothing.
#[test]
fn a_comparison_that_proves_nothing() {
    let folder = temp_folder();
    let plan = RatePlan::new(RateConfig {
        second_controller: Some(find_controller("road")),
        ..rate_config("baseline", "paper", 30, 0.9)
    })
    .unwrap();
    let (report, certificate) = count(&plan);
    assert!(certificate.is_err());
    assert_same_study(
        folder.path(),
        1,
        "verify rate --controller baseline --against road --runs 30 --confidence 0.9 --out count",
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn an_estimate_of_a_rare_failure() {
    let folder = temp_folder();
    let plan = RarePlan {
        controller: find_controller("predictive"),
        space: find_space("high-risk"),
        estimator: EstimatorKind::Kalman,
        specification: Specification::NoCollision,
        seed: 0,
        effort: SplittingConfig {
            samples: 50,
            repetition_count: 5,
        },
        resamples: 80,
    };
    let report = run_study(&plan);
    assert_same_study(
        folder.path(),
        0,
        "verify rate --controller predictive --space high-risk --rare --samples 50 --repetitions 5 --out rare",
        &LibraryResult::new(&report, report.to_text()),
    );
}

#[test]
fn an_invariant_set() {
    let folder = temp_folder();
    let controller = find_controller("idm");
    let spec = InvariantSpec {
        version: 1,
        scenario: "paper-1".to_owned(),
        motion: MotionModel::Absolute,
        leader_mps2: [-7.5, 3.0],
        observation_error: [1e-9; 3],
        region_gap_m: 100.0,
        ends_beyond_gap_m: None,
        region_own_mps: [0.0, 5.0],
        region_leader_mps: [0.0, 5.0],
        controller: None,
    };
    let plan =
        InvariantPlan::new(controller.source.clone(), &find_scenario("paper-1"), spec).unwrap();
    let options = InvariantOptions {
        cells: 20,
        splits: 1,
        smallest_gap_m: 0.0,
    };
    let set = plan.search(options, &Quiet).unwrap().expect("a set");
    let accepted = check_with(&set.certificate, plan.policy_bytes(), WorkLimit::UNLIMITED).unwrap();
    let defeat = plan.defeat(&set.table).unwrap();
    let report = InvariantReport::new("idm", &set, &accepted, defeat).unwrap();
    assert_same(
        folder.path(),
        "verify invariant --controller idm --speed 0..5 --leader-speed 0..5 --cells 20",
        &LibraryResult::new(&report, report.to_text()),
    );
}

/// Returns the text of a verified share without its times, which differ from run to run.
fn without_times(text: &str) -> String {
    let cut = |line: &str| match line.rsplit_once(", ") {
        Some((before, _)) if line.starts_with("depth") => format!("{before}\n"),
        _ => format!("{line}\n"),
    };
    text.lines().map(cut).collect()
}

/// Returns the JSON of a verified share without its times.
fn without_seconds(json: &str) -> Value {
    let mut object: Value = serde_json::from_str(json).unwrap();
    for share in object["shares"].as_array_mut().unwrap() {
        share.as_object_mut().unwrap().remove("seconds").unwrap();
    }
    object
}

#[test]
fn a_verified_share_of_a_box() {
    let folder = temp_folder();
    let path = corpus("boxes/paper-1.toml");
    let spec = BoxSpec::from_toml(&fs::read_to_string(&path).unwrap(), &path).unwrap();
    let plan = ReachPlan::new(find_controller("policy").source, &spec).unwrap();
    let partition = plan.partition(2, &Quiet).unwrap();
    let accepted = check_with(
        &partition.certificate,
        Some(plan.policy_bytes()),
        WorkLimit::UNLIMITED,
    )
    .unwrap();
    let report = ReachReport::new("policy", &path, &partition, &accepted);
    let command = format!(
        "verify reach --controller policy --box {} --depth 2",
        quote(&path)
    );
    let printed = run_ok(folder.path(), &command);
    assert_eq!(
        without_times(stdout(&printed)),
        without_times(&report.to_text())
    );
    let printed = run_ok(folder.path(), &format!("{command} --format json"));
    assert_eq!(
        without_seconds(stdout(&printed)),
        without_seconds(&json_line(&report))
    );
}

#[test]
fn certificates_of_kernels() {
    let folder = temp_folder();
    let kernels = shipped_kernels();
    let reports: Vec<_> = kernels
        .iter()
        .map(|(name, certificate)| {
            let path = format!("kernels/{name}.json");
            CertificateReport::new(path, certificate, Controllers::default())
        })
        .collect();
    let expected = LibraryResult {
        text: reports
            .iter()
            .map(|report| report.verdict_line(None))
            .collect(),
        json: report_json(&reports).unwrap(),
    };
    assert_same(folder.path(), "verify shield --out kernels", &expected);
}

#[test]
fn a_two_sided_certificate() {
    let folder = temp_folder();
    let settings = TwoSidedSettings::parse_for_certificate("level=3").unwrap();
    let options =
        RunOptions::new(find_controller("baseline").source).with_estimator(EstimatorKind::Truth);
    let run = Run::new(&find_scenario("paper-1"), options).unwrap();
    let certificate = initial_state_certificate(&run, 1, &settings).unwrap();
    let follower = ScenarioFollower::of_vehicle(&run, 1, &settings);
    let report = CertificateReport::new(
        "two-sided.json".to_owned(),
        &certificate,
        Controllers::default(),
    )
    .with_follower(follower);
    let expected = LibraryResult {
        text: report.verdict_line(None),
        json: report_json(&[report]).unwrap(),
    };
    assert_same(
        folder.path(),
        "verify two-sided paper-1 --settings level=3",
        &expected,
    );
}

/// Writes `good.json`, a count of `idm`, and `forged.json`, which claims a lower rate. Returns both.
fn write_certificates(folder: &Path) -> [Certificate; 2] {
    let plan = RatePlan::new(rate_config("idm", "paper", 70, 0.9)).unwrap();
    let good = count(&plan).1.unwrap();
    let forged = change_statement(&good, |statement| {
        rate_claim(statement).rate_at_most = 1e-9;
    });
    for (name, certificate) in [("good.json", &good), ("forged.json", &forged)] {
        fs::write(folder.join(name), json_line(certificate)).unwrap();
    }
    [good, forged]
}

fn checked<'a>(name: &str, certificate: &'a Certificate) -> CertificateReport<'a> {
    CertificateReport::check(
        name.to_owned(),
        certificate,
        None,
        WorkLimit::default(),
        Controllers::default(),
    )
    .unwrap()
}

/// One command checks an accepted, a rejected and an unreadable certificate.
#[test]
fn accepted_rejected_and_unread_certificates() {
    let folder = temp_folder();
    let [good, forged] = write_certificates(folder.path());
    fs::write(folder.path().join("cut.json"), "{").unwrap();
    let unread = format!("cut.json: {}", Certificate::from_json("{").unwrap_err());
    let mut accepted = checked("good.json", &good);
    accepted.counts = Some(CountsStatus::Unconfirmed);
    let reports = [accepted, checked("forged.json", &forged)];
    assert_eq!(
        reports.each_ref().map(|report| report.is_rejected()),
        [false, true]
    );
    let unchecked = [UncheckedCertificate::new("cut.json".to_owned(), unread)];
    let expected = LibraryResult {
        text: report_text(&reports, None),
        json: report_json(&reports).unwrap() + &unchecked_json(&unchecked).unwrap(),
    };
    assert_same_with_code(
        folder.path(),
        1,
        "check good.json cut.json forged.json",
        &expected,
    );
}

#[test]
fn a_certificate_about_another_scenario() {
    let folder = temp_folder();
    run_ok(folder.path(), "avoid paper-1 --certificate paper-1.json");
    let text = fs::read_to_string(folder.path().join("paper-1.json")).unwrap();
    let certificate = Certificate::from_json(&text).unwrap();
    for (name, code) in [("paper-1", 0), ("paper-2", 1)] {
        let mut report = checked("paper-1.json", &certificate);
        let covers = check_covers_scenario(&certificate, &find_scenario(name), None);
        report.covers_scenario = Some(covers.map_err(|elsewhere| elsewhere.to_string()));
        assert_eq!(i32::from(report.is_refused()), code);
        let reports = [report];
        let expected = LibraryResult {
            text: report_text(&reports, Some(name)),
            json: report_json(&reports).unwrap(),
        };
        let command = format!("check paper-1.json --scenario {name}");
        assert_same_with_code(folder.path(), code, &command, &expected);
    }
}

#[test]
fn repeated_counts() {
    let folder = temp_folder();
    let [good, _] = write_certificates(folder.path());
    let rerun = Rerun::new(&good, &[], Controllers::default()).unwrap();
    let cases = [
        ("--rerun", BlockSelection::All, None),
        (
            "--rerun=50 --rerun-seed 7",
            BlockSelection::Sample {
                percent: 50.0,
                seed: 7,
            },
            Some(7),
        ),
    ];
    for (options, selection, seed) in cases {
        let mut report = checked("good.json", &good);
        report.counts = Some(CountsStatus::Confirmed {
            confirmation: rerun.confirm(selection, &Quiet).unwrap(),
            seed,
        });
        let reports = [report];
        let expected = LibraryResult {
            text: report_text(&reports, None),
            json: report_json(&reports).unwrap(),
        };
        assert_same(
            folder.path(),
            &format!("check good.json {options}"),
            &expected,
        );
    }
}

/// Writes the certificate of a seed. Returns it with the name of its file.
fn write_certificate_of_seed(folder: &Path, seed: u64) -> (String, Certificate) {
    let plan = RatePlan::new(RateConfig {
        seed,
        ..rate_config("idm", "paper", 30, 0.9)
    })
    .unwrap();
    let certificate = count(&plan).1.unwrap();
    let name = format!("seed-{seed}.json");
    fs::write(folder.join(&name), json_line(&certificate)).unwrap();
    (name, certificate)
}

/// A pool of two seeds is accepted, and one of two equal certificates is rejected.
#[test]
fn accepted_and_rejected_pools() {
    let folder = temp_folder();
    let certificates = [0, 1].map(|seed| write_certificate_of_seed(folder.path(), seed));
    let new_pool = || PoolCheck::new(WorkLimit::default(), Controllers::default());
    let mut pool = new_pool();
    for (_, certificate) in &certificates {
        pool.add(certificate).unwrap();
    }
    let report = pool.conclude().unwrap();
    let expected = LibraryResult {
        text: report.to_text(),
        json: report.to_json().unwrap(),
    };
    assert_same(
        folder.path(),
        "check --pool seed-0.json seed-1.json",
        &expected,
    );
    let mut pool = new_pool();
    let (_, certificate) = &certificates[0];
    pool.add(certificate).unwrap();
    let rejection = match pool.add(certificate) {
        Err(error) => format!("seed-0.json: {error}"),
        Ok(()) => pool.conclude().unwrap_err().to_string(),
    };
    let rejected = RejectedPool {
        certificates: 2,
        rejection,
    };
    let expected = LibraryResult {
        text: rejected.to_text(),
        json: rejected.to_json().unwrap(),
    };
    let command = "check --pool seed-0.json seed-0.json";
    assert_same_with_code(folder.path(), 1, command, &expected);
}
