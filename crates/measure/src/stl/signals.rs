//! Named signals on a uniform time grid.

use std::borrow::Cow;

/// Signals by name, with sample k at `k * step_s`.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledSignals<'a> {
    step_s: f64,
    samples: usize,
    entries: Vec<(Cow<'a, str>, Cow<'a, [f64]>)>,
}

/// An error of signals.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SignalsError {
    /// A time step that is not positive and finite.
    #[error("the time step must be positive and finite, found {found} s")]
    Step {
        /// Time step, in seconds.
        found: f64,
    },
    /// Signals without samples.
    #[error("signals need at least one sample")]
    Empty,
    /// A signal with a different length.
    #[error("signal `{name}` has {found} samples, and the others have {expected}")]
    Length {
        /// Name of the signal.
        name: String,
        /// Number of its samples.
        found: usize,
        /// Number of samples of the others.
        expected: usize,
    },
    /// A sample that is NaN; infinities are allowed.
    #[error("signal `{name}`: sample {index} is not a number")]
    NotANumber {
        /// Name of the signal.
        name: String,
        /// Index of the first such sample.
        index: usize,
    },
    /// A duplicate name.
    #[error("there is a signal `{name}` already")]
    DuplicateName {
        /// Name of the signal.
        name: String,
    },
}

impl<'a> SampledSignals<'a> {
    /// Creates an empty set of signals with `samples` samples `step_s` seconds apart.
    ///
    /// # Errors
    /// [`SignalsError`] unless the step is positive and there is at least one sample.
    pub fn new(step_s: f64, samples: usize) -> Result<Self, SignalsError> {
        if !(step_s > 0.0 && step_s.is_finite()) {
            return Err(SignalsError::Step { found: step_s });
        }
        if samples == 0 {
            return Err(SignalsError::Empty);
        }
        Ok(Self {
            step_s,
            samples,
            entries: Vec::new(),
        })
    }

    /// Adds a signal, borrowed or owned.
    ///
    /// # Errors
    /// [`SignalsError`] if the name exists, the length differs or a sample is NaN.
    pub fn insert(
        &mut self,
        name: impl Into<Cow<'a, str>>,
        samples: impl Into<Cow<'a, [f64]>>,
    ) -> Result<(), SignalsError> {
        let name = name.into();
        let samples = samples.into();
        if self.get(&name).is_some() {
            return Err(SignalsError::DuplicateName {
                name: name.into_owned(),
            });
        }
        if samples.len() != self.samples {
            return Err(SignalsError::Length {
                name: name.into_owned(),
                found: samples.len(),
                expected: self.samples,
            });
        }
        if let Some(index) = samples.iter().position(|x| x.is_nan()) {
            return Err(SignalsError::NotANumber {
                name: name.into_owned(),
                index,
            });
        }
        self.entries.push((name, samples));
        Ok(())
    }

    /// Returns the samples of a signal.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&[f64]> {
        self.entries
            .iter()
            .find(|(signal, _)| signal == name)
            .map(|(_, samples)| samples.as_ref())
    }

    /// Returns the names, in order of insertion.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|(name, _)| name.as_ref())
    }

    /// Returns the time between samples in seconds.
    #[must_use]
    pub fn step_s(&self) -> f64 {
        self.step_s
    }

    /// Returns the number of samples, at least one.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Returns the time from the first to the last sample in seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        (self.samples - 1) as f64 * self.step_s
    }
}
