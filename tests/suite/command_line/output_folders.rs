//! Folders in which crumple chooses file names: it replaces only files that it wrote.

use super::*;
use crumple_store::disk::StagedFiles;

const SUITE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/examples/suites/lane-changes.toml"
);
const RECORDING: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/corpora/recordings/synthetic-platoon.csv"
);
const ASSESSMENT: &str = "version = 1\ncontrollers = [\"idm\"]\npaper = false\ndraws = 5\neveryday_draws = \
    0\nrates.runs = 0\n\
                          distributions = [\"paper\"]\nsearch = { spaces = [] }\ncertificates = []\n";

/// No file is written while an edited file, a file of another program or a link is in the way.
#[cfg(unix)]
#[test]
fn a_folder_of_results_keeps_every_file_that_crumple_did_not_write() {
    let folder = temp_folder();
    fs::write(folder.path().join("a.toml"), ASSESSMENT).unwrap();
    let other = "crumple did not write it";
    let suite = format!("suite run '{SUITE}' --controller=full-throttle");
    let import = format!("import '{RECORDING}'");
    let commands = [
        (suite.as_str(), other),
        ("export paper-1 --to=openscenario", other),
        ("man", other),
        ("verify shield", other),
        ("assess a.toml", other),
        (&import, "exists with other contents"),
    ];
    for (number, (command, refused)) in commands.into_iter().enumerate() {
        let (out, apart) = (format!("out-{number}"), format!("apart-{number}"));
        let write =
            |out: &str| run_crumple(folder.path(), &format!("{command} --quiet --out {out}"));
        let written = write(&out);
        assert_eq!(exit_code(&written), 0, "{command:?}: {}", stderr(&written));
        let names = file_names_in(&folder.path().join(&out));
        let name = names
            .iter()
            .find(|name| !name.ends_with(".sha256") && name.contains('.'))
            .unwrap();
        let path = folder.path().join(&out).join(name);
        let genuine = fs::read(&path).unwrap();
        fs::write(&path, [&genuine[..], b" "].concat()).unwrap();
        assert_refused(&write(&out), refused);
        assert_eq!(
            fs::read(&path).unwrap(),
            [&genuine[..], b" "].concat(),
            "{command:?}"
        );
        fs::write(&path, &genuine).unwrap();
        assert_eq!(
            exit_code(&write(&out)),
            0,
            "{command:?}: it is as it was written again"
        );
        let elsewhere = folder.path().join(format!("elsewhere-{number}"));
        fs::write(&elsewhere, "precious").unwrap();
        fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &path).unwrap();
        assert_refused(&write(&out), "is a symbolic link");
        assert!(
            path.is_symlink() && fs::read_to_string(&elsewhere).unwrap() == "precious",
            "{command:?}"
        );
        let apart = folder.path().join(&apart);
        fs::create_dir(&apart).unwrap();
        fs::write(apart.join(name), "precious").unwrap();
        assert_refused(&write(apart.to_str().unwrap()), refused);
        assert_eq!(
            fs::read_to_string(apart.join(name)).unwrap(),
            "precious",
            "{command:?}"
        );
        let files = |folder: &Path| {
            file_names_in(folder)
                .into_iter()
                .filter(|name| !name.starts_with("evidence"))
        };
        assert_eq!(
            files(&apart)
                .filter(|name| apart.join(name).is_file())
                .collect::<Vec<_>>(),
            [name.as_str()]
        );
    }
}

/// A process that ended while it moved files into place leaves both listings.
#[test]
fn an_interrupted_change_is_known_to_the_next_run() {
    let folder = temp_folder();
    let export = |controller: &str| {
        let arguments =
            format!("export paper-1 --to=openscenario --controller {controller} --out out");
        exit_code(&run_crumple(folder.path(), &arguments))
    };
    let at = |name: &str| folder.path().join("out").join(name);
    assert_eq!(export("idm"), 0);
    let (listing, before) = (
        fs::read(at("exported.sha256")).unwrap(),
        fs::read(at("paper-1.xosc")).unwrap(),
    );
    assert_eq!(export("policy"), 0);
    let (next, after) = (
        fs::read(at("exported.sha256")).unwrap(),
        fs::read(at("paper-1.xosc")).unwrap(),
    );
    assert_ne!(before, after);
    // The second export moved its file, but not its listing.
    fs::write(at(".exported.sha256.next"), [&listing[..], &next].concat()).unwrap();
    fs::write(at("exported.sha256"), listing).unwrap();
    assert_eq!(export("idm"), 0);
    assert_eq!(fs::read(at("paper-1.xosc")).unwrap(), before);
    assert_eq!(
        file_names_in(&folder.path().join("out")),
        ["exported.sha256", "paper-1.xodr", "paper-1.xosc"]
    );
}

