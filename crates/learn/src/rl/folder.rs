//! Training in a run folder: limits the loss of an interruption, and detects damage.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config::TrainingConfig;
use super::curve::{parse_episode, parse_evaluation};
use super::evaluation::{EvaluationSet, PolicyEvaluation, count_unseen_collisions};
use super::runner::{TrainingEvent, TrainingRecorder, end_training, start_training, train_episode};
use super::source::ScenarioSource;
use super::trainer::{Trainer, TrainingError};
use crumple_core::observer::Observer;
use crumple_core::{old_names, text_file};
use crumple_store::disk::DiskError;
use crumple_store::run_folder::{FolderTransaction, MANIFEST_FILE, RunFolder, RunFolderError};
use crumple_store::study::{self, Study, StudyStep};

/// Configuration of the training: a file for `--preset`.
const CONFIGURATION: &str = "training.toml";
const LOG: &str = "log.jsonl";
const CHECKPOINT: &str = "checkpoint.safetensors";
const POLICY: &str = "policy.safetensors";
const RESULT: &str = "result.json";

/// Result of the training of one seed: the file `result.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedResult {
    /// The seed.
    pub seed: u64,
    /// Episodes done.
    pub episodes: u64,
    /// Episode after which the policy was evaluated.
    pub best_episode: Option<u64>,
    /// Evaluation of the policy.
    #[serde(flatten)]
    pub evaluation: Option<PolicyEvaluation>,
    /// Collisions in the final test of [`super::UNSEEN_DRAWS`] random scenarios.
    #[serde(alias = "unseen_contacts")]
    pub unseen_collisions: u64,
    /// SHA-256 of the policy file; none if no checkpoint was better than the untrained network, which is not stored.
    pub policy_sha256: Option<String>,
}

impl SeedResult {
    /// True if any checkpoint was better than the untrained network.
    #[must_use]
    pub fn has_learned(&self) -> bool {
        self.policy_sha256.is_some()
    }
}

/// Training of one seed: a study in the seed's folder. A finished one may be continued with more episodes.
#[derive(Debug, Clone, Copy)]
pub struct SeedTraining<'a> {
    /// Configuration of the training.
    pub config: &'a TrainingConfig,
    /// The seed.
    pub seed: u64,
    /// Scenarios that evaluate checkpoints, of the configuration.
    pub held_out: &'a EvaluationSet,
}

/// State of a training between two episodes.
#[derive(Debug)]
pub struct SeedTrainingState {
    trainer: Trainer,
    log: String,
    /// True after the imitation and the evaluation before the first episode.
    is_started: bool,
}

impl SeedTrainingState {
    /// Returns the number of completed episodes.
    #[must_use]
    pub fn episode(&self) -> u64 {
        self.trainer.episode()
    }

    /// True if the policy is better than the untrained network.
    fn has_learned(&self) -> bool {
        self.trainer.config.imitation.is_some()
            || self.trainer.best().is_some_and(|best| best.episode > 0)
    }
}

/// Returns the folder of a seed in `out`.
#[must_use]
pub fn seed_folder(out: &Path, seed: u64) -> PathBuf {
    out.join(format!("seed-{seed}"))
}

