//! Signal temporal logic (STL): formulas over named signals, and their robustness on a trace.
//!
//! # Syntax
//!
//! ```text
//! always[0,100] y5 - y4 <= 40
//! always[0,70] eventually[0,30] y5 - y4 >= 15
//! (gap_m > 2 and ttc_s >= 1.5) until[0,10] speed_mps < 0.1
//! ```
//!
//! A comparison (`<`, `<=`, `>`, `>=`) is between two sums of signals and numbers, with numbers as factors or divisors.
//! By falling precedence: comparisons; `not`, `always[a,b]`, `eventually[a,b]`; `until[a,b]` (two in a row need
//! parentheses); `and`; `or`; `implies` (right-associative). So `always x > 0 and y > 0` is `(always (x > 0)) and (y >
//! 0)`, and is printed so. Bounds are in seconds, the upper one may be `inf`; the default is `[0,inf]`. Alternative
//! spellings: `¬ □ ◇ ∧ ∨ → ≤ ≥`, and `!`, `&&`, `||`, `->`.
//!
//! # Semantics
//!
//! Time is discrete: sample k is at k times the step, and a window `[a,b]` at sample k holds the samples from k +
//! a/step to k + b/step, inclusive. Robustness is the quantitative semantics of Donzé and Maler (Robust satisfaction of
//! temporal logic over real-valued signals, FORMATS 2010): a comparison yields its margin, `not` the negative, `and`
//! and `always` a minimum, `or` and `eventually` a maximum, and
//!
//! ```text
//! (p until[a,b] q) at k  =  max over j in the window of  min( q at j, min of p over the samples from k to before j ).
//! ```
//!
//! The value of a formula is that at the first sample. Positive robustness means satisfied, negative means violated; at
//! 0, [`Formula::is_satisfied`] distinguishes `<` from `<=`.
//!
//! # The end of the trace
//!
//! Windows are clipped to the trace. A window after the last sample is empty: `always` over it is satisfied (robustness
//! +∞), `eventually` and `until` are not (-∞), so that `not always` equals `eventually not` there too. Samples to which
//! the formula does not refer have no effect. On a trace of duration [`Formula::horizon_s`] no window is clipped,
//! nested windows included. To reject shorter traces, compare [`Formula::horizon_s`] with
//! [`SampledSignals::duration_s`].

mod buffer_pool;
mod formula;
#[cfg(test)]
mod generate;
mod lex;
mod monitor;
mod motion;
mod naive;
mod parse;
mod parts;
mod print;
mod signals;
mod window;

pub use formula::{ComparisonOp, Formula, FormulaError, LinearPredicate, TimeWindow};
pub(crate) use monitor::MIN_VIOLATION;
pub use monitor::MonitorError;
pub use motion::{motion_signal_names, motion_signals};
pub use naive::naive_robustness;
pub(crate) use parse::signal_column;
pub use parse::{FormulaParseError, SyntaxProblem};
pub use parts::FormulaPart;
pub use signals::{SampledSignals, SignalsError};
