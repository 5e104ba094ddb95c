//! Monitor: one bottom-up pass over the formula, linear in the trace for every operator.

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
        let values = |semantics| Monitor { signals, semantics }.values(self, 0, samples);
        let mut robustness = values(MonitorSemantics::Quantitative)?;
        if robustness.contains(&0.0) {
            let truth = values(MonitorSemantics::Boolean)?;
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
        reading: MonitorSemantics,
    ) -> Result<f64, MonitorError> {
        let values = Monitor {
            signals,
            semantics: reading,
        }
        .values(self, 0, 1)?;
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
        let mut terms = Vec::with_capacity(comparison.terms().len());
        for (weight, name) in comparison.terms() {
            let samples = self
                .signals
                .get(name)
                .and_then(|samples| samples.get(from..to));
            let samples = samples.ok_or_else(|| MonitorError::UnknownSignal {
                name: name.clone(),
                known: self.signals.names().map(str::to_owned).collect(),
            })?;
            terms.push((sign * weight, samples));
        }
        let bound = sign * comparison.bound();
        let mut values = buffer_pool::acquire();
        let mut any_undefined = false;
        // In chunks that stay in the L1 cache for all terms.
        for start in (0..to - from).step_by(CHUNK) {
            values.resize((start + CHUNK).min(to - from), 0.0);
            let piece = &mut values[start..];
            for (weight, samples) in &terms {
                piece
                    .iter_mut()
                    .zip(&samples[start..])
                    .for_each(|(value, &sample)| *value += weight * sample);
            }
            for value in piece {
                *value -= bound;
                any_undefined |= value.is_nan();
            }
        }
        if any_undefined {
            let index = from
                + values
                    .iter()
                    .position(|value| value.is_nan())
                    .unwrap_or_default();
            let time_s = index as f64 * self.signals.step_s();
            return Err(MonitorError::Undefined {
                comparison: comparison.to_string(),
                time_s,
            });
        }
        if self.semantics == MonitorSemantics::Boolean {
            let strict = comparison.operator().is_strict();
            let truth = |margin: f64| {
                if margin > 0.0 || (margin == 0.0 && !strict) {
                    1.0
                } else {
                    -1.0
                }
            };
            values.iter_mut().for_each(|value| *value = truth(*value));
        }
        Ok(values)
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
        let others = self.values(right, from, to)?;
        values
            .iter_mut()
            .zip(&others)
            .for_each(|(value, &other)| *value = joined(*value, other));
        buffer_pool::release(others);
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
        let Some((inner_from, inner_to)) = self.referenced_samples(first, last, from, to) else {
            return Ok(vec![E::IDENTITY; to - from]);
        };
        let values = self.values(inner, inner_from, inner_to)?;
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
    ) -> Option<(usize, usize)> {
        let start = from.saturating_add(first);
        let end = to.saturating_add(last).min(self.signals.samples());
        (start < end).then_some((start, end))
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
        let Some((start, end)) = self.referenced_samples(first, last, from, to) else {
            return Ok(vec![Maximum::IDENTITY; to - from]);
        };
        let goal = self.values(right, start, end)?;
        // The left side at the last sample has no effect.
        let path = self.values(left, from, end - 1)?;
        let mut result =
            sliding_extremum::<Maximum>(goal.clone(), (last - first).saturating_add(1), to - from);
        let before = if first == 0 {
            Vec::new()
        } else {
            sliding_extremum::<Minimum>(path.clone(), first, to - from)
        };
        result
            .iter_mut()
            .zip(&before)
            .for_each(|(value, &held)| *value = Minimum::combine(*value, held));
        // Unbounded until, from the last sample backwards: u(k) = max(q(k), min(p(k), u(k + 1))).
        let mut unbounded = goal;
        let mut next = Maximum::IDENTITY;
        let path = path
            .iter()
            .copied()
            .skip(first)
            .chain([Minimum::IDENTITY])
            .collect::<Vec<_>>();
        for (value, &held) in unbounded.iter_mut().zip(&path).rev() {
            next = Maximum::combine(*value, Minimum::combine(held, next));
            *value = next;
        }
        let reached = unbounded
            .into_iter()
            .chain(std::iter::repeat(Maximum::IDENTITY));
        result
            .iter_mut()
            .zip(reached)
            .for_each(|(value, reached)| *value = Minimum::combine(*value, reached));
        Ok(result)
    }
}

#[cfg(test)]
mod tests;
