//! Amplitudes of a sampled oscillation.

use std::f64::consts::TAU;

/// Sine and cosine of whole periods at evenly spaced samples.
pub(super) struct Wave {
    sin_cos: Vec<(f64, f64)>,
}

impl Wave {
    /// Samples `periods` whole periods; `periods` must be less than half of `samples`.
    pub(super) fn new(periods: usize, samples: usize) -> Self {
        let sin_cos = (0..samples).map(|sample| {
            // The remainder keeps the argument small, so that long windows lose no accuracy.
            let phase = TAU * ((periods * sample) % samples) as f64 / samples as f64;
            phase.sin_cos()
        });
        Self {
            sin_cos: sin_cos.collect(),
        }
    }

    /// Returns mean and amplitude of values at these samples: the projection on sine and cosine. It is exact for a sum
    /// of a constant and harmonics, because the samples are whole periods.
    pub(super) fn project(&self, values: &[f64]) -> [f64; 2] {
        let mut sum = 0.0;
        let mut sine = 0.0;
        let mut cosine = 0.0;
        for (value, (sin, cos)) in values.iter().zip(&self.sin_cos) {
            sum += value;
            sine += value * sin;
            cosine += value * cos;
        }
        let samples = self.sin_cos.len() as f64;
        [sum / samples, 2.0 * sine.hypot(cosine) / samples]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_of_a_constant_and_harmonics_has_the_amplitude_of_its_first() {
        let phase = |k: u32| 3.0 * TAU * f64::from(k) / 1001.0;
        let value = |k: u32| 20.0 + 0.3 * (phase(k) + 0.7).cos() + 0.2 * (2.0 * phase(k)).sin();
        let values: Vec<f64> = (0..1001).map(value).collect();
        let [mean, amplitude] = Wave::new(3, 1001).project(&values);
        assert!(
            (mean - 20.0).abs() < 1e-12 && (amplitude - 0.3).abs() < 1e-12,
            "{mean} {amplitude}"
        );
    }
}
