//! Duration and depth below a threshold: time exposed and time integrated time to collision.

use serde::{Deserialize, Serialize};

use super::approach::{Approach, PairState};

/// Critical time to collision, in seconds.
///
/// The middle of the usual 2 to 4 s. Minderhoud and Bovy leave the threshold to the study and warn that driver support
/// systems require another one; so it is a parameter of [`Approach::ttc_exposure`], and results with different
/// thresholds are not comparable.
pub const TTC_THRESHOLD_S: f64 = 3.0;

/// Exposure to short times to collision.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TtcExposure {
    /// TET: duration of a time to collision below the threshold, in seconds.
    pub tet_s: f64,
    /// TIT: integral of the shortfall over that time, in s².
    pub tit_s2: f64,
}

impl Approach {
    /// Computes time exposed and time integrated time to collision below `threshold_s`: `TET = ∫ 1[TTC < TTC*] dt`,
    /// `TIT = ∫ max(0, TTC* - TTC) dt`, both 0 if the gap never closed.
    ///
    /// The integrals end at the collision or at the end of the trace. The authors sum over equidistant samples; here
    /// each step has its own weight, since the last one before a collision may be shorter. Within a step,
    /// `TTC* closing - gap` is interpolated linearly, because it has no pole, unlike time to collision; the threshold
    /// is crossed where it is zero. On the part of a step below the threshold, the shortfall `TTC* - TTC` is
    /// interpolated linearly (trapezoid). The error falls with the square of the step, unless time to collision
    /// recovers from near zero within one step. `TIT <= TTC* TET` always.
    ///
    /// Source: Minderhoud and Bovy 2001, "Extended time-to-collision measures for road traffic safety assessment",
    /// Accident Analysis and Prevention 33, 89-97; as integrals in Westhofen et al. 2023, "Criticality metrics for
    /// automated driving", Archives of Computational Methods in Engineering 30, sections 5.2.6 and 5.2.7.
    #[must_use]
    pub fn ttc_exposure(&self, threshold_s: f64) -> TtcExposure {
        self.steps()
            .fold(TtcExposure::default(), |sum, (from, to)| {
                let exposed_s = (to.time_s - from.time_s) * exposed_share(from, to, threshold_s);
                let shortfalls_s = shortfall_s(from, threshold_s) + shortfall_s(to, threshold_s);
                TtcExposure {
                    tet_s: sum.tet_s + exposed_s,
                    tit_s2: sum.tit_s2 + 0.5 * exposed_s * shortfalls_s,
                }
            })
    }
}

/// Returns a value above 0 exactly when the gap closes and time to collision is below the threshold.
fn excess_m(state: &PairState, threshold_s: f64) -> f64 {
    threshold_s * state.closing_mps() - state.gap_m
}

fn shortfall_s(state: &PairState, threshold_s: f64) -> f64 {
    let excess_m = excess_m(state, threshold_s);
    if excess_m > 0.0 {
        excess_m / state.closing_mps()
    } else {
        0.0
    }
}

