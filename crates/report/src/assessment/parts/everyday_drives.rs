//! Drives in everyday traffic: comfort, and unnecessary braking with and without sensor faults.

use serde::{Deserialize, Serialize};

use super::first_scenarios::FirstScenarios;
use super::sampling::simulate_each;
use super::share::PercentInterval;
use super::{ControllerUsefulness, OscillationGain, SpaceBraking};
use crate::assessment::case::CaseVerdict;
use crate::assessment::config::EVERYDAY_SPACES;
use crate::assessment::run_ends::RunEnds;
use crate::assessment::{AssessError, Rounded};
use crumple_evidence::exposure::IntervalEstimate;
use crumple_measure::{FollowingMeasures, UsefulnessMeasures};
use crumple_sim::engine::{NamedController, RecordingLevel, RunOptions, SimulationResult};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{GhostObject, Scenario, SensorFaults};

/// Unnecessary braking per hour, with the exact interval of independent brakings at 95 %.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrakingRate {
    /// Sensor faults.
    pub sensors: String,
    /// Number of brakings.
    pub count: u64,
    /// Hours of driving.
    pub hours: Rounded<2>,
    /// Brakings per hour.
    pub per_hour: Rounded<1>,
    /// Lower and upper end of the interval, per hour.
    pub interval: [Rounded<1>; 2],
}

/// Returns names and faults of the sensors in everyday drives. The first has none.
fn sensor_conditions() -> [(&'static str, SensorFaults); 3] {
    let degraded = SensorFaults {
        latency_s: 0.2,
        gap_resolution_m: 0.5,
        outage_rate_per_s: 0.5,
        outage_length_s: 0.5,
        ..SensorFaults::default()
    };
    let object = GhostObject {
        onset_s: 5.0,
        duration_s: 0.5,
        gap_m: 20.0,
        speed_mps: 0.0,
    };
    let ghost = SensorFaults {
        ghost: Some(object),
        ..SensorFaults::default()
    };
    [
        ("no fault", SensorFaults::default()),
        ("degraded", degraded),
        ("ghost", ghost),
    ]
}

pub(super) struct EverydayDrive {
    verdict: CaseVerdict,
    usefulness: Option<UsefulnessMeasures>,
    /// Duration until the end or a collision, in seconds.
    duration_s: f64,
}

/// Measures unnecessary braking per hour under each condition of the sensors. Leaves out conditions that a controller
/// refuses, as a shield does, and in which it never answers, and all faults if it observes the true state.
pub(super) fn braking_rates(
    traffic: &[Scenario],
    drives: &[EverydayDrive],
    options: &RunOptions,
) -> Result<Vec<BrakingRate>, AssessError> {
    let mut rates = Vec::new();
    for (sensors, faults) in sensor_conditions() {
        if !faults.is_any() {
            rates.extend(BrakingRate::new(sensors, drives));
        } else if options.estimator == EstimatorKind::Kalman {
            let faulty = traffic
                .iter()
                .map(|scenario| scenario.edited(|spec| spec.sensors.faults = faults.clone()))
                .collect::<Result<Vec<_>, _>>()?;
            let drives = simulate_each(&faulty, options, RecordingLevel::Trace, EverydayDrive::new);
            let rate = drives
                .ok()
                .and_then(|drives| BrakingRate::new(sensors, &drives));
            rates.extend(rate);
        }
    }
    Ok(rates)
}

impl EverydayDrive {
    pub(super) fn verdict(&self) -> &CaseVerdict {
        &self.verdict
    }

    /// Returns the measures of a drive in which the controller answered. Others are no evidence about driving or
    /// keeping up.
    pub(super) fn answered_measures(&self) -> Option<UsefulnessMeasures> {
        self.answered().map(|(measures, _)| measures)
    }

    /// Returns the measures and the duration, in seconds, of a drive in which the controller answered.
    fn answered(&self) -> Option<(UsefulnessMeasures, f64)> {
        let is_answered = !matches!(self.verdict, CaseVerdict::ControllerFailed { .. });
        let measures = self.usefulness.filter(|_| is_answered)?;
        Some((measures, self.duration_s))
    }
}

impl BrakingRate {
    /// Returns the rate of the drives in which the controller answered; `None` without such a drive.
    fn new(sensors: &str, drives: &[EverydayDrive]) -> Option<Self> {
        let answered = || drives.iter().filter_map(EverydayDrive::answered);
        let count = answered()
            .map(|(useful, _)| useful.unnecessary.count as u64)
            .sum();
        let hours = answered().map(|(_, duration_s)| duration_s).sum::<f64>() / 3600.0;
        if hours <= 0.0 {
            return None;
        }
        let IntervalEstimate {
            estimate,
            lower,
            upper,
        } = IntervalEstimate::poisson_rate(count, hours);
        Some(Self {
            sensors: sensors.to_owned(),
            count,
            hours: hours.into(),
            per_hour: estimate.into(),
            interval: [Rounded::down(lower), Rounded::up(upper)],
        })
    }
}

impl EverydayDrive {
    pub(super) fn new(scenario: &Scenario, simulated: &SimulationResult) -> Self {
        let ego = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index));
        let usefulness = simulated.trace.as_ref().zip(ego).and_then(|(trace, ego)| {
            UsefulnessMeasures::from_trace(trace, &simulated.impacts, ego)
        });
        let end_s = simulated
            .outcome
            .collision()
            .map(|collision| collision.time_s);
        let duration_s = end_s.unwrap_or(scenario.spec().duration_s);
        Self {
            verdict: CaseVerdict::new(simulated, scenario),
            usefulness,
            duration_s,
        }
    }
}

