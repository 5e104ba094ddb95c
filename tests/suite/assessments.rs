//! Assessments do not claim more than their evidence supports, such as certificates of other subjects.

use crumple_sim::scenario::NoDriverFiles;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::command_line::{run_ok, temp_folder};
use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_evidence::{RateConfig, RatePlan};
use crumple_report::assessment::{
    AssessConfig, AssessmentGate, AssessmentPlan, AssessmentReport, CertificateStatus,
    CertificateSubject, ClaimStatus, EarlierAssessment, EvidenceCache, GateConfig, Strength,
    StrengthLevel, assess,
};
use crumple_search::falsify::counterexample::AvoidabilityClass;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::policy::Policy;
use crumple_spaces::{ScenarioSpace, built_in_space, file as space_file};
use crumple_verify::{Certificate, Statement};

/// Returns a small configuration, without everyday traffic: with it, an assessment also surveys the gains of each
/// controller, which takes longer than everything else.
pub(crate) fn config(controllers: &[&str]) -> AssessConfig {
    let mut config = AssessConfig::default();
    config.controllers = controllers.iter().map(|&name| name.to_owned()).collect();
    config.gates.clear();
    (config.distributions, config.search.spaces) =
        (Some(vec!["paper".to_owned()]), Some(Vec::new()));
    (
        config.paper,
        config.draws,
        config.rates.runs,
        config.everyday_draws,
    ) = (false, 40, 0, 0);
    config.certificates = Some(Vec::new());
    config
}

pub(crate) fn run(config: AssessConfig, folder: &Path) -> AssessmentReport {
    run_with_cache(config, folder, &EvidenceCache::disabled())
}

fn run_with_cache(config: AssessConfig, folder: &Path, cache: &EvidenceCache) -> AssessmentReport {
    let plan = AssessmentPlan::new(config, [], folder).expect("valid");
    assess(&plan, cache, None, &Quiet).expect("runs")
}

fn statuses(assessment: &AssessmentReport) -> Vec<&ClaimStatus> {
    assessment
        .summary
        .claims
        .iter()
        .flat_map(|row| &row.statuses)
        .collect()
}

fn rate_strength(assessment: &AssessmentReport, index: usize) -> &Strength {
    let row = assessment
        .summary
        .claims
        .iter()
        .find(|row| row.claim.contains("rate at most"))
        .expect("claimed");
    &row.statuses[index].strength
}

const RUNS: u64 = 1500;

fn count_certificate(
    controller: &str,
    against: Option<&str>,
    space: &ScenarioSpace,
    estimator: EstimatorKind,
    folder: &Path,
) -> Certificate {
    let find = |name: &str| Controllers::default().find(name, folder).expect("known");
    let config = RateConfig {
        second_controller: against.map(find),
        seed: 9,
        estimator,
        confidence: 0.999,
        ..RateConfig::new(find(controller), space.clone(), RUNS)
    };
    let plan = RatePlan::new(config).expect("valid");
    let mut tally = plan.empty_tally();
    while tally.runs < RUNS {
        plan.count_batch(&mut tally).expect("runs");
    }
    plan.certificate(&tally)
}

