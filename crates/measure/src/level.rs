//! Level of a run: the hardest braking of the leader for which both sides stay safe.

use serde::Serialize;

use crumple_sim::control::{
    ErrorBounds, FollowerClass, LevelMeter, RearErrorBounds, ShieldRefusal, TwoSidedSettings,
};
use crumple_sim::engine::{Impact, Run, SimulationResult, Trace};
use crumple_sim::observation::{Neighbour, Observation};

/// Time between two levels, in seconds; between decisions if these are farther apart.
const LEVEL_INTERVAL_S: f64 = 0.1;

/// The followers of the default class, for which a level holds, in words.
pub const DEFAULT_CLASS_WORDS: &str = "followers whose emergency brake fires at a time to collision below 1.4 s and \
    brakes to standstill, and whose acceleration before is within 0.3 m/s²";

/// Levels of a vehicle in a run, up to its first collision.
///
/// A plan avoids a collision on both sides as long as the leader brakes at most at the level and the follower is of the
/// class ([`TwoSidedSettings`]). The level is at most 12 m/s², and 0 if there is no such plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelMeasures {
    /// Index of the vehicle, from the front.
    pub vehicle: usize,
    /// The followers for which the levels hold, in words after "a follower that"; `None` without a follower.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub followers: Option<String>,
    /// The driver of the follower, unless it is known to be of the class.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub driver_outside_class: Option<&'static str>,
    /// Level at the start, in m/s².
    pub start_mps2: f64,
    /// Minimum level, in m/s².
    pub min_mps2: f64,
    /// Time of the minimum, in seconds.
    pub min_at_s: f64,
    /// Times of the levels, in seconds.
    pub time_s: Vec<f64>,
    /// Levels, in m/s².
    pub level_mps2: Vec<f64>,
}

/// Reason why a vehicle has no level.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoLevel {
    /// A shield gives no guarantee for the vehicle.
    #[error(transparent)]
    Refused(#[from] ShieldRefusal),
    /// The trace has accelerations, and not the commands that a plan must continue.
    #[error("its actuator has a delay or a lag, so its commands cannot be seen in its motion")]
    HiddenCommands,
    /// The run ended before its first step.
    #[error("the run has no step without a collision")]
    NoSteps,
}

impl LevelMeasures {
    /// Computes the levels of all vehicles under test of a run, with their indices; none without a trace.
    #[must_use]
    pub fn of_vehicles_under_test(
        run: &Run,
        result: &SimulationResult,
        settings: &TwoSidedSettings,
    ) -> Vec<(usize, Result<Self, NoLevel>)> {
        let Some(trace) = &result.trace else {
            return Vec::new();
        };
        (0..trace.vehicles.len())
            .filter(|&vehicle| run.scenario().is_under_test(vehicle))
            .map(|vehicle| {
                let level = Self::from_trace(run, trace, &result.impacts, vehicle, settings);
                (vehicle, level)
            })
            .collect()
    }

    /// Computes the levels of vehicle `vehicle` at the true state.
    ///
    /// # Errors
    /// [`NoLevel`] if a shield gives no guarantee for the vehicle, or its commands cannot be seen.
    fn from_trace(
        run: &Run,
        trace: &Trace,
        impacts: &[Impact],
        vehicle: usize,
        settings: &TwoSidedSettings,
    ) -> Result<Self, NoLevel> {
        let at_true_state = TwoSidedSettings {
            errors: Some((ErrorBounds::default(), RearErrorBounds::default())),
            ..*settings
        };
        let params = run.two_sided_shield(vehicle, &at_true_state)?;
        if params.delay_steps > 0 || params.response_fraction < 1.0 {
            return Err(NoLevel::HiddenCommands);
        }
        let end_s = impacts
            .iter()
            .find(|impact| impact.involves(vehicle))
            .map_or(f64::INFINITY, |impact| impact.collision.time_s);
        let interval = ((LEVEL_INTERVAL_S / params.step_s).round() as usize).max(1);
        let mut meter = LevelMeter::new(params);
        let mut levels = Vec::new();
        for (step, sample) in (0..trace.time_s.len()).step_by(run.substeps()).enumerate() {
            let seen = observed_step(trace, vehicle, sample).filter(|step| step.time_s < end_s);
            let Some(seen) = seen else {
                break;
            };
            meter.observe(&seen.observation);
            if step % interval == 0 {
                levels.push((seen.time_s, meter.level_mps2()));
            }
            meter.record_command(seen.acceleration_mps2);
        }
        Self::from_levels(vehicle, &levels).ok_or(NoLevel::NoSteps)
    }

    fn from_levels(vehicle: usize, levels: &[(f64, f64)]) -> Option<Self> {
        let &(_, start_mps2) = levels.first()?;
        let &(min_at_s, min_mps2) = levels
            .iter()
            .min_by(|(_, level), (_, other)| level.total_cmp(other))?;
        Some(Self {
            vehicle,
            followers: None,
            driver_outside_class: None,
            start_mps2,
            min_mps2,
            min_at_s,
            time_s: levels.iter().map(|(time_s, _)| *time_s).collect(),
            level_mps2: levels.iter().map(|(_, level)| *level).collect(),
        })
    }

