//! The convex program of one firing of the follower's brake.
//!
//! Variables are the smallest gap m and, for every ego and instant of a control grid, the change of speed w and the
//! displacement d from coasting (see [`super::avoidance_problem`]). Eliminating w and d would make every row dense; in
//! the sparse form the cost of an iteration is linear in the number of cells, not cubic. For a firing at step τ the
//! rows are
//!
//! ```text
//! d⁺ - d = H (w + w⁺) / 2          exact for an acceleration (w⁺ - w) / H held over the cell
//! -b H <= w⁺ - w <= a H            limits
//! w >= -v₀                         no vehicle reverses
//! d + m <= front slack             behind the leader
//! d₂ - d₁ + m <= pair slack        behind the ego ahead
//! -d + m <= rear slack of τ        ahead of the follower
//! d + θ w <= fired slack, at τ     by τ the brake has fired
//! ```
//! A profile that fires before τ makes the follower brake earlier and leaves more room, so it is an escape as well.

use super::avoidance_problem::AvoidanceProblem;
use super::multipliers::Multipliers;
use crumple_quadratic::{QuadraticProgram, QuadraticSolution};

/// Instants, in steps, between which accelerations are held.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    /// Increasing steps, from 0 to the number of steps.
    pub(super) steps: Vec<usize>,
}

#[derive(Debug, Clone)]
pub(super) enum ProgramOutcome {
    /// A profile, and the multipliers that bound the improvement of any other one.
    Profile {
        gap_m: f64,
        /// Acceleration of each ego in each cell, in m/s².
        acceleration_mps2: Vec<Vec<f64>>,
        /// Multipliers of the rows for gaps, speeds and firing.
        multipliers: Multipliers,
    },
    /// No profile makes the brake fire there.
    Infeasible(Multipliers),
    /// The solver failed; holds its status.
    SolverFailed(String),
}

/// Margin of the guard, in metres, so that rounding cannot undo the firing.
const GUARD_MARGIN_M: f64 = 1e-5;

impl Grid {
    /// Creates a grid with cells of `cell` steps, and five times as long once all may stand.
    pub(super) fn new(problem: &AvoidanceProblem, cell: usize) -> Self {
        let calm = problem.all_may_stand_step();
        let mut steps = Vec::new();
        let mut step = 0;
        while step < problem.steps {
            steps.push(step);
            step += if step >= calm {
                5 * cell.max(1)
            } else {
                cell.max(1)
            };
        }
        steps.push(problem.steps);
        Self { steps }
    }

    /// Creates a grid that ends once all may stand.
    pub(super) fn until_all_may_stand(problem: &AvoidanceProblem, cell: usize) -> Self {
        let end = problem.all_may_stand_step();
        let mut steps: Vec<usize> = (0..end).step_by(cell.max(1)).collect();
        steps.push(end);
        Self { steps }
    }

    fn cell_count(&self) -> usize {
        self.steps.len() - 1
    }
}

#[derive(Debug, Clone, Copy)]
enum ConstraintRow {
    Front(usize),
    Pair(usize, usize),
    Rear(usize),
    Speed(usize, usize),
    Fired,
    Other,
}

/// Returns the largest smallest gap if the follower's brake fires by step `firing`.
pub(super) fn solve(problem: &AvoidanceProblem, grid: &Grid, firing: usize) -> ProgramOutcome {
    let mut program = EscapeProgram::new(problem, grid);
    program.add_motion_rows();
    program.add_gap_rows(firing);
    program
        .quadratic_program
        .add_linear_cost(GAP_VARIABLE, -1.0);
    match program.quadratic_program.solve() {
        QuadraticSolution::Optimal { point, multipliers } => ProgramOutcome::Profile {
            gap_m: point.get(GAP_VARIABLE).copied().unwrap_or(f64::NAN),
            acceleration_mps2: (0..problem.egos.len())
                .map(|ego| program.accelerations(&point, ego))
                .collect(),
            multipliers: program.multipliers(&multipliers),
        },
        QuadraticSolution::Infeasible(multipliers) => {
            ProgramOutcome::Infeasible(program.multipliers(&multipliers))
        }
        QuadraticSolution::SolverFailed(status) => ProgramOutcome::SolverFailed(status),
    }
}

