//! One noisy sensor.

use std::sync::Arc;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use crate::random::{NoiseBlocks, NoiseStream, Purpose};
use crate::scenario::Sensors;

/// A distance sensor with normal noise and random dropouts.
#[derive(Debug, Clone)]
pub struct Sensor {
    stream: NoiseStream,
    noise_m: f64,
    dropout: f64,
}

impl Sensor {
    /// Creates the sensor of vehicle `vehicle` for `purpose`, with noise of standard deviation `noise_m`.
    #[must_use]
    pub fn new(seed: u64, purpose: Purpose, vehicle: usize, noise_m: f64, sensors: &Sensors) -> Self {
        Self { stream: NoiseStream::new(seed, purpose, vehicle as u64), noise_m, dropout: sensors.dropout }
    }

    /// Gives each block of measurements its own seed.
    pub fn set_noise_blocks(&mut self, blocks: &Arc<NoiseBlocks>) {
        self.stream.set_blocks(blocks);
    }

    /// Measures a distance; `None` if the measurement was lost.
    #[inline]
    pub fn measure(&mut self, distance_m: f64) -> Option<f64> {
        // Lost measurements draw noise too, so that a dropout does not shift all later noise.
        let stream = self.stream.advance(1);
        let normal: f64 = StandardNormal.sample(stream);
        let lost = self.dropout > 0.0 && stream.random::<f64>() < self.dropout;
        if lost { None } else { Some(distance_m + self.noise_m * normal) }
    }
}
