//! The program `crumple-fmu`: loads an FMU's library and answers crumple's questions by it.
//!
//! | module | what it holds |
//! |---|---|
//! | `instance` | an FMU that runs: the order of calls that the standard asks for |
//! | `fmi2`, `fmi3` | the calls of each edition, and their `unsafe` |
//! | `unpacked` | the folder that an FMU is unpacked into, and the removal of those that ended processes left behind |
//! | `serve` | the protocol of controllers, `docs/controllers.md` of crumple |
//!
//! At each decision the inputs are set, one step of the decision interval is made, and what then stands at the output is the
//! answer. So what an FMU calculates from its inputs acts without delay, and what it integrates has gone on by one interval.

mod fmi2;
mod fmi3;
mod instance;
mod serve;
mod unpacked_folder;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::Fmu;
use instance::VariableMap;

/// Drives by an FMU for crumple, in a process of its own
#[derive(Parser)]
#[command(name = "crumple-fmu", version, about)]
struct HostArguments {
    #[command(subcommand)]
    command: HostCommand,
}

#[derive(Subcommand)]
enum HostCommand {
    /// Lists what an FMU can be wired to
    Describe {
        /// The FMU
        #[arg(value_name = "F.fmu")]
        fmu: PathBuf,
    },
    /// Answers crumple's questions on standard input; crumple starts this itself
    Drive {
        /// The FMU
        #[arg(value_name = "F.fmu")]
        fmu: PathBuf,
        /// A variable for each number that is seen, in order
        #[arg(long = "input", value_name = "VARIABLE")]
        inputs: Vec<String>,
        /// The variable that is the answer
        #[arg(long, value_name = "VARIABLE")]
        output: String,
        /// A value that a parameter begins with; booleans are 0 or 1
        #[arg(long = "parameter", value_name = "VARIABLE=VALUE", value_parser = parse_parameter)]
        parameters: Vec<(String, f64)>,
        /// Time between decisions, in seconds; the scenario's step unless it is said
        #[arg(long, value_name = "S")]
        interval_s: Option<f64>,
    },
}

fn parse_parameter(text: &str) -> Result<(String, f64), String> {
    // Names of variables hold equals signs sooner than numbers do.
    let (name, value) = text.rsplit_once('=').ok_or("must be VARIABLE=VALUE")?;
    Ok((name.to_owned(), value.parse().map_err(|_| format!("{value:?} is no number"))?))
}

/// Runs the program.
#[must_use]
pub fn main() -> ExitCode {
    let (fmu, done) = match HostArguments::parse().command {
        HostCommand::Describe { fmu } => {
            let described = Fmu::open(&fmu).map(|fmu| print!("{}", fmu.description()));
            (fmu, described.map_err(|error| error.to_string()))
        }
        HostCommand::Drive { fmu, inputs, output, parameters, interval_s } => {
            let wiring = VariableMap { inputs, output, parameters, interval_s };
            let served = serve::serve(&fmu, &wiring);
            (fmu, served)
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("{}: {problem}", fmu.display());
            ExitCode::from(2)
        }
    }
}
