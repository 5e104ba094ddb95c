//! `crumple explore`: scenarios and campaigns in the browser.

use std::path::PathBuf;

use super::global_options::GlobalOptions;
use clap::Args;
use crumple_controllers::Controllers;
use crumple_explore::{CatalogScenario, ExploreConfig, ServeError, Server};
use serde::Serialize;

use super::output_format::OutputFormat;
use super::{CliError, args, output, value_enums};
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;

/// Explore scenarios and campaigns interactively in a browser
#[derive(Args)]
#[command(after_long_help = "\
Prints an address for the browser of this machine and serves it until Ctrl-C, only on 127.0.0.1 and only to requests \
with the token in that address. The page loads nothing from other servers. A request may have 1 MiB and 400 000 \
vehicle steps (summed over its controllers); the page shows the first 200 000 evaluations of a campaign.

Examples:
  crumple explore
  crumple explore my-scenario.toml --controller baseline --controller policy
  crumple explore runs/match-leader runs/idm")]
pub(super) struct Explore {
    /// Initial scenarios, built-in or files, and folders of complete campaigns (`crumple falsify --out`).
    /// The browser shows the first one
    #[arg(value_name = "SCENARIO|CAMPAIGN")]
    what: Vec<PathBuf>,
    /// Port; 0 for any free port
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u16>(0..=65_535))]
    port: u16,
    /// Initial controller (see `crumple list controllers`), with settings, a file or a command after `exec:`; up to 4
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
        let page = if self.what.first().is_some_and(|first| first.is_dir()) {
            "campaigns"
        } else {
            ""
        };
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

    /// Loads the scenarios to explore.
    fn into_config(self, controllers: Controllers) -> Result<ExploreConfig, CliError> {
        let mut config = ExploreConfig {
            controllers: self.controller,
            estimator: self.estimator,
            controllers_of_files: controllers,
            ..ExploreConfig::default()
        };
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
