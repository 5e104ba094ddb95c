//! Program `crumple-fmu`: loads the library of an FMU and answers crumple's requests.
//!
//! | module | content |
//! |---|---|
//! | `instance` | running FMU: order of calls by the standard |
//! | `fmi2`, `fmi3` | calls of each edition, and their `unsafe` |
//! | `unpacked_folder` | folder of an unpacked FMU, and removal of folders of ended processes |
//! | `serve` | protocol of controllers (`docs/controllers.md`) |
//!
//! At each decision the host sets the inputs, performs one step of the decision interval, and answers with the output.
//! Direct feedthrough thus acts without delay; integrated states have advanced by one interval.

mod fmi2;
mod fmi3;
mod instance;
mod serve;
mod unpacked_folder;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::Fmu;
use instance::VariableMap;

/// Runs an FMU as a controller of crumple, in its own process
#[derive(Parser)]
#[command(name = "crumple-fmu", version, about)]
struct HostArguments {
    #[command(subcommand)]
    command: HostCommand,
}

#[derive(Subcommand)]
enum HostCommand {
    /// Lists the variables of an FMU that a controller file can use
    Describe {
        /// The FMU
        #[arg(value_name = "F.fmu")]
        fmu: PathBuf,
    },
    /// Answers crumple's requests on standard input; crumple starts this itself
    Drive {
        /// The FMU
        #[arg(value_name = "F.fmu")]
        fmu: PathBuf,
        /// Variable of each observed quantity, in order
        #[arg(long = "input", value_name = "VARIABLE")]
        inputs: Vec<String>,
        /// Variable of the commanded acceleration
        #[arg(long, value_name = "VARIABLE")]
        output: String,
        /// Variable that is above 0.5 while the FMU warns of a collision
        #[arg(long, value_name = "VARIABLE")]
        warning: Option<String>,
        /// Initial value of a parameter; booleans are 0 or 1
        #[arg(long = "parameter", value_name = "VARIABLE=VALUE", value_parser = parse_parameter)]
        parameters: Vec<(String, f64)>,
        /// Time between decisions, in seconds; by default the scenario's step
        #[arg(long, value_name = "S")]
        interval_s: Option<f64>,
    },
}

fn parse_parameter(text: &str) -> Result<(String, f64), String> {
    // Split at the last equal sign: the name of a variable may contain one, a number cannot.
    let (name, value) = text.rsplit_once('=').ok_or("must be VARIABLE=VALUE")?;
    match value.parse() {
        Ok(number) => Ok((name.to_owned(), number)),
        Err(_) => Err(format!("{value:?} is no number")),
    }
}

/// Runs the program.
#[must_use]
pub fn main() -> ExitCode {
    let command = HostArguments::parse().command;
    let fmu = command.fmu().to_owned();
    match command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            // At once: standard error has no buffer, and crumple reads its last lines.
            let line = format!("{}: {problem}\n", fmu.display());
            let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
            ExitCode::from(2)
        }
    }
}

impl HostCommand {
    fn fmu(&self) -> &Path {
        match self {
            Self::Describe { fmu } | Self::Drive { fmu, .. } => fmu,
        }
    }

    fn run(self) -> Result<(), String> {
        match self {
            Self::Describe { fmu } => {
                let fmu = Fmu::open(&fmu).map_err(|error| error.to_string())?;
                print!("{}", fmu.description());
                Ok(())
            }
            Self::Drive {
                fmu,
                inputs,
                output,
                warning,
                parameters,
                interval_s,
            } => {
                let wiring = VariableMap {
                    inputs,
                    output,
                    warning,
                    parameters,
                    interval_s,
                };
                serve::serve(&fmu, &wiring)
            }
        }
    }
}
