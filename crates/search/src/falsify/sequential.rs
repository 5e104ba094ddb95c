//! Sequential convex programming on the braking of the leader.
//!
//! The scenario is a point of the space: some coordinates are the leader's script ([`UnitCube::leader_coordinates`]);
//! the others are held while [`TrustRegionDescent`] worsens the script. Every finite difference and every step is a
//! proposed point, so that it counts as an evaluation, and a resumed search takes the same steps.

use super::method::nan_as_infinity;
use super::simple_points::sample_simple_point;
use super::{SearchAlgorithm, UnitCube};
use crate::worst_case::{StepSchedule, TrustRegionDescent, VariableBounds};
use crumple_world::random::{Purpose, Stream, stream};

/// Finite difference of a coordinate, and the initial and final trust region, as shares of the ranges.
const STEP_SCHEDULE: StepSchedule = StepSchedule { finite_difference: 0.01, trust_region: [0.25, 0.02] };

/// A descent over the script of the leader, then over all coordinates.
#[derive(Debug)]
pub(super) struct LeaderDescent {
    point: Vec<f64>,
    coordinates: Vec<usize>,
    descent: TrustRegionDescent,
    is_joint: bool,
}

impl LeaderDescent {
    /// Creates a descent from a point and its robustness. In a cube without a leader every coordinate varies.
    pub(super) fn new(cube: &UnitCube, point: Vec<f64>, robustness: f64) -> Self {
        let is_joint = cube.leader_coordinates().is_empty();
        let coordinates = if is_joint { (0..cube.dimension()).collect() } else { cube.leader_coordinates().to_vec() };
        Self::with_coordinates(coordinates, point, robustness, is_joint)
    }

    fn with_coordinates(coordinates: Vec<usize>, point: Vec<f64>, robustness: f64, is_joint: bool) -> Self {
        let at = coordinates.iter().filter_map(|&coordinate| point.get(coordinate).copied()).collect();
        let descent = TrustRegionDescent::new(VariableBounds { low: 0.0, high: 1.0 }, STEP_SCHEDULE, at, robustness);
        Self { point, coordinates, descent, is_joint }
    }

    pub(super) fn ask(&mut self) -> Vec<Vec<f64>> {
        let mut asked = self.descent.ask();
        if asked.is_empty() && !self.is_joint {
            let (point, robustness) = (self.full_point(self.descent.point()), self.descent.value());
            *self = Self::with_coordinates((0..point.len()).collect(), point, robustness, true);
            asked = self.descent.ask();
        }
        asked.iter().map(|at| self.full_point(at)).collect()
    }

    pub(super) fn tell(&mut self, robustness: &[f64]) {
        self.descent.tell(robustness);
    }

    fn full_point(&self, at: &[f64]) -> Vec<f64> {
        let mut whole = self.point.clone();
        for (&coordinate, &value) in self.coordinates.iter().zip(at) {
            if let Some(place) = whole.get_mut(coordinate) {
                *place = value;
            }
        }
        whole
    }
}

const EXPLORATION_POINTS: usize = 16;
const MAX_STARTS: usize = 200;

/// Descents from the best of many simple points.
#[derive(Debug)]
pub(super) struct Sequential {
    cube: UnitCube,
    random: Stream,
    starts: Vec<(f64, Vec<f64>)>,
    descent: Option<LeaderDescent>,
    /// Proposed points of the exploration; empty during a descent.
    exploration_points: Vec<Vec<f64>>,
}

impl Sequential {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let random = stream(seed, Purpose::Search, 0);
        Self { cube: cube.clone(), random, starts: Vec::new(), descent: None, exploration_points: Vec::new() }
    }
}

impl SearchAlgorithm for Sequential {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        self.exploration_points.clear();
        if let Some(descent) = &mut self.descent {
            let asked = descent.ask();
            if !asked.is_empty() {
                return asked;
            }
            self.descent = None;
        }
        self.exploration_points =
            (0..EXPLORATION_POINTS).map(|_| sample_simple_point(&self.cube, &mut self.random)).collect();
        self.exploration_points.clone()
    }

    fn tell(&mut self, robustness: &[f64]) {
        let robustness: Vec<f64> = robustness.iter().map(|&value| nan_as_infinity(value)).collect();
        if let Some(descent) = &mut self.descent {
            return descent.tell(&robustness);
        }
        self.starts.extend(robustness.into_iter().zip(std::mem::take(&mut self.exploration_points)));
        self.starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.starts.truncate(MAX_STARTS);
        if !self.starts.is_empty() {
            let (robustness, point) = self.starts.remove(0);
            self.descent = Some(LeaderDescent::new(&self.cube, point, robustness));
        }
    }
}
