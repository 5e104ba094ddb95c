//! The command line, with one file per subcommand.

mod args;
mod argument_text;
mod artifacts;
mod assess;
mod avoid;
mod check;
mod describe;
mod describe_fmu;
mod doctor;
mod drives;
mod error;
#[cfg(feature = "explore")]
mod explore;
#[cfg(not(feature = "explore"))]
#[path = "explore_missing.rs"]
mod explore;
mod export;
mod exposure;
mod falsify;
mod feature;
mod file_kind;
mod fit;
mod fsck;
mod global_options;
mod import;
mod import_openscenario;
mod interrupt;
mod invariant;
mod list;
mod new;
mod output;
mod output_format;
mod preset;
mod progress;
mod rare;
mod reach;
mod replay;
mod retrain;
mod shell;
mod show;
mod simulate;
mod study;
mod suite;
mod suite_folder;
mod train;
mod tune;
mod two_sided;
mod value_enums;
mod verify;
mod worst_case;
mod written_files;

use std::ffi::OsString;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use crumple_core::{regular_file, threads};

use crumple_controllers::{Controllers, ExternalPrograms};
use error::CliError;
use global_options::GlobalOptions;

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    the result is negative: a gate of an assessment failed, --expect not met, certificate
       rejected, nothing verified, no braking episode found, training or retraining
       without a better policy, files damaged
  2    unusable arguments or input; the message names file, line and field
  3    the environment failed: disk, permission
  130  interrupted";

/// Subcommands by task, in the order of `--help`.
const TASKS: &[(&str, &[&str])] = &[
    ("Report on controllers", &["assess", "suite"]),
    ("Simulate and view", &["simulate", "explore", "export"]),
    ("Search for collisions", &["falsify", "worst-case", "avoid"]),
    ("Prove", &["verify", "check"]),
    ("Train and tune", &["train", "retrain", "tune"]),
    ("Use recorded data", &["import", "fit", "replay"]),
    ("Manage results", &["fsck"]),
    ("Look up", &["list", "show", "describe", "doctor"]),
    ("Set up", SETUP),
];
const SETUP: &[&str] = &["new", "completions", "man"];
/// Further subcommands that start no controller, whatever they read.
const START_NOTHING: &[&str] = &["describe", "fsck", "list", "show", "doctor"];
/// Version of the package and, in a release build, the commit: builds between two releases have the version of the
/// earlier one.
const VERSION: &str = env!("CRUMPLE_VERSION");
/// Heading of the options that every command takes, in its help.
const COMMON_OPTIONS: &str = "Common options";

/// Tests longitudinal driving controllers in simulation, before they reach the road.
#[derive(Parser)]
#[command(version = VERSION, after_help = EXIT_CODES, max_term_width = 100)]
struct Cli {
    /// Print no progress and no notes on standard error; errors are still shown
    #[arg(long, short, global = true, help_heading = COMMON_OPTIONS)]
    quiet: bool,
    /// Also start programs and FMUs that scenarios, spaces, suites, campaigns or certificates name. Without it, crumple
    /// starts only those named on this command line, or in a configuration or controller file that is named there
    #[arg(long, global = true, help_heading = COMMON_OPTIONS)]
    allow_external: bool,
    /// Number of threads, 1 to 1024 [default: RAYON_NUM_THREADS, else OMP_NUM_THREADS, else the cores that this
    /// process may use]
    #[arg(long, global = true, help_heading = COMMON_OPTIONS)]
    #[arg(value_name = "N", value_parser = args::whole_number::<usize>(1..=1024))]
    jobs: Option<usize>,
    #[command(subcommand)]
    command: CliCommand,
}

#[derive(Subcommand)]
enum CliCommand {
    Assess(assess::Assess),
    Simulate(simulate::Simulate),
    Import(import::Import),
    Fit(fit::Fit),
    Replay(replay::LogReplay),
    Export(export::Export),
    Explore(explore::Explore),
    Train(train::Train),
    // Boxed: it has far more arguments than any other.
    Retrain(Box<retrain::Retrain>),
    Tune(Box<tune::Tune>),
    Falsify(Box<falsify::Falsify>),
    Avoid(avoid::Avoid),
    WorstCase(worst_case::WorstCase),
    Check(check::Check),
    Verify(verify::Verify),
    Suite(suite::SuiteCommand),
    Fsck(fsck::Fsck),
    List(list::ListCommand),
    Show(show::Show),
    Describe(describe::Describe),
    New(new::New),
    Doctor(doctor::Doctor),
    Completions(shell::Completions),
    Man(shell::Man),
}

