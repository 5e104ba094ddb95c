//! `crumple assess` and `crumple import` on the command line.

use crate::report::without_build_info;
use crumple_controllers::find_for_user;
use crumple_report::assessment::AssessConfig;

use super::*;

/// Returns a small platoon in the OpenACC format: the leader brakes from 20 to 11 m/s at 3 m/s².
fn platoon_csv() -> String {
    let mut text =
        "Date,1,1,2026\nVehicle_order,A,B,\nNumber_of_vehicles,2\nACC,1\nDistance_setting,S\n"
            .to_owned();
    text += "Time,Speed1,E1,N1,Lon1,Lat1,Alt1,Speed2,E2,N2,Lon2,Lat2,Alt2,IVS1\n";
    for sample in 0..150 {
        let time_s = f64::from(sample) * 0.1;
        let speed_mps = 20.0 - 3.0 * (time_s - 3.0).clamp(0.0, 3.0);
        text += &format!("{time_s:.1},{speed_mps:.3},,,,,,20.0,,,,,,25.0\n");
    }
    text
}

#[test]
fn an_imported_episode_can_be_simulated_and_assessed() {
    let folder = temp_folder();
    fs::write(folder.path().join("platoon.csv"), platoon_csv()).unwrap();
    let imported = run_crumple(folder.path(), "import platoon.csv --out episodes");
    assert_eq!(
        (exit_code(&imported), stdout(&imported)),
        (
            0,
            "platoon.csv: 1 scenario (openacc), no vehicle behind: collisions from behind cannot happen\n"
        ),
        "{imported:?}"
    );
    let episode = &file_names_in(&folder.path().join("episodes"))[0];
    run_ok(
        folder.path(),
        &format!("simulate episodes/{episode} --expect safe"),
    );
    let config = "version = 1\ncontrollers = [\"baseline\", \"idm\"]\npaper = false\ndraws = 20\neveryday_draws = \
        4\nrates.runs = 200\nscenarios = [\"episodes\"]\n\
                  search = { spaces = [\"paper\"], budget = 20 }\n";
    fs::write(folder.path().join("a.toml"), config).unwrap();
    let written = [
        "assessment.gsn.yaml",
        "assessment.html",
        "assessment.json",
        "assessment.junit.xml",
        "assessment.md",
        "assessment.toml",
        "certificates",
        "counterexamples",
        "evidence",
        "replay.sh",
        "report.sha256",
        "scenarios",
        "violations",
        "work.json",
    ];
    for threads in ["1", "2"] {
        let out = format!("report-{threads}");
        assert_eq!(
            exit_code(&run_on_threads(
                folder.path(),
                threads,
                &format!("assess a.toml --out {out}")
            )),
            0
        );
        assert_eq!(file_names_in(&folder.path().join(&out)), written);
    }
    for name in &written[..6] {
        let read = |folder_name: &str| {
            without_build_info(
                name,
                &fs::read_to_string(folder.path().join(folder_name).join(name)).unwrap(),
            )
        };
        assert_eq!(
            read("report-1"),
            read("report-2"),
            "{name} depends on the number of threads"
        );
    }
    let markdown = fs::read_to_string(folder.path().join("report-1/assessment.md")).unwrap();
    assert!(
        markdown.contains("openacc-platoon-01"),
        "recorded traffic is in the report"
    );
}