/// Certificates of another estimator, space, policy, release or order are valid but change no claim; the genuine one
/// does.
#[test]
fn foreign_certificates_change_no_claim() {
    let folder = tempfile::tempdir().expect("a folder");
    let own = folder.path().join("own.safetensors");
    fs::write(&own, Policy::retrained_bytes()).expect("writes");
    let paper = built_in_space("paper").expect("built in");
    let text = space_file::to_toml(&paper)
        .expect("written")
        .replace("mean = 36.0", "mean = 37.0");
    let gentle =
        space_file::from_toml(&text, Path::new("gentle.toml"), &NoDriverFiles).expect("valid");
    assert_eq!(gentle.name(), paper.name(), "equal names");
    let there = folder.path().join("elsewhere");
    fs::create_dir(&there).expect("made");
    fs::write(there.join("own.safetensors"), Policy::reference_bytes()).expect("writes");
    let (truth, kalman) = (EstimatorKind::Truth, EstimatorKind::Kalman);
    let genuine =
        |controller: &str| count_certificate(controller, None, &paper, kalman, folder.path());
    let own_certificate = genuine("own.safetensors");
    let changed = |mut certificate: Certificate, entry: &str, value: &str| {
        let Statement::Rate(rate) = &mut certificate.statement else {
            panic!("a rate")
        };
        rate.registration
            .configuration
            .insert(entry.to_owned(), value.to_owned());
        rate.registration_sha256 = rate.registration.digest();
        certificate
    };
    let hostile = [
        count_certificate("own.safetensors", None, &paper, truth, folder.path()),
        count_certificate("own.safetensors", None, &gentle, kalman, folder.path()),
        count_certificate("own.safetensors", None, &paper, kalman, &there),
        count_certificate(
            "shield:own.safetensors",
            None,
            &paper,
            kalman,
            folder.path(),
        ),
        count_certificate(
            "baseline",
            Some("own.safetensors"),
            &gentle,
            kalman,
            folder.path(),
        ),
        count_certificate(
            "own.safetensors",
            Some("baseline-unlatched"),
            &paper,
            kalman,
            folder.path(),
        ),
        changed(own_certificate.clone(), "crumple", "0.0.9"),
        changed(genuine("idm"), "controller", "own.safetensors"),
    ];
    let controllers = ["baseline", "own.safetensors"];
    let mut without = config(&controllers);
    without.everyday_draws = 4;
    // Assessments with other certificates share all other evidence.
    let cache = EvidenceCache::open(&folder.path().join("cache"), "tests", false).expect("a cache");
    let bare = run_with_cache(without.clone(), folder.path(), &cache);
    let assess_with = |certificate: &Certificate| {
        let path = folder.path().join("given.json");
        fs::write(&path, serde_json::to_string(certificate).expect("JSON")).expect("writes");
        let mut with = without.clone();
        with.certificates = Some(vec![path]);
        run_with_cache(with, folder.path(), &cache)
    };
    for (place, certificate) in hostile.iter().enumerate() {
        let with = assess_with(certificate);
        let strengths = |of: &AssessmentReport| {
            statuses(of)
                .into_iter()
                .map(|claim| claim.strength.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(strengths(&with), strengths(&bare), "certificate {place}");
        let proof = with
            .results
            .proofs
            .certificates
            .iter()
            .find(|proof| proof.name == "given")
            .expect("listed");
        let is_foreign = matches!(&proof.subject, CertificateSubject::Unrelated { reason } if !reason.is_empty());
        assert!(is_foreign || place == 0, "{place}: {:?}", proof.subject);
    }
    let with = assess_with(&own_certificate);
    assert!(
        matches!(rate_strength(&bare, 1), Strength::Undecided { .. }),
        "{:?}",
        rate_strength(&bare, 1)
    );
    assert!(
        matches!(rate_strength(&with, 1), Strength::Bounded { .. }),
        "{:?}",
        rate_strength(&with, 1)
    );
}

/// A file called like a shield is no shield, a shield for other limits has other kernels, and a copy of a policy is
/// that policy.
#[test]
fn names_prove_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let copy = "shield-candidate.safetensors";
    fs::write(folder.path().join(copy), Policy::reference_bytes()).expect("writes");
    let all = [
        "baseline",
        copy,
        "policy",
        "shield:policy",
        "shield,ahead=0.1:full-throttle",
        "shield,gap-error=0:policy",
    ];
    let mut asked = config(&all);
    asked.certificates = None;
    let assessment = run(asked, folder.path());
    let rows: Vec<_> = assessment
        .summary
        .claims
        .iter()
        .filter(|row| row.claim.contains("kernel"))
        .collect();
    let proved = |strength: &Strength| matches!(strength, Strength::Proved { .. });
    let is_proved = |place: usize| rows.iter().any(|row| proved(&row.statuses[place].strength));
    assert_eq!(
        [0, 1, 2, 3, 4, 5].map(is_proved),
        [false, false, false, true, false, false]
    );
    let is_claimed = |place: usize| {
        rows.iter()
            .filter(|row| row.claims[place].is_some())
            .count()
    };
    assert_eq!([0, 1, 2, 3, 4, 5].map(is_claimed), [0, 0, 0, 1, 1, 1]);
    let words = &rows[1].claim;
    assert!(
        words.contains(
            "harder than 0.1 m/s², while the estimation error of the controller stays within the bounds of the shield"
        ),
        "{words}"
    );
    for row in assessment
        .summary
        .claims
        .iter()
        .filter(|row| row.claim.contains("the box of initial states"))
    {
        assert_eq!(row.statuses[1], row.statuses[2], "the copy is that policy");
        assert!(
            matches!(row.statuses[3].strength, Strength::Untried),
            "before a shield it is another controller"
        );
    }
    assert!(
        assessment
            .results
            .proofs
            .certificates
            .iter()
            .all(|proof| matches!(proof.status, CertificateStatus::Accepted { .. }))
    );
    assert!(
        !assessment.to_markdown().to_lowercase().contains("paper-3"),
        "the configuration has no paper scenarios"
    );
}

#[test]
fn every_command_of_a_report_runs_in_its_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let policy = "x;touch PWNED;# 'y'.safetensors";
    fs::write(folder.path().join(policy), Policy::reference_bytes()).expect("writes");
    let space =
        space_file::to_toml(&built_in_space("high-risk").expect("built in")).expect("written");
    fs::write(
        folder.path().join("own space.toml"),
        space.replacen("high-risk", "own", 1),
    )
    .expect("writes");
    fs::create_dir(folder.path().join("episodes")).expect("made");
    let episode = crumple_sim::scenario::built_in_scenario("paper-2")
        .expect("built in")
        .edited(|spec| spec.name = "an episode".to_owned());
    let episode = crumple_sim::scenario::file::to_toml(&episode.expect("valid")).expect("written");
    fs::write(folder.path().join("episodes/e.toml"), episode).expect("writes");
    let mut asked = config(&["baseline", policy, &format!("shield,ahead=8:{policy}")]);
    asked.search.spaces = Some(vec!["own space.toml".to_owned()]);
    (
        asked.search.budget,
        asked.draws,
        asked.scenarios,
        asked.certificates,
    ) = (5, 5, vec!["episodes".into()], None);
    let assessment = run(asked, folder.path());
    let report = folder.path().join("the report");
    let files = assessment.files().expect("renders");
    for (name, contents) in &files {
        let path = report.join(name);
        fs::create_dir_all(path.parent().expect("below")).expect("made");
        fs::write(path, contents).expect("writes");
    }
    let program = Path::new(env!("CARGO_BIN_EXE_crumple"));
    let path = format!(
        "{}:{}",
        program.parent().expect("a folder").display(),
        std::env::var("PATH").unwrap_or_default()
    );
    let shell = |command: &str| {
        let ran = Command::new("sh")
            .arg("-c")
            .arg(command)
            .current_dir(&report)
            .env("PATH", &path)
            .output();
        let ran = ran.expect("a shell");
        assert!(
            ran.status.success(),
            "{command}: {}",
            String::from_utf8_lossy(&ran.stderr)
        );
    };
    let page = assessment.to_html();
    let codes = page
        .split("<code>crumple ")
        .skip(1)
        .filter_map(|rest| rest.split("</code>").next());
    let plain = |code: &str| {
        code.replace("&quot;", "\"")
            .replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&amp;", "&")
    };
    let mut commands: Vec<String> = codes
        .map(|code| format!("crumple {}", plain(code)))
        .collect();
    commands.sort();
    commands.dedup();
    for wanted in [
        "crumple simulate scenarios/",
        "crumple simulate counterexamples/",
        "crumple falsify",
        "crumple check",
    ] {
        assert!(
            commands.iter().any(|command| command.starts_with(wanted)),
            "{wanted}: {commands:#?}"
        );
    }
    // The escape of an avoidable failure is a file of the report.
    let own: Vec<&String> = files.iter().map(|(name, _)| name).collect();
    let paths: Vec<_> = assessment
        .results
        .searches
        .spaces
        .iter()
        .flat_map(|space| &space.controllers)
        .collect();
    let failures: Vec<_> = paths.iter().flat_map(|search| &search.failures).collect();
    assert!(
        failures
            .iter()
            .any(|failure| failure.class == AvoidabilityClass::Avoidable),
        "{failures:?}"
    );
    for failure in &failures {
        let beside = failure.file.replace(".toml", "-escape.toml");
        let is_avoidable = failure.class == AvoidabilityClass::Avoidable;
        assert_eq!(
            failure.escape.as_ref().map(|escape| escape.file.clone()),
            is_avoidable.then(|| beside.clone())
        );
        assert_eq!(
            (report.join(&beside).exists(), own.contains(&&beside)),
            (is_avoidable, is_avoidable),
            "{beside}"
        );
    }
    commands.iter().for_each(|command| shell(command));
    let script = fs::read_to_string(report.join("replay.sh")).expect("written");
    assert!(script.contains("-escape.toml --expect safe"), "{script}");
    shell("sh replay.sh");
    // A replaced failure file is still a failure, and the listing detects the change.
    shell("crumple fsck .");
    let counterexample = |(name, _): &&(String, Vec<u8>)| {
        name.starts_with("counterexamples/") && name.ends_with(".toml")
    };
    let (name, contents) = files
        .iter()
        .find(counterexample)
        .expect("it fails somewhere");
    fs::write(
        report.join(name),
        [contents, b"# edited\n".as_slice()].concat(),
    )
    .expect("writes");
    let looked = Command::new(program)
        .args(["fsck", "."])
        .current_dir(&report)
        .output()
        .expect("runs");
    let message = String::from_utf8_lossy(&looked.stdout);
    assert!(
        looked.status.code() == Some(1) && message.contains(name.as_str()),
        "{message}"
    );
    assert!(!report.join("PWNED").exists() && !folder.path().join("PWNED").exists());
}

