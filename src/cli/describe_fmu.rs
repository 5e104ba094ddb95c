//! `crumple describe F.fmu`: the variables of an FMU, from its `modelDescription.xml` alone.

use std::path::Path;

use crumple_fmu::{Fmu, FmuReport};

use super::output_format::OutputFormat;
use super::{CliError, output};

/// Prints the variables of an FMU. Runs none of its code.
pub(super) fn describe(file: &Path, format: OutputFormat) -> Result<(), CliError> {
    let fmu = Fmu::open(file).map_err(|error| match CliError::from_cause(error) {
        CliError::Environment(problem) => {
            CliError::Environment(format!("{}: {problem}", file.display()))
        }
        other => CliError::at(file, other),
    })?;
    let report = FmuReport::new(file, fmu.description());
    output::print_result(format, &report, || report.to_text())
}
