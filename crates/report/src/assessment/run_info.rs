//! The time, program and machine of an assessment.

mod utc;

use std::path::Path;
use std::time::{Duration, SystemTime};
use std::{fs, process};

use super::parts::RunInfo;

impl RunInfo {
    /// Collects what is known of an assessment that ends now: time, machine, and the commit of the configuration in
    /// `folder`, which git states. `program_sha256` is [`crumple_store::program::identity`], and `program_commit` the
    /// commit from which the program was built, if its build states it.
    #[must_use]
    pub fn collect(
        folder: &Path,
        program_sha256: &str,
        program_commit: Option<&str>,
        took: Duration,
    ) -> Self {
        let model = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("model name"))?;
            Some(format!(", {}", line.split_once(':')?.1.trim()))
        });
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let system = std::env::consts::OS;
        let processor = std::env::consts::ARCH;
        Self {
            at: utc::rfc_3339(SystemTime::now()),
            commit: git_commit(folder),
            program_sha256: program_sha256.to_owned(),
            program_commit: program_commit.map(str::to_owned),
            machine: format!(
                "{system} {processor}, {cores} core{}{}",
                if cores == 1 { "" } else { "s" },
                model.unwrap_or_default()
            ),
            duration_s: took.as_secs(),
        }
    }
}

/// Returns the commit of the repository of the assessed files, with a mark if files differ from it; `None` without a
/// repository.
fn git_commit(folder: &Path) -> Option<String> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let commit = git_output(folder, &["rev-parse", "HEAD"])?;
    // `git status` starts the filters that the configuration of a repository names.
    let names_programs = ["--local", "--worktree"].into_iter().any(|scope| {
        let pattern = r"^(filter|include|includeif)\.";
        git_output(folder, &["config", scope, "--get-regexp", pattern]).is_some()
    });
    if names_programs {
        return Some(commit + ", not compared with the files: the repository configures filters");
    }
    let status = [
        "status",
        "--porcelain",
        "--untracked-files=no",
        "--ignore-submodules=all",
    ];
    let is_clean = git_output(folder, &status)?.is_empty();
    Some(commit + if is_clean { "" } else { " with changes" })
}

/// Returns the output of git in a folder, without starting programs that its configuration names; `None` if it fails.
fn git_output(folder: &Path, arguments: &[&str]) -> Option<String> {
    let no_programs = [
        "-c",
        "core.fsmonitor=false",
        "-c",
        "core.hooksPath=/dev/null",
    ];
    let mut command = process::Command::new("git");
    command
        .arg("-C")
        .arg(folder)
        .args(no_programs.iter().chain(arguments));
    // Keeps git from writing the index, which runs hooks, and from fetching, which starts a transport.
    command
        .env("GIT_OPTIONAL_LOCKS", "0")
        .env("GIT_NO_LAZY_FETCH", "1")
        .env("GIT_ALLOW_PROTOCOL", "none");
    let result = command.output().ok()?;
    result
        .status
        .success()
        .then(|| String::from_utf8_lossy(&result.stdout).trim().to_owned())
}
