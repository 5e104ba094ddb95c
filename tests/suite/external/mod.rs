//! crumple starts only the programs that the command line names: every subcommand, on files that name a program.

mod inputs;

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use crate::command_line::{exit_code, listed_subcommands, run_crumple, stderr, temp_folder};
use inputs::{EXEC_CONTROLLER, InputFolder, MARKER_FILE};

const OPTION: &str = "--allow-external";

/// Expected result without the option, and with it.
#[derive(Clone, Copy)]
enum StartExpectation {
    /// Exit code 2, and an error that names the option and this position. With the option the program starts.
    RefusedOrStarts(&'static str),
    /// Without the option like `RefusedOrStarts`. With it the command is too slow for a test, or starts nothing.
    Refused(&'static str),
    /// The command starts nothing, and needs no option.
    StartsNothing,
}

use StartExpectation::{Refused, RefusedOrStarts, StartsNothing};

/// Subcommand, arguments, result. Every subcommand of `crumple --help` has a row.
const CASES: &[(&str, &str, StartExpectation)] = &[
    ("assess", "scenarios.toml --out o", Refused("driven.toml:")),
    ("assess", "spaces.toml --out o", Refused("spaces.toml:")),
    (
        "simulate",
        "driven.toml",
        RefusedOrStarts("vehicles[2].driver.file.path: "),
    ),
    (
        "simulate",
        "driven.json",
        RefusedOrStarts("vehicles[2].driver.file.path: "),
    ),
    ("simulate", "driven-fmu.toml", Refused("/evil.fmu: ")),
    ("import", "driven.toml --out o", StartsNothing),
    ("fit", "driven.toml --out o.toml", StartsNothing),
    ("replay", "driven.toml --controller idm", StartsNothing),
    (
        "export",
        "driven.toml --to openscenario --out o",
        RefusedOrStarts("driven.toml:"),
    ),
    (
        "export",
        "driven.toml --to openscenario --as actions --out o",
        RefusedOrStarts("driven.toml:"),
    ),
    ("explore", "driven.toml", Refused("driven.toml:")),
    (
        "explore",
        "campaign",
        Refused("base.vehicles[2].driver.file.path: "),
    ),
    (
        "train",
        "--space space.toml --out o",
        Refused("space.toml:"),
    ),
    (
        "train",
        "--preset preset.toml --out o",
        Refused("space.toml:"),
    ),
    (
        "retrain",
        "--space space.toml --out o",
        Refused("space.toml:"),
    ),
    (
        "retrain",
        "--regression space.toml --out o",
        Refused("space.toml:"),
    ),
    (
        "tune",
        "--controller idm --space space.toml --evaluations 2 --runs 1 --test-runs 1 --out o",
        RefusedOrStarts("space.toml:"),
    ),
    (
        "falsify",
        "--controller idm --space space.toml --budget 2 --out o",
        RefusedOrStarts("space.toml:"),
    ),
    (
        "falsify",
        "--controller idm --space space.toml --budget 2 --out campaign --resume",
        Refused("space.toml:"),
    ),
    ("avoid", "driven.toml", RefusedOrStarts("driven.toml:")),
    (
        "worst-case",
        "driven.toml --controller idm --budget 1",
        RefusedOrStarts("driven.toml:"),
    ),
    (
        "check",
        "rate/certificate.json",
        Refused("base.vehicles[2].driver.file.path: "),
    ),
    (
        "check",
        "rate/certificate.json --rerun",
        RefusedOrStarts("base.vehicles[2].driver.file.path: "),
    ),
    (
        "check",
        "rate/certificate.json --scenario driven.toml",
        RefusedOrStarts("driven.toml:"),
    ),
    (
        "check",
        "rate/certificate.json --policy evil.toml",
        Refused("base.vehicles[2].driver.file.path: "),
    ),
    ("verify shield", "--help", StartsNothing),
    ("verify two-sided", "driven.toml", Refused("driven.toml:")),
    (
        "verify rate",
        "--controller idm --space space.toml --runs 2 --out o",
        RefusedOrStarts("space.toml:"),
    ),
    ("verify reach", "--box driven.toml", StartsNothing),
    (
        "verify invariant",
        "--controller idm --scenario driven.toml",
        Refused("driven.toml:"),
    ),
    ("suite list", "", StartsNothing),
    ("suite run", "driven.toml --controller idm", StartsNothing),
    ("suite table", "--help", StartsNothing),
    ("fsck", "campaign rate", StartsNothing),
    ("list", "", StartsNothing),
    ("show", "driven.toml", StartsNothing),
    ("describe", "evil.toml", StartsNothing),
    ("describe", "evil.fmu", StartsNothing),
    ("describe", "evil.fmu --format json", StartsNothing),
    ("describe", EXEC_CONTROLLER, StartsNothing),
    ("new", "o", StartsNothing),
    ("doctor", "", StartsNothing),
    ("completions", "bash", StartsNothing),
    ("man", "--out o", StartsNothing),
];

fn subcommands(folder: &Path, command: &str) -> BTreeSet<String> {
    let names = listed_subcommands(&run_crumple(folder, &format!("{command} --help")));
    if names.is_empty() {
        return BTreeSet::from([command.to_owned()]);
    }
    names
        .iter()
        .flat_map(|name| subcommands(folder, format!("{command} {name}").trim()))
        .collect()
}

#[test]
fn no_subcommand_starts_a_program_that_only_a_file_names() {
    let inputs = InputFolder::new();
    let covered: BTreeSet<String> = CASES
        .iter()
        .map(|(command, ..)| (*command).to_owned())
        .collect();
    assert_eq!(
        covered,
        subcommands(inputs.folder(), ""),
        "every subcommand has a row in the table"
    );
    for (command, arguments, expected) in CASES {
        let words = format!("{command} {arguments}");
        let text = inputs.run(&words);
        assert!(!inputs.has_started(), "{words} starts it: {}", text.stderr);
        let location = match expected {
            StartsNothing => "",
            Refused(location) | RefusedOrStarts(location) => location,
        };
        if !location.is_empty() {
            assert_eq!(text.code, 2, "{words}: {} {}", text.stdout, text.stderr);
            assert!(
                text.stderr.contains(OPTION) && text.stderr.contains(location),
                "{words}: {}",
                text.stderr
            );
        }
        if let Refused(_) = expected {
            continue;
        }
        let text = inputs.run(&format!("{words} {OPTION}"));
        assert_eq!(
            inputs.has_started(),
            matches!(expected, RefusedOrStarts(_)),
            "{words}: {}",
            text.stderr
        );
    }
}

/// With the option, crumple passes the FMU that a scenario names to its host, which finds no library in it.
#[test]
fn the_option_permits_the_fmu_that_a_scenario_names() {
    let inputs = InputFolder::new();
    let text = inputs.run(&format!("simulate driven-fmu.toml {OPTION}"));
    assert!(
        text.code == 2 && text.stderr.contains("evil.fmu") && !text.stderr.contains(OPTION),
        "{}",
        text.stderr
    );
    let listed = inputs.run("describe evil.fmu");
    assert_eq!(listed.code, 0, "{}", listed.stderr);
    assert!(
        listed.stdout.contains("input      gap_ahead_m"),
        "{}",
        listed.stdout
    );
    let listed: serde_json::Value = inputs
        .run("describe evil.fmu --format json")
        .stdout
        .parse()
        .unwrap();
    assert_eq!(listed["variables"][1]["causality"], "output", "{listed}");
}

#[test]
fn named_controllers_start() {
    let inputs = InputFolder::new();
    let config = inputs::assessment_toml("controllers = [\"idm\", \"evil.toml\"]", "");
    fs::write(inputs.folder().join("named.toml"), config).unwrap();
    let search = "falsify --controller evil.toml --space plain.toml --budget 2 --out own";
    for words in [
        "simulate paper-1 --controller evil.toml",
        "simulate paper-1 --controller exec:./ev",
        "simulate paper-1 --controller shield:evil.toml",
        "assess named.toml --out report",
        search,
        &format!("{search} --resume"),
    ] {
        let text = inputs.run(words);
        assert!(
            inputs.has_started() && text.code < 2,
            "{words}: {}",
            text.stderr
        );
    }
}

/// `git status` starts the programs that the configuration of a repository names.
#[test]
fn an_assessment_starts_no_program_of_the_repository_that_it_lies_in() {
    let folder = temp_folder();
    let git = |arguments: &[&str]| {
        let done = std::process::Command::new("git")
            .current_dir(folder.path())
            .args(arguments)
            .output();
        done.is_ok_and(|done| done.status.success())
    };
    if !git(&["init", "--quiet"]) {
        println!("skipped: there is no git");
        return;
    }
    fs::write(
        folder.path().join("a.toml"),
        inputs::assessment_toml("controllers = [\"idm\"]", ""),
    )
    .unwrap();
    fs::write(
        folder.path().join("plain.toml"),
        inputs::space_toml("plain", "paper-1"),
    )
    .unwrap();
    let author = ["-c", "user.name=a", "-c", "user.email=a@b"];
    assert!(
        git(&["add", "a.toml"]) && git(&[&author[..], &["commit", "--quiet", "-m", "a"]].concat())
    );
    fs::write(folder.path().join(".gitattributes"), "*.toml filter=evil\n").unwrap();
    let marker = format!("touch {}", folder.path().join(MARKER_FILE).display());
    assert!(git(&[
        "config",
        "filter.evil.clean",
        &format!("{marker}; cat")
    ]));
    assert!(git(&["config", "core.fsmonitor", &marker]));
    // A later time stamp makes git compare contents.
    fs::write(
        folder.path().join("a.toml"),
        inputs::assessment_toml("controllers = [\"idm\"] ", ""),
    )
    .unwrap();
    let starts_nothing = || {
        let assessed = run_crumple(folder.path(), "assess a.toml --out o");
        assert!(exit_code(&assessed) < 2, "{}", stderr(&assessed));
        assert!(!folder.path().join(MARKER_FILE).exists());
    };
    starts_nothing();
    // Git runs this hook when it refreshes the index, which it does if only a time stamp has changed.
    assert!(
        git(&["config", "--remove-section", "filter.evil"])
            && git(&["config", "core.fsmonitor", "false"])
    );
    let hook = folder.path().join(".git/hooks/post-index-change");
    fs::create_dir_all(hook.parent().unwrap()).unwrap();
    fs::write(&hook, format!("#!/bin/sh\n{marker}\n")).unwrap();
    fs::set_permissions(&hook, PermissionsExt::from_mode(0o755)).unwrap();
    fs::write(
        folder.path().join("a.toml"),
        inputs::assessment_toml("controllers = [\"idm\"]", ""),
    )
    .unwrap();
    starts_nothing();
}