/// Runs the command line. The first argument is the name of the program.
pub(crate) fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    interrupt::ignore_file_size_signal();
    output::show_logged_warnings();
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    regular_file::permit_pipes(named_pipes(&arguments));
    let mut command = build_command();
    // Reading an argument also reads the files that a controller file names.
    regular_file::record_opened();
    let matched = command
        .try_get_matches_from_mut(&arguments)
        .and_then(|matches| Ok((Cli::from_arg_matches(&matches)?, matches)));
    let opened = regular_file::take_opened();
    let (parsed, matches) = match matched {
        Ok(matched) => matched,
        Err(usage) => return report_usage(&usage, &arguments),
    };
    let quiet = parsed.quiet;
    let external = match parsed.allow_external {
        true => ExternalPrograms::Allowed,
        false => ExternalPrograms::Refused,
    };
    let global = GlobalOptions {
        quiet,
        controllers: Controllers { external },
    };
    let ready = start_threads(parsed.jobs)
        .and_then(|()| written_files::check(&command, &matches, &opened))
        .and_then(|()| args::try_controllers(quiet));
    let done = ready.and_then(|()| run_command(parsed.command, global));
    // Results of a controller that contradicted itself count for nothing, whatever the command found.
    let done = args::ensure_trusted().and(done);
    args::release_controllers();
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            failure.print();
            failure.exit_code()
        }
    }
}

/// Runs a subcommand.
fn run_command(command: CliCommand, global: GlobalOptions) -> Result<(), CliError> {
    match command {
        CliCommand::Assess(command) => command.run(global),
        CliCommand::Simulate(command) => command.run(global),
        CliCommand::Import(command) => command.run(global),
        CliCommand::Fit(command) => command.run(global.quiet),
        CliCommand::Replay(command) => command.run(global.quiet),
        CliCommand::Export(command) => command.run(global),
        CliCommand::Explore(command) => command.run(global),
        CliCommand::Train(command) => command.run(global),
        CliCommand::Retrain(command) => command.run(global),
        CliCommand::Tune(command) => command.run(global),
        CliCommand::Avoid(command) => command.run(global),
        CliCommand::Check(command) => command.run(global),
        CliCommand::WorstCase(command) => command.run(global),
        CliCommand::Falsify(command) => command.run(global),
        CliCommand::Verify(command) => command.run(global),
        CliCommand::Suite(command) => command.run(global.quiet),
        CliCommand::Fsck(command) => command.run(),
        CliCommand::List(command) => command.run(),
        CliCommand::Show(command) => command.run(global.quiet),
        CliCommand::Describe(command) => command.run(),
        CliCommand::New(command) => command.run(global.quiet),
        CliCommand::Doctor(command) => command.run(),
        CliCommand::Completions(command) => command.run(build_command()),
        CliCommand::Man(command) => command.run(build_command(), global.quiet),
    }
}

/// Starts the threads of all work if the user states their number. Otherwise they start with the first work, on all
/// cores that this process may use.
fn start_threads(jobs: Option<usize>) -> Result<(), CliError> {
    let stated = threads::explicit_thread_count(jobs).map_err(CliError::input)?;
    let Some(count) = stated else {
        return Ok(());
    };
    rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .build_global()
        .map_err(|error| CliError::Environment(format!("cannot start {count} threads: {error}")))
}

/// Prints the help or the version that the user asked for, or an error of the arguments. Returns the exit code.
fn report_usage(usage: &clap::Error, arguments: &[OsString]) -> ExitCode {
    if !usage.use_stderr() {
        return match output::print_help(usage) {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => {
                failure.print();
                failure.exit_code()
            }
        };
    }
    let text = match usage.kind() {
        ErrorKind::InvalidUtf8 => format!("error: {}", argument_text::describe_first(arguments)),
        // Without colours: the message quotes arguments, which may contain escape sequences.
        _ => usage.render().to_string(),
    };
    let is_of_environment =
        error::is_caused_by_environment(usage) || error::states_disk_failure(&text);
    output::warn(text.trim_end());
    ExitCode::from(if is_of_environment { 3 } else { 2 })
}

/// Returns the arguments, and the parts of arguments behind an equal sign, that name open files of this process, such
/// as `/dev/stdin` and the `/dev/fd/63` of `<(...)` in a shell. Only these may be pipes: within files, such names would
/// make crumple wait.
fn named_pipes(arguments: &[OsString]) -> Vec<PathBuf> {
    let words = arguments.iter().filter_map(|argument| argument.to_str());
    let words = words
        .flat_map(|word| [Some(word), word.split_once('=').map(|(_, value)| value)])
        .flatten();
    words
        .filter(|word| {
            let number = word
                .strip_prefix("/dev/fd/")
                .or_else(|| word.strip_prefix("/proc/self/fd/"));
            *word == "/dev/stdin" || number.is_some_and(|number| number.parse::<u32>().is_ok())
        })
        .map(PathBuf::from)
        .collect()
}

