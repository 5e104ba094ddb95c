//! Tells a release build the commit of its sources, which reports and `--version` state. A debug build states none, so
//! that a commit does not compile the tests again.

use std::path::Path;
use std::process::Command;
use std::{env, fs};

/// Paths of everything that the program is compiled from.
const SOURCES: [&str; 7] = [
    "Cargo.lock",
    "Cargo.toml",
    "build.rs",
    "corpora",
    "crates",
    "src",
    "verify",
];

/// Files of a repository of which one changes with each commit.
const COMMIT_FILES: [&str; 3] = ["HEAD", "logs/HEAD", "packed-refs"];

/// File that `cargo package` adds, with the commit of the packaged sources.
const PACKAGED_COMMIT: &str = ".cargo_vcs_info.json";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let mut version = env::var("CARGO_PKG_VERSION").unwrap_or_default();
    if let Some(commit) = commit() {
        println!("cargo::rustc-env=CRUMPLE_COMMIT={commit}");
        version += &format!(", commit {commit}");
    }
    println!("cargo::rustc-env=CRUMPLE_VERSION={version}");
}

/// Returns the commit of the sources of a release build; `None` if it is not known, and for other builds.
fn commit() -> Option<String> {
    let is_release = env::var("PROFILE").as_deref() == Ok("release");
    is_release
        .then(|| packaged_commit().or_else(checked_out_commit))
        .flatten()
}

/// Returns the commit of a package; `None` outside packages.
fn packaged_commit() -> Option<String> {
    let info = fs::read_to_string(PACKAGED_COMMIT).ok()?;
    let (_, rest) = info.split_once("\"sha1\"")?;
    let commit = rest.split('"').nth(1)?;
    let changed = if info.contains("\"dirty\": true") {
        " with changes"
    } else {
        ""
    };
    Some(format!("{commit}{changed}"))
}

/// Returns the commit that is checked out in this folder, with a mark if sources differ from it; `None` if this folder
/// is no repository of its own.
fn checked_out_commit() -> Option<String> {
    // A folder above may be another repository.
    if !Path::new(".git").exists() {
        return None;
    }
    let commit = git(&["rev-parse", "HEAD"])?;
    let files = COMMIT_FILES.map(|file| git(&["rev-parse", "--git-path", file]));
    for path in files.iter().flatten().map(String::as_str).chain(SOURCES) {
        // Cargo runs this script in each build if a path is missing.
        if Path::new(path).exists() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let mut status = vec!["status", "--porcelain", "--"];
    status.extend(SOURCES);
    let is_clean = git(&status)?.is_empty();
    let changed = if is_clean { "" } else { " with changes" };
    Some(format!("{commit}{changed}"))
}

/// Returns the output of git; `None` if it fails.
fn git(arguments: &[&str]) -> Option<String> {
    let mut command = Command::new("git");
    // Keeps git from writing its index.
    command.args(arguments).env("GIT_OPTIONAL_LOCKS", "0");
    let output = command.output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
