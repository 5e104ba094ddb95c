//! Sources of controllers: each starts a controller for a vehicle of a run.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::{
    ControllerFailure, ControllerSource, ControllerSpec, Ego, NetworkController, ProcessController, RequiredNeighbours,
    ShieldSettings,
};
use crate::policy::Policy;
use crumple_core::digest::sha256;

/// A controller behind a shield.
#[derive(Clone)]
pub struct ShieldedSource {
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
    Shielded(Arc<ShieldedSource>),
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

    /// Returns the source behind all shields.
    #[must_use]
    pub fn unshielded(&self) -> &Self {
        match self {
            Self::Shielded(shielded) => shielded.controller.unshielded(),
            other => other,
        }
    }

    /// Returns the controller file, network or FMU that states the mapping or the command; none without such a file.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        match self.unshielded() {
            Self::Network(network) => network.file_path(),
            Self::Process(process) => process.setup().file.as_deref(),
            _ => None,
        }
    }

    /// Returns what may be wrong with the controller, a line each: mismatches of a network's mapping and the spaces of its training.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        match self.unshielded() {
            Self::Network(network) => network.warnings(),
            _ => Vec::new(),
        }
    }

    /// Returns the time between decisions, in seconds; none for a decision at every step, and for a process that states it only
    /// once it runs. Starts nothing.
    #[must_use]
    pub fn interval_s(&self) -> Option<f64> {
        match self.unshielded() {
            Self::Network(network) => network.mapping().decision_interval_s,
            Self::Process(process) => process.setup().mapping.decision_interval_s,
            Self::Custom(source) => source.interval_s(),
            _ => self.policy().map(|policy| policy.header().decision_interval_s),
        }
    }

    /// Returns the policy of one of crumple's own, behind a shield or not.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        match self.unshielded() {
            Self::BuiltIn(spec) => spec.policy(),
            Self::Policy(policy) => Some(Arc::clone(policy)),
            _ => None,
        }
    }

    /// Returns true for a network, crumple's own or one from outside, behind a shield or not.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        matches!(self.unshielded(), Self::Network(_)) || self.policy().is_some()
    }

    /// Returns true for a controller from outside that can fail, behind a shield or not. A network cannot.
    #[must_use]
    pub fn is_external(&self) -> bool {
        matches!(self.unshielded(), Self::Process(_) | Self::Custom(_))
    }

    /// Returns false for a process that its file, or its own answer, calls nondeterministic.
    #[must_use]
    pub fn is_deterministic(&self) -> bool {
        match self.unshielded() {
            Self::Process(process) => process.is_deterministic(),
            _ => true,
        }
    }

    /// Starts the program of a process, for no run, and ends it.
    ///
    /// # Errors
    /// [`ControllerFailure`] of a process that cannot be started or does not introduce itself.
    pub(crate) fn try_start(&self) -> Result<(), ControllerFailure> {
        match self.unshielded() {
            Self::Process(process) => process.try_start(),
            _ => Ok(()),
        }
    }

    /// Returns the reason for which a process is refused by now: it contradicted its own claim to be deterministic, or cannot be
    /// started any more. Its runs then say nothing of their scenarios.
    #[must_use]
    pub fn refusal(&self) -> Option<ControllerFailure> {
        match self.unshielded() {
            Self::Process(process) => process.refusal(),
            _ => None,
        }
    }

    /// Returns true if its runs can be made in lockstep: a process that does not answer in batches is needed once for each run.
    pub(crate) fn supports_lockstep(&self, ego: impl FnOnce() -> Ego) -> bool {
        match self.unshielded() {
            Self::Process(process) => process.supports_batches(&ego()),
            _ => true,
        }
    }

    pub(crate) fn required_neighbours(&self) -> RequiredNeighbours {
        match self.unshielded() {
            Self::Custom(source) => source.required_neighbours(),
            _ => RequiredNeighbours::Nothing,
        }
    }
}

impl From<ShieldedSource> for ControllerKind {
    fn from(shielded: ShieldedSource) -> Self {
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
