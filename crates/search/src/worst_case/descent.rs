//! Sequential convex programming: minimises a function that is linearised by finite differences.
//!
//! A [`TrustRegionDescent`] proposes points and receives their values, independent of the function and its evaluation.
//! An attack on one scenario and a search with a shared budget thus use the same steps.

use crumple_quadratic::{QuadraticProgram, QuadraticSolution};

#[derive(Debug, Clone, Copy)]
pub(crate) struct VariableBounds {
    pub(crate) low: f64,
    pub(crate) high: f64,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct StepSchedule {
    pub(crate) finite_difference: f64,
    /// Initial and final trust region.
    pub(crate) trust_region: [f64; 2],
}

pub(super) const TRUST_REGION_FACTORS: [f64; 2] = [1.5, 0.4];
const MIN_GAIN: f64 = 1e-6;
/// Cost of the square of a variable, relative to its slope.
const REGULARIZATION_WEIGHT: f64 = 1e-4;

impl VariableBounds {
    /// Adds the rows of a step inside a trust region: the first variables of the program are the new values.
    pub(super) fn add_step_rows(&self, program: &mut QuadraticProgram, at: &[f64], region: f64) {
        for (index, &now) in at.iter().enumerate() {
            program.add_inequality(&[(index, 1.0)], (now + region).min(self.high));
            program.add_inequality(&[(index, -1.0)], (region - now).min(-self.low));
        }
    }

    /// Returns the first variables of a solution, within the bounds; `None` without a solution.
    pub(super) fn solve_clamped(
        &self,
        program: &QuadraticProgram,
        variables: usize,
    ) -> Option<Vec<f64>> {
        let QuadraticSolution::Optimal { point: at, .. } = program.solve() else {
            return None;
        };
        let inside: Vec<f64> = at
            .iter()
            .take(variables)
            .map(|value| value.clamp(self.low, self.high))
            .collect();
        inside
            .iter()
            .all(|value| value.is_finite())
            .then_some(inside)
    }

    /// Returns the perturbation of each variable: it moves towards the middle of its bounds.
    fn perturbations(&self, point: &[f64], nudge: f64) -> Vec<f64> {
        let middle = 0.5 * (self.low + self.high);
        point
            .iter()
            .map(|&value| if value > middle { -nudge } else { nudge })
            .collect()
    }
}

/// Returns the slopes of values relative to the value at a point; 0 for values that are not finite.
pub(super) fn finite_difference_gradient(value: f64, nudged: &[f64], by: &[f64]) -> Vec<f64> {
    nudged
        .iter()
        .zip(by)
        .map(|(nudged, by)| (nudged - value) / by)
        .map(|slope| if slope.is_finite() { slope } else { 0.0 })
        .collect()
}

#[derive(Debug)]
pub(crate) struct TrustRegionDescent {
    bounds: VariableBounds,
    schedule: StepSchedule,
    trust_region: f64,
    point: Vec<f64>,
    value: f64,
    gradient: Option<Vec<f64>>,
    pending: PendingRequest,
}

#[derive(Debug)]
enum PendingRequest {
    Nothing,
    Gradient(Vec<f64>),
    Step(Vec<f64>),
}

impl TrustRegionDescent {
    pub(crate) fn new(
        bounds: VariableBounds,
        schedule: StepSchedule,
        point: Vec<f64>,
        value: f64,
    ) -> Self {
        Self {
            bounds,
            schedule,
            trust_region: schedule.trust_region[0],
            point,
            value,
            gradient: None,
            pending: PendingRequest::Nothing,
        }
    }

    pub(crate) fn point(&self) -> &[f64] {
        &self.point
    }

    pub(crate) fn value(&self) -> f64 {
        self.value
    }

