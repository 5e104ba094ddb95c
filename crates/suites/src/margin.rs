//! Margins of a test: the largest change of a parameter that still passes.

use serde::{Deserialize, Serialize};

use super::parameter::{ParameterKind, ParameterUnit};
use super::result::TestVerdict;
use super::run::{ControllerSetup, Criterion};
use super::scenario::PointRun;
use super::spec::{TestSpec, with_value};

/// Number of equal intervals of a sweep; the test is run at their ends.
const SWEEP_PARTS: usize = 16;

/// Number of bisections of the interval with the first failure: to 1/2048 of the sweep.
const BISECTIONS: usize = 7;

/// Margin of a test in one parameter, with the others fixed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Margin {
    /// Parameter that is varied.
    #[serde(alias = "push")]
    pub parameter: ParameterKind,
    /// Unit of all values of the margin.
    pub unit: ParameterUnit,
    /// First value: the value of the grid that is nearest to `to`.
    pub from: f64,
    /// Last value.
    pub to: f64,
    /// Description of the fixed parameters.
    #[serde(alias = "held")]
    pub fixed_parameters: String,
    /// End of the margin.
    pub end: MarginEnd,
}

/// End of a margin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MarginEnd {
    /// The test does not pass at the first value.
    None {
        /// Outcome there.
        #[serde(alias = "beyond")]
        failure: SweepFailure,
    },
    /// The test passes at the ends of all intervals; values between them were not run.
    Holds {
        /// Number of intervals.
        parts: usize,
    },
    /// The test passes at one value and does not at the next; both were run.
    Boundary {
        /// Last value that passes.
        passes_at: f64,
        /// First value that does not pass.
        fails_at: f64,
        /// Outcome there.
        #[serde(alias = "beyond")]
        failure: SweepFailure,
        /// True if no later end of an interval passes; otherwise this is only the first failure.
        is_monotone: bool,
        /// Number of intervals.
        parts: usize,
    },
}

/// Outcome of a test that does not pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepFailure {
    /// A collision, or no valid answer of the controller.
    Fails,
    /// The test cannot be run, for example because a shield knows no safe command.
    Refused,
}

type SweepOutcome = Result<(), SweepFailure>;

struct Sweep<'t> {
    test: &'t TestSpec,
    base: Vec<f64>,
    position: usize,
    parameter: ParameterKind,
    unit: ParameterUnit,
    from: f64,
    to: f64,
}

impl Sweep<'_> {
    fn value(&self, part: usize) -> f64 {
        self.from + (self.to - self.from) * (part as f64 / SWEEP_PARTS as f64)
    }

    fn margin(&self, end: MarginEnd) -> Margin {
        Margin {
            parameter: self.parameter,
            unit: self.unit,
            from: self.from,
            to: self.to,
            fixed_parameters: self
                .test
                .describe_point_without(&self.base, Some(self.position)),
            end,
        }
    }

    /// Returns the point at a value of the swept parameter, ready to be run; `None` if it is invalid.
    fn point_run(&self, value: f64) -> Option<PointRun> {
        let point = with_value(&self.base, self.position, value);
        self.test.point_run("margin", "", &point).ok()
    }
}

impl TestSpec {
    /// Returns the point of a margin, given by its index among the [`margins`](crate::ControllerResult::margins) of a
    /// result, at a value of its parameter; `None` if the test has no such margin.
    #[must_use]
    pub fn margin_point(&self, margin: usize, value: f64) -> Option<Vec<f64>> {
        let all = sweeps(self);
        let sweep = all.get(margin)?;
        Some(with_value(&sweep.base, sweep.position, value))
    }
}

/// Finds the margins of a test: one per direction and combination of the other parameters.
pub(super) fn find_margins(
    test: &TestSpec,
    criterion: Criterion,
    setup: &ControllerSetup<'_>,
) -> Vec<Margin> {
    let sweeps = sweeps(test);
    let ends: Vec<(usize, f64)> = sweeps
        .iter()
        .enumerate()
        .flat_map(|(index, sweep)| (0..=SWEEP_PARTS).map(move |part| (index, sweep.value(part))))
        .collect();
    let outcomes = evaluate(&sweeps, &ends, criterion, setup);
    let mut margin_ends: Vec<MarginEnd> = outcomes
        .chunks(SWEEP_PARTS + 1)
        .zip(&sweeps)
        .map(|(outcomes, sweep)| grid_end(sweep, outcomes))
        .collect();
    for _ in 0..BISECTIONS {
        bisect(&mut margin_ends, &sweeps, criterion, setup);
    }
    sweeps
        .iter()
        .zip(margin_ends)
        .map(|(sweep, end)| sweep.margin(end))
        .collect()
}