/// A process that keeps its speed.
const KEEPS_SPEED: &str = r#"#!/bin/sh
while read -r line; do
    id=${line#'{"id":'}
    id=${id%%,*}
    case $line in
        *hello*) printf '%s\n' '{"crumple":1,"name":"keeps speed","deterministic":true}' ;;
        *reset*) printf '%s\n' "{\"id\":$id,\"ready\":true}" ;;
        *) printf '%s\n' "{\"id\":$id,\"acceleration_mps2\":0}" ;;
    esac
done
"#;

/// Returns a space in which a vehicle follows a leader at 20 m/s less `closing_mps`, with a gap of 36 to 40 m.
pub(crate) fn approach_space(name: &str, closing_mps: f64) -> String {
    let leader_mps = 20.0 - closing_mps;
    format!(
        "version = 1\nname = \"{name}\"\nabout = \"An approach.\"\n[base]\nversion = 1\nname = \"{name}\"\nabout = \
         \"An approach.\"\nduration_s = 2.5\n[[base.vehicles]]\nclass = \"light\"\nposition_m = 40.0\nspeed_mps = \
         {leader_mps:?}\ndriver{STILL}\n[[base.vehicles]]\nclass = \"light\"\nposition_m = 0.0\nspeed_mps = \
         20.0\ndriver = \"under-test\"\n[[parameters]]\nname = \"gap_m\"\nfield = \"vehicles[1].gap_m\"\nunit = \
         \"m\"\ndistribution.uniform = {{ low = 36.0, high = 40.0 }}\n"
    )
}

/// Returns the text of each command in the Markdown of a report that begins like this.
fn commands_in<'a>(markdown: &'a str, begin: &str) -> Vec<&'a str> {
    markdown
        .split('`')
        .filter(|code| code.starts_with(begin))
        .collect()
}

