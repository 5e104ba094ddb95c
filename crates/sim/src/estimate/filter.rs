//! A Kalman filter for one measured distance: state (distance, rate, acceleration), white jerk.
//!
//! Over a step h the state moves by F = [1 h h²/2; 0 1 h; 0 0 1] and gains the covariance of white jerk of spectral
//! density q (Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, section
//! 6.2.3); the measurement is the distance with standard deviation σ.
//!
//! Tuning by one number: the filter's bandwidth ω. In steady state its poles form a third-order Butterworth pattern at
//! ω = (q / (σ² h))^(1/6), and the standard deviations are sqrt(3 ω³ σ² h) for the rate and sqrt(2 ω⁵ σ² h) for the
//! acceleration. A larger ω follows a braking vehicle sooner and is noisier.
//!
//! Jumps of the acceleration are not white jerk. A known jump, such as one of the own motion, is fed forward
//! ([`Filter::feed_forward`]) without a change of the covariance: a known input adds no uncertainty.

mod matrix;

use matrix::{Matrix3, Vector3};

/// Doublings of the horizon after which the covariance is steady: 2²⁴ steps.
const DOUBLINGS: usize = 24;

/// Number of steps after which the response to a manoeuvre has faded for any tuning.
const MAX_STEPS_TO_FADE: f64 = 1e5;

/// Constants of a filter, computed once and shared by all filters of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuning {
    step_s: f64,
    transition: Matrix3,
    process_noise: Matrix3,
    measurement_variance: f64,
    /// Covariance before a measurement in steady state, if no measurement is lost.
    steady_covariance: Matrix3,
    steady_gain: Vector3,
    steady_cholesky: Matrix3,
}

impl Tuning {
    /// Computes the filter for measurements every `step_s` seconds with standard deviation `noise_m`, at a bandwidth in
    /// rad/s.
    ///
    /// Noise is at least 0.1 mm, which keeps the covariance positive definite.
    #[must_use]
    pub fn new(step_s: f64, noise_m: f64, bandwidth_rad_per_s: f64) -> Self {
        let h = step_s;
        let measurement_variance = noise_m.max(1e-4).powi(2);
        let jerk_density = bandwidth_rad_per_s.powi(6) * measurement_variance * h;
        #[rustfmt::skip]
        let transition = Matrix3([
            [1.0, h, h * h / 2.0],
            [0.0, 1.0, h],
            [0.0, 0.0, 1.0],
        ]);
        #[rustfmt::skip]
        let process = Matrix3([
            [h.powi(5) / 20.0, h.powi(4) / 8.0, h.powi(3) / 6.0],
            [h.powi(4) / 8.0, h.powi(3) / 3.0, h.powi(2) / 2.0],
            [h.powi(3) / 6.0, h.powi(2) / 2.0, h],
        ]) * jerk_density;
        let steady = steady_covariance(&transition, &process, measurement_variance);
        Self {
            step_s,
            transition,
            process_noise: process,
            measurement_variance,
            steady_covariance: steady,
            steady_gain: gain(&steady, measurement_variance),
            steady_cholesky: steady.cholesky().unwrap_or_default(),
        }
    }

    /// Returns the time between measurements, in seconds.
    #[must_use]
    pub fn step_s(&self) -> f64 {
        self.step_s
    }

