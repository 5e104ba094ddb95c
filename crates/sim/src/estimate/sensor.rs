//! One noisy sensor.

use crate::random::{NoiseShare, NoiseStream, Purpose};
use crate::scenario::Sensors;

/// A distance sensor with normal noise and random dropouts.
#[derive(Debug, Clone)]
pub struct Sensor {
    noise: NoiseStream,
    noise_m: f64,
    dropout: f64,
}

impl Sensor {
    /// Creates the sensor of vehicle `vehicle` for `purpose`, with noise of standard deviation `noise_m`.
    #[must_use]
    pub fn new(
        seed: u64,
        purpose: Purpose,
        vehicle: usize,
        noise_m: f64,
        sensors: &Sensors,
    ) -> Self {
        Self::with_noise_shares(seed, &[], purpose, vehicle, noise_m, sensors)
    }

    /// Creates the sensor with noise of shares, the first of which has the seed `seed`.
    #[must_use]
    pub fn with_noise_shares(
        seed: u64,
        shares: &[NoiseShare],
        purpose: Purpose,
        vehicle: usize,
        noise_m: f64,
        sensors: &Sensors,
    ) -> Self {
        let noise = NoiseStream::from_shares(seed, shares, purpose, vehicle as u64);
        Self {
            noise,
            noise_m,
            dropout: sensors.dropout,
        }
    }

    /// Measures a distance; `None` if the measurement was lost.
    #[inline]
    pub fn measure(&mut self, distance_m: f64) -> Option<f64> {
        // Lost measurements draw noise too, so that a dropout does not shift all later noise.
        let normal = self.noise.normal();
        let lost = self.dropout > 0.0 && self.noise.uniform() < self.dropout;
        if lost {
            None
        } else {
            Some(distance_m + self.noise_m * normal)
        }
    }
}
