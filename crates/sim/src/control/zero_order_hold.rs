//! Zero-order hold: a user's controller decides at an interval, and its answer holds in between.

use std::sync::Arc;

use super::batch_query::{BatchQuery, decide_by_query};
use super::decision_timer::DecisionTimer;
use super::{Controller, ControllerFailure, ControllerSource};
use crate::observation::Observation;

/// Zero-order hold around an external controller; a non-finite answer is a failure.
pub(crate) struct ZeroOrderHold {
    controller: Box<dyn Controller>,
    batch_source: Option<Arc<dyn ControllerSource>>,
    decision_timer: DecisionTimer,
    observation: Option<Observation>,
    command_mps2: f64,
}

impl ZeroOrderHold {
    /// Creates a hold with decisions every `interval_s` seconds from the first step on, or at every step.
    pub(crate) fn new(
        controller: Box<dyn Controller>,
        interval_s: Option<f64>,
        step_s: f64,
    ) -> Self {
        let interval = DecisionTimer::new(interval_s, step_s);
        Self {
            controller,
            batch_source: None,
            decision_timer: interval,
            observation: None,
            command_mps2: 0.0,
        }
    }

    /// Batches queries with others of `source` if it [supports batches](ControllerSource::batch_controller).
    pub(crate) fn with_batching(mut self, source: &Arc<dyn ControllerSource>) -> Self {
        self.batch_source = source
            .batch_controller()
            .is_some()
            .then(|| Arc::clone(source));
        self
    }
}

impl BatchQuery for ZeroOrderHold {
    fn sample(&mut self, observation: &Observation) -> bool {
        self.observation = self.decision_timer.tick().then_some(*observation);
        self.observation.is_some()
    }

    fn query(&mut self) -> Result<(), ControllerFailure> {
        let Some(observation) = self.observation else {
            return Ok(());
        };
        let answer_mps2 = self.controller.decide(&observation)?;
        self.set_command(answer_mps2)
    }

    fn shares_batch_with(&self, other: &dyn BatchQuery) -> bool {
        match (&self.batch_source, other.downcast_ref::<Self>()) {
            (
                Some(own),
                Some(Self {
                    batch_source: Some(other),
                    ..
                }),
            ) => std::ptr::addr_eq(Arc::as_ptr(own), Arc::as_ptr(other)),
            _ => false,
        }
    }

    fn query_batch(&self, members: &[&dyn BatchQuery]) -> Option<Vec<f64>> {
        let batch = self.batch_source.as_ref()?.batch_controller()?;
        let observations = members
            .iter()
            .map(|member| member.downcast_ref::<Self>()?.observation)
            .collect::<Option<Vec<_>>>()?;
        let mut query_batch = vec![0.0; observations.len()];
        batch.decide_batch(&observations, &mut query_batch).ok()?;
        query_batch
            .iter()
            .all(|answer_mps2| answer_mps2.is_finite())
            .then_some(query_batch)
    }

    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure> {
        self.command_mps2 = answer_mps2;
        if answer_mps2.is_finite() {
            Ok(())
        } else {
            Err(ControllerFailure::NotFinite)
        }
    }

    fn command_mps2(&self) -> f64 {
        self.command_mps2
    }
}

