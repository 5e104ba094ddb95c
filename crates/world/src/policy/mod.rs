//! The learned policy: an actor network, the file it lives in, and acting with it, one state or many.
//!
//! Acting is plain single-precision arithmetic in a fixed order: a state gets the same bits alone or among
//! others, and on any machine. No learning framework is needed to drive.

mod elementwise;
mod file;
mod frame_stack;
mod header;
mod learning_curve;
mod network;
mod product;
mod residual;
mod simd;

use std::sync::{Arc, LazyLock};

pub use elementwise::Elementwise;
pub use file::{MAX_HISTORY, PolicyError};
pub use frame_stack::FrameStack;
pub use header::{ActionBounds, ObservationScaling, POLICY_VERSION, PolicyHeader, STATE_LEN};
pub use learning_curve::{COLLISION_FREE_REWARD, CurvePoint, LearningCurve};
pub(crate) use network::PackedNetwork;
pub use network::{Network, Workspace};
pub use product::{Lhs, PackedPanels, Rhs, multiply_vector, with_workers};
pub use residual::{HeldAction, ResidualControl};
#[cfg(test)]
pub(crate) use simd::available_archs;
pub use simd::{SimdClosure, f64_lanes, has_fused_multiply_add};

use crate::observation::Observation;

/// The committed reference policy; `corpora/policy/README.md` says how it was trained.
static REFERENCE_BYTES: &[u8] = include_bytes!("reference.safetensors");

#[expect(clippy::expect_used, reason = "the file is part of the program, and a test reads it")]
static REFERENCE: LazyLock<Arc<Policy>> =
    LazyLock::new(|| Arc::new(Policy::from_bytes(REFERENCE_BYTES).expect("the reference policy is whole")));

/// The committed policy retrained by `crumple retrain`, likewise.
static RETRAINED_BYTES: &[u8] = include_bytes!("retrained.safetensors");

#[expect(clippy::expect_used, reason = "the file is part of the program, and a test reads it")]
static RETRAINED: LazyLock<Arc<Policy>> =
    LazyLock::new(|| Arc::new(Policy::from_bytes(RETRAINED_BYTES).expect("the retrained policy is whole")));

/// An actor that can drive.
///
/// Its answers are numbers: an observation is cut to the header's limit before the network sees it, and a network that could
/// overflow on any state within that limit is refused ([`PolicyError::Overflow`]), not driven with.
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    header: PolicyHeader,
    network: Network,
    packed: PackedNetwork,
    /// SHA-256 of its file.
    digest: String,
}

impl Policy {
    /// A policy of a header and the network it describes.
    ///
    /// # Errors
    /// [`PolicyError`] if the header is not usable, or describes another network.
    pub fn new(header: PolicyHeader, network: Network) -> Result<Self, PolicyError> {
        file::check_header(&header)?;
        let sizes = file::layer_sizes(&header);
        if network.sizes() != sizes {
            let problem = format!("describes layers of {sizes:?}, the network has {:?}", network.sizes());
            return Err(PolicyError::Header(problem));
        }
        if network.parameters().iter().all(|value| value.is_finite()) {
            Self::from_checked_parts(header, network)
        } else {
            Err(PolicyError::Header("the network holds a number that is not finite".to_owned()))
        }
    }

    /// A policy of parts that fit each other.
    fn from_checked_parts(header: PolicyHeader, network: Network) -> Result<Self, PolicyError> {
        if let Some(layer) = network.overflowing_layer(header.observation.limit) {
            return Err(PolicyError::Overflow { layer });
        }
        let mut policy = Self { header, packed: PackedNetwork::new(&network), network, digest: String::new() };
        policy.digest = crumple_core::digest::sha256(policy.to_bytes()?);
        Ok(policy)
    }

    /// The committed reference policy.
    #[must_use]
    pub fn reference() -> Arc<Self> {
        Arc::clone(&REFERENCE)
    }

    /// The file of the reference policy.
    #[must_use]
    pub fn reference_bytes() -> &'static [u8] {
        REFERENCE_BYTES
    }

    /// The committed policy that `crumple retrain` made of the reference policy.
    #[must_use]
    pub fn retrained() -> Arc<Self> {
        Arc::clone(&RETRAINED)
    }

    /// The file of the retrained policy.
    #[must_use]
    pub fn retrained_bytes() -> &'static [u8] {
        RETRAINED_BYTES
    }

    /// Everything but the weights.
    #[must_use]
    pub fn header(&self) -> &PolicyHeader {
        &self.header
    }

    /// The actor's network, before the final tanh.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// SHA-256 of the policy file, in hexadecimal, for reports and certificates.
    #[must_use]
    pub fn digest(&self) -> String {
        self.digest.clone()
    }

    /// What the network sees at a decision: a row of numbers, [`STATE_LEN`] for each decision that it looks back on.
    pub fn observe<'p>(&self, seen: &Observation, past: &'p mut FrameStack) -> &'p [f32] {
        let scaling = &self.header.observation;
        past.push([scaling.history, scaling.history_every], &scaling.state(seen))
    }

    /// The action chosen at one decision, between -1 and 1, for what the network [sees](Policy::look).
    #[must_use]
    pub fn choose(&self, row: &[f32], space: &mut Workspace) -> f32 {
        match *self.packed.forward(row, 1, space) {
            [raw] => ActionBounds::squash(raw),
            _ => -1.0,
        }
    }

    /// What [`Policy::choose`] answers for each of many rows, one after the other, as one matrix product a layer.
    pub fn choose_batch(&self, rows: &[f32], space: &mut Workspace, actions: &mut [f32]) {
        let answers = self.packed.forward(rows, actions.len(), space);
        for (action, &raw) in actions.iter_mut().zip(answers) {
            *action = ActionBounds::squash(raw);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
