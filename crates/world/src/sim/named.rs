//! Controllers under test, by name.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use crate::control::{
    BuiltIn, ControllerFailure, ControllerSource, ControllerSpec, InvalidSetting,
    InvalidShieldSetting, NameOrigin, PolicySource, ProcessController, ProcessSetup,
    RetrainedPolicy, ShieldSettings, ShieldedSource, StartRefusal,
};
use crate::network::NetworkFile;
use crate::policy::{Policy, PolicyError};
use crate::scenario::controller_file::{self, ControllerFileError, is_regular_file};

/// A controller under test and its name.
///
/// ```
/// use std::path::Path;
/// use crumple_world::sim::NamedController;
///
/// let shielded = NamedController::find("shield:acc-aeb,ttc_s=2.0", Path::new("")).unwrap();
/// assert_eq!(shielded.name, "shield:acc-aeb,ttc_s=2");
/// assert!(NamedController::find("acc-aeb,ttc=2", Path::new("")).is_err());
/// ```
#[derive(Debug, Clone)]
pub struct NamedController {
    /// Built-in name, or path as given by the user.
    pub name: String,
    /// Source of the controller.
    pub source: Arc<dyn ControllerSource>,
}

const EXEC_PREFIX: &str = "exec:";

/// Reason why a name does not identify a controller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownController {
    /// Neither a built-in name nor a file.
    #[error(
        "there is no controller `{name}`: use {built_in_names}, a policy, network or controller file, or a command \
        after `exec:`; each may follow `shield:`"
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
    /// A wrong setting of a shield.
    #[error(transparent)]
    ShieldSetting(#[from] InvalidShieldSetting),
    /// A shield around another shield.
    #[error("only one shield may stand before a controller")]
    NestedShields,
    /// A command with invalid quoting.
    #[error(
        "`{command}` is not a valid command: a quotation mark is not closed, or a backslash is last"
    )]
    CommandSyntax {
        /// The command.
        command: String,
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
    /// A process whose start or handshake failed.
    #[error("{location}{failure}")]
    NotStarted {
        /// Location of the command in a file, as a message prefix (`acc.toml:12: command: `); empty without a file.
        location: String,
        /// The failure.
        failure: ControllerFailure,
    },
    /// A program that the user did not name.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// A wrong setting of a built-in controller.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// An invalid policy file.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// An unusable network or controller file.
    #[error(transparent)]
    File(ControllerFileError),
}

/// A controller that contradicted itself or cannot be started any more, so that its results are not reproducible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the controller `{controller}` failed during the command, so its results are invalid: {failure}"
)]
pub struct RefusedController {
    /// Name of the controller.
    pub controller: String,
    /// The failure.
    pub failure: ControllerFailure,
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

impl NamedController {
    /// Creates a controller from an external source, under a given name.
    #[must_use]
    pub fn from_source(name: &str, source: Arc<dyn ControllerSource>) -> Self {
        Self {
            name: name.to_owned(),
            source,
        }
    }

    /// Finds the controller that a file names: a built-in one, or one in another file relative to `folder`
    /// ([`controller_file::load`]). For names from the user there is [`Self::find_for_user`].
    ///
    /// A built-in name may have settings (`acc-aeb,ttc_s=2.0`, see [`ControllerSpec::parse`]).
    ///
    /// `exec:COMMAND ARGUMENTS` is a process that runs in `folder`, split into words as in a shell; not started here.
    ///
    /// `shield:C` is controller C behind a shield. `shield,ahead=A:C` assumes that the leader never brakes harder than
    /// A m/s² on a dry road, instead of its own limit. `gap-error` (m), `speed-error` and `ahead-speed-error` (m/s)
    /// bound observation errors; if any is given, the others are 0. Only one shield may stand before a controller.
    ///
    /// # Errors
    /// [`UnknownController`] for an unknown name, or a file without a usable controller;
    /// [`UnknownController::StartRefused`] for a process or an FMU, unless
    /// [`allow_external`](crate::control::allow_external) was called.
    pub fn find(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        Self::parse(name, folder, NameOrigin::File)
    }

    /// Finds a built-in controller, behind a shield or not. Reads no file and starts nothing.
    #[must_use]
    pub fn find_built_in(name: &str) -> Option<Self> {
        ControllerSpec::parse(split_shield(name).map_or(name, |(_, inner)| inner))?.ok()?;
        Self::find(name, Path::new("")).ok()
    }

