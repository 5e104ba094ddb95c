//! ONNX, from opset 6: a straight chain of the operators that small networks consist of.
//!
//! A chain has one input and one answer, and each of its operators takes what the one before it gave, and constants.
//! What else there may be in a graph is refused by the name of its operator and its node.

mod chain;
mod constants;
mod model;

use super::{FeedForward, NetworkError};

/// Oldest set of operators that is read.
const MIN_OPSET: i64 = 6;

/// Reads a network from the bytes of an ONNX file.
pub(super) fn read(bytes: &[u8]) -> Result<FeedForward, NetworkError> {
    let model = model::OnnxModel::read(bytes)?;
    if model.opset < MIN_OPSET {
        let problem = format!("opset {} is too old: those from {MIN_OPSET} are read", model.opset);
        return Err(NetworkError::Unsupported(problem));
    }
    chain::build_network(model)
}
