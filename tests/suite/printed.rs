//! Printed pages: folded content is printed, and units stay with their numbers.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::command_line::{run_ok, temp_folder};

/// Elements that are useless on paper: links, and narrow forms of figures, which are printed in their wide form.
const NOT_PRINTED: [&str; 2] = ["nav", ".worst .draw-narrow"];

/// Returns the committed report, which another test compares with what `crumple assess` writes.
fn committed_report() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("reports/assessment.html"))
        .unwrap()
}

/// Returns the print-only rules of a page's style, as selectors and declarations.
fn print_rules(page: &str) -> Vec<(&str, &str)> {
    let (_, style) = page.split_once("<style>").unwrap();
    let (style, _) = style.split_once("</style>").unwrap();
    let of_block = |block: &'static str| {
        style
            .split(block)
            .skip(1)
            .filter_map(|rest| rest.split_once("}}"))
    };
    of_block("@media print{")
        .flat_map(|(block, _)| block.split('}'))
        .filter_map(|rule| rule.trim().split_once('{'))
        .collect()
}

fn assert_prints_everything(page: &str, folded: usize) {
    assert!(page.matches("<details").count() >= folded);
    let rules = print_rules(page);
    assert!(
        rules.contains(&("details::details-content", "content-visibility:visible")),
        "{rules:?}"
    );
    for (selectors, declarations) in &rules {
        if ["display:none", "visibility:hidden", "overflow:hidden"]
            .iter()
            .any(|hides| declarations.contains(hides))
        {
            assert!(
                selectors
                    .split(',')
                    .all(|selector| NOT_PRINTED.contains(&selector)),
                "{selectors} is not printed"
            );
        }
    }
    let units = ["m/s,", "m/s", "m/s²", "m,", "m", "s,", "s", "%"];
    let mut verbatim = None;
    for (tag, text) in page.split('<').filter_map(|piece| piece.split_once('>')) {
        match (verbatim, tag.split(' ').next()) {
            (None, Some(name @ ("code" | "script" | "style" | "svg"))) => verbatim = Some(name),
            (Some(name), Some(end)) if end.strip_prefix('/') == Some(name) => verbatim = None,
            _ => {}
        }
        let words: Vec<&str> = if verbatim.is_none() {
            text.split(' ').collect()
        } else {
            Vec::new()
        };
        let is_broken = |pair: &&[&str]| {
            pair[0].ends_with(|c: char| c.is_ascii_digit()) && units.contains(&pair[1])
        };
        assert_eq!(
            words.windows(2).find(is_broken),
            None,
            "a line may end between a number and its unit"
        );
    }
}

/// Prints a page if there is a Chromium, and checks that each of its texts is on paper; beside an `assessment.json`,
/// also identity, strengths and gates.
fn print_in_browser(file: &Path) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/printed.py");
    let output = match Command::new("python3").arg(script).arg(file).output() {
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

#[test]
fn a_report_prints_everything() {
    assert_prints_everything(&committed_report(), 42);
}

mod tier_2 {
    use super::*;

    #[test]
    #[ignore = "tier 2: a browser prints a page of two megabytes"]
    fn a_browser_prints_everything_of_a_report() {
        let folder = temp_folder();
        let file = folder.path().join("page.html");
        fs::write(&file, committed_report()).unwrap();
        print_in_browser(&file);
    }

    #[test]
    #[ignore = "tier 2: a browser prints a report"]
    fn a_printed_report_states_identity_strengths_and_gates() {
        let folder = temp_folder();
        let config = "version = 1\ncontrollers = [\"idm\", \"acc-aeb\"]\ndraws = 50\neveryday_draws = 10\n\
                      search = { budget = 20 }\n[[gates]]\nrequire = \"proofs-accepted\"\n[[gates]]\nrequire = \
                      \"rate-not-above\"\ncontroller = \"acc-aeb\"\nthan = \"idm\"\n";
        fs::write(folder.path().join("a.toml"), config).unwrap();
        run_ok(folder.path(), "assess a.toml --out report");
        print_in_browser(&folder.path().join("report/assessment.html"));
    }
}
