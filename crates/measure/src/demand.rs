//! Braking demand: the deceleration that a situation requires of the follower.

use serde::{Deserialize, Serialize};

use super::approach::Approach;
use crumple_sim::engine::{Impact, Trace};
pub use crumple_sim::required_brake::required_brake_mps2;

/// Returns the deceleration rate to avoid a crash in m/s²: the constant deceleration of the follower that just avoids
/// collision with a leader of constant speed, `DRAC = (closing speed)² / (2 gap)`.
///
/// `None` if the gap does not close or there is no gap.
///
/// Source: Cooper and Ferguson 1976, "Traffic studies at T-junctions: 2. A conflict simulation record", Traffic
/// Engineering and Control 17, 306-309; Archer 2005, "Indicators for traffic safety assessment and prediction and their
/// application in micro-simulation modelling", KTH Stockholm.
#[must_use]
pub fn drac_mps2(gap_m: f64, closing_mps: f64) -> Option<f64> {
    let closes = closing_mps > 0.0 && gap_m > 0.0;
    closes
        .then(|| 0.5 * closing_mps * closing_mps / gap_m)
        .filter(|drac_mps2| drac_mps2.is_finite())
}

impl Approach {
    /// Returns the largest DRAC of all samples, in m/s²; `None` if the gap never closed, or if there was a collision.
    /// Near a collision DRAC is unbounded, and its largest sample would depend only on the step.
    #[must_use]
    pub fn max_drac_mps2(&self) -> Option<f64> {
        let dracs = self
            .states()
            .filter_map(|state| drac_mps2(state.gap_m, state.closing_mps()));
        dracs.reduce(f64::max).filter(|_| !self.has_collision())
    }

    /// Returns the largest required deceleration of all samples, in m/s², for a leader that keeps its acceleration
    /// until standstill; `None` if there was a collision, as for [`Approach::max_drac_mps2`].
    #[must_use]
    pub fn max_required_brake_mps2(&self) -> Option<f64> {
        let required = self.states().filter_map(|state| {
            required_brake_mps2(
                state.gap_m,
                state.front_speed_mps,
                -state.front_acceleration_mps2,
                state.rear_speed_mps,
            )
        });
        required.reduce(f64::max).filter(|_| !self.has_collision())
    }
}

/// Braking that a vehicle induces in its follower.
///
/// A controller that brakes late and hard may protect itself at its follower's expense. The follower's actual braking
/// differs from the required one if the follower reacts late or cannot brake harder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct InducedBraking {
    /// Hardest deceleration of the follower before collision, in m/s², positive; `None` for less than two samples.
    pub peak_brake_mps2: Option<f64>,
    /// Largest DRAC of the follower, in m/s²; `None` if the gap never closed, or if there was a collision.
    pub max_drac_mps2: Option<f64>,
    /// Largest required deceleration of the follower, in m/s², for a vehicle ahead that keeps its braking until
    /// standstill; `None` if there was a collision.
    pub max_required_brake_mps2: Option<f64>,
}

