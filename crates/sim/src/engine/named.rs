//! Controllers under test, by name.

use std::sync::Arc;

use crate::control::{BuiltInController, ControllerFailure, ControllerSource, PolicySource};
use crate::policy::Policy;

/// A controller under test and its name.
#[derive(Debug, Clone)]
pub struct NamedController {
    /// Built-in name, or path as given by the user.
    pub name: String,
    /// Source of the controller.
    pub source: Arc<dyn ControllerSource>,
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

/// A program whose start or handshake failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{location}{failure}")]
pub struct NotStarted {
    /// Location of the command in a file, as a message prefix (`acc.toml:12: command: `); empty without a file.
    pub location: String,
    /// The failure.
    pub failure: ControllerFailure,
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

    /// Starts the program once as a trial.
    ///
    /// # Errors
    /// [`NotStarted`].
    pub fn try_start(&self) -> Result<(), NotStarted> {
        self.source.try_start().map_err(|failure| NotStarted {
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

/// True if a name identifies the controller, together with the digest of a policy.
fn is_identified_by_name(source: &dyn ControllerSource, name: &str) -> bool {
    if let Some(spec) = source.downcast_ref::<BuiltInController>() {
        return name == spec.to_arg();
    }
    if let Some(shield) = source.as_shield() {
        return name
            .strip_prefix(&shield.settings.name_prefix())
            .is_some_and(|inner| is_identified_by_name(&*shield.controller, inner));
    }
    source.downcast_ref::<PolicySource>().is_some()
}

impl From<BuiltInController> for NamedController {
    fn from(spec: BuiltInController) -> Self {
        Self {
            name: spec.to_arg(),
            source: Arc::new(spec),
        }
    }
}
