//! Training of a round.

use std::sync::Arc;

use super::RetrainError;
use super::cases::Cases;
use super::files::{CHECKPOINTS, LEARNER};
use super::plan::RetrainingPlan;
use super::progress::{RetrainingObserver, RetrainingProgress};
use super::round::{Checkpoint, RoundContext, RoundTraining, round_path};
use crate::rl::{
    CaseMixture, EvaluationSet, PaperSource, ScenarioSource, SourceMixture, Trainer, TrainingError,
    TrainingEvent, TrainingRecorder, train_with_recorder,
};
use crumple_sim::policy::Policy;
use crumple_store::run_folder::{RunFolderError, encode_json};

impl RoundContext<'_> {
    /// Returns the seed of the learner and its episodes so far. A new learner follows one that diverged.
    pub(super) fn learner_start(&self) -> (u64, u64) {
        match self.previous_round {
            Some(last) if last.training.to_episode > 0 => {
                (last.training.seed, last.training.to_episode)
            }
            _ => (self.plan.training_seed(self.round_number()), 0),
        }
    }

    fn scenario_source(&self, cases: &Cases) -> Result<Arc<dyn ScenarioSource>, RetrainError> {
        let RetrainingPlan {
            spaces, settings, ..
        } = self.plan;
        // Not those of the preset: an imitation has other costs.
        let training = self.plan.training_until(0);
        let cases = cases.scenarios(spaces)?;
        let with_cases = |base| CaseMixture::new(cases, settings.case_share, base);
        if !training.spaces.is_empty() {
            return Ok(Arc::new(with_cases(
                training.scenario_source().map_err(TrainingError::from)?,
            )));
        }
        let mixed = with_cases(Arc::new(spaces.clone()));
        Ok(Arc::new(SourceMixture::new(
            Arc::new(PaperSource),
            settings.nominal_share,
            Arc::new(mixed),
        )))
    }

    /// Returns the learner at the start of the round, or at its last checkpoint, and the episode at the start.
    fn load_learner(&self, cases: &Cases) -> Result<(Trainer, u64), RetrainError> {
        let (seed, from_episode) = self.learner_start();
        let episodes = from_episode + self.plan.settings.episodes;
        let config = self.plan.training_until(episodes);
        let source = self.scenario_source(cases)?;
        let taken_up = |name: &str, bytes: &[u8], source| {
            Trainer::from_checkpoint(bytes, &config, seed, source).map_err(|error| {
                RunFolderError::damaged(&self.run_folder.path(name), error.to_string())
            })
        };
        let name = self.path(LEARNER);
        if let Some(bytes) = self.run_folder.read(&name)? {
            return Ok((taken_up(&name, &bytes, source)?, from_episode));
        }
        let Some(last) = self.previous_round.filter(|_| from_episode > 0) else {
            return Ok((
                Trainer::with_source(&config, seed, source).with_initial_policy(self.policy),
                from_episode,
            ));
        };
        let name = round_path(last.round, LEARNER);
        let mut trainer = taken_up(
            &name,
            &self.run_folder.read_required(&name)?,
            self.scenario_source(self.cases)?,
        )?;
        if trainer.episode() != from_episode {
            let problem = format!(
                "is from episode {}, and its round ended with {from_episode}",
                trainer.episode()
            );
            return Err(RunFolderError::damaged(&self.run_folder.path(&name), problem).into());
        }
        trainer.switch_source(source, episodes);
        Ok((trainer, from_episode))
    }

    pub(super) fn train(
        &self,
        cases: &Cases,
        watch: &RetrainingObserver<'_>,
    ) -> Result<(RoundTraining, Policy), RetrainError> {
        let (mut trainer, from_episode) = self.load_learner(cases)?;
        let selection = self.selection_set.scenarios(&self.plan.spaces)?;
        let held_out = EvaluationSet::from_config(&self.plan.training)?.with_ranking(selection);
        let mut checkpoints: Vec<Checkpoint> = self
            .run_folder
            .read_json(&self.path(CHECKPOINTS))?
            .unwrap_or_default();
        checkpoints.retain(|checkpoint| {
            checkpoint.episode <= trainer.episode() && trainer.episode() > from_episode
        });
        let mut scribe = CheckpointWriter {
            context: self,
            from_episode,
            checkpoints,
            observer: watch,
        };
        train_with_recorder::<RetrainError>(&mut trainer, &held_out, &mut scribe)?;
        let trained = RoundTraining {
            seed: trainer.seed(),
            from_episode,
            to_episode: trainer.episode(),
            best_episode: trainer.best().map_or(0, |best| best.episode),
            checkpoints: scribe.checkpoints,
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
                    contacts: result.ranking_contacts,
                });
            }
            TrainingEvent::Episode(record) => {
                self.observer.notify(&RetrainingProgress::Training {
                    round: self.context.round_number(),
                    episode: record.episode - self.from_episode,
                    episodes: self.context.plan.settings.episodes,
                    fewest_contacts: self
                        .checkpoints
                        .iter()
                        .filter_map(|checkpoint| checkpoint.contacts)
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
