//! Syntax trees of formulas.

use std::fmt;

use super::lex::is_signal_name;
use super::motion::split_signal_name;

/// A formula of signal temporal logic.
#[derive(Debug, Clone, PartialEq)]
pub enum Formula {
    /// A sum of signals compared with a number.
    Compare(LinearPredicate),
    /// Negation.
    Not(Box<Formula>),
    /// Conjunction.
    And(Box<Formula>, Box<Formula>),
    /// Disjunction.
    Or(Box<Formula>, Box<Formula>),
    /// Implication.
    Implies(Box<Formula>, Box<Formula>),
    /// At every sample of the window.
    Always(TimeWindow, Box<Formula>),
    /// At some sample of the window.
    Eventually(TimeWindow, Box<Formula>),
    /// The second formula at some sample of the window, and the first one from now until just before it.
    Until(Box<Formula>, TimeWindow, Box<Formula>),
}

/// Comparison operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComparisonOp {
    /// `<`
    Below,
    /// `<=`
    AtMost,
    /// `>`
    Above,
    /// `>=`
    AtLeast,
}

/// A weighted sum of distinct signals compared with a number.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearPredicate {
    terms: Vec<(f64, String)>,
    operator: ComparisonOp,
    bound: f64,
}

/// A time window relative to now, in seconds: `0 <= from_s <= to_s`, and `to_s` may be infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeWindow {
    from_s: f64,
    to_s: f64,
}

/// An error of a part of a formula.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FormulaError {
    /// A name that the syntax cannot express.
    #[error(
        "`{name}` is not a signal name: a letter, then letters, digits, `_` and `.`, and no keyword"
    )]
    Name {
        /// Name of the signal.
        name: String,
    },
    /// A number that is infinite or NaN.
    #[error("a comparison needs finite numbers, found {found}")]
    NotFinite {
        /// Value of the number.
        found: f64,
    },
    /// A comparison without a signal.
    #[error("a comparison needs a signal, and this one has none")]
    NoSignal,
    /// A window that starts before now, or ends before its start.
    #[error("a window must have 0 <= start <= end, found [{from_s},{to_s}]")]
    Window {
        /// Start in seconds.
        from_s: f64,
        /// End in seconds.
        to_s: f64,
    },
}

impl LinearPredicate {
    /// Creates a comparison of the sum of `weight * signal` with `bound`. Adds up terms of one signal and drops zero
    /// weights.
    ///
    /// # Errors
    /// [`FormulaError`] if a name cannot be written in the syntax, a number is not finite or no signal is left.
    pub fn new(
        terms: impl IntoIterator<Item = (f64, String)>,
        relation: ComparisonOp,
        bound: f64,
    ) -> Result<Self, FormulaError> {
        let mut sum: Vec<(f64, String)> = Vec::new();
        for (weight, name) in terms {
            if !is_signal_name(&name) {
                return Err(FormulaError::Name { name });
            }
            match sum.iter_mut().find(|(_, signal)| *signal == name) {
                Some((total, _)) => *total += weight,
                None => sum.push((weight, name)),
            }
        }
        sum.retain(|(weight, _)| *weight != 0.0);
        if let Some(found) = sum
            .iter()
            .map(|(weight, _)| *weight)
            .chain([bound])
            .find(|x| !x.is_finite())
        {
            return Err(FormulaError::NotFinite { found });
        }
        if sum.is_empty() {
            return Err(FormulaError::NoSignal);
        }
        Ok(Self {
            terms: sum,
            operator: relation,
            bound,
        })
    }

    /// Returns weights and names of the signals, each name once.
    #[must_use]
    pub fn terms(&self) -> &[(f64, String)] {
        &self.terms
    }

    pub(crate) fn operator(&self) -> ComparisonOp {
        self.operator
    }

    /// Returns the bound.
    #[must_use]
    pub fn bound(&self) -> f64 {
        self.bound
    }
}

impl ComparisonOp {
    /// Returns true if equality does not satisfy the operator.
    pub(crate) fn is_strict(self) -> bool {
        matches!(self, Self::Below | Self::Above)
    }

    /// Returns true if larger sums satisfy the operator better.
    pub(crate) fn is_lower_bound(self) -> bool {
        matches!(self, Self::Above | Self::AtLeast)
    }
}

impl fmt::Display for ComparisonOp {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Below => "<",
            Self::AtMost => "<=",
            Self::Above => ">",
            Self::AtLeast => ">=",
        })
    }
}

impl TimeWindow {
    /// Window from now to the end of the trace.
    pub const ALL: Self = Self {
        from_s: 0.0,
        to_s: f64::INFINITY,
    };

