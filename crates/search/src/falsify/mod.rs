//! Falsification: search methods that look for negative robustness.
//!
//! A search moves in a [`UnitCube`]; the caller scales it to the problem. The search proposes a batch of points
//! ([`SearchAlgorithm::ask`]) and receives their values ([`SearchAlgorithm::tell`]). A batch depends only on the seed
//! and on earlier values. Its points may therefore be evaluated in any order and on any number of threads, and a search
//! resumes by replaying the logged values.
//!
//! The cube marks the coordinates of signals and of the script of a leader. Sequential convex programming
//! ([`worst_case`](crate::worst_case)) worsens that script in the method `auto`.
//!
//! A [`campaign`] combines a space, a controller, a specification and a method with a budget. Its run folder contains
//! every evaluation, and the distinct failures as [`counterexample`] files.

mod auto;
pub mod campaign;
mod climb;
mod cma_es;
pub mod counterexample;
mod cross_entropy;
mod cube;
mod evaluator;
mod failure_criterion;
mod halton;
mod leader_descent;
mod method;
mod plateau_bisection;
mod simple_points;
mod surrogate;
#[cfg(test)]
mod test_functions;
mod uniform;

pub use cube::{EmptyBlock, InvalidPoints, UnitCube};
pub use failure_criterion::{FailureCriterion, FailureCriterionRecord};
pub use method::{CustomMethod, InvalidMethodName, Method, SearchAlgorithm, UnknownMethod};
