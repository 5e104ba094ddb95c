//! `crumple completions` and `crumple man`: shell completions and manual pages.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Arg, Args, Command};
use clap_complete::Shell;

use super::output_folder::{EarlierFiles, OutputFolder};
use super::{CliError, output};
use crumple_search::falsify::Method;
use crumple_spaces::{BUILT_IN_SPACES, HUMAN_SPACES};
use crumple_world::control::ControllerSpec;
use crumple_world::scenario::built_in_scenario_names;

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
    pub(super) fn run(self, commands: Command) -> Result<(), CliError> {
        let name = commands.get_name().to_owned();
        let mut commands = with_built_in_names(commands);
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut commands, name, &mut script);
        output::print(&with_files(
            self.shell,
            &String::from_utf8_lossy(&script),
            &commands,
        ))
    }
}

/// Built-in items that arguments name. These arguments also take files.
#[derive(Clone, Copy)]
enum NamedItems {
    Controllers,
    Scenarios,
    Spaces,
    Methods,
}

impl NamedItems {
    const ALL: [Self; 4] = [
        Self::Controllers,
        Self::Scenarios,
        Self::Spaces,
        Self::Methods,
    ];

    fn of_argument(command: &str, argument: &Arg) -> Option<Self> {
        match (command, argument.get_id().as_str()) {
            ("assess", _) => None,
            (_, "controller" | "controllers" | "against") => Some(Self::Controllers),
            (_, "scenario" | "scenarios") | ("explore", "what") => Some(Self::Scenarios),
            (_, "space" | "regression") => Some(Self::Spaces),
            (_, "method" | "compare") => Some(Self::Methods),
            _ => None,
        }
    }

    fn names(self) -> Vec<&'static str> {
        match self {
            Self::Controllers => ControllerSpec::all()
                .iter()
                .map(ControllerSpec::name)
                .collect(),
            Self::Scenarios => built_in_scenario_names()
                .iter()
                .map(|(name, _)| *name)
                .collect(),
            Self::Spaces => BUILT_IN_SPACES
                .iter()
                .chain(&HUMAN_SPACES)
                .map(|(name, ..)| *name)
                .collect(),
            Self::Methods => Method::ALL.iter().map(Method::name).collect(),
        }
    }
}

/// Returns the commands for completion scripts: arguments have the built-in names as possible values.
fn with_built_in_names(command: Command) -> Command {
    let name = command.get_name().to_owned();
    let complete = |argument: Arg| match NamedItems::of_argument(&name, &argument) {
        Some(items) => argument.value_parser(PossibleValuesParser::new(items.names())),
        None => argument,
    };
    command
        .mut_args(complete)
        .mut_subcommands(with_built_in_names)
}

/// Returns the script with files beside the built-in names. The script for bash offers them if no name fits.
fn with_files(shell: Shell, script: &str, commands: &Command) -> String {
    let lists = NamedItems::ALL.map(NamedItems::names);
    match shell {
        Shell::Zsh => lists.iter().fold(script.to_owned(), |script, names| {
            let names = names.join(" ");
            script.replace(
                &format!(":({names})"),
                &format!(":{{compadd -- {names}; _files}}"),
            )
        }),
        Shell::Fish => {
            let script = lists.iter().fold(script.to_owned(), |script, names| {
                let names = format!(" -a \"{}\\t''", names.join("\\t''\n"));
                script.replace(&format!(" -f{names}"), &format!(" -F{names}"))
            });
            script + &fish_positionals(commands)
        }
        _ => script.to_owned(),
    }
}

/// Returns the names for positional arguments, which `clap_complete` leaves out for fish.
fn fish_positionals(commands: &Command) -> String {
    let mut text = String::new();
    for command in commands.get_subcommands() {
        let name = command.get_name();
        let items = command
            .get_positionals()
            .filter_map(|argument| NamedItems::of_argument(name, argument));
        for items in items {
            let names = items.names().join(" ");
            text += &format!(
                "complete -c crumple -n \"__fish_crumple_using_subcommand {name}\" -a \"{names}\"\n"
            );
        }
    }
    text
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
        OutputFolder::with_listing(&self.out, "crumple-man.sha256")?
            .write(&pages, EarlierFiles::Replace)?;
        output::note(
            &format!("wrote {} pages to {}", pages.len(), self.out.display()),
            quiet,
        );
        Ok(())
    }
}

/// Renders the pages of a command and its subcommands, by file name.
fn render_pages(mut command: Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), CliError> {
    let below: Vec<Command> = command
        .get_subcommands()
        .filter(|below| !below.is_hide_set() && below.get_name() != "help")
        .cloned()
        .collect();
    // The usage of `--help`: the synopsis of clap_mangen omits the values of options and does not mark required ones.
    let usage = command.render_usage().to_string();
    let usage = usage
        .strip_prefix("Usage:")
        .unwrap_or(&usage)
        .trim()
        .to_owned();
    let page = clap_mangen::Man::new(command.override_usage(usage));
    let mut text = Vec::new();
    page.render(&mut text).map_err(CliError::input)?;
    pages.push((page.get_filename(), text));
    below
        .into_iter()
        .try_for_each(|command| render_pages(command, pages))
}