fn sweeps(test: &TestSpec) -> Vec<Sweep<'_>> {
    let mut sweeps: Vec<Sweep<'_>> = Vec::new();
    for margin in &test.margins {
        let Some((position, figure)) = test.find_parameter(margin.parameter) else {
            continue;
        };
        let Some((&first, &last)) = figure.values.first().zip(figure.values.last()) else {
            continue;
        };
        let from = if margin.to > last { last } else { first };
        let bases = test
            .grid()
            .into_iter()
            .filter(|point| point.get(position) == Some(&from));
        sweeps.extend(bases.map(|base| Sweep {
            test,
            base,
            position,
            parameter: margin.parameter,
            unit: figure.unit,
            from,
            to: margin.to,
        }));
    }
    sweeps
}

/// Returns the end of a margin to the accuracy of the intervals of the sweep.
fn grid_end(sweep: &Sweep<'_>, outcomes: &[SweepOutcome]) -> MarginEnd {
    let first_failure = outcomes
        .iter()
        .zip(0..)
        .find_map(|(outcome, part)| outcome.err().map(|failure| (part, failure)));
    match first_failure {
        None => MarginEnd::Holds { parts: SWEEP_PARTS },
        Some((0, failure)) => MarginEnd::None { failure },
        Some((first, failure)) => MarginEnd::Boundary {
            passes_at: sweep.value(first - 1),
            fails_at: sweep.value(first),
            failure,
            is_monotone: !outcomes.iter().skip(first).any(Result::is_ok),
            parts: SWEEP_PARTS,
        },
    }
}

/// Halves the interval at the end of each margin.
fn bisect(
    margin_ends: &mut [MarginEnd],
    sweeps: &[Sweep<'_>],
    criterion: Criterion,
    setup: &ControllerSetup<'_>,
) {
    let middles: Vec<(usize, f64)> = margin_ends
        .iter()
        .enumerate()
        .filter_map(|(index, end)| Some((index, end.middle()?)))
        .collect();
    let outcomes = evaluate(sweeps, &middles, criterion, setup);
    for ((index, middle), outcome) in middles.into_iter().zip(outcomes) {
        let Some(MarginEnd::Boundary {
            passes_at,
            fails_at,
            failure,
            ..
        }) = margin_ends.get_mut(index)
        else {
            continue;
        };
        match outcome {
            Ok(()) => *passes_at = middle,
            Err(at_middle) => {
                *fails_at = middle;
                *failure = at_middle;
            }
        }
    }
}

impl MarginEnd {
    /// Returns the middle of the interval of a boundary.
    fn middle(&self) -> Option<f64> {
        match self {
            Self::Boundary {
                passes_at,
                fails_at,
                ..
            } => Some(0.5 * (passes_at + fails_at)),
            Self::None { .. } | Self::Holds { .. } => None,
        }
    }
}

/// Runs the test at some values of some sweeps, each given by its index.
fn evaluate(
    sweeps: &[Sweep<'_>],
    values: &[(usize, f64)],
    criterion: Criterion,
    setup: &ControllerSetup<'_>,
) -> Vec<SweepOutcome> {
    let runs: Vec<Option<PointRun>> = values
        .iter()
        .map(|&(index, value)| sweeps.get(index)?.point_run(value))
        .collect();
    let valid: Vec<_> = runs.iter().flatten().cloned().collect();
    let mut results = setup.run_points(criterion, &valid).into_iter();
    runs.iter()
        .map(|run| {
            let result = run.as_ref().and_then(|_| results.next());
            match result.map(|result| result.verdict) {
                Some(TestVerdict::Passed) => Ok(()),
                Some(TestVerdict::Refused { .. }) | None => Err(SweepFailure::Refused),
                Some(_) => Err(SweepFailure::Fails),
            }
        })
        .collect()
}
