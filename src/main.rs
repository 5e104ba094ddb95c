//! The `crumple` program: see [`crumple::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    crumple::cli::run(std::env::args_os())
}
