//! Imported networks as controllers.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`network`] | networks and the readers of their files: ONNX, Stable-Baselines3 |
//! | `mapping` | the mapping of observations to inputs, and of an output to an acceleration |
//! | `history` | inputs at the last decisions |
//! | `space_check` | comparison of a mapping with the spaces of the training |
//! | `controller` | a network with its mapping as a source of controllers |
//! | `checker_file` | the file by which the checker of certificates identifies a network |

mod checker_file;
mod controller;
mod history;
mod mapping;
pub mod network;
mod space_check;

pub use controller::NetworkController;
pub use history::InputHistory;
pub use mapping::{HistoryPadding, InputMapping, InvalidMapping, Mapping, OutputMapping, Squash};
