//! Reader of ONNX files, from opset 6: straight chains of the operators of small networks.
//!
//! A chain has one input and one answer. Each operator uses the output of the previous one and constants.

mod chain;
mod constants;
mod model;

use super::{FeedForward, NetworkError};

const MIN_OPSET: i64 = 6;

/// Reads a network from the bytes of an ONNX file.
pub(super) fn read(bytes: &[u8]) -> Result<FeedForward, NetworkError> {
    let model = model::OnnxModel::read(bytes)?;
    if model.opset < MIN_OPSET {
        let problem = format!(
            "opset {} is too old: those from {MIN_OPSET} are read",
            model.opset
        );
        return Err(NetworkError::Unsupported(problem));
    }
    chain::build_network(model)
}
