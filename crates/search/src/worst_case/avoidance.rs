//! The result of the search for an escape.

use crumple_verify::Certificate;

use super::escape::Escape;
use super::reason::UndecidedReason;

/// Result of an analysis of avoidability.
#[derive(Debug, Clone, PartialEq)]
pub struct Avoidance {
    /// The answer.
    pub verdict: AvoidanceVerdict,
    /// The largest smallest gap of the escapes that were found and replayed, in metres: best found, not best there is, for a finer
    /// grid may find a larger one. The escape shown may have less (see [`EscapeKind`](super::EscapeKind)).
    pub best_min_gap_m: Option<f64>,
    /// No escape has a larger smallest gap, in metres: a bound over every controller. With a certificate it is the certified one,
    /// otherwise as computed from multipliers of the programs. None if there is no bound, or no escape.
    pub min_gap_bound_m: Option<f64>,
    /// Certificate of the bound, if the options ask for it and it could be written; the checker has accepted it.
    pub bound_certificate: Option<Box<Certificate>>,
    /// Convex programs solved.
    pub programs: usize,
    /// Reason why no profile can keep a larger smallest gap, if there is one.
    pub optimality: Optimality,
}

/// Reason why no profile can keep a larger smallest gap than the best one found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Optimality {
    /// Nothing shows it.
    BestFound,
    /// The gap is within a centimetre of [`Avoidance::min_gap_bound_m`].
    Bound,
    /// The gap is within a centimetre of the smallest one at the start.
    InitialGap,
}

impl Optimality {
    /// Returns the name used in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::BestFound => "best-found",
            Self::Bound => "bound",
            Self::InitialGap => "initial-gap",
        }
    }
}

/// Verdict on whether any driver could have avoided the collision.
#[derive(Debug, Clone, PartialEq)]
pub enum AvoidanceVerdict {
    /// Yes, like this.
    Avoidable(Box<Escape>),
    /// No, by this proof; the checker has accepted it.
    Unavoidable(Box<Certificate>),
    /// Neither was shown.
    Undecided(UndecidedReason),
}

impl AvoidanceVerdict {
    /// The name used in results.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Avoidable(_) => "avoidable",
            Self::Unavoidable(_) => "unavoidable",
            Self::Undecided(_) => "undecided",
        }
    }

    /// The escape, if there is one.
    #[must_use]
    pub fn escape(&self) -> Option<&Escape> {
        match self {
            Self::Avoidable(escape) => Some(escape),
            Self::Unavoidable(_) | Self::Undecided(_) => None,
        }
    }
}
