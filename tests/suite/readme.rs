//! Measured results of README.md and two other pages against their sources.

use std::fs;
use std::path::Path;
use std::process::Command;

/// A row of the table of figures.
struct Row {
    figure: String,
    value: String,
    command: String,
}

/// The source of the numbers in a row.
enum Source {
    /// A command that takes about a second; numbers follow these texts.
    Printed(&'static [&'static str]),
    /// Rows of the committed report, which another test compares with what `crumple assess` writes, and the text
    /// before each number.
    Report(&'static [(&'static str, &'static str)]),
    /// Command, which takes longer.
    Slow(fn(&str) -> Vec<f64>),
    /// A clock of a machine, so that no two runs agree.
    Machine,
}

/// The source of each row, which begins with the text beside it.
const SOURCES: [(&str, Source); 9] = [
    (
        "collisions in 1000",
        Source::Report(&[
            (
                "| no collision in 1000 random scenarios of `paper` (seed 0) |",
                "✗ ",
            ),
            (
                "| no collision in 1000 random scenarios of `paper` (seed 0) |",
                "✓ ",
            ),
            ("| no collision in the paper's scenarios |", "✓ "),
        ]),
    ),
    (
        "collisions in 200",
        Source::Report(&[
            ("| idm |", "| idm | "),
            ("| acc-aeb |", "| acc-aeb | "),
            ("| predictive |", "| predictive | "),
            ("| road |", "| road | "),
        ]),
    ),
    (
        "collisions with an arbitrary leader",
        Source::Slow(|printed| {
            after(
                printed,
                &[
                    "full-throttle: ",
                    "random-actions: ",
                    "policy: ",
                    "interventions), ",
                ],
            )
        }),
    ),
    ("multilevel splitting", Source::Slow(known_probabilities)),
    ("one vehicle-step", Source::Machine),
    ("first collision", Source::Printed(&["COLLISION at "])),
    (
        "smallest gap",
        Source::Printed(&["smallest gap of the escape ", "no driver keeps more than "]),
    ),
    (
        "share of the boxes",
        Source::Report(&[("| reach-paper-1 |", "✓ "), ("| reach-paper-2 |", "✓ ")]),
    ),
    ("Chasing Cars", Source::Slow(chasing_cars)),
];

/// The pages with a table of measured results.
const PAGES: [&str; 3] = ["README.md", "reports/paper.md", "docs/comparison.md"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rows() -> Vec<Row> {
    PAGES.iter().flat_map(|page| rows_of(page)).collect()
}

/// Returns the rows of the table of measured results on a page.
fn rows_of(page: &str) -> Vec<Row> {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let (_, table) = text.split_once("\n## Measured results\n").unwrap();
    let table = table.split("\n## ").next().unwrap();
    let row = |line: &str| {
        let [figure, value, command] = line
            .trim_matches(['|', ' '])
            .split(" | ")
            .collect::<Vec<_>>()[..]
        else {
            panic!("{line}")
        };
        Row {
            figure: figure.to_owned(),
            value: value.to_owned(),
            command: command.trim_matches('`').to_owned(),
        }
    };
    table
        .lines()
        .filter(|line| line.starts_with("| "))
        .skip(1)
        .map(row)
        .collect()
}

/// Returns the numbers of a text, in which a space may stand between groups of three digits.
fn numbers(text: &str) -> Vec<f64> {
    let is_digits = |word: &str| word.chars().all(|c| c.is_ascii_digit());
    let mut problems = Vec::new();
    let mut group = String::new();
    for word in text.split_whitespace() {
        let bare = word.trim_matches(['[', ']', '(', ')', ',', ';', '.', '|', ':']);
        let joined = if bare.len() == 3 && is_digits(bare) {
            format!("{group}{bare}")
        } else {
            bare.to_owned()
        };
        let Ok(number) = joined.parse::<f64>() else {
            group.clear();
            continue;
        };
        if !group.is_empty() && joined.len() > bare.len() {
            problems.pop();
        }
        problems.push(number);
        group = if is_digits(word) {
            joined
        } else {
            String::new()
        };
    }
    problems
}

/// Returns the number behind each occurrence of one of these texts, from left to right.
fn after(text: &str, marks: &[&str]) -> Vec<f64> {
    let mut places: Vec<usize> = marks
        .iter()
        .flat_map(|mark| text.match_indices(mark).map(|(at, _)| at + mark.len()))
        .collect();
    places.sort_unstable();
    places
        .iter()
        .filter_map(|&index| {
            numbers(text[index..].lines().next()?.split([',', ')']).next()?)
                .first()
                .copied()
        })
        .collect()
}

/// Returns intervals that hold the truth, all intervals, their level, and the smallest and largest saving of runs.
fn known_probabilities(printed: &str) -> Vec<f64> {
    let (mut counts, mut savings) = ([0.0; 2], Vec::new());
    for words in printed
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>())
    {
        let before = |word: &str, distance: usize| -> Option<f64> {
            words[words
                .iter()
                .position(|column| *column == word)?
                .checked_sub(distance)?]
            .parse()
            .ok()
        };
        if let (Some(held), Some(all), Some(saving)) =
            (before("held,", 3), before("held,", 1), before("times", 1))
        {
            counts = [counts[0] + held, counts[1] + all];
            savings.push(saving);
        }
    }
    let least = savings.iter().copied().fold(f64::INFINITY, f64::min);
    vec![
        counts[0],
        counts[1],
        95.0,
        least,
        savings.into_iter().fold(0.0, f64::max),
    ]
}