/// The printed checks, and each command of `replay.sh`, end as the report states, for every kind of controller. A
/// comparison that is not shown, and counts of another release, are no obstacle.
#[test]
fn a_fresh_report_passes_its_own_checks() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, contents: &[u8]| {
        fs::write(folder.path().join(name), contents).expect("writes")
    };
    write("keeps speed.sh", KEEPS_SPEED.as_bytes());
    write(
        "keeps.toml",
        b"version = 1\ncommand = [\"sh\", \"keeps speed.sh\"]\nfiles = [\"keeps speed.sh\"]\n",
    );
    write("own.safetensors", Policy::retrained_bytes());
    let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/controllers/ppo.zip");
    fs::copy(network, folder.path().join("ppo.zip")).expect("copied");
    write("barrier.toml", approach_space("barrier", 20.0).as_bytes());
    write("calm.toml", approach_space("calm", 0.0).as_bytes());
    let paper = built_in_space("paper").expect("built in");
    let mut older = count_certificate("idm", None, &paper, EstimatorKind::Kalman, folder.path());
    let Statement::Rate(rate) = &mut older.statement else {
        panic!("a rate")
    };
    rate.registration
        .configuration
        .insert("crumple".to_owned(), "0.0.9".to_owned());
    rate.registration_sha256 = rate.registration.digest();
    write(
        "older.json",
        serde_json::to_string(&older).expect("JSON").as_bytes(),
    );
    write(
        "tuned.toml",
        b"version = 1\nbuilt_in = \"acc-aeb\"\n[settings]\nttc_s = 2.0\n",
    );
    // Without a C compiler there is no FMU.
    #[cfg(unix)]
    let fmu = crate::fmus::example_fmu_folder();
    #[cfg(not(unix))]
    let fmu: Option<tempfile::TempDir> = None;
    if let Some(fmu) = &fmu {
        let copied = fs::copy(
            fmu.path().join("follower.fmu"),
            folder.path().join("follower.fmu"),
        );
        copied.expect("copied");
    }
    let more = fmu.map_or("", |_| ", \"follower.fmu\"");
    let config = "version = 1\npaper = false\ncontrollers = [\"keeps.toml\", \"own.safetensors\", \"ppo.zip\", \
                  \"shield:own.safetensors\", \"idm\", \"tuned.toml\"MORE]\nsubject = \
                  \"own.safetensors\"\ndistributions = \
                  [\"barrier.toml\", \"calm.toml\"]\ndraws = 5\neveryday_draws = 0\nrates = { runs = 40, confidence = \
                  0.99 }\nsearch = { spaces = [\"barrier.toml\"], budget = 5 }\ncertificates = \
                  [\"older.json\"]\n[[gates]]\nrequire = \"rate-not-above\"\ncontroller = \
                  \"own.safetensors\"\nthan = \"keeps.toml\"\nspace = \"calm.toml\"\nrequirement = \
                  [\"REQ-1\", \"REQ-2\"]\n[[gates]]\nrequire = \
                  \"rate-not-above\"\ncontroller = \"own.safetensors\"\nthan = \"keeps.toml\"\nspace = \
                  \"barrier.toml\"\nrequirement = [\"REQ-2\"]\n";
    write("a.toml", config.replace("MORE", more).as_bytes());
    let program = Path::new(env!("CARGO_BIN_EXE_crumple"));
    let path = format!(
        "{}:{}",
        program.parent().expect("a folder").display(),
        std::env::var("PATH").unwrap_or_default()
    );
    let shell = |command: &str, at: &Path| {
        let ran = Command::new("sh")
            .arg("-c")
            .arg(command)
            .current_dir(at)
            .env("PATH", &path)
            .output();
        let ran = ran.expect("a shell");
        let [out, error] =
            [&ran.stdout, &ran.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
        assert!(ran.status.success(), "{command}: {out}{error}");
        out
    };
    shell("crumple assess a.toml --out report", folder.path());
    let report = folder.path().join("report");
    // The report does not depend on the files that were assessed.
    let elsewhere = tempfile::tempdir().expect("a folder");
    let moved = elsewhere.path().join("report");
    fs::rename(&report, &moved).expect("moved");
    drop(folder);
    let evidence: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(moved.join("assessment.json")).expect("written"))
            .expect("JSON");
    let certificate = |name: &str| {
        let all = evidence["proofs"]["certificates"]
            .as_array()
            .expect("a list");
        all.iter()
            .find(|proof| proof["name"] == name)
            .unwrap_or_else(|| panic!("{name}: {all:#?}"))
            .clone()
    };
    let shown = certificate("own-safetensors-against-keeps-toml-barrier");
    assert_eq!(shown["status"]["kind"], "accepted", "{shown}");
    let calm = certificate("own-safetensors-against-keeps-toml-calm");
    assert_eq!(
        (&calm["status"]["kind"], &calm["file"]),
        (&"nothing_shown".into(), &serde_json::Value::Null)
    );
    assert!(
        !moved
            .join("certificates/own-safetensors-against-keeps-toml-calm.json")
            .exists()
    );

    let markdown = fs::read_to_string(moved.join("assessment.md")).expect("written");
    let checks = commands_in(&markdown, "crumple check");
    // A later part explains the option `--rerun`.
    let [check, recount, ..] = checks[..] else {
        panic!("{checks:?}")
    };
    assert_eq!(check, "crumple check certificates/*.json");
    shell(check, &moved);
    let all = evidence["proofs"]["certificates"]
        .as_array()
        .expect("a list");
    let is_counted = |proof: &&serde_json::Value| {
        ["rate", "comparison"]
            .map(Into::into)
            .contains(&proof["statement"])
    };
    // Another release counted `older`. A count without a bound has a file, too.
    let is_written =
        |proof: &&serde_json::Value| proof["file"].is_string() && proof["name"] != "older";
    let counted = all.iter().filter(is_counted).filter(is_written).count();
    assert_eq!(
        shell(recount, &moved)
            .matches("confirmed: all 40 runs")
            .count(),
        counted,
        "{recount}"
    );
    assert!(
        !recount.contains("older.json") && recount.contains("keeps.toml"),
        "{recount}"
    );
    let script = fs::read_to_string(moved.join("replay.sh")).expect("written");
    let lines: Vec<&str> = script
        .lines()
        .filter_map(|line| line.strip_prefix("run "))
        .collect();
    assert!(
        lines
            .iter()
            .any(|line| line.contains("/keeps.toml --expect collision")),
        "{script}"
    );
    lines
        .iter()
        .for_each(|line| drop(shell(&format!("crumple {line}"), &moved)));
    shell("sh replay.sh", &moved);
    check_identity(&moved, &evidence, &shell(check, &moved));
    check_gates(&moved, &evidence);

    // The configuration in the folder repeats the report.
    let repeat = commands_in(&markdown, "crumple assess assessment.toml");
    let command = repeat.first().expect("the report says how to repeat it");
    let compared = shell(&format!("{command} --against assessment.json"), &moved);
    // The checker rejects `older`, so that the folder lacks it.
    assert!(
        compared.contains(
            "Compared with the earlier assessment: 0 better, 0 worse, 0 new, 1 gone, 0 changed without being better or \
             worse, "
        ) && !compared.contains(", 0 unchanged"),
        "{compared}"
    );
    let repeated = fs::read_to_string(elsewhere.path().join("repeated/assessment.json"));
    let repeated: serde_json::Value =
        serde_json::from_str(&repeated.expect("written")).expect("JSON");
    let words = |evidence: &serde_json::Value| -> Vec<String> {
        let rows = evidence["summary"]["claims"].as_array().expect("claims");
        rows.iter()
            .flat_map(|row| row["statuses"].as_array().expect("statuses"))
            .map(|status| status["strength"].to_string())
            .collect()
    };
    assert_eq!(words(&repeated), words(&evidence));
    // A controller has the same name in both, whatever its file is called in the folder.
    for field in [
        "/summary/controllers",
        "/identity/subject",
        "/provenance/config_sha256",
    ] {
        assert_eq!(repeated.pointer(field), evidence.pointer(field), "{field}");
    }
    let configurations = [moved, elsewhere.path().join("repeated")].map(|folder| {
        let text = fs::read_to_string(folder.join("assessment.toml")).expect("written");
        text.replace(
            "# It also needs: the certificate `older`, which the checker rejected\n",
            "",
        )
    });
    assert_eq!(configurations[0], configurations[1]);
}

