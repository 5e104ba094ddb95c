//! Checkpoint of a training: everything that determines its continuation.

use std::borrow::Cow;
use std::sync::Arc;

use pulp::bytemuck;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, View};
use serde::{Deserialize, Serialize};

use super::config::TrainingConfig;
use super::evaluation::PolicyEvaluation;
use super::learner::TrainableNetwork;
use super::replay::ReplayBuffer;
use super::source::ScenarioSource;
use super::trainer::{BestPolicy, Trainer, TrainingError};
use crumple_core::digest::Sha256;
use crumple_sim::policy::Network;
use crumple_store::program::{self, OTHER_BUILD_MESSAGE};

const METADATA_KEY: &str = "crumple_training";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckpointHeader {
    version: u32,
    /// Identity of the program that wrote the checkpoint. Another build may compute different results.
    program: String,
    /// SHA-256 of everything else: this header with an empty string here, and the name and bytes of each array.
    sha256: String,
    config: TrainingConfig,
    seed: u64,
    /// Identity of the scenario source; none for the paper's distribution.
    scenarios: Option<String>,
    episode: u64,
    decisions: u64,
    updates: u64,
    adam_steps: Vec<u64>,
    stored: u64,
    best: Option<(u64, PolicyEvaluation)>,
    mastered: bool,
}

const VERSION: u32 = 3;

impl CheckpointHeader {
    fn digest<'a, B: AsRef<[u8]>>(
        &self,
        arrays: impl Iterator<Item = (&'a str, B)>,
    ) -> Result<String, TrainingError> {
        let mut digest = Sha256::default();
        digest.update(serde_json::to_string(self).map_err(checkpoint_error)?);
        for (name, bytes) in arrays {
            let bytes = bytes.as_ref();
            digest.update(name);
            digest.update((bytes.len() as u64).to_le_bytes());
            digest.update(bytes);
        }
        Ok(digest.hexadecimal())
    }

    /// Checks the SHA-256 of the file, and removes it from the header.
    fn check_digest(&mut self, arrays: &SafeTensors<'_>) -> Result<(), TrainingError> {
        let stated = std::mem::take(&mut self.sha256);
        let mut arrays: Vec<_> = arrays
            .iter()
            .map(|(name, view)| (name, view.data()))
            .collect();
        arrays.sort_unstable_by_key(|(name, _)| *name);
        if self.digest(arrays.into_iter())? == stated {
            Ok(())
        } else {
            Err(checkpoint_error(
                "its content does not match its SHA-256: the file is damaged",
            ))
        }
    }

    /// Checks that a training with this configuration, seed and source can continue.
    fn check_training(
        &self,
        config: &TrainingConfig,
        seed: u64,
        source: &dyn ScenarioSource,
    ) -> Result<(), TrainingError> {
        if self.seed != seed {
            return Err(checkpoint_error(format!(
                "it belongs to seed {}, not {seed}",
                self.seed
            )));
        }
        if (TrainingConfig {
            episodes: config.episodes,
            controllers: config.controllers,
            ..self.config.clone()
        }) != *config
        {
            let problem =
                "it belongs to another configuration: only the number of episodes may differ";
            return Err(checkpoint_error(problem));
        }
        let scenarios = source.identity()?;
        if self.scenarios != scenarios {
            return Err(checkpoint_error(format!(
                "it belongs to a training on {}, not on {}",
                describe_source(self.scenarios.as_deref()),
                describe_source(scenarios.as_deref())
            )));
        }
        if self.episode > config.episodes {
            return Err(checkpoint_error(format!(
                "{} episodes are already done, more than the requested {}",
                self.episode, config.episodes
            )));
        }
        Ok(())
    }
}

fn describe_source(identity: Option<&str>) -> &str {
    identity.unwrap_or("the paper's distribution")
}

/// Reads the header of a checkpoint of this build.
fn read_header(bytes: &[u8]) -> Result<CheckpointHeader, TrainingError> {
    let container = SafeTensors::read_metadata(bytes)
        .map_err(checkpoint_error)?
        .1;
    let text = container
        .metadata()
        .as_ref()
        .and_then(|metadata| metadata.get(METADATA_KEY))
        .ok_or_else(|| checkpoint_error("this is not a checkpoint of a training"))?;
    check_build(text)?;
    serde_json::from_str(text).map_err(checkpoint_error)
}

