//! Imported networks: fully connected, layers of any width, with readers of their own.
//!
//! | module | content |
//! |---|---|
//! | `feed_forward` | the network and its evaluation for one state or many |
//! | `protobuf` | the encoding of protocol buffers |
//! | `onnx` | ONNX: a straight chain of a few operators |
//! | `archive` | zip archives with uncompressed members |
//! | `pickle` | the values of a pickle, without calling anything |
//! | `sb3` | models saved by Stable-Baselines3 |
//!
//! The operations of a file run in its order, in single precision: products as in crumple's own policies, all else
//! elementwise. Only an addition right after a product becomes its bias.

mod archive;
mod description;
mod error;
mod feed_forward;
mod onnx;
mod pickle;
mod protobuf;
mod sb3;

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use crumple_core::regular_file;

pub use crumple_sim::policy::Elementwise;
pub use description::{FoundStatistics, NetworkDescription, SavedModelDescription};
pub use error::NetworkError;
pub use feed_forward::{FeedForward, Linear, NetworkStep};
pub use sb3::{BoxSpace, Normalisation, SavedModel, VecNormalizeStats, VecNormalizeUse};

const MAX_BYTES: u64 = 64 << 20;

const MAX_PARAMETERS: usize = 8 << 20;

const MAX_LAYER_WIDTH: usize = 1 << 14;

const MAX_STEPS: usize = 256;

/// A network with its file.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkFile {
    /// The network.
    pub network: FeedForward,
    /// SHA-256 of the file, in hexadecimal.
    pub sha256: String,
    /// Content of the file, for copies beside results.
    bytes: Arc<[u8]>,
    format: NetworkFormat,
    saved_model: Option<Arc<SavedModel>>,
}

impl NetworkFile {
    /// True if a file counts as a network: it ends in `.onnx`, in `.zip` for a model of Stable-Baselines3, or in
    /// neither and begins as a zip archive. `model.save("ppo_0.5")` appends no `.zip`.
    #[must_use]
    pub fn is_network(path: &Path) -> bool {
        NetworkFormat::from_path(path).is_some()
    }

    /// Reads a network.
    ///
    /// # Errors
    /// [`NetworkError`] for a file that cannot be read, is damaged, or contains no supported network.
    pub fn load(path: &Path) -> Result<Self, NetworkError> {
        let format =
            NetworkFormat::from_path(path).ok_or_else(|| NetworkError::Extension.in_file(path))?;
        let mut bytes = Vec::new();
        regular_file::open(path)
            .and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes))
            .map_err(|source| NetworkError::Read {
                path: path.to_owned(),
                source,
            })?;
        Self::from_bytes(&bytes, format).map_err(|reason| reason.in_file(path))
    }

    fn from_bytes(bytes: &[u8], format: NetworkFormat) -> Result<Self, NetworkError> {
        if bytes.len() as u64 > MAX_BYTES {
            return Err(NetworkError::TooLarge);
        }
        let mut saved_model = None;
        let network = match format {
            NetworkFormat::Onnx => onnx::read(bytes)?,
            NetworkFormat::StableBaselines => {
                let model = sb3::read(bytes)?;
                saved_model = Some(Arc::new(model.metadata));
                model.network
            }
        };
        Ok(Self {
            network,
            sha256: crumple_core::digest::sha256(bytes),
            bytes: bytes.into(),
            format,
            saved_model,
        })
    }

    /// Returns the metadata of a Stable-Baselines3 model.
    #[must_use]
    pub fn saved_model(&self) -> Option<&SavedModel> {
        self.saved_model.as_deref()
    }

    /// Returns the format of the file.
    #[must_use]
    pub fn format(&self) -> NetworkFormat {
        self.format
    }

    /// Returns the file, and a name for it that identifies its content.
    pub fn name_and_bytes(&self) -> (String, Arc<[u8]>) {
        let extension = match self.format {
            NetworkFormat::Onnx => "onnx",
            NetworkFormat::StableBaselines => "zip",
        };
        let digits = self.sha256.get(..16).unwrap_or(&self.sha256);
        (format!("{digits}.{extension}"), Arc::clone(&self.bytes))
    }

    /// Reads a network from the bytes of an ONNX file.
    ///
    /// # Errors
    /// [`NetworkError`], as for [`Self::load`].
    pub fn from_onnx(bytes: &[u8]) -> Result<Self, NetworkError> {
        Self::from_bytes(bytes, NetworkFormat::Onnx)
    }

    /// Reads the actor of a model saved by Stable-Baselines3.
    ///
    /// # Errors
    /// [`NetworkError`], as for [`Self::load`].
    pub fn from_sb3(bytes: &[u8]) -> Result<Self, NetworkError> {
        Self::from_bytes(bytes, NetworkFormat::StableBaselines)
    }
}

/// Supported formats of networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum NetworkFormat {
    /// ONNX.
    Onnx,
    /// A model saved by Stable-Baselines3.
    StableBaselines,
}

impl NetworkFormat {
    fn from_path(path: &Path) -> Option<Self> {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("onnx") => Some(Self::Onnx),
            Some("zip") => Some(Self::StableBaselines),
            // These are other formats, even if they begin as a zip archive.
            Some("toml" | "fmu" | "safetensors") => None,
            _ => has_zip_signature(path).then_some(Self::StableBaselines),
        }
    }
}

/// True if a regular file begins as a zip archive.
fn has_zip_signature(path: &Path) -> bool {
    let mut first = [0; 4];
    let is_read =
        regular_file::open(path).is_ok_and(|mut file| file.read_exact(&mut first).is_ok());
    is_read && first == *b"PK\x03\x04"
}

#[cfg(test)]
mod tests;
