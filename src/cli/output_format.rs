//! Output format of most subcommands.

use clap::ValueEnum;

#[derive(Clone, Copy, PartialEq, ValueEnum)]
pub(super) enum OutputFormat {
    /// Text
    Text,
    /// JSON
    Json,
}
