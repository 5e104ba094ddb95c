//! `crumple completions` and `crumple man`: what a shell and `man` want to know of the command line.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;

use super::output_folder::{EarlierFiles, OutputFolder};
use super::{CliError, output};

/// Print what a shell needs to complete commands and options
#[derive(Args)]
#[command(after_long_help = "\
  bash        crumple completions bash > ~/.local/share/bash-completion/completions/crumple
  zsh         crumple completions zsh > a folder of $fpath, as _crumple
  fish        crumple completions fish > ~/.config/fish/completions/crumple.fish
  powershell  crumple completions powershell >> $PROFILE")]
pub(super) struct Completions {
    /// The shell
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
    /// Folder for them, one for each command; `crumple-man.sha256` lists them. Pages that crumple wrote there and that have not changed are
    /// replaced, all other files stay
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Man {
    pub(super) fn run(self, mut commands: Command, quiet: bool) -> Result<(), CliError> {
        // Before, subcommands go by their last name alone.
        commands.build();
        let mut pages = Vec::new();
        render_pages(commands, &mut pages)?;
        OutputFolder::with_listing(&self.out, "crumple-man.sha256")?.write(&pages, EarlierFiles::Replace)?;
        output::note(&format!("wrote {} pages to {}", pages.len(), self.out.display()), quiet);
        Ok(())
    }
}

/// Renders the pages of a command and of all below it, by the names of their files.
fn render_pages(mut command: Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), CliError> {
    let below: Vec<Command> =
        command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help").cloned().collect();
    // The usage of `--help`: the synopsis that clap makes of the options says neither what they take nor which are required.
    let usage = command.render_usage().to_string();
    let usage = usage.strip_prefix("Usage:").unwrap_or(&usage).trim().to_owned();
    let page = clap_mangen::Man::new(command.override_usage(usage));
    let mut text = Vec::new();
    page.render(&mut text).map_err(CliError::input)?;
    pages.push((page.get_filename(), text));
    below.into_iter().try_for_each(|command| render_pages(command, pages))
}
