//! Simulated annealing with adaptive steps.
//!
//! Metropolis acceptance, one coordinate per move, with steps that adapt to half acceptance (Corana et al., ACM
//! Transactions on Mathematical Software 13, 1987). The temperature falls geometrically over a cycle; the next cycle
//! starts at the best point.

use rand::RngExt;

use super::method::nan_as_infinity;
use super::{SearchAlgorithm, UnitCube};
use crumple_world::random::{Purpose, Stream, stream};

const MOVES_PER_COORDINATE: usize = 100;
/// Temperature at the end of a cycle, relative to its start.
const FINAL_TEMPERATURE_RATIO: f64 = 1e-6;
/// Number of uniform points whose spread sets the initial temperature.
const WARM_UP_POINTS: usize = 16;

#[derive(Debug)]
pub(super) struct Annealing {
    random: Stream,
    dimension: usize,
    warm_up_values: Vec<f64>,
    current: (f64, Vec<f64>),
    best: (f64, Vec<f64>),
    steps: Vec<f64>,
    moves: usize,
    pending: Vec<Vec<f64>>,
}

impl Annealing {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        Self {
            random: stream(seed, Purpose::Search, 0),
            dimension: cube.dimension(),
            warm_up_values: Vec::new(),
            current: (f64::INFINITY, vec![0.5; cube.dimension()]),
            best: (f64::INFINITY, vec![0.5; cube.dimension()]),
            steps: vec![0.5; cube.dimension()],
            moves: 0,
            pending: Vec::new(),
        }
    }

    fn temperature(&self) -> f64 {
        let finite = || self.warm_up_values.iter().filter(|value| value.is_finite());
        let count = finite().count().max(1) as f64;
        let mean = finite().sum::<f64>() / count;
        let spread = (finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        let cycle = MOVES_PER_COORDINATE * self.dimension;
        spread * FINAL_TEMPERATURE_RATIO.powf((self.moves % cycle) as f64 / cycle as f64)
    }

    fn current_coordinate(&self) -> usize {
        self.moves % self.dimension
    }
}

impl SearchAlgorithm for Annealing {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.pending = if self.warm_up_values.is_empty() {
            (0..WARM_UP_POINTS).map(|_| (0..self.dimension).map(|_| self.random.random()).collect()).collect()
        } else {
            let mut point = self.current.1.clone();
            let coordinate = self.current_coordinate();
            if let (Some(x), Some(step)) = (point.get_mut(coordinate), self.steps.get(coordinate)) {
                *x = reflect(*x + step * self.random.random_range(-1.0..1.0));
            }
            vec![point]
        };
        self.pending.clone()
    }

    fn tell(&mut self, robustness: &[f64]) {
        let values = robustness.iter().map(|&value| nan_as_infinity(value));
        let costs: Vec<(f64, Vec<f64>)> = values.zip(std::mem::take(&mut self.pending)).collect();
        let Some(least) = costs.iter().min_by(|a, b| a.0.total_cmp(&b.0)).cloned() else { return };
        if least.0 < self.best.0 {
            self.best = least.clone();
        }
        if self.warm_up_values.is_empty() {
            self.warm_up_values = costs.iter().map(|(value, _)| *value).collect();
            self.current = least;
            return;
        }
        let rise = least.0 - self.current.0;
        // NaN: a move between two infinite values counts as no rise.
        let accepted = rise <= 0.0 || rise.is_nan() || self.random.random::<f64>() < (-rise / self.temperature()).exp();
        if accepted {
            self.current = least;
        }
        // Grows by a tenth if accepted and shrinks by as much if not, so it is stationary at half acceptance.
        let coordinate = self.current_coordinate();
        if let Some(step) = self.steps.get_mut(coordinate) {
            *step = (*step * if accepted { 1.1 } else { 1.0 / 1.1 }).clamp(1e-9, 0.5);
        }
        self.moves += 1;
        if self.moves.is_multiple_of(MOVES_PER_COORDINATE * self.dimension) {
            self.current = self.best.clone();
            self.steps.fill(0.5);
        }
    }
}

fn reflect(x: f64) -> f64 {
    let folded = x.rem_euclid(2.0);
    if folded > 1.0 { 2.0 - folded } else { folded }
}
