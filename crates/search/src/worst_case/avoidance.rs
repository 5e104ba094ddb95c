//! Result of an analysis of avoidability.

use crumple_verify::Certificate;
use serde::{Deserialize, Serialize};

use super::escape::Escape;
use super::reason::UndecidedReason;

/// Result of an analysis of avoidability.
#[derive(Debug, Clone, PartialEq)]
pub struct Avoidance {
    /// Verdict of the analysis.
    pub verdict: AvoidanceVerdict,
    /// Largest smallest gap of all replayed escapes, in metres. The returned escape may have less.
    pub best_min_gap_m: Option<f64>,
    /// Upper bound of the smallest gap over every controller, in metres: certified if there is a certificate, otherwise
    /// computed from multipliers. `None` without a bound or without an escape.
    pub min_gap_bound_m: Option<f64>,
    /// Certificate of the bound, accepted by the checker, if the options request it and it could be written.
    pub bound_certificate: Option<Box<Certificate>>,
    /// Number of convex programs solved.
    pub programs: usize,
    /// Proof that no profile has a larger smallest gap, if there is one.
    pub optimality: Optimality,
}

impl Avoidance {
    /// Returns an undecided result without any search.
    pub(super) fn undecided(reason: UndecidedReason) -> Self {
        Self {
            verdict: AvoidanceVerdict::Undecided(reason),
            best_min_gap_m: None,
            min_gap_bound_m: None,
            bound_certificate: None,
            programs: 0,
            optimality: Optimality::BestFound,
        }
    }
}

/// Proof that no profile has a larger smallest gap than the best one found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Optimality {
    /// No proof.
    BestFound,
    /// The gap is within a centimetre of [`Avoidance::min_gap_bound_m`].
    Bound,
    /// The gap is within a centimetre of the smallest one at the start.
    InitialGap,
}

/// Verdict on whether any driver could have avoided the collision.
#[derive(Debug, Clone, PartialEq)]
pub enum AvoidanceVerdict {
    /// An escape exists.
    Avoidable(Box<Escape>),
    /// No escape exists; the checker has accepted the proof.
    Unavoidable(Box<Certificate>),
    /// Neither was shown.
    Undecided(UndecidedReason),
}

/// Class of an [`AvoidanceVerdict`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AvoidanceClass {
    /// [`AvoidanceVerdict::Avoidable`].
    Avoidable,
    /// [`AvoidanceVerdict::Unavoidable`].
    Unavoidable,
    /// [`AvoidanceVerdict::Undecided`].
    Undecided,
}

impl AvoidanceClass {
    /// Returns the name used in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Avoidable => "avoidable",
            Self::Unavoidable => "unavoidable",
            Self::Undecided => "undecided",
        }
    }
}

impl AvoidanceVerdict {
    /// Returns the class of the verdict.
    #[must_use]
    pub fn class(&self) -> AvoidanceClass {
        match self {
            Self::Avoidable(_) => AvoidanceClass::Avoidable,
            Self::Unavoidable(_) => AvoidanceClass::Unavoidable,
            Self::Undecided(_) => AvoidanceClass::Undecided,
        }
    }

    /// Returns the escape, if there is one.
    #[must_use]
    pub fn escape(&self) -> Option<&Escape> {
        match self {
            Self::Avoidable(escape) => Some(escape),
            Self::Unavoidable(_) | Self::Undecided(_) => None,
        }
    }
}
