//! `crumple completions` and `crumple man`: shell completions and manual pages.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;

use super::output_folder::{EarlierFiles, OutputFolder};
use super::{CliError, output};

/// Print a completion script for a shell
#[derive(Args)]
#[command(after_long_help = "\
Install the script:
  bash        crumple completions bash > ~/.local/share/bash-completion/completions/crumple
  zsh         crumple completions zsh > a folder of $fpath, as _crumple
  fish        crumple completions fish > ~/.config/fish/completions/crumple.fish
  powershell  crumple completions powershell >> $PROFILE")]
pub(super) struct Completions {
    /// Shell
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    pub(super) fn run(self, mut commands: Command) -> Result<(), CliError> {
        let mut script = Vec::new();
        let name = commands.get_name().to_owned();
        clap_complete::generate(self.shell, &mut commands, name, &mut script);
        output::print(&String::from_utf8_lossy(&script))
    }
}

/// Write manual pages: `man -l DIR/crumple.1`
#[derive(Args)]
pub(super) struct Man {
    /// Folder for the pages, one per command, created if missing; `crumple-man.sha256` lists them. crumple replaces
    /// only pages that it wrote there and that have not changed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Man {
    pub(super) fn run(self, mut commands: Command, quiet: bool) -> Result<(), CliError> {
        // Sets the full names of subcommands.
        commands.build();
        let mut pages = Vec::new();
        render_pages(commands, &mut pages)?;
        OutputFolder::with_listing(&self.out, "crumple-man.sha256")?.write(&pages, EarlierFiles::Replace)?;
        output::note(&format!("wrote {} pages to {}", pages.len(), self.out.display()), quiet);
        Ok(())
    }
}

/// Renders the pages of a command and its subcommands, by file name.
fn render_pages(mut command: Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), CliError> {
    let below: Vec<Command> =
        command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help").cloned().collect();
    // The usage of `--help`: the synopsis of clap_mangen omits the values of options and does not mark required ones.
    let usage = command.render_usage().to_string();
    let usage = usage.strip_prefix("Usage:").unwrap_or(&usage).trim().to_owned();
    let page = clap_mangen::Man::new(command.override_usage(usage));
    let mut text = Vec::new();
    page.render(&mut text).map_err(CliError::input)?;
    pages.push((page.get_filename(), text));
    below.into_iter().try_for_each(|command| render_pages(command, pages))
}
