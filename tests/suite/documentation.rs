//! Commands in the documentation, checked without running them: `.ci/commands` runs them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Returns all files below a folder, or a file itself.
pub(crate) fn files_below(path: PathBuf) -> Vec<PathBuf> {
    match fs::read_dir(&path) {
        Ok(entries) => entries
            .flat_map(|entry| files_below(entry.unwrap().path()))
            .collect(),
        Err(_) => vec![path],
    }
}

fn commands_by_page() -> BTreeMap<String, Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut blocks = BTreeMap::new();
    for folder in [
        "docs",
        "corpora",
        "examples",
        "python",
        "reports",
        "README.md",
        "CONTRIBUTING.md",
    ] {
        for page in files_below(root.join(folder))
            .into_iter()
            .filter(|path| path.extension().is_some_and(|end| end == "md"))
        {
            let text = fs::read_to_string(&page).unwrap();
            let mut kind = None;
            let mut lines = Vec::new();
            for line in text.lines() {
                match (line.strip_prefix("```"), kind) {
                    (Some(after), None) => kind = Some(after),
                    (Some(_), Some(_)) => kind = None,
                    (None, Some("sh")) => lines.push(line),
                    (None, Some("console")) => lines.extend(line.strip_prefix("$ ")),
                    (None, Some(_)) => {}
                    (None, None) => lines.extend(
                        line.strip_suffix("` |")
                            .and_then(|row| row.rsplit('`').next()),
                    ),
                }
            }
            let commands = lines
                .iter()
                .map(|line| line.split(" # ").next().unwrap_or(line).trim().to_owned());
            blocks.insert(
                page.strip_prefix(root).unwrap().display().to_string(),
                commands.collect(),
            );
        }
    }
    blocks
}

/// `.ci/run` runs this block in an empty folder.
#[test]
fn the_readme_begins_with_two_commands_in_a_clone() {
    let commands = &commands_by_page()["README.md"];
    let clone = "git clone https://github.com/crumple-rs/crumple && cd crumple";
    assert_eq!(
        commands[..3],
        [clone, "cargo run --release -- assess", "cargo test"]
    );
}

/// Pages that a help names exist, with the term that the help looks up there.
#[test]
fn pages_that_a_help_names_explain_it() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for file in files_below(root.join("src/cli")) {
        let Ok(source) = fs::read_to_string(&file) else {
            continue;
        };
        for rest in source.split("docs/").skip(1) {
            let Some(name) = rest.split_once(".md").map(|(name, _)| name) else {
                continue;
            };
            if !name.is_empty() && name.chars().all(|c| c.is_ascii_lowercase() || c == '-') {
                assert!(
                    root.join(format!("docs/{name}.md")).is_file(),
                    "{}: docs/{name}.md",
                    file.display()
                );
            }
        }
    }
    let replay = fs::read_to_string(root.join("src/cli/replay.rs"))
        .unwrap()
        .replace(" \\\n", " ");
    let glossary = fs::read_to_string(root.join("docs/glossary.md")).unwrap();
    assert!(replay.contains("(docs/glossary.md): more than 2 m/s²"));
    assert!(
        glossary
            .lines()
            .any(|line| line.starts_with("| unnecessary braking |")
                && line.contains("2 m/s² harder"))
    );
}

/// Figures of FalCAuN_ARCH2026_summary.csv (commit 3b47594), and times between the changes of zlscheck's inputs.
#[test]
fn the_comparison_has_the_published_figures() {
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/comparison.md"))
        .unwrap();
    let words = page.split_whitespace().collect::<Vec<_>>().join(" ");
    for (specification, simulations) in [
        ("AT1", 448),
        ("AT2", 128),
        ("AT6a", 501),
        ("AT6c", 449),
        ("AT6abc", 616),
    ] {
        let row = page
            .lines()
            .find(|line| line.starts_with(&format!("| {specification} |")))
            .unwrap();
        assert!(row.ends_with(&format!(" | {simulations} |")), "{row}");
    }
    for stated in [
        "CC1 198, CC2 38, CC3 61, CC4 474 (all ten)",
        "All figures of 2026 on this page but that of CC4 are half of those of 2024",
        "zlscheck of 0.5 s (AT1, AT51 to AT54), 2.5 s (AT2), 5 s (AT6a), 10 s (AT6b) and 15 s (AT6c)",
    ] {
        assert!(words.contains(stated), "{stated}");
    }
}

