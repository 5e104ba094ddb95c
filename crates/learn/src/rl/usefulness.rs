//! Usefulness of a policy: the spaces `traffic` and `everyday` and recorded drives, without exploration noise, compared
//! with `idm`.

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

use super::recorded_drives::{RecordedBenchmark, RecordedUsefulness};
use super::source::EGO;
use crumple_evidence::drives::DriveSet;

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
    #[serde(alias = "contacts")]
    pub collisions: u64,
    /// Scenarios with braking above 4 m/s² where less than 3 m/s² was justified.
    #[serde(alias = "hard")]
    pub hard_braking: u64,
    /// Scenarios in which the ego vehicle fell behind its leader, at less than half its speed or far behind it.
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
    /// Result in as many scenarios of the space `everyday`; none in files of 0.3.0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub everyday: Option<EverydayUsefulness>,
    /// Result in recorded drives; none without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<RecordedUsefulness>,
}

/// Result of a controller in random scenarios of the space `everyday`, which has followers of every kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EverydayUsefulness {
    /// Scenarios in which this controller has a fault, and `idm` has none: a collision, unnecessary braking, braking
    /// above 4 m/s² whose cause required less than 3 m/s², or falling behind.
    pub faults: u64,
    /// RMS of jerk over all scenarios, relative to that of `idm`.
    pub jerk_times_idm: f64,
}

/// The result of `idm`.
impl Default for EverydayUsefulness {
    fn default() -> Self {
        Self {
            faults: 0,
            jerk_times_idm: 1.0,
        }
    }
}

impl TrafficUsefulness {
    /// Returns the share of faulty drives, plus a penalty for discomfort and for an unusual time gap. 0 is best.
    pub(crate) fn penalty(&self) -> f64 {
        let [closest_s, furthest_s] = TIME_GAP_RANGE_S;
        let off_s = (closest_s - self.mean_time_gap_s)
            .max(self.mean_time_gap_s - furthest_s)
            .max(0.0);
        let everyday = self.everyday.unwrap_or_default();
        let recorded = self.recorded.unwrap_or_default();
        let excess: f64 = [
            self.acceleration_times_idm,
            self.jerk_times_idm,
            everyday.jerk_times_idm,
            recorded.jerk_times_idm,
        ]
        .into_iter()
        .map(|times_idm| (times_idm / MAX_RATIO_TO_IDM - 1.0).max(0.0))
        .sum();
        let faults = self.collisions + self.hard_braking + self.fell_behind + everyday.faults;
        let recorded_faults = recorded.faults as f64 / recorded.drive_count.max(1) as f64;
        faults as f64 / self.scenario_count.max(1) as f64
            + EXCESS_WEIGHT * (excess + off_s)
            + recorded_faults
    }
}

/// Random scenarios of everyday driving, the results of `idm` in them, and a line of vehicles.
#[derive(Debug, Clone)]
pub(crate) struct TrafficBenchmark {
    draws: Vec<Scenario>,
    everyday: Vec<Scenario>,
    line: Option<Scenario>,
    estimator: EstimatorKind,
    idm_rms: [f64; 2],
    /// Drives of `idm` in the scenarios of `everyday`.
    idm_everyday: Vec<ComparedOutcome>,
    recorded: Option<RecordedBenchmark>,
}

/// Result of a drive that is compared with that of `idm`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ComparedOutcome {
    is_faulty: bool,
    rms_jerk_mps3: f64,
}

impl ComparedOutcome {
    pub(crate) fn new(has_failed: bool, measures: Option<UsefulnessMeasures>) -> Self {
        let is_faulty = has_failed
            || measures.is_some_and(|measures| {
                let following = measures.following;
                !measures.unnecessary.is_empty()
                    || !measures.hard.is_empty()
                    || following.is_some_and(|following| following.fell_behind)
            });
        let rms_jerk_mps3 = measures.and_then(|measures| measures.rms_jerk_mps3);
        Self {
            is_faulty,
            rms_jerk_mps3: rms_jerk_mps3.unwrap_or(0.0),
        }
    }
}

/// Returns the number of drives with a fault in which `idm` has none, and the RMS of jerk relative to that of `idm`.
pub(crate) fn compare_with_idm(own: &[ComparedOutcome], idm: &[ComparedOutcome]) -> (u64, f64) {
    let only_here = own
        .iter()
        .zip(idm)
        .filter(|(own, idm)| own.is_faulty && !idm.is_faulty);
    let [jerk, idm_jerk] = [own, idm].map(|outcomes| {
        let squares = outcomes.iter().map(|outcome| outcome.rms_jerk_mps3.powi(2));
        squares.sum::<f64>().sqrt()
    });
    (
        only_here.count() as u64,
        jerk / idm_jerk.max(f64::MIN_POSITIVE),
    )
}

/// Returns the first random scenarios of a built-in space.
fn draw_all(space: &str, seed: u64, count: u64) -> Vec<Scenario> {
    let space = built_in_space(space);
    let draws = space
        .iter()
        .flat_map(|space| (0..count).filter_map(move |index| space.draw(seed, index).ok()));
    draws.collect()
}

