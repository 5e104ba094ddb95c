//! Robustness by definition: the reference of the monitor, and an independent check for replays.

use std::cell::RefCell;

use super::formula::{Formula, LinearPredicate, TimeWindow};
use super::monitor::MonitorError;
use super::signals::SampledSignals;

/// Returns the robustness at sample `at` by recursion over the definition.
///
/// Quadratic in the trace for long windows. Shares only the conversion of seconds to samples with
/// [`Formula::robustness`]. A sample after the end of the trace yields NaN.
///
/// # Errors
/// As [`Formula::robustness`].
pub fn naive_robustness(
    formula: &Formula,
    signals: &SampledSignals<'_>,
    at: usize,
) -> Result<f64, MonitorError> {
    NaiveNode::new(formula, signals.samples()).value_at(signals, at)
}

/// A formula with cached values, so that no sample is evaluated twice.
struct NaiveNode<'a> {
    formula: &'a Formula,
    inner: Vec<NaiveNode<'a>>,
    cache: RefCell<Vec<Option<f64>>>,
}

impl<'a> NaiveNode<'a> {
    fn new(formula: &'a Formula, samples: usize) -> Self {
        let inner = formula
            .operands()
            .into_iter()
            .map(|formula| NaiveNode::new(formula, samples))
            .collect();
        Self {
            formula,
            inner,
            cache: RefCell::new(vec![None; samples]),
        }
    }

    fn value_at(&self, signals: &SampledSignals<'_>, k: usize) -> Result<f64, MonitorError> {
        if let Some(value) = self.cache.borrow().get(k).copied().flatten() {
            return Ok(value);
        }
        let value = self.evaluate(signals, k)?;
        if let Some(slot) = self.cache.borrow_mut().get_mut(k) {
            *slot = Some(value);
        }
        Ok(value)
    }

    fn evaluate(&self, signals: &SampledSignals<'_>, k: usize) -> Result<f64, MonitorError> {
        match (self.formula, self.inner.as_slice()) {
            (Formula::Compare(comparison), _) => margin(comparison, signals, k),
            (Formula::Not(_), [a]) => Ok(-a.value_at(signals, k)?),
            (Formula::And(..), [a, b]) => Ok(a.value_at(signals, k)?.min(b.value_at(signals, k)?)),
            (Formula::Or(..), [a, b]) => Ok(a.value_at(signals, k)?.max(b.value_at(signals, k)?)),
            (Formula::Implies(..), [a, b]) => {
                Ok((-a.value_at(signals, k)?).max(b.value_at(signals, k)?))
            }
            (Formula::Always(window, _), [a]) => samples(*window, signals, k)?
                .try_fold(f64::INFINITY, |least, j| {
                    Ok(least.min(a.value_at(signals, j)?))
                }),
            (Formula::Eventually(window, _), [a]) => samples(*window, signals, k)?
                .try_fold(f64::NEG_INFINITY, |most, j| {
                    Ok(most.max(a.value_at(signals, j)?))
                }),
            (Formula::Until(_, window, _), [a, b]) => {
                let mut best = f64::NEG_INFINITY;
                let mut path_min = f64::INFINITY;
                let mut next = k;
                for j in samples(*window, signals, k)? {
                    while next < j {
                        path_min = path_min.min(a.value_at(signals, next)?);
                        next += 1;
                    }
                    best = best.max(b.value_at(signals, j)?.min(path_min));
                }
                Ok(best)
            }
            _ => Ok(f64::NAN),
        }
    }
}

/// Returns the robustness of a comparison at sample `k`.
fn margin(
    comparison: &LinearPredicate,
    signals: &SampledSignals<'_>,
    k: usize,
) -> Result<f64, MonitorError> {
    let mut sum = 0.0;
    for (weight, name) in comparison.terms() {
        let samples = signals
            .get(name)
            .ok_or_else(|| MonitorError::UnknownSignal {
                name: name.clone(),
                known: signals.names().map(str::to_owned).collect(),
            })?;
        sum += weight * samples.get(k).copied().unwrap_or(f64::NAN);
    }
    let excess = sum - comparison.bound();
    if excess.is_nan() {
        return Err(MonitorError::Undefined {
            comparison: comparison.to_string(),
            time_s: k as f64 * signals.step_s(),
        });
    }
    Ok(if comparison.operator().is_lower_bound() {
        excess
    } else {
        -excess
    })
}

/// Returns the samples of a window at sample `k`, clipped to the trace.
fn samples(
    window: TimeWindow,
    signals: &SampledSignals<'_>,
    k: usize,
) -> Result<impl Iterator<Item = usize>, MonitorError> {
    let (first, last) = window.sample_bounds(signals.step_s())?;
    Ok((k.saturating_add(first)..signals.samples()).take_while(move |j| j - k <= last))
}
