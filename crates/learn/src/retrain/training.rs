//! Training of a round.

use std::sync::Arc;

use super::RetrainError;
use super::cases::Cases;
use super::files::{CHECKPOINTS, LEARNER};
use super::plan::RetrainingPlan;
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::round::{Checkpoint, RoundContext, RoundTraining, round_path};
use crate::rl::{
    CaseMixture, EvaluationSet, PaperSource, ScenarioSource, SourceMixture, Trainer,
    TrainingConfig, TrainingError, TrainingEvent, TrainingRecorder, train_with_recorder,
};
use crumple_sim::policy::Policy;
use crumple_store::run_folder::{RunFolderError, encode_json};

/// State of the learner at the start of a round.
pub(super) struct LearnerStart {
    pub(super) seed: u64,
    /// Episodes so far.
    pub(super) episode: u64,
}

impl RoundContext<'_> {
    /// Returns the start of the learner of the round. A new learner follows one that diverged.
    pub(super) fn learner_start(&self) -> LearnerStart {
        match self.previous_round {
            Some(last) if last.training.to_episode > 0 => LearnerStart {
                seed: last.training.seed,
                episode: last.training.to_episode,
            },
            _ => LearnerStart {
                seed: self.plan.training_seed(self.round_number()),
                episode: 0,
            },
        }
    }

    fn scenario_source(&self, cases: &Cases) -> Result<Arc<dyn ScenarioSource>, RetrainError> {
        let RetrainingPlan {
            spaces, settings, ..
        } = self.plan;
        // Not those of the preset: an imitation has other costs.
        let training = self.plan.training_until(0);
        let cases = cases.scenarios(spaces)?;
        if !training.spaces.is_empty() {
            let base = training.scenario_source().map_err(TrainingError::from)?;
            return Ok(Arc::new(CaseMixture::new(cases, settings.case_share, base)));
        }
        let mixed = CaseMixture::new(cases, settings.case_share, Arc::new(spaces.clone()));
        Ok(Arc::new(SourceMixture::new(
            Arc::new(PaperSource),
            settings.nominal_share,
            Arc::new(mixed),
        )))
    }

    /// Reads a learner from a checkpoint in the run folder.
    fn read_learner(
        &self,
        name: &str,
        bytes: &[u8],
        config: &TrainingConfig,
        source: Arc<dyn ScenarioSource>,
    ) -> Result<Trainer, RunFolderError> {
        Trainer::from_checkpoint(bytes, config, self.learner_start().seed, source).map_err(
            |error| RunFolderError::damaged(&self.run_folder.path(name), error.to_string()),
        )
    }

    /// Returns the learner at the start of the round, or at its last checkpoint.
    fn load_learner(&self, cases: &Cases) -> Result<Trainer, RetrainError> {
        let LearnerStart {
            seed,
            episode: from_episode,
        } = self.learner_start();
        let episodes = from_episode + self.plan.settings.episodes;
        let config = self.plan.training_until(episodes);
        let source = self.scenario_source(cases)?;
        let name = self.path(LEARNER);
        if let Some(bytes) = self.run_folder.read(&name)? {
            return Ok(self.read_learner(&name, &bytes, &config, source)?);
        }
        let Some(last) = self.previous_round.filter(|_| from_episode > 0) else {
            return Ok(Trainer::with_source(&config, seed, source).with_initial_policy(self.policy));
        };
        let name = round_path(last.round, LEARNER);
        let bytes = self.run_folder.read_required(&name)?;
        let last_source = self.scenario_source(self.cases)?;
        let mut trainer = self.read_learner(&name, &bytes, &config, last_source)?;
        if trainer.episode() != from_episode {
            let problem = format!(
                "is from episode {}, and its round ended with {from_episode}",
                trainer.episode()
            );
            return Err(RunFolderError::damaged(&self.run_folder.path(&name), problem).into());
        }
        trainer.switch_source(source, episodes);
        Ok(trainer)
    }

    pub(super) fn train(
        &self,
        cases: &Cases,
        watch: &RetrainingObserver<'_>,
    ) -> Result<(RoundTraining, Policy), RetrainError> {
        let mut trainer = self.load_learner(cases)?;
        let from_episode = self.learner_start().episode;
        let selection = self.selection_set.scenarios(&self.plan.spaces)?;
        let held_out = EvaluationSet::from_config(&self.plan.training)?.with_ranking(selection);
        let mut checkpoints: Vec<Checkpoint> = self
            .run_folder
            .read_json(&self.path(CHECKPOINTS))?
            .unwrap_or_default();
        checkpoints.retain(|checkpoint| {
            checkpoint.episode <= trainer.episode() && trainer.episode() > from_episode
        });
        let mut recorder = CheckpointWriter {
            context: self,
            from_episode,
            checkpoints,
            observer: watch,
        };
        train_with_recorder::<RetrainError>(&mut trainer, &held_out, &mut recorder)?;
        let trained = RoundTraining {
            seed: trainer.seed(),
            from_episode,
            to_episode: trainer.episode(),
            best_episode: trainer.best().map_or(0, |best| best.episode),
            checkpoints: recorder.checkpoints,
        };
        Ok((trained, trainer.policy()?))
    }
}

struct CheckpointWriter<'a, 'b, 'c> {
    context: &'a RoundContext<'b>,
    from_episode: u64,
    checkpoints: Vec<Checkpoint>,
    observer: &'a RetrainingObserver<'c>,
}

impl TrainingRecorder<RetrainError> for CheckpointWriter<'_, '_, '_> {
    fn record(&mut self, event: &TrainingEvent) -> Result<(), RetrainError> {
        match event {
            TrainingEvent::Evaluation {
                episode, result, ..
            } => {
                self.checkpoints.push(Checkpoint {
                    episode: *episode,
                    collisions: result.ranking_collisions,
                });
            }
            TrainingEvent::Episode(record) => {
                self.observer.notify(&RetrainingProgress::Training {
                    round: self.context.round_number(),
                    episode: record.episode - self.from_episode,
                    episodes: self.context.plan.settings.episodes,
                    fewest_collisions: self
                        .checkpoints
                        .iter()
                        .filter_map(|checkpoint| checkpoint.collisions)
                        .min(),
                })?
            }
            TrainingEvent::Imitation(imitation) => {
                let round = self.context.round_number();
                self.observer.notify(&RetrainingProgress::Imitating {
                    round,
                    imitation: *imitation,
                })?;
            }
        }
        Ok(())
    }

    fn checkpoint(&mut self, trainer: &Trainer) -> Result<(), RetrainError> {
        // An imitation is no part of a checkpoint: resumed without episodes, the learner would imitate twice.
        if trainer.episode() == 0 {
            return Ok(());
        }
        // Written together; list entries after the checkpoint are dropped on resume.
        let mut changes = self.context.run_folder.transaction();
        changes
            .write(
                &self.context.path(CHECKPOINTS),
                encode_json(CHECKPOINTS, &self.checkpoints)?,
            )
            .write(&self.context.path(LEARNER), trainer.to_checkpoint()?);
        Ok(changes.commit()?)
    }
}
