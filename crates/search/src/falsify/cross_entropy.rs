//! The cross-entropy method with independent normal coordinates.
//!
//! Follows Rubinstein and Kroese (The cross-entropy method, Springer 2004, section 5.1) with the recommended smoothing:
//! constant for the mean, and decreasing for the deviation, so that it does not collapse early.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::method::nan_as_infinity;
use super::{SearchAlgorithm, UnitCube};
use crumple_sim::random::{Purpose, Stream, stream};

const POPULATION: usize = 60;
const ELITE_SIZE: usize = 6;
const MEAN_SMOOTHING: f64 = 0.8;
const DEVIATION_SMOOTHING: f64 = 0.8;
const SMOOTHING_EXPONENT: f64 = 5.0;
/// Minimum deviation: if all are smaller, the distribution has collapsed, and the search restarts elsewhere.
const MIN_DEVIATION: f64 = 1e-5;

#[derive(Debug)]
pub(super) struct CrossEntropy {
    random: Stream,
    mean: Vec<f64>,
    deviation: Vec<f64>,
    generation: f64,
    pending: Vec<Vec<f64>>,
}

impl CrossEntropy {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let dimension = cube.dimension();
        Self {
            random: stream(seed, Purpose::Search, 0),
            mean: vec![0.5; dimension],
            deviation: vec![0.5; dimension],
            generation: 0.0,
            pending: Vec::new(),
        }
    }
}

impl CrossEntropy {
    fn sample(&mut self) -> Vec<f64> {
        self.mean
            .iter()
            .zip(&self.deviation)
            .map(|(mean, deviation)| {
                let normal: f64 = StandardNormal.sample(&mut self.random);
                (mean + deviation * normal).clamp(0.0, 1.0)
            })
            .collect()
    }
}

impl SearchAlgorithm for CrossEntropy {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        if self
            .deviation
            .iter()
            .all(|&deviation| deviation < MIN_DEVIATION)
        {
            self.mean
                .iter_mut()
                .for_each(|mean| *mean = self.random.random());
            self.deviation.fill(0.5);
            self.generation = 0.0;
        }
        self.pending = (0..POPULATION).map(|_| self.sample()).collect();
        self.pending.clone()
    }

    fn tell(&mut self, robustness: &[f64]) {
        if robustness.len() < POPULATION {
            return;
        }
        let mut ranked: Vec<(f64, &Vec<f64>)> = robustness
            .iter()
            .map(|&value| nan_as_infinity(value))
            .zip(&self.pending)
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        ranked.truncate(ELITE_SIZE);
        self.generation += 1.0;
        let fading = DEVIATION_SMOOTHING
            - DEVIATION_SMOOTHING * (1.0 - 1.0 / self.generation).powf(SMOOTHING_EXPONENT);
        for (i, (mean, deviation)) in self.mean.iter_mut().zip(&mut self.deviation).enumerate() {
            let elite = ranked.iter().filter_map(|(_, point)| point.get(i));
            let centre = elite.clone().sum::<f64>() / ELITE_SIZE as f64;
            let squares = elite.map(|x| (x - centre).powi(2));
            let spread = (squares.sum::<f64>() / ELITE_SIZE as f64).sqrt();
            *mean += MEAN_SMOOTHING * (centre - *mean);
            *deviation += fading * (spread - *deviation);
        }
    }
}