    /// Returns the path in the name of a controller that a file holds, behind a shield or not; `None` for a built-in
    /// controller and for a command.
    #[must_use]
    pub fn file_in_name(name: &str) -> Option<&str> {
        let inner = split_shield(name).map_or(name, |(_, inner)| inner);
        let is_file = ControllerSpec::parse(&present_name(inner)).is_none()
            && !inner.starts_with(EXEC_PREFIX);
        is_file.then_some(inner)
    }

    /// Finds a controller as [`Self::find`] does, for a name from the user, which permits processes and FMUs.
    ///
    /// # Errors
    /// [`UnknownController`], as for [`Self::find`].
    pub fn find_for_user(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        Self::parse(name, folder, NameOrigin::User)
    }

    /// Finds a controller as [`Self::find_for_user`] does and starts its program once as a trial.
    ///
    /// # Errors
    /// [`UnknownController`], as for [`Self::find_for_user`], and [`UnknownController::NotStarted`].
    pub fn find_and_try(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        let found = Self::find_for_user(name, folder)?;
        found.try_start()?;
        Ok(found)
    }

    /// Starts the program once as a trial.
    ///
    /// # Errors
    /// [`UnknownController::NotStarted`].
    pub fn try_start(&self) -> Result<(), UnknownController> {
        self.source
            .try_start()
            .map_err(|failure| UnknownController::NotStarted {
                location: self.program_location(),
                failure,
            })
    }

    fn program_location(&self) -> String {
        match (self.source.file(), self.source.program_field()) {
            (Some(file), Some(field)) => file.program_location(field),
            _ => String::new(),
        }
    }

    /// Returns file and line of a field as a message prefix (`acc.toml:12: `); empty without a file.
    #[must_use]
    pub fn field_location(&self, field: &str) -> String {
        self.source
            .file()
            .map_or_else(String::new, |file| file.field_location(field))
    }

    /// Fails if the controller contradicted itself or can no longer be started; call before reporting any result.
    ///
    /// # Errors
    /// [`RefusedController`] if the controller answered the same query differently, or cannot be started any more.
    pub fn ensure_trusted(&self) -> Result<(), RefusedController> {
        match self.source.refusal() {
            None => Ok(()),
            Some(failure) => Err(RefusedController {
                controller: self.name.clone(),
                failure,
            }),
        }
    }

    fn parse(name: &str, folder: &Path, named_by: NameOrigin) -> Result<Self, UnknownController> {
        let Some((settings, inner)) = split_shield(name) else {
            return Self::parse_unshielded(name, folder, named_by);
        };
        let settings = ShieldSettings::parse(settings)?;
        if split_shield(inner).is_some() {
            return Err(UnknownController::NestedShields);
        }
        let inner = Self::parse_unshielded(inner, folder, named_by)?;
        Ok(inner.behind_shield(settings))
    }

    /// Returns the controller behind a shield.
    #[must_use]
    pub fn behind_shield(self, settings: ShieldSettings) -> Self {
        Self {
            name: format!("shield{}:{}", settings.to_arg(), self.name),
            source: Arc::new(ShieldedSource {
                controller: self.source,
                settings,
            }),
        }
    }

    fn parse_unshielded(
        name: &str,
        folder: &Path,
        named_by: NameOrigin,
    ) -> Result<Self, UnknownController> {
        let name = &*present_name(name);
        if let Some(spec) = ControllerSpec::parse(name) {
            return Ok(spec?.into());
        }
        if let Some(command) = name.strip_prefix(EXEC_PREFIX) {
            let words = split_command(command).ok_or_else(|| UnknownController::CommandSyntax {
                command: command.to_owned(),
            })?;
            let permission = named_by.permission(|| format!("`{name}`"))?;
            let process = ProcessController::new(ProcessSetup::new(words, folder), permission)
                .map_err(ControllerFileError::Command)?;
            return Ok(Self {
                name: name.to_owned(),
                source: Arc::new(process),
            });
        }
        let place = folder.join(name);
        let is_network = NetworkFile::is_network(&place);
        if let Some(program) = not_a_controller(name, folder).filter(|_| !is_network) {
            return Err(program);
        }
        if Path::new(name).extension().is_none() && !is_network {
            if let Some(file) = file_with_extension(&place, name) {
                return Err(UnknownController::MissingExtension {
                    name: name.to_owned(),
                    file,
                });
            }
            let known: Vec<_> = ControllerSpec::all()
                .iter()
                .map(ControllerSpec::name)
                .collect();
            return Err(UnknownController::UnknownName {
                name: name.to_owned(),
                built_in_names: known.join(", "),
            });
        }
        Ok(Self {
            name: name.to_owned(),
            source: controller_file::load(&place, named_by)?,
        })
    }

