//! `crumple explore` in a build without the feature `explore`: an error that explains how to enable it.

use clap::Args;

use super::global_options::GlobalOptions;
use super::{CliError, feature};

/// Edit scenarios and follow campaigns in the browser (this build lacks the feature `explore`)
#[derive(Args)]
pub(super) struct Explore {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    ignored: Vec<std::ffi::OsString>,
}

impl Explore {
    pub(super) fn run(self, _global: GlobalOptions) -> Result<(), CliError> {
        drop(self.ignored);
        feature::EXPLORE.require().map_err(CliError::Input)
    }
}
