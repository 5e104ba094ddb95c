//! Gap that a fully braking vehicle needs behind another fully braking vehicle.
//!
//! The mathematics, and a check of the closed form in exact arithmetic, are in `crumple_verify::kernel`. Certificates
//! and proof obligations evaluate these functions with other number types ([`Real`]).

use super::Real;

/// Brake limits of two successive vehicles; determines the states from which they can avoid a collision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViabilityKernel<R = f64> {
    /// b, deceleration that the rear vehicle can reach, in m/s², positive.
    pub own_brake_mps2: R,
    /// c, deceleration that the front vehicle never exceeds, in m/s², positive.
    pub ahead_brake_mps2: R,
}

impl<R: Real> ViabilityKernel<R> {
    /// Returns the demanded gap D(v, w), in metres. The rear vehicle at `speed_mps` can avoid a collision with the
    /// leader at `ahead_mps`, for any behaviour of the leader, exactly if the gap is larger.
    ///
    /// D = max(0, v²/2b - w²/2c) if b <= c or v/b >= w/c, and max(0, v - w)²/2(b - c) otherwise. The first expression
    /// is the distance of Shalev-Shwartz, Shammah and Shashua (arXiv:1708.06374, definition 1, without response time).
    /// If the rear vehicle brakes harder and stops first, the two are closest while both move.
    #[must_use]
    #[inline]
    pub fn demanded_gap_m(&self, speed_mps: R, ahead_mps: R) -> R {
        let Self {
            own_brake_mps2: b,
            ahead_brake_mps2: c,
        } = *self;
        let [v, w] = [speed_mps, ahead_mps];
        let zero = R::from_f64(0.0);
        let two = R::from_f64(2.0);
        let closest_at_rest = c.at_least(b) | (v * c).at_least(w * b);
        R::select(
            closest_at_rest,
            || (v * v / (two * b) - w * w / (two * c)).larger(zero),
            || {
                let closing_mps = (v - w).larger(zero);
                closing_mps * closing_mps / (two * (b - c))
            },
        )
    }
}

/// Returns distance (m) and speed (m/s) after `dt_s` under constant acceleration; vehicles do not reverse.
#[must_use]
#[inline]
pub fn distance_and_speed_after<R: Real>(speed_mps: R, acceleration_mps2: R, dt_s: R) -> [R; 2] {
    let zero = R::from_f64(0.0);
    let half = R::from_f64(0.5);
    let end_mps = speed_mps + acceleration_mps2 * dt_s;
    let stops = zero.greater_than(end_mps);
    [
        R::select(
            stops,
            || speed_mps * speed_mps / (R::from_f64(-2.0) * acceleration_mps2),
            || speed_mps * dt_s + half * acceleration_mps2 * dt_s * dt_s,
        ),
        R::select(stops, || zero, || end_mps),
    ]
}

/// Returns the maximum decrease of the gap at any instant within `dt_s`, in metres. The front vehicle brakes at
/// `ahead_brake_mps2`, the rear one holds `acceleration_mps2`.
///
/// The closing speed is linear until a vehicle stops, and turns from positive to negative only while both move.
#[must_use]
#[inline]
pub fn max_closing_m<R: Real>(
    speed_mps: R,
    acceleration_mps2: R,
    ahead_mps: R,
    ahead_brake_mps2: R,
    dt_s: R,
) -> R {
    let zero = R::from_f64(0.0);
    let closing_m = |t: R| {
        distance_and_speed_after(speed_mps, acceleration_mps2, t)[0]
            - distance_and_speed_after(ahead_mps, -ahead_brake_mps2, t)[0]
    };
    let at_end_m = closing_m(dt_s).larger(zero);
    let turn_s = (speed_mps - ahead_mps) / (-acceleration_mps2 - ahead_brake_mps2);
    let turns_inside = speed_mps.greater_than(ahead_mps)
        & turn_s.greater_than(zero)
        & dt_s
            .smaller(ahead_mps / ahead_brake_mps2)
            .greater_than(turn_s);
    R::select(
        turns_inside,
        || at_end_m.larger(closing_m(turn_s)),
        || at_end_m,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The leader brakes softly and stops late. At t = 2/3 s both vehicles are equally fast, before either stands.
    #[test]
    fn the_gap_is_smallest_before_either_stands() {
        assert!((max_closing_m(2.0, -2.0, 1.0, 0.5, 2.0) - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_harder_braking_car_needs_a_gap_where_the_rss_distance_needs_none() {
        let kernel = ViabilityKernel {
            own_brake_mps2: 8.0,
            ahead_brake_mps2: 5.0,
        };
        assert!((kernel.demanded_gap_m(25.0, 20.0) - 25.0 / 6.0).abs() < 1e-12);
        assert!(
            25.0_f64.powi(2) / 16.0 < 20.0_f64.powi(2) / 10.0,
            "familiar distance"
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn closed_forms_are_the_largest_closing(v in 0.0..40.0_f64, w in 0.0..40.0_f64, b in 0.5..10.0_f64,
                                                c in 0.5..10.0_f64, a in -10.0..4.0_f64, dt in 0.01..2.0_f64) {
            let standstill_s = (v / b).max(w / c) + 0.01;
            for (rate, horizon_s, claimed) in [
                (-b, standstill_s, ViabilityKernel { own_brake_mps2: b, ahead_brake_mps2: c }.demanded_gap_m(v, w)),
                (a, dt, max_closing_m(v, a, w, c, dt)),
            ] {
                let closing = |t: f64| distance_and_speed_after(v, rate, t)[0] - distance_and_speed_after(w, -c, t)[0];
                let brute = (0..=4000).map(|k| closing(horizon_s * f64::from(k) / 4000.0)).fold(0.0, f64::max);
                prop_assert!(claimed >= brute - 1e-9, "{claimed} {brute}");
                prop_assert!(claimed <= brute + 20.0 * (horizon_s / 4000.0).powi(2) + 1e-9, "{claimed} {brute}");
            }
        }
    }
}
