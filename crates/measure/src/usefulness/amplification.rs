//! Amplification: growth of one disturbance from vehicle to vehicle.

use serde::{Deserialize, Serialize};

use crumple_sim::engine::Trace;

/// Largest deviation from the leader's speed at which vehicles count as driving at one speed, in m/s.
pub const SETTLED_TOLERANCE_MPS: f64 = 0.5;

/// Smallest deviation that is not noise, in m/s.
pub const MIN_DEVIATION_MPS: f64 = 0.1;

/// Amplification of the leader's change of speed along the line: ratios of the largest deviations from the initial
/// speeds.
///
/// The ratio of peaks is `max_t |v_i - v_i(t_0)| / max_t |v_(i-1) - v_(i-1)(t_0)|`. Above 1 a disturbance grows. This
/// describes one disturbance: others may grow where this one shrinks. [`GainSurvey`](crate::GainSurvey)
/// measures oscillations of many frequencies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedAmplification {
    /// Ratio of each vehicle's deviation to that of its leader, without the first vehicle; `None` if the latter is
    /// below [`MIN_DEVIATION_MPS`].
    pub of_each: Vec<Option<f64>>,
    /// Ratio from the first vehicle to the last.
    pub overall: f64,
}

impl SpeedAmplification {
    /// Measures a disturbance that begins at `from_s` seconds.
    ///
    /// `None` if the vehicles do not drive at one speed then ([`SETTLED_TOLERANCE_MPS`]), since they would still be
    /// settling, and `None` if the leader keeps its speed.
    #[must_use]
    pub fn from_trace(trace: &Trace, from_s: f64) -> Option<Self> {
        let start = trace.time_s.iter().position(|&time_s| time_s >= from_s)?;
        let speeds = trace
            .vehicles
            .iter()
            .map(|track| track.speed_mps.get(start..))
            .collect::<Option<Vec<_>>>()?;
        let initial_mps = *speeds.first()?.first()?;
        let mut deviations_mps = Vec::with_capacity(speeds.len());
        for speeds in speeds {
            let own_mps = *speeds.first()?;
            let off_mps = (own_mps - initial_mps).abs();
            if off_mps > SETTLED_TOLERANCE_MPS || off_mps.is_nan() {
                return None;
            }
            deviations_mps.push(
                speeds
                    .iter()
                    .map(|speed_mps| (speed_mps - own_mps).abs())
                    .fold(0.0, f64::max),
            );
        }
        let pairs = deviations_mps.iter().zip(deviations_mps.iter().skip(1));
        let of_each = pairs
            .map(|(&ahead_mps, &own_mps)| amplification(own_mps, ahead_mps))
            .collect();
        Some(Self {
            of_each,
            overall: amplification(*deviations_mps.last()?, *deviations_mps.first()?)?,
        })
    }

    /// Returns true if the disturbance grew at any vehicle.
    #[must_use]
    pub fn has_amplification(&self) -> bool {
        self.of_each.iter().flatten().any(|&ratio| ratio > 1.0)
    }
}

/// Returns the ratio of two deviations; `None` if that of the leader is too small.
fn amplification(own_mps: f64, ahead_mps: f64) -> Option<f64> {
    (ahead_mps >= MIN_DEVIATION_MPS).then_some(own_mps / ahead_mps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{driven_track, trace};
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::observation::EstimatorKind;
    use crumple_sim::scenario::{SPEED_DIP_ONSET_S, speed_dip};

    /// Creates a trace in which each vehicle brakes after a second at 20 m/s for a second and recovers.
    fn line(brakes_mps2: &[f64]) -> Trace {
        let dips = brakes_mps2.iter().enumerate().map(|(i, &brake)| {
            driven_track(
                4.0,
                -30.0 * i as f64,
                20.0,
                &[(1.0, 0.0), (1.0, -brake), (1.0, brake)],
                0.25,
            )
        });
        trace(dips.collect(), 0.25)
    }

    #[test]
    fn amplification_by_hand() {
        let amplification = SpeedAmplification::from_trace(&line(&[2.0, 3.0, 1.5]), 1.0).unwrap();
        assert_eq!(
            amplification,
            SpeedAmplification {
                of_each: vec![Some(1.5), Some(0.5)],
                overall: 0.75
            }
        );
        let damped = SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 0.0).unwrap();
        assert!(amplification.has_amplification() && !damped.has_amplification());
        assert_eq!(
            SpeedAmplification::from_trace(&line(&[2.0, 0.0, 1.0]), 0.0)
                .unwrap()
                .of_each,
            [Some(0.0), None]
        );
    }

    #[test]
    fn without_a_disturbance_there_is_no_amplification() {
        assert_eq!(
            SpeedAmplification::from_trace(&line(&[0.0, 1.0]), 0.0),
            None,
            "the leader keeps its speed"
        );
        assert_eq!(
            SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 2.0),
            None,
            "speeds differ by then"
        );
        assert_eq!(
            SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 9.0),
            None,
            "after the end"
        );
        assert_eq!(
            SpeedAmplification::from_trace(
                &Trace {
                    time_s: vec![],
                    vehicles: vec![]
                },
                0.0
            ),
            None
        );
    }

    #[test]
    fn a_line_of_cruise_controls_carries_a_speed_dip_back() {
        let scenario = speed_dip(5, 1.5).unwrap();
        let acc = BuiltInController::from_name("acc-aeb").unwrap();
        let options = RunOptions::new(acc).with_estimator(EstimatorKind::Truth);
        let run = Run::new(&scenario, options).unwrap();
        let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
        let amplification = SpeedAmplification::from_trace(&trace, SPEED_DIP_ONSET_S).unwrap();
        assert!(
            amplification.of_each.len() == 5 && amplification.overall > 0.1,
            "{amplification:?}"
        );
    }
}
