//! Convex quadratic programs, solved with the interior-point solver Clarabel.
//!
//! The solver is generic and compiled where it is called: in this crate it is compiled once, and always optimised.

use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::{NonnegativeConeT, ZeroConeT};
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus};

/// A program: minimise ½ xᵀ P x + qᵀ x over x with A x = b in the first rows and A x <= b in the others.
#[derive(Debug, Clone, Default)]
pub struct QuadraticProgram {
    variables: usize,
    cost: Vec<f64>,
    /// Upper triangle: row, column, value.
    hessian: Vec<(usize, usize, f64)>,
    equalities: SparseRows,
    inequalities: SparseRows,
}

#[derive(Debug, Clone, Default)]
struct SparseRows {
    row: Vec<usize>,
    column: Vec<usize>,
    value: Vec<f64>,
    bound: Vec<f64>,
}

/// Result of the solver.
#[derive(Debug, Clone)]
pub enum QuadraticSolution {
    /// A minimum, and a multiplier for each inequality.
    Optimal {
        /// Point of the minimum.
        point: Vec<f64>,
        /// Nonnegative multipliers, one for each inequality, in the order of addition.
        multipliers: Vec<f64>,
    },
    /// No point satisfies all rows. These multipliers of the inequalities prove it.
    Infeasible(Vec<f64>),
    /// The solver reached neither result; holds its status.
    SolverFailed(String),
}

impl QuadraticProgram {
    /// Creates a program without rows and cost.
    #[must_use]
    pub fn new(variables: usize) -> Self {
        Self {
            variables,
            cost: vec![0.0; variables],
            ..Self::default()
        }
    }

    /// Adds to the linear cost.
    pub fn add_linear_cost(&mut self, variable: usize, value: f64) {
        if let Some(cost) = self.cost.get_mut(variable) {
            *cost += value;
        }
    }

    /// Adds `weight` (Σ cᵢ xᵢ)² to the cost.
    pub fn add_squared_cost(&mut self, terms: &[(usize, f64)], weight: f64) {
        for &(i, c) in terms {
            for &(j, d) in terms.iter().filter(|(j, _)| i <= *j) {
                self.hessian.push((i, j, 2.0 * weight * c * d));
            }
        }
    }

    /// Adds Σ cᵢ xᵢ = bound.
    pub fn add_equality(&mut self, terms: &[(usize, f64)], bound: f64) {
        self.equalities.add(terms, bound);
    }

    /// Adds Σ cᵢ xᵢ <= bound.
    pub fn add_inequality(&mut self, terms: &[(usize, f64)], bound: f64) {
        self.inequalities.add(terms, bound);
    }

    /// Solves the program.
    #[must_use]
    pub fn solve(&self) -> QuadraticSolution {
        let equalities = self.equalities.bound.len();
        let n = self.variables;
        let rows = equalities + self.inequalities.bound.len();
        let below = self.inequalities.row.iter().map(|row| row + equalities);
        let matrix = CscMatrix::new_from_triplets(
            rows,
            n,
            self.equalities.row.iter().copied().chain(below).collect(),
            [&self.equalities.column[..], &self.inequalities.column].concat(),
            [&self.equalities.value[..], &self.inequalities.value].concat(),
        );
        let hessian = CscMatrix::new_from_triplets(
            n,
            n,
            self.hessian.iter().map(|entry| entry.0).collect(),
            self.hessian.iter().map(|entry| entry.1).collect(),
            self.hessian.iter().map(|entry| entry.2).collect(),
        );
        let bound = [&self.equalities.bound[..], &self.inequalities.bound].concat();
        let cones = [ZeroConeT(equalities), NonnegativeConeT(rows - equalities)];
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .max_iter(100)
            .presolve_enable(false)
            .build();
        let Ok(settings) = settings else {
            return QuadraticSolution::SolverFailed("settings".to_owned());
        };
        let mut solver =
            match DefaultSolver::new(&hessian, &self.cost, &matrix, &bound, &cones, settings) {
                Ok(solver) => solver,
                Err(error) => return QuadraticSolution::SolverFailed(error.to_string()),
            };
        solver.solve();
        let solution = &solver.solution;
        let multipliers = solution.z.iter().skip(equalities).map(|z| z.max(0.0));
        match solution.status {
            // The caller checks solutions that are almost solved.
            SolverStatus::Solved | SolverStatus::AlmostSolved => QuadraticSolution::Optimal {
                point: solution.x.clone(),
                multipliers: multipliers.collect(),
            },
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => {
                QuadraticSolution::Infeasible(multipliers.collect())
            }
            status => QuadraticSolution::SolverFailed(format!("{status:?}")),
        }
    }
}

impl SparseRows {
    fn add(&mut self, terms: &[(usize, f64)], bound: f64) {
        let row = self.bound.len();
        for &(column, value) in terms {
            self.row.push(row);
            self.column.push(column);
            self.value.push(value);
        }
        self.bound.push(bound);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_program_has_the_minimum_and_multiplier_of_the_textbook() {
        // Minimise x² + y² with x + y = 2 and x >= 1.5: at (1.5, 0.5); the multiplier of the bound is 2 (1.5 - 0.5).
        let mut cone = QuadraticProgram::new(2);
        cone.add_squared_cost(&[(0, 1.0)], 1.0);
        cone.add_squared_cost(&[(1, 1.0)], 1.0);
        cone.add_equality(&[(0, 1.0), (1, 1.0)], 2.0);
        cone.add_inequality(&[(0, -1.0)], -1.5);
        let QuadraticSolution::Optimal {
            point: at,
            multipliers,
        } = cone.solve()
        else {
            panic!("solvable")
        };
        assert!(
            (at[0] - 1.5).abs() < 1e-6 && (at[1] - 0.5).abs() < 1e-6,
            "{at:?}"
        );
        assert!((multipliers[0] - 2.0).abs() < 1e-5, "{multipliers:?}");
        cone.add_inequality(&[(0, 1.0)], 1.0);
        assert!(matches!(cone.solve(), QuadraticSolution::Infeasible(_)));
    }
}
