//! Execution of one training, or of several in parallel.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;

use super::evaluation::{EvaluationSet, PolicyEvaluation};
use super::imitation::ImitationRound;
use super::trainer::{EpisodeRecord, Trainer, TrainingError};
use crumple_core::observer::Observer;

/// Event of a training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TrainingEvent {
    /// A round of imitation is over.
    Imitation(ImitationRound),
    /// An episode is over.
    Episode(EpisodeRecord),
    /// The actor was evaluated.
    Evaluation {
        /// Episodes done.
        episode: u64,
        /// True if this is the best policy so far.
        best: bool,
        /// Result of the evaluation.
        result: PolicyEvaluation,
    },
}

pub(crate) trait TrainingRecorder<E> {
    /// Receives all events, in order.
    ///
    /// # Errors
    /// A reason to stop the training.
    fn record(&mut self, event: &TrainingEvent) -> Result<(), E>;

    /// Receives the trainer for a checkpoint: between episodes, and after the last one.
    ///
    /// # Errors
    /// A reason to stop the training.
    fn checkpoint(&mut self, trainer: &Trainer) -> Result<(), E>;
}

/// Number of evaluations between checkpoints. Checkpoints cost little, and an interruption loses less than a minute.
const EVALUATIONS_PER_CHECKPOINT: u64 = 10;

impl TrainingRecorder<TrainingError> for &dyn Observer<TrainingEvent> {
    fn record(&mut self, event: &TrainingEvent) -> Result<(), TrainingError> {
        Ok(self.notify(event)?)
    }

    fn checkpoint(&mut self, _: &Trainer) -> Result<(), TrainingError> {
        Ok(())
    }
}

/// Trains until the last episode. [`SeedTraining`](super::SeedTraining) adds checkpoints.
///
/// # Errors
/// [`TrainingError`] if the training diverges, a scenario cannot be run, or `observer` stops it.
///
/// ```no_run
/// use crumple_core::observer::Quiet;
/// use crumple_learn::rl::{EvaluationSet, Trainer, TrainingConfig, train};
///
/// let config = TrainingConfig::preset("fast").unwrap();
/// let held_out = EvaluationSet::new(&config.evaluation, &config.environment);
/// let mut trainer = Trainer::new(&config, 1);
/// train(&mut trainer, &held_out, &Quiet).unwrap();
/// println!("{}", trainer.policy().unwrap().digest());
/// ```
pub fn train(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    mut observer: &dyn Observer<TrainingEvent>,
) -> Result<(), TrainingError> {
    train_with_recorder(trainer, held_out, &mut observer)
}

/// Trains until the last episode, and passes events and checkpoints to `recorder`.
///
/// # Errors
/// [`TrainingError`], or the error of the recorder.
pub(crate) fn train_with_recorder<E: From<TrainingError>>(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    recorder: &mut impl TrainingRecorder<E>,
) -> Result<(), E> {
    if trainer.episode() == 0 {
        start_training(trainer, held_out, recorder)?;
    }
    while !trainer.is_done() {
        train_episode(trainer, held_out, recorder)?;
    }
    end_training(trainer, held_out, recorder)
}

/// Imitates, and evaluates the policy before reinforcement learning, as the reference for its improvement.
pub(super) fn start_training<E: From<TrainingError>>(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    recorder: &mut impl TrainingRecorder<E>,
) -> Result<(), E> {
    trainer.imitate(|round| recorder.record(&TrainingEvent::Imitation(*round)))?;
    evaluate_and_record(trainer, held_out, recorder)
}

/// Trains one episode. Evaluates the actor and passes a checkpoint if they are due.
pub(super) fn train_episode<E: From<TrainingError>>(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    recorder: &mut impl TrainingRecorder<E>,
) -> Result<(), E> {
    let record = trainer.run_episode()?;
    recorder.record(&TrainingEvent::Episode(record))?;
    if trainer.is_evaluation_episode(trainer.episode()) {
        evaluate_and_record(trainer, held_out, recorder)?;
    }
    let every = trainer.config.evaluation.every_episodes * EVALUATIONS_PER_CHECKPOINT;
    if trainer.episode().is_multiple_of(every) && !trainer.is_done() {
        recorder.checkpoint(trainer)?;
    }
    Ok(())
}

/// Passes the last checkpoint, and makes the last evaluation.
pub(super) fn end_training<E: From<TrainingError>>(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    recorder: &mut impl TrainingRecorder<E>,
) -> Result<(), E> {
    recorder.checkpoint(trainer)?;
    // This evaluation takes place only because the training ends. It comes after the checkpoint, so that a longer
    // training can resume without it.
    if trainer.episode() > 0
        && trainer.is_evaluation_due()
        && !trainer.is_evaluation_episode(trainer.episode())
    {
        evaluate_and_record(trainer, held_out, recorder)?;
    }
    Ok(())
}

fn evaluate_and_record<E: From<TrainingError>>(
    trainer: &mut Trainer,
    held_out: &EvaluationSet,
    recorder: &mut impl TrainingRecorder<E>,
) -> Result<(), E> {
    let result = trainer.evaluate(held_out)?;
    let episode = trainer.episode();
    let best = trainer.best().is_some_and(|best| best.episode == episode);
    recorder.record(&TrainingEvent::Evaluation {
        episode,
        best,
        result,
    })
}

/// Applies `work` to each item on `threads` threads and returns the results in order.
///
/// Several items run at once, each in its own pool of some of the threads, so that none waits for another. A pool that
/// is done takes the next item.
pub fn parallel_map<I: Sync, R: Send>(
    items: &[I],
    threads: usize,
    work: impl Fn(&I) -> R + Sync,
) -> Vec<R> {
    let at_once = threads.clamp(1, items.len().max(1));
    let next = AtomicUsize::new(0);
    let results: Mutex<Vec<(usize, R)>> = Mutex::new(Vec::with_capacity(items.len()));
    let take_turns = || {
        while let Some((index, item)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            items.get(index).map(|item| (index, item))
        } {
            let result = work(item);
            results
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push((index, result));
        }
    };
    std::thread::scope(|scope| {
        let take_turns = &take_turns;
        for lane in 0..at_once {
            let share = threads.max(1) / at_once + usize::from(lane < threads % at_once);
            scope.spawn(
                move || match rayon::ThreadPoolBuilder::new().num_threads(share).build() {
                    Ok(pool) => pool.install(take_turns),
                    // Without its own pool the thread uses the global one: slower, with the same results.
                    Err(_) => take_turns(),
                },
            );
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}
