//! Learning to drive: deep deterministic policy gradient on the paper's task.
//!
//! [`TrainingConfig`] says how, a seed decides the rest: first weights, scenarios, tried actions, draws from memory. A
//! training always does its arithmetic in the same order, on however many threads, so a seed gives the same policy file to
//! the last byte, alone or beside others, in one go or resumed.
//!
//! [`Learner`] contains the update, written out over the products that a policy acts with. The workspace member `oracle`
//! compares it with the plain formulation on candle's automatic differentiation.

mod adam;
mod backprop;
mod space_mixture;
mod checkpoint;
mod config;
mod config_error;
mod costs;
mod curve;
mod environment;
mod evaluation;
mod folder;
mod learner;
mod limits;
mod observation;
mod privileged;
mod replay;
mod reward;
mod runner;
mod shard;
mod f32_serde;
mod source;
mod trainer;
mod usefulness;

pub use adam::Adam;
pub use space_mixture::{SpaceShare, SpaceMixture};
#[cfg(feature = "schema")]
pub use config::json_schema;
pub use config::{
    EnvironmentConfig, EvaluationConfig, ExplorationConfig, LearningConfig, NetworkConfig, PRESETS, LrDecay,
    ReplayConfig, TRAINING_VERSION, Td3Config, TimeLimit, TrainingConfig,
};
pub use config_error::ConfigError;
pub use costs::CostConfig;
pub use curve::{episode_of, learning_curve};
pub use environment::{Consequence, Ending, Episode, Terms, bounds};
pub use evaluation::{Evaluation, EvaluationSet, UNSEEN_DRAWS, unseen_contacts};
pub use folder::{SeedResult, TrainingFolder, finished_trainings, seed_folder};
pub use learner::{Learner, Losses, Trained};
pub use observation::{Inputs, ObservationConfig, Scale};
pub use replay::{Batch, Remembered, Replay, Transition};
pub use runner::{Event, side_by_side, train};
pub(crate) use runner::{TrainingRecorder, train_recorded};
pub use shard::{GatherError, MergedTrainings, TrainingShard, is_of_trainings};
pub use source::{Blend, Mixed, PaperSource, ScenarioSource, unsuited};
pub use trainer::{Best, EpisodeRecord, Trainer, TrainingError};
pub use usefulness::TrafficUsefulness;
pub(crate) use usefulness::usefulness;

#[cfg(test)]
mod tests;