/// Counts and sums over the drives of everyday traffic.
#[derive(Default)]
struct TrafficTally {
    drives: u64,
    collisions: u64,
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
                result.outcome.collision().is_some(),
                measure_usefulness(&result),
            )
        });
        let mut tally = Self {
            drives: runs.len() as u64,
            ..Self::default()
        };
        for (collided, measures) in drives {
            tally.collisions += u64::from(collided);
            if let Some(measures) = measures {
                tally.add(&measures);
            }
        }
        tally
    }

    /// Returns the root mean squares of acceleration and jerk over all drives.
    fn rms(&self) -> [f64; 2] {
        self.sum_squares
            .map(|sum| (sum / self.drives.max(1) as f64).sqrt())
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
    /// Samples the first scenarios of the built-in spaces `traffic` and `everyday`.
    pub(crate) fn new(seed: u64, draws: u64, estimator: EstimatorKind) -> Result<Self, RunError> {
        let mut traffic = Self {
            draws: draw_all("traffic", seed, draws),
            everyday: draw_all("everyday", seed, draws),
            line: speed_dip(LINE.0, LINE.1).ok(),
            estimator,
            idm_rms: [1.0; 2],
            idm_everyday: Vec::new(),
            recorded: None,
        };
        let idm = BuiltInController::Idm(Default::default()).into_source();
        traffic.idm_rms = traffic.drive_traffic(&idm)?.rms();
        traffic.idm_everyday = traffic.drive_everyday(&idm)?;
        Ok(traffic)
    }

    /// Adds recorded drives, if there are any.
    pub(crate) fn with_drives(self, drives: Option<Arc<DriveSet>>) -> Result<Self, RunError> {
        let recorded = drives.map(|drives| RecordedBenchmark::new(drives, self.estimator));
        Ok(Self {
            recorded: recorded.transpose()?,
            ..self
        })
    }

    pub(crate) fn evaluate(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<TrafficUsefulness, RunError> {
        let tally = self.drive_traffic(controller)?;
        let [acceleration, jerk] = tally.rms();
        let [idm_acceleration, idm_jerk] = self.idm_rms;
        let line_gain = match &self.line {
            Some(line) => line_gain(line, self.options(controller))?,
            None => None,
        };
        let recorded = self.recorded.as_ref();
        let recorded = recorded.map(|recorded| recorded.evaluate(&self.options(controller)));
        Ok(TrafficUsefulness {
            scenario_count: tally.drives,
            collisions: tally.collisions,
            hard_braking: tally.hard_braking,
            fell_behind: tally.fell_behind,
            acceleration_times_idm: acceleration / idm_acceleration.max(f64::MIN_POSITIVE),
            jerk_times_idm: jerk / idm_jerk.max(f64::MIN_POSITIVE),
            mean_time_gap_s: tally.time_gap_sum_s / tally.moving_drives.max(1) as f64,
            line_gain,
            everyday: Some(self.evaluate_everyday(controller)?),
            recorded: recorded.transpose()?,
        })
    }

    fn options(&self, controller: &Arc<dyn ControllerSource>) -> RunOptions {
        RunOptions::new(controller.clone()).with_estimator(self.estimator)
    }

    fn runs(&self, scenarios: &[Scenario], options: &RunOptions) -> Result<Vec<Run>, RunError> {
        let runs = scenarios.iter();
        runs.map(|scenario| Run::new(scenario, options.clone()))
            .collect()
    }

    /// Simulates a controller in the scenarios of `traffic`.
    fn drive_traffic(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<TrafficTally, RunError> {
        let runs = self.runs(&self.draws, &self.options(controller))?;
        Ok(TrafficTally::from_runs(&runs))
    }

    /// Simulates a controller in the scenarios of `everyday`.
    fn drive_everyday(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<Vec<ComparedOutcome>, RunError> {
        let runs = self.runs(&self.everyday, &self.options(controller))?;
        Ok(simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            let collided = result.outcome.collision().is_some();
            ComparedOutcome::new(collided, measure_usefulness(&result))
        }))
    }

    /// Compares a controller with `idm` in the scenarios of `everyday`.
    fn evaluate_everyday(
        &self,
        controller: &Arc<dyn ControllerSource>,
    ) -> Result<EverydayUsefulness, RunError> {
        let drives = self.drive_everyday(controller)?;
        let (faults, jerk_times_idm) = compare_with_idm(&drives, &self.idm_everyday);
        Ok(EverydayUsefulness {
            faults,
            jerk_times_idm,
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
        assert_eq!(
            (idm.collisions, idm.hard_braking, idm.fell_behind),
            (0, 0, 0)
        );
        assert_eq!((idm.acceleration_times_idm, idm.jerk_times_idm), (1.0, 1.0));
        assert_eq!(idm.everyday, Some(EverydayUsefulness::default()));
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
