//! CMA-ES with restarts and growing populations.
//!
//! The strategy and its constants are those of Hansen's tutorial (The CMA evolution strategy, 2016, arXiv:1604.00772).
//! It restarts with twice the population after stagnation (Auger and Hansen, IPOP-CMA-ES, CEC 2005).

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::method::nan_as_infinity;
use super::{SearchAlgorithm, UnitCube};
use crumple_sim::random::{Purpose, Stream, stream};

/// Maximum population after restarts, as a multiple of the first one.
const MAX_GROWTH: usize = 32;
/// Initial step size, relative to the cube: the tutorial's 0.3 of the range.
pub(super) const INITIAL_SIGMA: f64 = 0.3;
/// Maximum condition number of the covariance; beyond it the numerical error is too large.
const MAX_CONDITION_NUMBER: f64 = 1e14;

/// CMA-ES with restarts. The first run starts at the centre, later ones at random points.
#[derive(Debug)]
pub(super) struct CmaEs {
    random: Stream,
    initial_population: usize,
    growth: usize,
    run: CmaRun,
}

/// One run, from a start to stagnation. Points outside the cube are projected, so that extreme inputs are reached.
#[derive(Debug)]
pub(super) struct CmaRun {
    population: usize,
    pending: Vec<DVector<f64>>,
    mean: DVector<f64>,
    sigma: f64,
    initial_sigma: f64,
    covariance: DMatrix<f64>,
    /// Eigenvectors of the covariance, and the square roots of its eigenvalues.
    axes: DMatrix<f64>,
    lengths: DVector<f64>,
    path_sigma: DVector<f64>,
    path_covariance: DVector<f64>,
    generation: usize,
    recent_best_values: Vec<f64>,
}

/// Constants of the tutorial's table 1, without negative weights.
#[derive(Debug)]
struct Constants {
    weights: Vec<f64>,
    mu_eff: f64,
    c_sigma: f64,
    d_sigma: f64,
    c_c: f64,
    c_1: f64,
    c_mu: f64,
    expected_norm: f64,
}

impl Constants {
    fn new(dimension: usize, population: usize) -> Self {
        let n = dimension as f64;
        let half = (population as f64 + 1.0) / 2.0;
        let raw: Vec<f64> = (1..=population / 2)
            .map(|rank| half.ln() - (rank as f64).ln())
            .collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|w| w / sum).collect();
        let mu_eff = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0);
        let d_sigma = 1.0 + 2.0 * (((mu_eff - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + c_sigma;
        let c_c = (4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n);
        let c_1 = 2.0 / ((n + 1.3).powi(2) + mu_eff);
        let c_mu = (2.0 * (0.25 + mu_eff + 1.0 / mu_eff - 2.0) / ((n + 2.0).powi(2) + mu_eff))
            .min(1.0 - c_1);
        let expected_norm = n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n));
        Self {
            weights,
            mu_eff,
            c_sigma,
            d_sigma,
            c_c,
            c_1,
            c_mu,
            expected_norm,
        }
    }
}

impl CmaEs {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let dimension = cube.dimension();
        let population = default_population(dimension);
        Self {
            random: stream(seed, Purpose::Search, 0),
            initial_population: population,
            growth: 1,
            run: CmaRun::new(vec![0.5; dimension], INITIAL_SIGMA, population),
        }
    }
}

impl SearchAlgorithm for CmaEs {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        if self.run.has_stagnated() {
            self.growth = (2 * self.growth).min(MAX_GROWTH);
            let start = self.run.mean.iter().map(|_| self.random.random()).collect();
            self.run = CmaRun::new(start, INITIAL_SIGMA, self.initial_population * self.growth);
        }
        self.run.ask(&mut self.random)
    }

    fn tell(&mut self, robustness: &[f64]) {
        self.run.tell(robustness);
    }
}

/// Returns the default population of the tutorial, equation 48.
pub(super) fn default_population(dimension: usize) -> usize {
    4 + (3.0 * (dimension as f64).ln()) as usize
}

impl CmaRun {
    pub(super) fn new(start: Vec<f64>, sigma: f64, population: usize) -> Self {
        let n = start.len();
        Self {
            population,
            pending: Vec::new(),
            mean: DVector::from_vec(start),
            sigma,
            initial_sigma: sigma,
            covariance: DMatrix::identity(n, n),
            axes: DMatrix::identity(n, n),
            lengths: DVector::from_element(n, 1.0),
            path_sigma: DVector::zeros(n),
            path_covariance: DVector::zeros(n),
            generation: 0,
            recent_best_values: Vec::new(),
        }
    }

    pub(super) fn ask(&mut self, random: &mut Stream) -> Vec<Vec<f64>> {
        self.pending = (0..self.population).map(|_| self.sample(random)).collect();
        self.pending
            .iter()
            .map(|point| point.iter().copied().collect())
            .collect()
    }

    /// Returns as many points as [`CmaRun::ask`]. Draws `among` times as many samples and keeps those with the lowest
    /// `score`.
    pub(super) fn ask_screened(
        &mut self,
        random: &mut Stream,
        among: usize,
        score: impl Fn(&[f64]) -> f64,
    ) -> Vec<Vec<f64>> {
        let mut candidates: Vec<(f64, DVector<f64>)> = (0..self.population * among)
            .map(|_| self.sample(random))
            .map(|point| (score(point.as_slice()), point))
            .collect();
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        candidates.truncate(self.population);
        self.pending = candidates.into_iter().map(|(_, point)| point).collect();
        self.pending
            .iter()
            .map(|point| point.iter().copied().collect())
            .collect()
    }

