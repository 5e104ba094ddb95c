//! Training in a run folder: limits the loss of an interruption, and detects damage.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::config::TrainingConfig;
use super::curve::{parse_episode, parse_evaluation};
use super::evaluation::{EvaluationSet, PolicyEvaluation, count_unseen_contacts};
use super::runner::{TrainingEvent, TrainingRecorder, train_with_recorder};
use super::trainer::{Trainer, TrainingError};
use crumple_core::observer::Observer;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::{MANIFEST_FILE, RunFolder, RunFolderError, RunFolderOptions};

/// Configuration of the training: a file for `--preset`.
pub(super) const CONFIGURATION: &str = "training.toml";
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
    pub unseen_contacts: u64,
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

/// Training of one seed in its folder.
#[derive(Debug)]
pub struct TrainingFolder<'a> {
    run_folder: RunFolder,
    config: &'a TrainingConfig,
    pub(super) trainer: Trainer,
    log: String,
}

/// Returns the folder of a seed in `out`.
#[must_use]
pub fn seed_folder(out: &Path, seed: u64) -> PathBuf {
    out.join(format!("seed-{seed}"))
}

impl<'a> TrainingFolder<'a> {
    /// Starts the training of a seed in its folder in `out`, or continues it if `resume` is set.
    ///
    /// # Errors
    /// [`TrainingError`] if the folder is in use, damaged, or holds another training or one of another build.
    pub fn open(
        out: &Path,
        config: &'a TrainingConfig,
        seed: u64,
        resume: bool,
    ) -> Result<Self, TrainingError> {
        let work = open_run_folder(out, config, seed, resume)?;
        let (checkpoint, path, source) = (
            work.read(CHECKPOINT)?,
            work.path(CHECKPOINT),
            config.scenario_source()?,
        );
        let trainer = match checkpoint {
            Some(bytes) => Trainer::from_checkpoint(&bytes, config, seed, source).map_err(
                |error| match error {
                    TrainingError::Checkpoint(problem) => {
                        RunFolderError::damaged(&path, problem).into()
                    }
                    other => other,
                },
            )?,
            None => Trainer::with_source(config, seed, source),
        };
        let before = work.read(LOG)?.unwrap_or_default();
        let is_done =
            |line: &&str| parse_episode(line).is_some_and(|episode| episode <= trainer.episode());
        // Drop an evaluation that was made only because an earlier training ended. It is repeated if this one ends at
        // the same episode.
        let is_of_the_end = |line: &&str| {
            parse_evaluation(line)
                .is_some_and(|(episode, _)| episode > 0 && !trainer.is_evaluation_episode(episode))
        };
        // Drop log entries after the checkpoint; their episodes are repeated.
        let log = match trainer.episode() {
            0 => String::new(),
            _ => {
                let before = String::from_utf8_lossy(&before);
                before
                    .split_inclusive('\n')
                    .take_while(is_done)
                    .filter(|line| !is_of_the_end(line))
                    .collect()
            }
        };
        Ok(Self {
            run_folder: work,
            config,
            trainer,
            log,
        })
    }

    /// Returns the number of completed episodes.
    #[must_use]
    pub fn episode(&self) -> u64 {
        self.trainer.episode()
    }

