//! Sources of controllers: each starts a controller for a vehicle of a run.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::{
    ControllerFailure, ControllerSource, ControllerSpec, Ego, NetworkController, ProcessController,
    RequiredNeighbours, ShieldSettings,
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
    /// An imported network.
    Network(Arc<NetworkController>),
    /// A controller process.
    Process(Arc<ProcessController>),
    /// A controller behind a shield.
    Shielded(Arc<ShieldedSource>),
    /// An external controller.
    Custom(Arc<dyn ControllerSource>),
}

impl ControllerKind {
    /// Returns the SHA-256, in hexadecimal, of everything that determines the commands; `None` if that is unknown.
    #[must_use]
    pub fn identity(&self) -> Option<String> {
        match self {
            Self::BuiltIn(spec) => Some(spec.identity()),
            Self::Policy(policy) => Some(policy.digest()),
            Self::Network(network) => Some(network.identity().to_owned()),
            Self::Process(process) => process.identity().map(str::to_owned),
            Self::Shielded(shielded) => Some(sha256(format!(
                "shield {:?} {}",
                shielded.settings,
                shielded.controller.identity()?
            ))),
            Self::Custom(source) => source.identity(),
        }
    }

    /// Returns the source behind a shield, or this source.
    #[must_use]
    pub fn unshielded(&self) -> &Self {
        match self {
            Self::Shielded(shielded) => shielded.controller.unshielded(),
            other => other,
        }
    }

    fn process(&self) -> Option<&ProcessController> {
        if let Self::Process(process) = self.unshielded() {
            Some(process)
        } else {
            None
        }
    }

    /// Returns the controller file, network or FMU that defines the mapping or the command, if there is one.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        match self.unshielded() {
            Self::Network(network) => network.file_path(),
            Self::Process(process) => process.setup().file.as_deref(),
            _ => None,
        }
    }

    /// Returns warnings, one line each: differences between a network's mapping and the spaces of its training.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        if let Self::Network(network) = self.unshielded() {
            network.warnings()
        } else {
            Vec::new()
        }
    }

    /// Returns the time between decisions, in seconds. `None` for every step, or if only the process knows it.
    #[must_use]
    pub fn interval_s(&self) -> Option<f64> {
        match self.unshielded() {
            Self::Network(network) => network.mapping().decision_interval_s,
            Self::Process(process) => process.setup().mapping.decision_interval_s,
            Self::Custom(source) => source.interval_s(),
            _ => self
                .policy()
                .map(|policy| policy.header().decision_interval_s),
        }
    }

    /// Returns the policy of a policy controller, behind a shield or not.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        match self.unshielded() {
            Self::BuiltIn(spec) => spec.policy(),
            Self::Policy(policy) => Some(Arc::clone(policy)),
            _ => None,
        }
    }

    /// Returns true for a policy or an imported network, behind a shield or not.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        matches!(self.unshielded(), Self::Network(_)) || self.policy().is_some()
    }

    /// Returns true for an external controller that can fail, behind a shield or not. A network cannot.
    #[must_use]
    pub fn is_external(&self) -> bool {
        matches!(self.unshielded(), Self::Process(_) | Self::Custom(_))
    }

    /// Returns false for a process that its file or its handshake declares nondeterministic.
    #[must_use]
    pub fn is_deterministic(&self) -> bool {
        self.process()
            .is_none_or(ProcessController::is_deterministic)
    }

    /// Starts the program of a process without a run, and ends it.
    ///
    /// # Errors
    /// [`ControllerFailure`] of a process that cannot be started or does not complete the handshake.
    pub(crate) fn try_start(&self) -> Result<(), ControllerFailure> {
        self.process().map_or(Ok(()), ProcessController::try_start)
    }

    /// Returns the reason to reject all runs of a process: it proved nondeterministic, or does not start any more.
    #[must_use]
    pub fn refusal(&self) -> Option<ControllerFailure> {
        self.process().and_then(ProcessController::refusal)
    }

    /// Returns true if the controller can run in lockstep; false for a process without batches.
    pub(crate) fn supports_lockstep(&self, ego: impl FnOnce() -> Ego) -> bool {
        self.process()
            .is_none_or(|process| process.supports_batches(&ego()))
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
        out.debug_tuple("ControllerKind")
            .field(&self.identity())
            .finish()
    }
}
