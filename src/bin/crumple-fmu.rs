//! The program that loads FMUs, in a separate process: `crumple-fmu describe F.fmu` lists the variables of an FMU.

use std::process::ExitCode;

fn main() -> ExitCode {
    crumple_fmu::host::main()
}
