//! What rounding may take of a gap, and the margin that pays for it.

use super::ShieldParams;

/// Demanded on top of the kernel's gap even where rounding takes less, in metres.
pub const MIN_MARGIN_M: f64 = 1e-6;

/// A margin beyond which a shield refuses to vouch for a vehicle, in metres: rounding would no longer be a detail.
pub(crate) const MAX_MARGIN_M: f64 = 0.1;

/// Half the distance of 1 from the next number: what one operation may be off by, as a share of its result.
const UNIT_ROUNDOFF: f64 = 0.5 * f64::EPSILON;

/// What is bounded by real numbers may be exceeded by what is computed, and by what rounding adds in all steps of a run, of which there are
/// at most five million: by less than this share.
const PAD: f64 = 1.0 + 1e-8;

/// How far, how fast and in how many steps a vehicle and the one ahead of it may travel: bounds over a whole run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MotionBounds {
    /// X, the largest distance from the origin of any bumper of the two, in metres.
    pub position_m: f64,
    /// V, the highest speed of the two, in m/s.
    pub speed_mps: f64,
    /// What the vehicle ahead may accelerate at, in m/s².
    pub ahead_accel_mps2: f64,
    /// Steps in which motion is integrated, in the whole run.
    pub steps: usize,
    /// Of them in each step between two decisions, 1 or more.
    pub substeps: usize,
}

impl MotionBounds {
    /// The margin in metres that lets what is proved of real numbers hold of the numbers that drive.
    ///
    /// Names in parentheses are theorems that Coq has checked, of the Rust expressions operation by operation: `verify/coq/Rounding.v`, shown in
    /// `docs/kernel-theorems.md` beside what they speak of. What has no name is derived by hand.
    ///
    /// # What is computed
    ///
    /// u = 2⁻⁵³ is what an operation may be off by, as a share of its result (`an_operation_is_off_by_u`). With V as in [`MotionBounds`], the
    /// shield's step h, the integration's h/k, d steps of delay and τ' for the lag ([`Frame::lag_s`]), let
    ///
    /// ```text
    /// b   the own brake less noise               P = a + full brake + noise, more than any response differs from another
    /// A = P + c + the acceleration of the vehicle ahead, more than any acceleration
    /// Z = V + (τ' + h) P   more than what takes the place of the own speed
    /// T = Z/b      the longest way to standstill, in time     R = T + (d + 1) h   the same from when a command is given
    /// S = Z²/2b    the longest way to standstill
    /// X   as in Travel, and at least 4 h (V + A h)
    /// ```
    ///
    /// D(v, w) changes by at most T for each m/s of either speed (`the_demand_rises_with_errors_of_speeds`).
    ///
    /// *A step of motion.* In real numbers a step of full braking, from the numbers that the simulation holds, does not lessen
    /// the spare gap g - D. What it computes instead differs by
    ///
    /// - 4 u X for each position: x + v t + a t²/2 is two sums of at most 1.3 X, and products that are at most X/4; a step cut into k
    ///   parts is k h/k, which is off by u h;
    /// - u (V + 5.2 A h) for the own speed and u (V + 3.2 A h) for the one ahead, which count T times: a product, a sum, the step's parts, and
    ///   for the own one a sum with noise and what is left of the brake (`the_own_vehicle_in_a_step`, `the_vehicle_ahead_in_a_step`,
    ///   `motion_takes_at_most`);
    /// - 3.1 u P for the response of an actuator with lag, which counts (τ' + h) T times (`the_response_takes_at_most`).
    ///
    /// ```text
    /// ε = u (8 X + 2 R (V + 6 A h) + 5 τ' R P)
    /// ```
    ///
    /// with T in the place of R is more than all that (`a_step_of_full_braking_takes_at_most`); R > T, since a speed that is off while a command
    /// is under way is off until it acts.
    ///
    /// *The spare gap*, as computed of what is held, is off by u (6 X + 28 S) and some u τ' T P, which ε has to spare: the gap that is seen,
    /// (X - length) - x, by 3.1 u X, D by 12 u S, what takes the place of the own speed by 7 u Z (`the_gap_is_seen_rounded`,
    /// `the_demand_is_rounded`, `the_speed_to_lose_is_rounded`, `the_spare_gap_is_rounded`).
    ///
    /// *A test.* Each of the d + 1 predicted steps adds two numbers of at most X/2 to a gap of at most 3 X, and computes two ways, while the
    /// vehicles move: 24 u X. Speeds are predicted to be no better than they come, to the bit, as long as motion is not cut into parts, since nothing
    /// rounds a larger number to a smaller one (`a_predicted_step_is_no_better`, `predicted_steps_are_no_better`,
    /// `what_passes_the_test_is_spare`). In parts, or where an actuator without lag and delay does to the bit what the shield takes for
    /// r + (a - r), they are off as in a step of motion: ε. One difference more, for the closing inside the step.
    ///
    /// ```text
    /// η = (d + 1) (ε + 16 u X) + u (8 X + 32 S)
    /// ```
    ///
    /// *Contact.* In real numbers nobody touches inside a step from the numbers that are held (`inside_a_step_nobody_touches`). The simulation
    /// solves g + r t + a t²/2 = 0 there from a gap off by 11 u X and speeds off by a few u V over
    /// no more than h; where the discriminant's sign is decided wrongly, the gap is at most 5 u times what it was before: 16 u X.
    ///
    /// # Why that is enough
    ///
    /// An action is let through if the spare gap, as computed, is at least the margin m. Let it act, and full braking follow. After n steps,
    /// those under way included, the spare gap is at least m - η - n ε (`braking_on_takes_at_most`), and computed once more, to ask
    /// whether the state is out of the kernel, at least m - 2 η - n ε. As soon as the own
    /// vehicle stands nothing is lost any more: it has D = 0, and the vehicle ahead does not reverse. So n is no more than
    /// Z/(b h/k) + 1, the k (d + 1) parts of predicted steps besides, nor more than the steps of the whole run; and
    ///
    /// ```text
    /// m/2 = (n + 2) ε + 2 η + 16 u X
    /// ```
    ///
    /// keeps the spare gap above m/2 (`half_a_margin_pays`): more than is needed to say of every instant that the vehicles do not touch, and
    /// as much as is needed to brake on from there. So a state from which a shield lets something through is never called out of the kernel
    /// afterwards (spare gap below m/2), and nobody touches from a state that is not.
    ///
    /// One exception is left: with lag, and motion cut into parts, a vehicle that is predicted to stand, by rounding alone, may move on at
    /// 10⁻¹⁷ m/s for a part; τ' (r + b) takes the place of its speed meanwhile, where nothing was to. Without noise it stands within the next part,
    /// and all that is wrong is that the state may be called out of the kernel.
    ///
    /// What the estimator computes is not counted here: the error bounds are taken as they are given. Products below 10⁻³⁰⁸ are rounded by
    /// more than a share u, and are no matter for a gap.
    #[must_use]
    pub(crate) fn margin_m(&self, frame: &ShieldParams) -> f64 {
        let Self { steps, substeps, .. } = *self;
        let speed_mps = PAD * self.speed_mps;
        let brake_mps2 = frame.kernel().own_brake_mps2;
        let response_span_mps2 = frame.accel_mps2 + frame.brake_mps2 + frame.noise_mps2;
        let any_mps2 = response_span_mps2 + frame.ahead_brake_mps2 + self.ahead_accel_mps2;
        let position_m = (PAD * self.position_m).max(4.0 * frame.step_s * (speed_mps + any_mps2 * frame.step_s));
        let lag_s = frame.lag_s();
        let replaced_mps = speed_mps + (lag_s + frame.step_s) * response_span_mps2;
        let (stop_s, stop_m) = (replaced_mps / brake_mps2, 0.5 * replaced_mps * replaced_mps / brake_mps2);
        let predicted = frame.delay_steps as f64 + 1.0;
        let reach_s = stop_s + predicted * frame.step_s;
        let step_m = UNIT_ROUNDOFF
            * (8.0 * position_m
                + 2.0 * reach_s * (speed_mps + 6.0 * any_mps2 * frame.step_s)
                + 5.0 * lag_s * reach_s * response_span_mps2);
        let test_m = predicted * (step_m + 16.0 * UNIT_ROUNDOFF * position_m)
            + UNIT_ROUNDOFF * (8.0 * position_m + 32.0 * stop_m);
        let braking = (stop_s / frame.step_s + predicted) * substeps as f64 + 1.0;
        let needed_m = (braking.min(steps as f64) + 2.0) * step_m + 2.0 * test_m + 16.0 * UNIT_ROUNDOFF * position_m;
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
        errors: ErrorBounds { gap_m: 0.0, speed_mps: 0.0, ahead_speed_mps: 0.0 },
        behind: None,
        margin_m: 0.0,
    };