/// View of an array in the byte order of the file, without a copy if that is the native order.
struct Array<'a> {
    shape: [usize; 1],
    values: &'a [f32],
}

impl<'a> Array<'a> {
    fn new(values: &'a [f32]) -> Self {
        Self {
            shape: [values.len()],
            values,
        }
    }
}

impl View for Array<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        if cfg!(target_endian = "little") {
            Cow::Borrowed(bytemuck::cast_slice(self.values))
        } else {
            self.values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect()
        }
    }

    fn data_len(&self) -> usize {
        size_of_val(self.values)
    }
}

/// Refuses a checkpoint of another build, without reading the rest of its header.
fn check_build(text: &str) -> Result<(), TrainingError> {
    let header: serde_json::Value = serde_json::from_str(text).map_err(checkpoint_error)?;
    let is_of_this_build = header
        .get("version")
        .is_some_and(|version| *version == VERSION)
        && header.get("program").and_then(|program| program.as_str()) == Some(program::identity()?);
    if is_of_this_build {
        Ok(())
    } else {
        Err(checkpoint_error(OTHER_BUILD_MESSAGE))
    }
}

fn checkpoint_error(problem: impl std::fmt::Display) -> TrainingError {
    TrainingError::Checkpoint(problem.to_string())
}

impl Trainer {
    /// Encodes the training between two episodes.
    ///
    /// # Errors
    /// [`TrainingError::Checkpoint`] in principle, if encoding fails.
    pub(crate) fn to_checkpoint(&self) -> Result<Vec<u8>, TrainingError> {
        let (stored, replay) = self.replay.as_raw_parts();
        let mut header = CheckpointHeader {
            version: VERSION,
            program: program::identity()?.to_owned(),
            sha256: String::new(),
            config: self.config.clone(),
            seed: self.seed,
            scenarios: self.source.identity()?,
            episode: self.episode,
            decisions: self.decisions,
            updates: self.learner.updates,
            adam_steps: self
                .named_networks()
                .map(|(_, part)| part.adam.steps)
                .collect(),
            stored,
            best: self
                .best
                .as_ref()
                .map(|best| (best.episode, best.evaluation)),
            mastered: self.mastered,
        };
        let mut arrays: Vec<(String, Array<'_>)> = self
            .network_arrays()
            .chain([("replay".to_owned(), replay)])
            .map(|(name, values)| (name, Array::new(values)))
            .collect();
        arrays.sort_unstable_by(|(a, _), (b, _)| a.cmp(b));
        header.sha256 = header.digest(
            arrays
                .iter()
                .map(|(name, array)| (name.as_str(), array.data())),
        )?;
        let text = serde_json::to_string(&header).map_err(checkpoint_error)?;
        safetensors::serialize(arrays, Some([(METADATA_KEY.to_owned(), text)].into()))
            .map_err(checkpoint_error)
    }

    /// Returns the parameters of all networks and optimisers, with their names in the file.
    fn network_arrays(&self) -> impl Iterator<Item = (String, &[f32])> {
        let trained = self.named_networks().flat_map(|(name, part)| {
            [
                ("network", part.network.parameters()),
                ("target", part.target.parameters()),
                ("first", &part.adam.first_moment),
                ("second", &part.adam.second_moment),
            ]
            .map(|(array, values)| (format!("{name}.{array}"), values))
        });
        let mean = self
            .weight_average
            .as_ref()
            .map(|mean| ("mean".to_owned(), mean.parameters()));
        let best = self
            .best
            .as_ref()
            .map(|best| ("best".to_owned(), best.network.parameters()));
        trained.chain(mean).chain(best)
    }

    /// Decodes a result of [`Trainer::to_checkpoint`]. `config` may differ from it only in the number of episodes.
    ///
    /// # Errors
    /// [`TrainingError::Checkpoint`] if it is damaged, or of another build, training or source.
    pub(crate) fn from_checkpoint(
        bytes: &[u8],
        config: &TrainingConfig,
        seed: u64,
        source: Arc<dyn ScenarioSource>,
    ) -> Result<Self, TrainingError> {
        let mut header = read_header(bytes)?;
        let arrays = SafeTensors::deserialize(bytes).map_err(checkpoint_error)?;
        header.check_digest(&arrays)?;
        header.check_training(config, seed, &*source)?;
        let mut trainer = Self::with_source(config, seed, source);
        trainer.read_networks(&arrays, &header.adam_steps)?;
        let replay = read_tensor(&arrays, "replay")?;
        trainer.replay = ReplayBuffer::from_raw_parts(
            config.replay.capacity,
            config.transition_layout(),
            header.stored,
            replay,
        )
        .ok_or_else(|| checkpoint_error("the size of the replay memory differs from the header"))?;
        if config.evaluation.weight_average_updates > 0 && header.updates > 0 {
            trainer.weight_average = Some(trainer.read_actor(&arrays, "mean")?);
        }
        if let Some((episode, evaluation)) = header.best {
            trainer.best = Some(BestPolicy {
                episode,
                evaluation,
                network: trainer.read_actor(&arrays, "best")?,
            });
        }
        trainer.episode = header.episode;
        trainer.decisions = header.decisions;
        trainer.learner.updates = header.updates;
        trainer.mastered = header.mastered;
        Ok(trainer)
    }

    /// Reads the networks in training, with the state of their optimisers.
    fn read_networks(
        &mut self,
        arrays: &SafeTensors<'_>,
        adam_steps: &[u64],
    ) -> Result<(), TrainingError> {
        let mut adam_steps = adam_steps.iter();
        for (name, part) in self.named_networks_mut() {
            for (array, values) in [
                ("network", part.network.parameters_mut()),
                ("target", part.target.parameters_mut()),
                ("first", &mut part.adam.first_moment),
                ("second", &mut part.adam.second_moment),
            ] {
                read_tensor_into(arrays, &format!("{name}.{array}"), values)?;
            }
            part.adam.steps = *adam_steps
                .next()
                .ok_or_else(|| checkpoint_error("the state of an optimiser is missing"))?;
        }
        Ok(())
    }

    /// Reads a network of the size of the actor.
    fn read_actor(&self, arrays: &SafeTensors<'_>, name: &str) -> Result<Network, TrainingError> {
        let mut network = Network::zeros(self.learner.actor.network.sizes());
        read_tensor_into(arrays, name, network.parameters_mut())?;
        Ok(network)
    }

    fn named_networks(&self) -> impl Iterator<Item = (String, &TrainableNetwork)> {
        let critics = self
            .learner
            .critics
            .iter()
            .enumerate()
            .map(|(i, critic)| (format!("critic-{i}"), critic));
        std::iter::once(("actor".to_owned(), &self.learner.actor)).chain(critics)
    }

    fn named_networks_mut(&mut self) -> impl Iterator<Item = (String, &mut TrainableNetwork)> {
        let critics = self
            .learner
            .critics
            .iter_mut()
            .enumerate()
            .map(|(i, critic)| (format!("critic-{i}"), critic));
        std::iter::once(("actor".to_owned(), &mut self.learner.actor)).chain(critics)
    }
}

fn read_tensor(arrays: &SafeTensors<'_>, name: &str) -> Result<Vec<f32>, TrainingError> {
    let view = arrays.tensor(name).map_err(checkpoint_error)?;
    if view.dtype() != Dtype::F32 {
        return Err(checkpoint_error(format!(
            "`{name}` must be F32, found {:?}",
            view.dtype()
        )));
    }
    let values: Vec<f32> = view
        .data()
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&bytes| f32::from_le_bytes(bytes))
        .collect();
    if values.iter().all(|value| value.is_finite()) {
        Ok(values)
    } else {
        Err(checkpoint_error(format!(
            "`{name}` holds a number that is not finite"
        )))
    }
}

fn read_tensor_into(
    arrays: &SafeTensors<'_>,
    name: &str,
    out: &mut [f32],
) -> Result<(), TrainingError> {
    let values = read_tensor(arrays, name)?;
    if values.len() != out.len() {
        return Err(checkpoint_error(format!(
            "`{name}` must have {} numbers, found {}",
            out.len(),
            values.len()
        )));
    }
    out.copy_from_slice(&values);
    Ok(())
}