struct EscapeProgram<'a> {
    problem: &'a AvoidanceProblem,
    grid: &'a Grid,
    quadratic_program: QuadraticProgram,
    rows: Vec<ConstraintRow>,
}

const GAP_VARIABLE: usize = 0;

impl<'a> EscapeProgram<'a> {
    fn new(problem: &'a AvoidanceProblem, grid: &'a Grid) -> Self {
        let variables = 1 + 2 * problem.egos.len() * grid.cell_count();
        Self {
            problem,
            grid,
            quadratic_program: QuadraticProgram::new(variables),
            rows: Vec::new(),
        }
    }

    /// Returns the variable w of an ego at a grid instant after the first.
    fn speed_variable(&self, ego: usize, instant: usize) -> usize {
        1 + 2 * ((instant - 1) * self.problem.egos.len() + ego)
    }

    /// Returns the variable d of an ego at a grid instant after the first.
    fn displacement_variable(&self, ego: usize, instant: usize) -> usize {
        self.speed_variable(ego, instant) + 1
    }

    fn cell_s(&self, instant: usize) -> f64 {
        (self.grid.steps[instant] - self.grid.steps[instant - 1]) as f64 * self.problem.step_s
    }

    /// Returns the change of speed in the cell before an instant.
    fn speed_change_terms(&self, ego: usize, instant: usize) -> Vec<(usize, f64)> {
        let w = self.speed_variable(ego, instant);
        if instant > 1 {
            vec![(w, 1.0), (self.speed_variable(ego, instant - 1), -1.0)]
        } else {
            vec![(w, 1.0)]
        }
    }

    fn add_inequality(&mut self, row: ConstraintRow, terms: &[(usize, f64)], bound: f64) {
        self.quadratic_program.add_inequality(terms, bound);
        self.rows.push(row);
    }

    fn add_motion_rows(&mut self) {
        for instant in 1..=self.grid.cell_count() {
            let cell_s = self.cell_s(instant);
            for (ego, limits) in self.problem.egos.iter().enumerate() {
                let w = self.speed_variable(ego, instant);
                let mut travel = vec![(w + 1, 1.0), (w, -0.5 * cell_s)];
                if instant > 1 {
                    let before = self.speed_variable(ego, instant - 1);
                    travel.extend([(before + 1, -1.0), (before, -0.5 * cell_s)]);
                }
                self.quadratic_program.add_equality(&travel, 0.0);
                let change = self.speed_change_terms(ego, instant);
                if self.grid.steps[instant - 1] < self.problem.dead_steps[ego] {
                    self.quadratic_program.add_equality(&change, 0.0);
                } else {
                    let back: Vec<_> = change.iter().map(|&(variable, c)| (variable, -c)).collect();
                    self.add_inequality(
                        ConstraintRow::Other,
                        &change,
                        limits.max_accel_mps2 * cell_s,
                    );
                    self.add_inequality(
                        ConstraintRow::Other,
                        &back,
                        limits.max_brake_mps2 * cell_s,
                    );
                }
                let step = self.grid.steps[instant];
                self.add_inequality(
                    ConstraintRow::Speed(ego, step),
                    &[(w, -1.0)],
                    self.problem.speed_slack_mps(ego),
                );
            }
        }
    }

    fn add_gap_rows(&mut self, firing: usize) {
        let problem = self.problem;
        self.add_inequality(
            ConstraintRow::Other,
            &[(GAP_VARIABLE, 1.0)],
            problem.initial_gap_m(),
        );
        let leader_rests = problem.leader_standstill_step();
        let follower_rests = problem.follower_standstill_step(firing);
        for instant in 1..=self.grid.cell_count() {
            // Behind a standing leader or ahead of a standing follower the last row suffices: egos do not reverse.
            if self.grid.steps[instant] <= leader_rests || instant == self.grid.cell_count() {
                self.add_front_row(instant);
            }
            self.add_pair_rows(instant);
            if problem.follower.is_some() && self.grid.steps[instant - 1] <= follower_rests {
                self.add_rear_row(instant, firing);
            }
        }
        if let Some(follower) = &problem.follower
            && firing < problem.never_firing()
        {
            let terms = self.guard_terms(firing, follower.ttc_s);
            self.add_inequality(
                ConstraintRow::Fired,
                &terms,
                problem.fired_slack_m(firing) - GUARD_MARGIN_M,
            );
        }
    }