/// Gates decide the exit code, evidence is reused, and a killed assessment resumes to the same bytes.
#[test]
fn gates_decide_and_evidence_is_kept() {
    let folder = temp_folder();
    let config = |paper: bool, gates: &str| {
        let text = format!(
            "version = 1\ncontrollers = [\"baseline\", \"idm\"]\ndraws = 20\neveryday_draws = 4\nrates.runs = 200\n\
             paper = {paper}\ndistributions = [\"paper\"]\n\
             search = {{ spaces = [\"paper\"], budget = 5 }}\ncertificates = []\n{gates}"
        );
        fs::write(folder.path().join("a.toml"), text).unwrap();
    };
    config(false, "");
    run_ok(folder.path(), "assess a.toml --out one");
    let mut child = command(folder.path(), "assess a.toml --out two")
        .spawn()
        .unwrap();
    sleep(Duration::from_millis(150));
    child.kill().unwrap();
    child.wait().unwrap();
    let again = run_crumple(
        folder.path(),
        "assess a.toml --out two --against one/assessment.json",
    );
    assert_prints(&again, 0, &["0 better, 0 worse, 0 new, 0 gone"]);
    let mut pieces = fs::read_dir(folder.path().join("two/evidence"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let piece = pieces
        .find(|path| {
            path.extension()
                .is_some_and(|extension| extension == "json")
        })
        .unwrap();
    fs::write(&piece, "{").unwrap();
    let third = run_crumple(folder.path(), "assess a.toml --out two");
    let name = piece.file_name().unwrap().to_string_lossy().into_owned();
    assert!(
        stderr(&third).contains(&format!(
            "two/evidence/{name} was damaged, and its evidence was computed again"
        )),
        "{third:?}"
    );
    assert!(
        stderr(&third).contains("pieces of evidence were reused"),
        "{third:?}"
    );
    let read = |report: &str| {
        let text = fs::read_to_string(folder.path().join(report).join("assessment.json")).unwrap();
        without_build_info("assessment.json", &text)
    };
    assert_eq!(read("one"), read("two"));

    // `fsck` names a folder that is damaged or no run folder, and also reports the intact ones.
    fs::create_dir(folder.path().join("none")).unwrap();
    let looked = run_crumple(folder.path(), "fsck one none two");
    assert_eq!(
        (exit_code(&looked), stdout(&looked).lines().count()),
        (2, 2),
        "{looked:?}"
    );
    assert_eq!(
        stderr(&looked),
        "error: none: not a result folder: it contains no work.json\n"
    );
    let looked = run_crumple(folder.path(), "fsck nosuch");
    let printed = (exit_code(&looked), stdout(&looked), stderr(&looked));
    assert_eq!(printed, (2, "", "error: nosuch: there is no such folder\n"));
    fs::write(folder.path().join("one/assessment.md"), "").unwrap();
    let looked = run_crumple(folder.path(), "fsck one none two");
    assert_eq!(stderr(&looked), "failed: damaged: one; unreadable: none\n");

    // The second name is that of version 0.3.0.
    for name in [
        "no-collision-in-paper-scenarios",
        "no-contact-in-paper-scenarios",
    ] {
        let gate = format!("[[gates]]\nrequire = \"{name}\"\ncontroller = \"baseline\"\n");
        config(true, &gate);
        let failed = run_crumple(folder.path(), "assess a.toml --out two");
        assert_reports(
            &failed,
            1,
            "gate: baseline: no collision in the paper's scenarios (it collides in paper-1",
        );
        assert!(
            stdout(&failed).ends_with("0 of 1 gates hold.\n"),
            "{failed:?}"
        );
        let report = fs::read_to_string(folder.path().join("two/assessment.json")).unwrap();
        assert!(report.contains("\"no-collision-in-paper-scenarios\""));
    }
    config(
        false,
        "[[gates]]\nrequire = \"rate-not-above\"\ncontroller = \"idm\"\nthan = \"baseline\"\n",
    );
    let held = run_ok(folder.path(), "assess a.toml --out two");
    assert!(stdout(&held).ends_with("The gate holds.\n"), "{held:?}");
}

#[test]
fn a_bad_configuration_or_recording_is_named_and_nothing_is_written() {
    let folder = temp_folder();
    let cases = [
        (
            "version = 1\ndraws = \"many\"\n",
            "error: a.toml:2: draws: invalid type",
        ),
        (
            "version = 1\n\nspeed = 3\n",
            "error: a.toml:3: speed: unknown field `speed`",
        ),
        (
            "version = 2\n",
            "error: a.toml:1: version: version 2 is not supported",
        ),
        (
            "version = 1\ncontrollers = [\"hal\"]\n",
            "error: a.toml:2: controllers[0]: there is no controller `hal`",
        ),
        (
            "version = 1\ncontrollers = []\n",
            "error: a.toml:2: controllers: must name at least one",
        ),
        (
            "version = 1\nscenarios = [\"nowhere\"]\n",
            "error: a.toml:2: scenarios[0]: ",
        ),
        (
            "version = 1\nsubject = \"hal\"\n",
            "error: a.toml:2: subject: `hal` is not among `controllers`",
        ),
        (
            "version = 1\n\nsearch = { spaces = [\"moon\"] }\n",
            "error: a.toml:3: search.spaces[0]: `moon` is neither",
        ),
        (
            "version = 1\nrates = { confidence = 1.5 }\n",
            "error: a.toml:2: rates.confidence: must be between",
        ),
        (
            "version = 1\ncertificates = [\"nowhere.json\"]\n",
            "error: a.toml:2: certificates[0]: nowhere.json: ",
        ),
        (
            "version = 1\n[[gates]]\nrequire = \"proofs-accepted\"\n[[gates]]\nrequire = \"proofs-accepted\"\nspeed = \
             3\n",
            "error: a.toml:4: gates[1]: unknown field `speed`",
        ),
        (
            "version = 1\n[[gates]]\nrequire = \"luck\"\n",
            "error: a.toml:3: gates[0].require: unknown variant `luck`",
        ),
    ];
    for (config, expected) in cases {
        fs::write(folder.path().join("a.toml"), config).unwrap();
        assert_refused(
            &run_crumple(folder.path(), "assess a.toml --out report"),
            expected,
        );
    }
    let truncated = platoon_csv();
    fs::write(
        folder.path().join("cut.csv"),
        &truncated[..truncated.len() - 12],
    )
    .unwrap();
    fs::write(folder.path().join("empty.csv"), "").unwrap();
    assert_refused(
        &run_crumple(folder.path(), "import empty.csv --out episodes"),
        "error: empty.csv: ",
    );
    assert_refused(
        &run_crumple(folder.path(), "import missing.csv --out episodes"),
        "error: missing.csv: ",
    );
    assert_refused(
        &run_crumple(folder.path(), "import cut.csv --min-brake -1"),
        "error: --min-brake: ",
    );
    assert_eq!(
        file_names_in(folder.path()),
        ["a.toml", "cut.csv", "empty.csv"],
        "nothing was written"
    );
    let cut = run_crumple(folder.path(), "import cut.csv --out episodes");
    assert_eq!(
        exit_code(&cut),
        0,
        "a logger that stops within a line loses that line"
    );
    assert!(
        stderr(&cut).contains("cut.csv:156: the file ends within this line, so it was left out")
    );
}

/// A new user starts without a file: an own controller, the built-in configuration, and a hint for a wrong file.
#[test]
fn an_own_controller_is_assessed_without_a_file() {
    let folder = temp_folder();
    fs::write(
        folder.path().join("aeb.toml"),
        "version = 1\nbuilt_in = \"acc-aeb\"\n[settings]\nttc_s = 2.0\n",
    )
    .unwrap();
    let wrong = run_crumple(folder.path(), "assess aeb.toml");
    assert_eq!(exit_code(&wrong), 2);
    let message = stderr(&wrong);
    for part in [
        "is a controller",
        "assess --controller aeb.toml",
        "show assessment",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let shown = run_crumple(folder.path(), "show assessment");
    assert_eq!(exit_code(&shown), 0);
    let shown: AssessConfig = toml::from_str(stdout(&shown)).expect("a configuration");
    let mut default = AssessConfig::default();
    // The file states what the default leaves to the paper.
    default.subject = Some("road".to_owned());
    default.distributions = Some(default.rate_spaces());
    default.search.spaces = Some(default.search_spaces());
    assert_eq!(shown, default);
    let both = run_crumple(folder.path(), "assess aeb.toml --controller idm");
    assert_eq!(exit_code(&both), 2);
    // `idm` is compared with another controller, also under the name of a file.
    fs::write(
        folder.path().join("mine.toml"),
        "version = 1\nbuilt_in = \"idm\"\n",
    )
    .unwrap();
    for (name, reference) in [
        ("mine.toml", "baseline"),
        ("idm", "baseline"),
        ("aeb.toml", "idm"),
    ] {
        let own = find_for_user(name, folder.path()).expect("a controller");
        assert_eq!(
            AssessConfig::for_own_controller(&own).controllers,
            [reference],
            "{name}"
        );
    }
}
