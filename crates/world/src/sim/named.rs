//! What can be put under test, by name.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use crate::control::{
    BuiltIn, ControllerFailure, ControllerKind, ControllerSource, ControllerSpec, ErrorBounds, InvalidSetting,
    NameOrigin, ProcessController, ProcessSetup, RetrainedPolicy, ShieldSettings, ShieldedSource, StartRefusal,
};
use crate::network::NetworkFile;
use crate::policy::{Policy, PolicyError};
use crate::scenario::controller_file::{self, ControllerFileError, is_regular_file};
use crate::scenario::file::{MAX_TOML_BYTES, line_in_toml, read_at_most};

/// A controller to put under test, and what it is called.
///
/// ```
/// use std::path::Path;
/// use crumple_world::sim::NamedController;
///
/// let shielded = NamedController::find("shield:acc-aeb,ttc_s=2.0", Path::new("")).unwrap();
/// assert_eq!(shielded.name, "shield:acc-aeb,ttc_s=2");
/// assert!(NamedController::find("acc-aeb,ttc=2", Path::new("")).is_err());
/// ```
#[derive(Clone)]
pub struct NamedController {
    /// A built-in name, or the path of a file as it was given.
    pub name: String,
    /// What drives.
    pub kind: ControllerKind,
}

/// Most shields before one controller: one within another may assume another vehicle ahead, and a name has an end.
const MAX_SHIELDS: usize = 8;

/// What stands before a command.
const EXEC_PREFIX: &str = "exec:";

/// Why a name stands for no controller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownController {
    /// Neither a built-in name nor a file.
    #[error(
        "there is no controller `{name}`: there are {built_in_names}, files of policies, networks and controllers, \
         commands after `exec:`, and `shield:` before any of them"
    )]
    UnknownName {
        /// What was asked for.
        name: String,
        /// Built-in names.
        built_in_names: String,
    },
    /// A file's name without its ending.
    #[error("there is no controller `{name}`; did you mean the file `{file}`?")]
    MissingExtension {
        /// What was asked for.
        name: String,
        /// The file that is there.
        file: String,
    },
    /// A shield that is set wrongly.
    #[error(
        "`{setting}` is no setting of a shield: there are ahead, gap-error, speed-error and ahead-speed-error, each with a \
         number, as in `shield,ahead=7.5,gap-error=0.2:policy`"
    )]
    ShieldSetting {
        /// What was found.
        setting: String,
    },
    /// More shields than anybody needs.
    #[error("at most {MAX_SHIELDS} shields may stand before a controller")]
    TooManyShields,
    /// A command that is no list of words.
    #[error("`{command}` is no command: a quotation mark or a backslash has nothing after it")]
    CommandSyntax {
        /// What was found.
        command: String,
    },
    /// A file of a kind that is no controller.
    #[error(
        "{path} is no controller, but {what}: a program is asked as `exec:{command}`, or by a controller file, F.toml, with \
         `command` (docs/controllers.md){hint}"
    )]
    NotAController {
        /// The file.
        path: String,
        /// What it looks like.
        what: &'static str,
        /// How a command names what would be run.
        command: String,
        /// What else there is to do about it.
        hint: &'static str,
    },
    /// A process that cannot be started, or does not introduce itself.
    #[error("{location}{failure}")]
    NotStarted {
        /// Where it is said, if that is a file: with its line and field.
        location: String,
        /// Why not.
        failure: ControllerFailure,
    },
    /// A program that the user did not name.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
    /// A setting of a built-in controller that is wrong.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// A file that is no policy.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A network or a controller file that cannot be used.
    #[error(transparent)]
    File(ControllerFileError),
}

/// A controller that contradicted itself, or cannot be started any more: what was found with it would not come out again.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the controller `{controller}` was refused on the way, and nothing that was found with it counts: {failure}")]
pub struct RefusedController {
    /// Its name.
    pub controller: String,
    /// Why.
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
    /// A controller from outside, under a name of one's own.
    #[must_use]
    pub fn from_source(name: &str, source: Arc<dyn ControllerSource>) -> Self {
        Self { name: name.to_owned(), kind: ControllerKind::Custom(source) }
    }