/// A program without listed files is not copied into the report, which says what to copy. With it, the configuration in
/// the folder repeats the report, also if the program lay in another folder.
#[test]
fn a_report_about_a_program_is_repeated_after_a_copy() {
    let folder = temp_folder();
    let [programs, report] = ["programs", "report"].map(|name| folder.path().join(name));
    fs::create_dir(&programs).expect("writable");
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/controllers");
    fs::copy(examples.join("follower.py"), programs.join("follower.py")).expect("copied");
    let text = fs::read_to_string(examples.join("follower.toml")).expect("readable");
    let without_files: String = text
        .split_inclusive('\n')
        .filter(|line| !line.starts_with("files"))
        .collect();
    fs::write(programs.join("own.toml"), without_files).expect("written");
    let config = "version = 1\ncontrollers = [\"idm\", \"programs/own.toml\"]\npaper = false\n\
                  distributions = [\"traffic\"]\ndraws = 2\neveryday_draws = 0\ncertificates = []\n\
                  rates = { runs = 10, confidence = 0.99 }\nsearch = { spaces = [], budget = 1 }\n\
                  [[gates]]\nrequire = \"rate-not-above\"\ncontroller = \"programs/own.toml\"\n\
                  than = \"idm\"\nspace = \"traffic\"\n";
    fs::write(folder.path().join("a.toml"), config).expect("written");
    run_ok(folder.path(), "assess a.toml --out report");
    let markdown = fs::read_to_string(report.join("assessment.md")).expect("written");
    assert!(
        markdown.contains("first copy into this folder, each with its files: `programs/own.toml`"),
        "{markdown}"
    );
    for name in ["own.toml", "follower.py"] {
        fs::copy(programs.join(name), report.join(name)).expect("copied");
    }
    let repeat = commands_in(&markdown, "crumple assess assessment.toml");
    let command = repeat.first().expect("the report says how to repeat it");
    run_ok(&report, command.trim_start_matches("crumple "));
    let repeated = fs::read_to_string(folder.path().join("repeated/assessment.md"));
    let claims = |markdown: &str| {
        let (_, rest) = markdown.split_once("| claim |").expect("a table");
        rest.split_once("\n\n")
            .expect("its end")
            .0
            .replace("programs/", "")
    };
    assert_eq!(claims(&repeated.expect("written")), claims(&markdown));
}

/// Each form of a report states its identity, each certificate has one hash, and captions have no empty part.
fn check_identity(report: &Path, evidence: &serde_json::Value, checked: &str) {
    let text = |name: &str| fs::read_to_string(report.join(name)).expect("written");
    let identity = &evidence["identity"];
    let hash = identity["subject_sha256"].as_str().expect("a hash");
    let configuration = identity["configuration_sha256"].as_str().expect("a hash");
    assert_eq!(
        crumple_core::digest::sha256(text("assessment.toml")),
        configuration
    );
    let date = evidence["provenance"]["run_info"]["at"]
        .as_str()
        .expect("a date");
    let version = concat!("crumple ", env!("CARGO_PKG_VERSION"));
    for form in [
        "assessment.html",
        "assessment.md",
        "assessment.junit.xml",
        "assessment.gsn.yaml",
    ] {
        let text = text(form);
        for part in ["own.safetensors", hash, configuration, date] {
            assert!(text.contains(part), "{form} lacks {part}");
        }
        // Lines of Markdown are wrapped.
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let version_is_there = [" ", ": ", ": `"]
            .iter()
            .any(|between| words.contains(&version.replace(' ', between)));
        assert!(version_is_there || form == "assessment.junit.xml", "{form}");
    }
    let html = text("assessment.html");
    let title = format!(
        "<title>Assessment of own.safetensors (SHA-256 {}), {}, {version}",
        &hash[..12],
        &date[..10]
    );
    assert!(html.contains(&title), "{title}");
    assert!(
        !html.contains(" · </figcaption>"),
        "an empty part of a caption"
    );
    let certificates = evidence["proofs"]["certificates"]
        .as_array()
        .expect("a list");
    for proof in certificates.iter().filter(|proof| !proof["file"].is_null()) {
        let hash = proof["sha256"].as_str().expect("a hash");
        assert!(
            checked.contains(hash) && html.contains(hash) && text("assessment.md").contains(hash),
            "{proof}"
        );
    }
}

/// The indicator of a comparison has an interval, and the claim about the runs that decide it: those counted, not the
/// random scenarios of the report.
fn check_indicators(gates: &[serde_json::Value]) {
    for gate in gates {
        let indicator = &gate["indicator"];
        let claim = indicator["claim"].as_str().expect("a claim");
        assert!(
            claim
                .starts_with("own.safetensors: fewer failures than keeps.toml in the distribution"),
            "{claim}"
        );
        let number = |field: &str| indicator.pointer(field).and_then(serde_json::Value::as_f64);
        let [value, lower, upper] = ["/value", "/interval/lower", "/interval/upper"]
            .map(|field| number(field).expect(field));
        assert!(lower <= value && value <= upper, "{indicator}");
        assert_eq!(number("/interval/confidence_percent"), Some(99.0));
        assert_eq!(
            (number("/threshold"), indicator["unit"].as_str()),
            (Some(0.0), Some("%"))
        );
    }
}

/// The folder has each certificate that the checker accepts, also those of counts in which every run failed. Gates use
/// counted runs, and requirements are in JUnit.
fn check_gates(report: &Path, evidence: &serde_json::Value) {
    let gates = evidence["summary"]["gates"].as_array().expect("gates");
    let files = fs::read_dir(report.join("certificates")).expect("a folder");
    let files = files
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "json"))
        .count();
    let certificates = evidence["proofs"]["certificates"]
        .as_array()
        .expect("a list");
    let is_written = |proof: &&serde_json::Value| match proof["status"]["kind"].as_str() {
        Some("accepted") => true,
        Some("nothing_shown") => proof["statement"] == "rate",
        _ => false,
    };
    assert_eq!(files, certificates.iter().filter(is_written).count());
    check_indicators(gates);
    let counted = gates[1]["reason"].as_str().expect("a reason");
    assert!(
        counted.contains(" of the same 40 counted runs, "),
        "{counted}"
    );
    let junit = fs::read_to_string(report.join("assessment.junit.xml")).expect("written");
    for property in [
        r#"<property name="FullyVerifies" value="REQ-1"/>"#,
        r#"<property name="PartiallyVerifies" value="REQ-2"/>"#,
    ] {
        assert!(junit.contains(property), "{junit}");
    }
}

