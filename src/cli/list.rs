//! `crumple list`: names of built-in items.

use std::fmt::Write;
use std::io::{self, IsTerminal};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::output_format::OutputFormat;
use super::{CliError, output};
use crumple_search::falsify::Method;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::built_in_scenario_names;
use crumple_spaces::{BUILT_IN_SPACES, VARIANT_SPACES};

const SHIELD_ENTRY: (&str, &str) = (
    "shield:policy",
    "the controller policy with a shield, which brakes fully if the command of the controller would leave the safety \
     kernel; shield: can stand before any controller",
);

const TWO_SIDED_SHIELD_ENTRY: (&str, &str) = (
    "shield2:policy",
    "the controller policy with a two-sided shield, which passes a command only if a plan remains that avoids \
     collisions with the leader and with a follower of the stated class; shield2: can stand before any controller",
);

const FILE_ENTRY: (&str, &str) = (
    "FILE",
    "a policy, a network (F.onnx, F.zip of Stable-Baselines3), an FMU (F.fmu), or a controller file (F.toml) that \
     states its inputs and outputs: docs/controllers.md; `crumple describe F.zip` prints a starter file",
);

const SETTING_ENTRY: (&str, &str) = (
    "NAME,SETTING=VALUE",
    "a controller of this list with another value of a setting; (off): the value switches the setting off; meanings of \
     settings: crates/sim/src/scenario/scenario.schema.json",
);

/// List the built-in scenarios, controllers, scenario spaces and search methods
///
/// `crumple show NAME` prints a scenario, a scenario space, a vehicle class, a preset, a suite or a map as a file.
#[derive(Args)]
pub(super) struct ListCommand {
    /// Items to list [default: all kinds]
    what: Option<Catalogue>,
    /// List the built-in controllers that serve tests and comparisons, too
    #[arg(long)]
    all: bool,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Catalogue {
    /// Scenarios that `simulate` and `assess` know by name
    Scenarios,
    /// Controllers that can be put under test
    Controllers,
    /// Distributions of scenarios, for searches and random scenarios
    Spaces,
    /// Search methods
    Methods,
}

#[derive(Serialize)]
struct CatalogueEntry {
    name: &'static str,
    summary: String,
}

impl From<(&'static str, &str)> for CatalogueEntry {
    fn from((name, summary): (&'static str, &str)) -> Self {
        Self {
            name,
            summary: summary.to_owned(),
        }
    }
}

impl Catalogue {
    fn title(self) -> &'static str {
        match self {
            Self::Scenarios => "scenarios",
            Self::Controllers => "controllers",
            Self::Spaces => "spaces",
            Self::Methods => "methods",
        }
    }

    /// Returns the items; those that serve tests only if `all` is true.
    fn entries(self, all: bool) -> Vec<CatalogueEntry> {
        match self {
            Self::Scenarios => built_in_scenario_names().map(CatalogueEntry::from).into(),
            Self::Controllers => {
                let controllers = match all {
                    true => BuiltInController::all(),
                    false => BuiltInController::all_that_drive(),
                };
                let mut entries: Vec<_> = controllers.iter().map(controller_entry).collect();
                let presets = BuiltInController::presets();
                entries.extend(presets.map(|preset| (preset.name, preset.summary).into()));
                entries.push(SHIELD_ENTRY.into());
                entries.push(TWO_SIDED_SHIELD_ENTRY.into());
                entries
            }
            Self::Spaces => BUILT_IN_SPACES
                .into_iter()
                .chain(VARIANT_SPACES)
                .map(|(name, summary, _)| (name, summary).into())
                .collect(),
            Self::Methods => Method::ALL
                .iter()
                .map(|method| (method.name(), method.summary()).into())
                .collect(),
        }
    }
}

/// Returns the entry of a controller: its summary with the default values of its settings.
fn controller_entry(controller: &BuiltInController) -> CatalogueEntry {
    let settings: Vec<_> = controller
        .values()
        .map(|(field, value)| match field.none_value {
            Some(none) if none == value => format!("{}={value} (off)", field.name),
            _ => format!("{}={value}", field.name),
        })
        .collect();
    let mut summary = controller.summary().to_owned();
    if !settings.is_empty() {
        summary += &format!("; {}", settings.join(","));
    }
    CatalogueEntry {
        name: controller.name(),
        summary,
    }
}

impl ListCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let catalogues = match self.what {
            Some(catalogue) => vec![catalogue],
            None => Catalogue::value_variants().to_vec(),
        };
        let all: serde_json::Map<_, _> = catalogues
            .iter()
            .map(|catalogue| {
                let entries = serde_json::json!(catalogue.entries(self.all));
                (catalogue.title().to_owned(), entries)
            })
            .collect();
        output::print_result(self.format, &all, || {
            format_catalogues(&catalogues, self.all, output_columns())
        })
    }
}

