//! Search over the steps at which the follower's brake may fire.
//!
//! The multipliers of each solved program also bound the programs of all other firings (see [`super::multipliers`]) at
//! a thousandth of the cost. The search solves the firing with the highest bound, lowers all other bounds, drops
//! firings that cannot beat the best escape, and repeats. If no escape is found, the bounds are a proof.

use super::avoidance_problem::AvoidanceProblem;
use super::multipliers::{DualProof, Multipliers, ROUNDING_MARGIN};
use super::program::{self, Grid, ProgramOutcome};

#[derive(Debug, Clone)]
pub(super) struct ModelEscape {
    /// The step by which the follower's brake fires; the number of steps for never.
    pub(super) firing: usize,
    /// Smallest gap at the instants of the grid, in metres.
    pub(super) gap_m: f64,
    /// Acceleration of each ego in each cell, in m/s².
    pub(super) acceleration_mps2: Vec<Vec<f64>>,
    pub(super) grid: Grid,
}

pub(super) struct FiringSearch<'a> {
    problem: &'a AvoidanceProblem,
    pub(super) proofs: Vec<DualProof>,
    /// Upper bound of the smallest gap of an escape with each firing.
    bounds_m: Vec<f64>,
    solved: Vec<bool>,
    pub(super) best: Option<ModelEscape>,
    pub(super) programs: usize,
    pub(super) solver_failure: Option<String>,
}

const MIN_GAP_GAIN_M: f64 = 2e-3;

impl<'a> FiringSearch<'a> {
    pub(super) fn new(problem: &'a AvoidanceProblem) -> Self {
        let firings = problem.firing_count();
        let mut search = Self {
            problem,
            proofs: Vec::new(),
            bounds_m: vec![f64::INFINITY; firings],
            solved: vec![false; firings],
            best: None,
            programs: 0,
            solver_failure: None,
        };
        Multipliers::for_initial_gaps(problem).for_each(|multipliers| search.cut(multipliers));
        if problem.follower.is_some() {
            // Firings that full braking cannot cause need no program.
            search.cut(Multipliers::for_firing(problem));
            search.cut_unreachable_firings();
        }
        search
    }

    /// Returns the upper bound of the smallest gap over all firings, in metres.
    pub(super) fn bound_m(&self) -> f64 {
        self.bounds_m
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Solves programs until no firing can improve the result, `most` programs are solved, or `open_ends` programs gave
    /// neither an escape nor a proof for their firing.
    pub(super) fn explore(&mut self, grid: &Grid, most: usize, mut open_ends: usize) {
        self.solved.fill(false);
        for _ in 0..most {
            let Some(firing) = self.most_promising(self.min_useful_bound_m()) else {
                return;
            };
            self.solved[firing] = true;
            self.solve(grid, firing);
            let escapes = self.best.as_ref().is_some_and(|best| best.gap_m > 0.0);
            open_ends -= usize::from(!escapes && self.bounds_m[firing] >= 0.0);
            if open_ends == 0 {
                return;
            }
        }
    }

    /// Returns the bound that a firing must exceed to be worth a program.
    fn min_useful_bound_m(&self) -> f64 {
        let escape = self.best.as_ref().filter(|best| best.gap_m > 0.0);
        escape.map_or(0.0, |best| {
            // The difference between bound and gap of the best firing is the loss of the grid against continuous time.
            // No program on the same grid recovers it.
            let slack_m = (self.bounds_m[best.firing] - best.gap_m).max(0.0);
            best.gap_m + slack_m + MIN_GAP_GAIN_M
        })
    }

    /// Returns the unsolved firing with the highest bound above `floor_m`; of equal neighbours the middle one.
    fn most_promising(&self, floor_m: f64) -> Option<usize> {
        let open = self
            .bounds_m
            .iter()
            .enumerate()
            .filter(|(firing, bound)| !self.solved[*firing] && **bound > floor_m);
        let highest_m = open
            .clone()
            .map(|(_, bound)| *bound)
            .fold(f64::NEG_INFINITY, f64::max);
        let mut highest = open.filter(|(_, bound)| **bound >= highest_m);
        let first = highest.next()?.0;
        let alike = (first..self.bounds_m.len())
            .take_while(|&at| self.bounds_m[at] >= highest_m && !self.solved[at]);
        Some(first + alike.count() / 2)
    }

    /// Bounds the gap at the instant at which all may stand. After it, a bound loses more with every cell, because a
    /// standing vehicle of the model may move back within a cell.
    pub(super) fn bound_when_all_may_stand(&mut self, cell: usize) {
        let grid = Grid::until_all_may_stand(self.problem, cell);
        let firing = self.problem.never_firing();
        if let ProgramOutcome::Profile { multipliers, .. }
        | ProgramOutcome::Infeasible(multipliers) = self.solve_program(&grid, firing)
        {
            self.cut(multipliers);
        }
    }

    fn solve(&mut self, grid: &Grid, firing: usize) {
        match self.solve_program(grid, firing) {
            ProgramOutcome::Profile {
                gap_m,
                acceleration_mps2,
                multipliers,
            } => {
                self.cut(multipliers);
                if self.best.as_ref().is_none_or(|best| gap_m > best.gap_m) {
                    self.best = Some(ModelEscape {
                        firing,
                        gap_m,
                        acceleration_mps2,
                        grid: grid.clone(),
                    });
                }
            }
            ProgramOutcome::Infeasible(multipliers) => self.cut(multipliers),
            ProgramOutcome::SolverFailed(status) => self.solver_failure = Some(status),
        }
    }

    fn solve_program(&mut self, grid: &Grid, firing: usize) -> ProgramOutcome {
        self.programs += 1;
        program::solve(self.problem, grid, firing)
    }

    /// Drops the early firings that even a standing ego cannot cause, because the follower only approaches.
    fn cut_unreachable_firings(&mut self) {
        let stands_from = Multipliers::standstill_step(self.problem);
        let mut below = stands_from;
        let mut above = self.problem.never_firing();
        while below < above {
            let middle = usize::midpoint(below, above);
            if self.is_unreachable(middle) {
                below = middle + 1
            } else {
                above = middle
            }
        }
        for bound_m in self.bounds_m.iter_mut().take(below).skip(stands_from) {
            *bound_m = f64::NEG_INFINITY;
        }
    }

    /// Returns true if even an ego that brakes to standstill at once cannot cause a firing.
    fn is_unreachable(&self, firing: usize) -> bool {
        let multipliers = Multipliers::for_standstill(self.problem, firing, 1);
        let proof = DualProof::new(self.problem, multipliers);
        proof.infimum(self.problem, firing, true) > ROUNDING_MARGIN
    }

    fn cut(&mut self, multipliers: Multipliers) {
        let proof = DualProof::new(self.problem, multipliers);
        let never = self.problem.never_firing();
        let floor_m = self.best.as_ref().map_or(0.0, |best| best.gap_m.max(0.0));
        for (firing, bound_m) in self.bounds_m.iter_mut().enumerate() {
            // Bounds below the best escape need no update.
            if *bound_m >= floor_m {
                *bound_m = bound_m.min(proof.gap_bound_m(self.problem, firing, firing < never));
            }
        }
        self.proofs.push(proof);
    }
}
