//! `crumple explore`: scenarios, campaigns, recordings and suites in the browser.

use std::path::PathBuf;

use super::global_options::GlobalOptions;
use clap::Args;
use crumple_controllers::Controllers;
use crumple_explore::{CatalogScenario, CatalogSuite, ExploreConfig, ServeError, Server};
use serde::Serialize;

use super::import::load_map;
use super::output_format::OutputFormat;
use super::suite::find_suite;
use super::{CliError, args, output, value_enums};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;

/// Explore scenarios, campaigns, recordings and suites interactively in a browser
#[derive(Args)]
#[command(after_long_help = "\
Prints an address for the browser of this machine and serves it until Ctrl-C, only on 127.0.0.1 and only to requests \
with the token in that address. The page loads nothing from other servers. A request may have 1 MiB and 400 000 \
vehicle steps (summed over its controllers). The page shows the first 200 000 evaluations of a campaign. It reads the \
first part of a recording (about 500 000 rows), and shows its first drives: at most 200, of together at most 14 h.

Examples:
  crumple explore
  crumple explore my-scenario.toml --controller baseline --controller policy
  crumple explore runs/match-leader runs/idm
  crumple explore --recording platoon.csv --suite fmvss-127 --controller acc-aeb")]
pub(super) struct Explore {
    /// Initial scenarios, built-in or files, and folders of complete campaigns (`crumple falsify --out`).
    /// The browser shows the first one
    #[arg(value_name = "SCENARIO|CAMPAIGN")]
    what: Vec<PathBuf>,
    /// Recording, as for `crumple replay`: the page shows its drives and what the controllers would command there;
    /// may be repeated
    #[arg(long = "recording", value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Meanings of the columns of the recordings: a file (docs/exchange.md), or openacc, car-following, highd, ngsim
    /// or sumo-fcd
    #[arg(long, value_name = "MAP.toml|NAME", requires = "recordings")]
    map: Option<PathBuf>,
    /// Built-in suite (see `crumple suite list`), or a file: the page shows its tests with their margins; may be
    /// repeated
    #[arg(long = "suite", value_name = "SUITE")]
    suites: Vec<PathBuf>,
    /// Port; 0 for any free port
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u16>(0..=65_535))]
    port: u16,
    /// Initial controller: a name (see `crumple list controllers`), which may have settings, a file, or a command after
    /// `exec:`; up to 4
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: Vec<NamedController>,
    /// Initial estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Output format of the address: text, or one JSON object
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Serialize)]
struct Address {
    address: String,
    page: String,
    port: u16,
}

impl Explore {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let page = self.first_page();
        let format = self.format;
        let server = Server::bind(self.port, self.into_config(global.controllers)?)?;
        let address = server.url();
        let port = server.port();
        let page = format!("{address}{page}");
        let text = format!("{page}\n");
        output::print_result(
            format,
            &Address {
                address,
                page,
                port,
            },
            || text,
        )?;
        output::note(
            "open this address in a browser on this machine; Ctrl-C stops the server",
            global.quiet,
        );
        Ok(server.run()?)
    }

    /// Returns the address of the page of the first argument, without one that of the recordings or suites.
    fn first_page(&self) -> &'static str {
        match self.what.first() {
            Some(first) if first.is_dir() => "campaigns",
            Some(_) => "",
            None if !self.recordings.is_empty() => "recordings",
            None if !self.suites.is_empty() => "suites",
            None => "",
        }
    }

    /// Loads the scenarios and suites to explore.
    fn into_config(self, controllers: Controllers) -> Result<ExploreConfig, CliError> {
        let mut config = ExploreConfig {
            controllers: self.controller,
            estimator: self.estimator,
            controllers_of_files: controllers,
            recordings: self.recordings,
            recording_map: self.map.as_deref().map(load_map).transpose()?,
            ..ExploreConfig::default()
        };
        for path in self.suites {
            let suite = find_suite(&path)?;
            let name = path.display().to_string();
            config.suites.push(CatalogSuite { name, suite });
        }
        for path in self.what {
            if path.is_dir() {
                config.campaigns.push(path);
                continue;
            }
            let scenario = args::load_scenario(&path, controllers)?;
            let name = path.display().to_string();
            config.scenarios.push(CatalogScenario { name, scenario });
        }
        Ok(config)
    }
}

impl From<ServeError> for CliError {
    fn from(error: ServeError) -> Self {
        match error {
            ServeError::System(source) => Self::Environment(format!("the network: {source}")),
            other => Self::input(other),
        }
    }
}
