//! Opening of controllers by name.

use std::path::Path;
use std::sync::Arc;

use crumple_networks::network::NetworkFile;
use crumple_process::{ExternalPrograms, NameOrigin, ProcessController, ProcessSetup};
use crumple_sim::control::{
    BuiltInController, ControllerSource, ShieldedSource, StartRefusal, TestDriverSource,
};
use crumple_sim::engine::{NamedController, NotStarted};
use crumple_sim::policy::PolicyError;
use crumple_sim::scenario::{DriverProblem, OpenDriver};

use super::controller_file::{self, ControllerFileError, is_regular_file};
use super::spec::{ControllerSpec, InvalidControllerName};

/// Reason why a name does not identify a controller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownController {
    /// Neither a built-in name nor a file.
    #[error(
        "there is no controller `{name}`: use {built_in_names}, a policy, network or controller file, or a command \
        after `exec:`; each may follow `shield:` or `shield2:`"
    )]
    UnknownName {
        /// The requested name.
        name: String,
        /// Built-in names.
        built_in_names: String,
    },
    /// A file name without its extension.
    #[error("there is no controller `{name}`; did you mean the file `{file}`?")]
    MissingExtension {
        /// The requested name.
        name: String,
        /// The existing file.
        file: String,
    },
    /// A file that is not a controller.
    #[error(
        "{path} is {what}, not a controller: run a program with `exec:{command}`, or with a controller file, F.toml, \
        that has a `command` (docs/controllers.md){hint}"
    )]
    NotAController {
        /// The file.
        path: String,
        /// Description of the file.
        what: &'static str,
        /// Example of a command.
        command: String,
        /// Further advice.
        hint: &'static str,
    },
    /// A text that is no name.
    #[error(transparent)]
    Name(#[from] InvalidControllerName),
    /// A program whose start or handshake failed.
    #[error(transparent)]
    NotStarted(#[from] NotStarted),
    /// A program that the user did not name.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// An invalid policy file.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// An unusable network or controller file.
    #[error(transparent)]
    File(ControllerFileError),
}

impl From<ControllerFileError> for UnknownController {
    fn from(error: ControllerFileError) -> Self {
        match error {
            ControllerFileError::Policy(error) => Self::Policy(error),
            ControllerFileError::StartRefused(refused) => Self::StartRefused(refused),
            other => Self::File(other),
        }
    }
}

/// Opens controllers that files name: scenarios, spaces, suites, campaigns, certificates and reports.
///
/// The value carries the user's permission for programs and FMUs. Controllers that the user names need none:
/// [`find_for_user`].
///
/// ```
/// use std::path::Path;
/// use crumple_controllers::Controllers;
///
/// let shielded = Controllers::default().find("shield:acc-aeb,ttc_s=2.0", Path::new("")).unwrap();
/// assert_eq!(shielded.name, "shield:acc-aeb,ttc_s=2");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Controllers {
    /// Treatment of programs and FMUs; the default refuses them.
    pub external: ExternalPrograms,
}

impl Controllers {
    /// Finds the controller that a file names: a built-in one, or one in another file relative to `folder`
    /// ([`controller_file::load`]).
    ///
    /// # Errors
    /// [`UnknownController`] for an unknown name, or a file without a usable controller;
    /// [`UnknownController::StartRefused`] for a process or an FMU without permission.
    pub fn find(self, name: &str, folder: &Path) -> Result<NamedController, UnknownController> {
        find(name, folder, NameOrigin::File(self.external))
    }
}

impl OpenDriver for Controllers {
    fn open_driver(&self, path: &Path) -> Result<Arc<dyn ControllerSource>, DriverProblem> {
        controller_file::load(path, NameOrigin::File(self.external)).map_err(|error| match error {
            ControllerFileError::StartRefused(refused) => refused.into(),
            other => DriverProblem::Unusable(other.to_string()),
        })
    }
}

/// Finds a controller as [`Controllers::find`] does, for a name from the user, which permits processes and FMUs.
///
/// # Errors
/// [`UnknownController`], as for [`Controllers::find`].
pub fn find_for_user(name: &str, folder: &Path) -> Result<NamedController, UnknownController> {
    find(name, folder, NameOrigin::User)
}

/// Finds a controller as [`find_for_user`] does and starts its program once as a trial.
///
/// # Errors
/// [`UnknownController`], as for [`find_for_user`], and [`UnknownController::NotStarted`].
pub fn find_and_try(name: &str, folder: &Path) -> Result<NamedController, UnknownController> {
    let controller = find_for_user(name, folder)?;
    controller.try_start()?;
    Ok(controller)
}

fn find(
    name: &str,
    folder: &Path,
    named_by: NameOrigin,
) -> Result<NamedController, UnknownController> {
    let parsed = ControllerSpec::parse(name)?;
    let source = open(&parsed, folder, named_by)?;
    Ok(NamedController {
        name: parsed.to_string(),
        source,
    })
}