    /// Returns the identity of the controller unless its name, or its name and policy, already determine it. External
    /// controllers and controllers under another name need it.
    #[must_use]
    pub fn disambiguating_hash(&self) -> Option<String> {
        if is_identified_by_name(&*self.source, &self.name) {
            None
        } else {
            self.source.identity()
        }
    }

    /// Describes a failure of a run; only external controllers can fail without a collision.
    #[must_use]
    pub fn failure_description(&self) -> &'static str {
        if self.source.can_fail() {
            "vehicles touch, or a controller fails"
        } else {
            "vehicles touch"
        }
    }

    /// Returns the policy of a policy controller.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        self.source.policy()
    }
}

/// Returns the name without names of earlier versions: version 0.1.0 calls the retrained policy `hardened`.
fn present_name(name: &str) -> Cow<'_, str> {
    match name.strip_prefix("hardened") {
        Some(rest) if rest.is_empty() || rest.starts_with(',') => {
            format!("{}{rest}", RetrainedPolicy::NAME).into()
        }
        _ => name.into(),
    }
}

/// Splits `shield,SETTINGS:CONTROLLER` into the text after `shield`, and the controller.
fn split_shield(name: &str) -> Option<(&str, &str)> {
    name.strip_prefix("shield")?.split_once(':')
}

/// Returns the file that a name without extension may mean.
fn file_with_extension(place: &Path, name: &str) -> Option<String> {
    const EXTENSIONS: [&str; 5] = ["toml", "zip", "onnx", "fmu", "safetensors"];
    let is_there = |ending: &&str| place.with_extension(ending).is_file();
    EXTENSIONS
        .into_iter()
        .find(is_there)
        .map(|ending| format!("{name}.{ending}"))
}

/// True if a name identifies the controller, together with the digest of a policy.
fn is_identified_by_name(source: &dyn ControllerSource, name: &str) -> bool {
    if let Some(spec) = source.downcast_ref::<ControllerSpec>() {
        return name == spec.to_arg();
    }
    if let Some(shield) = source.as_shield() {
        return name
            .strip_prefix(&format!("shield{}:", shield.settings.to_arg()))
            .is_some_and(|inner| is_identified_by_name(&*shield.controller, inner));
    }
    source.downcast_ref::<PolicySource>().is_some()
}

/// Returns the error for a name of a program, a library or a source file.
fn not_a_controller(name: &str, folder: &Path) -> Option<UnknownController> {
    const LIBRARIES: [&str; 3] = ["so", "dll", "dylib"];
    const SOURCES: [&str; 10] = ["c", "h", "cc", "cpp", "cxx", "rs", "py", "m", "java", "sh"];
    let path = folder.join(name);
    let extension = path
        .extension()
        .map(|extension| extension.to_string_lossy().to_lowercase());
    let is_one_of = |kinds: &[&str]| extension.as_deref().is_some_and(|own| kinds.contains(&own));
    let (what, hint) = if !is_regular_file(&path) {
        return None;
    } else if is_one_of(&LIBRARIES) {
        ("a shared library", "; export a library as an FMU, F.fmu")
    } else if is_one_of(&SOURCES) {
        (
            "source code",
            "; export a model as an FMU, F.fmu, or a network, F.onnx",
        )
    } else if extension.is_none() {
        ("a file without an extension", "")
    } else {
        return None;
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

/// Splits a command into words as a shell does; `None` for invalid quoting.
fn split_command(command: &str) -> Option<Vec<String>> {
    #[cfg(feature = "process")]
    return shlex::split(command);
    // Without processes, one word suffices.
    #[cfg(not(feature = "process"))]
    Some(vec![command.to_owned()])
}

impl From<ControllerSpec> for NamedController {
    fn from(spec: ControllerSpec) -> Self {
        Self {
            name: spec.to_arg(),
            source: Arc::new(spec),
        }
    }
}