/// Returns the mean number of evaluations of each problem by `auto`.
fn chasing_cars(printed: &str) -> Vec<f64> {
    let rows = printed.lines().filter(|line| line.starts_with("| CC"));
    rows.filter_map(|line| line.split('|').nth(3)?.trim().parse().ok())
        .collect()
}

fn run(command: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_crumple")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let folder = if command.contains("cargo ") {
        root()
    } else {
        folder.path()
    };
    let output = Command::new("bash")
        .args(["-c", command])
        .current_dir(folder)
        .env("PATH", path)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{command}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn source(row: &Row) -> &'static Source {
    let mut values = SOURCES
        .iter()
        .filter(|(figure, _)| row.figure.starts_with(figure));
    let Some((_, source)) = values.next() else {
        panic!("no source of: {}", row.figure)
    };
    assert!(values.next().is_none(), "two sources of: {}", row.figure);
    source
}

#[test]
fn figures_are_those_of_their_commands() {
    let report = fs::read_to_string(root().join("reports/assessment.md")).unwrap();
    let rows = rows();
    assert_eq!(rows.len(), SOURCES.len());
    for row in rows {
        let printed = match source(&row) {
            Source::Printed(marks) if cfg!(unix) => after(&run(&row.command), marks),
            Source::Report(places) => {
                let number = |(row, mark): &(&str, &str)| {
                    let row = report.lines().find(|line| line.starts_with(row))?;
                    after(row, &[mark]).first().copied()
                };
                places.iter().filter_map(number).collect()
            }
            Source::Printed(_) | Source::Slow(_) | Source::Machine => continue,
        };
        assert_eq!(
            numbers(&row.value),
            printed,
            "{} (`{}`)",
            row.figure,
            row.command
        );
    }
}

/// `cargo test --release --test suite -- --ignored figures_that_take_long`.
#[cfg(unix)]
#[test]
#[ignore = "15 minutes"]
fn figures_that_take_long_are_those_of_their_commands() {
    for row in rows() {
        if let Source::Slow(printed) = source(&row) {
            assert_eq!(
                numbers(&row.value),
                printed(&run(&row.command)),
                "{} (`{}`)",
                row.figure,
                row.command
            );
        }
    }
}

/// The page of commands quotes rows of the built-in report.
#[test]
fn claims_that_the_documentation_quotes_are_those_of_the_report() {
    let [page, report] = ["docs/commands.md", "reports/assessment.md"]
        .map(|name| fs::read_to_string(root().join(name)).unwrap());
    let quoted = page
        .lines()
        .skip_while(|line| !line.starts_with("| claim |"))
        .skip(2)
        .take_while(|line| line.starts_with("| "));
    let mut compared = 0;
    for row in quoted {
        let (claim, cells) = row.trim_start_matches("| ").split_once(" | ").unwrap();
        if let Some(source) = report
            .lines()
            .find(|line| line.starts_with(&format!("| {claim}")))
        {
            let there = numbers(source);
            let missing = numbers(cells)
                .into_iter()
                .find(|number| !there.contains(number));
            assert_eq!(missing, None, "{row}\n{source}");
            compared += 1;
        }
    }
    assert!(
        compared >= 4,
        "{compared} rows of docs/commands.md are in the report"
    );
}

#[test]
fn numbers_of_a_text_are_found() {
    assert_eq!(
        numbers("5.51 s, CC1 2.9; 92 777 of paper-1, 100 %. 8.35 of 8.39 m, 0 and 90"),
        [5.51, 2.9, 92777.0, 100.0, 8.35, 8.39, 0.0, 90.0]
    );
    assert_eq!(after("a 3 m, b 4\na 5.0", &["a ", "b "]), [3.0, 4.0, 5.0]);
}