    pub(super) fn tell(&mut self, robustness: &[f64]) {
        // Ignore a generation that the budget cut short.
        if robustness.len() < self.population {
            return;
        }
        let points = std::mem::take(&mut self.pending);
        let mut ranked: Vec<(f64, &DVector<f64>)> = robustness
            .iter()
            .map(|&value| nan_as_infinity(value))
            .zip(&points)
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.learn(&ranked);
    }

    fn sample(&self, random: &mut Stream) -> DVector<f64> {
        let normal: DVector<f64> =
            DVector::from_fn(self.mean.len(), |_, _| StandardNormal.sample(random));
        let step = &self.axes * self.lengths.component_mul(&normal);
        (&self.mean + step * self.sigma).map(|x| x.clamp(0.0, 1.0))
    }

    /// Applies equations 39 to 47 of the tutorial to a population sorted from the best to the worst.
    fn learn(&mut self, ranked: &[(f64, &DVector<f64>)]) {
        let constants = Constants::new(self.mean.len(), self.population);
        let steps: Vec<DVector<f64>> = ranked
            .iter()
            .map(|(_, point)| (*point - &self.mean) / self.sigma)
            .collect();
        let mut mean_step = DVector::zeros(self.mean.len());
        for (weight, step) in constants.weights.iter().zip(&steps) {
            mean_step.axpy(*weight, step, 1.0);
        }
        self.mean += &mean_step * self.sigma;
        self.generation += 1;
        let moving = self.update_paths(&constants, &mean_step);
        self.update_covariance(&constants, &steps, moving);
        let Constants {
            c_sigma,
            d_sigma,
            expected_norm,
            ..
        } = constants;
        self.sigma *= ((c_sigma / d_sigma) * (self.path_sigma.norm() / expected_norm - 1.0))
            .min(1.0)
            .exp();
        self.decompose_covariance();
        self.recent_best_values
            .extend(ranked.first().map(|(value, _)| *value));
        // Equal best and median indicate a plateau; wider steps may leave it.
        if ranked.first().map(|r| r.0) == ranked.get(self.population / 2).map(|r| r.0) {
            self.sigma *= (0.2 + c_sigma / d_sigma).exp();
        }
    }

    /// Updates both evolution paths. Returns false if the path of the step size is so long that that of the covariance
    /// did not receive the step.
    fn update_paths(&mut self, constants: &Constants, mean_step: &DVector<f64>) -> bool {
        let n = self.mean.len() as f64;
        let &Constants {
            mu_eff,
            c_sigma,
            c_c,
            expected_norm,
            ..
        } = constants;
        let whitened = &self.axes * (self.axes.tr_mul(mean_step)).component_div(&self.lengths);
        self.path_sigma *= 1.0 - c_sigma;
        self.path_sigma += whitened * (c_sigma * (2.0 - c_sigma) * mu_eff).sqrt();
        let settled = (1.0 - (1.0 - c_sigma).powf(2.0 * self.generation as f64)).sqrt();
        let moving = self.path_sigma.norm() / settled < (1.4 + 2.0 / (n + 1.0)) * expected_norm;
        self.path_covariance *= 1.0 - c_c;
        if moving {
            self.path_covariance += mean_step * (c_c * (2.0 - c_c) * mu_eff).sqrt();
        }
        moving
    }

    fn update_covariance(&mut self, constants: &Constants, steps: &[DVector<f64>], moving: bool) {
        let &Constants { c_c, c_1, c_mu, .. } = constants;
        let lost = if moving { 0.0 } else { c_1 * c_c * (2.0 - c_c) };
        self.covariance *= 1.0 + lost - c_1 - c_mu;
        self.covariance
            .ger(c_1, &self.path_covariance, &self.path_covariance, 1.0);
        for (weight, step) in constants.weights.iter().zip(steps) {
            self.covariance.ger(c_mu * weight, step, step, 1.0);
        }
    }

    fn decompose_covariance(&mut self) {
        let eigen = SymmetricEigen::new(self.covariance.clone());
        self.lengths = eigen.eigenvalues.map(|value| value.max(1e-30).sqrt());
        self.axes = eigen.eigenvectors;
    }

    pub(super) fn spread(&self) -> f64 {
        self.lengths.max() * self.sigma
    }

    /// Returns true if a termination criterion of the IPOP paper that applies to a unit cube holds.
    pub(super) fn has_stagnated(&self) -> bool {
        let spread = self.spread();
        let condition = (self.lengths.max() / self.lengths.min()).powi(2);
        let window = 10 + 30 * self.mean.len() / self.population;
        let recent = self.recent_best_values.iter().rev().take(window).copied();
        let least = recent.clone().fold(f64::INFINITY, f64::min);
        let most = recent.fold(f64::NEG_INFINITY, f64::max);
        let flat =
            self.recent_best_values.len() >= window && most - least <= 1e-12 * (1.0 + most.abs());
        let lost =
            !spread.is_finite() || !least.is_finite() && self.recent_best_values.len() >= window;
        spread < 1e-12 * self.initial_sigma
            || spread > 1e4
            || condition > MAX_CONDITION_NUMBER
            || flat
            || lost
    }
}
