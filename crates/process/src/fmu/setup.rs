//! Connections of an FMU to quantities, and the command that runs it.

use std::path::{Path, PathBuf};

use crumple_fmu::{Causality, Fmu, ModelDescription, Variable, VariableType};

use super::units::{convert_input, convert_output, convert_parameter};
use super::{FmuConfig, FmuProblem};
use crate::setup::ProcessSetup;
use crumple_networks::{InputMapping, InvalidMapping, Mapping, OutputMapping};
use crumple_world::control::ObservedQuantity;

const HOST_PROGRAM: &str = "crumple-fmu";
/// Environment variable with another location of the program.
const HOST_ENV_VAR: &str = "CRUMPLE_FMU";
/// Name of the answer, if an FMU has several outputs and no controller file chooses one.
const DEFAULT_OUTPUT: &str = "acceleration_mps2";

impl ProcessSetup {
    /// Creates the setup of an FMU from its path relative to `folder`, connected by `wiring`. Converts inputs, answer
    /// and parameters between SI units and the units of the FMU. Reads the FMU without running it.
    ///
    /// # Errors
    /// [`FmuProblem`] for an unusable file, for missing variables, and for units that cannot be converted.
    pub fn from_fmu(folder: &Path, path: &str, wiring: FmuConfig) -> Result<Self, FmuProblem> {
        let fmu = Fmu::open(&folder.join(path))?;
        let description = fmu.description();
        let plain = Self::new(Vec::new(), folder);
        let inputs = wiring
            .inputs
            .map_or_else(|| inputs_by_name(description), Ok)?;
        let (inputs, variables) = connect_inputs(description, inputs)?;
        let output = wiring
            .output
            .unwrap_or_else(|| plain.mapping.output.clone());
        let answer = answer_variable(description, &output)?;
        let output = convert_output(output, answer)
            .map_err(|problem| InvalidMapping::new("output.variable", problem))?;
        let mut command: Vec<String> = vec![HOST_PROGRAM.to_owned(), "drive".to_owned()];
        let mut say = |option: &str, value: String| command.push(format!("--{option}={value}"));
        variables
            .into_iter()
            .for_each(|variable| say("input", variable));
        say("output", answer.name.clone());
        for (name, value) in &wiring.parameters {
            let invalid = |problem| InvalidMapping::new(format!("parameters.{name}"), problem);
            let variable =
                find_variable(description, Causality::Parameter, name).map_err(invalid)?;
            let value = convert_parameter(*value, variable).map_err(invalid)?;
            if !variable.kind.accepts(value) {
                let problem = format!(
                    "{value} is not a value of a parameter that is {}",
                    variable.kind.name()
                );
                return Err(invalid(problem).into());
            }
            say("parameter", format!("{name}={value}"));
        }
        if let Some(interval_s) = wiring.decision_interval_s {
            say("interval-s", interval_s.to_string());
        }
        // `./` keeps the path from being parsed as an option.
        command.push(format!("./{path}"));
        Ok(Self {
            command,
            program: Some(find_fmu_host().ok_or(FmuProblem::MissingHost)?),
            files: vec![path.to_owned()],
            mapping: Mapping {
                inputs,
                output,
                decision_interval_s: wiring.decision_interval_s,
                ..plain.mapping.clone()
            },
            ..plain
        })
    }
}

fn inputs_by_name(description: &ModelDescription) -> Result<Vec<InputMapping>, InvalidMapping> {
    let inputs: Result<Vec<InputMapping>, String> = description
        .with_causality(Causality::Input)
        .map(|Variable { name, .. }| {
            let named = ObservedQuantity::from_name(name).map(InputMapping::unscaled);
            named.ok_or_else(|| {
                format!(
                    "its input `{name}` has not the name of a quantity: write a controller file, F.toml with `fmu`, \
                        that connects such inputs by `[[inputs]]` with `quantity` and `variable` \
                        (docs/controllers.md); the quantities are {}",
                    ObservedQuantity::names().collect::<Vec<_>>().join(", ")
                )
            })
        })
        .collect();
    match inputs {
        Ok(inputs) if inputs.is_empty() => Err(InvalidMapping::new("inputs", "it has none")),
        other => other.map_err(|problem| InvalidMapping::new("inputs", problem)),
    }
}

