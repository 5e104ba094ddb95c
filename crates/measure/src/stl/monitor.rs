//! Monitor: one bottom-up pass over the formula, linear in the trace for every operator.

use std::ops::Range;

use super::buffer_pool;
use super::formula::{Formula, LinearPredicate, TimeWindow};
use super::signals::SampledSignals;
use super::window::{Extremum, Maximum, Minimum, sliding_extremum};

/// An error of the evaluation of a formula.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MonitorError {
    /// An unknown signal.
    #[error("there is no signal `{name}`; there are: {}", known.join(", "))]
    UnknownSignal {
        /// Name in the formula.
        name: String,
        /// Existing names.
        known: Vec<String>,
    },
    /// A window without a sample.
    #[error("the window [{},{}] s holds no sample at a step of {step_s} s", window.from_s(), window.to_s())]
    NoSample {
        /// Window of the formula.
        window: TimeWindow,
        /// Time between samples, in seconds.
        step_s: f64,
    },
    /// A sum of signals that is infinity minus infinity at some sample.
    #[error("`{comparison}` is undefined at {time_s} s: infinity minus infinity")]
    Undefined {
        /// Text of the comparison.
        comparison: String,
        /// Time of the first such sample, in seconds.
        time_s: f64,
    },
}

/// Smallest violation: a robustness of 0 is no violation.
pub(crate) const MIN_VIOLATION: f64 = 1e-9;

/// Value of a comparison: its margin, or its truth as +1 or -1.
#[derive(Clone, Copy, PartialEq)]
enum MonitorSemantics {
    Quantitative,
    Boolean,
}

impl Formula {
    /// Returns the robustness at the first sample: positive if satisfied, negative if violated, in the units of the
    /// comparisons.
    ///
    /// Time and memory are linear in the number of samples for any windows.
    ///
    /// # Errors
    /// [`MonitorError`] for an unknown signal, a window between samples, or an undefined sum.
    pub fn robustness(&self, signals: &SampledSignals<'_>) -> Result<f64, MonitorError> {
        self.first_value(signals, MonitorSemantics::Quantitative)
    }

    /// Returns the robustness at every sample.
    ///
    /// # Errors
    /// As [`Formula::robustness`].
    pub fn robustness_over_time(
        &self,
        signals: &SampledSignals<'_>,
    ) -> Result<Vec<f64>, MonitorError> {
        Monitor {
            signals,
            semantics: MonitorSemantics::Quantitative,
        }
        .values(self, 0, signals.samples())
    }

    /// Returns true if the formula holds at the first sample. Agrees with the sign of a non-zero robustness.
    ///
    /// # Errors
    /// As [`Formula::robustness`].
    pub fn is_satisfied(&self, signals: &SampledSignals<'_>) -> Result<bool, MonitorError> {
        Ok(self.first_value(signals, MonitorSemantics::Boolean)? > 0.0)
    }

    /// Returns the robustness at the first samples, below 0 if and only if the formula is violated there: at 0, the
    /// Boolean semantics decide between 0 and the negative [`MIN_VIOLATION`].
    pub(crate) fn decided_robustness(
        &self,
        signals: &SampledSignals<'_>,
        samples: usize,
    ) -> Result<Vec<f64>, MonitorError> {
        let mut robustness = Monitor {
            signals,
            semantics: MonitorSemantics::Quantitative,
        }
        .values(self, 0, samples)?;
        if robustness.contains(&0.0) {
            let truth = Monitor {
                signals,
                semantics: MonitorSemantics::Boolean,
            }
            .values(self, 0, samples)?;
            let zeros = robustness
                .iter_mut()
                .zip(truth)
                .filter(|(value, _)| **value == 0.0);
            zeros
                .for_each(|(value, truth)| *value = if truth > 0.0 { 0.0 } else { -MIN_VIOLATION });
        }
        Ok(robustness)
    }

    fn first_value(
        &self,
        signals: &SampledSignals<'_>,
        semantics: MonitorSemantics,
    ) -> Result<f64, MonitorError> {
        let values = Monitor { signals, semantics }.values(self, 0, 1)?;
        let first = values.first().copied().unwrap_or(f64::NAN);
        buffer_pool::release(values);
        Ok(first)
    }
}

