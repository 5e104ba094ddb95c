//! Report on an FMU, as text and as JSON.

use std::path::Path;

use crumple_core::quoting::TerminalText;
use serde::Serialize;

use crate::{ModelDescription, Variable};

/// Report on an FMU, from its description alone.
#[derive(Debug, Serialize)]
pub struct FmuReport<'a> {
    /// Path of the FMU.
    pub file: String,
    /// Always `fmu`.
    pub format: &'static str,
    /// Edition of the standard.
    pub fmi_version: &'static str,
    /// Name of the model.
    pub model_name: &'a str,
    /// Variables, in the order of the file.
    pub variables: Vec<FmuVariableReport<'a>>,
    #[serde(skip)]
    description: &'a ModelDescription,
}

/// Report on a variable of an FMU.
#[derive(Debug, Serialize)]
pub struct FmuVariableReport<'a> {
    /// Name of the variable.
    pub name: &'a str,
    /// Causality in the standard.
    pub causality: &'static str,
    /// Type of the variable.
    pub kind: &'static str,
    /// Unit as declared.
    pub unit: Option<&'a str>,
    /// Start value as declared.
    pub start: Option<&'a str>,
    /// Description of the variable.
    pub description: Option<&'a str>,
}

impl<'a> FmuReport<'a> {
    /// Describes the FMU in a file.
    #[must_use]
    pub fn new(file: &Path, description: &'a ModelDescription) -> Self {
        Self {
            file: file.display().to_string(),
            format: "fmu",
            fmi_version: description.version.name(),
            model_name: &description.model_name,
            variables: description
                .variables
                .iter()
                .map(FmuVariableReport::new)
                .collect(),
            description,
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let description = self.description.to_string();
        let lines = description.lines();
        lines
            .map(|line| format!("{}\n", TerminalText(line)))
            .collect()
    }
}

impl<'a> FmuVariableReport<'a> {
    fn new(variable: &'a Variable) -> Self {
        Self {
            name: &variable.name,
            causality: variable.causality.name(),
            kind: variable.kind.name(),
            unit: variable.unit.as_ref().map(|unit| unit.name.as_str()),
            start: variable.start.as_deref(),
            description: variable.description.as_deref(),
        }
    }
}
