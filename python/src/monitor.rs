//! Robustness of STL formulas on arrays.

use crumple_measure::stl::{Formula, SampledSignals};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::errors::{self, ExceptionClass};
use crate::interruptible::{StopFlag, run_interruptible};

/// Number of traces between two checks for an interrupt.
const TRACES_PER_BATCH: usize = 1024;

/// Maximum number of samples, over all traces, that are monitored without checks for an interrupt.
const MAX_INLINE_SAMPLES: usize = 1 << 16;

/// Reason why a formula has no robustness on some signals.
type RobustnessError = Box<dyn std::error::Error + Send + Sync>;

/// Signals of several traces: one row for every trace, or one shared row.
struct SignalRows<'a> {
    step_s: f64,
    samples: usize,
    signals: Vec<(&'a str, &'a [f64], bool)>,
}

impl SignalRows<'_> {
    /// Returns the robustness of traces, in parallel, until `stop` is set.
    fn robustness_of_traces(
        &self,
        formula: &Formula,
        traces: usize,
        over_time: bool,
        stop: &StopFlag,
    ) -> Result<Vec<Vec<f64>>, RobustnessError> {
        let mut robustness = Vec::with_capacity(traces);
        for first in (0..traces).step_by(TRACES_PER_BATCH) {
            if stop.is_set() {
                break;
            }
            let batch = (first..traces.min(first + TRACES_PER_BATCH))
                .into_par_iter()
                .map(|trace| self.robustness(formula, trace, over_time));
            robustness.append(&mut batch.collect::<Result<Vec<_>, _>>()?);
        }
        Ok(robustness)
    }

    /// Returns the robustness of one trace at its start, or at every sample.
    fn robustness(
        &self,
        formula: &Formula,
        trace: usize,
        over_time: bool,
    ) -> Result<Vec<f64>, RobustnessError> {
        let mut signals = SampledSignals::new(self.step_s, self.samples)?;
        for (name, values, is_shared) in &self.signals {
            let first = if *is_shared { 0 } else { trace * self.samples };
            let row = values.get(first..first + self.samples).unwrap_or_default();
            signals.insert(*name, row)?;
        }
        Ok(match over_time {
            true => formula.robustness_over_time(&signals)?,
            false => vec![formula.robustness(&signals)?],
        })
    }
}

/// Returns the robustness of a formula on `traces` traces, one row each.
#[pyfunction]
pub(crate) fn monitor<'py>(
    py: Python<'py>,
    formula: &str,
    names: Vec<String>,
    signals: Vec<PyReadonlyArray2<'py, f64>>,
    step_s: f64,
    traces: usize,
    over_time: bool,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let formula: Formula = formula
        .parse()
        .map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))?;
    let samples = signals
        .first()
        .map_or(0, |values| values.as_array().ncols());
    let mut named = Vec::with_capacity(signals.len());
    for (name, values) in names.iter().zip(&signals) {
        let [rows, columns] = [values.as_array().nrows(), values.as_array().ncols()];
        if columns != samples || !(rows == 1 || rows == traces) {
            let problem = format!(
                "signal `{name}` has {rows} rows of {columns} samples: there are {traces} traces of {samples}"
            );
            return Err(errors::exception(py, ExceptionClass::Formula, &problem));
        }
        named.push((name.as_str(), values.as_slice()?, rows == 1));
    }
    let rows = SignalRows {
        step_s,
        samples,
        signals: named,
    };
    let robustness = if samples.saturating_mul(traces) <= MAX_INLINE_SAMPLES {
        // Another thread would take longer.
        py.detach(|| {
            (0..traces)
                .map(|trace| rows.robustness(&formula, trace, over_time))
                .collect()
        })
    } else {
        let stop = StopFlag::default();
        run_interruptible(py, &stop, None, None, |_| {
            rows.robustness_of_traces(&formula, traces, over_time, &stop)
        })?
    };
    let robustness: Vec<Vec<f64>> =
        robustness.map_err(|error| errors::exception(py, ExceptionClass::Formula, &error))?;
    let width = if over_time { samples } else { 1 };
    PyArray1::from_vec(py, robustness.concat()).reshape([traces, width])
}
