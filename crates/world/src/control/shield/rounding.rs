//! What rounding may take of a gap, and the margin that pays for it.

use super::Frame;

/// Demanded on top of the kernel's gap even where rounding takes less, in metres.
pub const MARGIN_M: f64 = 1e-6;

/// A margin beyond which a shield refuses to vouch for a vehicle, in metres: rounding would no longer be a detail.
pub const MOST_MARGIN_M: f64 = 0.1;

/// Half the distance of 1 from the next number: what one operation may be off by, as a share of its result.
const U: f64 = 0.5 * f64::EPSILON;

/// How far, how fast and in how many steps a vehicle and the one ahead of it may travel: bounds over a whole run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Travel {
    /// X, the largest distance from the origin of any bumper of the two, in metres.
    pub position_m: f64,
    /// V, the highest speed of the two, in m/s.
    pub speed_mps: f64,
    /// Steps in which motion is integrated, in the whole run.
    pub steps: usize,
    /// Of them in each step between two decisions, 1 or more.
    pub substeps: usize,
}

impl Travel {
    /// The margin in metres that lets what is proved of real numbers hold of the numbers that drive.
    ///
    /// # What is computed
    ///
    /// u = 2⁻⁵³ is what an operation may be off by, as a share of its result. With X and V as in [`Travel`], the shield's
    /// step h, the integration's h/k, d steps of delay and τ' for the lag ([`Frame::lag_s`]), let
    ///
    /// ```text
    /// b   the own brake less noise               Z = V + τ' (a + b)     what takes the place of the own speed
    /// A   a + b + c, more than any acceleration  T = Z/b                the longest way to standstill, in time
    /// S   Z²/2b, the longest way to standstill
    /// ```
    ///
    /// D(v, w) changes by at most T for each m/s of either speed: its slopes are v/b and w/c, or (v - w)/(b - c), which is at
    /// most v/b in its case. (Where D > 0 in the first case with b <= c, w/c is at most v/b.)
    ///
    /// *A step of motion.* In real numbers a step of full braking, from the numbers that the simulation holds, does not lessen
    /// the spare gap g - D. What it computes instead differs by
    ///
    /// - 4 u X for each position: x + v t + a t²/2 is two sums of at most X (with a step's way to spare), and products that are
    ///   far smaller; a step cut into k parts is k h/k, which is off by u h;
    /// - u (V + 6 A h) for each speed, which count T times: a product, a sum, the step's parts, and the own acceleration,
    ///   which the shield computes by another route than the actuator;
    /// - 3 u (a + b) for the response of an actuator with lag, which counts τ' T times.
    ///
    /// ```text
    /// ε = u (8 X + 2 T (V + 6 A h) + 3 τ' T (a + b))
    /// ```
    ///
    /// *A test.* The gap that is seen, (X - length) - x, is off by 3 u X. Each of d + 1 predicted steps adds two numbers of at most
    /// 2 X to it and computes two speeds: less than ε + 2 u X. Z is off by six operations, so D by 12 u S; D's own operations
    /// are at most six on numbers no larger than S, and where v c >= w b is decided wrongly, which of the two formulas is used
    /// matters by (v c - w b)²/2 b c (b - c), less than 4 u S: 24 u S cover all. Two differences of numbers up to 2 X and S remain.
    ///
    /// ```text
    /// η = (d + 1) (ε + 2 u X) + u (7 X + 24 S)
    /// ```
    ///
    /// *Contact.* The simulation solves g + r t + a t²/2 = 0 inside a step from a gap off by 7 u X and speeds off by a few u V over
    /// no more than h; where the discriminant's sign is decided wrongly, the gap is at most 3 u times what it was before: 16 u X.
    ///
    /// # Why that is enough
    ///
    /// An action is let through if the spare gap, as computed, is at least the margin m. Let it act, and full braking follow. The
    /// spare gap is then at least m - η - ε after that step, and at least m - η - (n + 1) ε after n more. As soon as the own
    /// vehicle stands nothing is lost any more: it has D = 0, and the vehicle ahead does not reverse. So n is no more than
    /// Z/(b h/k) + 1, the k d steps of delay besides, nor more than the steps of the whole run; and
    ///
    /// ```text
    /// m/2 = (n + 2) ε + η + 16 u X
    /// ```
    ///
    /// keeps the spare gap above m/2: more than is needed to say of every instant that the vehicles do not touch, and as much as is
    /// needed to brake on from there. So a state from which a shield lets something through is never called out of the kernel
    /// afterwards (spare gap below m/2), and nobody touches from a state that is not.
    ///
    /// What the estimator computes is not counted here: the error bounds are taken as they are given.
    #[must_use]
    pub fn margin_m(&self, frame: &Frame) -> f64 {
        let Self { position_m, speed_mps, steps, substeps } = *self;
        let brake_mps2 = frame.kernel().own_brake_mps2;
        let response_span_mps2 = frame.accel_mps2 + frame.brake_mps2 + frame.noise_mps2;
        let any_mps2 = response_span_mps2 + frame.ahead_brake_mps2;
        let lag_s = frame.lag_s();
        let replaced_mps = speed_mps + lag_s * response_span_mps2;
        let (stop_s, stop_m) = (replaced_mps / brake_mps2, 0.5 * replaced_mps * replaced_mps / brake_mps2);
        let step_m = U
            * (8.0 * position_m
                + 2.0 * stop_s * (speed_mps + 6.0 * any_mps2 * frame.step_s)
                + 3.0 * lag_s * stop_s * response_span_mps2);
        let predicted = frame.delay_steps as f64 + 1.0;
        let test_m = predicted * (step_m + 2.0 * U * position_m) + U * (7.0 * position_m + 24.0 * stop_m);
        let braking = (stop_s / frame.step_s + predicted) * substeps as f64 + 1.0;
        let needed_m = (braking.min(steps as f64) + 2.0) * step_m + test_m + 16.0 * U * position_m;
        (2.0 * needed_m).max(MARGIN_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::ErrorBounds;

    const FRAME: Frame = Frame {
        step_s: 0.01,
        brake_mps2: 7.5,
        accel_mps2: 3.0,
        noise_mps2: 0.5,
        ahead_brake_mps2: 6.0,
        delay_steps: 2,
        share: 0.25,
        errors: ErrorBounds { gap_m: 0.0, speed_mps: 0.0, ahead_speed_mps: 0.0 },
        behind: None,
        margin_m: 0.0,
    };

    /// The formulas of the documentation, worked out by hand: τ' = 0.03 s, Z = 30.33 m/s, T = 4.332857 s, S = 65.7077 m,
    /// n = 4 (433.2857 + 3) + 1.
    #[test]
    fn the_margin_is_that_of_the_derivation() {
        let travel = Travel { position_m: 1e8, speed_mps: 30.0, steps: 1_000_000, substeps: 4 };
        let (x, u) = (1e8, 2.0_f64.powi(-53));
        let (z, t): (f64, f64) = (30.0 + 0.03 * 11.0, 30.33 / 7.0);
        let epsilon = 8.0 * x + 2.0 * t * (30.0 + 6.0 * 17.0 * 0.01) + 3.0 * 0.03 * t * 11.0;
        let eta = 3.0 * (epsilon + 2.0 * x) + 7.0 * x + 24.0 * z * z / 14.0;
        let expected_m = 2.0 * u * ((4.0 * (t / 0.01 + 3.0) + 1.0 + 2.0) * epsilon + eta + 16.0 * x);
        let found_m = travel.margin_m(&FRAME);
        assert!((found_m / expected_m - 1.0).abs() < 1e-12, "{found_m} {expected_m}");
        // No more steps than there are.
        let short = Travel { steps: 100, ..travel }.margin_m(&FRAME);
        let expected_m = 2.0 * u * (102.0 * epsilon + eta + 16.0 * x);
        assert!((short / expected_m - 1.0).abs() < 1e-12, "{short} {expected_m}");
        // Terms that large positions hide.
        let still = Travel { position_m: 0.0, speed_mps: 1e5, steps: 1_000_000_000, substeps: 1 };
        let found_m = still.margin_m(&Frame { share: 0.001, delay_steps: 0, step_s: 1.0, ..FRAME });
        let (z, lag) = (1e5 + 999.0 * 11.0, 999.0);
        let t = z / 7.0;
        let epsilon = 2.0 * t * (1e5 + 6.0 * 17.0) + 3.0 * lag * t * 11.0;
        let expected_m = 2.0 * u * ((t + 1.0 + 1.0 + 2.0) * epsilon + epsilon + 24.0 * z * z / 14.0);
        assert!((found_m / expected_m - 1.0).abs() < 1e-12, "{found_m} {expected_m}");
    }

    #[test]
    fn near_the_origin_the_margin_is_a_micrometre() {
        let near = Travel { position_m: 400.0, speed_mps: 70.0, steps: 1500, substeps: 10 };
        assert_eq!(near.margin_m(&FRAME), MARGIN_M);
    }
}
