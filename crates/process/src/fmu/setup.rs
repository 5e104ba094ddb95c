//! Connections of an FMU to quantities, and the command that runs it.

use std::path::{Path, PathBuf};

use crumple_fmu::{Causality, Fmu, ModelDescription, Variable, VariableType};

use super::units::{convert_input, convert_output, convert_parameter};
use super::{FmuConfig, FmuProblem};
use crate::setup::ProcessSetup;
use crumple_networks::{InputMapping, InvalidMapping, Mapping, OutputMapping};
use crumple_sim::control::ObservedQuantity;

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
        let inputs = connect_inputs(description, inputs)?;
        let output = wiring
            .output
            .unwrap_or_else(|| plain.mapping.output.clone());
        let answer = answer_variable(description, &output)?;
        let output = convert_output(output, answer)
            .map_err(|problem| InvalidMapping::new("output.variable", problem))?;
        let mut command: Vec<String> = vec![HOST_PROGRAM.to_owned(), "drive".to_owned()];
        command.extend(
            inputs
                .iter()
                .map(|input| format!("--input={}", input.variable)),
        );
        command.push(format!("--output={}", answer.name));
        if let Some(name) = &wiring.warning {
            let warning = real_output(description, name)
                .map_err(|problem| InvalidMapping::new("warning", problem))?;
            command.push(format!("--warning={}", warning.name));
        }
        for (name, value) in &wiring.parameters {
            let value = parameter_value(description, name, *value)
                .map_err(|problem| InvalidMapping::new(format!("parameters.{name}"), problem))?;
            command.push(format!("--parameter={name}={value}"));
        }
        let interval_s = wiring.decision_interval_s;
        command.extend(interval_s.map(|interval_s| format!("--interval-s={interval_s}")));
        // `./` keeps the path from being parsed as an option.
        command.push(format!("./{path}"));
        Ok(Self {
            command,
            program: Some(find_fmu_host().ok_or(FmuProblem::MissingHost)?),
            files: vec![path.to_owned()],
            mapping: Mapping {
                inputs: inputs.into_iter().map(|input| input.mapping).collect(),
                output,
                decision_interval_s: interval_s,
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

/// Returns the value of a parameter in the unit of its variable.
fn parameter_value(
    description: &ModelDescription,
    name: &str,
    si_value: f64,
) -> Result<f64, String> {
    let variable = find_variable(description, Causality::Parameter, name)?;
    let value = convert_parameter(si_value, variable)?;
    if variable.kind.accepts(value) {
        return Ok(value);
    }
    Err(format!(
        "{value} is not a value of a parameter that is {}",
        variable.kind.name()
    ))
}

/// An input of an FMU.
struct ConnectedInput {
    /// Name of its variable.
    variable: String,
    /// Mapping to values in the unit of the variable.
    mapping: InputMapping,
}

/// Connects inputs to the variables of an FMU.
fn connect_inputs(
    description: &ModelDescription,
    inputs: Vec<InputMapping>,
) -> Result<Vec<ConnectedInput>, InvalidMapping> {
    let mut connected: Vec<ConnectedInput> = Vec::with_capacity(inputs.len());
    for (index, input) in inputs.into_iter().enumerate() {
        let input = connect_input(description, input, &connected)
            .map_err(|problem| InvalidMapping::new(format!("inputs[{index}]"), problem))?;
        connected.push(input);
    }
    Ok(connected)
}

/// Connects an input to a variable that none of the `connected` inputs has.
fn connect_input(
    description: &ModelDescription,
    input: InputMapping,
    connected: &[ConnectedInput],
) -> Result<ConnectedInput, String> {
    let name = match (&input.variable, input.quantity) {
        (Some(variable), _) => variable.clone(),
        (None, Some(quantity)) => quantity.name().to_owned(),
        (None, None) => {
            return Err("a constant needs a `variable` that is set to it".to_owned());
        }
    };
    let variable = find_variable(description, Causality::Input, &name)?;
    if connected.iter().any(|other| other.variable == name) {
        return Err(format!("the FMU's input `{name}` is set twice"));
    }
    Ok(ConnectedInput {
        mapping: convert_input(input, variable)?,
        variable: name,
    })
}

fn answer_variable<'d>(
    description: &'d ModelDescription,
    output: &OutputMapping,
) -> Result<&'d Variable, InvalidMapping> {
    let outputs: Vec<&Variable> = description
        .with_causality(Causality::Output)
        .filter(|variable| variable.kind == VariableType::Real)
        .collect();
    let name = match (&output.variable, outputs.as_slice()) {
        (Some(variable), _) => variable,
        (None, [only]) => &only.name,
        (None, _) => DEFAULT_OUTPUT,
    };
    real_output(description, name)
        .map_err(|problem| InvalidMapping::new("output.variable", problem))
}

fn real_output<'d>(description: &'d ModelDescription, name: &str) -> Result<&'d Variable, String> {
    let variable = find_variable(description, Causality::Output, name)?;
    match variable.kind {
        VariableType::Real => Ok(variable),
        kind => Err(format!(
            "`{name}` is {}, and crumple reads only real outputs",
            kind.name()
        )),
    }
}

fn find_variable<'a>(
    description: &'a ModelDescription,
    causality: Causality,
    name: &str,
) -> Result<&'a Variable, String> {
    description
        .with_causality(causality)
        .find(|variable| variable.name == name)
        .ok_or_else(|| {
            let what = match causality {
                Causality::Input => "inputs",
                Causality::Output => "outputs",
                Causality::Parameter => "parameters",
            };
            let mut names: Vec<&str> = description
                .with_causality(causality)
                .map(|variable| variable.name.as_str())
                .take(13)
                .collect();
            if names.len() == 13 {
                names[12] = "…";
            }
            let list = if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            };
            format!("the FMU has no `{name}` among its {what}: {list}")
        })
}

/// Finds the program that runs FMUs: by the variable `CRUMPLE_FMU`, beside this program, or on the path.
#[must_use]
pub fn find_fmu_host() -> Option<PathBuf> {
    if let Some(text) = std::env::var_os(HOST_ENV_VAR) {
        return absolute_file(text.into());
    }
    let name = format!("{HOST_PROGRAM}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH").unwrap_or_default();
    program_folders()
        .into_iter()
        .chain(std::env::split_paths(&path))
        .map(|folder| folder.join(&name))
        .find_map(absolute_file)
}

/// Returns the folder of this program, and the one above if Cargo places tests or examples there.
fn program_folders() -> Vec<PathBuf> {
    let program = std::env::current_exe().ok();
    let Some(folder) = program.as_deref().and_then(Path::parent) else {
        return Vec::new();
    };
    let mut folders = vec![folder.to_owned()];
    if folder.ends_with("deps") || folder.ends_with("examples") {
        folders.extend(folder.parent().map(Path::to_owned));
    }
    folders
}

/// Returns the absolute path of a file; none for anything else.
fn absolute_file(path: PathBuf) -> Option<PathBuf> {
    std::path::absolute(path).ok().filter(|path| path.is_file())
}
