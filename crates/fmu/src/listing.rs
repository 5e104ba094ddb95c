//! Text list of the variables of an FMU.

use std::fmt;

use crate::{Causality, DeclaredUnit, FmiVersion, ModelDescription, Variable, VariableType};

impl FmiVersion {
    /// Returns the number of the edition.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Two => "2.0",
            Self::Three => "3.0",
        }
    }
}

impl Causality {
    /// Returns the name in the standard.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Input => "input",
            Self::Output => "output",
            Self::Parameter => "parameter",
        }
    }
}

impl fmt::Display for ModelDescription {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{}, FMI {}, co-simulation",
            self.model_name,
            self.version.name()
        )?;
        self.variables
            .iter()
            .try_for_each(|variable| writeln!(out, "{variable}"))
    }
}

impl fmt::Display for Variable {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name,
            causality,
            kind,
            start,
            unit,
            description,
            ..
        } = self;
        let parts = [
            unit.as_ref().map(DeclaredUnit::to_string),
            (*kind != VariableType::Real).then(|| kind.name().to_owned()),
            start.as_ref().map(|start| format!("starts with {start}")),
            description.clone(),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        let line = format!("{:9}  {name:32}  {}", causality.name(), parts.join("; "));
        out.write_str(line.trim_end())
    }
}