impl Controller for ZeroOrderHold {
    fn perceive(&mut self, truth: &Observation) {
        self.controller.perceive(truth);
    }

    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        decide_by_query(self, observation)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.controller.record_command(command_mps2);
    }

    fn is_warning(&self) -> bool {
        self.controller.is_warning()
    }

    fn as_batch_query(&mut self) -> Option<&mut dyn BatchQuery> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::super::tests::leader_observation;
    use super::super::{BatchController, Ego};
    use super::*;
    use crate::engine::{RecordingLevel, Run, RunOptions, simulate, simulate_batch};
    use crate::scenario::PaperDistribution;

    struct CountingController(f64);
    impl Controller for CountingController {
        fn decide(&mut self, _: &Observation) -> Result<f64, ControllerFailure> {
            self.0 += 1.0;
            Ok(if self.0 > 2.5 { f64::NAN } else { self.0 })
        }
    }

    #[test]
    fn decides_once_an_interval_and_fails_at_a_nan_answer() {
        let mut hold = ZeroOrderHold::new(Box::new(CountingController(0.0)), Some(0.03), 0.01);
        let answers = [0; 7].map(|_| hold.decide(&leader_observation(20.0, 20.0, 20.0, 0.0)));
        let failed = Err(ControllerFailure::NotFinite);
        assert_eq!(
            answers,
            [Ok(1.0), Ok(1.0), Ok(1.0), Ok(2.0), Ok(2.0), Ok(2.0), failed]
        );
        let mut at_every_step = ZeroOrderHold::new(Box::new(CountingController(0.0)), None, 0.01);
        let answers =
            [0; 2].map(|_| at_every_step.decide(&leader_observation(20.0, 20.0, 20.0, 0.0)));
        assert_eq!(answers, [Ok(1.0), Ok(2.0)]);
    }

    #[derive(Clone)]
    struct MinGapController {
        min_gap_m: f64,
        max_batch_size: Arc<AtomicUsize>,
    }
    impl MinGapController {
        fn answer_mps2(&self, observation: &Observation) -> Result<f64, ControllerFailure> {
            let ahead = observation
                .ahead
                .filter(|ahead| ahead.gap_m >= self.min_gap_m);
            let ahead = ahead.ok_or(ControllerFailure::Died {
                message: "too close".to_owned(),
            })?;
            Ok(ahead.speed_mps - observation.speed_mps)
        }
    }
    impl Controller for MinGapController {
        fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
            self.answer_mps2(observation)
        }
    }
    impl BatchController for MinGapController {
        fn decide_batch(
            &self,
            observations: &[Observation],
            answers_mps2: &mut [f64],
        ) -> Result<(), ControllerFailure> {
            self.max_batch_size
                .fetch_max(observations.len(), Ordering::Relaxed);
            answers_mps2
                .iter_mut()
                .zip(observations)
                .try_for_each(|(answer_mps2, observation)| {
                    *answer_mps2 = self.answer_mps2(observation)?;
                    Ok(())
                })
        }
    }
    impl ControllerSource for MinGapController {
        fn identity(&self) -> Option<String> {
            None
        }
        fn interval_s(&self) -> Option<f64> {
            Some(0.1)
        }
        fn batch_controller(&self) -> Option<&dyn BatchController> {
            Some(self)
        }
        fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
            Ok(Box::new(self.clone()))
        }
    }

    #[test]
    fn runs_that_share_a_batch_have_the_results_of_single_runs() {
        let draws: Vec<_> = (0..60)
            .map(|index| PaperDistribution { seed: 2 }.draw(index).unwrap())
            .collect();
        let most_together = Arc::new(AtomicUsize::new(0));
        let sources = [0.0, 12.0].map(|least_gap_m| {
            Arc::new(MinGapController {
                min_gap_m: least_gap_m,
                max_batch_size: most_together.clone(),
            })
        });
        let options = |index: usize| RunOptions::new(sources[index / 5 % 2].clone());
        let runs: Vec<_> = (0..60)
            .map(|index| Run::new(&draws[index], options(index)).unwrap())
            .collect();
        let two_threads = rayon::ThreadPoolBuilder::new()
            .num_threads(2)
            .build()
            .unwrap();
        let together = two_threads
            .install(|| simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| simulated));
        for (run, together) in runs.iter().zip(&together) {
            assert_eq!(simulate(run, RecordingLevel::Summary), *together);
        }
        let failed = together
            .iter()
            .filter(|simulated| simulated.outcome.failed_controller().is_some())
            .count();
        assert!((1..=30).contains(&failed), "{failed}");
        assert!(most_together.load(Ordering::Relaxed) >= 5);
    }
}
