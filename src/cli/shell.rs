//! `crumple completions` and `crumple man`: shell completions and manual pages.

use std::path::PathBuf;
use std::sync::LazyLock;

use clap::builder::PossibleValuesParser;
use clap::{Arg, Args, Command};
use clap_complete::Shell;

use super::preset::RETRAIN_PRESET_NAMES;
use super::reach::BUILT_IN_BOXES;
use super::{CliError, output, show};
use crumple_exchange::recording::map::BUILT_IN_MAPS;
use crumple_learn::rl::PRESETS;
use crumple_search::falsify::Method;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::built_in_scenario_names;
use crumple_spaces::built_in_space_names;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};
use crumple_suites::SHIPPED_SUITES;

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

/// Built-in items that arguments name.
#[derive(Clone, Copy)]
enum NamedItems {
    Controllers,
    Scenarios,
    Spaces,
    Methods,
    Policies,
    Suites,
    Maps,
    Boxes,
    TrainPresets,
    RetrainPresets,
    /// Names that `crumple show` prints as files.
    ShownFiles,
}

/// Names of built-in controllers behind a shield.
static SHIELDED: LazyLock<Vec<String>> = LazyLock::new(|| {
    let specs = BuiltInController::all_that_drive();
    let shielded = ["shield", "shield2"].into_iter().flat_map(|shield| {
        let specs = specs.iter();
        specs.map(move |spec| format!("{shield}:{}", spec.name()))
    });
    shielded.collect()
});

fn names_of<T>(items: &[(&'static str, T)]) -> Vec<&'static str> {
    items.iter().map(|(name, _)| *name).collect()
}

impl NamedItems {
    const ALL: [Self; 11] = [
        Self::Controllers,
        Self::Scenarios,
        Self::Spaces,
        Self::Methods,
        Self::Policies,
        Self::Suites,
        Self::Maps,
        Self::Boxes,
        Self::TrainPresets,
        Self::RetrainPresets,
        Self::ShownFiles,
    ];

    fn of_argument(command: &str, argument: &Arg) -> Option<Self> {
        match (command, argument.get_id().as_str()) {
            ("assess", _) => None,
            ("show", "name") => Some(Self::ShownFiles),
            ("run", "suite") => Some(Self::Suites),
            ("retrain", "policy") => Some(Self::Policies),
            ("retrain", "preset") => Some(Self::RetrainPresets),
            ("train", "preset") => Some(Self::TrainPresets),
            (_, "controller" | "controllers" | "against") => Some(Self::Controllers),
            (_, "scenario" | "scenarios") | ("explore", "what") => Some(Self::Scenarios),
            (_, "space" | "regression") => Some(Self::Spaces),
            (_, "method" | "compare") => Some(Self::Methods),
            (_, "map") => Some(Self::Maps),
            _ if argument.get_long() == Some("box") => Some(Self::Boxes),
            _ => None,
        }
    }

    /// True if the arguments also take files.
    fn may_be_files(self) -> bool {
        !matches!(self, Self::Methods | Self::ShownFiles)
    }

    fn names(self) -> Vec<&'static str> {
        match self {
            Self::Controllers => {
                let specs = BuiltInController::all_that_drive();
                let shielded = SHIELDED.iter().map(String::as_str);
                specs
                    .iter()
                    .map(BuiltInController::name)
                    .chain(BuiltInController::presets().map(|preset| preset.name))
                    .chain(shielded)
                    .collect()
            }
            Self::Policies => {
                let specs = BuiltInController::all();
                let policies = specs.iter().filter(|spec| spec.policy().is_some());
                policies.map(BuiltInController::name).collect()
            }
            Self::Scenarios => names_of(&built_in_scenario_names()),
            Self::Spaces => built_in_space_names().collect(),
            Self::Methods => Method::ALL.iter().map(Method::name).collect(),
            Self::Suites => names_of(&SHIPPED_SUITES),
            Self::Maps => names_of(&BUILT_IN_MAPS),
            Self::Boxes => names_of(&BUILT_IN_BOXES),
            Self::TrainPresets => names_of(&PRESETS),
            Self::RetrainPresets => [&RETRAIN_PRESET_NAMES[..1], &names_of(&PRESETS)].concat(),
            Self::ShownFiles => show::built_in_file_names(),
        }
    }
}

/// Returns the commands for completion scripts: arguments have the built-in names as possible values.
fn with_built_in_names(command: Command) -> Command {
    let name = command.get_name().to_owned();
    command
        .mut_args(|argument| match NamedItems::of_argument(&name, &argument) {
            Some(items) => argument.value_parser(PossibleValuesParser::new(items.names())),
            None => argument,
        })
        .mut_subcommands(with_built_in_names)
}

/// Part of the script for bash: bash splits words at colons, so that `shield:idm` is three words. Joins them before the
/// completion, and removes the part up to the colon from the replies, which bash keeps.
const BASH_COLONS: &str = r#"
_crumple_with_colons() {
    local line="${COMP_LINE:0:COMP_POINT}" before
    if [[ "${COMP_WORDBREAKS}" != *:* || ! "${line}" =~ [[:space:]][^[:space:]]*:[^[:space:]]*$ ]]; then
        _crumple "$@"
        return
    fi
    read -ra COMP_WORDS <<< "${line}"
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
    _crumple "$1" "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
    before="${COMP_WORDS[COMP_CWORD]%"${COMP_WORDS[COMP_CWORD]##*:}"}"
    COMPREPLY=("${COMPREPLY[@]#"${before}"}")
}
"#;

/// Returns the script with files beside the built-in names. The script for bash offers them if no name fits.
fn with_files(shell: Shell, script: &str, commands: &Command) -> String {
    let lists = NamedItems::ALL
        .into_iter()
        .filter(|items| items.may_be_files());
    let lists: Vec<_> = lists.map(NamedItems::names).collect();
    match shell {
        Shell::Bash => match script.rsplit_once("\nif [[ ") {
            Some((function, registration)) => format!(
                "{function}{BASH_COLONS}\nif [[ {}",
                registration.replace("-F _crumple ", "-F _crumple_with_colons ")
            ),
            None => script.to_owned(),
        },
        Shell::Zsh => lists.iter().fold(script.to_owned(), |script, names| {
            let names = names.join(" ");
            script.replace(
                &format!(":({})", names.replace(':', "\\:")),
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
        let condition = format!("__fish_crumple_using_subcommand {}", command.get_name());
        text += &fish_names(command, &condition);
        for below in command.get_subcommands() {
            let condition = format!(
                "{condition}; and __fish_seen_subcommand_from {}",
                below.get_name()
            );
            text += &fish_names(below, &condition);
        }
    }
    text
}

/// Returns the names for the positional arguments of one subcommand.
fn fish_names(command: &Command, condition: &str) -> String {
    let items = command
        .get_positionals()
        .filter_map(|argument| NamedItems::of_argument(command.get_name(), argument));
    let lines = items.map(|items| {
        let names = items.names().join(" ");
        format!("complete -c crumple -n \"{condition}\" -a \"{names}\"\n")
    });
    lines.collect()
}

/// Write manual pages to --out DIR; `man -l DIR/crumple.1` shows one
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
