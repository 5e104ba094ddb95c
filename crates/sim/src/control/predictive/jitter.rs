//! Noise of an estimated acceleration, from its changes between steps.

use crate::observation::BANDWIDTH_RAD_PER_S;

/// Time over which changes are averaged, in seconds.
const AVERAGING_S: f64 = 1.0;
/// Initial variance of the changes, in (m/s²)²: the one that gap noise of 0.1 m causes.
const FIRST_VARIANCE: f64 = 0.0156;

/// Recursive variance of the changes of an acceleration between steps.
///
/// In steady state each change is the filter's gain ω³ h times a white residual of standard deviation σ, and the
/// standard deviation of the acceleration is sqrt(2 ω⁵ h) σ (`estimate::filter`). The ratio is sqrt(2 / (ω h)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Jitter {
    step_s: f64,
    last_mps2: Option<f64>,
    variance: f64,
}

impl Jitter {
    pub(super) fn new(step_s: f64) -> Self {
        Self {
            step_s,
            last_mps2: None,
            variance: FIRST_VARIANCE,
        }
    }

    /// Adds the acceleration of this step. `expected_mps2` is the part of the change that was commanded.
    pub(super) fn observe(&mut self, acceleration_mps2: f64, expected_mps2: f64) {
        if let Some(last_mps2) = self.last_mps2 {
            let change_mps2 = acceleration_mps2 - last_mps2 - expected_mps2;
            // Rare jumps of the motion are no noise.
            let square = (change_mps2 * change_mps2).min(9.0 * self.variance + 1e-3);
            self.variance += (self.step_s / AVERAGING_S).min(1.0) * (square - self.variance);
        }
        self.last_mps2 = Some(acceleration_mps2);
    }

    /// Returns the variance of the estimated acceleration, in (m/s²)².
    pub(super) fn acceleration_variance(&self) -> f64 {
        self.variance * 2.0 / (BANDWIDTH_RAD_PER_S * self.step_s)
    }
}