/// Claims about collisions that hold with some followers only (`reports/driver.md`).
#[test]
fn claims_about_drivers_name_their_space_and_follower() {
    let read = |page: &str| {
        let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(page)).unwrap();
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    for (page, stated) in [
        (
            "README.md",
            "in the emergencies of the space `followers`, it collides at most as often as `idm`",
        ),
        (
            "README.md",
            "of `high-risk`, in %; `baseline` drives the followers",
        ),
        (
            "README.md",
            "`road` collides less often than `idm`, if its own brake acts at once",
        ),
        (
            "reports/driver.md",
            "If it acts 0.2 s later, `predictive` collides *more* often than `idm` with `human` behind",
        ),
        (
            "docs/limits.md",
            "In `paper` and `high-risk`, `baseline` drives the follower",
        ),
        (
            "docs/commands.md",
            "In `paper` and `high-risk`, `baseline` drives the followers",
        ),
        (
            "docs/commands.md",
            "`followers` and `everyday` have [six kinds of follower, or none]",
        ),
        (
            "reports/driver.md",
            "`baseline` drives the follower in `paper`",
        ),
        (
            "reports/driver.md",
            "Every figure about collisions from behind names the follower",
        ),
        (
            "reports/retraining.md",
            "In `high-risk`, `baseline` drives the follower",
        ),
        (
            "reports/plants-and-sensors.md",
            "`baseline` drives the follower.",
        ),
    ] {
        assert!(read(page).contains(stated), "{page}: {stated}");
    }
    let study = read("reports/aeb-behind.md");
    let begin = "# Emergency braking and rear-end collisions **Withdrawn: the summary and the findings 1 to 3.**";
    assert!(
        study.starts_with(begin) || !study.contains("no brake, brakes after impact"),
        "{begin}"
    );
}

/// `.ci/nightly` trains every committed policy again, except one whose page says that its command gives another policy
/// today, and runs every fuzz target that has seeds.
#[test]
fn tier_3_has_a_part_for_each_policy_and_fuzz_target() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let script = fs::read_to_string(root.join(".ci/nightly")).unwrap();
    let page = fs::read_to_string(root.join("corpora/policy/README.md")).unwrap();
    for policy in files_below(root.join("corpora/policy")) {
        if policy
            .extension()
            .is_some_and(|extension| extension == "safetensors")
        {
            let name = policy.file_stem().unwrap().to_str().unwrap();
            let (_, section) = page
                .split_once(&format!("`{name}.safetensors`"))
                .expect("a section");
            let section = section.split("\n## ").next().unwrap_or_default();
            let is_trained = script.contains(&format!("    \"{name}\": (\""));
            let is_of_an_earlier_release =
                section.contains("today the same command gives another policy");
            assert_ne!(is_trained, is_of_an_earlier_release, "{name}");
        }
    }
    assert!(script.contains("(ROOT / \"corpora/fuzz\").glob(\"*/\")"));
    assert!(
        !script.contains(env!("CARGO_PKG_VERSION")),
        "the version is that of the policies"
    );
}

#[test]
fn every_variable_of_a_command_is_set_on_its_page() {
    for (page, commands) in commands_by_page() {
        for command in &commands {
            for name in command
                .split('$')
                .skip(1)
                .map(|rest| rest.trim_start_matches(['{', '(']))
            {
                let name: String = name
                    .chars()
                    .take_while(|c| c.is_ascii_alphanumeric() || *c == '_')
                    .collect();
                let is_set = commands.iter().any(|line| {
                    line.contains(&format!("for {name} in ")) || line.contains(&format!("{name}="))
                });
                assert!(
                    name.is_empty() || is_set,
                    "{page}: `{command}` needs ${name}, which the page does not set"
                );
            }
        }
    }
}

#[test]
fn every_exception_is_a_command_of_a_page_with_its_reason_and_run_time() {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/commands.toml"))
        .unwrap();
    let list: toml::Table = text.parse().unwrap();
    let pages = commands_by_page();
    for exception in list["exception"].as_array().unwrap() {
        let field = |name: &str| exception.get(name).and_then(toml::Value::as_str);
        let command = field("command").unwrap();
        let is_shown = |(page, commands): (&String, &Vec<String>)| {
            field("page").is_none_or(|named| named == page)
                && commands.iter().any(|shown| shown == command)
        };
        assert!(pages.iter().any(is_shown), "no page shows `{command}`");
        assert!(
            field("reason").is_some() && (field("takes").is_some() || field("until").is_some()),
            "{command}"
        );
    }
    let count = |page: &str| pages[page].len();
    let with_results = count("README.md") + count("reports/paper.md") + count("docs/comparison.md");
    assert!(count("docs/tutorial.md") > 10 && count("docs/commands.md") > 10 && with_results > 10);
}