    /// Trains to the end. If `observer` stops the training, the folder keeps the last checkpoint.
    ///
    /// # Errors
    /// [`TrainingError`] if the training diverges, a file cannot be written, or `observer` stops the training.
    pub fn train(
        mut self,
        held_out: &EvaluationSet,
        observer: &dyn Observer<TrainingEvent>,
    ) -> Result<SeedResult, TrainingError> {
        let configuration = config_toml(self.config)?;
        let known = if self.run_folder.is_complete() {
            self.run_folder.read(CONFIGURATION)?
        } else {
            None
        };
        if known.is_some_and(|known| known == configuration.as_bytes()) {
            return read_result(&self.run_folder);
        }
        self.run_folder.write(CONFIGURATION, configuration)?;
        let mut keeper = FolderRecorder {
            run_folder: &self.run_folder,
            log: self.log,
            observer,
        };
        let trained =
            train_with_recorder::<TrainingError>(&mut self.trainer, held_out, &mut keeper);
        let log = keeper.log;
        let has_learned = self.config.imitation.is_some()
            || self.trainer.best().is_some_and(|best| best.episode > 0);
        if !has_learned && matches!(trained, Ok(()) | Err(TrainingError::Diverged { .. })) {
            // An untrained network is no result of a training.
            self.run_folder.transaction().remove(POLICY).commit()?;
        }
        trained?;
        let policy = Arc::new(self.trainer.policy()?);
        let result = SeedResult {
            seed: self.trainer.seed(),
            episodes: self.trainer.episode(),
            best_episode: self.trainer.best().map(|best| best.episode),
            evaluation: self.trainer.best().map(|best| best.evaluation),
            unseen_contacts: count_unseen_contacts(&policy, self.config.environment.estimator)?,
            policy_sha256: has_learned.then(|| policy.digest()),
        };
        // The checkpoint precedes a final evaluation that is not due otherwise.
        let mut changes = self.run_folder.transaction();
        changes
            .write(LOG, log)
            .write(RESULT, serde_json::to_string_pretty(&result)? + "\n");
        if has_learned {
            changes.write(POLICY, policy.to_bytes()?);
        }
        changes.commit()?;
        self.run_folder.finish()?;
        Ok(result)
    }
}

struct FolderRecorder<'a> {
    run_folder: &'a RunFolder,
    log: String,
    observer: &'a dyn Observer<TrainingEvent>,
}

impl TrainingRecorder<TrainingError> for FolderRecorder<'_> {
    fn record(&mut self, event: &TrainingEvent) -> Result<(), TrainingError> {
        self.log += &serde_json::to_string(event)?;
        self.log.push('\n');
        Ok(self.observer.notify(event)?)
    }

    fn checkpoint(&mut self, trainer: &Trainer) -> Result<(), TrainingError> {
        let (policy, checkpoint) = (trainer.policy()?.to_bytes()?, trainer.to_checkpoint()?);
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
) -> Result<Vec<(SeedResult, String)>, TrainingError> {
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
    let mut finished = Vec::new();
    for seed in seeds {
        let (folder, manifest) = (
            seed_folder(out, seed),
            seed_folder(out, seed).join(MANIFEST_FILE),
        );
        if !manifest.exists() {
            if [POLICY, CHECKPOINT]
                .iter()
                .any(|name| folder.join(name).exists())
            {
                return Err(RunFolderError::missing(&manifest).into());
            }
            // Another process may be about to start there.
            continue;
        }
        let work = match open_run_folder(out, config, seed, true) {
            Err(TrainingError::RunFolder(
                RunFolderError::InUse { .. } | RunFolderError::OtherBuild { .. },
            )) => continue,
            work => work?,
        };
        if work.is_complete() {
            let log = String::from_utf8_lossy(&work.read_required(LOG)?).into_owned();
            finished.push((read_result(&work)?, log));
        }
    }
    Ok(finished)
}

/// Opens the run folder of a seed.
fn open_run_folder(
    out: &Path,
    config: &TrainingConfig,
    seed: u64,
    resume: bool,
) -> Result<RunFolder, TrainingError> {
    let folder = seed_folder(out, seed);
    let configuration = training_identity(config, seed)?;
    let asked = RunFolderOptions {
        kind: "training",
        configuration: &configuration,
        configuration_file: CONFIGURATION,
        resume,
        outputs: &[CONFIGURATION, LOG, CHECKPOINT, POLICY, RESULT],
    };
    Ok(RunFolder::open(&folder, asked)?)
}

/// Returns everything that determines a training, except the number of episodes, which may grow.
pub(super) fn training_identity(
    config: &TrainingConfig,
    seed: u64,
) -> Result<String, TrainingError> {
    Ok(format!(
        "seed = {seed}\n{}",
        config_toml(&TrainingConfig {
            episodes: 0,
            ..config.clone()
        })?
    ))
}

pub(super) fn config_toml(config: &TrainingConfig) -> Result<String, TrainingError> {
    toml::to_string(config).map_err(TrainingError::ConfigEncoding)
}

fn read_result(work: &RunFolder) -> Result<SeedResult, TrainingError> {
    let bytes = work.read_required(RESULT)?;
    let found = serde_json::from_slice(&bytes);
    Ok(found.map_err(|error| RunFolderError::damaged(&work.path(RESULT), error.to_string()))?)
}
