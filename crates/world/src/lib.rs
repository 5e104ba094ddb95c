//! What happens: scenarios, the vehicles' drivers, two engines with one meaning, and measures of what they did.
//!
//! One way through, each module using only those above it:
//!
//! | module | what it holds |
//! |---|---|
//! | [`random`] | seeded streams: one seed decides everything |
//! | [`observation`] | what a controller may see |
//! | `settings` | settings of controllers: numbers with a default, a range and a usual range |
//! | `idm` | the Intelligent Driver Model, which drives, is departed from and is compared with |
//! | [`policy`] | the actor network and its file: acting, one state or many |
//! | [`network`] | networks from outside: ONNX, Stable-Baselines3 |
//! | [`process`] | programs that are asked line by line, and how they fail |
//! | [`control`] | who decides: one trait, one table, one file for each controller |
//! | [`scenario`] | what may happen: vehicles, drivers, lead profiles, the file format, the paper's scenarios |
//! | [`estimate`] | what the ego knows: sensors and the Kalman filter |
//! | [`sim`] | how it happens: exact steps, contact times, two engines with one meaning, the trace |
//! | [`measure`] | how it was: surrogate safety measures; formulas of signal temporal logic and their monitor |
//! | `recording` | recorded traffic turned into scenarios (a feature) |

pub mod control;
pub mod estimate;
mod idm;
pub mod measure;
pub mod network;
pub mod observation;
pub mod policy;
pub mod process;
pub mod random;
#[cfg(feature = "recording")]
pub mod recording;
pub mod scenario;
mod settings;
pub mod sim;