    /// The formulas of the documentation, worked out once more: P = 11 and A = 19 m/s², and b = 7 m/s².
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
            assert!((found_m / expected_m - 1.0).abs() < 1e-12, "{found_m} {expected_m}");
        };
        let travel =
            MotionBounds { position_m: 1e8, speed_mps: 30.0, ahead_accel_mps2: 2.0, steps: 1_000_000, substeps: 4 };
        near(travel.margin_m(&PARAMS), expected_m(1e8, 30.0, [0.01, 0.03], 2.0, &|t| 4.0 * (t / 0.01 + 3.0) + 1.0));
        // No more steps than there are.
        let short = MotionBounds { steps: 100, ..travel };
        near(short.margin_m(&PARAMS), expected_m(1e8, 30.0, [0.01, 0.03], 2.0, &|_| 100.0));
        // Terms that large positions hide.
        let still = MotionBounds { position_m: 0.0, speed_mps: 1e5, steps: 1_000_000_000, substeps: 1, ..travel };
        let slow = ShieldParams { response_fraction: 0.001, delay_steps: 0, step_s: 1.0, ..PARAMS };
        near(still.margin_m(&slow), expected_m(0.0, 1e5, [1.0, 999.0], 0.0, &|t| t + 2.0));
    }

    /// Behind one that may accelerate harder than the own vehicle brakes, what rounding takes of its speed counts.
    #[test]
    fn the_margin_covers_a_vehicle_ahead_that_accelerates_hard() {
        let tame =
            MotionBounds { position_m: 1e8, speed_mps: 30.0, ahead_accel_mps2: 0.0, steps: 1_000_000, substeps: 1 };
        let wild = MotionBounds { ahead_accel_mps2: 90.0, ..tame };
        let slow = ShieldParams { step_s: 1.0, ..PARAMS };
        assert!(wild.margin_m(&slow) > tame.margin_m(&slow));
    }

    #[test]
    fn near_the_origin_the_margin_is_a_micrometre() {
        let near =
            MotionBounds { position_m: 400.0, speed_mps: 70.0, ahead_accel_mps2: 3.0, steps: 1500, substeps: 10 };
        assert_eq!(near.margin_m(&PARAMS), MIN_MARGIN_M);
    }
}
