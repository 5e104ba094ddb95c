//! Policies: an actor network, its file, and its evaluation for one state or many.
//!
//! Evaluation uses single precision in a fixed order: same bits for one state, in a batch, and on any machine.

mod elementwise;
mod file;
mod frame_stack;
mod header;
mod held_action;
mod learning_curve;
mod network;
mod product;
mod simd;

use std::sync::{Arc, LazyLock};

pub use elementwise::Elementwise;
pub use file::{MAX_EXTRA_INPUTS, MAX_HISTORY, PolicyError};
pub use frame_stack::FrameStack;
pub use header::{
    ActionBounds, ExtraInput, ObservationScaling, POLICY_VERSION, PolicyHeader, STATE_LEN,
};
pub use held_action::HeldAction;
pub use learning_curve::{COLLISION_FREE_REWARD, CurvePoint, LearningCurve};
pub use network::PackedNetwork;
pub use network::{Network, Workspace};
pub use product::{Lhs, PackedPanels, Rhs, multiply_vector, with_workers};
#[cfg(test)]
pub(crate) use simd::available_archs;
pub use simd::{SimdClosure, f64_lanes, has_fused_multiply_add};

use crate::observation::Observation;

/// File of the committed reference policy; `corpora/policy/README.md` describes its training.
static REFERENCE_BYTES: &[u8] = include_bytes!("reference.safetensors");

#[expect(
    clippy::expect_used,
    reason = "the file is part of the program, and a test reads it"
)]
static REFERENCE: LazyLock<Arc<Policy>> = LazyLock::new(|| {
    Arc::new(Policy::from_bytes(REFERENCE_BYTES).expect("the reference policy is whole"))
});

/// File of the committed policy that `crumple retrain` made.
static RETRAINED_BYTES: &[u8] = include_bytes!("retrained.safetensors");

#[expect(
    clippy::expect_used,
    reason = "the file is part of the program, and a test reads it"
)]
static RETRAINED: LazyLock<Arc<Policy>> = LazyLock::new(|| {
    Arc::new(Policy::from_bytes(RETRAINED_BYTES).expect("the retrained policy is whole"))
});

/// File of the committed policy `road`, which `crumple train --preset road --seed 1` makes.
static ROAD_BYTES: &[u8] = include_bytes!("road.safetensors");

#[expect(
    clippy::expect_used,
    reason = "the file is part of the program, and a test reads it"
)]
static ROAD: LazyLock<Arc<Policy>> =
    LazyLock::new(|| Arc::new(Policy::from_bytes(ROAD_BYTES).expect("the policy is whole")));

/// A policy: an actor network that drives.
///
/// Answers are finite: networks that could overflow on clipped observations are rejected ([`PolicyError::Overflow`]).
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    header: PolicyHeader,
    network: Network,
    packed: PackedNetwork,
    digest: String,
}

impl Policy {
    /// Creates a policy from a header and the network that it describes.
    ///
    /// # Errors
    /// [`PolicyError`] if the header is not usable, or describes another network.
    pub fn new(header: PolicyHeader, network: Network) -> Result<Self, PolicyError> {
        file::check_header(&header)?;
        let sizes = file::layer_sizes(&header);
        if network.sizes() != sizes {
            let problem = format!(
                "describes layers of {sizes:?}, the network has {:?}",
                network.sizes()
            );
            return Err(PolicyError::Header(problem));
        }
        if network.parameters().iter().all(|value| value.is_finite()) {
            Self::from_checked_parts(header, network)
        } else {
            Err(PolicyError::Header(
                "the network holds a number that is not finite".to_owned(),
            ))
        }
    }

    fn from_checked_parts(header: PolicyHeader, network: Network) -> Result<Self, PolicyError> {
        if let Some(layer) = network.overflowing_layer(header.observation.limit) {
            return Err(PolicyError::Overflow { layer });
        }
        let mut policy = Self {
            header,
            packed: PackedNetwork::new(&network),
            network,
            digest: String::new(),
        };
        policy.digest = crumple_core::digest::sha256(policy.to_bytes()?);
        Ok(policy)
    }

    /// Returns the committed reference policy.
    #[must_use]
    pub fn reference() -> Arc<Self> {
        Arc::clone(&REFERENCE)
    }

    /// Returns the file of the reference policy.
    #[must_use]
    pub fn reference_bytes() -> &'static [u8] {
        REFERENCE_BYTES
    }

    /// Returns the committed policy that `crumple retrain` made from the reference policy.
    #[must_use]
    pub fn retrained() -> Arc<Self> {
        Arc::clone(&RETRAINED)
    }

    /// Returns the file of the retrained policy.
    #[must_use]
    pub fn retrained_bytes() -> &'static [u8] {
        RETRAINED_BYTES
    }

    /// Returns the committed policy that imitates `predictive`, trained by the preset `road`.
    #[must_use]
    pub fn road() -> Arc<Self> {
        Arc::clone(&ROAD)
    }

    /// Returns the header: everything except the weights.
    #[must_use]
    pub fn header(&self) -> &PolicyHeader {
        &self.header
    }

    /// Returns the actor network, before the final tanh.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Returns the SHA-256 of the policy file, in hexadecimal.
    #[must_use]
    pub fn digest(&self) -> String {
        self.digest.clone()
    }

    /// Returns the inputs of the network at a decision: [`ObservationScaling::width`] numbers per decision of the
    /// history. `last_answer_mps2` is the controller's last answer.
    pub fn observe<'p>(
        &self,
        observation: &Observation,
        last_answer_mps2: f64,
        past: &'p mut FrameStack,
    ) -> &'p [f32] {
        past.push(&self.header.observation, observation, last_answer_mps2)
    }

    /// Returns the action for a row of [inputs](Policy::observe), between -1 and 1.
    #[must_use]
    pub fn choose(&self, row: &[f32], space: &mut Workspace) -> f32 {
        match *self.packed.forward(row, 1, space) {
            [raw] => ActionBounds::squash(raw),
            _ => -1.0,
        }
    }

    /// Computes the action of [`Policy::choose`] for each of many rows, with one matrix product per layer.
    pub fn choose_batch(&self, rows: &[f32], space: &mut Workspace, actions: &mut [f32]) {
        let answers = self.packed.forward(rows, actions.len(), space);
        for (action, &raw) in actions.iter_mut().zip(answers) {
            *action = ActionBounds::squash(raw);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
