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
}

/// View of an array in the byte order of the file, without a copy if that is the native order.
struct Array<'a> {
    shape: [usize; 1],
    values: &'a [f32],
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
    let field = |name| header.get(name).cloned().unwrap_or_default();
    if field("version") != VERSION || field("program") != program::identity()? {
        return Err(checkpoint_error(OTHER_BUILD_MESSAGE));
    }
    Ok(())
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
        let mut arrays: Vec<(String, &[f32])> = vec![("replay".to_owned(), replay)];
        for (name, part) in self.named_networks() {
            for (what, values) in [
                ("network", part.network.parameters()),
                ("target", part.target.parameters()),
                ("first", &part.adam.first_moment),
                ("second", &part.adam.second_moment),
            ] {
                arrays.push((format!("{name}.{what}"), values));
            }
        }
        if let Some(mean) = &self.weight_average {
            arrays.push(("mean".to_owned(), mean.parameters()));
        }
        if let Some(best) = &self.best {
            arrays.push(("best".to_owned(), best.network.parameters()));
        }
        let mut arrays: Vec<(String, Array<'_>)> = arrays
            .into_iter()
            .map(|(name, values)| {
                (
                    name,
                    Array {
                        shape: [values.len()],
                        values,
                    },
                )
            })
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
        let (_, container) = SafeTensors::read_metadata(bytes).map_err(checkpoint_error)?;
        let text = container
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(METADATA_KEY));
        let text =
            text.ok_or_else(|| checkpoint_error("this is not a checkpoint of a training"))?;
        check_build(text)?;
        let mut header: CheckpointHeader = serde_json::from_str(text).map_err(checkpoint_error)?;
        let arrays = SafeTensors::deserialize(bytes).map_err(checkpoint_error)?;
        let written = std::mem::take(&mut header.sha256);
        let mut found: Vec<_> = arrays
            .iter()
            .map(|(name, view)| (name, view.data()))
            .collect();
        found.sort_unstable_by_key(|(name, _)| *name);
        if header.digest(found.into_iter())? != written {
            return Err(checkpoint_error(
                "its content does not match its SHA-256: the file is damaged",
            ));
        }
        if header.seed != seed {
            return Err(checkpoint_error(format!(
                "it belongs to seed {}, not {seed}",
                header.seed
            )));
        }
        if (TrainingConfig {
            episodes: config.episodes,
            controllers: config.controllers,
            ..header.config
        }) != *config
        {
            let problem =
                "it belongs to another configuration: only the number of episodes may differ";
            return Err(checkpoint_error(problem));
        }
        let asked = source.identity()?;
        if header.scenarios != asked {
            let name = |source: Option<String>| {
                source.unwrap_or_else(|| "the paper's distribution".to_owned())
            };
            let (found, asked) = (name(header.scenarios), name(asked));
            return Err(checkpoint_error(format!(
                "it belongs to a training on {found}, not on {asked}"
            )));
        }
        if header.episode > config.episodes {
            let (done, asked) = (header.episode, config.episodes);
            return Err(checkpoint_error(format!(
                "{done} episodes are already done, more than the requested {asked}"
            )));
        }
        let mut trainer = Self::with_source(config, seed, source);
        let mut adam_steps = header.adam_steps.into_iter();
        for (name, part) in trainer.named_networks_mut() {
            read_tensor_into(
                &arrays,
                &format!("{name}.network"),
                part.network.parameters_mut(),
            )?;
            read_tensor_into(
                &arrays,
                &format!("{name}.target"),
                part.target.parameters_mut(),
            )?;
            read_tensor_into(
                &arrays,
                &format!("{name}.first"),
                &mut part.adam.first_moment,
            )?;
            read_tensor_into(
                &arrays,
                &format!("{name}.second"),
                &mut part.adam.second_moment,
            )?;
            part.adam.steps = adam_steps
                .next()
                .ok_or_else(|| checkpoint_error("the state of an optimiser is missing"))?;
        }
        let replay = read_tensor(&arrays, "replay")?;
        trainer.replay = ReplayBuffer::from_raw_parts(
            config.replay.capacity,
            config.transition_layout(),
            header.stored,
            replay,
        )
        .ok_or_else(|| checkpoint_error("the size of the replay memory differs from the header"))?;
        let sizes = trainer.learner.actor.network.sizes().to_vec();
        let actor_of = |name| {
            let mut network = Network::zeros(&sizes);
            read_tensor_into(&arrays, name, network.parameters_mut()).map(|()| network)
        };
        if config.evaluation.weight_average_updates > 0 && header.updates > 0 {
            trainer.weight_average = Some(actor_of("mean")?);
        }
        if let Some((episode, evaluation)) = header.best {
            let network = actor_of("best")?;
            trainer.best = Some(BestPolicy {
                episode,
                evaluation,
                network,
            });
        }
        (trainer.episode, trainer.decisions) = (header.episode, header.decisions);
        (trainer.learner.updates, trainer.mastered) = (header.updates, header.mastered);
        Ok(trainer)
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
    let (values, _) = view.data().as_chunks::<4>();
    let values: Vec<f32> = values
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