    /// Adds the gap between the leader and the first ego.
    fn add_front_row(&mut self, instant: usize) {
        let step = self.grid.steps[instant];
        let d = self.displacement_variable(0, instant);
        self.add_inequality(
            ConstraintRow::Front(step),
            &[(d, 1.0), (GAP_VARIABLE, 1.0)],
            self.problem.front_slack_m(step),
        );
    }

    /// Adds the gaps between the egos.
    fn add_pair_rows(&mut self, instant: usize) {
        let step = self.grid.steps[instant];
        for ahead in 0..self.problem.egos.len() - 1 {
            let terms = [
                (self.displacement_variable(ahead + 1, instant), 1.0),
                (self.displacement_variable(ahead, instant), -1.0),
                (GAP_VARIABLE, 1.0),
            ];
            self.add_inequality(
                ConstraintRow::Pair(ahead, step),
                &terms,
                self.problem.pair_slack_m(ahead, step),
            );
        }
    }

    /// Adds the gap between the last ego and the follower.
    fn add_rear_row(&mut self, instant: usize, firing: usize) {
        let step = self.grid.steps[instant];
        let d = self.displacement_variable(self.problem.egos.len() - 1, instant);
        self.add_inequality(
            ConstraintRow::Rear(step),
            &[(d, -1.0), (GAP_VARIABLE, 1.0)],
            self.problem.rear_slack_m(firing, step),
        );
    }

    /// Returns d + θ w of the last ego at a step, which may lie inside a cell.
    fn guard_terms(&self, step: usize, theta_s: f64) -> Vec<(usize, f64)> {
        if step == 0 {
            return Vec::new();
        }
        let last = self.problem.egos.len() - 1;
        let instant = self.grid.steps.partition_point(|&at| at < step);
        let into_s = (step - self.grid.steps[instant - 1]) as f64 * self.problem.step_s;
        let share = into_s / self.cell_s(instant);
        // w(s) = w + (w⁺ - w) s / H and d(s) = d + w s + (w⁺ - w) s² / 2 H.
        let after = theta_s * share + 0.5 * into_s * share;
        let mut terms = vec![(self.speed_variable(last, instant), after)];
        if instant > 1 {
            let before = self.speed_variable(last, instant - 1);
            terms.extend([(before + 1, 1.0), (before, theta_s + into_s - after)]);
        }
        terms
    }

    /// Returns the accelerations of a solution, clamped to the limits because of the solver's accuracy.
    fn accelerations(&self, at: &[f64], ego: usize) -> Vec<f64> {
        let limits = &self.problem.egos[ego];
        let lowest_mps = -self.problem.speed_slack_mps(ego);
        let mut before = 0.0;
        let cells = 1..=self.grid.cell_count();
        let accelerations_mps2 = cells.map(|instant| {
            if self.grid.steps[instant - 1] < self.problem.dead_steps[ego] {
                return 0.0;
            }
            let wanted = at
                .get(self.speed_variable(ego, instant))
                .copied()
                .unwrap_or(before);
            // Treat negligible speeds as standstill.
            let wanted = if wanted - lowest_mps < STANDSTILL_SPEED_MPS {
                lowest_mps
            } else {
                wanted
            };
            let cell_s = self.cell_s(instant);
            let accel_mps2 =
                ((wanted - before) / cell_s).clamp(-limits.max_brake_mps2, limits.max_accel_mps2);
            before += accel_mps2 * cell_s;
            accel_mps2
        });
        accelerations_mps2.collect()
    }

    fn multipliers(&self, values: &[f64]) -> Multipliers {
        let mut multipliers = Multipliers::zero(self.problem);
        for (row, &value) in self.rows.iter().zip(values) {
            match *row {
                ConstraintRow::Front(step) => multipliers.front.push((step, value)),
                ConstraintRow::Rear(step) => multipliers.rear.push((step, value)),
                ConstraintRow::Pair(ahead, step) => multipliers.between[ahead].push((step, value)),
                ConstraintRow::Speed(ego, step) => multipliers.speed[ego].push((step, value)),
                ConstraintRow::Fired => multipliers.fired = value,
                ConstraintRow::Other => {}
            }
        }
        multipliers.without_negligible()
    }
}

/// Speed below which a vehicle of a solution counts as standing, in m/s.
const STANDSTILL_SPEED_MPS: f64 = 1e-5;