/// The first step is the imitation, and the evaluation before the first episode. Each further step is an episode.
impl Study for SeedTraining<'_> {
    const KIND: &'static str = "training";
    const CONFIGURATION_FILE: &'static str = CONFIGURATION;
    const OUTPUTS: &'static [&'static str] = &[CONFIGURATION, LOG, CHECKPOINT, POLICY, RESULT];

    type State = SeedTrainingState;
    type Progress = TrainingEvent;
    type Report = SeedResult;
    type Error = TrainingError;

    /// Returns everything that determines a training, except the number of episodes, which may grow; with the names of
    /// version 1, so that a finished training of 0.3.0 is recognised.
    fn configuration(&self) -> Result<String, TrainingError> {
        let config = config_toml(&TrainingConfig {
            episodes: 0,
            ..self.config.clone()
        })?;
        let config = old_names::TRAINING.restore_in_text(&config);
        Ok(format!("seed = {}\n{config}", self.seed))
    }

    fn configuration_file(&self) -> Result<Option<String>, TrainingError> {
        config_toml(self.config).map(Some)
    }

    /// The configuration has a line with the seed and old names, which the file does not have.
    fn compared_configurations(&self, existing: &str) -> Result<[String; 2], TrainingError> {
        let parsed = text_file::parse_toml::<TrainingConfig>(existing, Path::new(CONFIGURATION));
        let Ok(existing) = parsed else {
            return Ok([existing.to_owned(), config_toml(self.config)?]);
        };
        let asked = TrainingConfig {
            episodes: existing.episodes,
            ..self.config.clone()
        };
        Ok([config_toml(&existing)?, config_toml(&asked)?])
    }

    fn is_finished(&self, folder: &RunFolder) -> Result<bool, TrainingError> {
        let existing = folder.read(CONFIGURATION)?.unwrap_or_default();
        Ok(folder.is_complete() && is_same_config(self.config, &existing)?)
    }

    fn load(&self, folder: &RunFolder) -> Result<SeedTrainingState, TrainingError> {
        let trainer = self.load_trainer(folder)?;
        let log = match trainer.episode() {
            0 => String::new(),
            _ => {
                let bytes = folder.read(LOG)?.unwrap_or_default();
                log_until_checkpoint(&String::from_utf8_lossy(&bytes), &trainer)
            }
        };
        Ok(SeedTrainingState {
            is_started: trainer.episode() > 0,
            trainer,
            log,
        })
    }

    fn step(
        &self,
        state: &mut SeedTrainingState,
        folder: &RunFolder,
        observer: &dyn Observer<TrainingEvent>,
    ) -> Result<StudyStep, TrainingError> {
        let result = self.train_next(state, folder, observer);
        if matches!(result, Err(TrainingError::Diverged { .. })) && !state.has_learned() {
            // An untrained network is no result of a training.
            folder.transaction().remove(POLICY).commit()?;
        }
        result
    }

    fn finish(
        &self,
        mut state: SeedTrainingState,
        folder: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<TrainingEvent>,
    ) -> Result<SeedResult, TrainingError> {
        let mut recorder = FolderRecorder {
            run_folder: folder,
            log: &mut state.log,
            observer,
        };
        end_training(&mut state.trainer, self.held_out, &mut recorder)?;
        let has_learned = state.has_learned();
        let policy = Arc::new(state.trainer.policy()?);
        let best = state.trainer.best();
        let result = SeedResult {
            seed: self.seed,
            episodes: state.episode(),
            best_episode: best.map(|best| best.episode),
            evaluation: best.map(|best| best.evaluation),
            unseen_collisions: count_unseen_collisions(&policy, self.config.environment.estimator)?,
            policy_sha256: has_learned.then(|| policy.digest()),
        };
        // The checkpoint precedes a final evaluation that is not due otherwise.
        results.write(LOG, state.log).write_json(RESULT, &result)?;
        if has_learned {
            results.write(POLICY, policy.to_bytes()?);
        } else {
            results.remove(POLICY);
        }
        Ok(result)
    }

    fn read(
        &self,
        folder: &RunFolder,
        _: &dyn Observer<TrainingEvent>,
    ) -> Result<SeedResult, TrainingError> {
        Ok(folder.read_required_json(RESULT)?)
    }
}

impl SeedTraining<'_> {
    /// Returns the trainer at the last checkpoint, or at the start.
    fn load_trainer(&self, folder: &RunFolder) -> Result<Trainer, TrainingError> {
        let source = self.config.scenario_source()?;
        if let Some(bytes) = folder.read(CHECKPOINT)? {
            let trainer = self.read_checkpoint(&bytes, Arc::clone(&source), folder)?;
            // An imitation alone is repeated, because it must not start from its own result.
            if trainer.episode() > 0 {
                return Ok(trainer);
            }
        }
        Ok(Trainer::with_source(self.config, self.seed, source))
    }

    fn read_checkpoint(
        &self,
        bytes: &[u8],
        source: Arc<dyn ScenarioSource>,
        folder: &RunFolder,
    ) -> Result<Trainer, TrainingError> {
        match Trainer::from_checkpoint(bytes, self.config, self.seed, source) {
            Err(TrainingError::Checkpoint(problem)) => {
                Err(RunFolderError::damaged(&folder.path(CHECKPOINT), problem).into())
            }
            trainer => trainer,
        }
    }

    fn train_next(
        &self,
        state: &mut SeedTrainingState,
        folder: &RunFolder,
        observer: &dyn Observer<TrainingEvent>,
    ) -> Result<StudyStep, TrainingError> {
        let mut recorder = FolderRecorder {
            run_folder: folder,
            log: &mut state.log,
            observer,
        };
        if !state.is_started {
            start_training(&mut state.trainer, self.held_out, &mut recorder)?;
            state.is_started = true;
        } else if !state.trainer.is_done() {
            train_episode(&mut state.trainer, self.held_out, &mut recorder)?;
        }
        if state.trainer.is_done() {
            Ok(StudyStep::Done)
        } else {
            Ok(StudyStep::Continue)
        }
    }
}

