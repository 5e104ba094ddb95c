//! The `crumple` program: one file a subcommand under `cli`, all of them thin.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run(std::env::args_os())
}
