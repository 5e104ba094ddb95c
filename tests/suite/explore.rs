//! `crumple explore` in a browser, if there is one, and its end.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::command_line::{exit_code, run_crumple, temp_folder};

/// Runs `tests/browser/explore.py`. Skipped with a message if Python, chromium or its driver is missing.
#[test]
fn explore_is_driven_in_a_browser() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/explore.py");
    let output = match Command::new("python3").arg(script).arg(env!("CARGO_BIN_EXE_crumple")).output() {
        Ok(output) => output,
        Err(error) => return println!("skipped: no python3: {error}"),
    };
    print!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(matches!(output.status.code(), Some(0 | 77)), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The address is the first output, and Ctrl-C ends with success.
#[cfg(unix)]
#[test]
fn explore_prints_its_address_and_ends_with_ctrl_c() {
    for format in ["text", "json"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
        command.args(["explore", "--quiet", "--format", format]).stdout(Stdio::piped());
        let mut child = command.spawn().expect("starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
        let address = match format {
            "json" => serde_json::from_str::<serde_json::Value>(&line).expect("one object")["address"]
                .as_str()
                .expect("text")
                .to_owned(),
            _ => line.trim_end().to_owned(),
        };
        assert!(address.starts_with("http://127.0.0.1:") && address.ends_with('/'), "{address}");
        let interrupted = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill is there");
        assert!(interrupted.success());
        assert_eq!(child.wait().expect("ends").code(), Some(0));
    }
}

#[cfg(unix)]
#[test]
fn explore_opens_a_campaign_that_is_named_first() {
    let folder = temp_folder();
    let search = ["falsify", "--controller", "idm", "--budget", "1", "--out", "found"];
    assert_eq!(exit_code(&run_crumple(folder.path(), &search)), 0);
    for (what, page) in [(["found", "paper-1"], "/campaigns"), (["paper-1", "found"], "/")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_crumple"));
        command.arg("explore").args(what).args(["--quiet", "--format", "json"]).current_dir(folder.path());
        let mut child = command.stdout(Stdio::piped()).spawn().expect("starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
        child.kill().expect("it runs");
        child.wait().expect("ends");
        let printed: serde_json::Value = serde_json::from_str(&line).expect("one object");
        let [address, opened] = ["address", "page"].map(|key| printed[key].as_str().expect("text"));
        assert_eq!(opened.strip_prefix(address.trim_end_matches('/')), Some(page), "{line}");
    }
}

#[test]
fn explore_refuses_unsupported_inputs() {
    let folder = temp_folder();
    let refused = |arguments: &[&str], message: &str| {
        let output = run_crumple(folder.path(), &[&["explore"], arguments].concat());
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(exit_code(&output) == 2 && text.contains(message) && text.lines().count() == 1, "{text}");
    };
    refused(&["no-such-scenario"], "neither a built-in scenario");
    refused(&["."], "the folder holds no campaign");
    refused(&["--out", "nowhere"], "no such folder");
    refused(&["--controller", "idm", "--controller", "idm"], "given twice");
    refused(
        &[
            "--controller",
            "idm",
            "--controller",
            "rss",
            "--controller",
            "baseline",
            "--controller",
            "policy",
            "--controller",
            "retrained",
        ],
        "at most 4",
    );
}
