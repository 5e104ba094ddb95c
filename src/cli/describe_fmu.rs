//! `crumple describe F.fmu`: the variables of an FMU, from its `modelDescription.xml` alone.

use std::path::Path;

use crumple_fmu::{Fmu, ModelDescription, Variable};
use serde::Serialize;

use super::output_format::OutputFormat;
use super::{CliError, output};
use crumple_core::quoting::TerminalText;

#[derive(Serialize)]
struct FmuReport<'a> {
    file: String,
    format: &'static str,
    fmi_version: &'static str,
    model_name: &'a str,
    variables: Vec<FmuVariableReport<'a>>,
}

#[derive(Serialize)]
struct FmuVariableReport<'a> {
    name: &'a str,
    causality: &'static str,
    kind: &'static str,
    unit: Option<&'a str>,
    start: Option<&'a str>,
    description: Option<&'a str>,
}

/// Prints the variables of an FMU. Runs none of its code.
pub(super) fn describe(file: &Path, format: OutputFormat) -> Result<(), CliError> {
    let fmu = Fmu::open(file).map_err(|error| match CliError::from_cause(error) {
        CliError::Environment(problem) => {
            CliError::Environment(format!("{}: {problem}", file.display()))
        }
        other => CliError::at(file, other),
    })?;
    let description = fmu.description();
    let words = || {
        description
            .to_string()
            .lines()
            .map(|line| format!("{}\n", TerminalText(line)))
            .collect()
    };
    output::print_result(format, &FmuReport::new(file, description), words)
}

impl<'a> FmuReport<'a> {
    fn new(file: &Path, description: &'a ModelDescription) -> Self {
        let variable = |variable: &'a Variable| FmuVariableReport {
            name: &variable.name,
            causality: variable.causality.name(),
            kind: variable.kind.name(),
            unit: variable.unit.as_ref().map(|unit| unit.name.as_str()),
            start: variable.start.as_deref(),
            description: variable.description.as_deref(),
        };
        Self {
            file: file.display().to_string(),
            format: "fmu",
            fmi_version: description.version.name(),
            model_name: &description.model_name,
            variables: description.variables.iter().map(variable).collect(),
        }
    }
}