    /// Finds the controller that a file names: a built-in one, or the one in another file; a relative path starts at `folder`
    /// ([`controller_file::load`]). For names that the user gives there is [`Self::find_for_user`].
    ///
    /// A built-in name may be followed by settings (`acc-aeb,ttc_s=2.0`, see [`ControllerSpec::parse`]).
    ///
    /// `exec:COMMAND ARGUMENTS` is a process that runs in `folder`, its words as a shell would split them; none is started here.
    ///
    /// `shield:C` is controller C behind a shield. `shield,ahead=A:C` assumes that the vehicle ahead never brakes harder than
    /// A m/s² on a dry road, instead of its own limit; `gap-error` (m), `speed-error` and `ahead-speed-error` (m/s) bound what
    /// is seen, and those that are not given are then 0.
    ///
    /// # Errors
    /// [`UnknownController`] if there is neither, or the file holds no usable controller;
    /// [`UnknownController::StartRefused`] for a process or an FMU, unless [`allow_external`](crate::control::allow_external)
    /// was called.
    pub fn find(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        Self::parse_nested(MAX_SHIELDS, name, folder, NameOrigin::File)
    }

    /// Finds a built-in controller, behind shields or not. Reads no file and starts nothing.
    #[must_use]
    pub fn find_built_in(name: &str) -> Option<Self> {
        ControllerSpec::parse(strip_shields(name))?.ok()?;
        Self::find(name, Path::new("")).ok()
    }

    /// Finds the controller that the user names, in an argument or in a configuration that an argument names, as
    /// [`Self::find`] does. Runs of a process or an FMU start it.
    ///
    /// # Errors
    /// [`UnknownController`], as for [`Self::find`].
    pub fn find_for_user(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        Self::parse_nested(MAX_SHIELDS, name, folder, NameOrigin::User)
    }

    /// Finds the controller that the user names ([`Self::find_for_user`]), and starts its program once as a trial: a missing
    /// program is an error of the user, not a failure of a controller.
    ///
    /// # Errors
    /// As [`Self::find_for_user`], and [`UnknownController::NotStarted`].
    pub fn find_and_try(name: &str, folder: &Path) -> Result<Self, UnknownController> {
        let found = Self::find_for_user(name, folder)?;
        found.try_start()?;
        Ok(found)
    }

    /// Starts its program once as a trial.
    ///
    /// # Errors
    /// [`UnknownController::NotStarted`].
    pub fn try_start(&self) -> Result<(), UnknownController> {
        let field = match self.kind.unshielded() {
            ControllerKind::Process(process) if process.setup().program.is_some() => "fmu",
            _ => "command",
        };
        let place = || match self.kind.file().is_some_and(is_toml) {
            true => format!("{}{field}: ", self.field_location(field)),
            false => self.field_location(field),
        };
        self.kind.try_start().map_err(|failure| UnknownController::NotStarted { location: place(), failure })
    }

    /// Returns file and line of a field, as a prefix of a message (`acc.toml:12: `); empty without a file that states a mapping or
    /// a command.
    #[must_use]
    pub fn field_location(&self, field: &str) -> String {
        let Some(path) = self.kind.file() else { return String::new() };
        match read_at_most(path, MAX_TOML_BYTES) {
            Ok(text) if is_toml(path) => format!("{}:{}: ", path.display(), line_in_toml(&text, field)),
            _ => format!("{}: ", path.display()),
        }
    }

    /// Whether its runs so far say something of it: to be asked before anything that was found is told.
    ///
    /// # Errors
    /// [`RefusedController`] if it was asked the same twice in some run, and answered otherwise, or cannot be started any more.
    pub fn ensure_trusted(&self) -> Result<(), RefusedController> {
        match self.kind.refusal() {
            None => Ok(()),
            Some(failure) => Err(RefusedController { controller: self.name.clone(), failure }),
        }
    }