impl TimeWindow {
    /// Returns the first and last sample of the window, relative to now; the last is `usize::MAX` for an infinite
    /// window.
    pub(super) fn sample_bounds(self, step_s: f64) -> Result<(usize, usize), MonitorError> {
        // A millionth of a step of tolerance: decimal multiples of the step are not multiples in binary.
        let first = (self.from_s() / step_s - 1e-6).ceil().max(0.0);
        let last = (self.to_s() / step_s + 1e-6).floor();
        if last < first {
            return Err(MonitorError::NoSample {
                window: self,
                step_s,
            });
        }
        // The conversion saturates.
        Ok((first as usize, last as usize))
    }
}

const CHUNK: usize = 1024;

struct Monitor<'a> {
    signals: &'a SampledSignals<'a>,
    semantics: MonitorSemantics,
}

impl Monitor<'_> {
    /// Returns the values at the samples from `from` to before `to`, all of which exist.
    fn values(&self, formula: &Formula, from: usize, to: usize) -> Result<Vec<f64>, MonitorError> {
        match formula {
            Formula::Compare(comparison) => self.compare(comparison, from, to),
            Formula::Not(inner) => {
                let mut values = self.values(inner, from, to)?;
                values.iter_mut().for_each(|value| *value = -*value);
                Ok(values)
            }
            Formula::And(left, right) => self.join(left, right, from, to, Minimum::combine),
            Formula::Or(left, right) => self.join(left, right, from, to, Maximum::combine),
            Formula::Implies(left, right) => {
                self.join(left, right, from, to, |a, b| Maximum::combine(-a, b))
            }
            Formula::Always(window, inner) => self.window::<Minimum>(*window, inner, from, to),
            Formula::Eventually(window, inner) => self.window::<Maximum>(*window, inner, from, to),
            Formula::Until(left, window, right) => self.until(left, *window, right, from, to),
        }
    }

    fn compare(
        &self,
        comparison: &LinearPredicate,
        from: usize,
        to: usize,
    ) -> Result<Vec<f64>, MonitorError> {
        let sign = if comparison.operator().is_lower_bound() {
            1.0
        } else {
            -1.0
        };
        let terms = self.weighted_samples(comparison, sign, from..to)?;
        let mut values = buffer_pool::acquire();
        let is_defined = subtract_bound(&terms, sign * comparison.bound(), &mut values, to - from);
        if !is_defined {
            let index = from
                + values
                    .iter()
                    .position(|value| value.is_nan())
                    .unwrap_or_default();
            return Err(MonitorError::Undefined {
                comparison: comparison.to_string(),
                time_s: index as f64 * self.signals.step_s(),
            });
        }
        if self.semantics == MonitorSemantics::Boolean {
            let is_strict = comparison.operator().is_strict();
            for value in &mut values {
                let is_true = *value > 0.0 || (*value == 0.0 && !is_strict);
                *value = if is_true { 1.0 } else { -1.0 };
            }
        }
        Ok(values)
    }

    /// Returns the terms of a comparison: weight, multiplied by `sign`, and samples of the signal.
    fn weighted_samples(
        &self,
        comparison: &LinearPredicate,
        sign: f64,
        range: Range<usize>,
    ) -> Result<Vec<(f64, &[f64])>, MonitorError> {
        let mut terms = Vec::with_capacity(comparison.terms().len());
        for (weight, name) in comparison.terms() {
            let samples = self
                .signals
                .get(name)
                .and_then(|samples| samples.get(range.clone()));
            let samples = samples.ok_or_else(|| MonitorError::UnknownSignal {
                name: name.clone(),
                known: self.signals.names().map(str::to_owned).collect(),
            })?;
            terms.push((sign * weight, samples));
        }
        Ok(terms)
    }

    fn join(
        &self,
        left: &Formula,
        right: &Formula,
        from: usize,
        to: usize,
        joined: impl Fn(f64, f64) -> f64,
    ) -> Result<Vec<f64>, MonitorError> {
        let mut values = self.values(left, from, to)?;
        let right = self.values(right, from, to)?;
        values
            .iter_mut()
            .zip(&right)
            .for_each(|(value, &right)| *value = joined(*value, right));
        buffer_pool::release(right);
        Ok(values)
    }

    fn window<E: Extremum>(
        &self,
        window: TimeWindow,
        inner: &Formula,
        from: usize,
        to: usize,
    ) -> Result<Vec<f64>, MonitorError> {
        let (first, last) = window.sample_bounds(self.signals.step_s())?;
        let Some(referenced) = self.referenced_samples(first, last, from, to) else {
            return Ok(vec![E::IDENTITY; to - from]);
        };
        let values = self.values(inner, referenced.start, referenced.end)?;
        Ok(sliding_extremum::<E>(
            values,
            (last - first).saturating_add(1),
            to - from,
        ))
    }

    /// Returns the range of samples to which windows at `from..to` refer; `None` if all start after the end of the
    /// trace.
    fn referenced_samples(
        &self,
        first: usize,
        last: usize,
        from: usize,
        to: usize,
    ) -> Option<Range<usize>> {
        let start = from.saturating_add(first);
        let end = to.saturating_add(last).min(self.signals.samples());
        (start < end).then_some(start..end)
    }

    /// Evaluates `until` by the rewriting of Donzé, Ferrère and Maler (Efficient robust monitoring for STL, CAV 2013),
    /// which also holds for robustness:
    ///
    /// `p until[a,b] q  =  eventually[a,b] q  and  always[0,a) p  and  eventually[a,a] (p until q)`.
    fn until(
        &self,
        left: &Formula,
        window: TimeWindow,
        right: &Formula,
        from: usize,
        to: usize,
    ) -> Result<Vec<f64>, MonitorError> {
        let (first, last) = window.sample_bounds(self.signals.step_s())?;
        let Some(referenced) = self.referenced_samples(first, last, from, to) else {
            return Ok(vec![Maximum::IDENTITY; to - from]);
        };
        let goal = self.values(right, referenced.start, referenced.end)?;
        // The left side at the last sample has no effect.
        let path = self.values(left, from, referenced.end - 1)?;
        let mut result =
            sliding_extremum::<Maximum>(goal.clone(), (last - first).saturating_add(1), to - from);
        if first > 0 {
            let before = sliding_extremum::<Minimum>(path.clone(), first, to - from);
            result
                .iter_mut()
                .zip(&before)
                .for_each(|(value, &before)| *value = Minimum::combine(*value, before));
        }
        let unbounded = unbounded_until(path.get(first..).unwrap_or_default(), goal);
        result
            .iter_mut()
            .zip(
                unbounded
                    .into_iter()
                    .chain(std::iter::repeat(Maximum::IDENTITY)),
            )
            .for_each(|(value, unbounded)| *value = Minimum::combine(*value, unbounded));
        Ok(result)
    }
}

