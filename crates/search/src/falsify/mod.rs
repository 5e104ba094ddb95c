//! How it is attacked: search methods that look for negative robustness, and the problems they are measured on.
//!
//! A search moves in a unit [`UnitCube`]; the owner of the problem scales it. A search proposes a batch of points
//! ([`Search::ask`]) and learns what they were worth ([`Search::tell`]). The batch is the method's choice and depends on the
//! seed and on earlier values alone, so its points may be evaluated in any order and on any number of threads without
//! changing a result; and a search is resumed by asking and telling again what an earlier run has logged.
//!
//! What a method knows of a problem stands in its cube: which coordinates are a signal, and which are the script of a
//! leader. The convex programs of `worst_case` make that script worse step by step (`sequential`, and part of `auto`);
//! where there is no leader, `auto` is what it is without them.
//!
//! A [`campaign`] puts it together: a space, a controller, a specification, a method with a budget, and a folder that holds
//! every evaluation and the distinct failures as [`counterexample`] files.

mod annealing;
mod auto;
pub mod campaign;
pub mod chasing_cars;
mod climb;
mod cma_es;
pub mod counterexample;
mod cross_entropy;
mod cube;
mod evaluator;
mod failure_criterion;
mod halton;
mod method;
pub mod non_finite;
mod plateau_bisection;
mod sequential;
mod signals;
mod simple_points;
mod surrogate;
#[cfg(test)]
mod test_functions;
mod uniform;

pub use cube::{EmptyBlock, UnitCube};
pub use failure_criterion::{FailureCriterion, FailureCriterionRecord, MetamorphicRelation, UnknownRelation};
pub use method::{CustomMethod, InvalidMethodName, Method, SearchAlgorithm, UnknownMethod};