/// A custom space may have another name in the configuration than in its file.
#[test]
fn gates_find_the_draws_of_own_spaces() {
    let folder = tempfile::tempdir().expect("a folder");
    let paper = built_in_space("paper").expect("built in");
    let text = space_file::to_toml(&paper)
        .expect("written")
        .replace("mean = 36.0", "mean = 37.0");
    let text = text.replacen("name = \"paper\"", "name = \"mine\"", 1);
    let text = text.replacen(
        "The distribution the paper trains on:",
        "Drives of 0.099 h:",
        1,
    );
    fs::write(folder.path().join("of mine.toml"), text).expect("writes");
    let space = || Some("of mine.toml".to_owned());
    let rate = |controller: &str, percent| {
        GateConfig::from(AssessmentGate::RateAtMost {
            controller: controller.into(),
            percent,
            space: space(),
        })
    };
    let fewer = |controller: &str, than: &str| {
        GateConfig::from(AssessmentGate::RateNotAbove {
            controller: controller.into(),
            than: than.into(),
            space: space(),
        })
    };
    let mut asked = config(&["match-leader", "full-throttle"]);
    asked.everyday_draws = 4;
    asked.distributions = Some(vec!["of mine.toml".to_owned()]);
    asked.gates = vec![
        rate("full-throttle", 100.0),
        rate("full-throttle", 1.0),
        fewer("match-leader", "full-throttle"),
        fewer("full-throttle", "match-leader"),
    ];
    let assessment = run(asked, folder.path());
    let holds: Vec<_> = assessment
        .summary
        .gates
        .iter()
        .map(|gate| gate.holds)
        .collect();
    assert_eq!(holds, [true, false, true, false]);
    // A space has one name in gates and claims, and each gate names its claim.
    for gate in &assessment.summary.gates {
        assert!(gate.gate.contains("`mine`"), "{}", gate.gate);
        // There is no claim that the first controller fails less often than another one.
        match &gate.indicator.claim {
            Some(claim) => assert!(claim.contains("`mine`"), "{claim}"),
            None => assert!(gate.gate.starts_with("match-leader: no more"), "{gate:#?}"),
        }
        let value = gate.indicator.value.expect("a value");
        assert_eq!(gate.holds, value <= gate.indicator.threshold, "{gate:#?}");
    }
    let explanation = |name: &str| {
        assessment
            .summary
            .named
            .iter()
            .find(|named| named.name == name)
            .map(|named| named.explanation.as_str())
    };
    assert_eq!(explanation("space `mine`"), Some("Drives of 0.099 h"));
    // Built-in spaces have their one-line descriptions, the others their own texts.
    let traffic = "everyday driving without hard braking; idm or acc-aeb drives the follower";
    assert_eq!(explanation("space `traffic`"), Some(traffic));
    let about = |name: &str| {
        let spaces = &assessment.space_descriptions.spaces;
        spaces
            .iter()
            .find(|space| space.name == name)
            .map(|space| space.about.as_str())
    };
    assert_eq!(
        about("traffic"),
        Some(format!("E{}.", &traffic[1..]).as_str())
    );
    assert!(
        about("mine")
            .is_some_and(|about| about.starts_with("Drives of 0.099 h: scenarios 1 and 2"))
    );
}

/// A gate on a space counts its random scenarios, including everyday traffic; a gate on scenario files does not.
#[test]
fn gates_on_spaces_look_at_random_scenarios() {
    let mut asked = config(&["idm", "full-throttle"]);
    asked.everyday_draws = 20;
    asked.scenarios = vec!["recorded.toml".into()];
    let in_space = |controller: &str, space: &str| {
        GateConfig::from(AssessmentGate::NoCollisionInSpace {
            controller: controller.to_owned(),
            space: space.to_owned(),
        })
    };
    asked.gates = vec![
        AssessmentGate::NoCollisionInScenarioFiles {
            controller: "full-throttle".to_owned(),
        }
        .into(),
        in_space("full-throttle", "traffic"),
        in_space("full-throttle", "high-risk"),
        in_space("full-throttle", "paper"),
        in_space("idm", "traffic"),
    ];
    let folder = tempfile::tempdir().expect("a folder");
    // No vehicle ahead is within reach, so full throttle avoids a collision.
    let far = "version = 1\nname = \"far\"\nduration_s = 1.0\n[[vehicles]]\nclass = \"light\"\nposition_m = \
        900.0\nspeed_mps = 20.0\n\
               [vehicles.driver]\nconstant-speed = {}\n[[vehicles]]\nclass = \"light\"\nposition_m = 0.0\nspeed_mps = \
               20.0\n\
               driver = \"under-test\"\n";
    fs::write(folder.path().join("recorded.toml"), far).expect("writes");
    let assessment = run(asked.clone(), folder.path());
    let gates = &assessment.summary.gates;
    let holds: Vec<_> = gates.iter().map(|gate| gate.holds).collect();
    assert_eq!(holds, [true, false, false, false, true], "{gates:#?}");
    assert!(
        gates[1].reason.ends_with("of 20 random scenarios collide"),
        "{}",
        gates[1].reason
    );
    assert!(
        gates[3].reason.ends_with("of 40 random scenarios collide"),
        "{}",
        gates[3].reason
    );

    // The gates end the first page on a terminal, and are in both forms of the report.
    assert!(
        assessment
            .summary
            .gates_to_plain_text()
            .ends_with("2 of 5 gates hold.\n"),
        "{}",
        assessment.summary.gates_to_plain_text()
    );
    for page in [assessment.first_page_to_html(), assessment.to_markdown()] {
        let [gates, space] = ["2 of 5 gates hold.", "no collision in random scenarios of"]
            .map(|text| page.find(text));
        assert!(gates.is_some() && space > gates, "{page}");
    }
    let claims = assessment.to_markdown().find("## Claims").expect("a part");
    assert!(
        assessment.to_markdown().find("2 of 5 gates hold.") < Some(claims),
        "on the first page"
    );

    for (space, message) in [
        ("standing", "gates[0].space: `standing` is neither among"),
        ("traffic", "needs `everyday_draws`"),
    ] {
        (asked.everyday_draws, asked.gates) = (0, vec![in_space("idm", space)]);
        let refused = AssessmentPlan::new(asked.clone(), [], folder.path())
            .expect_err("refused")
            .to_string();
        assert!(refused.contains(message), "{refused}");
    }
}

/// A space in which the third vehicle brakes and the fourth hits it, with `drivers` from front to rear.
fn third_party_crash_space(drivers: [&str; 4]) -> String {
    let vehicle = |(place_m, speed_mps, driver): (f64, f64, &str)| {
        format!(
            "[[base.vehicles]]\nclass = \"light\"\nposition_m = {place_m}\nspeed_mps = {speed_mps}\ndriver{driver}\n"
        )
    };
    let places = [(210.0, 0.0), (120.0, 20.0), (40.0, 20.0), (30.0, 25.0)];
    let vehicles: String = places
        .iter()
        .zip(drivers)
        .map(|(&(place_m, speed_mps), driver)| vehicle((place_m, speed_mps, driver)))
        .collect();
    format!(
        "version = 1\nname = \"others\"\nabout = \"Others crash at once.\"\n[base]\nversion = 1\nname \
         = \"others\"\nabout = \"x\"\n\
         duration_s = 20.0\n{vehicles}[[parameters]]\nname = \"friction\"\nfield = \"environment.friction\"\nunit \
         = \"1\"\n\
         distribution.uniform = {{ low = 0.9, high = 1.0 }}\n"
    )
}

