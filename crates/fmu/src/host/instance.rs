//! Running FMU.

use std::path::Path;

use super::fmi2::Fmi2;
use super::fmi3::Fmi3;
use super::unpacked_folder::UnpackedFolder;
use crate::{Causality, FmiVersion, Fmu, ModelDescription, VariableType};

/// Value of the warning's variable above which the FMU warns.
const WARNING_ABOVE: f64 = 0.5;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct VariableMap {
    /// Variable of each observed quantity, in order.
    pub(super) inputs: Vec<String>,
    /// Variable of the commanded acceleration.
    pub(super) output: String,
    /// Variable that is above 0.5 while the FMU warns of a collision.
    pub(super) warning: Option<String>,
    pub(super) parameters: Vec<(String, f64)>,
    /// Time between decisions, in seconds; none for the scenario's step.
    pub(super) interval_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct VariableRef {
    pub(super) value_reference: u32,
    pub(super) kind: VariableType,
}

/// Outputs of an FMU after a step.
pub(super) struct FmuOutputs {
    /// Commanded acceleration, in the unit of its variable.
    pub(super) answer: f64,
    /// True while the FMU warns of a collision; `None` without a variable for it.
    pub(super) is_warning: Option<bool>,
}

/// Checks the status of a call; both editions use the same numbers.
pub(super) fn check_status(call: &str, status: i32) -> Result<(), String> {
    let text = match status {
        // Success, and success with a warning, which the FMU has logged.
        0 | 1 => return Ok(()),
        2 => "discarded it",
        3 => "reports an error",
        4 => "reported a fatal error",
        5 => "returned `pending`, which is not supported",
        other => {
            return Err(format!(
                "{call} returned {other}, which is not a status of the FMI standard"
            ));
        }
    };
    Err(format!("the FMU {text} ({call})"))
}

/// Calls of both editions. All but `instantiate` require an instance that is not yet freed.
pub(super) trait FmiFunctions {
    fn instantiate(&mut self) -> Result<(), String>;
    fn reset(&mut self) -> Result<(), String>;
    fn set(&mut self, variable: VariableRef, value: f64) -> Result<(), String>;
    fn enter_initialization(&mut self) -> Result<(), String>;
    fn exit_initialization(&mut self) -> Result<(), String>;
    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String>;
    fn get(&mut self, variable: VariableRef) -> Result<f64, String>;
    /// The returned status is ignored.
    fn terminate(&mut self);
    fn free(&mut self);
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum InstanceState {
    None,
    Instantiated,
    Initialized,
    /// A call has failed. The standard allows few calls after that, and the process is about to end.
    Failed,
}

pub(super) struct Instance {
    functions: Box<dyn FmiFunctions>,
    inputs: Vec<VariableRef>,
    output: VariableRef,
    warning: Option<VariableRef>,
    parameters: Vec<(VariableRef, f64)>,
    is_once_per_process: bool,
    state: InstanceState,
    /// Unpacked files; none if only the library is needed. Dropped after `functions`, which may read them.
    _folder: Option<UnpackedFolder>,
}

impl Instance {
    /// Unpacks an FMU, loads its library, and connects its variables.
    pub(super) fn load(path: &Path, wiring: &VariableMap) -> Result<Self, String> {
        let mut fmu = Fmu::open(path).map_err(|error| error.to_string())?;
        let description = fmu.description();
        let inputs = wiring
            .inputs
            .iter()
            .map(|name| find_variable(description, name, Causality::Input))
            .collect::<Result<_, _>>()?;
        let output = find_variable(description, &wiring.output, Causality::Output)?;
        let warning = match &wiring.warning {
            Some(name) => Some(find_variable(description, name, Causality::Output)?),
            None => None,
        };
        let parameters = wiring
            .parameters
            .iter()
            .map(|(name, value)| Ok((find_parameter(description, name, *value)?, *value)))
            .collect::<Result<_, String>>()?;
        let folder = UnpackedFolder::new()
            .map_err(|error| format!("cannot be unpacked: temporary folder: {error}"))?;
        let library = fmu
            .unpack(folder.path())
            .map_err(|error| error.to_string())?;
        let functions: Box<dyn FmiFunctions> = match fmu.description().version {
            FmiVersion::Two => Box::new(Fmi2::load(&library, folder.path(), fmu.description())?),
            FmiVersion::Three => Box::new(Fmi3::load(&library, folder.path(), fmu.description())?),
        };
        // Early removal leaves nothing behind if the process is killed. Only Windows needs the file of an open library.
        let is_needed = cfg!(windows) || fmu.has_resources() || has_sibling_libraries(&library);
        Ok(Self {
            functions,
            inputs,
            output,
            warning,
            parameters,
            is_once_per_process: fmu.description().is_once_per_process,
            state: InstanceState::None,
            _folder: is_needed.then_some(folder),
        })
    }

    pub(super) fn start_run(&mut self) -> Result<(), String> {
        if self.state == InstanceState::Initialized {
            self.functions.terminate();
        }
        match std::mem::replace(&mut self.state, InstanceState::Failed) {
            InstanceState::None => self.functions.instantiate()?,
            InstanceState::Failed => {
                return Err("cannot start another run after an error".to_owned());
            }
            InstanceState::Instantiated | InstanceState::Initialized
                if self.is_once_per_process =>
            {
                self.functions.reset()?
            }
            InstanceState::Instantiated | InstanceState::Initialized => {
                self.functions.free();
                self.functions.instantiate()?;
            }
        }
        self.parameters
            .iter()
            .try_for_each(|(variable, value)| self.functions.set(*variable, *value))?;
        self.state = InstanceState::Instantiated;
        Ok(())
    }

    pub(super) fn decide(
        &mut self,
        time_s: f64,
        interval_s: f64,
        inputs: &[f64],
    ) -> Result<FmuOutputs, String> {
        // The first observation initializes the FMU.
        let is_first = match std::mem::replace(&mut self.state, InstanceState::Failed) {
            InstanceState::Instantiated => true,
            InstanceState::Initialized => false,
            InstanceState::None | InstanceState::Failed => {
                return Err("received a request for a decision before a run started".to_owned());
            }
        };
        if is_first {
            self.functions.enter_initialization()?;
        }
        for (variable, value) in self.inputs.iter().zip(inputs) {
            let value = if variable.kind == VariableType::Integer {
                value.round()
            } else {
                *value
            };
            self.functions.set(*variable, value)?;
        }
        if is_first {
            self.functions.exit_initialization()?;
        }
        self.functions.step(time_s, interval_s)?;
        let answer = self.functions.get(self.output)?;
        let warning = self.warning.map(|variable| self.functions.get(variable));
        let is_warning = warning.transpose()?.map(|value| value > WARNING_ABOVE);
        self.state = InstanceState::Initialized;
        if answer.is_finite() {
            Ok(FmuOutputs { answer, is_warning })
        } else {
            Err(format!("its output is {answer}, at {time_s} s"))
        }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.state == InstanceState::Initialized {
            self.functions.terminate();
        }
        if matches!(
            self.state,
            InstanceState::Initialized | InstanceState::Instantiated
        ) {
            self.functions.free();
        }
    }
}

fn find_variable(
    description: &ModelDescription,
    name: &str,
    causality: Causality,
) -> Result<VariableRef, String> {
    let variable = description
        .with_causality(causality)
        .find(|variable| variable.name == name)
        .ok_or_else(|| format!("has no variable {name:?} of that kind ({causality:?})"))?;
    Ok(VariableRef {
        value_reference: variable.value_reference,
        kind: variable.kind,
    })
}

/// Returns the parameter of a name, which must accept a value.
fn find_parameter(
    description: &ModelDescription,
    name: &str,
    value: f64,
) -> Result<VariableRef, String> {
    let parameter = find_variable(description, name, Causality::Parameter)?;
    if parameter.kind.accepts(value) {
        return Ok(parameter);
    }
    Err(format!(
        "{name}: {value} is no value of a variable that is {}",
        parameter.kind.name()
    ))
}

/// True if the folder of the library holds other files, which it may load later.
fn has_sibling_libraries(library: &Path) -> bool {
    let entries = library
        .parent()
        .and_then(|folder| std::fs::read_dir(folder).ok());
    entries.is_none_or(|entries| entries.count() > 1)
}

/// Returns the loader's reason without the temporary folder, and a hint.
pub(super) fn load_error_message(error: &libloading::Error, folder: &Path) -> String {
    let reason =
        std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string);
    let reason = reason.replace(&folder.join("").to_string_lossy().into_owned(), "");
    format!(
        "its library cannot be loaded: {reason}; install the libraries that it needs (`ldd` lists those that are \
         missing), or build the FMU for this system"
    )
}
