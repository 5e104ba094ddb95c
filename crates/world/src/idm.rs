//! The Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000)).

use crate::observation::Observation;
use crate::settings::settings;

/// A gap below this counts as this, in metres: the model divides by the gap, and an estimated one can be negative.
const MIN_GAP_M: f64 = 0.01;

settings! {
    /// Settings of the Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000), eq. 3 and 4).
    IdmSettings {
        /// Speed on a free road, in m/s. Default: 120 km/h, the paper's table I.
        desired_speed_mps: 120.0 / 3.6, 0.1..=100.0, 5.0..=45.0;
        /// Desired time headway, in seconds. Default 1.6, the paper's table I.
        time_headway_s: 1.6, 0.0..=10.0, 0.0..=3.0;
        /// Gap at standstill, in metres.
        standstill_gap_m: 2.0, 0.0..=100.0, 0.0..=5.0;
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
    /// What the model consists of, for those who drive many at once and keep each number in an array.
    pub(crate) fn to_array(&self) -> [f64; 5] {
        [self.desired_speed_mps, self.time_headway_s, self.standstill_gap_m, self.accel_mps2, self.twice_mean_mps2]
    }

    /// The model with given [`numbers`](Self::numbers).
    #[inline(always)]
    pub(crate) fn from_array(numbers: [f64; 5]) -> Self {
        let [desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, twice_mean_mps2] = numbers;
        Self { desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, twice_mean_mps2 }
    }

    /// The acceleration wanted at `speed_mps`, with the gap to and the speed of the vehicle ahead.
    #[inline(always)]
    pub(crate) fn acceleration_mps2(&self, speed_mps: f64, ahead: Option<[f64; 2]>) -> f64 {
        let squared = |value: f64| value * value;
        let free = 1.0 - squared(squared(speed_mps / self.desired_speed_mps));
        let interaction = ahead.map_or(0.0, |ahead| self.interaction(speed_mps, ahead));
        self.accel_mps2 * (free - interaction)
    }

    /// (s*/s)²: what the vehicle ahead takes away, as a share of the largest acceleration.
    #[inline(always)]
    fn interaction(&self, speed_mps: f64, [gap_m, ahead_mps]: [f64; 2]) -> f64 {
        let closing_mps = speed_mps - ahead_mps;
        let dynamic_m = speed_mps * self.time_headway_s + speed_mps * closing_mps / self.twice_mean_mps2;
        let share = (self.standstill_gap_m + dynamic_m.max(0.0)) / gap_m.max(MIN_GAP_M);
        share * share
    }

    /// Deceleration for the vehicle ahead alone, in m/s², never negative: a (s*/s)², whatever speed would be wanted on a
    /// free road.
    pub(crate) fn interaction_brake_mps2(&self, speed_mps: f64, ahead: [f64; 2]) -> f64 {
        self.accel_mps2 * self.interaction(speed_mps, ahead)
    }
}

impl Idm {
    /// The acceleration wanted, in m/s².
    #[inline]
    pub(crate) fn desired_acceleration_mps2(&self, seen: &Observation) -> f64 {
        self.acceleration_mps2(seen.speed_mps, seen.ahead.map(|ahead| [ahead.gap_m, ahead.speed_mps]))
    }
}

impl From<&IdmSettings> for Idm {
    fn from(settings: &IdmSettings) -> Self {
        let IdmSettings { desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, comfortable_brake_mps2 } =
            *settings;
        let twice_mean_mps2 = 2.0 * (accel_mps2 * comfortable_brake_mps2).sqrt();
        Self { desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, twice_mean_mps2 }
    }
}
