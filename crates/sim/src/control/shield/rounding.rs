//! Effect of rounding on gaps, and the margin that covers it.

use super::ShieldParams;

/// Minimum margin beyond the kernel's gap, in metres.
pub const MIN_MARGIN_M: f64 = 1e-6;

/// Maximum margin, in metres; beyond it a shield gives no guarantee.
pub(crate) const MAX_MARGIN_M: f64 = 0.1;

/// Unit roundoff u: maximum relative error of one operation.
const UNIT_ROUNDOFF: f64 = 0.5 * f64::EPSILON;

/// Factor by which rounded numbers may exceed bounds that hold for real numbers, after at most five million steps.
const PAD: f64 = 1.0 + 1e-8;

/// Bounds of the motion of a vehicle and its leader over a whole run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionBounds {
    /// X, maximum distance of any bumper of the two from the origin, in metres.
    pub position_m: f64,
    /// V, maximum speed of the two, in m/s.
    pub speed_mps: f64,
    /// Maximum acceleration of the leader, in m/s².
    pub ahead_accel_mps2: f64,
    /// Integration steps of the whole run.
    pub steps: usize,
    /// Integration steps per decision step, 1 or more.
    pub substeps: usize,
}

impl MotionBounds {
    /// Returns the margin, in metres, with which the proofs over real numbers hold in double precision.
    ///
    /// Names in parentheses are Coq theorems about the Rust operations: `verify/coq/Rounding.v`, explained in
    /// `docs/kernel-theorems.md`. Statements without a name are derived by hand.
    ///
    /// # Rounding errors
    ///
    /// The relative error of an operation is at most u = 2⁻⁵³ (`an_operation_is_off_by_u`). With V as in
    /// [`MotionBounds`], the maximum acceleration a of the vehicle, the brake limit c of the leader, the shield's step
    /// h, the integration step h/k, d steps of delay and τ' for the lag ([`ShieldParams::lag_s`]), let
    ///
    /// ```text
    /// b   own brake limit less noise             P = a + full brake + noise, bounds the difference of two responses
    /// A = P + c + the acceleration of the leader, a bound of any acceleration
    /// Z = V + (τ' + h) P   a bound of the speed that the kernel uses
    /// T = Z/b      maximum time to standstill           R = T + (d + 1) h   maximum time from a command to standstill
    /// S = Z²/2b    maximum distance to standstill
    /// X   as in MotionBounds, and at least 4 h (V + A h)
    /// ```
    ///
    /// D(v, w) changes by at most T per m/s of either speed (`the_demand_rises_with_errors_of_speeds`).
    ///
    /// *A step of motion.* In real numbers, full braking does not decrease the spare gap g - D. The computed step
    /// differs by
    ///
    /// - 4 u X for each position: x + v t + a t²/2 is two sums of at most 1.3 X, and products of at most X/4; the k
    ///   parts h/k of a step add up to h with an error of u h;
    /// - u (V + 5.2 A h) for the own speed and u (V + 3.2 A h) for the leader's, each times T: a product, a sum, the
    ///   parts of the step and, for the own speed, a sum with noise and the rest of the brake
    ///   (`the_own_vehicle_in_a_step`, `the_vehicle_ahead_in_a_step`, `motion_takes_at_most`);
    /// - 3.1 u P for the response of an actuator with lag, times (τ' + h) T (`the_response_takes_at_most`).
    ///
    /// ```text
    /// ε = u (8 X + 2 R (V + 6 A h) + 5 τ' R P)
    /// ```
    ///
    /// exceeds the sum of these, even with T in place of R (`a_step_of_full_braking_takes_at_most`). It has R > T,
    /// because an error of speed while a command is pending lasts until the command takes effect.
    ///
    /// *The spare gap*, computed from the stored numbers, has an error of u (6 X + 28 S) and a few u τ' T P, which ε
    /// covers: 3.1 u X of the observed gap (position ahead - length) - own position, 12 u S of D, and 7 u Z of the
    /// speed that the kernel uses (`the_gap_is_seen_rounded`, `the_demand_is_rounded`, `the_speed_to_lose_is_rounded`,
    /// `the_spare_gap_is_rounded`).
    ///
    /// *A test.* Each of the d + 1 predicted steps adds two numbers of at most X/2 to a gap of at most 3 X, and
    /// computes two distances while the vehicles move: 24 u X. Without division of a step into parts, predicted speeds
    /// are at least as bad as the real ones, to the bit, because rounding is monotonic
    /// (`a_predicted_step_is_no_better`, `predicted_steps_are_no_better`, `what_passes_the_test_is_spare`). With parts,
    /// or for an actuator without lag and delay, whose response the shield computes as r + (a - r), predicted speeds
    /// have the error ε of a step of motion. The closing inside the step adds one difference.
    ///
    /// ```text
    /// η = (d + 1) (ε + 16 u X) + u (8 X + 32 S)
    /// ```
    ///
    /// *Collision.* In real numbers no collision occurs inside a step that starts at the stored numbers
    /// (`inside_a_step_nobody_touches`). The simulation solves g + r t + a t²/2 = 0 with a gap error of 11 u X and
    /// speed errors of a few u V over at most h. If the sign of the discriminant is wrong, the gap is at most 5 u times
    /// the gap at the begin of the step: 16 u X.
    ///
    /// # Sufficiency of the margin
    ///
    /// A command is admitted if the computed spare gap is at least the margin m. Let it take effect, followed by full
    /// braking. After n steps, including pending ones, the spare gap is at least m - η - n ε
    /// (`braking_on_takes_at_most`). The shield computes it again to test if the state is outside the kernel; the
    /// result is at least m - 2 η - n ε. A vehicle at rest loses nothing more: it has D = 0, and the leader does not
    /// reverse. So n is at most Z/(b h/k) + 1 plus the k (d + 1) parts of predicted steps, and at most the number of
    /// steps of the run, and
    ///
    /// ```text
    /// m/2 = (n + 2) ε + 2 η + 16 u X
    /// ```
    ///
    /// keeps the spare gap above m/2 (`half_a_margin_pays`). This is enough to exclude a collision at every instant and
    /// to continue full braking. After a state from which a shield admits a command, no state is reported as outside
    /// the kernel (spare gap below m/2), and no collision occurs from a state inside it.
    ///
    /// One exception remains, with lag and steps in parts. A vehicle that is predicted to stand may, by rounding alone,
    /// move on at 10⁻¹⁷ m/s for a part; meanwhile the kernel uses τ' (r + b) as its speed. The only consequence is that
    /// the state may be reported as outside the kernel.
    ///
    /// Not included are estimator errors beyond the bounds, and products below 10⁻³⁰⁸, which are irrelevant for a gap.
    pub(crate) fn margin_m(&self, params: &ShieldParams) -> f64 {
        let Self {
            steps, substeps, ..
        } = *self;
        let speed_mps = PAD * self.speed_mps;
        let brake_mps2 = params.kernel().own_brake_mps2;
        let response_span_mps2 = params.accel_mps2 + params.brake_mps2 + params.noise_mps2;
        let any_mps2 = response_span_mps2 + params.ahead_brake_mps2 + self.ahead_accel_mps2;
        let position_m = (PAD * self.position_m)
            .max(4.0 * params.step_s * (speed_mps + any_mps2 * params.step_s));
        let lag_s = params.lag_s();
        let replaced_mps = speed_mps + (lag_s + params.step_s) * response_span_mps2;
        let stop_s = replaced_mps / brake_mps2;
        let stop_m = 0.5 * replaced_mps * replaced_mps / brake_mps2;
        let predicted = params.delay_steps as f64 + 1.0;
        let reach_s = stop_s + predicted * params.step_s;
        let step_m = UNIT_ROUNDOFF
            * (8.0 * position_m
                + 2.0 * reach_s * (speed_mps + 6.0 * any_mps2 * params.step_s)
                + 5.0 * lag_s * reach_s * response_span_mps2);
        let test_m = predicted * (step_m + 16.0 * UNIT_ROUNDOFF * position_m)
            + UNIT_ROUNDOFF * (8.0 * position_m + 32.0 * stop_m);
        let braking = (stop_s / params.step_s + predicted) * substeps as f64 + 1.0;
        let needed_m = (braking.min(steps as f64) + 2.0) * step_m
            + 2.0 * test_m
            + 16.0 * UNIT_ROUNDOFF * position_m;
        (2.0 * needed_m).max(MIN_MARGIN_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::ErrorBounds;

    const PARAMS: ShieldParams = ShieldParams {
        step_s: 0.01,
        brake_mps2: 7.5,
        accel_mps2: 3.0,
        noise_mps2: 0.5,
        ahead_brake_mps2: 6.0,
        delay_steps: 2,
        response_fraction: 0.25,
        errors: ErrorBounds {
            gap_m: 0.0,
            speed_mps: 0.0,
            ahead_speed_mps: 0.0,
        },
        behind: None,
        margin_m: 0.0,
    };

    /// Evaluates the formulas of the documentation a second time: P = 11 and A = 19 m/s², b = 7 m/s².
    #[test]
    fn the_margin_is_that_of_the_derivation() {
        let u = 2.0_f64.powi(-53);
        let expected_m = |x: f64, v: f64, [h, lag]: [f64; 2], d: f64, n: &dyn Fn(f64) -> f64| {
            let v = v * (1.0 + 1e-8);
            let x = (x * (1.0 + 1e-8)).max(4.0 * h * (v + 19.0 * h));
            let z = v + (lag + h) * 11.0;
            let (t, reach) = (z / 7.0, z / 7.0 + (d + 1.0) * h);
            let epsilon = 8.0 * x + 2.0 * reach * (v + 6.0 * 19.0 * h) + 5.0 * lag * reach * 11.0;
            let eta = (d + 1.0) * (epsilon + 16.0 * x) + 8.0 * x + 32.0 * z * z / 14.0;
            2.0 * u * ((n(t) + 2.0) * epsilon + 2.0 * eta + 16.0 * x)
        };
        let near = |found_m: f64, expected_m: f64| {
            assert!(
                (found_m / expected_m - 1.0).abs() < 1e-12,
                "{found_m} {expected_m}"
            );
        };
        let travel = MotionBounds {
            position_m: 3e8,
            speed_mps: 30.0,
            ahead_accel_mps2: 2.0,
            steps: 1_000_000,
            substeps: 4,
        };
        near(
            travel.margin_m(&PARAMS),
            expected_m(3e8, 30.0, [0.01, 0.03], 2.0, &|t| {
                4.0 * (t / 0.01 + 3.0) + 1.0
            }),
        );
        let short = MotionBounds {
            steps: 100,
            ..travel
        };
        near(
            short.margin_m(&PARAMS),
            expected_m(3e8, 30.0, [0.01, 0.03], 2.0, &|_| 100.0),
        );
        let still = MotionBounds {
            position_m: 0.0,
            speed_mps: 1e5,
            steps: 1_000_000_000,
            substeps: 1,
            ..travel
        };
        let slow = ShieldParams {
            response_fraction: 0.001,
            delay_steps: 0,
            step_s: 0.5,
            ..PARAMS
        };
        near(
            still.margin_m(&slow),
            expected_m(0.0, 1e5, [0.5, 499.5], 0.0, &|t| t / 0.5 + 2.0),
        );
    }

    /// Behind a leader that may accelerate harder than the own vehicle brakes, rounding of the leader's speed counts.
    #[test]
    fn the_margin_covers_a_vehicle_ahead_that_accelerates_hard() {
        let tame = MotionBounds {
            position_m: 1e8,
            speed_mps: 30.0,
            ahead_accel_mps2: 0.0,
            steps: 1_000_000,
            substeps: 1,
        };
        let wild = MotionBounds {
            ahead_accel_mps2: 90.0,
            ..tame
        };
        let slow = ShieldParams {
            step_s: 1.0,
            ..PARAMS
        };
        assert!(wild.margin_m(&slow) > tame.margin_m(&slow));
    }

    #[test]
    fn the_margin_near_the_origin_is_one_micrometre() {
        let near = MotionBounds {
            position_m: 400.0,
            speed_mps: 70.0,
            ahead_accel_mps2: 3.0,
            steps: 1500,
            substeps: 10,
        };
        assert_eq!(near.margin_m(&PARAMS), MIN_MARGIN_M);
    }
}