/// Unfinished files of a killed process are unlocked; those of a living process are locked.
#[test]
fn files_of_killed_processes_are_removed_and_no_others() {
    let folder = temp_folder();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.toml"), ASSESSMENT).unwrap();
    for (kind, arguments) in [
        (
            "suite",
            format!("suite run '{SUITE}' --controller=full-throttle"),
        ),
        ("assessment", "assess a.toml".to_owned()),
    ] {
        let results = if kind == "suite" {
            at(kind)
        } else {
            at(kind).join("evidence")
        };
        fs::create_dir_all(&results).unwrap();
        let write = || run_crumple(folder.path(), &format!("{arguments} --out {kind}"));
        for left in [
            ".crumple-unfinished-file-aB3dE6",
            ".crumple-unfinished-aB3dE6",
        ] {
            fs::write(results.join(left), "half").unwrap();
        }
        let mut writing = StagedFiles::default();
        writing.stage(&results.join("own.json"), "whole").unwrap();
        let written = write();
        assert_eq!(exit_code(&written), 0, "{}", stderr(&written));
        let unfinished = || {
            file_names_in(&results)
                .iter()
                .filter(|name| name.contains("unfinished"))
                .count()
        };
        assert_eq!(
            unfinished(),
            2,
            "the file and its lock, {kind}: {:?}",
            file_names_in(&results)
        );
        writing.commit().unwrap();
        assert_eq!(
            fs::read_to_string(results.join("own.json")).unwrap(),
            "whole"
        );
        assert_eq!((exit_code(&write()), unfinished()), (0, 0));
    }
}

/// The folder contains the failures of the last run, and files that no run wrote.
#[test]
fn failures_of_an_earlier_suite_run_do_not_stay() {
    let folder = temp_folder();
    let failures = folder.path().join("failures");
    let run = |controller: &str| {
        run_crumple(
            folder.path(),
            &format!("suite run '{SUITE}' --controller {controller} --out failures"),
        )
    };
    assert_eq!(exit_code(&run("full-throttle")), 0);
    let listed = file_names_in(&failures);
    assert!(
        listed.len() > 3 && listed.contains(&"failures.sha256".to_owned()),
        "{listed:?}"
    );
    assert_eq!(exit_code(&run("full-throttle")), 0);
    assert_eq!(file_names_in(&failures), listed);
    // An edited file and a file of the user stay, and are listed.
    let edited = listed.iter().find(|name| name.ends_with(".toml")).unwrap();
    let text = fs::read_to_string(failures.join(edited)).unwrap();
    fs::write(failures.join(edited), text + "# mine\n").unwrap();
    fs::write(failures.join("own.toml"), "").unwrap();
    let passed = run("acc-aeb");
    assert_eq!(exit_code(&passed), 0);
    assert_eq!(file_names_in(&failures), [edited.as_str(), "own.toml"]);
    assert!(
        stderr(&passed).contains(" and 1 more: not written by this run, and unchanged"),
        "{}",
        stderr(&passed)
    );
    fs::write(failures.join("failures.sha256"), "0  ../elsewhere\n").unwrap();
    assert_refused(
        &run("acc-aeb"),
        "failures.sha256:1: expected a SHA-256 and the name of a file in this folder",
    );
}

#[test]
fn an_edited_scenario_is_not_imported_over() {
    let folder = temp_folder();
    let import = |more: &str| {
        run_crumple(
            folder.path(),
            &format!("import '{RECORDING}' --out episodes {more}"),
        )
    };
    assert_eq!(
        (exit_code(&import("")), exit_code(&import(""))),
        (0, 0),
        "the same again is no edit"
    );
    let names = file_names_in(&folder.path().join("episodes"));
    let first = folder.path().join("episodes").join(&names[0]);
    let genuine = fs::read_to_string(&first).unwrap();
    fs::write(&first, genuine.clone() + "# mine\n").unwrap();
    assert_refused(
        &import(""),
        &format!("{}: exists with other contents: use --force", names[0]),
    );
    assert!(fs::read_to_string(&first).unwrap().ends_with("# mine\n"));
    assert_eq!(exit_code(&import("--force")), 0);
    assert_eq!(fs::read_to_string(&first).unwrap(), genuine);
}