    /// Creates the window from `from_s` to `to_s`, inclusive.
    ///
    /// # Errors
    /// [`FormulaError::Window`] unless `0 <= from_s <= to_s` and `from_s` is finite.
    pub fn new(from_s: f64, to_s: f64) -> Result<Self, FormulaError> {
        if from_s >= 0.0 && from_s.is_finite() && to_s >= from_s {
            Ok(Self { from_s, to_s })
        } else {
            Err(FormulaError::Window { from_s, to_s })
        }
    }

    /// Returns the start of the window in seconds from now.
    #[must_use]
    pub fn from_s(self) -> f64 {
        self.from_s
    }

    /// Returns the end of the window in seconds from now, possibly infinite.
    #[must_use]
    pub fn to_s(self) -> f64 {
        self.to_s
    }
}

impl Formula {
    /// Returns the shortest duration of a trace on which no window is clipped, in seconds; infinite for an unbounded
    /// window.
    #[must_use]
    pub fn horizon_s(&self) -> f64 {
        self.sum_of_windows_s(TimeWindow::to_s)
    }

    /// Returns the duration from which on the stated ends of all windows can lie within a trace, in seconds: as
    /// [`Formula::horizon_s`], but of an unbounded window, only the start counts.
    #[must_use]
    pub fn stated_horizon_s(&self) -> f64 {
        self.sum_of_windows_s(|window| {
            if window.to_s.is_finite() {
                window.to_s
            } else {
                window.from_s
            }
        })
    }

    /// Returns the largest sum of nested windows, each of the given length in seconds.
    fn sum_of_windows_s(&self, length_s: fn(TimeWindow) -> f64) -> f64 {
        let operands_s = self
            .operands()
            .into_iter()
            .map(|operand| operand.sum_of_windows_s(length_s))
            .fold(0.0, f64::max);
        match self {
            Self::Always(window, _) | Self::Eventually(window, _) | Self::Until(_, window, _) => {
                length_s(*window) + operands_s
            }
            Self::Compare(_) | Self::Not(_) | Self::And(..) | Self::Or(..) | Self::Implies(..) => {
                operands_s
            }
        }
    }

    /// Returns the formulas that the operator joins, left to right.
    pub(super) fn operands(&self) -> Vec<&Self> {
        match self {
            Self::Compare(_) => vec![],
            Self::Not(inner) | Self::Always(_, inner) | Self::Eventually(_, inner) => vec![inner],
            Self::And(left, right)
            | Self::Or(left, right)
            | Self::Implies(left, right)
            | Self::Until(left, _, right) => vec![left, right],
        }
    }

    /// Returns the largest parts without a temporal operator, which are evaluated only at the first sample.
    pub(crate) fn first_sample_parts(&self) -> Vec<&Self> {
        if !self.has_temporal_operator() {
            return vec![self];
        }
        if self.is_temporal() {
            return Vec::new();
        }
        self.operands()
            .into_iter()
            .flat_map(Self::first_sample_parts)
            .collect()
    }

    fn is_temporal(&self) -> bool {
        matches!(
            self,
            Self::Always(..) | Self::Eventually(..) | Self::Until(..)
        )
    }

    fn has_temporal_operator(&self) -> bool {
        self.is_temporal() || self.operands().into_iter().any(Self::has_temporal_operator)
    }

    /// Returns a warning if a part of the formula is evaluated only at the first sample, which is rarely intended.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let parts: Vec<_> = self
            .first_sample_parts()
            .iter()
            .map(|part| format!("`{part}`"))
            .collect();
        let [no, are] = if parts.len() == 1 {
            ["has no", "is"]
        } else {
            ["have no", "are"]
        };
        (!parts.is_empty()).then(|| {
            format!(
                "{} {no} temporal operator (`always`, `eventually`, `until`) and {are} evaluated at the first instant \
                    only; the formula was read as `{self}`",
                parts.join(" and ")
            )
        })
    }

    /// Returns the names of the signals, in order of first use.
    #[must_use]
    pub fn signal_names(&self) -> Vec<&str> {
        let mut names = Vec::new();
        self.collect_names(&mut names);
        names
    }

    /// Returns the number of vehicles in runs that have all signals of the formula.
    pub(crate) fn vehicle_count(&self) -> usize {
        let names = self.signal_names().into_iter();
        let vehicles = names
            .filter_map(|name| split_signal_name(name))
            .map(|(index, _)| index);
        vehicles.max().map_or(0, |last| last.saturating_add(1))
    }

    fn collect_names<'a>(&'a self, names: &mut Vec<&'a str>) {
        if let Self::Compare(comparison) = self {
            for (_, name) in &comparison.terms {
                if !names.contains(&name.as_str()) {
                    names.push(name);
                }
            }
        }
        self.operands()
            .into_iter()
            .for_each(|operand| operand.collect_names(names));
    }
}