    /// The controller of that name, which says at most so many shields.
    fn parse_nested(
        shields: usize,
        name: &str,
        folder: &Path,
        named_by: NameOrigin,
    ) -> Result<Self, UnknownController> {
        // Its name in version 0.1.0.
        let name = &match name.strip_prefix("hardened") {
            Some(rest) if rest.is_empty() || rest.starts_with(',') => format!("{}{rest}", RetrainedPolicy::NAME),
            _ => name.to_owned(),
        };
        if let Some(spec) = ControllerSpec::parse(name) {
            return Ok(spec?.into());
        }
        if let Some(command) = name.strip_prefix(EXEC_PREFIX) {
            let words = split_command(command)
                .ok_or_else(|| UnknownController::CommandSyntax { command: command.to_owned() })?;
            let permission = named_by.permission(|| format!("`{name}`"))?;
            let process = ProcessController::new(ProcessSetup::new(words, folder), permission)
                .map_err(ControllerFileError::Command)?;
            return Ok(Self { name: name.to_owned(), kind: Arc::new(process).into() });
        }
        if let Some((settings, inner)) = name.strip_prefix("shield").and_then(|rest| rest.split_once(':')) {
            let settings = parse_shield_settings(settings)?;
            let left = shields.checked_sub(1).ok_or(UnknownController::TooManyShields)?;
            let Self { name: inner_name, kind: controller } = Self::parse_nested(left, inner, folder, named_by)?;
            let name = format!("{}{inner_name}", name.strip_suffix(inner).unwrap_or(name));
            return Ok(Self { name, kind: ShieldedSource { controller, settings }.into() });
        }
        let place = folder.join(name);
        let is_network = NetworkFile::is_network(&place);
        if let Some(program) = not_a_controller(name, folder).filter(|_| !is_network) {
            return Err(program);
        }
        if Path::new(name).extension().is_none() && !is_network {
            if let Some(file) = file_with_extension(&place, name) {
                return Err(UnknownController::MissingExtension { name: name.to_owned(), file });
            }
            let known: Vec<_> = ControllerSpec::all().iter().map(ControllerSpec::name).collect();
            return Err(UnknownController::UnknownName { name: name.to_owned(), built_in_names: known.join(", ") });
        }
        Ok(Self { name: name.to_owned(), kind: controller_file::load(&place, named_by)? })
    }

    /// The identity, where name and policy do not say what drives: of a controller from outside, and of one that goes by
    /// another name than its own.
    #[must_use]
    pub fn disambiguating_hash(&self) -> Option<String> {
        if is_identified_by_name(&self.kind, &self.name) { None } else { self.kind.identity() }
    }

    /// What counts as a failure of it, in words: only what comes from outside can fail otherwise than by contact.
    #[must_use]
    pub fn failure_description(&self) -> &'static str {
        if self.kind.is_external() { "vehicles touch, or a controller fails" } else { "vehicles touch" }
    }

    /// The policy, if it is one of crumple's own.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        self.kind.policy()
    }
}

/// Returns true for a controller file, the only kind of file with fields.
fn is_toml(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "toml")
}

/// Returns the name of the controller behind all shields.
fn strip_shields(name: &str) -> &str {
    let mut inner = name;
    while let Some((_, rest)) = inner.strip_prefix("shield").and_then(|rest| rest.split_once(':')) {
        inner = rest;
    }
    inner
}

/// The file that a name without its ending may mean.
fn file_with_extension(place: &Path, name: &str) -> Option<String> {
    const EXTENSIONS: [&str; 5] = ["toml", "zip", "onnx", "fmu", "safetensors"];
    let is_there = |ending: &&str| place.with_extension(ending).is_file();
    EXTENSIONS.into_iter().find(is_there).map(|ending| format!("{name}.{ending}"))
}