    /// Returns steady-state standard deviations before a measurement: distance (m), rate (m/s), acceleration (m/s²).
    #[must_use]
    pub fn steady_deviations(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| self.steady_covariance.0[i][i].sqrt())
    }

    /// Returns the largest errors of distance (s²) and rate (s) for an acceleration in [-1, 1] m/s² that varies from
    /// step to step.
    ///
    /// The error is linear in the acceleration, so its maximum is the sum of the absolute responses to a unit step. A
    /// constant acceleration causes no steady error. The error for a range of accelerations therefore depends on half
    /// its width, not on its middle.
    pub(crate) fn manoeuvre_errors(&self) -> [f64; 2] {
        let h = self.step_s;
        let mut filter = Filter::new_steady(self, 0.0, 0.0, [0.0; 3]);
        filter.update(self, Some(0.0));
        let mut distance_m = 0.5 * h * h;
        let mut worst = [0.0; 2];
        loop {
            let estimate = filter.update(self, Some(distance_m));
            let errors = [distance_m - estimate.distance_m, h - estimate.rate_mps].map(f64::abs);
            worst = [worst[0] + errors[0], worst[1] + errors[1]];
            distance_m += h * h;
            let faded = errors[1] < 1e-12 * h && errors[0] < 1e-12 * h * h;
            if faded || distance_m > MAX_STEPS_TO_FADE * h * h {
                return worst;
            }
        }
    }

    fn gain(&self, covariance: &Matrix3) -> Vector3 {
        gain(covariance, self.measurement_variance)
    }

    /// Returns the covariance after a measurement, in Joseph's form, which stays symmetric and positive.
    fn correct_covariance(&self, covariance: &Matrix3) -> Matrix3 {
        let gain = self.gain(covariance);
        let mut rest = Matrix3::IDENTITY;
        for (row, gain) in rest.0.iter_mut().zip(gain) {
            row[0] -= gain;
        }
        rest * *covariance * rest.transpose()
            + Matrix3::outer_product(&gain, &gain) * self.measurement_variance
    }

    fn predict_covariance(&self, covariance: &Matrix3) -> Matrix3 {
        let next = self.transition * *covariance * self.transition.transpose() + self.process_noise;
        (next + next.transpose()) * 0.5
    }
}

/// Returns the gain of a measurement of the distance.
fn gain(covariance: &Matrix3, measurement_variance: f64) -> Vector3 {
    let innovation_variance = covariance.0[0][0] + measurement_variance;
    covariance
        .first_column()
        .map(|value| value / innovation_variance)
}

/// Solves the discrete Riccati equation for the steady covariance before a measurement. Each iteration of the
/// structure-preserving doubling algorithm (Chu, Fan, Lin and Wang, Int. J. Control 77(8), 2004) doubles the horizon.
fn steady_covariance(
    transition: &Matrix3,
    process: &Matrix3,
    measurement_variance: f64,
) -> Matrix3 {
    let mut a = transition.transpose();
    let mut g = Matrix3::default();
    g.0[0][0] = measurement_variance.recip();
    let mut h = *process;
    for _ in 0..DOUBLINGS {
        let Some(inverse) = (Matrix3::IDENTITY + g * h).inverse() else {
            break;
        };
        let next_a = a * inverse * a;
        let next_g = g + a * inverse * g * a.transpose();
        let next_h = h + a.transpose() * h * inverse * a;
        let settled = next_h == h;
        (a, g, h) = (next_a, next_g, (next_h + next_h.transpose()) * 0.5);
        if settled {
            break;
        }
    }
    h
}

/// Difference between a measurement and its prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Measured minus predicted distance, in metres.
    pub residual_m: f64,
    /// Expected variance, in m².
    pub variance_m2: f64,
}

/// Estimate of a distance and its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DistanceEstimate {
    /// Distance in metres.
    pub distance_m: f64,
    /// Rate of the distance, in m/s.
    pub rate_mps: f64,
    /// Second derivative, in m/s².
    pub acceleration_mps2: f64,
}

impl DistanceEstimate {
    #[inline]
    fn changed(self, tuning: &Tuning, change: &KnownChange, sign: f64) -> Self {
        Self {
            distance_m: self.distance_m + sign * (0.5 * tuning.step_s * change.rate_mps),
            rate_mps: self.rate_mps + sign * change.rate_mps,
            acceleration_mps2: self.acceleration_mps2 + sign * change.acceleration_mps2,
        }
    }
}

/// Known change of the motion over the step that ends now, relative to constant acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownChange {
    /// Change of the rate, in m/s.
    pub rate_mps: f64,
    /// Change of the acceleration, in m/s².
    pub acceleration_mps2: f64,
}

