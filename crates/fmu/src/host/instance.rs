//! An FMU that runs.

use std::path::{Path, PathBuf};

use super::fmi2::Fmi2;
use super::fmi3::Fmi3;
use super::unpacked::UnpackedFolder;
use crate::{Causality, Description, FmiVersion, Fmu, Kind, Variable};

/// What is set, and what is read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Wiring {
    /// A variable for each number that is seen.
    pub(super) inputs: Vec<String>,
    /// The variable that is the answer.
    pub(super) output: String,
    /// What parameters begin with.
    pub(super) parameters: Vec<(String, f64)>,
    /// Time between decisions in seconds; none for the scenario's step.
    pub(super) interval_s: Option<f64>,
}

/// A variable as the library knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Wire {
    pub(super) reference: u32,
    pub(super) kind: Kind,
}

/// How a call ended: both editions of the standard number these alike.
pub(super) fn checked(call: &str, status: i32) -> Result<(), String> {
    let said = match status {
        // Done, and done with a warning, which the FMU has logged.
        0 | 1 => return Ok(()),
        2 => "discarded it",
        3 => "reports an error",
        4 => "reports that it cannot go on (fatal)",
        5 => "asks to be waited for, which is not supported",
        other => return Err(format!("{call} returned {other}, which the standard does not know")),
    };
    Err(format!("the FMU {said} ({call})"))
}

/// The calls that both editions have. Those that are about an instance come after it was made and before it is freed.
pub(super) trait Calls {
    fn instantiate(&mut self) -> Result<(), String>;
    fn reset(&mut self) -> Result<(), String>;
    fn set(&mut self, wire: Wire, value: f64) -> Result<(), String>;
    fn enter_initialization(&mut self) -> Result<(), String>;
    fn exit_initialization(&mut self) -> Result<(), String>;
    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String>;
    fn get(&mut self, wire: Wire) -> Result<f64, String>;
    /// What the FMU says to it changes nothing.
    fn terminate(&mut self);
    fn free(&mut self);
}

/// What every instance of an FMU is made with.
pub(super) struct Made<'a> {
    pub(super) library: &'a Path,
    pub(super) folder: &'a Path,
    pub(super) description: &'a Description,
}

/// How far a run is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// There is no instance.
    None,
    /// There is one, which is not initialized.
    Made,
    /// It steps.
    Initialized,
    /// A call has failed: the standard leaves little that may be called then, and the process is about to end.
    Broken,
}

/// An FMU, wired.
pub(super) struct Instance {
    calls: Box<dyn Calls>,
    inputs: Vec<Wire>,
    output: Wire,
    parameters: Vec<(Wire, f64)>,
    is_instantiated_once: bool,
    stage: Stage,
    /// Removed already if the FMU needs no file but its library. Dropped after `calls`, whose library may read its files until
    /// it is closed.
    _folder: Option<UnpackedFolder>,
}

impl Instance {
    /// Unpacks and loads an FMU.
    pub(super) fn load(path: &Path, wiring: &Wiring) -> Result<Self, String> {
        let mut fmu = Fmu::open(path).map_err(|error| error.to_string())?;
        let description = fmu.description();
        let wire = |name: &str, causality| wire(description, name, causality);
        let inputs = wiring.inputs.iter().map(|name| wire(name, Causality::Input)).collect::<Result<_, _>>()?;
        let output = wire(&wiring.output, Causality::Output)?;
        let parameters = wiring.parameters.iter().map(|(name, value)| {
            let wire = wire(name, Causality::Parameter)?;
            if wire.kind.accepts(*value) { Ok((wire, *value)) } else { Err(unfit(name, wire.kind, *value)) }
        });
        let parameters = parameters.collect::<Result<_, _>>()?;
        let folder = UnpackedFolder::new().map_err(|error| format!("cannot be unpacked: temporary folder: {error}"))?;
        let library = fmu.unpack(folder.path()).map_err(|error| error.to_string())?;
        let made = Made { library: &library, folder: folder.path(), description: fmu.description() };
        let calls: Box<dyn Calls> = match fmu.description().version {
            FmiVersion::Two => Box::new(Fmi2::load(&made)?),
            FmiVersion::Three => Box::new(Fmi3::load(&made)?),
        };
        // A process that is killed leaves nothing then. An open library needs its file no longer, except on Windows.
        let is_needed = cfg!(windows) || fmu.has_resources() || is_among_others(&library);
        let is_instantiated_once = fmu.description().is_instantiated_once;
        let _folder = is_needed.then_some(folder);
        Ok(Self { calls, inputs, output, parameters, is_instantiated_once, stage: Stage::None, _folder })
    }