fn exposed_share(from: &PairState, to: &PairState, threshold_s: f64) -> f64 {
    let from_m = excess_m(from, threshold_s);
    let to_m = excess_m(to, threshold_s);
    match (from_m > 0.0, to_m > 0.0) {
        (true, true) => 1.0,
        (true, false) => from_m / (from_m - to_m),
        (false, true) => to_m / (to_m - from_m),
        (false, false) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{driven_track, impact, pair_trace, trace};
    use crumple_sim::engine::Trace;

    #[test]
    fn a_steady_approach_by_hand() {
        // Gap 20 m closes at 5 m/s: TTC = 4 - t, collision at t = 4 s, between samples (0.7 s apart). Below 3 s from
        // t = 1 on: TET = 3 s. The shortfall grows from 0 to 3 s over these 3 s: TIT = 3 * 3 / 2 s².
        let pair = pair_trace(20.0, [(10.0, &[(4.9, 0.0)]), (15.0, &[(4.9, 0.0)])], 0.7);
        let approach = Approach::from_trace(&pair, &[impact(4.0, 0, 10.0, 15.0)], 1).unwrap();
        let TtcExposure { tet_s, tit_s2 } = approach.ttc_exposure(3.0);
        assert!(
            (tet_s - 3.0).abs() < 1e-12 && (tit_s2 - 4.5).abs() < 1e-12,
            "{tet_s} {tit_s2}"
        );
        let TtcExposure { tet_s, tit_s2 } = approach.ttc_exposure(1.0);
        assert!(
            (tet_s - 1.0).abs() < 1e-12 && (tit_s2 - 0.5).abs() < 1e-12,
            "{tet_s} {tit_s2}"
        );
        assert_eq!(approach.ttc_exposure(0.0), TtcExposure::default());
    }

    #[test]
    fn exposure_ends_inside_a_step_when_the_follower_brakes() {
        // Threshold 2 s. Gap 17 m closes at 10 m/s: TTC 1.7, shortfall 0.3, excess 2 * 10 - 17 = 3 m. The rear vehicle
        // brakes at 8 m/s² for 0.5 s: gap 13 m closes at 6 m/s, excess 2 * 6 - 13 = -1 m. Exposed for 3/4 of the step:
        // TET = 0.375 s, TIT = 0.375 * 0.3 / 2 s².
        let pair = pair_trace(17.0, [(10.0, &[(0.5, 0.0)]), (20.0, &[(0.5, -8.0)])], 0.5);
        let approach = Approach::from_trace(&pair, &[], 1).unwrap();
        let TtcExposure { tet_s, tit_s2 } = approach.ttc_exposure(2.0);
        assert!(
            (tet_s - 0.375).abs() < 1e-12 && (tit_s2 - 0.05625).abs() < 1e-12,
            "{tet_s} {tit_s2}"
        );
    }

    #[test]
    fn an_opening_gap_adds_no_exposure() {
        let pair = pair_trace(1.0, [(15.0, &[(5.0, 0.0)]), (15.0, &[(5.0, -1.0)])], 0.5);
        let approach = Approach::from_trace(&pair, &[], 1).unwrap();
        assert_eq!(
            approach.ttc_exposure(TTC_THRESHOLD_S),
            TtcExposure::default()
        );
    }

    /// Creates a trace in which both brake in turn: time to collision falls below the threshold and recovers.
    fn near_miss_trace(gap_m: f64, speed_mps: f64, brakes_mps2: [f64; 2], step_s: f64) -> Trace {
        let front = driven_track(
            4.0,
            gap_m + 4.0,
            speed_mps,
            &[(1.0, -brakes_mps2[0]), (5.0, 0.0)],
            step_s,
        );
        let rear = driven_track(
            4.0,
            0.0,
            speed_mps,
            &[(1.0, 0.0), (2.0, -brakes_mps2[1]), (3.0, 0.0)],
            step_s,
        );
        trace(vec![front, rear], step_s)
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn exposure_is_bounded_and_converges(
            gap_m in 5.0..20.0f64,
            speed_mps in 10.0..30.0f64,
            brakes_mps2 in prop::array::uniform2(1.0..8.0f64),
            threshold_s in 1.0..4.0f64,
        ) {
            let exposure = |step_s| {
                let trace = near_miss_trace(gap_m, speed_mps, brakes_mps2, step_s);
                Approach::from_trace(&trace, &[], 1).unwrap().ttc_exposure(threshold_s)
            };
            // Excludes collisions, which cut the approach, and near collisions, which recover within a coarse step.
            let fine = Approach::from_trace(&near_miss_trace(gap_m, speed_mps, brakes_mps2, 0.001), &[], 1).unwrap();
            prop_assume!(fine.min_gap_m() > Some(0.5));
            let (coarse, fine) = (exposure(0.02), exposure(0.001));
            for TtcExposure { tet_s, tit_s2 } in [coarse, fine] {
                prop_assert!((0.0..=6.0).contains(&tet_s));
                prop_assert!(tit_s2 >= 0.0 && tit_s2 <= threshold_s * tet_s + 1e-12);
            }
            prop_assert!((coarse.tet_s - fine.tet_s).abs() < 0.04, "{coarse:?} {fine:?}");
            prop_assert!((coarse.tit_s2 - fine.tit_s2).abs() < 0.01, "{coarse:?} {fine:?}");
        }

        #[test]
        fn exposure_equals_a_sum_over_fine_samples(
            gap_m in 5.0..20.0f64,
            speed_mps in 10.0..30.0f64,
            brakes_mps2 in prop::array::uniform2(1.0..8.0f64),
        ) {
            let fine = Approach::from_trace(&near_miss_trace(gap_m, speed_mps, brakes_mps2, 0.0005), &[], 1).unwrap();
            let ttcs = fine.states().filter_map(|s| super::super::ttc_s(s.gap_m, s.closing_mps()));
            let short: Vec<f64> = ttcs.filter(|&ttc_s| ttc_s < TTC_THRESHOLD_S).collect();
            let TtcExposure { tet_s, tit_s2 } = fine.ttc_exposure(TTC_THRESHOLD_S);
            prop_assert!((tet_s - 0.0005 * short.len() as f64).abs() < 0.002);
            let sum_s2: f64 = short.iter().map(|ttc_s| 0.0005 * (TTC_THRESHOLD_S - ttc_s)).sum();
            prop_assert!((tit_s2 - sum_s2).abs() < 0.005);
        }
    }
}
