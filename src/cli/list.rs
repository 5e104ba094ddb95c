//! `crumple list`: names of built-in items.

use std::fmt::Write;

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::simulate::OutputFormat;
use super::{CliError, output};
use crumple_search::falsify::Method;
use crumple_world::control::ControllerSpec;
use crumple_world::scenario::built_in_scenario_names;
use crumple_world::scenario::space::{BUILT_IN_SPACES, HUMAN_SPACES};

const SHIELD_ENTRY: (&str, &str) = (
    "shield:policy",
    "policy with a shield: full braking if the policy's command would leave the safety kernel; shield: works with any \
     controller",
);

const FILE_ENTRY: (&str, &str) = (
    "FILE",
    "a policy, a network (F.onnx, F.zip of Stable-Baselines3), an FMU (F.fmu), or a controller file (F.toml) that \
     states its inputs and outputs: docs/controllers.md; `crumple describe F.zip` prints a starter file",
);

/// List the built-in scenarios, controllers, scenario spaces and search methods
///
/// `crumple show NAME` prints a scenario, a scenario space, a preset, a suite or a map as a file.
#[derive(Args)]
pub(super) struct ListCommand {
    /// Items to list [default: all]
    what: Option<Catalogue>,
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

impl Catalogue {
    fn title(self) -> &'static str {
        match self {
            Self::Scenarios => "scenarios",
            Self::Controllers => "controllers",
            Self::Spaces => "spaces",
            Self::Methods => "methods",
        }
    }

    fn entries(self) -> Vec<CatalogueEntry> {
        let entry = |(name, summary): (_, &str)| CatalogueEntry { name, summary: summary.to_owned() };
        match self {
            Self::Scenarios => built_in_scenario_names().map(entry).into(),
            Self::Controllers => {
                let built_in = ControllerSpec::all();
                let own = built_in.iter().map(|spec| {
                    let settings: Vec<_> =
                        spec.values().map(|(field, value)| format!("{}={value}", field.name)).collect();
                    let settings =
                        if settings.is_empty() { String::new() } else { format!("; {}", settings.join(",")) };
                    CatalogueEntry { name: spec.name(), summary: format!("{}{settings}", spec.summary()) }
                });
                own.chain([entry(SHIELD_ENTRY)]).collect()
            }
            Self::Spaces => BUILT_IN_SPACES
                .into_iter()
                .chain(HUMAN_SPACES)
                .map(|(name, summary, _)| entry((name, summary)))
                .collect(),
            Self::Methods => Method::ALL.iter().map(|method| entry((method.name(), method.summary()))).collect(),
        }
    }
}

impl ListCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let catalogues = match self.what {
            Some(one) => vec![one],
            None => Catalogue::value_variants().to_vec(),
        };
        let entries = |one: &Catalogue| (one.title().to_owned(), serde_json::json!(one.entries()));
        let all: serde_json::Map<_, _> = catalogues.iter().map(entries).collect();
        output::print_result(self.format, &all, || format_catalogues(&catalogues))
    }
}

fn format_catalogues(catalogues: &[Catalogue]) -> String {
    let mut text = String::new();
    for (index, catalogue) in catalogues.iter().enumerate() {
        if catalogues.len() > 1 {
            let gap = if index == 0 { "" } else { "\n" };
            let _ = writeln!(text, "{gap}{}", catalogue.title());
        }
        for CatalogueEntry { name, summary } in catalogue.entries() {
            let _ = writeln!(text, "  {name:<20}{summary}");
        }
        if let Catalogue::Controllers = catalogue {
            let (name, summary) = FILE_ENTRY;
            let _ = writeln!(text, "  {name:<20}{summary}");
        }
    }
    text
}
