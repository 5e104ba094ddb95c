//! Reinforcement learning of a driving policy: deep deterministic policy gradient on the paper's task.
//!
//! [`TrainingConfig`] and a seed determine a training: initial weights, scenarios, exploration and samples from the
//! replay memory. The order of all arithmetic is fixed, so a seed gives the same policy file to the last byte on any
//! number of threads, in parallel with others, and after a resume.
//!
//! [`Learner`] implements the update with the same matrix products as a policy. The workspace member `oracle` compares
//! it with an implementation that uses candle's automatic differentiation.

mod adam;
mod backprop;
mod checkpoint;
mod config;
mod config_error;
mod costs;
mod curve;
mod environment;
mod evaluation;
mod folder;
mod imitation;
mod learner;
mod limits;
mod observation;
mod privileged;
mod recorded_drives;
mod replay;
mod report;
mod reward;
mod runner;
mod serde_helpers;
mod source;
mod space_mixture;
mod trainer;
mod usefulness;

pub use adam::Adam;
#[cfg(feature = "schema")]
pub use config::json_schema;
pub use config::{
    EnvironmentConfig, EvaluationConfig, ExplorationConfig, LearningConfig, LrDecay, NetworkConfig,
    PRESETS, ReplayConfig, TRAINING_VERSION, Td3Config, TimeLimit, TrainingConfig,
};
pub use config_error::TrainingConfigError;
pub use costs::CostConfig;
pub use curve::{learning_curve, parse_episode};
pub use environment::{
    EpisodeConstants, EpisodeEnding, StepOutcome, TrainingEpisode, action_bounds,
};
pub use evaluation::{EvaluationSet, PolicyEvaluation, UNSEEN_DRAWS, count_unseen_collisions};
pub use folder::{
    SeedResult, SeedTraining, SeedTrainingState, read_finished_trainings, seed_folder,
};
pub use imitation::{ImitationConfig, ImitationLoss, ImitationRound};
pub use learner::{Learner, Losses, TrainableNetwork};
pub use observation::{InputScaling, ObservationConfig, ObservationInputs};
pub use recorded_drives::RecordedUsefulness;
pub use replay::{Batch, Transition};
pub use report::{TrainingResult, format_table};
pub use runner::{TrainingEvent, parallel_map, train};
pub(crate) use runner::{TrainingRecorder, train_with_recorder};
pub use source::{CaseMixture, PaperSource, ScenarioSource, SourceMixture, unsuitability};
pub use space_mixture::{SpaceMixture, TrainingSpace};
pub use trainer::{BestPolicy, EpisodeRecord, Trainer, TrainingError};
pub(crate) use usefulness::{
    EXCESS_WEIGHT, MAX_RATIO_TO_IDM, TIME_GAP_RANGE_S, TrafficBenchmark, measure_usefulness,
};
pub use usefulness::{EverydayUsefulness, TrafficUsefulness};

#[cfg(test)]
mod tests;
