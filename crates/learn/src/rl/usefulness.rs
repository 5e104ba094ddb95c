//! Usefulness of a policy: everyday traffic without noise, compared with `idm`.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

use crumple_measure::{SpeedAmplification, UsefulnessMeasures};
use crumple_sim::control::{BuiltInController, ControllerSource, IntoSource};
use crumple_sim::engine::{
    RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{SPEED_DIP_ONSET_S, Scenario, speed_dip};
use crumple_spaces::built_in_space;

use super::source::EGO;

/// Largest RMS of acceleration and jerk without a penalty, relative to `idm`.
pub(crate) const MAX_RATIO_TO_IDM: f64 = 1.2;
/// Range of mean time gaps without a penalty, in seconds.
pub(crate) const TIME_GAP_RANGE_S: [f64; 2] = [1.2, 2.1];
/// Weight of an excess of comfort or time gap, relative to the share of faulty drives: a tenth more jerk than allowed
/// weighs as much as 5 % more collisions.
pub(crate) const EXCESS_WEIGHT: f64 = 0.5;

/// Vehicles under test in the line, and their initial time gap in seconds.
const LINE: (usize, f64) = (5, 1.5);

/// Result of a controller in random scenarios of everyday traffic.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrafficUsefulness {
    /// Number of random scenarios.
    #[serde(alias = "drives")]
    pub scenario_count: u64,
    /// Scenarios that ended in a collision.
    pub contacts: u64,
    /// Scenarios with braking above 4 m/s² whose cause required less than 3 m/s².
    #[serde(alias = "hard")]
    pub hard_braking: u64,
    /// Scenarios in which the ego vehicle ended at less than half the leader's speed.
    #[serde(alias = "left_behind")]
    pub fell_behind: u64,
    /// RMS of acceleration over all scenarios, relative to that of `idm`.
    pub acceleration_times_idm: f64,
    /// RMS of jerk, likewise.
    pub jerk_times_idm: f64,
    /// Mean time gap, in seconds; 0 if the ego vehicle never moved.
    pub mean_time_gap_s: f64,
    /// Gain of a line of five such vehicles behind a leader that slows down ([`SpeedAmplification::overall`]); none if
    /// they collide or do not settle before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line_gain: Option<f64>,
}

impl TrafficUsefulness {
    /// Returns the share of faulty drives, plus a penalty for discomfort and for an unusual time gap. 0 is best.
    pub(crate) fn penalty(&self) -> f64 {
        let [closest_s, furthest_s] = TIME_GAP_RANGE_S;
        let off_s = (closest_s - self.mean_time_gap_s)
            .max(self.mean_time_gap_s - furthest_s)
            .max(0.0);
        let [acceleration_excess, jerk_excess] = [self.acceleration_times_idm, self.jerk_times_idm]
            .map(|times_idm| (times_idm / MAX_RATIO_TO_IDM - 1.0).max(0.0));
        let excess = acceleration_excess + jerk_excess + off_s;
        (self.contacts + self.hard_braking + self.fell_behind) as f64
            / self.scenario_count.max(1) as f64
            + EXCESS_WEIGHT * excess
    }
}

/// Random scenarios of everyday traffic, the result of `idm` in them, and a line of vehicles.
#[derive(Debug, Clone)]
pub(crate) struct TrafficBenchmark {
    draws: Vec<Scenario>,
    line: Option<Scenario>,
    estimator: EstimatorKind,
    idm_rms: [f64; 2],
}

/// Counts and sums over the drives of everyday traffic.
#[derive(Default)]
struct TrafficTally {
    contacts: u64,
    hard_braking: u64,
    fell_behind: u64,
    /// Drives with a mean time gap.
    moving_drives: u64,
    /// Of the root mean squares of acceleration and jerk.
    sum_squares: [f64; 2],
    time_gap_sum_s: f64,
}

impl TrafficTally {
    /// Simulates runs and adds up their measures.
    fn from_runs(runs: &[Run]) -> Self {
        let drives = simulate_batch(runs, RecordingLevel::Trace, |_, result| {
            (
                result.outcome.contact().is_some(),
                measure_usefulness(&result),
            )
        });
        let mut tally = Self::default();
        for (collided, measures) in drives {
            tally.contacts += u64::from(collided);
            if let Some(measures) = measures {
                tally.add(&measures);
            }
        }
        tally
    }