impl ControllerUsefulness {
    pub(super) fn new(
        controller: &NamedController,
        drives: &[EverydayDrive],
        danger: &[EverydayDrive],
        unnecessary_braking_rates: Vec<BrakingRate>,
        oscillation_gain: OscillationGain,
    ) -> Self {
        let measures = AnsweredDrives::new(drives);
        let needless = measures.count(|drive| !drive.unnecessary.is_empty());
        let in_traffic = RunEnds::from_verdicts(drives.iter().map(|drive| &drive.verdict));
        let in_danger = RunEnds::from_verdicts(danger.iter().map(|run| &run.verdict));
        Self {
            controller: controller.name.clone(),
            failures: in_traffic.failures(),
            ended_by_others: [in_traffic.ended_by_others, in_danger.ended_by_others],
            high_risk_failures: in_danger.failures(),
            hit: [in_traffic.hit, in_danger.hit],
            was_hit: [in_traffic.was_hit, in_danger.was_hit],
            // The results of drives without an answer are unknown.
            unnecessary_braking_percent: PercentInterval::clopper_pearson(
                [needless, in_traffic.unanswered_runs()],
                drives.len() as u64,
            ),
            high_risk_percent: PercentInterval::clopper_pearson(
                [in_danger.failures(), in_danger.ended_by_others],
                danger.len() as u64,
            ),
            unanswered: [in_traffic.unanswered, in_danger.unanswered],
            unnecessary_braking: needless,
            unnecessary_braking_rates,
            unnecessary_braking_s: measures.mean(|drive| Some(drive.unnecessary.time_s)),
            hard_braking: measures.count(|drive| !drive.hard.is_empty()),
            left_behind: measures.count(|drive| {
                drive
                    .following
                    .is_some_and(|following| following.fell_behind)
            }),
            progress: measures.mean_following(|following| following.progress),
            time_gap_s: measures.mean_following(|following| following.mean_time_gap_s),
            time_gap_deviation_s: measures
                .mean_following(|following| following.time_gap_deviation_s),
            rms_acceleration_mps2: measures.mean(|drive| drive.rms_acceleration_mps2),
            rms_jerk_mps3: measures.mean(|drive| drive.rms_jerk_mps3),
            induced_brake_mps2: measures.mean(|drive| drive.induced?.peak_brake_mps2),
            oscillation_gain,
            first: [drives, danger].map(FirstScenarios::from_drives),
            braking_by_space: [drives, danger]
                .into_iter()
                .zip(EVERYDAY_SPACES)
                .map(|(drives, space)| SpaceBraking::new(space, drives))
                .collect(),
        }
    }
}

impl SpaceBraking {
    pub(super) fn new(space: &str, drives: &[EverydayDrive]) -> Self {
        let measures = AnsweredDrives::new(drives);
        Self {
            space: space.to_owned(),
            random_scenarios: drives.len() as u64,
            unnecessary: measures.count(|drive| !drive.unnecessary.is_empty()),
            hard: measures.count(|drive| !drive.hard.is_empty()),
        }
    }
}

/// Measures of the drives in which the controller answered.
struct AnsweredDrives(Vec<UsefulnessMeasures>);

impl AnsweredDrives {
    fn new(drives: &[EverydayDrive]) -> Self {
        let answered = drives.iter().filter_map(EverydayDrive::answered_measures);
        Self(answered.collect())
    }

    fn count(&self, condition: impl Fn(&UsefulnessMeasures) -> bool) -> u64 {
        self.0.iter().filter(|drive| condition(drive)).count() as u64
    }

    /// Returns the mean over the drives that have this measure.
    fn mean<const D: usize>(
        &self,
        measure: impl Fn(&UsefulnessMeasures) -> Option<f64>,
    ) -> Option<Rounded<D>> {
        let values: Vec<f64> = self.0.iter().filter_map(measure).collect();
        let sum: f64 = values.iter().sum();
        (!values.is_empty()).then(|| Rounded::new(sum / values.len() as f64))
    }

    fn mean_following<const D: usize>(
        &self,
        measure: fn(FollowingMeasures) -> Option<f64>,
    ) -> Option<Rounded<D>> {
        self.mean(|drive| drive.following.and_then(measure))
    }
}