/// Returns the inputs in the units of their variables, and the names of the variables.
fn connect_inputs(
    description: &ModelDescription,
    inputs: Vec<InputMapping>,
) -> Result<(Vec<InputMapping>, Vec<String>), InvalidMapping> {
    let mut names: Vec<String> = Vec::with_capacity(inputs.len());
    let mut converted = Vec::with_capacity(inputs.len());
    for (index, input) in inputs.into_iter().enumerate() {
        let invalid = |problem: String| InvalidMapping::new(format!("inputs[{index}]"), problem);
        let name = match (&input.variable, input.quantity) {
            (Some(variable), _) => variable,
            (None, Some(quantity)) => quantity.name(),
            (None, None) => {
                return Err(invalid(
                    "a constant needs a `variable` that is set to it".to_owned(),
                ));
            }
        };
        let variable = find_variable(description, Causality::Input, name).map_err(invalid)?;
        if names.iter().any(|other| other == name) {
            return Err(invalid(format!("the FMU's input `{name}` is set twice")));
        }
        names.push(name.to_owned());
        converted.push(convert_input(input, variable).map_err(invalid)?);
    }
    Ok((converted, names))
}

fn answer_variable<'d>(
    description: &'d ModelDescription,
    output: &OutputMapping,
) -> Result<&'d Variable, InvalidMapping> {
    let invalid = |problem| InvalidMapping::new("output.variable", problem);
    let outputs: Vec<&Variable> = description
        .with_causality(Causality::Output)
        .filter(|variable| variable.kind == VariableType::Real)
        .collect();
    let name = match (&output.variable, outputs.as_slice()) {
        (Some(variable), _) => variable,
        (None, [only]) => &only.name,
        (None, _) => DEFAULT_OUTPUT,
    };
    let found = find_variable(description, Causality::Output, name).map_err(invalid)?;
    match found.kind {
        VariableType::Real => Ok(found),
        kind => Err(invalid(format!(
            "`{name}` is {}, and an acceleration is real",
            kind.name()
        ))),
    }
}

fn find_variable<'a>(
    description: &'a ModelDescription,
    causality: Causality,
    name: &str,
) -> Result<&'a Variable, String> {
    let of_kind = || description.with_causality(causality);
    of_kind()
        .find(|variable| variable.name == name)
        .ok_or_else(|| {
            let what = match causality {
                Causality::Input => "inputs",
                Causality::Output => "outputs",
                Causality::Parameter => "parameters",
            };
            let mut names: Vec<&str> = of_kind()
                .map(|variable| variable.name.as_str())
                .take(13)
                .collect();
            if names.len() == 13 {
                names[12] = "…";
            }
            let there = if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            };
            format!("the FMU has no `{name}` among its {what}: {there}")
        })
}

/// Finds the program that runs FMUs: by the variable `CRUMPLE_FMU`, beside this program, or on the path.
#[must_use]
pub fn find_fmu_host() -> Option<PathBuf> {
    let absolute = |path: PathBuf| std::path::absolute(path).ok().filter(|path| path.is_file());
    if let Some(text) = std::env::var_os(HOST_ENV_VAR) {
        return absolute(text.into());
    }
    let name = format!("{HOST_PROGRAM}{}", std::env::consts::EXE_SUFFIX);
    let own = std::env::current_exe().ok();
    // Cargo places tests and examples in subfolders beside the programs.
    let is_of_cargo = |folder: &Path| folder.ends_with("deps") || folder.ends_with("examples");
    let beside = own.iter().flat_map(|own| {
        let folder = own.parent();
        let above = folder
            .filter(|folder| is_of_cargo(folder))
            .and_then(Path::parent);
        folder.into_iter().chain(above)
    });
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = beside
        .map(Path::to_owned)
        .chain(std::env::split_paths(&path));
    folders.map(|folder| folder.join(&name)).find_map(absolute)
}
