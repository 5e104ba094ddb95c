//! The Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000)).

use crate::observation::Observation;
use crate::settings::settings;

/// Minimum gap that the model divides by, in metres; an estimated gap can be negative.
pub(crate) const MIN_GAP_M: f64 = 0.01;
/// Default gap at standstill, in metres.
pub(crate) const STANDSTILL_GAP_M: f64 = 2.0;

settings! {
    /// Settings of the Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000), eq. 3,
    /// 4).
    IdmSettings {
        /// Speed on a free road, in m/s. Default: 120 km/h, the paper's table I.
        desired_speed_mps: 120.0 / 3.6, 0.1..=100.0, 5.0..=45.0;
        /// Desired time headway, in seconds. Default 1.6, the paper's table I.
        time_headway_s: 1.6, 0.0..=10.0, 0.0..=3.0;
        /// Gap at standstill, in metres.
        standstill_gap_m: STANDSTILL_GAP_M, 0.0..=100.0, 0.0..=5.0;
        /// Largest acceleration, in m/s².
        accel_mps2: 0.73, 0.01..=30.0, 0.1..=4.0;
        /// Comfortable deceleration, in m/s², positive.
        comfortable_brake_mps2: 1.67, 0.01..=30.0, 0.1..=4.0;
    }
}

/// a · [1 - (v/v₀)⁴ - (s*/s)²] with the desired gap s* = s₀ + max(0, v T + v Δv / (2 √(a b))) (equations 3 and 4).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Idm {
    desired_speed_mps: f64,
    time_headway_s: f64,
    standstill_gap_m: f64,
    accel_mps2: f64,
    /// 2 √(a b).
    twice_mean_mps2: f64,
}

impl Idm {
    /// Returns the parameters as an array, for code that stores many models as one array per parameter.
    pub(crate) fn to_array(self) -> [f64; 5] {
        [
            self.desired_speed_mps,
            self.time_headway_s,
            self.standstill_gap_m,
            self.accel_mps2,
            self.twice_mean_mps2,
        ]
    }

    #[inline(always)]
    pub(crate) fn from_array(numbers: [f64; 5]) -> Self {
        let [
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            twice_mean_mps2,
        ] = numbers;
        Self {
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            twice_mean_mps2,
        }
    }

    /// Returns the desired acceleration at `speed_mps`, given gap and speed of the leader.
    #[inline(always)]
    pub(crate) fn acceleration_mps2(&self, speed_mps: f64, ahead: Option<[f64; 2]>) -> f64 {
        let free = 1.0 - squared(squared(speed_mps / self.desired_speed_mps));
        let interaction = ahead.map_or(0.0, |ahead| self.interaction(speed_mps, ahead));
        self.accel_mps2 * (free - interaction)
    }

    /// Returns (s*/s)²: the reduction by the leader, as a share of the maximum acceleration.
    #[inline(always)]
    fn interaction(&self, speed_mps: f64, [gap_m, ahead_mps]: [f64; 2]) -> f64 {
        let closing_mps = speed_mps - ahead_mps;
        let dynamic_m =
            speed_mps * self.time_headway_s + speed_mps * closing_mps / self.twice_mean_mps2;
        let share = (self.standstill_gap_m + dynamic_m.max(0.0)) / gap_m.max(MIN_GAP_M);
        share * share
    }

    /// Returns the deceleration a (s*/s)² because of the leader alone, in m/s², never negative.
    #[must_use]
    pub fn interaction_brake_mps2(&self, speed_mps: f64, ahead: [f64; 2]) -> f64 {
        self.accel_mps2 * self.interaction(speed_mps, ahead)
    }
}

impl Idm {
    #[inline]
    pub(crate) fn desired_acceleration_mps2(&self, observation: &Observation) -> f64 {
        self.acceleration_mps2(
            observation.speed_mps,
            observation
                .ahead
                .map(|ahead| [ahead.gap_m, ahead.speed_mps]),
        )
    }
}

impl From<&IdmSettings> for Idm {
    fn from(settings: &IdmSettings) -> Self {
        let IdmSettings {
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            comfortable_brake_mps2,
        } = *settings;
        let twice_mean_mps2 = 2.0 * (accel_mps2 * comfortable_brake_mps2).sqrt();
        Self {
            desired_speed_mps,
            time_headway_s,
            standstill_gap_m,
            accel_mps2,
            twice_mean_mps2,
        }
    }
}

#[inline(always)]
fn squared(value: f64) -> f64 {
    value * value
}
