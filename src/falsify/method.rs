//! What every search method can do, and their names.

use std::fmt;
use std::str::FromStr;

use super::annealing::Annealing;
use super::auto::Auto;
use super::cma_es::CmaEs;
use super::cross_entropy::CrossEntropy;
use super::cube::Cube;
use super::halton::Halton;
use super::signals::Signals;
use super::uniform::Uniform;

/// A search for the smallest robustness in a unit cube.
pub trait Search: fmt::Debug + Send {
    /// The next points to evaluate, at least one, every coordinate in [0, 1].
    fn ask(&mut self) -> Vec<Vec<f64>>;

    /// The robustness of the points asked for last, in their order. Where it is shorter (the budget is used up), the
    /// others count as never evaluated. NaN counts as +∞: whoever cannot be evaluated is no counterexample.
    fn tell(&mut self, robustness: &[f64]);
}

/// The search methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// Independent uniform points.
    Uniform,
    /// A randomised Halton sequence.
    Halton,
    /// Covariance matrix adaptation with restarts.
    CmaEs,
    /// Cross-entropy with independent normal coordinates.
    CrossEntropy,
    /// Simulated annealing.
    Annealing,
    /// Signals of few pieces with bang-bang moves.
    Signals,
    /// A portfolio.
    Auto,
}

/// A name that is not that of a method.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no method `{name}`; there are: {}", Method::ALL.map(Method::name).join(", "))]
pub struct UnknownMethod {
    /// The name.
    pub name: String,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 7] =
        [Self::Uniform, Self::Halton, Self::CmaEs, Self::CrossEntropy, Self::Annealing, Self::Signals, Self::Auto];

    /// The name used on the command line and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Halton => "halton",
            Self::CmaEs => "cma-es",
            Self::CrossEntropy => "cross-entropy",
            Self::Annealing => "annealing",
            Self::Signals => "signals",
            Self::Auto => "auto",
        }
    }

    /// A search in `cube`, decided by `seed`.
    #[must_use]
    pub fn start(self, cube: &Cube, seed: u64) -> Box<dyn Search> {
        match self {
            Self::Uniform => Box::new(Uniform::new(cube, seed)),
            Self::Halton => Box::new(Halton::new(cube, seed)),
            Self::CmaEs => Box::new(CmaEs::new(cube, seed)),
            Self::CrossEntropy => Box::new(CrossEntropy::new(cube, seed)),
            Self::Annealing => Box::new(Annealing::new(cube, seed)),
            Self::Signals => Box::new(Signals::new(cube, seed)),
            Self::Auto => Box::new(Auto::new(cube, seed)),
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for Method {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        let found = Self::ALL.into_iter().find(|method| method.name() == name);
        found.ok_or_else(|| UnknownMethod { name: name.to_owned() })
    }
}

/// A robustness that can be ranked: NaN is worst.
pub(super) fn rankable(robustness: f64) -> f64 {
    if robustness.is_nan() { f64::INFINITY } else { robustness }
}