    /// States the class of followers.
    pub(crate) fn with_class(
        mut self,
        run: &Run,
        settings: &TwoSidedSettings,
        describe_followers: fn(&FollowerClass) -> String,
    ) -> Self {
        let params = run.two_sided_shield(self.vehicle, settings);
        if let Some(class) = params.ok().and_then(|params| params.follower) {
            self.followers = Some(describe_followers(&class));
            self.driver_outside_class = run.driver_outside_class(self.vehicle, &class);
        }
        self
    }

    /// Returns a sentence for a report.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "vehicle {}: level {:.2} m/s² on this road at the start, smallest {:.2} m/s² (at {:.1} s)",
            self.vehicle, self.start_mps2, self.min_mps2, self.min_at_s
        )
    }

    /// Returns sentences about the followers, for a report.
    #[must_use]
    pub fn describe_followers(&self) -> Vec<String> {
        let vehicle = self.vehicle;
        let class = self.followers.as_ref().map(|followers| {
            format!("vehicle {vehicle}: the level holds only for a follower that {followers}")
        });
        let driver = self.driver_outside_class;
        let note = driver.map(|driver| describe_outside_class(vehicle + 1, driver));
        class.into_iter().chain(note).collect()
    }
}

/// Returns the note that the driver of a follower is not known to be of a class.
#[must_use]
pub fn describe_outside_class(follower: usize, driver: &str) -> String {
    format!(
        "note: vehicle {follower} (`{driver}`) is not known to be such a follower, so the level does not cover it"
    )
}

/// A step of a vehicle: the true state at its begin, and its acceleration.
struct ObservedStep {
    time_s: f64,
    observation: Observation,
    acceleration_mps2: f64,
}

fn observed_step(trace: &Trace, vehicle: usize, sample: usize) -> Option<ObservedStep> {
    let own = trace.vehicles.get(vehicle)?.motion(sample)?;
    Some(ObservedStep {
        time_s: *trace.time_s.get(sample)?,
        observation: true_observation(trace, vehicle, sample)?,
        acceleration_mps2: own.acceleration_mps2,
    })
}

/// Returns the true state that a vehicle would observe at a sample. Accelerations are those of the step before.
fn true_observation(trace: &Trace, vehicle: usize, sample: usize) -> Option<Observation> {
    let acceleration_mps2 = |index: usize| match sample.checked_sub(1) {
        Some(before) => trace
            .vehicles
            .get(index)?
            .acceleration_mps2
            .get(before)
            .copied(),
        None => Some(0.0),
    };
    let neighbour = |index: usize, [front, rear]: [usize; 2]| {
        let ahead = trace.vehicles.get(front)?;
        let behind = trace.vehicles.get(rear)?;
        Some(Neighbour {
            gap_m: ahead.position_m.get(sample)?
                - ahead.length_m
                - behind.position_m.get(sample)?,
            speed_mps: *trace.vehicles.get(index)?.speed_mps.get(sample)?,
            acceleration_mps2: acceleration_mps2(index)?,
        })
    };
    Some(Observation {
        speed_mps: *trace.vehicles.get(vehicle)?.speed_mps.get(sample)?,
        acceleration_mps2: acceleration_mps2(vehicle)?,
        ahead: vehicle
            .checked_sub(1)
            .and_then(|front| neighbour(front, [front, vehicle])),
        behind: neighbour(vehicle + 1, [vehicle, vehicle + 1]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, RunOptions, simulate};
    use crumple_sim::observation::EstimatorKind;
    use crumple_sim::scenario::built_in_scenario;

    /// The leader of `paper-1` brakes at 3 m/s². Braking as hard as it, and later, costs level.
    #[test]
    fn the_level_falls_towards_a_collision_and_is_high_far_from_one() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let levels = |controller: &str| {
            let controller = BuiltInController::from_name(controller).unwrap();
            let options = RunOptions::new(controller).with_estimator(EstimatorKind::Truth);
            let run = Run::new(&scenario, options).unwrap();
            let result = simulate(&run, RecordingLevel::Trace);
            let trace = result.trace.as_ref().unwrap();
            LevelMeasures::from_trace(
                &run,
                trace,
                &result.impacts,
                1,
                &TwoSidedSettings::default(),
            )
            .unwrap()
        };
        let predictive = levels("predictive");
        assert!(predictive.start_mps2 > 3.0, "{}", predictive.describe());
        assert!(predictive.min_mps2 > 0.0, "{}", predictive.describe());
        let full_throttle = levels("full-throttle");
        assert_eq!(full_throttle.start_mps2, predictive.start_mps2);
        assert_eq!(full_throttle.min_mps2, 0.0);
        assert!(
            full_throttle.time_s.len() < predictive.time_s.len(),
            "it ends at the collision"
        );
    }
}