    /// Begins a run.
    pub(super) fn begin(&mut self) -> Result<(), String> {
        if self.stage == Stage::Initialized {
            self.calls.terminate();
        }
        match std::mem::replace(&mut self.stage, Stage::Broken) {
            Stage::None => self.calls.instantiate()?,
            Stage::Broken => return Err("cannot begin again".to_owned()),
            Stage::Made | Stage::Initialized if self.is_instantiated_once => self.calls.reset()?,
            Stage::Made | Stage::Initialized => {
                self.calls.free();
                self.calls.instantiate()?;
            }
        }
        self.parameters.iter().try_for_each(|(wire, value)| self.calls.set(*wire, *value))?;
        self.stage = Stage::Made;
        Ok(())
    }

    /// The answer to what is seen.
    pub(super) fn decide(&mut self, time_s: f64, interval_s: f64, see: &[f64]) -> Result<f64, String> {
        // What is seen first is what the FMU is initialized with.
        let is_first = match std::mem::replace(&mut self.stage, Stage::Broken) {
            Stage::Made => true,
            Stage::Initialized => false,
            Stage::None | Stage::Broken => return Err("is asked before a run has begun".to_owned()),
        };
        if is_first {
            self.calls.enter_initialization()?;
        }
        for (wire, value) in self.inputs.iter().zip(see) {
            let value = if wire.kind == Kind::Integer { value.round() } else { *value };
            self.calls.set(*wire, value)?;
        }
        if is_first {
            self.calls.exit_initialization()?;
        }
        self.calls.step(time_s, interval_s)?;
        let answer = self.calls.get(self.output)?;
        self.stage = Stage::Initialized;
        if answer.is_finite() { Ok(answer) } else { Err(format!("its output is {answer}, at {time_s} s")) }
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.stage == Stage::Initialized {
            self.calls.terminate();
        }
        if matches!(self.stage, Stage::Initialized | Stage::Made) {
            self.calls.free();
        }
    }
}

fn wire(description: &Description, name: &str, causality: Causality) -> Result<Wire, String> {
    let found = description.of(causality).find(|variable| variable.name == name);
    let Variable { reference, kind, .. } =
        found.ok_or_else(|| format!("has no variable {name:?} of that kind ({causality:?})"))?;
    Ok(Wire { reference: *reference, kind: *kind })
}

fn unfit(name: &str, kind: Kind, value: f64) -> String {
    format!("{name}: {value} is no value of a variable that is {}", kind.name())
}

/// Whether a library lies beside others, which it may load when it wants to.
fn is_among_others(library: &Path) -> bool {
    let entries = library.parent().and_then(|folder| std::fs::read_dir(folder).ok());
    entries.is_none_or(|entries| entries.count() > 1)
}

/// Returns the reason that the system's loader gives, without the folder that the FMU is unpacked into, and a way out.
pub(super) fn not_loaded(error: &libloading::Error, folder: &Path) -> String {
    let reason = std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string);
    let reason = reason.replace(&folder.join("").to_string_lossy().into_owned(), "");
    format!(
        "its library cannot be loaded: {reason}; install the libraries that it needs (`ldd` lists those that are missing), or build \
         the FMU for this system"
    )
}

/// Where an FMU's resources lie.
pub(super) fn resources(folder: &Path) -> PathBuf {
    folder.join("resources")
}
