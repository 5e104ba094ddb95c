//! `crumple completions` and `crumple man`: what a shell and `man` want to know of the command line.

use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_complete::Shell;

use super::{Failure, output};
use crumple_search::disk::{DiskError, Files};

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
    pub(super) fn run(self, mut commands: Command) -> Result<(), Failure> {
        let mut script = Vec::new();
        let name = commands.get_name().to_owned();
        clap_complete::generate(self.shell, &mut commands, name, &mut script);
        output::print(&String::from_utf8_lossy(&script))
    }
}

/// Write manual pages: `man -l DIR/crumple.1`
#[derive(Args)]
pub(super) struct Man {
    /// Folder for them, one for each command
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

impl Man {
    pub(super) fn run(self, mut commands: Command, quiet: bool) -> Result<(), Failure> {
        // Before, subcommands go by their last name alone.
        commands.build();
        std::fs::create_dir_all(&self.out).map_err(DiskError::at(&self.out))?;
        let mut files = Files::default();
        let pages = write_pages(commands, &self.out, &mut files)?;
        files.commit()?;
        output::note(&format!("wrote {pages} pages to {}", self.out.display()), quiet);
        Ok(())
    }
}

/// The pages of a command and of all below it, and how many they are.
fn write_pages(mut command: Command, folder: &Path, files: &mut Files) -> Result<usize, Failure> {
    let below: Vec<Command> =
        command.get_subcommands().filter(|below| !below.is_hide_set() && below.get_name() != "help").cloned().collect();
    // What `--help` says: the synopsis that a page would make of the options tells neither what they take nor which must be there.
    let usage = command.render_usage().to_string();
    let usage = usage.strip_prefix("Usage:").unwrap_or(&usage).trim().to_owned();
    let page = clap_mangen::Man::new(command.override_usage(usage));
    let path = folder.join(page.get_filename());
    let mut text = Vec::new();
    page.render(&mut text).map_err(DiskError::at(&path))?;
    files.stage(&path, &text)?;
    below.into_iter().try_fold(1, |pages, command| Ok(pages + write_pages(command, folder, files)?))
}