const STILL: &str = ".pieces = { from_s = [1.0], accel_mps2 = [0.0] }";
const BRAKES: &str = ".pieces = { from_s = [0.1], accel_mps2 = [-7.0] }";

/// Collisions among other vehicles support no claim about a controller (draws, search, count, gate); the report
/// mentions them.
#[test]
fn runs_that_others_end_say_nothing_of_a_controller() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(
        folder.path().join("others.toml"),
        third_party_crash_space([STILL, " = \"under-test\"", BRAKES, STILL]),
    )
    .expect("writes");
    fs::write(
        folder.path().join("own.safetensors"),
        Policy::retrained_bytes(),
    )
    .expect("writes");
    let mut asked = config(&["full-throttle", "idm", "own.safetensors"]);
    // The policy's certificate also consists only of runs that end with collisions of others.
    asked.rates.runs = 200;
    asked.distributions = Some(vec!["others.toml".to_owned()]);
    asked.search.spaces = Some(vec!["others.toml".to_owned()]);
    (asked.search.budget, asked.everyday_draws) = (20, 0);
    let (controller, than) = ("idm".to_owned(), "full-throttle".to_owned());
    asked.gates = vec![
        AssessmentGate::RateNotAbove {
            controller,
            than,
            space: None,
        }
        .into(),
    ];
    let assessment = run(asked, folder.path());
    let message = |row: &str| -> Vec<&Strength> {
        let rows = assessment
            .summary
            .claims
            .iter()
            .filter(|shown| shown.claim.starts_with(row));
        rows.flat_map(|row| row.statuses.iter().map(|status| &status.strength))
            .collect()
    };
    for row in ["no collision in", "no collision anywhere", "fewer failures"] {
        assert!(
            message(row)
                .iter()
                .all(|strength| matches!(strength, Strength::NotShown | Strength::Untried)),
            "{row}: {:?}",
            message(row)
        );
    }
    let undecided = |strength: &&&Strength| matches!(strength, Strength::Undecided { .. });
    assert_eq!(
        message("failure rate at most")
            .iter()
            .filter(undecided)
            .count(),
        3
    );
    let refuted = |strength: &&&Strength| {
        matches!(
            strength,
            Strength::Refuted {
                failures: 40,
                runs: 40
            }
        )
    };
    assert_eq!(
        message("no collision of other vehicles")
            .iter()
            .filter(refuted)
            .count(),
        3
    );
    assert!(
        !assessment.summary.gates[0].holds,
        "{}",
        assessment.summary.gates[0].reason
    );
}

/// Refused before the first run, with file and field.
#[test]
fn misleading_configurations_are_refused_at_the_start() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(
        folder.path().join("no-subject.toml"),
        third_party_crash_space([STILL, " = \"idm\"", BRAKES, STILL]),
    )
    .expect("writes");
    let begin = "version = 1\ncontrollers = [\"idm\", \"baseline\"]\npaper = false\n";
    for (rest, message) in [
        (
            "distributions = [\"no-subject.toml\"]\n",
            "a.toml:4: distributions[0]: no-subject.toml: no vehicle is under test",
        ),
        (
            "distributions = [\"gone.toml\"]\n",
            "a.toml:4: distributions[0]: ",
        ),
        (
            "[[gates]]\nrequire = \"proofs-accepted\"\ncontroler = \"idm\"\n",
            "controler",
        ),
        (
            "[names]\n\"acc-aeb\" = \"mine\"\n",
            "names: `acc-aeb` is not among `controllers`",
        ),
        (
            "[names]\nidm = \" \"\n",
            "names: the name of `idm` must not be empty",
        ),
        (
            "[names]\nidm = \"shield:road\"\n",
            "names: `shield:road` is a built-in controller; give `idm` another name",
        ),
        (
            "[names]\nidm = \"mine\"\nbaseline = \"mine\"\n",
            "controllers[1]: `mine` appears twice",
        ),
        (
            "[[gates]]\nrequire = \"rate-not-above\"\ncontroller = \"idm\"\nthan = \"idm\"\n",
            "gates[0].than: is the controller itself",
        ),
        (
            "[[gates]]\nrequire = \"no-collision-in-scenario-files\"\ncontroller = \"idm\"\n",
            "gates[0].require: needs `scenarios`",
        ),
        (
            "everyday_draws = 0\n[[gates]]\nrequire = \"string-stable\"\ncontroller = \"idm\"\n",
            "needs `everyday_draws`",
        ),
    ] {
        let path = folder.path().join("a.toml");
        fs::write(&path, format!("{begin}{rest}")).expect("writes");
        let refused = AssessmentPlan::load(&path, Controllers::default())
            .expect_err("refused")
            .to_string();
        assert!(refused.contains(message), "{rest}: {refused}");
    }
}

/// An equal controller is not worse after more runs, and the report contains the assessment that it was compared with.
#[test]
fn an_equal_controller_with_more_runs_is_not_worse() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("old.json");
    let asked = |factor: u64| {
        let mut asked = config(&["baseline", "idm"]);
        asked.subject = Some("idm".to_owned());
        let spaces = Some(vec!["high-risk".to_owned()]);
        (asked.distributions, asked.search.spaces) = (spaces.clone(), spaces);
        (asked.draws, asked.rates.runs) = (20 * factor, 100 * factor);
        asked.search.budget = 10 * factor;
        asked.gates = vec![AssessmentGate::NothingWorse {}.into()];
        AssessmentPlan::new(asked, [], Path::new("")).expect("valid")
    };
    let [few, many] = [asked(1), asked(4)];
    for (before, now) in [(&few, &many), (&many, &few)] {
        let run = |plan, against: Option<&EarlierAssessment>| {
            assess(plan, &EvidenceCache::disabled(), against, &Quiet).expect("runs")
        };
        let json = run(before, None).to_json().expect("serializes");
        fs::write(&path, &json).expect("writes");
        let earlier = EarlierAssessment::load(&path).expect("evidence");
        let later = run(now, Some(&earlier));
        assert!(later.summary.gates[0].holds, "{:?}", later.comparison);
        let files = later.files().expect("encoded");
        let copy = files.iter().find(|(name, _)| name == "earlier.json");
        assert_eq!(copy.expect("copied").1, json.as_bytes());
        assert!(later.to_markdown().contains("--against earlier.json"));
    }
}

