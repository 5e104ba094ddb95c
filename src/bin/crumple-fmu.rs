//! The program that loads FMUs, in a process of its own: `crumple-fmu describe F.fmu` lists what one can be wired to.

use std::process::ExitCode;

fn main() -> ExitCode {
    crumple_fmu::host::main()
}
