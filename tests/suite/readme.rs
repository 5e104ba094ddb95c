//! Values of README.md against their sources.

use std::fs;
use std::path::Path;
use std::process::Command;

struct FigureRow {
    figure: String,
    value: String,
    command: String,
}

enum FigureSource {
    /// Output of a command that takes about a second; numbers follow these texts.
    Printed(&'static [&'static str]),
    /// Rows of the committed report, which another test compares with `crumple assess`, and the text before each
    /// number.
    Report(&'static [(&'static str, &'static str)]),
    /// Output of a slow command.
    Slow(fn(&str) -> Vec<f64>),
    /// Measured time or memory of a machine, which is not reproducible.
    Machine,
}

/// Source of each row, identified by the first words of the row.
const SOURCES: [(&str, FigureSource); 13] = [
    (
        "contacts of the baseline",
        FigureSource::Report(&[("| no contact in 1000 draws of `paper` (seed 0) |", "refuted: ")]),
    ),
    (
        "contacts of `policy`",
        FigureSource::Report(&[
            ("| no contact in 1000 draws of `paper` (seed 0) |", "tested: "),
            ("| no contact in the paper's scenarios |", "tested: "),
        ]),
    ),
    ("`train --preset fast", FigureSource::Machine),
    ("Chasing Cars", FigureSource::Slow(mean_evaluations)),
    ("first contact", FigureSource::Printed(&["COLLISION at "])),
    ("smallest gap", FigureSource::Printed(&["smallest gap of the escape ", "no driver keeps more than "])),
    ("share of the boxes", FigureSource::Report(&[("| reach-paper-1 |", "✓ from "), ("| reach-paper-2 |", "✓ from ")])),
    ("four problems", FigureSource::Slow(known_probability_figures)),
    ("largest memory", FigureSource::Machine),
    (
        "contacts with a leader",
        FigureSource::Slow(|printed| {
            numbers_after(printed, &["full-throttle: ", "random-actions: ", "policy: ", "interventions), "])
        }),
    ),
    ("one vehicle-step, baseline, lockstep engine, one core, true state", FigureSource::Machine),
    ("one vehicle-step, baseline, lockstep engine, one core, Kalman filter", FigureSource::Machine),
    ("two cores against one", FigureSource::Machine),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn figure_rows() -> Vec<FigureRow> {
    let text = fs::read_to_string(root().join("README.md")).unwrap();
    let (_, table) = text.split_once("\n## Figures\n").unwrap();
    let (table, _) = table.split_once("\n## ").unwrap();
    let row = |line: &str| {
        let [figure, value, command] = line.trim_matches(['|', ' ']).split(" | ").collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        FigureRow { figure: figure.to_owned(), value: value.to_owned(), command: command.trim_matches('`').to_owned() }
    };
    table.lines().filter(|line| line.starts_with("| ")).skip(1).map(row).collect()
}

/// Returns the numbers of a text, in which a space may separate groups of three digits.
fn parse_numbers(text: &str) -> Vec<f64> {
    let is_digits = |word: &str| word.chars().all(|c| c.is_ascii_digit());
    let mut found = Vec::new();
    let mut group = String::new();
    for word in text.split_whitespace() {
        let bare = word.trim_matches(['[', ']', '(', ')', ',', ';', '.', '|', ':']);
        let joined = if bare.len() == 3 && is_digits(bare) { format!("{group}{bare}") } else { bare.to_owned() };
        let Ok(number) = joined.parse::<f64>() else {
            group.clear();
            continue;
        };
        if !group.is_empty() && joined.len() > bare.len() {
            found.pop();
        }
        found.push(number);
        group = if is_digits(word) { joined } else { String::new() };
    }
    found
}

fn numbers_after(text: &str, marks: &[&str]) -> Vec<f64> {
    let mut places: Vec<usize> =
        marks.iter().flat_map(|mark| text.match_indices(mark).map(|(at, _)| at + mark.len())).collect();
    places.sort_unstable();
    places
        .iter()
        .filter_map(|&place| parse_numbers(text[place..].lines().next()?.split([',', ')']).next()?).first().copied())
        .collect()
}

/// Returns the largest error in per cent, the number of intervals that contain the truth, all intervals, and the most
/// runs.
fn known_probability_figures(printed: &str) -> Vec<f64> {
    let lines = || printed.lines().filter(|line| line.contains(" by Splitting: "));
    let ratios = lines().flat_map(|line| parse_numbers(line.split_once("ratios ").unwrap().1));
    let error_percent = ratios.map(|ratio| (100.0 * (ratio - 1.0).abs()).round()).fold(0.0, f64::max);
    let field = |index: usize| lines().map(move |line| parse_numbers(line.split(", ").nth(index).unwrap()));
    let [held, all] = [0, 1].map(|index| field(2).map(|numbers| numbers[index]).sum());
    vec![error_percent, held, all, field(3).map(|numbers| numbers[0]).fold(0.0, f64::max)]
}

fn mean_evaluations(printed: &str) -> Vec<f64> {
    let means =
        printed.lines().filter_map(|line| line.strip_suffix(" evaluations to the first that holds at both steps"));
    means.filter_map(|line| parse_numbers(line).last().copied()).collect()
}

fn run_shell(command: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_crumple")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let folder = if command.contains("cargo ") { root() } else { folder.path() };
    let output = Command::new("bash").args(["-c", command]).current_dir(folder).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn figure_source(row: &FigureRow) -> &'static FigureSource {
    let mut found = SOURCES.iter().filter(|(figure, _)| row.figure.starts_with(figure));
    let Some((_, source)) = found.next() else { panic!("no source of: {}", row.figure) };
    assert!(found.next().is_none(), "two sources of: {}", row.figure);
    source
}

#[test]
fn figures_are_those_of_their_commands() {
    let report = fs::read_to_string(root().join("reports/assessment.md")).unwrap();
    let rows = figure_rows();
    assert_eq!(rows.len(), SOURCES.len());
    for row in rows {
        let printed = match figure_source(&row) {
            FigureSource::Printed(marks) if cfg!(unix) => numbers_after(&run_shell(&row.command), marks),
            FigureSource::Report(places) => {
                let number = |(row, mark): &(&str, &str)| {
                    let row = report.lines().find(|line| line.starts_with(row))?;
                    numbers_after(row, &[mark]).first().copied()
                };
                places.iter().filter_map(number).collect()
            }
            FigureSource::Printed(_) | FigureSource::Slow(_) | FigureSource::Machine => continue,
        };
        assert_eq!(parse_numbers(&row.value), printed, "{} (`{}`)", row.figure, row.command);
    }
}

/// `cargo test --release --test suite -- --ignored figures_that_take_long`.
#[cfg(unix)]
#[test]
#[ignore = "15 minutes"]
fn figures_that_take_long_are_those_of_their_commands() {
    for row in figure_rows() {
        if let FigureSource::Slow(printed) = figure_source(&row) {
            assert_eq!(
                parse_numbers(&row.value),
                printed(&run_shell(&row.command)),
                "{} (`{}`)",
                row.figure,
                row.command
            );
        }
    }
}

#[test]
fn claims_that_the_documentation_quotes_are_those_of_the_report() {
    let [page, report] =
        ["docs/commands.md", "reports/assessment.md"].map(|name| fs::read_to_string(root().join(name)).unwrap());
    let quoted = page
        .lines()
        .skip_while(|line| !line.starts_with("| claim |"))
        .skip(2)
        .take_while(|line| line.starts_with("| "));
    let mut compared = 0;
    for row in quoted {
        let (claim, cells) = row.trim_start_matches("| ").split_once(" | ").unwrap();
        if let Some(source) = report.lines().find(|line| line.starts_with(&format!("| {claim}"))) {
            let there = parse_numbers(source);
            let missing = parse_numbers(cells).into_iter().find(|number| !there.contains(number));
            assert_eq!(missing, None, "{row}\n{source}");
            compared += 1;
        }
    }
    assert!(compared >= 4, "{compared} rows of docs/commands.md are in the report");
}

#[test]
fn numbers_of_a_text_are_found() {
    assert_eq!(
        parse_numbers("5.51 s, CC1 2.9; 92 777 of paper-1, 100 %. 8.35 of 8.39 m, 0 and 90"),
        [5.51, 2.9, 92777.0, 100.0, 8.35, 8.39, 0.0, 90.0]
    );
    assert_eq!(numbers_after("a 3 m, b 4\na 5.0", &["a ", "b "]), [3.0, 4.0, 5.0]);
}