/// Writes the weighted sum of `terms` less `bound` to `values`, for `samples` samples. Returns false if one is NaN.
fn subtract_bound(
    terms: &[(f64, &[f64])],
    bound: f64,
    values: &mut Vec<f64>,
    samples: usize,
) -> bool {
    let mut any_undefined = false;
    // In chunks that stay in the L1 cache for all terms.
    for start in (0..samples).step_by(CHUNK) {
        values.resize((start + CHUNK).min(samples), 0.0);
        let chunk = &mut values[start..];
        for (weight, samples) in terms {
            chunk
                .iter_mut()
                .zip(&samples[start..])
                .for_each(|(value, &sample)| *value += weight * sample);
        }
        for value in chunk {
            *value -= bound;
            any_undefined |= value.is_nan();
        }
    }
    !any_undefined
}

/// Evaluates `p until q` without a window: u(k) = max(q(k), min(p(k), u(k + 1))), from the last sample backwards.
/// `path` has the values of p, and no value at the last sample.
fn unbounded_until(path: &[f64], goal: Vec<f64>) -> Vec<f64> {
    let mut values = goal;
    let mut next = Maximum::IDENTITY;
    let path = path
        .iter()
        .copied()
        .chain([Minimum::IDENTITY])
        .collect::<Vec<_>>();
    for (value, &path) in values.iter_mut().zip(&path).rev() {
        next = Maximum::combine(*value, Minimum::combine(path, next));
        *value = next;
    }
    values
}

#[cfg(test)]
mod tests;
