//! Admission of commands by a shield.

use super::kernel::{distance_and_speed_after, max_closing_m};
use super::{Real, ShieldParams};

/// Gap, speeds and response of the own actuator at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShieldState<R = f64> {
    /// Gap to the leader, in metres.
    pub gap_m: R,
    /// Own speed, in m/s.
    pub speed_mps: R,
    /// Speed of the leader, in m/s.
    pub ahead_mps: R,
    /// Response of the own actuator, in m/s².
    pub response_mps2: R,
}

impl<R: Real> ShieldParams<R> {
    /// Returns the response of the actuator, in m/s², over the step in which the command `due_mps2` takes effect. The
    /// command is within the vehicle's limits.
    #[must_use]
    #[inline]
    pub fn response_mps2(&self, response_mps2: R, due_mps2: R) -> R {
        response_mps2 + self.response_fraction * (due_mps2 - response_mps2)
    }

    /// Returns the maximum acceleration over a step. A standing vehicle stays at rest unless the response is positive.
    fn acceleration_mps2(&self, state: ShieldState<R>, response_mps2: R) -> R {
        let zero = R::from_f64(0.0);
        let is_held = zero.at_least(state.speed_mps) & zero.at_least(response_mps2);
        R::select(is_held, || zero, || response_mps2 + self.noise_mps2)
    }

    /// Returns the state after a step in which the leader brakes at its limit.
    #[must_use]
    #[inline]
    pub fn after(&self, state: ShieldState<R>, due_mps2: R) -> ShieldState<R> {
        let response_mps2 = self.response_mps2(state.response_mps2, due_mps2);
        let [covered_m, speed_mps] = distance_and_speed_after(
            state.speed_mps,
            self.acceleration_mps2(state, response_mps2),
            self.step_s,
        );
        let [ahead_m, ahead_mps] =
            distance_and_speed_after(state.ahead_mps, -self.ahead_brake_mps2, self.step_s);
        ShieldState {
            gap_m: state.gap_m + ahead_m - covered_m,
            speed_mps,
            ahead_mps,
            response_mps2,
        }
    }

    /// Returns z, the speed that the kernel uses, in m/s: own speed plus the effect of [lag](ShieldParams::lag_s). It
    /// is 0 for a standing vehicle without a positive response.
    #[must_use]
    #[inline]
    pub fn speed_to_lose_mps(&self, state: ShieldState<R>) -> R {
        let zero = R::from_f64(0.0);
        let stands = zero.at_least(state.speed_mps) & zero.at_least(state.response_mps2);
        R::select(
            stands,
            || zero,
            || state.speed_mps + self.lag_s() * (state.response_mps2 + self.brake_mps2),
        )
    }

    /// Returns the spare gap g - D, in metres. Full braking never decreases it.
    #[must_use]
    #[inline]
    pub fn spare_m(&self, state: ShieldState<R>) -> R {
        state.gap_m
            - self
                .kernel()
                .demanded_gap_m(self.speed_to_lose_mps(state), state.ahead_mps)
    }

    /// True if after the command a collision can still be avoided for every behaviour of the leader.
    #[must_use]
    #[inline]
    pub fn admits(&self, state: ShieldState<R>, wanted_mps2: R) -> R::Truth {
        let response_mps2 = self.response_mps2(state.response_mps2, wanted_mps2);
        let acceleration_mps2 = self.acceleration_mps2(state, response_mps2);
        let ShieldState {
            speed_mps,
            ahead_mps,
            ..
        } = state;
        let closing_m = max_closing_m(
            speed_mps,
            acceleration_mps2,
            ahead_mps,
            self.ahead_brake_mps2,
            self.step_s,
        );
        let stays_open = (state.gap_m - closing_m).at_least(self.margin_m);
        let stays_in_kernel = self
            .spare_m(self.after(state, wanted_mps2))
            .at_least(self.margin_m);
        stays_open & stays_in_kernel
    }
}