fn format_catalogues(catalogues: &[Catalogue], all: bool, columns: usize) -> String {
    let mut text = String::new();
    for (index, catalogue) in catalogues.iter().enumerate() {
        if catalogues.len() > 1 {
            let gap = if index == 0 { "" } else { "\n" };
            let _ = writeln!(text, "{gap}{}", catalogue.title());
        }
        for CatalogueEntry { name, summary } in catalogue.entries(all) {
            write_entry(&mut text, name, &summary, columns);
        }
        if let Catalogue::Controllers = catalogue {
            write_entry(&mut text, FILE_ENTRY.0, FILE_ENTRY.1, columns);
            write_entry(&mut text, SETTING_ENTRY.0, SETTING_ENTRY.1, columns);
        }
    }
    text
}

/// Number of columns of a pipe or a file.
const DEFAULT_COLUMNS: usize = 100;
/// Columns of an indentation and a name.
const NAME_COLUMNS: usize = 22;
/// Least number of columns of a summary; a narrower terminal wraps it.
const MIN_SUMMARY_COLUMNS: usize = 30;

/// Returns the number of columns of standard output.
fn output_columns() -> usize {
    let width = if io::stdout().is_terminal() {
        terminal_size::terminal_size()
    } else {
        None
    };
    width.map_or(DEFAULT_COLUMNS, |(columns, _)| columns.0.into())
}

/// Writes a name and its summary, whose lines are wrapped.
fn write_entry(text: &mut String, name: &str, summary: &str, columns: usize) {
    let mut shown = format!("  {name}");
    // A space stays between a name and its summary.
    if shown.chars().count() >= NAME_COLUMNS {
        let _ = writeln!(text, "{shown}");
        shown.clear();
    }
    for line in wrap(
        summary,
        columns
            .saturating_sub(NAME_COLUMNS)
            .max(MIN_SUMMARY_COLUMNS),
    ) {
        let _ = writeln!(text, "{shown:<NAME_COLUMNS$}{line}");
        shown.clear();
    }
}

fn ends_with_number(text: &str) -> bool {
    text.trim_end_matches(' ')
        .ends_with(|last: char| last.is_ascii_digit())
}

/// Breaks a text into lines, after spaces and commas, but not after a number, which may have a unit.
fn wrap(text: &str, columns: usize) -> Vec<String> {
    let mut pieces: Vec<String> = Vec::new();
    for piece in text.split_inclusive([' ', ',']) {
        match pieces.last_mut().filter(|before| ends_with_number(before)) {
            Some(before) => before.push_str(piece),
            None => pieces.push(piece.to_owned()),
        }
    }
    let mut lines = vec![String::new()];
    for piece in &pieces {
        let width = piece.trim_end().chars().count();
        match lines.last_mut() {
            Some(line) if line.is_empty() || line.chars().count() + width <= columns => {
                line.push_str(piece)
            }
            _ => lines.push(piece.clone()),
        }
    }
    lines
        .into_iter()
        .map(|line| line.trim_end().to_owned())
        .collect()
}