/// Returns the log up to the checkpoint of the trainer. The episodes after it are repeated.
fn log_until_checkpoint(log: &str, trainer: &Trainer) -> String {
    log.split_inclusive('\n')
        .take_while(|line| parse_episode(line).is_some_and(|episode| episode <= trainer.episode()))
        // Drop an evaluation that was made only because an earlier training ended. It is repeated if this one ends at
        // the same episode.
        .filter(|line| {
            parse_evaluation(line)
                .is_none_or(|(episode, _)| episode == 0 || trainer.is_evaluation_episode(episode))
        })
        .collect()
}

struct FolderRecorder<'a> {
    run_folder: &'a RunFolder,
    log: &'a mut String,
    observer: &'a dyn Observer<TrainingEvent>,
}

impl TrainingRecorder<TrainingError> for FolderRecorder<'_> {
    fn record(&mut self, event: &TrainingEvent) -> Result<(), TrainingError> {
        let line =
            serde_json::to_string(event).map_err(|error| RunFolderError::encoding(LOG, error))?;
        self.log.push_str(&line);
        self.log.push('\n');
        Ok(self.observer.notify(event)?)
    }

    fn checkpoint(&mut self, trainer: &Trainer) -> Result<(), TrainingError> {
        let policy = trainer.policy()?.to_bytes()?;
        let checkpoint = trainer.to_checkpoint()?;
        let mut changes = self.run_folder.transaction();
        changes
            .write(LOG, self.log.as_str())
            .write(POLICY, policy)
            .write(CHECKPOINT, checkpoint);
        Ok(changes.commit()?)
    }
}

/// Returns the finished trainings of a configuration, in the order of seeds, with logs. Skips unfinished ones.
///
/// # Errors
/// [`TrainingError`] if a training has another configuration, or one of its files is damaged.
pub fn read_finished_trainings(
    out: &Path,
    config: &TrainingConfig,
    held_out: &EvaluationSet,
) -> Result<Vec<(SeedResult, String)>, TrainingError> {
    let mut finished = Vec::new();
    for seed in find_seeds(out)? {
        let training = SeedTraining {
            config,
            seed,
            held_out,
        };
        finished.extend(read_if_finished(&training, &seed_folder(out, seed))?);
    }
    Ok(finished)
}

/// Returns the seeds that have a folder in `out`, in order.
fn find_seeds(out: &Path) -> Result<Vec<u64>, DiskError> {
    let mut seeds = Vec::new();
    for entry in fs::read_dir(out).map_err(DiskError::at(out))? {
        let name = entry.map_err(DiskError::at(out))?.file_name();
        let seed = name
            .to_str()
            .and_then(|name| name.strip_prefix("seed-")?.parse::<u64>().ok());
        // `seed-07` is not the name of a seed's folder.
        seeds.extend(
            seed.filter(|&seed| name == *format!("seed-{seed}") && seed_folder(out, seed).is_dir()),
        );
    }
    seeds.sort_unstable();
    Ok(seeds)
}

/// Reads the result and the log of a training; `None` if it is not finished.
fn read_if_finished(
    training: &SeedTraining<'_>,
    folder: &Path,
) -> Result<Option<(SeedResult, String)>, TrainingError> {
    let manifest = folder.join(MANIFEST_FILE);
    if !manifest.exists() {
        return match [POLICY, CHECKPOINT].map(|name| folder.join(name).exists()) {
            // Another process may be about to start there.
            [false, false] => Ok(None),
            _ => Err(RunFolderError::missing(&manifest).into()),
        };
    }
    let run_folder = match study::open_run_folder(training, folder, true) {
        Err(TrainingError::RunFolder(
            RunFolderError::InUse { .. } | RunFolderError::OtherBuild { .. },
        )) => return Ok(None),
        run_folder => run_folder?,
    };
    if !run_folder.is_complete() {
        return Ok(None);
    }
    let log = String::from_utf8_lossy(&run_folder.read_required(LOG)?).into_owned();
    Ok(Some((run_folder.read_required_json(RESULT)?, log)))
}

/// True if the text of a finished training, with present or old names, is this configuration.
fn is_same_config(config: &TrainingConfig, existing: &[u8]) -> Result<bool, TrainingError> {
    let asked = config_toml(config)?;
    let existing = String::from_utf8_lossy(existing);
    match text_file::parse_toml::<TrainingConfig>(&existing, Path::new(CONFIGURATION)) {
        Ok(existing) => Ok(config_toml(&existing)? == asked),
        Err(_) => Ok(false),
    }
}

fn config_toml(config: &TrainingConfig) -> Result<String, TrainingError> {
    Ok(toml::to_string(config).map_err(|error| RunFolderError::encoding(CONFIGURATION, error))?)
}
