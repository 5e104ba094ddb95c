//! String stability: whether a disturbance grows from vehicle to vehicle.

use serde::{Deserialize, Serialize};

use crate::sim::Trace;

/// A line drives at one speed if no vehicle is further off that of the leader than this, in m/s: 0.5.
pub const SETTLED_TOLERANCE_MPS: f64 = 0.5;

/// A smaller deviation is noise, in m/s: 0.1.
pub const MIN_DEVIATION_MPS: f64 = 0.1;

/// How much of the leader's change of speed arrives further back: ratios of the largest deviations from the speed at which
/// the line drove before.
///
/// A line of vehicles is string stable if disturbances do not grow along it. Of the many definitions this is the ratio of
/// peaks: `max_t |v_i - v_i(t_0)| / max_t |v_(i-1) - v_(i-1)(t_0)|`. Above 1 a disturbance grows. One disturbance of one
/// size refutes string stability, and does not prove it.
///
/// Source: Swaroop and Hedrick 1996, "String stability of interconnected systems", IEEE Transactions on Automatic Control
/// 41, 349-357 (peaks); Ploeg, van de Wouw and Nijmeijer 2014, "Lp string stability of cascaded systems: application to
/// vehicle platooning", IEEE Transactions on Control Systems Technology 22, 786-793 (definitions compared).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SpeedAmplification {
    /// For each vehicle but the leader, how much larger its deviation is than that of the one ahead; none where that is below
    /// [`MIN_DEVIATION_MPS`].
    pub of_each: Vec<Option<f64>>,
    /// From the leader to the last.
    pub overall: f64,
}

impl SpeedAmplification {
    /// How a disturbance that begins at `from_s` seconds goes through the line.
    ///
    /// None if the vehicles do not drive at one speed then ([`SETTLED_TOLERANCE_MPS`]): what would be measured is how they settle. None
    /// if the leader keeps its speed, too.
    #[must_use]
    pub fn from_trace(trace: &Trace, from_s: f64) -> Option<Self> {
        let start = trace.time_s.iter().position(|&time_s| time_s >= from_s)?;
        let speeds = trace.vehicles.iter().map(|track| track.speed_mps.get(start..)).collect::<Option<Vec<_>>>()?;
        let initial_mps = *speeds.first()?.first()?;
        let mut deviations_mps = Vec::with_capacity(speeds.len());
        for speeds in speeds {
            let own_mps = *speeds.first()?;
            let off_mps = (own_mps - initial_mps).abs();
            if off_mps > SETTLED_TOLERANCE_MPS || off_mps.is_nan() {
                return None;
            }
            deviations_mps.push(speeds.iter().map(|speed_mps| (speed_mps - own_mps).abs()).fold(0.0, f64::max));
        }
        let ratio = |of: f64, to: f64| (to >= MIN_DEVIATION_MPS).then_some(of / to);
        let pairs = deviations_mps.iter().zip(deviations_mps.iter().skip(1));
        let of_each = pairs.map(|(&ahead_mps, &own_mps)| ratio(own_mps, ahead_mps)).collect();
        Some(Self { of_each, overall: ratio(*deviations_mps.last()?, *deviations_mps.first()?)? })
    }

    /// Whether the disturbance grew anywhere along the line.
    #[must_use]
    pub fn has_amplification(&self) -> bool {
        self.of_each.iter().flatten().any(|&ratio| ratio > 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::testing::{driven_track, trace};

    /// After a second at 20 m/s each vehicle brakes for a second and recovers.
    fn line(brakes_mps2: &[f64]) -> Trace {
        let dips = brakes_mps2.iter().enumerate().map(|(i, &brake)| {
            driven_track(4.0, -30.0 * i as f64, 20.0, &[(1.0, 0.0), (1.0, -brake), (1.0, brake)], 0.25)
        });
        trace(dips.collect(), 0.25)
    }

    #[test]
    fn amplification_by_hand() {
        let found = SpeedAmplification::from_trace(&line(&[2.0, 3.0, 1.5]), 1.0).unwrap();
        assert_eq!(found, SpeedAmplification { of_each: vec![Some(1.5), Some(0.5)], overall: 0.75 });
        assert!(
            found.has_amplification()
                && !SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 0.0).unwrap().has_amplification()
        );
        assert_eq!(SpeedAmplification::from_trace(&line(&[2.0, 0.0, 1.0]), 0.0).unwrap().of_each, [Some(0.0), None]);
    }

    #[test]
    fn what_is_no_disturbance_of_a_line_is_none() {
        assert_eq!(SpeedAmplification::from_trace(&line(&[0.0, 1.0]), 0.0), None, "the leader keeps its speed");
        assert_eq!(SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 2.0), None, "speeds differ by then");
        assert_eq!(SpeedAmplification::from_trace(&line(&[2.0, 1.0]), 9.0), None, "after the end");
        assert_eq!(SpeedAmplification::from_trace(&Trace { time_s: vec![], vehicles: vec![] }, 0.0), None);
    }
}
