//! Names, files and texts of users with special characters for a terminal, Markdown, HTML or a shell.

use crumple_sim::scenario::NoDriverFiles;
use std::fs;
use std::path::Path;

use crumple_core::quoting::{TerminalText, is_hidden};
use crumple_sim::policy::Policy;
use crumple_sim::scenario::{built_in_scenario, file};
use crumple_spaces::{built_in_space, file as space_file};
use pulldown_cmark::{Event, Options, Parser, Tag};
use saphyr::LoadableYamlNode;

use crate::assessments::{config, run};
use crate::command_line::{command, exit_code, temp_folder};

/// For fields that exclude control characters.
const NAME: &str = "a|b <img src=x onerror=alert(1)> `touch PWNED` [x](http://x.y) *z* \
    \u{202e}$(touch PWNED);'\"\\ &amp; \u{2066}";
/// For the name of a space: code in the middle of a name.
const SPACE: &str =
    "a `space` | <b> <img src=x onerror=alert(1)> [x](http://x.y) *z* \u{202e}$(touch PWNED)";
/// For file names.
const FILE: &str = "x\u{1b}]0;PWNED\u{7}\u{9b}2J\n# no contact\n| a | b |\n\u{202e};touch PWNED;# \
    <script>alert(1)<\\script> `'\"";

fn assert_no_hidden_characters(what: &str, text: &str) {
    let hidden = text
        .chars()
        .find(|&letter| is_hidden(letter) && !"\n\t".contains(letter));
    assert!(hidden.is_none(), "{what} holds {hidden:?}: {text}");
}

fn assert_harmless_markdown(text: &str) {
    let (mut columns, mut cells) = (0, 0);
    for event in Parser::new_ext(text, Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH) {
        match event {
            Event::Html(found) | Event::InlineHtml(found) => panic!("HTML: {found}"),
            Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
                panic!("a link to {dest_url}")
            }
            Event::Start(Tag::Emphasis) => panic!("emphasis"),
            Event::Start(Tag::Table(set)) => columns = set.len(),
            Event::Start(Tag::TableHead | Tag::TableRow) => cells = 0,
            Event::Start(Tag::TableCell) => cells += 1,
            Event::End(pulldown_cmark::TagEnd::TableRow) => {
                assert_eq!(cells, columns, "cells of a row")
            }
            _ => {}
        }
    }
    // Parsers silently repair a row with more bars than its header.
    let bars = |line: &str| {
        line.replace("\\\\", "")
            .replace("\\|", "")
            .matches('|')
            .count()
    };
    let mut expected = None;
    for line in text.lines() {
        expected = match (line.starts_with('|'), expected) {
            (false, _) => None,
            (true, None) => Some(bars(line)),
            (true, Some(many)) => {
                assert_eq!(bars(line), many, "{line}");
                Some(many)
            }
        };
    }
}

fn hostile_folder() -> tempfile::TempDir {
    let folder = temp_folder();
    let write =
        |name: &str, text: &[u8]| fs::write(folder.path().join(name), text).expect("writes");
    write(&format!("{FILE}.safetensors"), Policy::reference_bytes());
    let mut space = built_in_space("high-risk")
        .expect("built in")
        .spec()
        .clone();
    (space.name, space.about) = (SPACE.to_owned(), format!("# {NAME}\n<!-- {FILE}"));
    write(
        &format!("{FILE}.toml"),
        toml::to_string(&space).expect("TOML").as_bytes(),
    );
    let scenario = built_in_scenario("paper-2")
        .expect("built in")
        .edited(|spec| spec.name = NAME.to_owned())
        .expect("valid");
    fs::create_dir(folder.path().join("scenarios")).expect("made");
    write(
        &format!("scenarios/{FILE}.toml"),
        file::to_toml(&scenario).expect("TOML").as_bytes(),
    );
    write(&format!("{FILE}.csv"), b"nonsense\n");
    let (_, kernel) = crumple_evidence::shipped_kernels().remove(0);
    let kernel = serde_json::to_vec(&kernel).expect("JSON");
    write(&format!("{FILE}.json"), &kernel);
    folder
}

/// A code span with a part of a name would end in the middle of the name.
fn assert_whole_names_in_code(text: &str) {
    let code = Parser::new_ext(text, Options::ENABLE_TABLES).filter_map(|event| match event {
        Event::Code(code) => Some(code.into_string()),
        _ => None,
    });
    let code: Vec<String> = code.collect();
    let shown = TerminalText(&SPACE.replace('`', "'")).to_string();
    assert!(code.contains(&shown), "{shown} is in no code span");
    for part in ["a", "a ", "space"] {
        assert!(!code.contains(&part.to_owned()), "`{part}` of a name");
    }
}