    /// Returns the points to evaluate next; empty at the end.
    pub(crate) fn ask(&mut self) -> Vec<Vec<f64>> {
        let Some(slope) = &self.gradient else {
            let by = self
                .bounds
                .perturbations(&self.point, self.schedule.finite_difference);
            let nudged = by
                .iter()
                .enumerate()
                .map(|(index, by)| {
                    let mut changed = self.point.clone();
                    changed[index] += by;
                    changed
                })
                .collect();
            self.pending = PendingRequest::Gradient(by);
            return nudged;
        };
        let is_over = self.trust_region <= self.schedule.trust_region[1]
            || slope.iter().all(|slope| *slope == 0.0);
        let step = if is_over { None } else { self.step(slope) };
        self.pending = step
            .clone()
            .map_or(PendingRequest::Nothing, PendingRequest::Step);
        step.into_iter().collect()
    }

    /// Receives the values of the last points. If some are missing, the request is repeated.
    pub(crate) fn tell(&mut self, values: &[f64]) {
        match std::mem::replace(&mut self.pending, PendingRequest::Nothing) {
            PendingRequest::Gradient(by) if values.len() == by.len() => {
                self.gradient = Some(finite_difference_gradient(self.value, values, &by))
            }
            PendingRequest::Step(at) => {
                let Some(&value) = values.first() else { return };
                let [success, failure] = TRUST_REGION_FACTORS;
                if value < self.value - MIN_GAIN {
                    (self.point, self.value, self.gradient) = (at, value, None);
                    self.trust_region *= success;
                } else {
                    self.trust_region *= failure;
                }
            }
            PendingRequest::Gradient(_) | PendingRequest::Nothing => {}
        }
    }

    /// Returns the minimum of the linearised function inside the trust region.
    fn step(&self, slope: &[f64]) -> Option<Vec<f64>> {
        let mut program = QuadraticProgram::new(self.point.len());
        self.bounds
            .add_step_rows(&mut program, &self.point, self.trust_region);
        for ((index, &now), &slope) in self.point.iter().enumerate().zip(slope) {
            // w (x - c)² = w x² - 2 w c x + constant.
            program.add_squared_cost(&[(index, 1.0)], REGULARIZATION_WEIGHT);
            program.add_linear_cost(index, slope - 2.0 * REGULARIZATION_WEIGHT * now);
        }
        self.bounds
            .solve_clamped(&program, self.point.len())
            .filter(|next| *next != self.point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_descent_finds_the_minimum_of_a_kinked_bowl_within_its_bounds() {
        // The minimum is at (0.2, 0.9); the third variable has no effect.
        let value = |x: &[f64]| (x[0] - 0.2).abs() + 2.0 * (x[1] - 1.5).abs();
        let limits = VariableBounds {
            low: 0.0,
            high: 0.9,
        };
        let pace = StepSchedule {
            finite_difference: 1e-3,
            trust_region: [0.25, 1e-4],
        };
        let start = vec![0.6, 0.1, 0.3];
        let first = value(&start);
        let mut descent = TrustRegionDescent::new(limits, pace, start, first);
        for _ in 0..200 {
            let proposals = descent.ask();
            assert!(proposals.iter().flatten().all(|x| (0.0..=0.9).contains(x)));
            descent.tell(&proposals.iter().map(|x| value(x)).collect::<Vec<_>>());
        }
        assert!(descent.ask().is_empty(), "it ends");
        assert!(
            (descent.point()[0] - 0.2).abs() < 2e-3 && descent.point()[1] > 0.899,
            "{descent:?}"
        );
        // Tolerance of the solver, accumulated over the steps.
        assert!((descent.point()[2] - 0.3).abs() < 1e-3);
        assert_eq!(descent.value(), value(descent.point()));
    }

    #[test]
    fn incomparable_values_end_the_descent() {
        let limits = VariableBounds {
            low: 0.0,
            high: 1.0,
        };
        let pace = StepSchedule {
            finite_difference: 0.01,
            trust_region: [0.25, 0.01],
        };
        for strange in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut descent = TrustRegionDescent::new(limits, pace, vec![0.5, 0.5], strange);
            descent.tell(&[]);
            let proposals = descent.ask();
            descent.tell(&vec![strange; proposals.len()]);
            assert!(descent.ask().is_empty());
        }
    }
}
