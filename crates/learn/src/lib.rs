//! Policies that are trained on the paper's task, and retrained on counterexamples of a search.
//!
//! | module | content |
//! |---|---|
//! | [`rl`] | reinforcement learning: DDPG, its environment, its presets |
//! | [`retrain`] | rounds of search, training on avoidable counterexamples, and acceptance |

pub mod retrain;
pub mod rl;
