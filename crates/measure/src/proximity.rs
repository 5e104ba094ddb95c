//! Proximity: time to collision, time headway and time gap.

use super::approach::Approach;
use crumple_sim::engine;

/// Returns the time to collision in seconds at constant speeds, `TTC = gap / closing speed`.
///
/// `None` if the gap does not close; 0 if it closes and is 0.
///
/// Source: Hayward 1972, "Near-miss determination through use of a scale of danger", Highway Research Record 384,
/// 24-34.
#[must_use]
pub fn ttc_s(gap_m: f64, closing_mps: f64) -> Option<f64> {
    Some(engine::ttc_s(gap_m, closing_mps)).filter(|ttc_s| ttc_s.is_finite())
}

/// Returns the time headway in seconds, from front bumper to front bumper at the own speed, `h = (gap + length of the
/// leader) / v`; `None` at standstill.
///
/// Traffic engineering defines headway as the time between two front bumpers at a point. Much of the literature also
/// calls [`time_gap_s`], without the length, a headway; SAE J2944 separates the two.
///
/// Source: Vogel 2003, "A comparison of headway and time to collision as safety indicators", Accident Analysis and
/// Prevention 35, 427-433 (front to front); SAE J2944 (2015), "Operational definitions of driving performance measures
/// and statistics" (gap and headway told apart).
#[must_use]
pub fn time_headway_s(gap_m: f64, front_length_m: f64, rear_speed_mps: f64) -> Option<f64> {
    time_gap_s(gap_m + front_length_m, rear_speed_mps)
}

/// Returns the time gap in seconds, from the leader's rear bumper to the own front bumper at the own speed, `gap / v`;
/// `None` at standstill.
///
/// Adaptive cruise control is set to this value. Source: as for [`time_headway_s`].
#[must_use]
pub fn time_gap_s(gap_m: f64, rear_speed_mps: f64) -> Option<f64> {
    (rear_speed_mps > 0.0)
        .then(|| gap_m.max(0.0) / rear_speed_mps)
        .filter(|gap_s| gap_s.is_finite())
}

impl Approach {
    /// Returns the smallest time to collision of all samples, in seconds, 0 at a collision; `None` if the gap
    /// never closed.
    #[must_use]
    pub fn min_ttc_s(&self) -> Option<f64> {
        self.states()
            .filter_map(|state| ttc_s(state.gap_m, state.closing_mps()))
            .reduce(f64::min)
    }

    /// Returns the smallest time headway of all samples, in seconds; `None` if the vehicle never moved.
    #[must_use]
    pub fn min_time_headway_s(&self) -> Option<f64> {
        self.states_with_length_m()
            .filter_map(|(state, length_m)| {
                time_headway_s(state.gap_m, length_m, state.rear_speed_mps)
            })
            .reduce(f64::min)
    }

    /// Returns the smallest time gap of all samples, in seconds, 0 at a collision; `None` if the vehicle never moved.
    #[must_use]
    pub fn min_time_gap_s(&self) -> Option<f64> {
        self.states()
            .filter_map(|state| time_gap_s(state.gap_m, state.rear_speed_mps))
            .reduce(f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::pair_trace;

    #[test]
    fn time_to_collision_by_hand() {
        assert_eq!(ttc_s(20.0, 5.0), Some(4.0), "20 m at 5 m/s");
        assert_eq!(ttc_s(0.0, 5.0), Some(0.0));
        assert_eq!(ttc_s(20.0, 0.0), None, "not closing");
        assert_eq!(ttc_s(20.0, -5.0), None, "opening");
        assert_eq!(ttc_s(20.0, 1e-320), None, "too slow for a number");
    }

    #[test]
    fn headway_counts_the_vehicle_ahead_and_time_gap_does_not() {
        assert_eq!(time_headway_s(16.0, 4.0, 25.0), Some(0.8), "(16 + 4) / 25");
        assert_eq!(time_gap_s(16.0, 25.0), Some(0.64), "16 / 25");
        assert_eq!(
            (time_headway_s(16.0, 4.0, 0.0), time_gap_s(16.0, 0.0)),
            (None, None),
            "standstill"
        );
    }

    #[test]
    fn smallest_times_over_a_trace_by_hand() {
        // Gap 20 m; front 10 m/s, rear 20 m/s for 1 s, then rear brakes at 10 m/s² for 1 s.
        // t = 0: gap 20, closing 10: TTC 2.    t = 1: gap 10, closing 10: TTC 1, time gap 10 / 20.
        // t = 1.5: rear 15, closing 5, gap 10 - 3.75 = 6.25: TTC 1.25, time gap 6.25 / 15 = 5 / 12, headway 8.25 / 15.
        // t = 2: rear 10, gap 5, not closing: time gap 5 / 10, headway 7 / 10.
        let pair = pair_trace(
            20.0,
            [(10.0, &[(2.0, 0.0)]), (20.0, &[(1.0, 0.0), (1.0, -10.0)])],
            0.5,
        );
        let approach = Approach::from_trace(&pair, &[], 1).unwrap();
        let near = |value: Option<f64>, by_hand: f64| (value.unwrap() - by_hand).abs() < 1e-12;
        assert!(near(approach.min_ttc_s(), 1.0));
        assert!(near(approach.min_time_gap_s(), 5.0 / 12.0));
        assert!(near(approach.min_time_headway_s(), 8.25 / 15.0));
    }
}
