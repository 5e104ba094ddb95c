//! Policies that are trained on the paper's task and retrained on counterexamples of a search, and controllers whose
//! settings are tuned.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`rl`] | reinforcement learning: DDPG, its environment, its presets |
//! | [`retrain`] | rounds of search, training on avoidable counterexamples, and acceptance |
//! | [`tune`] | settings of built-in controllers, fitted on the closed loop |

pub mod retrain;
pub mod rl;
pub mod tune;
