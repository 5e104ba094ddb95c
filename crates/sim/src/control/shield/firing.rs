//! Followers whose brake fires if the time to collision at a sample is less than a threshold.
//!
//! Before it fires, their acceleration is within a limit of 0. The functions are generic over numbers ([`Real`]), so
//! that simulation and proof obligations use the same code; `docs/two-sided.md` has the theorems about them.

use super::Real;

/// Position and speed at a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionSample<R = f64> {
    /// Position, in metres.
    pub position_m: R,
    /// Speed, in m/s.
    pub speed_mps: R,
}

/// When a follower's brake fires, and how its speed changes before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FiringRule<R = f64> {
    /// Time between samples, in seconds.
    pub step_s: R,
    /// Time to collision below which the brake fires, in seconds, larger than the time between samples.
    pub ttc_s: R,
    /// Maximum magnitude of the acceleration before, in m/s².
    pub drift_mps2: R,
}

/// Speeds of all followers that fire at a sample, in m/s. No follower fires there if `min_mps` exceeds `max_mps`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FiringSpeeds<R = f64> {
    /// Lowest speed.
    pub min_mps: R,
    /// Highest speed up to which the follower may be at its farthest position; within the other two.
    pub kink_mps: R,
    /// Highest speed.
    pub max_mps: R,
}

impl<R: Real> FiringRule<R> {
    /// Returns the distance by which a follower misses the threshold, in metres. Its brake fires if this is negative.
    #[must_use]
    #[inline]
    pub fn spare_m(&self, own: MotionSample<R>, follower: MotionSample<R>) -> R {
        own.position_m - follower.position_m - self.ttc_s * (follower.speed_mps - own.speed_mps)
    }

    /// Returns the farthest position, in metres, of a follower with this speed whose brake had not fired at the sample
    /// before.
    #[must_use]
    #[inline]
    pub fn unfired_position_m(&self, own_before: MotionSample<R>, speed_mps: R) -> R {
        let drift_mps = self.drift_mps2 * self.step_s;
        own_before.position_m - self.ttc_s * (speed_mps - drift_mps - own_before.speed_mps)
            + (speed_mps + R::from_f64(0.5) * drift_mps) * self.step_s
    }

    /// Returns the speed for which [`Self::unfired_position_m`] is this position, in m/s.
    #[must_use]
    #[inline]
    pub fn unfired_speed_mps(&self, own_before: MotionSample<R>, position_m: R) -> R {
        let at_rest_m = self.unfired_position_m(own_before, R::from_f64(0.0));
        (at_rest_m - position_m) / (self.ttc_s - self.step_s)
    }

    /// Returns the speeds of followers that fire at a sample and not before. `fastest` and `slowest` are the farthest
    /// and least far motion of all followers.
    ///
    /// The farthest later position of such a follower increases with its speed up to `kink_mps`, and is convex in its
    /// speed from there on. So the worst follower has the speed `kink_mps` or `max_mps`.
    #[must_use]
    #[inline]
    pub fn firing_speeds_mps(
        &self,
        [own, own_before]: [MotionSample<R>; 2],
        [fastest, slowest]: [MotionSample<R>; 2],
    ) -> FiringSpeeds<R> {
        let gap_m = own.position_m - fastest.position_m;
        let min_mps = (own.speed_mps + gap_m / self.ttc_s).larger(slowest.speed_mps);
        let max_mps = self
            .unfired_speed_mps(own_before, slowest.position_m)
            .smaller(fastest.speed_mps);
        let kink_mps = self
            .unfired_speed_mps(own_before, fastest.position_m)
            .larger(min_mps)
            .smaller(max_mps);
        FiringSpeeds {
            min_mps,
            kink_mps,
            max_mps,
        }
    }

    /// Returns the smallest gap, in metres, to a follower that does not fire at a sample, until the next one. The ego
    /// vehicle brakes by at most `own_brake_mps2`; the follower is not slower than `low_mps`.
    #[must_use]
    #[inline]
    pub fn waiting_gap_m(
        &self,
        own: MotionSample<R>,
        own_brake_mps2: R,
        fastest_position_m: R,
        low_mps: R,
    ) -> R {
        let least_m =
            (own.position_m - fastest_position_m).larger(self.ttc_s * (low_mps - own.speed_mps));
        let relative_mps2 = self.drift_mps2 + own_brake_mps2;
        least_m * (self.ttc_s - self.step_s) / self.ttc_s
            - R::from_f64(0.5) * relative_mps2 * self.step_s * self.step_s
    }
}

/// Returns the minimum of value + rate t + acceleration t²/2 for t from 0 to `duration_s`.
#[must_use]
#[inline]
pub fn min_quadratic<R: Real>(value: R, rate: R, acceleration: R, duration_s: R) -> R {
    let zero = R::from_f64(0.0);
    let half = R::from_f64(0.5);
    let at_end = value + (rate + half * acceleration * duration_s) * duration_s;
    let turns_inside = zero.greater_than(rate)
        & acceleration.greater_than(zero)
        & (rate + acceleration * duration_s).greater_than(zero);
    R::select(
        turns_inside,
        || value - half * rate * rate / acceleration,
        || value.smaller(at_end),
    )
}
