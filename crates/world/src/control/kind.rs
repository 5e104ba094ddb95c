//! Sources of controllers: each starts a controller for a vehicle of a run.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::{
    ControllerFailure, ControllerSource, ControllerSpec, Ego, Needs, NetworkController, ProcessController,
    ShieldSettings,
};
use crate::digest::sha256;
use crate::policy::Policy;

/// A controller behind a shield.
#[derive(Clone)]
pub struct Shielded {
    /// Controller that drives as long as the shield admits its commands.
    pub controller: ControllerKind,
    /// Settings of the user.
    pub settings: ShieldSettings,
}

/// Source of the controllers of vehicles.
#[derive(Clone)]
pub enum ControllerKind {
    /// A built-in controller.
    BuiltIn(ControllerSpec),
    /// A learned policy.
    Policy(Arc<Policy>),
    /// A network from outside.
    Network(Arc<NetworkController>),
    /// A process.
    Process(Arc<ProcessController>),
    /// Any of these behind a shield.
    Shielded(Arc<Shielded>),
    /// A controller from outside.
    Custom(Arc<dyn ControllerSource>),
}

impl ControllerKind {
    /// SHA-256, in hexadecimal, of everything that decides how it drives; none for a controller from outside that has none.
    #[must_use]
    pub fn identity(&self) -> Option<String> {
        match self {
            Self::BuiltIn(spec) => Some(spec.identity()),
            Self::Policy(policy) => Some(policy.digest()),
            Self::Network(network) => Some(network.identity().to_owned()),
            Self::Process(process) => process.identity().map(str::to_owned),
            Self::Shielded(shielded) => {
                Some(sha256(format!("shield {:?} {}", shielded.settings, shielded.controller.identity()?)))
            }
            Self::Custom(source) => source.identity(),
        }
    }

    /// Returns the controller file, network or FMU that states the mapping or the command; none without such a file.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Network(network) => network.file_path(),
            Self::Process(process) => process.setup().file.as_deref(),
            Self::Shielded(shielded) => shielded.controller.file(),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Custom(_) => None,
        }
    }

    /// What may be wrong with it, a line each: so far, how a network's mapping fits the spaces in which it was trained.
    #[must_use]
    pub fn doubts(&self) -> Vec<String> {
        match self {
            Self::Network(network) => network.doubts(),
            Self::Shielded(shielded) => shielded.controller.doubts(),
            _ => Vec::new(),
        }
    }

    /// Time between its decisions, in seconds; none if it decides at every step, or is a process that has yet to say so. Starts
    /// nothing.
    #[must_use]
    pub fn interval_s(&self) -> Option<f64> {
        match self {
            Self::Shielded(shielded) => shielded.controller.interval_s(),
            Self::Network(network) => network.mapping().decision_interval_s,
            Self::Process(process) => process.setup().mapping.decision_interval_s,
            Self::Custom(source) => source.interval_s(),
            Self::BuiltIn(_) | Self::Policy(_) => self.policy().map(|policy| policy.header().decision_interval_s),
        }
    }

    /// Its policy, if it is one of crumple's own, behind a shield or not.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        match self {
            Self::BuiltIn(spec) => spec.policy(),
            Self::Policy(policy) => Some(Arc::clone(policy)),
            Self::Shielded(shielded) => shielded.controller.policy(),
            Self::Network(_) | Self::Process(_) | Self::Custom(_) => None,
        }
    }

    /// Whether a network drives, crumple's own or one from outside, behind a shield or not.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        match self {
            Self::Network(_) => true,
            Self::Shielded(shielded) => shielded.controller.is_learned(),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Process(_) | Self::Custom(_) => self.policy().is_some(),
        }
    }

    /// Whether it is a controller from outside that can fail, behind a shield or not. A network cannot.
    #[must_use]
    pub fn is_from_outside(&self) -> bool {
        match self {
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) => false,
            Self::Shielded(shielded) => shielded.controller.is_from_outside(),
            Self::Process(_) | Self::Custom(_) => true,
        }
    }

    /// Whether nothing says that it is not deterministic. A process may say so once it was asked.
    #[must_use]
    pub fn is_deterministic(&self) -> bool {
        match self {
            Self::Shielded(shielded) => shielded.controller.is_deterministic(),
            Self::Process(process) => process.is_deterministic(),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) | Self::Custom(_) => true,
        }
    }

    /// Starts what has to be started, for no run, and ends it: whether there is anything to be asked at all.
    ///
    /// # Errors
    /// [`ControllerFailure`] of a process that cannot be started or does not introduce itself.
    pub fn try_start(&self) -> Result<(), ControllerFailure> {
        match self {
            Self::Shielded(shielded) => shielded.controller.try_start(),
            Self::Process(process) => process.try_start(),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) | Self::Custom(_) => Ok(()),
        }
    }

    /// Why a process is refused, if it is by now: it contradicted its own claim to be deterministic, or cannot be started any more. Its runs
    /// then say nothing of their scenarios.
    #[must_use]
    pub fn refusal(&self) -> Option<ControllerFailure> {
        match self {
            Self::Shielded(shielded) => shielded.controller.refusal(),
            Self::Process(process) => process.refusal(),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) | Self::Custom(_) => None,
        }
    }

    /// Whether its runs can be made in lockstep: a process that does not answer in batches is needed once for each.
    pub(crate) fn steps_together(&self, ego: impl FnOnce() -> Ego) -> bool {
        match self {
            Self::Shielded(shielded) => shielded.controller.steps_together(ego),
            Self::Process(process) => process.takes_batches(&ego()),
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) | Self::Custom(_) => true,
        }
    }

    pub(crate) fn needs(&self) -> Needs {
        match self {
            Self::BuiltIn(_) | Self::Policy(_) | Self::Network(_) | Self::Process(_) => Needs::Nothing,
            Self::Shielded(shielded) => shielded.controller.needs(),
            Self::Custom(source) => source.needs(),
        }
    }
}

impl From<Shielded> for ControllerKind {
    fn from(shielded: Shielded) -> Self {
        Self::Shielded(Arc::new(shielded))
    }
}

impl From<ControllerSpec> for ControllerKind {
    fn from(spec: ControllerSpec) -> Self {
        Self::BuiltIn(spec)
    }
}

impl From<Arc<Policy>> for ControllerKind {
    fn from(policy: Arc<Policy>) -> Self {
        Self::Policy(policy)
    }
}

impl From<Arc<NetworkController>> for ControllerKind {
    fn from(network: Arc<NetworkController>) -> Self {
        Self::Network(network)
    }
}

impl From<Arc<ProcessController>> for ControllerKind {
    fn from(process: Arc<ProcessController>) -> Self {
        Self::Process(process)
    }
}

impl<S: ControllerSource + 'static> From<Arc<S>> for ControllerKind {
    fn from(source: Arc<S>) -> Self {
        Self::Custom(source)
    }
}

impl fmt::Debug for ControllerKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("ControllerKind").field(&self.identity()).finish()
    }
}
