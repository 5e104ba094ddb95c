//! Independent uniform points: the reference search of every other method.

use rand::RngExt;

use super::{SearchAlgorithm, UnitCube};
use crumple_sim::random::{Purpose, Stream, stream};

const BATCH_SIZE: usize = 32;

#[derive(Debug)]
pub(super) struct UniformSearch {
    random: Stream,
    dimension: usize,
}

impl UniformSearch {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        Self {
            random: stream(seed, Purpose::Search, 0),
            dimension: cube.dimension(),
        }
    }
}

impl SearchAlgorithm for UniformSearch {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        (0..BATCH_SIZE)
            .map(|_| (0..self.dimension).map(|_| self.random.random()).collect())
            .collect()
    }

    fn tell(&mut self, _robustness: &[f64]) {}
}