/// A comparison that counted runs decide against the subject is refuted in every form of the report. Below the minimum
/// confidence level, the same counts decide nothing, in favour of either controller.
#[test]
fn counts_against_the_subject_refute_its_comparison() {
    let compared = |controllers: [&str; 2], confidence: f64| {
        let mut asked = config(&controllers);
        asked.subject = Some(controllers[1].to_owned());
        (asked.rates.runs, asked.rates.confidence) = (200, confidence);
        run(asked, Path::new(""))
    };
    let row = |assessment: &AssessmentReport| {
        let rows = assessment.summary.claims.iter();
        let mut rows = rows.filter(|row| row.claim.contains("fewer failures"));
        rows.find(|row| row.part == "proofs")
            .expect("claimed")
            .clone()
    };
    let worse = compared(["idm", "baseline"], 0.999);
    let refuted = row(&worse);
    let status = &refuted.statuses[1];
    assert!(
        matches!(
            status.strength,
            Strength::CountedAgainst {
                only_own: 200,
                only_other: 0,
                ..
            }
        ) && status.strength.level() == StrengthLevel::Refuted,
        "{status:?}"
    );
    let files = worse.files().expect("encoded");
    let text = |name: &str| {
        let mut files = files.iter();
        let file = files.find(|file| file.0 == name).expect("written");
        let text = String::from_utf8(file.1.clone()).expect("UTF-8");
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let facts = "in 200 of 200 counted runs, it fails and the other does not; in 0, the other fails and it does not; \
                 confidence 99.9 %";
    for (form, begin) in [
        ("assessment.junit.xml", "<failure message=\"refuted: "),
        ("assessment.gsn.yaml", "\"Refuted: "),
        (
            "assessment.md",
            "no fewer failures than idm in the distribution of `paper`",
        ),
    ] {
        let text = text(form);
        let stated = text.split(begin).skip(1).any(|rest| {
            rest.split(['"', '\n'])
                .next()
                .unwrap_or_default()
                .contains(facts)
        });
        assert!(stated, "{form}: {text}");
    }
    assert!(
        text("assessment.md").contains("Counted runs show that it fails more often than `idm`")
    );
    for controllers in [["idm", "baseline"], ["baseline", "idm"]] {
        let status = row(&compared(controllers, 0.9)).statuses[1].clone();
        assert_eq!(
            status.strength.level(),
            StrengthLevel::NotShown,
            "{status:?}"
        );
    }
}

/// Certificates of no greater weight do not outweigh the comparison that the assessment counted.
#[test]
fn a_count_in_vain_is_not_outweighed() {
    let folder = tempfile::tempdir().expect("a folder");
    let own = folder.path().join("own.safetensors");
    fs::write(&own, Policy::retrained_bytes()).expect("writes");
    let paper = built_in_space("paper").expect("built in");
    let mut forged = count_certificate(
        "own.safetensors",
        Some("idm"),
        &paper,
        EstimatorKind::Kalman,
        folder.path(),
    );
    let Statement::Comparison(two) = &mut forged.statement else {
        panic!("a comparison")
    };
    (two.only_first_failed, two.only_second_failed) = (0, 0);
    for (counted, _) in &mut two.blocks {
        *counted = [0, 100];
        two.only_second_failed += 100;
    }
    let path = folder.path().join("forged.json");
    fs::write(&path, serde_json::to_string(&forged).expect("JSON")).expect("writes");
    let mut asked = config(&["idm", "own.safetensors"]);
    (asked.rates.runs, asked.rates.confidence) = (2000, 0.999);
    asked.certificates = Some(vec![path]);
    let assessment = run(asked, folder.path());
    let row = assessment
        .summary
        .claims
        .iter()
        .find(|row| row.claim.contains("fewer failures") && row.part == "proofs");
    let status = &row.expect("claimed").statuses[1];
    assert!(
        matches!(
            status.strength,
            Strength::NotShownByCounting { runs: 2000, .. }
        ),
        "{status:?}"
    );
    assert!(
        matches!(status.secondary[..], [ref one] if matches!(one.strength, Strength::Counted { .. })),
        "{status:?}"
    );
}

#[test]
fn a_recording_is_assessed_as_its_episodes() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("corpora/recordings/synthetic-platoon.csv");
    fs::copy(recording, folder.path().join("platoon.csv")).expect("copied");
    let with = |rest: &str| {
        let path = folder.path().join("a.toml");
        fs::write(
            &path,
            format!("version = 1\ncontrollers = [\"idm\"]\npaper = false\n{rest}"),
        )
        .expect("writes");
        AssessmentPlan::load(&path, Controllers::default()).map_err(|error| error.to_string())
    };
    let small = "draws = 0\neveryday_draws = 0\ndistributions = []\nsearch = { spaces = [] }\nrates = { runs = 0 }\n";
    let gate = "[[gates]]\nrequire = \"no-collision-in-scenario-files\"\ncontroller = \"idm\"\n";
    let plan = with(&format!("recordings = [\"platoon.csv\"]\n{small}{gate}")).expect("valid");
    let assessment = assess(&plan, &EvidenceCache::disabled(), None, &Quiet).expect("runs");
    let traffic = assessment.results.file_scenarios.as_ref().expect("a part");
    assert_eq!(
        (traffic.scenarios.len(), assessment.summary.gates[0].holds),
        (2, true),
        "each car that brakes leads one: {}",
        assessment.summary.gates[0].reason
    );
    assert!(
        assessment
            .command_files
            .iter()
            .any(|file| file.file.starts_with("scenarios/openacc"))
    );
    let refused = with("recordings = [\"gone.csv\"]\n").expect_err("refused");
    assert!(
        refused.contains("a.toml:4: recordings: ") && refused.contains("gone.csv"),
        "{refused}"
    );
}