#[test]
fn reports_show_hostile_names_as_text() {
    let folder = hostile_folder();
    let (policy, space) = (format!("{FILE}.safetensors"), format!("{FILE}.toml"));
    let mut asked = config(&["baseline", &policy, &format!("shield,ahead=8:{policy}")]);
    (asked.distributions, asked.search.spaces) = (Some(vec![space.clone()]), Some(vec![space]));
    (
        asked.search.budget,
        asked.everyday_draws,
        asked.scenarios,
        asked.certificates,
    ) = (
        20,
        4,
        vec!["scenarios".into()],
        Some(vec![format!("{FILE}.json").into()]),
    );
    let assessment = run(asked, folder.path());
    let files = assessment.files().expect("renders");
    let text = |wanted: &str| {
        let (name, bytes) = files
            .iter()
            .find(|(name, _)| name == wanted)
            .expect("written");
        let text = String::from_utf8(bytes.clone()).expect("text");
        assert_no_hidden_characters(name, &text);
        text
    };
    let markdown = text("assessment.md");
    assert_harmless_markdown(&markdown);
    assert_whole_names_in_code(&markdown);
    // In prose, backticks begin and end code.
    let mut controllers = assessment.summary.controllers.iter();
    assert!(controllers.all(|name| !name.contains('`')));
    for name in ["assessment.html", "assessment.junit.xml"] {
        let text = text(name);
        for raw in ["<img src=x", "<script>alert", "<!-- x"] {
            assert!(!text.contains(raw), "{name} holds {raw}");
        }
    }
    saphyr::Yaml::load_from_str(&text("assessment.gsn.yaml")).expect("YAML");
    assert_no_hidden_characters(
        "the first page",
        &crumple_core::quoting::TerminalLines(&assessment.first_page.to_plain_text()).to_string(),
    );
    let replayed = files
        .iter()
        .find(|(name, _)| name == "replay.sh")
        .expect("written");
    for line in String::from_utf8_lossy(&replayed.1)
        .lines()
        .filter(|line| line.starts_with("run "))
    {
        let words = shlex::split(line).expect("words of a shell");
        // A shell pattern finds the certificates, whose names the report chooses.
        let others = if line == "run check certificates/*.json" {
            "-_./*"
        } else {
            "-_./,=:"
        };
        let is_harmless = |letter: char| letter.is_ascii_alphanumeric() || others.contains(letter);
        assert!(
            words.iter().all(|word| word.chars().all(is_harmless)),
            "{line}"
        );
    }
    for (name, _) in &files {
        assert!(
            name.chars()
                .all(|letter| letter.is_ascii_alphanumeric() || "-_./".contains(letter)),
            "{name}"
        );
    }
}

/// Standard output and error of every command, as text and as JSON, including errors.
#[test]
fn terminals_show_hostile_names_as_text() {
    let folder = hostile_folder();
    let (policy, space) = (format!("{FILE}.safetensors"), format!("{FILE}.toml"));
    let scenario = format!("scenarios/{FILE}.toml");
    let broken = format!("scenarios/{FILE}.json");
    fs::write(
        folder.path().join(&broken),
        format!("{{\"{}\": 1}}", NAME.escape_default()),
    )
    .expect("writes");
    let missing = format!("{FILE}/nowhere.toml");
    let recording = format!("{FILE}.csv");
    let (policy, space, scenario) = (policy.as_str(), space.as_str(), scenario.as_str());
    let commands: &[(i32, &[&str])] = &[
        (0, &["simulate", scenario, "--controller", policy]),
        (
            0,
            &[
                "simulate",
                scenario,
                "--controller",
                policy,
                "--format",
                "json",
            ],
        ),
        (
            1,
            &[
                "simulate",
                scenario,
                "--controller",
                "baseline",
                "--expect",
                "safe",
            ],
        ),
        (0, &["avoid", scenario]),
        (0, &["avoid", scenario, "--format", "json"]),
        (
            0,
            &[
                "worst-case",
                scenario,
                "--controller",
                policy,
                "--budget",
                "3",
            ],
        ),
        (
            0,
            &[
                "falsify",
                "--controller",
                policy,
                "--space",
                space,
                "--budget",
                "10",
                "--out",
                FILE,
            ],
        ),
        (0, &["fsck", FILE]),
        (
            2,
            &[
                "falsify",
                "--controller",
                policy,
                "--space",
                space,
                "--budget",
                "10",
                "--out",
                FILE,
            ],
        ),
        (
            0,
            &[
                "falsify",
                "--controller",
                policy,
                "--space",
                space,
                "--budget",
                "10",
                "--format",
                "json",
            ],
        ),
        (2, &["simulate", &missing]),
        (2, &["simulate", &broken]),
        (2, &["simulate", "paper-1", "--controller", FILE]),
        (2, &["simulate", "paper-1", "--spec", FILE]),
        (2, &["falsify", "--controller", "idm", "--space", FILE]),
        (2, &["import", &recording]),
        (2, &["check", &recording]),
        (2, &["assess", scenario]),
        (2, &[FILE]),
    ];
    for (expected, arguments) in commands {
        let output = command(folder.path(), "")
            .args(*arguments)
            .output()
            .expect("starts");
        let (message, noted) = (
            String::from_utf8(output.stdout.clone()),
            String::from_utf8(output.stderr.clone()),
        );
        let (message, noted) = (message.expect("text"), noted.expect("text"));
        assert_eq!(exit_code(&output), *expected, "{arguments:?}: {noted}");
        assert_no_hidden_characters(&format!("{arguments:?}"), &(message.clone() + &noted));
        if arguments.contains(&"json") {
            message.lines().for_each(|line| {
                drop(serde_json::from_str::<serde_json::Value>(line).expect("JSON"))
            });
        } else {
            // The usage error repeats arguments literally, including line breaks.
            let is_usage = noted.contains("For more information, try '--help'");
            let forged = (message + &noted)
                .lines()
                .any(|line| line.starts_with("# no contact"));
            assert!(!forged || is_usage, "{arguments:?}");
        }
        if *expected == 2
            && arguments.len() > 1
            && arguments[0] != "falsify"
            && arguments[1] != "paper-1"
        {
            assert_eq!(noted.lines().count(), 1, "{arguments:?}: {noted}");
        }
    }
    assert!(!Path::new("PWNED").exists() && !folder.path().join("PWNED").exists());
}

#[test]
fn a_space_reads_back_with_its_words() {
    let folder = hostile_folder();
    let read = space_file::load(&folder.path().join(format!("{FILE}.toml")), &NoDriverFiles)
        .expect("valid");
    assert!(
        read.spec().about.contains("<!-- x\u{1b}"),
        "no name is changed but where it is shown"
    );
}
