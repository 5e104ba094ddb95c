//! What can be learned: policies trained on the paper's task, and retrained against what a search found.
//!
//! | module | what it holds |
//! |---|---|
//! | [`rl`] | learning to drive: DDPG, its environment, its presets |
//! | [`retrain`] | search, train on what could have been avoided, accept what breaks nothing; again |

pub mod retrain;
pub mod rl;