/// Opens a controller: reads its file, and starts nothing. A path and the folder of a command are relative to `folder`.
///
/// # Errors
/// [`UnknownController`] for a path that holds no usable controller, and for a program without permission.
pub fn open(
    parsed: &ControllerSpec,
    folder: &Path,
    named_by: NameOrigin,
) -> Result<Arc<dyn ControllerSource>, UnknownController> {
    Ok(match parsed {
        ControllerSpec::BuiltIn(spec) => Arc::new(spec.clone()),
        ControllerSpec::File(name) => open_file(name, folder, named_by)?,
        ControllerSpec::Command { words, .. } => {
            let permission = named_by.permission(|| format!("`{parsed}`"))?;
            let process =
                ProcessController::new(ProcessSetup::new(words.clone(), folder), permission);
            Arc::new(process.map_err(ControllerFileError::Command)?)
        }
        ControllerSpec::Shielded {
            settings,
            controller,
        } => Arc::new(ShieldedSource {
            controller: open(controller, folder, named_by)?,
            settings: *settings,
        }),
        ControllerSpec::WithTestDriver {
            settings,
            controller,
        } => Arc::new(TestDriverSource {
            controller: open(controller, folder, named_by)?,
            settings: settings.clone(),
        }),
    })
}

fn open_file(
    name: &str,
    folder: &Path,
    named_by: NameOrigin,
) -> Result<Arc<dyn ControllerSource>, UnknownController> {
    let path = folder.join(name);
    let is_network = NetworkFile::is_network(&path);
    if let Some(program) = not_a_controller(name, folder).filter(|_| !is_network) {
        return Err(program);
    }
    if Path::new(name).extension().is_none() && !is_network {
        if let Some(file) = file_with_extension(&path, name) {
            return Err(UnknownController::MissingExtension {
                name: name.to_owned(),
                file,
            });
        }
        return Err(UnknownController::UnknownName {
            name: name.to_owned(),
            built_in_names: similar_names(name),
        });
    }
    Ok(controller_file::load(&path, named_by)?)
}

/// Returns the built-in names that an unknown name may mean: with `car:` or `cruise:`, those of cars.
fn similar_names(name: &str) -> String {
    let prefix = |name: &str| Some(name.split_once(':')?.0.to_owned());
    let wanted = prefix(name);
    let presets = BuiltInController::presets().map(|preset| preset.name);
    let mut names: Vec<_> = presets
        .filter(|preset| wanted.is_some() && prefix(preset) == wanted)
        .collect();
    if names.is_empty() {
        let built_in = BuiltInController::all_that_drive();
        names.extend(built_in.iter().map(BuiltInController::name));
        names.push("a preset of `crumple list controllers`");
    }
    names.join(", ")
}

/// Returns the file that a name without extension may mean.
fn file_with_extension(path: &Path, name: &str) -> Option<String> {
    const EXTENSIONS: [&str; 5] = ["toml", "zip", "onnx", "fmu", "safetensors"];
    let mut extensions = EXTENSIONS.into_iter();
    let extension = extensions.find(|extension| path.with_extension(extension).is_file())?;
    Some(format!("{name}.{extension}"))
}

/// Returns the error for a name of a program, a library or a source file.
fn not_a_controller(name: &str, folder: &Path) -> Option<UnknownController> {
    const LIBRARIES: [&str; 3] = ["so", "dll", "dylib"];
    const SOURCES: [&str; 10] = ["c", "h", "cc", "cpp", "cxx", "rs", "py", "m", "java", "sh"];
    let path = folder.join(name);
    let extension = path
        .extension()
        .map(|extension| extension.to_string_lossy().to_lowercase());
    if !is_regular_file(&path) {
        return None;
    }
    let [what, hint] = match extension.as_deref() {
        Some(extension) if LIBRARIES.contains(&extension) => {
            ["a shared library", "; export a library as an FMU, F.fmu"]
        }
        Some(extension) if SOURCES.contains(&extension) => [
            "source code",
            "; export a model as an FMU, F.fmu, or a network, F.onnx",
        ],
        Some(_) => return None,
        None => ["a file without an extension", ""],
    };
    let command = match extension.as_deref() {
        Some("py") => format!("python3 {name}"),
        // A shell script can be run itself. A compiled source file or a library suggests a program of the same name
        // without the extension.
        Some("sh") => command_path(Path::new(name)),
        _ => command_path(&Path::new(name).with_extension("")),
    };
    Some(UnknownController::NotAController {
        path: path.display().to_string(),
        what,
        command,
        hint,
    })
}

/// Returns a program as a command names it; `./` marks one in this folder.
fn command_path(program: &Path) -> String {
    let name = program.display();
    if program.components().count() > 1 {
        name.to_string()
    } else {
        format!("./{name}")
    }
}
