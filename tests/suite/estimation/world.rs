//! The motion model that the filter assumes.

use crumple_sim::estimate::{EgoTuning, Filter, Tuning};
use crumple_sim::random::{Purpose, Stream, stream};
use crumple_sim::scenario::Sensors;
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// A distance with white jerk of the density that corresponds to the filter's bandwidth.
pub(super) struct WhiteJerk {
    state: Vector3<f64>,
    transition: Matrix3<f64>,
    root: Matrix3<f64>,
    stream: Stream,
}

impl WhiteJerk {
    pub(super) const STEP_S: f64 = 0.01;
    const BANDWIDTH_RAD_PER_S: f64 = 5.0;

    /// Returns the tuning of a gap sensor's filter, a world, and such a filter in steady state.
    pub(super) fn with_filter(sensors: &Sensors, run: u64) -> (Tuning, Self, Filter) {
        let mut world = Self::new(sensors.gap_noise_m, run);
        let tuning = EgoTuning::new(Self::STEP_S, sensors).gap().clone();
        let normals = [0; 3].map(|_| world.normal());
        let filter = Filter::new_steady(&tuning, world.state.x, world.state.y, normals);
        (tuning, world, filter)
    }

    fn new(noise_m: f64, run: u64) -> Self {
        let h = Self::STEP_S;
        // The density q = ω⁶ σ² h, and the covariance that it adds per step.
        let density = Self::BANDWIDTH_RAD_PER_S.powi(6) * noise_m * noise_m * h;
        let integrals = |row: i32, column: i32| {
            let factorial = |n: i32| f64::from((1..=n).product::<i32>());
            // Jerk at time t before the step's end moves component i by t^(2-i) / (2-i)!.
            let (p, q) = (2 - row, 2 - column);
            density * h.powi(p + q + 1) / (f64::from(p + q + 1) * factorial(p) * factorial(q))
        };
        let gained = Matrix3::from_fn(|row, column| integrals(row as i32, column as i32));
        Self {
            state: Vector3::new(16.0, 0.0, 0.0),
            transition: Matrix3::new(1.0, h, h * h / 2.0, 0.0, 1.0, h, 0.0, 0.0, 1.0),
            root: gained.cholesky().expect("positive definite").l(),
            stream: stream(run, Purpose::ScenarioSampling, 0),
        }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.stream)
    }

    pub(super) fn step(&mut self) {
        let normals = Vector3::from([0; 3].map(|_| self.normal()));
        self.state = self.transition * self.state + self.root * normals;
    }

    pub(super) fn distance_m(&self) -> f64 {
        self.state.x
    }

    /// Returns the error of the filter's prediction of this instant.
    pub(super) fn prediction_error(&self, tuning: &Tuning, filter: &Filter) -> [f64; 3] {
        // Without a measurement the filter returns its prediction.
        let predicted = filter.clone().update(tuning, None);
        (Vector3::new(
            predicted.distance_m,
            predicted.rate_mps,
            predicted.acceleration_mps2,
        ) - self.state)
            .into()
    }
}