    fn add(&mut self, measures: &UsefulnessMeasures) {
        self.hard_braking += u64::from(!measures.hard.is_empty());
        self.sum_squares[0] += measures.rms_acceleration_mps2.unwrap_or(0.0).powi(2);
        self.sum_squares[1] += measures.rms_jerk_mps3.unwrap_or(0.0).powi(2);
        if let Some(following) = &measures.following {
            self.fell_behind += u64::from(following.fell_behind);
            if let Some(time_gap_s) = following.mean_time_gap_s {
                self.time_gap_sum_s += time_gap_s;
                self.moving_drives += 1;
            }
        }
    }
}

impl TrafficBenchmark {
    /// Samples the first scenarios of the built-in space `traffic`.
    pub(crate) fn new(seed: u64, draws: u64, estimator: EstimatorKind) -> Result<Self, RunError> {
        let space = built_in_space("traffic");
        let draws = space
            .iter()
            .flat_map(|space| (0..draws).filter_map(|index| space.draw(seed, index).ok()))
            .collect();
        let mut traffic = Self {
            draws,
            line: speed_dip(LINE.0, LINE.1).ok(),
            estimator,
            idm_rms: [1.0; 2],
        };
        let idm = traffic.evaluate(&BuiltInController::Idm(Default::default()).into_source())?;
        traffic.idm_rms = [idm.acceleration_times_idm, idm.jerk_times_idm];
        Ok(traffic)
    }

    pub(crate) fn evaluate(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<TrafficUsefulness, RunError> {
        let options = RunOptions::new(controller.clone()).with_estimator(self.estimator);
        let runs = self
            .draws
            .iter()
            .map(|scenario| Run::new(scenario, options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        let tally = TrafficTally::from_runs(&runs);
        let [acceleration, jerk] = tally
            .sum_squares
            .map(|sum: f64| (sum / runs.len().max(1) as f64).sqrt());
        let [idm_acceleration, idm_jerk] = self.idm_rms;
        Ok(TrafficUsefulness {
            scenario_count: runs.len() as u64,
            contacts: tally.contacts,
            hard_braking: tally.hard_braking,
            fell_behind: tally.fell_behind,
            acceleration_times_idm: acceleration / idm_acceleration.max(f64::MIN_POSITIVE),
            jerk_times_idm: jerk / idm_jerk.max(f64::MIN_POSITIVE),
            mean_time_gap_s: tally.time_gap_sum_s / tally.moving_drives.max(1) as f64,
            line_gain: self
                .line
                .as_ref()
                .and_then(|line| line_gain(line, options).transpose())
                .transpose()?,
        })
    }
}

fn line_gain(line: &Scenario, options: RunOptions) -> Result<Option<f64>, RunError> {
    let result = simulate(&Run::new(line, options)?, RecordingLevel::Trace);
    let trace = result.trace.as_ref().filter(|_| result.outcome.is_safe());
    Ok(trace
        .and_then(|trace| SpeedAmplification::from_trace(trace, SPEED_DIP_ONSET_S))
        .map(|amplification| amplification.overall))
}

/// Measures the usefulness of a run; none without its trace.
pub(crate) fn measure_usefulness(result: &SimulationResult) -> Option<UsefulnessMeasures> {
    UsefulnessMeasures::from_trace(result.trace.as_ref()?, &result.impacts, EGO)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::policy::Policy;

    #[test]
    fn idm_is_useful_and_the_reference_policy_is_not() {
        let traffic = TrafficBenchmark::new(3, 40, EstimatorKind::Kalman).unwrap();
        let idm = traffic
            .evaluate(&BuiltInController::Idm(Default::default()).into_source())
            .unwrap();
        assert_eq!((idm.contacts, idm.hard_braking, idm.fell_behind), (0, 0, 0));
        assert_eq!((idm.acceleration_times_idm, idm.jerk_times_idm), (1.0, 1.0));
        assert!(idm.penalty() < 0.02, "{idm:?}");
        let policy = traffic
            .evaluate(&Policy::reference().into_source())
            .unwrap();
        assert!(
            policy.penalty() > 0.3 && policy.fell_behind > 0,
            "{policy:?}"
        );
    }
}
