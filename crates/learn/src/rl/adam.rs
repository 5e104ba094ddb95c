//! Adam (Kingma and Ba, 2015, algorithm 1) and the soft update of targets, in one pass over the parameters.

use pulp::Arch;

use crumple_sim::policy::SimdClosure;

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// Optimiser of one network, with the moments of its gradients.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    pub(crate) first_moment: Vec<f32>,
    pub(crate) second_moment: Vec<f32>,
    pub(crate) steps: u64,
}

impl Adam {
    /// Creates an optimiser of `parameters` parameters with zero moments.
    #[must_use]
    pub fn new(parameters: usize) -> Self {
        Self {
            first_moment: vec![0.0; parameters],
            second_moment: vec![0.0; parameters],
            steps: 0,
        }
    }

    /// Performs one gradient step. `follow` is a target network and τ: target ← (1 - τ) target + τ parameters.
    pub fn step(
        &mut self,
        parameters: &mut [f32],
        gradients: &[f32],
        rate: f32,
        follow: Option<(&mut [f32], f32)>,
    ) {
        self.steps += 1;
        // `powi` rounds differently between platforms.
        let unbias =
            |beta: f32| (1.0 / (1.0 - libm::pow(f64::from(beta), self.steps as f64))) as f32;
        let [unbias_1, unbias_2] = [BETA_1, BETA_2].map(unbias);
        let first = self.first_moment.as_mut_slice();
        let second = self.second_moment.as_mut_slice();
        let (target, share) = follow.unwrap_or((&mut [], 0.0));
        Arch::new().dispatch(SimdClosure(
            #[inline(always)]
            || {
                let n = parameters.len();
                let gradients = &gradients[..n];
                let first = &mut first[..n];
                let second = &mut second[..n];
                for i in 0..n {
                    let g = gradients[i];
                    first[i] = BETA_1 * first[i] + (1.0 - BETA_1) * g;
                    second[i] = BETA_2 * second[i] + (1.0 - BETA_2) * (g * g);
                    parameters[i] -=
                        rate * (first[i] * unbias_1) / ((second[i] * unbias_2).sqrt() + EPSILON);
                }
                for (target, &parameter) in target.iter_mut().zip(parameters.iter()) {
                    *target += share * (parameter - *target);
                }
            },
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_algorithm_in_double_precision() {
        let mut parameters = [1.0_f32, -2.0, 0.5];
        let mut exact = parameters.map(f64::from);
        let (mut m, mut v) = ([0.0; 3], [0.0; 3]);
        let mut adam = Adam::new(3);
        for t in 1..=50 {
            let gradients: [f32; 3] = std::array::from_fn(|i| ((t * (i + 1)) as f32).sin());
            adam.step(&mut parameters, &gradients, 0.01, None);
            for i in 0..3 {
                let g = f64::from(gradients[i]);
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let unbiased = [
                    m[i] / (1.0 - 0.9_f64.powi(t as i32)),
                    v[i] / (1.0 - 0.999_f64.powi(t as i32)),
                ];
                exact[i] -= 0.01 * unbiased[0] / (unbiased[1].sqrt() + 1e-8);
            }
        }
        for (actual, expected) in parameters.iter().zip(exact) {
            assert!(
                (f64::from(*actual) - expected).abs() < 1e-5,
                "{actual} {expected}"
            );
        }
    }

    #[test]
    fn a_target_follows_a_resting_network_geometrically() {
        let (mut parameters, mut target) = ([1.0_f32], [0.0_f32]);
        let mut adam = Adam::new(1);
        for _ in 0..100 {
            adam.step(&mut parameters, &[0.0], 0.1, Some((&mut target, 0.005)));
        }
        // After n updates a share of 1 - (1 - τ)ⁿ is covered.
        assert!(
            (f64::from(target[0]) - (1.0 - 0.995_f64.powi(100))).abs() < 1e-6,
            "{target:?}"
        );
    }
}
