//! Independent replay: a second, plain implementation of the model, and the naive monitor.

use crate::ExperimentError;
use crate::work::chasing_cars::{ChasingCarsInputs, STEP_S};
use crumple_measure::stl::{Formula, SampledSignals, naive_robustness};

/// Ratio of the step to the finer step. Guards are checked per step, so violations may depend on it.
const FINER_STEP_DIVISOR: usize = 5;

/// Returns the robustness by an independent model and the naive monitor, which are orders of magnitude slower.
///
/// # Errors
/// An error if the formula does not fit the model.
pub(super) fn replayed_robustness(
    formula: &Formula,
    inputs: &ChasingCarsInputs,
) -> Result<f64, ExperimentError> {
    Ok(naive_robustness(formula, &replay(inputs, 1)?, 0)?)
}

/// Returns the robustness by the independent model at a step that is [`FINER_STEP_DIVISOR`] times as fine.
///
/// # Errors
/// An error if the formula does not fit the model.
pub(super) fn finer_robustness(
    formula: &Formula,
    inputs: &ChasingCarsInputs,
) -> Result<f64, ExperimentError> {
    Ok(formula.robustness(&replay(inputs, FINER_STEP_DIVISOR)?)?)
}

/// Returns the positions, simulated with `finer` steps per [`STEP_S`].
fn replay(
    inputs: &ChasingCarsInputs,
    finer: usize,
) -> Result<SampledSignals<'static>, ExperimentError> {
    let step_s = STEP_S / finer as f64;
    let mut cars: Vec<ReplayCar> = (0..5)
        .map(|i| ReplayCar {
            y: 10.0 * f64::from(i),
            v: 0.0,
            mode: "keeping",
        })
        .collect();
    let mut tracks: Vec<Vec<f64>> = cars.iter().map(|car| vec![car.y]).collect();
    for piece in 0..inputs.throttle.len() {
        for _ in 0..500 * finer {
            let before = cars.clone();
            for (i, car) in cars.iter_mut().enumerate() {
                if i == 0 {
                    car.step_leader(inputs.throttle[piece], inputs.brake[piece], step_s);
                } else {
                    car.step_follower(before[i].y - before[i - 1].y, step_s);
                }
            }
            for (track, car) in tracks.iter_mut().zip(&cars) {
                track.push(car.y);
            }
        }
    }
    let mut signals = SampledSignals::new(step_s, tracks[0].len())?;
    for (i, track) in tracks.into_iter().enumerate() {
        signals.insert(format!("y{}", i + 1), track)?;
    }
    Ok(signals)
}

#[derive(Clone)]
struct ReplayCar {
    y: f64,
    v: f64,
    mode: &'static str,
}

impl ReplayCar {
    fn step_leader(&mut self, throttle: f64, brake: f64, h: f64) {
        let v = self.v;
        if brake < 1e-6 {
            // Taylor expansion of the solution below, to first order in the brake.
            self.v = v - throttle * h - brake * (v * h - throttle * h * h / 2.0);
            self.y += v * h
                - throttle * h * h / 2.0
                - brake * (v * h * h / 2.0 - throttle * h * h * h / 6.0);
        } else {
            let rest = -throttle / brake;
            self.v = rest + (v - rest) * (-brake * h).exp();
            self.y += rest * h + (v - self.v) / brake;
        }
    }

    fn step_follower(&mut self, gap: f64, h: f64) {
        self.mode = match self.mode {
            "keeping" if gap >= 15.0 => "chasing",
            "keeping" if gap <= 5.0 => "braking",
            "chasing" if gap <= 10.0 => "keeping",
            "braking" if gap >= 20.0 => "chasing",
            mode => mode,
        };
        let v = self.v;
        match self.mode {
            "keeping" => self.y += v * h,
            "chasing" => {
                self.v = v + h;
                self.y -= (v + self.v) / 2.0 * h;
            }
            _ => {
                self.v = v * (-h).exp();
                self.y -= v - self.v;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::work::chasing_cars::{SPECIFICATIONS, robustness};
    use crumple_sim::random::{Purpose, stream};
    use rand::RngExt;

    #[test]
    fn agrees_with_the_fast_model_and_monitor() {
        for seed in 0..3 {
            let mut random = stream(seed, Purpose::ScenarioSampling, 0);
            let mut extreme = |_| {
                if random.random() {
                    f64::from(random.random::<bool>())
                } else {
                    random.random()
                }
            };
            let inputs = ChasingCarsInputs {
                throttle: std::array::from_fn(&mut extreme),
                brake: std::array::from_fn(extreme),
            };
            for (name, text) in SPECIFICATIONS {
                let formula = text.parse().unwrap();
                let (fast, plain) = (
                    robustness(&formula, &inputs).unwrap(),
                    replayed_robustness(&formula, &inputs).unwrap(),
                );
                // Rounding shifts a switch of mode by at most one step.
                assert!(
                    (fast - plain).abs() < 1e-6 * (1.0 + fast.abs()),
                    "{name}, seed {seed}: {fast} and {plain}"
                );
            }
        }
    }
}