/// Names and links in a listing cannot lead outside the folder.
#[cfg(unix)]
#[test]
fn a_report_removes_nothing_that_is_elsewhere() {
    use std::os::unix::fs::symlink;
    let folder = temp_folder();
    let at = |name: &str| folder.path().join(name);
    for name in [
        "mine",
        "report",
        "report/scenarios",
        "report/counterexamples",
    ] {
        fs::create_dir(at(name)).unwrap();
    }
    for name in [
        "mine/a.toml",
        "mine/b.toml",
        "report/scenarios/old.toml",
        "report/scenarios/own.toml",
    ] {
        fs::write(at(name), "precious").unwrap();
    }
    symlink("../../mine", at("report/counterexamples/deep")).unwrap();
    fs::write(at("a.toml"), ASSESSMENT).unwrap();
    let digest = sha256("precious");
    let list =
        |name: &str| fs::write(at("report/report.sha256"), format!("{digest}  {name}\n")).unwrap();
    let assess = || run_crumple(folder.path(), "assess a.toml --out report");
    assert_refused(&assess(), "report/counterexamples/deep: is a symbolic link");
    fs::remove_file(at("report/counterexamples/deep")).unwrap();
    for outside in [
        "scenarios/../../mine/a.toml",
        at("mine/a.toml").to_str().unwrap(),
        "../mine/b.toml",
    ] {
        list(outside);
        assert_refused(
            &assess(),
            "report/report.sha256:1: expected a SHA-256 and the name of a file",
        );
    }
    list("scenarios/old.toml");
    let made = assess();
    assert_eq!(exit_code(&made), 0, "{}", stderr(&made));
    assert_eq!(file_names_in(&at("mine")), ["a.toml", "b.toml"]);
    assert_eq!(
        file_names_in(&at("report/scenarios")),
        ["own.toml"],
        "the report removes what it wrote itself"
    );
    fs::remove_dir_all(at("report/scenarios")).unwrap();
    symlink("../mine", at("report/scenarios")).unwrap();
    assert_refused(&assess(), "report/scenarios: is a symbolic link");
    assert_eq!(file_names_in(&at("mine")), ["a.toml", "b.toml"]);
}

/// A stop before the last rename leaves no `work.json`. Files of a person are refused before the work.
#[test]
fn an_incomplete_report_is_named_and_completed() {
    let folder = temp_folder();
    let at = |name: &str| folder.path().join(name);
    let run = |arguments: &str| run_crumple(folder.path(), arguments);
    fs::write(at("a.toml"), ASSESSMENT).unwrap();
    let assess = || run("assess a.toml --out report");
    assert_eq!(exit_code(&assess()), 0);
    fs::remove_file(at("report/work.json")).unwrap();
    assert_refused(
        &run("fsck report"),
        "report: an incomplete report without work.json: run the same command again",
    );
    assert_eq!(exit_code(&assess()), 0);
    assert_eq!(exit_code(&run("fsck report")), 0);
    fs::write(at("report/assessment.md"), "mine").unwrap();
    let examined = run("fsck report");
    assert_eq!(exit_code(&examined), 1);
    assert!(
        stdout(&examined).contains("move changed files away and run the same command again"),
        "{}",
        stdout(&examined)
    );
    for name in ["assessment.gsn.yaml", "replay.sh"] {
        let out = format!("own-{name}");
        fs::create_dir(at(&out)).unwrap();
        fs::write(at(&out).join(name), "mine").unwrap();
        let refused = run(&format!("assess a.toml --out {out}"));
        assert_refused(
            &refused,
            &format!("{name}: has changed, or crumple did not"),
        );
        assert_eq!(file_names_in(&at(&out)), [name], "no evidence was gathered");
    }
    assert_refused(&run("assess --out a.toml"), "a.toml: is not a folder");
}
