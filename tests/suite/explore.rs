//! `crumple explore` in a browser, if there is one, and its end.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command};

use crate::command_line::{
    assert_refused, exit_code, interrupt, run_crumple, run_ok, spawn, stderr, temp_folder,
};

/// Runs `tests/browser/explore.py`. Skipped with a message if Python, chromium or its driver is missing.
#[test]
fn explore_is_driven_in_a_browser() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/explore.py");
    let output = match Command::new("python3")
        .arg(script)
        .arg(env!("CARGO_BIN_EXE_crumple"))
        .output()
    {
        Ok(output) => output,
        Err(error) => return println!("skipped: no python3: {error}"),
    };
    print!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(
        matches!(output.status.code(), Some(0 | 77)),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

fn first_line(child: &mut Child) -> String {
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("piped"))
        .read_line(&mut line)
        .expect("a line");
    line
}

/// The address is the first output, and Ctrl-C ends with success.
#[cfg(unix)]
#[test]
fn explore_prints_its_address_and_ends_with_ctrl_c() {
    for format in ["text", "json"] {
        let mut child = spawn(
            Path::new("."),
            &format!("explore --quiet --format {format}"),
        );
        let line = first_line(&mut child);
        let address = match format {
            "json" => {
                serde_json::from_str::<serde_json::Value>(&line).expect("one object")["address"]
                    .as_str()
                    .expect("text")
                    .to_owned()
            }
            _ => line.trim_end().to_owned(),
        };
        assert!(
            address.starts_with("http://127.0.0.1:") && address.ends_with('/'),
            "{address}"
        );
        assert_eq!(exit_code(&interrupt(child)), 0);
    }
}

#[cfg(unix)]
#[test]
fn explore_opens_a_campaign_that_is_named_first() {
    let folder = temp_folder();
    run_ok(
        folder.path(),
        "falsify --controller idm --budget 1 --out found",
    );
    for (what, page) in [("found paper-1", "/campaigns"), ("paper-1 found", "/")] {
        let mut child = spawn(
            folder.path(),
            &format!("explore {what} --quiet --format json"),
        );
        let line = first_line(&mut child);
        child.kill().expect("it runs");
        child.wait().expect("ends");
        let printed: serde_json::Value = serde_json::from_str(&line).expect("one object");
        let [address, opened] = ["address", "page"].map(|key| printed[key].as_str().expect("text"));
        assert_eq!(
            opened.strip_prefix(address.trim_end_matches('/')),
            Some(page),
            "{line}"
        );
    }
}

#[test]
fn explore_refuses_unsupported_inputs() {
    let folder = temp_folder();
    let refused = |arguments: &str, message: &str| {
        let output = run_crumple(folder.path(), &format!("explore {arguments}"));
        assert_refused(&output, message);
        assert_eq!(stderr(&output).lines().count(), 1, "{}", stderr(&output));
    };
    refused("no-such-scenario", "neither a built-in scenario");
    refused(".", "the folder holds no campaign");
    refused("--controller idm --controller idm", "given twice");
    refused(
        "--controller idm --controller rss --controller baseline --controller policy --controller retrained",
        "at most 4",
    );
}