/// Whether a name stands for what drives; of a policy, beside its digest.
fn is_identified_by_name(kind: &ControllerKind, name: &str) -> bool {
    match kind {
        ControllerKind::BuiltIn(spec) => name == spec.to_arg(),
        ControllerKind::Policy(_) => true,
        ControllerKind::Shielded(shielded) => {
            name.strip_prefix("shield").and_then(|rest| rest.split_once(':')).is_some_and(|(settings, inner)| {
                parse_shield_settings(settings).is_ok_and(|settings| settings == shielded.settings)
                    && is_identified_by_name(&shielded.controller, inner)
            })
        }
        ControllerKind::Network(_) | ControllerKind::Process(_) | ControllerKind::Custom(_) => false,
    }
}

/// What to say of a name that is that of a program, or of something that one is made of.
fn not_a_controller(name: &str, folder: &Path) -> Option<UnknownController> {
    const LIBRARIES: [&str; 3] = ["so", "dll", "dylib"];
    const SOURCES: [&str; 10] = ["c", "h", "cc", "cpp", "cxx", "rs", "py", "m", "java", "sh"];
    let path = folder.join(name);
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let is_one_of = |kinds: &[&str]| extension.as_deref().is_some_and(|own| kinds.contains(&own));
    let (what, hint) = if !is_regular_file(&path) {
        return None;
    } else if is_one_of(&LIBRARIES) {
        ("a shared library", "; a library as an FMU, F.fmu")
    } else if is_one_of(&SOURCES) {
        ("a source text", "; a model as an FMU, F.fmu, or a network, F.onnx")
    } else if extension.is_none() {
        ("a file without an extension", "")
    } else {
        return None;
    };
    let command = match extension.as_deref() {
        Some("py") => format!("python3 {name}"),
        // A script is run as it is; of a source or a library, what is made of it.
        Some("sh") => command_path(Path::new(name)),
        _ => command_path(&Path::new(name).with_extension("")),
    };
    Some(UnknownController::NotAController { path: path.display().to_string(), what, command, hint })
}

/// A program as a command names it: one in this folder begins with `./`.
fn command_path(program: &Path) -> String {
    let name = program.display();
    if program.components().count() > 1 { name.to_string() } else { format!("./{name}") }
}

/// The words of a command as a shell would split them; none for one that does not end.
fn split_command(command: &str) -> Option<Vec<String>> {
    #[cfg(feature = "process")]
    return shlex::split(command);
    // Where no process starts, it is one word as well.
    #[cfg(not(feature = "process"))]
    Some(vec![command.to_owned()])
}

/// Settings as they stand between `shield` and the colon: nothing, or each with a comma before it.
fn parse_shield_settings(text: &str) -> Result<ShieldSettings, UnknownController> {
    let mut settings = ShieldSettings::default();
    let mut parts = text.split(',');
    let unknown = |setting: &str| UnknownController::ShieldSetting { setting: setting.to_owned() };
    if let Some(before) = parts.next().filter(|before| !before.is_empty()) {
        return Err(unknown(before));
    }
    for part in parts {
        let (name, value) = part.split_once('=').ok_or_else(|| unknown(part))?;
        let value: f64 = value.parse().map_err(|_| unknown(part))?;
        if !(value >= 0.0 && value.is_finite()) {
            return Err(unknown(part));
        }
        let errors = settings.errors.unwrap_or_default();
        match name {
            "ahead" if value > 0.0 => settings.ahead_brake_mps2 = Some(value),
            "gap-error" => settings.errors = Some(ErrorBounds { gap_m: value, ..errors }),
            "speed-error" => settings.errors = Some(ErrorBounds { speed_mps: value, ..errors }),
            "ahead-speed-error" => settings.errors = Some(ErrorBounds { ahead_speed_mps: value, ..errors }),
            _ => return Err(unknown(part)),
        }
    }
    Ok(settings)
}

impl fmt::Debug for NamedController {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("NamedController").field(&self.name).finish()
    }
}

impl From<ControllerSpec> for NamedController {
    fn from(spec: ControllerSpec) -> Self {
        Self { name: spec.to_arg(), kind: ControllerKind::BuiltIn(spec) }
    }
}
