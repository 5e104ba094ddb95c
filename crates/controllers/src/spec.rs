//! Names of controllers.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use crumple_sim::control::{
    BuiltIn, BuiltInController, ControllerSource, InvalidSetting, RetrainedPolicy, ShieldKind,
    ShieldedSource, TestDriverSettings, TestDriverSource,
};
use crumple_sim::engine::NamedController;

const EXEC_PREFIX: &str = "exec:";

/// The controller that a name states, before any file is read: `idm`, `acc-aeb,ttc_s=2.0`, `acc.toml`,
/// `exec:python3 acc.py`, one of these behind a shield, `shield,ahead=7:idm`, or any of these with a test driver,
/// `test-driver,hold_mps=20:idm`.
///
/// ```
/// use crumple_controllers::ControllerSpec;
///
/// let parsed = ControllerSpec::parse("shield:acc-aeb,ttc_s=2.0").unwrap();
/// assert_eq!(parsed.to_string(), "shield:acc-aeb,ttc_s=2");
/// assert!(ControllerSpec::parse("acc-aeb,ttc=2").is_err());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum ControllerSpec {
    /// A built-in controller with its settings ([`BuiltInController::parse`]).
    BuiltIn(BuiltInController),
    /// A path: a policy, a network, an FMU or a controller file.
    File(String),
    /// A process: its command, split into words as in a shell.
    Command {
        /// The command as the user wrote it.
        text: String,
        /// Program and arguments.
        words: Vec<String>,
    },
    /// A controller behind a shield ([`ShieldKind::parse`]).
    Shielded {
        /// Settings of the shield.
        settings: ShieldKind,
        /// The controller, which is no shield.
        controller: Box<Self>,
    },
    /// A controller with a test driver ([`TestDriverSettings::parse`]).
    WithTestDriver {
        /// Settings of the driver.
        settings: TestDriverSettings,
        /// The controller, which has no test driver.
        controller: Box<Self>,
    },
}

/// Reason why a text is no name of a controller.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidControllerName {
    /// A shield around another shield.
    #[error("only one shield may stand before a controller")]
    NestedShields,
    /// A test driver inside a shield or another test driver.
    #[error(
        "only one test driver is possible, before the shield and the controller: `test-driver:shield:policy`"
    )]
    TestDriverInside,
    /// A wrong setting of a built-in controller, a shield or a test driver.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// A command with invalid quoting.
    #[error(
        "`{command}` is not a valid command: a quotation mark is not closed, or a backslash is last"
    )]
    CommandSyntax {
        /// The command.
        command: String,
    },
}

impl ControllerSpec {
    /// Parses a name. Any text that is neither built in nor a command is a path.
    ///
    /// # Errors
    /// [`InvalidControllerName`] for wrong settings, nested shields or test drivers, and commands with invalid quoting.
    pub fn parse(name: &str) -> Result<Self, InvalidControllerName> {
        let Some((settings, inner)) = split_test_driver(name) else {
            return Self::parse_without_driver(name);
        };
        Ok(Self::WithTestDriver {
            settings: TestDriverSettings::parse(settings)?,
            controller: Box::new(Self::parse_without_driver(inner)?),
        })
    }

    fn parse_without_driver(name: &str) -> Result<Self, InvalidControllerName> {
        let Some((settings, inner)) = split_shield(name) else {
            return Self::parse_unshielded(name);
        };
        let settings = ShieldKind::parse(settings)?;
        if split_shield(inner).is_some() {
            return Err(InvalidControllerName::NestedShields);
        }
        Ok(Self::Shielded {
            settings,
            controller: Box::new(Self::parse_unshielded(inner)?),
        })
    }

    fn parse_unshielded(name: &str) -> Result<Self, InvalidControllerName> {
        if split_test_driver(name).is_some() {
            return Err(InvalidControllerName::TestDriverInside);
        }
        let name = &*present_name(name);
        if let Some(spec) = BuiltInController::parse(name) {
            return Ok(Self::BuiltIn(spec?));
        }
        let Some(command) = name.strip_prefix(EXEC_PREFIX) else {
            return Ok(Self::File(name.to_owned()));
        };
        let words = split_command(command).ok_or_else(|| InvalidControllerName::CommandSyntax {
            command: command.to_owned(),
        })?;
        Ok(Self::Command {
            text: command.to_owned(),
            words,
        })
    }

