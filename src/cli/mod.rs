//! The command line: one file a subcommand, all of them thin.

mod assess;
mod avoid;
mod benchmark;
mod check;
mod failure;
mod falsify;
mod import;
mod list;
mod output;
mod progress;
mod reach;
mod retrain;
mod simulate;
mod subject;
mod train;
mod verify;
mod worst_case;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub use failure::Failure;

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    a gate did not hold: --expect was not met, a training diverged, no round of
       a retraining was accepted, a certificate was rejected
  2    unusable arguments or input; the message names file, line and field
  3    the environment failed: disk, permission
  130  interrupted";

/// Crash-tests longitudinal driving controllers before the road does.
#[derive(Parser)]
#[command(version, after_help = EXIT_CODES, max_term_width = 100)]
struct Arguments {
    /// No progress and no notes on standard error; errors are still shown
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Assess(assess::Assess),
    Simulate(simulate::Simulate),
    Import(import::Import),
    Train(train::Train),
    // Far more arguments than any other.
    Retrain(Box<retrain::Retrain>),
    Falsify(falsify::Falsify),
    Avoid(avoid::Avoid),
    WorstCase(worst_case::WorstCase),
    Check(check::Check),
    Benchmark(benchmark::Measure),
    Verify(verify::Verify),
    List(list::List),
}

/// Runs the command line with given arguments, the program's name first.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(usage) => {
            // Help and version are not errors; clap prints them to standard output.
            let code = if usage.use_stderr() { 2 } else { 0 };
            // Nothing can be done about a standard stream that is closed.
            let _ = usage.print();
            return ExitCode::from(code);
        }
    };
    let quiet = arguments.quiet;
    let done = match arguments.command {
        Command::Assess(command) => command.run(quiet),
        Command::Simulate(command) => command.run(quiet),
        Command::Import(command) => command.run(quiet),
        Command::Train(command) => command.run(quiet),
        Command::Retrain(command) => command.run(quiet),
        Command::Avoid(command) => command.run(quiet),
        Command::Check(command) => command.run(),
        Command::WorstCase(command) => command.run(quiet),
        Command::Falsify(command) => command.run(quiet),
        Command::Benchmark(command) => command.run(quiet),
        Command::Verify(command) => command.run(quiet),
        Command::List(command) => command.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            failure.report();
            failure.exit_code()
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_well_formed() {
        super::Arguments::command().debug_assert();
    }
}