/// Kalman filter of one distance.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    prediction: DistanceEstimate,
    /// Covariance of the prediction after a lost measurement; `None` in steady state.
    covariance: Option<Matrix3>,
}

impl Filter {
    /// Creates a filter in steady state, with an error drawn from the steady covariance.
    ///
    /// `normals` are three independent standard normal numbers.
    #[must_use]
    pub fn new_steady(tuning: &Tuning, distance_m: f64, rate_mps: f64, normals: [f64; 3]) -> Self {
        let [distance_error_m, rate_error_mps, acceleration_mps2] =
            tuning.steady_cholesky * normals;
        let predicted = DistanceEstimate {
            distance_m: distance_m + distance_error_m,
            rate_mps: rate_mps + rate_error_mps,
            acceleration_mps2,
        };
        Self {
            prediction: predicted,
            covariance: None,
        }
    }

    /// Compares a measurement with its prediction.
    #[must_use]
    pub fn innovation(&self, tuning: &Tuning, measured_m: f64) -> Innovation {
        let covariance = self
            .covariance
            .as_ref()
            .unwrap_or(&tuning.steady_covariance);
        Innovation {
            residual_m: measured_m - self.prediction.distance_m,
            variance_m2: covariance.0[0][0] + tuning.measurement_variance,
        }
    }

    /// Adds a known change of motion, times `sign`, to the prediction: the control input of the filter.
    ///
    /// The change is spread evenly over the step, so half of its rate counts for the distance.
    #[inline]
    pub fn feed_forward(&mut self, tuning: &Tuning, change: &KnownChange, sign: f64) {
        self.prediction = self.prediction.changed(tuning, change, sign);
    }

    /// Adds a known change of motion and applies a measurement, as [`Self::feed_forward`] and [`Self::update`] do. The
    /// prediction stays in registers: to store it and load it again at once takes longer than all else.
    #[inline]
    pub(super) fn advance(
        &mut self,
        tuning: &Tuning,
        change: &KnownChange,
        sign: f64,
        measured_m: Option<f64>,
    ) -> DistanceEstimate {
        self.update_prediction(
            tuning,
            self.prediction.changed(tuning, change, sign),
            measured_m,
        )
    }

    /// Applies this step's measurement, unless it was lost, and predicts the next step.
    ///
    /// Returns the estimate at the instant of the measurement.
    #[inline]
    pub fn update(&mut self, tuning: &Tuning, measured_m: Option<f64>) -> DistanceEstimate {
        self.update_prediction(tuning, self.prediction, measured_m)
    }

    #[inline]
    fn update_prediction(
        &mut self,
        tuning: &Tuning,
        mut estimate: DistanceEstimate,
        measured_m: Option<f64>,
    ) -> DistanceEstimate {
        if let Some(measured_m) = measured_m {
            let gain = match &self.covariance {
                None => tuning.steady_gain,
                Some(covariance) => tuning.gain(covariance),
            };
            let residual_m = measured_m - estimate.distance_m;
            estimate.distance_m += gain[0] * residual_m;
            estimate.rate_mps += gain[1] * residual_m;
            estimate.acceleration_mps2 += gain[2] * residual_m;
        }
        if measured_m.is_none() || self.covariance.is_some() {
            self.update_covariance(tuning, measured_m.is_some());
        }
        let h = tuning.step_s;
        self.prediction = DistanceEstimate {
            distance_m: estimate.distance_m
                + h * (estimate.rate_mps + 0.5 * h * estimate.acceleration_mps2),
            rate_mps: estimate.rate_mps + h * estimate.acceleration_mps2,
            acceleration_mps2: estimate.acceleration_mps2,
        };
        estimate
    }

    #[cold]
    fn update_covariance(&mut self, tuning: &Tuning, measured: bool) {
        let covariance = self.covariance.unwrap_or(tuning.steady_covariance);
        let covariance = if measured {
            tuning.correct_covariance(&covariance)
        } else {
            covariance
        };
        self.covariance = Some(tuning.predict_covariance(&covariance));
    }
}

#[cfg(test)]
mod tests;