impl InducedBraking {
    /// Measures the braking that vehicle `index` induces in its follower; `None` for the last vehicle.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], index: usize) -> Option<Self> {
        let approach = Approach::from_trace_behind(trace, impacts, index)?;
        let brakes_mps2 = approach
            .steps()
            .map(|(state, _)| -state.rear_acceleration_mps2);
        Some(Self {
            peak_brake_mps2: brakes_mps2
                .reduce(f64::max)
                .map(|brake_mps2| brake_mps2.max(0.0)),
            max_drac_mps2: approach.max_drac_mps2(),
            max_required_brake_mps2: approach.max_required_brake_mps2(),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{driven_track, impact, pair_trace, trace};

    #[test]
    fn deceleration_rate_to_avoid_a_crash_by_hand() {
        assert_eq!(drac_mps2(20.0, 10.0), Some(2.5), "10² / (2 * 20)");
        assert_eq!(
            (
                drac_mps2(20.0, 0.0),
                drac_mps2(20.0, -1.0),
                drac_mps2(0.0, 1.0)
            ),
            (None, None, None)
        );
    }

    #[test]
    fn required_deceleration_by_hand() {
        // Equal speeds while moving: 20 m/s behind 15 m/s braking at 1 m/s², gap 10 m: 1 + 5² / 20; equal speeds after
        // 4 s, when the leader still drives 11 m/s.
        assert_eq!(required_brake_mps2(10.0, 15.0, 1.0, 20.0), Some(2.25));
        // Equal speeds at rest: both at 20 m/s, gap 10 m, the leader brakes at 5 m/s² and stops after 40 m: 20² / (2 *
        // 50).
        assert_eq!(required_brake_mps2(10.0, 20.0, 5.0, 20.0), Some(4.0));
        assert_eq!(
            required_brake_mps2(10.0, 0.0, 0.0, 20.0),
            Some(20.0),
            "standing vehicle: 20² / (2 * 10)"
        );
        assert_eq!(
            required_brake_mps2(10.0, 20.0, -1.0, 20.0),
            Some(0.0),
            "no vehicle needs to brake"
        );
        assert_eq!(required_brake_mps2(0.0, 20.0, 1.0, 20.0), None, "no gap");
    }

    #[test]
    fn induced_braking_by_hand() {
        // Gap 10 m, both at 20 m/s; the leader brakes at 8 m/s² and stops after 25 m. The follower brakes 0.5 s later
        // at 10 m/s². It coasts 10 m and brakes over 20 m, so it stops 5 m behind the leader.
        // Required at t = 0: 20² / (2 * (10 + 25)) = 40 / 7. At t = 0.5: speeds 16 and 20, gap 10 - 1 = 9: 20² / (2 *
        // (9 + 16)) = 8. DRAC then: 4² / (2 * 9) = 8 / 9.
        // From then on the follower brakes harder than required, and required deceleration falls. A time s later the
        // speeds are 16 - 8 s and 20 - 10 s, the closing speed is 4 - 2 s and the gap 9 - 4 s + s². At s = 1.5 DRAC is
        // 1² / (2 * 5.25); it is largest at s = 0.
        let mut trace = pair_trace(
            10.0,
            [(20.0, &[(3.0, -8.0)]), (20.0, &[(0.5, 0.0), (2.5, -10.0)])],
            0.5,
        );
        let induced = InducedBraking::from_trace(&trace, &[], 0).unwrap();
        assert_eq!(induced.peak_brake_mps2, Some(10.0));
        assert!((induced.max_required_brake_mps2.unwrap() - 8.0).abs() < 1e-12);
        assert!((induced.max_drac_mps2.unwrap() - 8.0 / 9.0).abs() < 1e-12);
        assert_eq!(
            InducedBraking::from_trace(&trace, &[], 1),
            None,
            "no vehicle behind the last"
        );

        // After a collision at 0.4 s, later braking does not count, and no deceleration would have sufficed.
        trace.vehicles[1].acceleration_mps2[0] = -1.0;
        let collided =
            InducedBraking::from_trace(&trace, &[impact(0.4, 0, 16.8, 20.0)], 0).unwrap();
        let InducedBraking {
            peak_brake_mps2,
            max_drac_mps2,
            max_required_brake_mps2,
        } = collided;
        assert_eq!(
            (peak_brake_mps2, max_drac_mps2, max_required_brake_mps2),
            (Some(1.0), None, None)
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn the_required_deceleration_just_avoids_collision(
            gap_m in 5.0..50.0f64,
            front_speed_mps in 1.0..30.0f64,
            rear_speed_mps in 1.0..30.0f64,
            front_brake_mps2 in 0.0..9.0f64,
        ) {
            let required_mps2 = required_brake_mps2(gap_m, front_speed_mps, front_brake_mps2, rear_speed_mps).unwrap();
            prop_assume!(required_mps2 > 0.2, "comes to rest within the time simulated");
            let min_gap_m = |rear_brake_mps2: f64| {
                let front = driven_track(4.0, gap_m + 4.0, front_speed_mps, &[(200.0, -front_brake_mps2)], 0.5);
                let rear = driven_track(4.0, 0.0, rear_speed_mps, &[(200.0, -rear_brake_mps2)], 0.5);
                Approach::from_trace(&trace(vec![front, rear], 0.5), &[], 1).unwrap().min_gap_m().unwrap()
            };
            prop_assert!(min_gap_m(required_mps2) < 1e-6, "no harder than needed");
            prop_assert!(min_gap_m(1.001 * required_mps2) > 0.0, "hard enough");
            prop_assert_eq!(min_gap_m(0.999 * required_mps2), 0.0, "any softer and they touch");
        }

        #[test]
        fn required_deceleration_extends_drac(gap_m in 0.1..99.0f64, front in 0.1..30.0f64, closing in 0.1..30.0f64) {
            let required_mps2 = required_brake_mps2(gap_m, front, 0.0, front + closing).unwrap();
            let drac_mps2 = drac_mps2(gap_m, closing).unwrap();
            prop_assert!((required_mps2 - drac_mps2).abs() < 1e-9 * drac_mps2.max(1.0));
        }
    }
}
