//! What shells, `man` and those who ask for help are told of this build.

use std::collections::BTreeSet;
use std::fs;

use super::*;

/// The subcommands that `--help` lists.
fn listed(folder: &Path) -> BTreeSet<String> {
    let help = crumple(folder, &["--help"]);
    let commands = stdout(&help).split("Commands:").nth(1).unwrap().split("Options:").next().unwrap().to_owned();
    let names = commands.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").map(str::to_owned).collect()
}

/// Every command has a page, and every shell completes every command.
#[test]
fn pages_and_completions_know_every_command() {
    let folder = folder();
    let commands = listed(folder.path());
    assert!(commands.len() > 15, "{commands:?}");
    let written = crumple(folder.path(), &["man", "--out", "man"]);
    assert_eq!(code(&written), 0, "{}", stderr(&written));
    for command in &commands {
        let page = fs::read_to_string(folder.path().join(format!("man/crumple-{command}.1"))).unwrap();
        assert!(page.contains(".SH SYNOPSIS") && page.contains("130  interrupted"), "{command}");
    }
    assert!(folder.path().join("man/crumple-verify-rate.1").exists());
    // The synopsis is what `--help` says: what has to be there stands without brackets, with what it takes.
    for words in [&["suite", "run"][..], &["suite", "map"], &["verify", "rate"], &["merge"], &["simulate"]] {
        let help = crumple(folder.path(), &[words, &["--help"]].concat());
        let usage = stdout(&help).lines().find_map(|line| line.strip_prefix("Usage: ")).expect("a usage").to_owned();
        let page = fs::read_to_string(folder.path().join(format!("man/crumple-{}.1", words.join("-")))).unwrap();
        let synopsis = page.split(".SH SYNOPSIS\n").nth(1).unwrap().split("\n.SH").next().unwrap();
        let plain = synopsis.replace("\\fB", "").replace("\\fR", "").replace("\\fI", "").replace("\\-", "-");
        assert_eq!(plain.split_whitespace().collect::<Vec<_>>(), usage.split_whitespace().collect::<Vec<_>>());
    }
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = crumple(folder.path(), &["completions", shell]);
        assert_eq!(code(&script), 0, "{}", stderr(&script));
        let missing: Vec<_> = commands.iter().filter(|command| !stdout(&script).contains(*command)).collect();
        assert!(missing.is_empty(), "{shell}: {missing:?}");
    }
    assert_refused(&crumple(folder.path(), &["completions", "tcsh"]), "invalid value 'tcsh'");
}

/// It says what is missing where nothing is on the `PATH`, and never fails for it.
#[test]
fn a_doctor_says_what_is_missing() {
    let folder = folder();
    let told = command(folder.path(), &["doctor", "--format", "json"]).env("PATH", "/nowhere").output().unwrap();
    assert_eq!(code(&told), 0, "{}", stderr(&told));
    let report = &objects(&told)[0];
    // The first is crumple's own, for FMUs, and lies beside it.
    assert!(report["needs"].as_array().unwrap().iter().skip(1).all(|need| need["found"].is_null()));
    assert!(report["fused_multiply_add"].is_boolean());
    assert!(report["register_bits"].as_u64().unwrap() >= 64 && report["threads"].as_u64().unwrap() >= 1);
    let text = crumple(folder.path(), &["doctor"]);
    assert!(stdout(&text).contains("hyperqueue") && stdout(&text).starts_with("crumple 0."), "{}", stdout(&text));
}
