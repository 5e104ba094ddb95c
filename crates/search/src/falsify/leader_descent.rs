//! Sequential convex programming on the braking of the leader.
//!
//! The scenario is a point of the space: some coordinates are the leader's script ([`UnitCube::leader_coordinates`]);
//! the others are held while [`TrustRegionDescent`] worsens the script. Every finite difference and every step is a
//! proposed point, so that it counts as an evaluation, and a resumed search takes the same steps.

use super::UnitCube;
use crate::worst_case::{StepSchedule, TrustRegionDescent, VariableBounds};

/// Finite difference of a coordinate, and the initial and final trust region, as shares of the ranges.
const STEP_SCHEDULE: StepSchedule = StepSchedule {
    finite_difference: 0.01,
    trust_region: [0.25, 0.02],
};

/// A descent over the script of the leader, then over all coordinates.
#[derive(Debug)]
pub(super) struct LeaderDescent {
    point: Vec<f64>,
    coordinates: Vec<usize>,
    descent: TrustRegionDescent,
    is_joint: bool,
}

impl LeaderDescent {
    /// Creates a descent from a point and its robustness.
    pub(super) fn new(cube: &UnitCube, point: Vec<f64>, robustness: f64) -> Self {
        Self::with_coordinates(cube.leader_coordinates().to_vec(), point, robustness, false)
    }

    fn with_coordinates(
        coordinates: Vec<usize>,
        point: Vec<f64>,
        robustness: f64,
        is_joint: bool,
    ) -> Self {
        let at = coordinates
            .iter()
            .filter_map(|&coordinate| point.get(coordinate).copied())
            .collect();
        let descent = TrustRegionDescent::new(
            VariableBounds {
                low: 0.0,
                high: 1.0,
            },
            STEP_SCHEDULE,
            at,
            robustness,
        );
        Self {
            point,
            coordinates,
            descent,
            is_joint,
        }
    }

    pub(super) fn ask(&mut self) -> Vec<Vec<f64>> {
        let mut proposals = self.descent.ask();
        if proposals.is_empty() && !self.is_joint {
            let point = self.full_point(self.descent.point());
            let robustness = self.descent.value();
            *self = Self::with_coordinates((0..point.len()).collect(), point, robustness, true);
            proposals = self.descent.ask();
        }
        proposals.iter().map(|at| self.full_point(at)).collect()
    }

    pub(super) fn tell(&mut self, robustness: &[f64]) {
        self.descent.tell(robustness);
    }

    fn full_point(&self, at: &[f64]) -> Vec<f64> {
        let mut whole = self.point.clone();
        for (&coordinate, &value) in self.coordinates.iter().zip(at) {
            if let Some(target) = whole.get_mut(coordinate) {
                *target = value;
            }
        }
        whole
    }
}