    /// Returns the path, behind a shield or not; `None` for a built-in controller and for a command.
    #[must_use]
    pub fn file(&self) -> Option<&str> {
        match self {
            Self::File(path) => Some(path),
            Self::Shielded { controller, .. } | Self::WithTestDriver { controller, .. } => {
                controller.file()
            }
            Self::BuiltIn(_) | Self::Command { .. } => None,
        }
    }

    /// Returns the built-in controller, behind a shield or not; `None` for a file and for a command.
    #[must_use]
    pub fn built_in(&self) -> Option<NamedController> {
        let source: Arc<dyn ControllerSource> = match self {
            Self::BuiltIn(spec) => Arc::new(spec.clone()),
            Self::Shielded {
                settings,
                controller,
            } => Arc::new(ShieldedSource {
                controller: controller.built_in()?.source,
                settings: *settings,
            }),
            Self::WithTestDriver {
                settings,
                controller,
            } => Arc::new(TestDriverSource {
                controller: controller.built_in()?.source,
                settings: settings.clone(),
            }),
            Self::File(_) | Self::Command { .. } => return None,
        };
        Some(NamedController {
            name: self.to_string(),
            source,
        })
    }
}

/// Prints the name in its shortest form, from which [`ControllerSpec::parse`] gives this value.
impl fmt::Display for ControllerSpec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BuiltIn(spec) => out.write_str(&spec.to_arg()),
            Self::File(path) => out.write_str(path),
            Self::Command { text, .. } => write!(out, "{EXEC_PREFIX}{text}"),
            Self::Shielded {
                settings,
                controller,
            } => write!(out, "{}{controller}", settings.name_prefix()),
            Self::WithTestDriver {
                settings,
                controller,
            } => write!(out, "{}{controller}", settings.name_prefix()),
        }
    }
}

/// Returns the built-in controller of this name, behind a shield or not. Reads no file and starts nothing.
#[must_use]
pub fn find_built_in(name: &str) -> Option<NamedController> {
    ControllerSpec::parse(name).ok()?.built_in()
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

/// Splits `test-driver,SETTINGS:CONTROLLER` into the text after `test-driver`, and the controller.
fn split_test_driver(name: &str) -> Option<(&str, &str)> {
    let rest = name.strip_prefix("test-driver")?;
    rest.split_once(':')
        .filter(|_| rest.starts_with([',', ':']))
}

/// Splits a command into words as a shell does; `None` for invalid quoting.
fn split_command(command: &str) -> Option<Vec<String>> {
    #[cfg(feature = "process")]
    return shlex::split(command);
    // Without processes, one word suffices.
    #[cfg(not(feature = "process"))]
    Some(vec![command.to_owned()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_parsed_as_they_are_printed() {
        for (name, printed) in [
            ("idm", "idm"),
            ("hardened", "retrained"),
            ("acc-aeb,ttc_s=2.0", "acc-aeb,ttc_s=2"),
            ("a/b.toml", "a/b.toml"),
            ("exec:sh 'a b'", "exec:sh 'a b'"),
            ("shield,ahead=6.50:acc.onnx", "shield,ahead=6.5:acc.onnx"),
            ("test-driver/a:b.toml", "test-driver/a:b.toml"),
            (
                "test-driver,hold_mps=20.0,delay_s=1:shield:exec:sh 'a b'",
                "test-driver,hold_mps=20:shield:exec:sh 'a b'",
            ),
            ("shield2,level=4.50:idm", "shield2,level=4.5:idm"),
            ("shield2:exec:sh a", "shield2:exec:sh a"),
        ] {
            let parsed = ControllerSpec::parse(name).unwrap();
            assert_eq!(parsed.to_string(), printed);
            assert_eq!(ControllerSpec::parse(printed), Ok(parsed));
        }
    }

    #[test]
    fn a_shield_around_a_shield_is_refused() {
        let name = "shield,ahead=3:shield,ahead=9:full-throttle";
        let refused = ControllerSpec::parse(name);
        assert_eq!(refused, Err(InvalidControllerName::NestedShields));
        assert!(find_built_in(name).is_none());
    }

    #[test]
    fn a_test_driver_inside_another_or_a_shield_is_refused() {
        for name in ["shield:test-driver:idm", "test-driver:test-driver:idm"] {
            let refused = ControllerSpec::parse(name);
            assert_eq!(
                refused,
                Err(InvalidControllerName::TestDriverInside),
                "{name}"
            );
        }
        assert!(find_built_in("test-driver:shield:idm").is_some());
    }
}