fn build_command() -> clap::Command {
    let command = Cli::command();
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n{}\nOptions:\n{{options}}{{after-help}}",
        list_by_task(&command)
    );
    let command = command
        .help_template(template)
        .mut_subcommands(with_exit_codes);
    SETUP
        .iter()
        .chain(START_NOTHING)
        .fold(command, hide_external)
        .mut_subcommands(with_negative_numbers)
}

/// Hides `--allow-external` in the help of a subcommand that starts no controller.
fn hide_external(command: clap::Command, name: &&'static str) -> clap::Command {
    let hidden = clap::Arg::new("allow_external")
        .long("allow-external")
        .action(clap::ArgAction::SetTrue)
        .hide(true);
    command.mut_subcommand(name, |subcommand| subcommand.arg(hidden))
}

/// Returns the subcommands with their descriptions, under the headings of [`TASKS`].
fn list_by_task(command: &clap::Command) -> String {
    let mut text = String::new();
    for (task, names) in TASKS {
        let _ = writeln!(text, "\n{task}:");
        for name in *names {
            let about = command
                .find_subcommand(name)
                .and_then(clap::Command::get_about);
            let _ = writeln!(
                text,
                "  {name:<12} {}",
                about.map(ToString::to_string).unwrap_or_default()
            );
        }
    }
    text
}

/// Lets options take negative numbers, so that errors name the value instead of an unknown option.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    command
        .mut_args(|arg| {
            let takes_value = arg.get_long().is_some() && arg.get_action().takes_values();
            if takes_value {
                arg.allow_negative_numbers(true)
            } else {
                arg
            }
        })
        .mut_subcommands(with_negative_numbers)
}

/// Appends the exit codes to the long help of a command and of its subcommands.
fn with_exit_codes(command: clap::Command) -> clap::Command {
    let text = command.get_after_long_help().map_or_else(
        || EXIT_CODES.to_owned(),
        |help| format!("{help}\n\n{EXIT_CODES}"),
    );
    command
        .after_long_help(text)
        .mut_subcommands(with_exit_codes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        Cli::command().debug_assert();
    }

    #[test]
    fn help_lists_every_subcommand_once() {
        let mut listed: Vec<&str> = TASKS
            .iter()
            .flat_map(|(_, names)| *names)
            .copied()
            .collect();
        let command = Cli::command();
        let mut defined: Vec<&str> = command
            .get_subcommands()
            .map(clap::Command::get_name)
            .collect();
        listed.sort_unstable();
        defined.sort_unstable();
        assert_eq!(listed, defined);
        assert!(
            list_by_task(&command).lines().all(|line| line.len() <= 100),
            "{}",
            list_by_task(&command)
        );
    }

    /// An error about a number says which numbers are right; those of Rust's parsers do not.
    #[test]
    fn the_error_of_a_number_names_its_range() {
        fn check(command: &clap::Command, path: &[&str], numbers: &mut usize) {
            for argument in command
                .get_arguments()
                .filter(|argument| argument.get_action().takes_values())
            {
                let Some(long) = argument.get_long() else {
                    continue;
                };
                let option = format!("--{long}=ten");
                let words = ["crumple"]
                    .iter()
                    .chain(path)
                    .copied()
                    .chain([option.as_str()]);
                let Err(error) = build_command().try_get_matches_from(words) else {
                    continue;
                };
                let text = error.to_string();
                assert!(
                    !text.contains("invalid digit") && !text.contains("invalid float"),
                    "{path:?} {option}: {text}"
                );
                *numbers += usize::from(text.contains("must be a"));
            }
            for below in command.get_subcommands() {
                check(below, &[path, &[below.get_name()]].concat(), numbers);
            }
        }
        let mut numbers = 0;
        check(&build_command(), &[], &mut numbers);
        assert!(numbers > 30, "{numbers}");
    }

    #[test]
    fn every_long_help_ends_with_the_exit_codes() {
        fn check(command: &mut clap::Command) {
            let help = command.render_long_help().to_string();
            assert!(
                help.trim_end().ends_with("130  interrupted"),
                "{}: {help}",
                command.get_name()
            );
            command
                .get_subcommands_mut()
                .filter(|sub| sub.get_name() != "help")
                .for_each(check);
        }
        check(&mut build_command());
    }
}
