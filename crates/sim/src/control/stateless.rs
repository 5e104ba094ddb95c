//! Controllers without memory.

use std::sync::Arc;

use super::{Controller, ControllerFailure, ControllerSource, Ego};
use crate::observation::Observation;

/// A controller without memory: a function from an observation to an acceleration in m/s².
#[derive(Debug, Clone, Copy)]
pub struct StatelessController<F>(F);

/// Makes a function a controller. A controller with memory implements [`ControllerSource`].
///
/// ```
/// use crumple_sim::control::stateless;
/// use crumple_sim::scenario::built_in_scenario;
/// use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
///
/// let brake = stateless(|observation| match observation.ahead {
///     Some(ahead) if ahead.gap_m < 30.0 => -7.5,
///     _ => 0.0,
/// });
/// let run = Run::new(&built_in_scenario("paper-1").unwrap(), RunOptions::new(brake)).unwrap();
/// assert!(simulate(&run, RecordingLevel::Summary).outcome.failed_controller().is_none());
/// ```
pub fn stateless<F>(decide: F) -> Arc<StatelessController<F>>
where
    F: Fn(&Observation) -> f64 + Clone + Send + Sync + 'static,
{
    Arc::new(StatelessController(decide))
}

impl<F: Fn(&Observation) -> f64 + Clone + Send + Sync + 'static> ControllerSource
    for StatelessController<F>
{
    fn identity(&self) -> Option<String> {
        None
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(Self(self.0.clone())))
    }
}

impl<F: Fn(&Observation) -> f64 + Send> Controller for StatelessController<F> {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        Ok(self.0(observation))
    }
}
