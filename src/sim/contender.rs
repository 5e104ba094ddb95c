//! What can be put under test, by name.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::UnderTest;
use crate::policy::{Policy, PolicyError};
use crate::scenario::ControllerSpec;

/// A controller to put under test, and what it is called.
#[derive(Clone)]
pub struct Contender {
    /// A built-in name, or the path of a policy file as it was given.
    pub name: String,
    /// What drives.
    pub controller: UnderTest,
}

/// Why a name stands for no controller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownContender {
    /// Neither a built-in name nor a file.
    #[error("there is no controller `{name}`: there are {known}, and policy files")]
    Name {
        /// What was asked for.
        name: String,
        /// Built-in names.
        known: String,
    },
    /// A file that is no policy.
    #[error(transparent)]
    Policy(#[from] PolicyError),
}

impl Contender {
    /// The built-in controllers, in the order they are listed.
    #[must_use]
    pub fn built_in() -> Vec<Self> {
        ControllerSpec::built_in().into_iter().map(Self::from).collect()
    }

    /// The built-in controller of that name, or the policy in a file; a relative path starts at `folder`.
    ///
    /// # Errors
    /// [`UnknownContender`] if there is neither, or the file holds no usable policy.
    pub fn find(name: &str, folder: &Path) -> Result<Self, UnknownContender> {
        if let Some(spec) = ControllerSpec::named(name) {
            return Ok(spec.into());
        }
        if Path::new(name).extension().is_none() {
            let known: Vec<_> = ControllerSpec::built_in().iter().map(ControllerSpec::name).collect();
            return Err(UnknownContender::Name { name: name.to_owned(), known: known.join(", ") });
        }
        let policy = Policy::load(&folder.join(name))?;
        Ok(Self { name: name.to_owned(), controller: UnderTest::Policy(Arc::new(policy)) })
    }

    /// The policy, if it is a learned one.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        match &self.controller {
            UnderTest::BuiltIn(ControllerSpec::Policy) => Some(Policy::reference()),
            UnderTest::Policy(policy) => Some(Arc::clone(policy)),
            UnderTest::BuiltIn(_) | UnderTest::Custom(_) => None,
        }
    }
}

impl fmt::Debug for Contender {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Contender").field(&self.name).finish()
    }
}

impl From<ControllerSpec> for Contender {
    fn from(spec: ControllerSpec) -> Self {
        Self { name: spec.name().to_owned(), controller: UnderTest::BuiltIn(spec) }
    }
}
